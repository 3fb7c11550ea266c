"""What becomes of a socket's connections, as ZeroMQ tells it."""

import zmq


def monitor_of(socket: "zmq.Socket[bytes]", events: int) -> "zmq.Socket[bytes]":
    """A socket that becomes readable with each of these ``events`` of ``socket``, which is neither bound nor connected.

    Its queue is not bounded: ZeroMQ's own thread writes to it and would wait for room, with every connection of the
    process. Whoever reads it sees to it that events do not pile up.
    """
    address = f"inproc://monitor-{id(socket)}"
    socket.monitor(address, events)
    monitor: zmq.Socket[bytes] = socket.context.socket(zmq.PAIR)
    monitor.setsockopt(zmq.RCVHWM, 0)
    monitor.connect(address)
    return monitor


def close_monitor(socket: "zmq.Socket[bytes]", monitor: "zmq.Socket[bytes]") -> None:
    """End it, before or after ``socket`` is closed."""
    if not socket.closed:
        socket.disable_monitor()  # before its other end closes: ZeroMQ says goodbye to it
    monitor.close(linger=0)
