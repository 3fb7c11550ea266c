"""One process of the chain device -> coupling -> environment -> coupling -> device, with nothing in it but messages.

    python chain.py MIDDLEWARE NODE PLAN CONTROL

The same processes, links, frame sizes and pacing as in the session that they are held against, carried by some
middleware; no mathematics. Needs nothing but the standard library and the middleware, so that it runs in whatever
interpreter the middleware was installed for.

PLAN is a JSON file: ``roles`` (by node), ``links`` ([binder, connector] each), ``period`` (ns), ``ticks``, ``limit``
(ns, when to stop though ticks are left), ``folder`` and ``port`` for the middleware. CONTROL is a Unix socket: the node
sends its name, reports its links as open, and receives the epoch; a device reports its ticks at the end.
"""

from __future__ import annotations

import array
import ctypes
import gc
import importlib
import json
import os
import signal
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple, Protocol

FRAME = struct.Struct("<qq15x")  # tick, stamp; 31 bytes, as long as a signal of one port
WAIT = 0.1  # s, until a wait is given up as lost
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29  # linux/prctl.h


class Peer(NamedTuple):
    """The other end of a link: its name, whether this node binds, and the link's number in the plan."""

    name: str
    binds: bool
    link: int


class Wire(Protocol):
    """What a middleware has to do; a module ``NAME_wire`` has a function ``open_wire`` that makes one.

    ``open_wire(node, peers, folder, port)`` returns when every peer can be sent to.
    """

    version: str

    def send(self, peer: str, frame: bytes) -> None:
        """Send a frame to a peer."""
        ...

    def receive(self, peer: str, wait: float) -> bytes | None:
        """The next frame from a peer; None if none came within ``wait`` seconds.

        A middleware that knows no time limits waits for ever.
        """
        ...


def awaited(wire: Wire, peer: str, tick: int) -> bytes | None:
    """The peer's frame of ``tick``; None if nothing came in time. Those of ticks that were given up are passed over."""
    while (frame := wire.receive(peer, WAIT)) is not None:
        if FRAME.unpack(frame)[0] == tick:
            return frame
    return None


def device(wire: Wire, coupling: str, epoch: int, plan: dict[str, Any]) -> dict[str, Any]:
    """Pace the chain as a device's node does; how it went, with every tau (ns) in a file."""
    period, ticks, end = plan["period"], plan["ticks"], epoch + plan["limit"]
    taus = array.array("q", bytes(8 * ticks))
    now, sleep, pack = time.monotonic_ns, time.sleep, FRAME.pack
    done = late = lost = slot = 0
    for tick in range(ticks):
        due = epoch + slot * period
        while (remaining := due - now()) > 0:
            sleep(remaining / 1e9)
        sampled = now()
        if sampled > end:
            break
        wire.send(coupling, pack(tick, sampled))
        answer = awaited(wire, coupling, tick)
        applied = now()
        if answer is None:
            lost += 1
        else:
            taus[done] = applied - sampled
            done += 1
        if applied > epoch + (slot + 1) * period:
            late += 1
            slot = -((epoch - applied) // period)  # rounded up
        else:
            slot += 1
    file = Path(plan["folder"]) / f"{os.getpid()}.tau"
    file.write_bytes(taus[:done].tobytes())
    return {"taus": str(file), "ticks": done, "late": late, "lost": lost}


def coupling(wire: Wire, own: str, environment: str) -> None:
    """Hand on, there and back, for ever."""
    while True:
        frame = wire.receive(own, WAIT)
        if frame is None:
            continue
        wire.send(environment, frame)
        answer = awaited(wire, environment, FRAME.unpack(frame)[0])
        if answer is not None:
            wire.send(own, answer)


def environment(wire: Wire, couplings: list[str]) -> None:
    """Answer everybody once everybody's frame of the tick is there, for ever."""
    while True:
        tick = -1
        frames: dict[str, bytes] = {}
        while len(frames) < len(couplings):
            for name in couplings:
                if name in frames or (frame := wire.receive(name, WAIT)) is None:
                    continue
                found, _ = FRAME.unpack(frame)
                if found > tick:  # one node has given up a lost tick; the others will, too
                    tick, frames = found, {}
                if found == tick:
                    frames[name] = frame
        for name in couplings:
            wire.send(name, frames[name])


def main() -> None:
    """Be one node."""
    middleware, node, plan_file, control = sys.argv[1:]
    prctl = ctypes.CDLL(None).prctl
    prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # couplings and environment run until they are ended
    plan = json.loads(Path(plan_file).read_text())
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(control)
        words = line.makefile("rw")

        def say(word: dict[str, Any]) -> None:
            words.write(json.dumps(word) + "\n")
            words.flush()

        say({"node": node, "pid": os.getpid()})
        peers = []
        for number, (binder, connector) in enumerate(plan["links"]):
            if node in (binder, connector):
                peers.append(Peer(connector if node == binder else binder, node == binder, number))
        opens = importlib.import_module(f"{middleware}_wire").open_wire
        wire: Wire = opens(node, peers, plan["folder"], plan["port"])
        say({"open": wire.version})
        epoch = json.loads(words.readline())["epoch"]
        prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
        gc.collect()
        gc.freeze()
        gc.disable()
        roles = plan["roles"]
        of = {role: [peer.name for peer in peers if roles[peer.name] == role] for role in set(roles.values())}
        match roles[node]:
            case "device":
                say(device(wire, of["coupling"][0], epoch, plan))
                words.readline()  # until the other end hangs up: a process that ends may take a link with it
            case "coupling":
                coupling(wire, of["device"][0], of["environment"][0])
            case "environment":
                environment(wire, of["coupling"])


if __name__ == "__main__":
    main()
