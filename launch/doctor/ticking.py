"""A node of a session with the mathematics left out: its links, and frames of their size, on bare pyzmq.

What a node does in a tick follows from which of its links lead towards the hands (``inner``) and which towards the
world (``outer``): it hears the inner ones, asks the outer ones, and answers the inner ones. A device has no inner ones:
it paces itself instead.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import zmq

from manyhands.launch.doctor.conversation import hear, said, tell
from manyhands.nodes.life import Life, Stopped
from manyhands.nodes.realtime import RealtimeWishes, prepare, restore
from manyhands.protocol.clock import Instant, RealtimeClock

FRAME = bytes(64)  # about what a signal of a device takes
MAX_FRAME_BYTES = 4096  # what encryption says at the handshake is longer than a frame
QUEUE_FRAMES = 16
PATIENCE_MS = 100  # between two looks at whether the process should still run

_LOOPBACK = "tcp://127.0.0.1:*"


@dataclass(frozen=True)
class TickTask:
    """Be a node of a session.

    Attributes:
        period: ns.
        ticks: number of ticks.
        priority: of SCHED_FIFO; 0 for ordinary scheduling.
        binds: for each link that this process binds, the address: an ``ipc`` endpoint, or empty for encrypted TCP.
        connects: the links that it connects to.
        inner: its links towards the hands.
        outer: its links towards the world.
    """

    period: int
    ticks: int
    priority: int
    binds: Mapping[str, str]
    connects: tuple[str, ...]
    inner: tuple[str, ...]
    outer: tuple[str, ...]


def tick(task: TickTask, life: Life) -> None:
    """Be a node: link up, wait for the start, run the ticks, tell the figures."""
    context = zmq.Context()
    try:
        links: dict[str, zmq.Socket[bytes]] = {}
        endpoints: dict[str, tuple[str, str]] = {}
        for name, address in task.binds.items():
            links[name], endpoints[name] = _bound(context, address)
        tell({"endpoints": endpoints})
        for name, (endpoint, key) in hear()["endpoints"].items():
            links[name] = _connected(context, endpoint, key)
        _shake_hands(links, task, life)
        tell({"ready": True})
        clock = RealtimeClock()
        epoch = Instant(hear()["epoch"])
        granted = prepare(RealtimeWishes(priority=task.priority))
        life.enter_loop()
        try:
            figures = _run(task, links, epoch, clock, life)
        finally:
            life.leave_loop()
            restore(granted)
        tell({**figures, **said(granted)})
    finally:
        context.destroy(linger=0)


def _socket(context: zmq.Context[zmq.Socket[bytes]]) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.PAIR)
    for option, value in (
        (zmq.LINGER, 0), (zmq.SNDHWM, QUEUE_FRAMES), (zmq.RCVHWM, QUEUE_FRAMES),
        (zmq.RCVTIMEO, PATIENCE_MS), (zmq.SNDTIMEO, PATIENCE_MS), (zmq.MAXMSGSIZE, MAX_FRAME_BYTES),
    ):  # fmt: skip
        socket.setsockopt(option, value)
    return socket


def _bound(context: zmq.Context[zmq.Socket[bytes]], address: str) -> tuple[zmq.Socket[bytes], tuple[str, str]]:
    """A bound link, its endpoint and, for TCP, its public key: made for this probe, and gone with it."""
    socket, public = _socket(context), b""
    if not address:
        public, socket.curve_secretkey = zmq.curve_keypair()
        socket.curve_server = True
    socket.bind(address or _LOOPBACK)
    return socket, (socket.getsockopt_string(zmq.LAST_ENDPOINT), public.decode())


def _connected(context: zmq.Context[zmq.Socket[bytes]], endpoint: str, key: str) -> zmq.Socket[bytes]:
    socket = _socket(context)
    if key:
        socket.curve_serverkey = key.encode()
        socket.curve_publickey, socket.curve_secretkey = zmq.curve_keypair()
    socket.connect(endpoint)
    return socket


def _shake_hands(links: Mapping[str, zmq.Socket[bytes]], task: TickTask, life: Life) -> None:
    """One frame each way on every link; whoever connects speaks first, to all, so that nobody waits in a ring."""
    for name in task.connects:
        _send(links[name], life)
    for name in task.binds:
        _receive(links[name], life)
        _send(links[name], life)
    for name in task.connects:
        _receive(links[name], life)


def _run(
    task: TickTask, links: Mapping[str, zmq.Socket[bytes]], epoch: Instant, clock: RealtimeClock, life: Life
) -> dict[str, Any]:
    """The ticks; of one that paces itself: every tau, ns, and how many ticks were late."""
    inner, outer = [links[name] for name in task.inner], [links[name] for name in task.outer]
    paces = not inner
    # written in place: nothing grows in a tick
    taus = array("q", bytes(8 * task.ticks if paces else 0))
    late = slot = 0
    for k in range(task.ticks):
        if life.stopping:
            raise Stopped
        if paces:
            clock.sleep_until(Instant(epoch + slot * task.period))
        sampled = clock.now()
        for link in inner:
            _receive(link, life)
        for link in outer:
            _send(link, life)
        for link in outer:
            _receive(link, life)
        for link in inner:
            _send(link, life)
        if paces:
            applied = clock.now()
            taus[k] = applied - sampled
            slot += 1
            if applied > epoch + slot * task.period:
                late += 1
                slot = -((epoch - applied) // task.period)  # rounded up: nobody leaves the common raster
    return {"tau_ns": taus.tolist(), "late": late}


def _send(link: zmq.Socket[bytes], life: Life) -> None:
    while True:
        try:
            link.send(FRAME)
        except zmq.Again:
            _look(life)
        else:
            return


def _receive(link: zmq.Socket[bytes], life: Life) -> None:
    while True:
        try:
            link.recv()
        except zmq.Again:
            _look(life)
        else:
            return


def _look(life: Life) -> None:
    """Whether to go on waiting.

    Raises:
        Stopped: no.
    """
    life.check()
    if life.stopping:
        raise Stopped
