"""One end of a wave link as a process of its own, at 1 kHz, for tests over a WAN.

    python -m tests.support.path_end {near,far} SECONDS

The near end is the environment's: it binds a keyed TCP link and the datagrams' port, and sends its PathKey over that
link. The first line of input has the keys, the first line of the near end's output where it listens, which is the far
end's second line of input. The last line of output of either says what came of it, as JSON.
"""

from __future__ import annotations

import json
import sys
from typing import Any, Final

from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.keys import KeyPair, KeyRing
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import PathKey, Ready, Wave
from manyhands.protocol.path import PathState
from manyhands.protocol.transport import Link
from manyhands.protocol.transport.datagrams import DatagramPath, DatagramSocket
from manyhands.protocol.transport.zeromq import ZmqTransport

PERIOD: Final = from_seconds(0.001)
LONG: Final = from_seconds(20.0)


def main() -> None:
    """Run one end."""
    side, seconds = sys.argv[1], float(sys.argv[2])
    clock = RealtimeClock()
    keys = json.loads(sys.stdin.readline())
    peer = {"near": "far", "far": "near"}[side]
    ring = KeyRing(side, KeyPair(**keys[side]), {peer: keys[peer]["public"]})
    transport = ZmqTransport.tcp(ring)
    try:
        if side == "near":
            link, endpoint = transport.bind("near", peer, f"{keys['link']}:*")
            datagrams = DatagramSocket.bound(keys["datagrams"], 0, clock)
            say(endpoint)
            heard(link)  # the far end is there
            path = datagrams.offer(link, 1, PERIOD)
            link.send(encode(path.key))
        else:
            endpoint = json.loads(sys.stdin.readline())
            link = transport.connect(endpoint, peer)
            while not link.send(encode(Ready())):
                link.recv(from_seconds(0.01))
            key = decode(heard(link), MAX_CONTROL_BYTES)
            assert isinstance(key, PathKey)
            datagrams = DatagramSocket.unbound(clock)
            path = datagrams.take_up(key, keys["datagrams"], link, 1, PERIOD)
        transport.settle()
        say(loop(path, datagrams, link, clock, from_seconds(seconds)))
        datagrams.close()
    finally:
        transport.close()


def heard(link: Link) -> bytes:
    frame = link.recv(LONG)
    if frame is None:
        raise SystemExit("the other end does not come")
    return frame


def loop(
    path: DatagramPath, datagrams: DatagramSocket, link: Link, clock: RealtimeClock, time: Duration
) -> dict[str, Any]:
    """A wave in every period, whose sum is the sender's time; the age of the newest one in every period, ns."""
    began = clock.now()
    ages: list[int] = []
    newest: Wave | None = None
    taken, up, opened, latest = 0, 0, 0, -1
    for tick in range(time // PERIOD):
        clock.sleep_until(Instant(began + tick * PERIOD))
        path.send(Wave(tick, (float(clock.now()),), float(tick)))
        while (frame := link.recv(Duration(0))) is not None:
            path.take(frame)
        datagrams.read()
        wave = path.receive()
        taken += wave is not None
        newest = wave or newest
        up += path.state is PathState.UP
        if path.end.opened > opened:
            opened, latest = path.end.opened, tick
        if newest is not None:
            ages.append(clock.now() - int(newest.sums[0]))
    return {
        "ages": ages,
        "taken": taken,
        "up": up,
        "state": path.state,
        "opened": path.end.opened,
        "latest": latest,
        "refused": path.end.refused,
        "dropped": path.gate.dropped,
        "ticks": time // PERIOD,
    }


def say(what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
