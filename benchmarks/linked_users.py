"""The number of users behind wave links that one environment's process serves at 1 kHz, and what each of them costs.

    python benchmarks/linked_users.py [--users 1 4 16 ...] [--interval 1 4] [--compiled] [--json FILE] [--plot FILE]
                                      [--markdown FILE]

The environment is the real process with its real bundle, at a world rate of 1 kHz by its own clock. One other process
plays all the users' ends, with real handshakes and real waves: 64 devices with their couplings would not fit two
processors. Each user joins at rest; then its tool moves by 1 mm, and its waves carry the energy that they cost. The
environment's own count says which ticks were late: they had not ended when the next was due, or were never done. A
number of users holds while at most 1 % are. Cost is the environment's processor time, of its loop and of ZeroMQ's
thread.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import proc
from loop_ours import COMPILED
from users_load import Broken, Served, scheduled, serving, session_text

from manyhands.nodes import telemetry as names
from manyhands.nodes.supervisor_line import NOT_AT_ALL
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import WaveWriter, decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Telemetry

NUMBERS = (1, 4, 8, 16, 32, 48, 64, 96, 128)
HOLDS = 0.01
TARGET = 64
IMPEDANCE = 20.0  # N*s/m
AMPLITUDE, FREQUENCY = 1e-3, 2.0  # m and Hz, of every tool
RESTING, STARTING = 1.5, 0.5  # s in which users rest while they join, and in which their motion then grows
SETTLING = RESTING + STARTING  # s before the counted ticks
AT_ONCE = 16  # waves that are read of one link at a time
MARK = "linked-users"


@dataclass(frozen=True)
class LinkedPoint:
    """How one number of linked users went.

    Attributes:
        users: how many.
        interval: ticks from one wave to the next, at both ends.
        compiled: whether the environment's tick is compiled.
        ticks: how many the environment has done.
        late: share of the ticks that had not ended when the next was due, or were never done.
        loop_us: processor time of the environment's loop, us a tick.
        zeromq_us: that of ZeroMQ's thread.
        waves: received by the users, a second in all.
        generator_cpu: processors that this process used.
        resident: the environment's memory at the end, MiB.
    """

    users: int
    interval: int
    compiled: bool
    ticks: int
    late: float
    loop_us: float
    zeromq_us: float
    waves: float
    generator_cpu: float
    resident: float


def measure(users: int, interval: int, seconds: float, compiled: bool) -> LinkedPoint:
    """Serve ``users`` for ``seconds`` with a wave in every ``interval`` ticks.

    Raises:
        Broken: the environment ended, or a link fell silent, so the load was not the one that was meant.
    """
    link = f", wave_link: {{b: {IMPEDANCE:g}{f', interval: {interval * 0.001:g}' if interval > 1 else ''}}}"
    with serving(session_text(users, link), package=COMPILED if compiled else None) as served:
        users_ = _Users(served, interval)
        with scheduled(users):
            users_.run(0, round(SETTLING * 1e9 / served.period))
            before, used = users_.telemetry(), _used(served.pid)
            own, began, heard = time.process_time(), time.monotonic(), users_.heard
            users_.run(users_.ticks, users_.ticks + round(seconds * 1e9 / served.period))
            lasted = time.monotonic() - began
            after = users_.telemetry()
            loop, zeromq = (now - then for now, then in zip(_used(served.pid), used, strict=True))
            own = time.process_time() - own
        heard = users_.heard - heard
        resident = proc.resident(served.pid) or 0.0
        served.finish()
    silences = sum(value for name, value in after.figures.items() if name.startswith(names.WAVE_SILENCES))
    if silences or after.figures[names.FROZEN]:
        raise Broken(f"found {silences:.0f} silences, {after.figures[names.FROZEN]:.0f} users out; expected none")
    periods = lasted * 1e9 / served.period
    ticks, late = after.tick - before.tick, after.figures[names.LATE] - before.figures[names.LATE]
    return LinkedPoint(
        users,
        interval,
        compiled,
        ticks,
        late / periods,
        1e6 * loop / periods,
        1e6 * zeromq / periods,
        heard / lasted,
        own / lasted,
        resident,
    )


def _used(pid: int) -> tuple[float, float]:
    """Processor time of the environment's loop and of its other threads, s."""
    times = [proc.thread_seconds(pid, thread) for thread in proc.threads(pid)]
    return times[0], sum(times[1:])


class _Users:
    """The users' ends of all wave links.

    Attributes:
        ticks: periods that have passed since the first.
        heard: waves that the environment has sent.
    """

    def __init__(self, served: Served, interval: int) -> None:
        self._served, self._interval = served, interval
        self._writer = WaveWriter(1)
        self._sums = math.sqrt(IMPEDANCE / 2.0)  # U of a tool without force, W^(1/2)*s/m
        self._shipped = [0.0] * len(served.links)
        self._before = [0.0] * len(served.links)
        self._latest = b""  # of the environment's messages
        self.ticks = self.heard = 0

    def telemetry(self) -> Telemetry:
        """The environment's latest.

        Raises:
            Broken: its latest message is none.
        """
        latest = decode(self._latest, MAX_CONTROL_BYTES)
        if not isinstance(latest, Telemetry):
            raise Broken(f"the environment sent {type(latest).__name__}; expected telemetry")
        return latest

    def run(self, first: int, last: int) -> None:
        """Do the ticks from ``first`` to ``last``, and read what the environment sends its supervisor."""
        served, interval = self._served, self._interval
        links, period, T = served.links, served.period, served.period / 1e9
        angle, part = 2.0 * math.pi * FREQUENCY * T, 2.0 * math.pi / len(links)
        tick = first
        while tick < last:
            served.clock.sleep_until(Instant(served.epoch + tick * period))
            grown = self._sums * AMPLITUDE * min(1.0, max(0.0, (tick * T - RESTING) / STARTING))
            for i, link in enumerate(links):
                if (tick - i) % interval == 0:
                    U = grown * math.sin(angle * tick + part * i)
                    moved = U - self._before[i]
                    self._before[i] = U
                    self._shipped[i] += moved * moved / (2.0 * T * interval)
                    link.send(self._writer.frame(tick + 1, (U,), self._shipped[i]))
            for link in links:
                for _ in range(AT_ONCE):
                    if link.recv(NOT_AT_ALL) is None:
                        break
                    self.heard += 1
            while (received := served.hub.recv()) is not None:
                self._latest = received[1]
            now = served.clock.now()
            tick = max(tick + 1, -((served.epoch - now) // period))  # a wave that this process is late for is lost
        self.ticks = tick


def curve(numbers: Sequence[int], interval: int, seconds: float, repeats: int, compiled: bool) -> list[LinkedPoint]:
    """The medians of every number of users, up to two in a row that do not hold."""
    points: list[LinkedPoint] = []
    for users in numbers:
        runs = []
        for _ in range(repeats):
            try:
                runs.append(measure(users, interval, seconds, compiled))
            except Broken as error:
                tell(f"{users} users: {error}")
                return points
        points.append(sorted(runs, key=lambda run: run.late)[len(runs) // 2])
        last = points[-1]
        tell(
            f"{users} users, a wave in {interval} ticks{', compiled' if compiled else ''}: late {last.late:.2%}, "
            f"loop {last.loop_us:.0f} us a tick ({last.loop_us / users:.1f} a user), ZeroMQ {last.zeromq_us:.0f}, "
            f"generator {last.generator_cpu:.2f} processors, {last.waves:.0f} waves a second"
        )
        if len(points) > 1 and all(point.late > HOLDS for point in points[-2:]):
            break
    return points


def tell(text: str) -> None:
    """Progress, beside the table on standard output."""
    print(text, file=sys.stderr, flush=True)
