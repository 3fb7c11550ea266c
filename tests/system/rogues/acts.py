"""A dishonest node: it runs in an honest node's place, with its bundle and its real key.

    python -m rogues.acts ACT BUNDLE SUPERVISOR_PID [LEAVES DONE]

Each act is the honest node and one addition, so that the misbehaviour is the only difference.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import CouplingBundle, DeviceBundle, EnvironmentBundle, load
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.link.process import key_ring, main
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    Echo,
    Figures,
    Force,
    LinkHello,
    NodeHello,
    Observation,
    Ready,
    Refusal,
    Role,
    Start,
    Stop,
    Telemetry,
    Welcome,
)
from manyhands.protocol.transport import Link
from manyhands.protocol.transport.zeromq import ZmqTransport

from .links import Babbling, Flooding, Forceful, HurriedClock, Lapsing, Oversized, Wrapped

LEAVE: Final = 10
"""Ticks that a held device does at each leave."""


class SteppedDriver:
    """A driver that samples only with the test's leave, so that a test knows between which ticks an event falls.

    Reads a byte for every :data:`LEAVE` ticks and writes one when they are done; the end of the file is leave for ever.
    """

    def __init__(self, driver: Driver, leaves: int, done: int) -> None:
        self._driver, self._leaves, self._done = driver, leaves, done
        self._free = False

    @property
    def axes(self) -> int:
        return self._driver.axes

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        if tick % LEAVE == 0 and not self._free:
            if tick > 0:
                os.write(self._done, b".")
            self._free = os.read(self._leaves, 1) == b""
        return self._driver.sample(tick, at)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float]:
        return self._driver.apply(f, at, until)

    def release(self, at: Instant) -> Sequence[float]:
        return self._driver.release(at)

    def idle(self, due: Instant) -> None:
        self._driver.idle(due)

    def intended_work(self) -> float:
        return self._driver.intended_work()

    def figures(self) -> Figures:
        return self._driver.figures()

    def close(self) -> None:
        self._driver.close()


OUT_OF_TURN: Final = (
    encode(NodeHello(PROTOCOL_VERSION, "0" * 64, "another", "dz", Role.DEVICE, 1, {})),
    encode(Ready()),
    encode(Welcome()),
    encode(Refusal("name", "go away")),
    encode(Connect({"cx": "tcp://127.0.0.1:1"})),
    encode(Start(0, 1)),
    encode(Stop("enough")),
    encode(Echo(1, 2, 3)),
    encode(Observation("dx", 1, Figures({"speed": 1.0}), {})),
    encode(Force(1, 1, np.array([1.0]))),
    b"",
    b"junk",
    bytes([0x97, 2, 99]),  # a hello of another version, which breaks off
    bytes(MAX_CONTROL_BYTES),
)
"""What no running node may say to its supervisor."""

_COLUMN: Final = np.zeros((3, 1))
MISFITS: Final = (
    Telemetry(3, Figures(), {names.DISPLACEMENT: np.zeros((3, 2)), names.FORCE: np.zeros((3, 2))}),  # too wide
    Telemetry(3, Figures(), {names.DISPLACEMENT: _COLUMN, names.FORCE: np.zeros((2, 1))}),  # of two lengths
    Telemetry(2, Figures(), {names.DISPLACEMENT: _COLUMN, names.FORCE: _COLUMN}),  # from before the first tick
    Telemetry(2**62, Figures(), {names.DISPLACEMENT: _COLUMN, names.FORCE: _COLUMN}),  # from long after the last
)
"""Telemetry of a device with one port that no recording can take."""


class BabblingDevice(DeviceNode):
    """Sends strays to its couplings and its supervisor."""

    def establish(self, links: Mapping[str, Link]) -> None:
        super().establish({name: Babbling(Oversized(link), bounded=True) for name, link in links.items()})

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        line = Wrapped(control._link)
        for frame in (*OUT_OF_TURN, *map(encode, MISFITS)):
            line.insist(frame)
        super().loop(start, life, control)


class BabblingCoupling(CouplingNode):
    """Sends strays to its devices and to the environment, which alone bounds its signals."""

    def establish(self, links: Mapping[str, Link]) -> None:
        super().establish({name: Babbling(link, name == "environment") for name, link in links.items()})


class BabblingEnvironment(EnvironmentNode):
    """Sends strays to one coupling, the last."""

    def establish(self, links: Mapping[str, Link]) -> None:
        last = list(links)[-1]
        super().establish({**links, last: Babbling(links[last], bounded=False)})


class FloodingDevice(DeviceNode):
    """Sends too much."""

    def establish(self, links: Mapping[str, Link]) -> None:
        super().establish({name: Flooding(link) for name, link in links.items()})


class ForcefulCoupling(CouplingNode):
    """Honest towards the environment, dishonest towards its devices."""

    def establish(self, links: Mapping[str, Link]) -> None:
        super().establish({name: link if name == "environment" else Forceful(link) for name, link in links.items()})


class HalfwayDevice(DeviceNode):
    """Sends its hello, receives the answer, and never sends Welcome."""

    def establish(self, links: Mapping[str, Link]) -> None:
        common = self._common
        for peer in common.peers:
            hello = LinkHello(
                PROTOCOL_VERSION, common.certificate, common.session, common.name, common.role, peer.ports
            )
            links[peer.name].send(encode(hello))
            links[peer.name].recv(None)
            links[peer.name].recv(None)  # until it receives the end


class HurriedCoupling(CouplingNode):
    """Gives its devices no time after their first frame."""

    def establish(self, links: Mapping[str, Link]) -> None:
        self._clock = clock = HurriedClock()
        late = {name: link if name == "environment" else Lapsing(link, clock) for name, link in links.items()}
        super().establish(late)


def impostor(kind: type[DeviceBundle | CouplingBundle], lie: Callable[[NodeHello], NodeHello]) -> int:
    """Send a false hello; returns 0 if the supervisor refuses it."""
    common = load(Path(sys.argv[1]), kind).common
    transport = ZmqTransport.tcp(key_ring(common, Path(common.private)))
    try:
        hello = NodeHello(
            PROTOCOL_VERSION, common.certificate, common.session, common.name, common.role, os.getpid(), {}
        )
        line = transport.join(common.control, common.name)
        line.send(encode(lie(hello)))
        answer = line.recv(None)
        return 0 if answer is not None and isinstance(decode(answer, MAX_CONTROL_BYTES), Refusal) else 1
    finally:
        transport.close()


def held() -> int:
    """An honest device that a test steps."""
    done, leaves = int(sys.argv.pop()), int(sys.argv.pop())
    return main(DeviceBundle, lambda bundle: DeviceNode(bundle, SteppedDriver(driver_of(bundle), leaves, done)))


ACTS: Final[Mapping[str, Callable[[], int]]] = {
    "held": held,
    "babbling device": lambda: main(DeviceBundle, lambda b: BabblingDevice(b, driver_of(b))),
    "babbling coupling": lambda: main(CouplingBundle, BabblingCoupling),
    "babbling environment": lambda: main(EnvironmentBundle, BabblingEnvironment),
    "flooding device": lambda: main(DeviceBundle, lambda b: FloodingDevice(b, driver_of(b))),
    "forceful coupling": lambda: main(CouplingBundle, ForcefulCoupling),
    "halfway device": lambda: main(DeviceBundle, lambda b: HalfwayDevice(b, driver_of(b))),
    "hurried coupling": lambda: main(CouplingBundle, HurriedCoupling),
    "under another's name": lambda: impostor(DeviceBundle, lambda hello: replace(hello, name="dz")),
    "with another's link": lambda: impostor(
        CouplingBundle, lambda hello: replace(hello, endpoints=dict.fromkeys(("dy", "dz"), "tcp://127.0.0.1:1"))
    ),
}

if __name__ == "__main__":
    act = sys.argv.pop(1)
    sys.exit(ACTS[act]())
