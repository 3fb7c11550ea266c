"""One environment's process under load: its supervisor, and all its couplings, played by this process.

The environment is the real one, with the bundle that a session of so many users has cut for it. The couplings shake
hands as couplings do and send what couplings send, each on a link of its own: at every millisecond all their p(k), and
then all their f_v(k) are awaited. Their frames are prepared beforehand, so that one process can play very many. As in a
session the environment is pinned to one processor, the last; this process has the others, or the same one, and where it
has one alone it asks for the scheduling that a session's processes ask for.
"""

from __future__ import annotations

import array
import gc
import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import proc

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import HUB_NAME
from manyhands.launch.run.processes import ONE_THREAD
from manyhands.launch.session import load_session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.kernel import realtime
from manyhands.nodes.kernel.bundle import REALTIME, EnvironmentBundle, save
from manyhands.nodes.wave_link.faces import wave_feedthrough
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import USUAL, decode, encode
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    Fault,
    LinkHello,
    Message,
    NodeHello,
    Ready,
    Report,
    Role,
    Start,
    Stop,
    Tool,
    Welcome,
)
from manyhands.protocol.transport import Hub, Link
from manyhands.protocol.transport.zeromq import ZmqTransport

PATIENCE = from_seconds(20.0)  # for the environment's next word before and after the ticks
WAIT = from_seconds(0.1)  # for a reaction, before it is seen whether the couplings are at one tick
AMPLITUDE, FREQUENCY = 1e-3, 2.0  # m and Hz, of every tool
_PREPARED_TICKS = 500  # a period of that, at 1 kHz
_TICK = struct.Struct(">Q")
_AGAIN = from_seconds(0.003)  # as a coupling at 1 kHz, which then sends its p(k) once more
_TICK_AT = 3  # bytes into a signal's usual head
_LEAD = from_seconds(0.2)  # from saying when it starts to the first tick


class Broken(Exception):
    """The environment did not do its part; the text has its messages."""


@dataclass(frozen=True)
class Point:
    """How one number of users went.

    Attributes:
        users: how many.
        ticks: how many have passed.
        late: share of them in which the last reaction came after the next tick was due, or not at all.
        round_trip_us: p50, p99, p999 and max, us, from before the first p(k) was sent to after the last f_v(k) came.
        environment_cpu: processors that the environment used.
        generator_cpu: processors that this process used.
        resident: the environment's memory at the end, MiB.
    """

    users: int
    ticks: int
    late: float
    round_trip_us: dict[str, float]
    environment_cpu: float
    generator_cpu: float
    resident: float


def session_text(users: int, coupling: str = "") -> str:
    """Example 1's world with so many users: each one's tool tied to the hub; ``coupling`` is added to each coupling."""
    lines = ["session: users", "period: 0.001", "devices:"]
    lines += [f"  d{i}: {{dof: 1, osp: 1.37, driver: simulated, mass: 0.2}}" for i in range(users)]
    lines += ["couplings:", *(f"  c{i}: {{devices: [d{i}]{coupling}}}" for i in range(users))]
    lines += ["environment:", "  type: network", "  masses: {hub: 3.0}", "  links:"]
    lines += [f"    - {{between: [d{i}, hub], stiffness: 3500, damping: 0.2}}" for i in range(users)]
    lines += ["    - {between: [hub, ground], stiffness: 2600, damping: 0.5}"]
    lines += ["design: {coupling: spring-damper, objective: feasible}"]
    return "\n".join(lines) + "\n"


@dataclass
class Served:
    """An environment's process that ticks, with this process as its supervisor and all its couplings.

    Attributes:
        bundle: the environment's.
        links: to it, by coupling.
        hub: its messages to the supervisor.
        clock: this process's.
        epoch: when the first tick is.
        period: T, ns.
        pid: its process.
        finish: end the ticks, and return the environment's report.
    """

    bundle: EnvironmentBundle
    links: list[Link]
    hub: Hub
    clock: RealtimeClock
    epoch: Instant
    period: Duration
    pid: int
    finish: Callable[[], Report]


@contextmanager
def serving(text: str, beside: Callable[[int], None] | None = None, package: Path | None = None) -> Iterator[Served]:
    """Start the environment of a session, and be everybody else.

    Args:
        text: the session's file.
        beside: called with the environment's process id right before the ticks begin; for a profiler.
        package: where the environment's own package is, for instance a compiled one; None for this process's.

    Raises:
        Broken: the environment ended, or sent an unexpected message.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "session.yaml").write_text(text)
        prepared = prepare(load_session(folder / "session.yaml"))
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, processors[:-1] or processors)  # before there are threads
        transport = ZmqTransport.ipc(folder)
        try:
            hub, endpoint = transport.bind_hub(HUB_NAME, (ENVIRONMENT,))
            bundle = cut(prepared, RunPlan(REALTIME, folder, endpoint))[ENVIRONMENT]
            if not isinstance(bundle, EnvironmentBundle):
                raise TypeError(f"found {type(bundle).__name__}; expected the environment's bundle")
            save(bundle, folder / "environment.bundle")
            with (
                _environment(folder, processors[-1], package) as process,
                _listening(hub, process.pid, folder) as hear,
            ):
                hello = hear(NodeHello)
                _say(hub, Welcome())
                _say(hub, Connect({}))
                links = _shake_hands(prepared, bundle, transport, hello)
                hear(Ready)
                if beside is not None:
                    beside(process.pid)
                clock = RealtimeClock()
                epoch = Instant(clock.now() + _LEAD)
                _say(hub, Start(epoch, 0))

                def finish() -> Report:
                    process.send_signal(signal.SIGTERM)
                    report = hear(Report)
                    if not isinstance(report, Report):
                        raise TypeError(f"found {type(report).__name__}; expected a report")
                    _say(hub, Stop("reported"))
                    process.wait()
                    return report

                period = from_seconds(prepared.session.period)
                yield Served(bundle, links, hub, clock, epoch, period, process.pid, finish)
        finally:
            transport.close()
            os.sched_setaffinity(0, processors)


@contextmanager
def scheduled(links: int) -> Iterator[None]:
    """Run as couplings do where that is permitted; with many links as the environment does, to play so many."""
    granted = realtime.prepare(realtime.RealtimeWishes(memory=False, links=links))
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
        realtime.restore(granted)


def measure(users: int, seconds: float, beside: Callable[[int], None] | None = None) -> Point:
    """Serve ``users`` for ``seconds``.

    Args:
        users: how many couplings, of one port each.
        seconds: how long.
        beside: called with the environment's process id right before the ticks begin; for a profiler.

    Raises:
        Broken: the environment ended, or sent an unexpected message.
    """
    with serving(session_text(users), beside) as served:
        load = _Load(served.links, served.period)
        used, own, began = proc.cpu_seconds([served.pid]), time.process_time(), time.monotonic()
        with scheduled(users):
            load.run(served.epoch, round(seconds * 1e9 / served.period), served.clock, served.hub)
        lasted = time.monotonic() - began
        point = Point(
            users,
            load.ticks,
            load.late / load.ticks,
            load.percentiles(),
            (proc.cpu_seconds([served.pid]) - used) / lasted,
            (time.process_time() - own) / lasted,
            proc.resident(served.pid) or 0.0,
        )
        served.finish()
    return point


@contextmanager
def _environment(folder: Path, processor: int, package: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """The environment's process; killed if it has not ended by itself."""
    with (folder / "environment.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603 -- our own interpreter and module, no shell
            [sys.executable, "-P", "-m", "manyhands.nodes.environment",
             str(folder / "environment.bundle"), str(os.getpid())],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            env={**os.environ, **ONE_THREAD, **({} if package is None else {"PYTHONPATH": str(package)})},
        )  # fmt: skip
    try:
        os.sched_setaffinity(process.pid, {processor})  # before it has threads: they inherit it
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def _listening(hub: Hub, pid: int, folder: Path) -> Iterator[Callable[[type[Message]], Message]]:
    """A function that waits for a message of a kind, passing over telemetry."""
    ended = os.pidfd_open(pid)
    clock = RealtimeClock()

    def hear(kind: type[Message]) -> Message:
        deadline = clock.now() + PATIENCE
        while (remaining := deadline - clock.now()) > 0:
            if hub.wait(Duration(remaining), (ended,)):
                log = (folder / "environment.log").read_text()[-2000:]
                status = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
                raise Broken(f"the environment ended with {status and status.si_status}: {log}")
            while (received := hub.recv()) is not None:
                message = decode(received[1], MAX_CONTROL_BYTES)
                if isinstance(message, kind):
                    return message
                if isinstance(message, Fault):
                    raise Broken(f"the environment: {message.text}")
        raise Broken(f"the environment said nothing; expected {kind.__name__}")

    try:
        yield hear
    finally:
        os.close(ended)


def _say(hub: Hub, message: Message) -> None:
    if not hub.send(ENVIRONMENT, encode(message)):
        raise Broken("the environment has left")


def _shake_hands(prepared: Prepared, bundle: EnvironmentBundle, transport: ZmqTransport, hello: Message) -> list[Link]:
    """Be every coupling, in the order in which the environment shakes hands."""
    if not isinstance(hello, NodeHello):
        raise TypeError(f"found {type(hello).__name__}; expected a hello")
    blocks = dict(zip(prepared.session.couplings, prepared.blocks, strict=True))
    clock = RealtimeClock()
    links = []
    for peer in bundle.common.peers:
        wave = bundle.waves.get(peer.name)
        D_V = blocks[peer.name].D if wave is None else wave_feedthrough(wave.b, bundle.common.period)
        feedthrough = tuple(map(tuple, D_V.tolist()))
        own = LinkHello(
            PROTOCOL_VERSION, peer.certificate or bundle.common.certificate, bundle.common.session, peer.name,
            Role.COUPLING, peer.ports, feedthrough,
        )  # fmt: skip
        link = transport.connect(hello.endpoints[peer.name], ENVIRONMENT)
        handshake = LinkHandshake(own, Expected(ENVIRONMENT, Role.ENVIRONMENT, peer.ports), opens=True)
        shake_hands(link, handshake, clock, Instant(clock.now() + PATIENCE))
        links.append(link)
    return links


class _Load:
    """All couplings' ticks.

    Attributes:
        ticks: periods that have passed since the first.
        late: of these, those in which not all reactions came in time.
    """

    def __init__(self, links: list[Link], period: Duration) -> None:
        self._links, self._period = links, period
        self._round_trips = array.array("q")
        self.ticks = self.late = 0
        # of each tick one frame for each link, whose tick and stamp are written anew
        self._frames = [
            [
                encode(
                    Tool(0, 0, np.array([AMPLITUDE * math.sin(2 * math.pi * (k / _PREPARED_TICKS + i / len(links)))]))
                )
                for i in range(len(links))
            ]
            for k in range(_PREPARED_TICKS)
        ]
        self._head = USUAL.unpack_from(self._frames[0][0])

    def run(self, epoch: Instant, ticks: int, clock: RealtimeClock, hub: Hub) -> None:
        """Do the ticks; the environment's messages to its supervisor are read and ignored meanwhile."""
        links, period, now = self._links, self._period, clock.now
        tick = 0
        while self.ticks < ticks:
            slot = self.ticks
            clock.sleep_until(Instant(epoch + slot * period))
            sent = now()
            start = self._start(tick, sent)
            for link, frame in zip(links, self._frames[slot % _PREPARED_TICKS], strict=True):
                link.send(start + frame[USUAL.size :])
            answers = [self._answer(link, tick) for link in links]
            if any(answer != tick for answer in answers):  # beyond it: that coupling was given up
                tick = self._go_on_apart(answers, tick, slot, clock)
            ended = now()
            self._round_trips.append(ended - sent)
            if ended > epoch + (slot + 1) * period:
                self.ticks = -((epoch - ended) // period)  # rounded up
                self.late += self.ticks - slot
            else:
                self.ticks = slot + 1
            tick += 1
            hub.recv()

    def _start(self, tick: int, stamp: int) -> bytes:
        """The head of a p(k)."""
        array_tag, number, tag, _, _, _, values_tag, length = self._head
        return USUAL.pack(array_tag, number, tag, tick, tag, stamp, values_tag, length)

    def _answer(self, link: Link, tick: int, wait: Duration = WAIT) -> int:
        """The tick of the next reaction that is of ``tick`` or beyond it; -1 for none in time."""
        while (answer := link.recv(wait)) is not None:
            (found,) = _TICK.unpack_from(answer, _TICK_AT)
            if found >= tick:
                return int(found)
        return -1

    def _go_on_apart(self, answered: list[int], tick: int, slot: int, clock: RealtimeClock) -> int:
        """Some coupling was given up: each goes on by itself, as couplings do, until all are at one tick again.

        Returns:
            The tick that all were answered.

        Raises:
            Broken: that takes longer than :data:`PATIENCE`.
        """
        said = [tick] * len(answered)
        deadline = clock.now() + PATIENCE
        while len(set(answered)) > 1 or answered != said:
            if clock.now() > deadline:
                raise Broken(f"the couplings are at the ticks {sorted(set(said))}; expected them together again")
            said = [max(told + 1, tick) for told, tick in zip(answered, said, strict=True)]
            for i, link in enumerate(self._links):
                link.send(self._start(said[i], clock.now()) + self._frames[slot % _PREPARED_TICKS][i][USUAL.size :])
            for i, link in enumerate(self._links):
                answered[i] = max(answered[i], self._answer(link, said[i], _AGAIN))
        return answered[0]

    def percentiles(self) -> dict[str, float]:
        """Of the round trips, us."""
        ordered = sorted(self._round_trips)
        parts = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
        return {name: ordered[max(0, math.ceil(part * len(ordered)) - 1)] / 1e3 for name, part in parts.items()}
