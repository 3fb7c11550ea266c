"""What the measured delays mean: the stiffness that can be certified with them, and what would reduce them.

The delay tau inside a tick, from sample to force, reduces the stiffness that can be certified
(:mod:`manyhands.design.budget`). A certificate covers delays up to a longest one. A design should therefore take p99.9,
and the runtime watches for the rest. The median shows what the machine would allow without its slowest ticks.
"""

from __future__ import annotations

import os
import pwd
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from manyhands.design.budget import certified_limit, environment_share
from manyhands.design.problem import HapticLoop
from manyhands.launch.doctor.machine import Machine
from manyhands.launch.doctor.probe import Measured, Ticking
from manyhands.launch.doctor.profile import NOTHING, Stated
from manyhands.launch.doctor.wakeup import Spread
from manyhands.nodes.kernel.realtime import FIFO_PRIORITY, NETWORK_NICE
from manyhands.nodes.kernel.words import counted

QUANTILES = ("p50", "p999")
"""The percentiles of the delay for which a stiffness is computed."""

_STEADY = ("tsc", "arch_sys_counter")  # clock sources that can be read without a system call


@dataclass(frozen=True, eq=False)
class Worth:
    """The stiffness that can be certified for a loop's devices.

    Attributes:
        loop: the loop.
        share: the share of the devices' levels that the environment takes, at the loop's period.
        stated: what the session states of its delays beside its ticks.
    """

    loop: HapticLoop
    share: float
    stated: Stated = NOTHING

    @classmethod
    def of(cls, loop: HapticLoop, stated: Stated = NOTHING) -> Worth:
        """The loop with its environment's share.

        Raises:
            SolverFailure: the search for the share did not converge.
        """
        share = environment_share(loop.environment, loop.Delta_D_at(loop.period, loop.tau), loop.period)
        return cls(loop, share, stated)

    def at(self, period: float) -> Worth | None:
        """The same at another period, s; None for an environment that is given in discrete time, at its own alone."""
        if period == self.loop.period:
            return self
        if not self.loop.environment.at_any_period:
            return None
        return Worth.of(replace(self.loop, period=period, tau=0.0), self.stated)

    def stiffness(self, tau: float, period_tolerance: float | None = None) -> dict[str, float]:
        """The supremum of the certified stiffness by device, N/m; 0 where the delay (s) permits none.

        Args:
            tau: the longest delay, s.
            period_tolerance: rho; by default the loop's.
        """
        loop = self.loop
        if tau > loop.period:
            return {device.name: 0.0 for device in loop.devices}
        return {
            device.name: certified_limit(loop, device, loop.period, tau, self.share, period_tolerance).certified
            for device in loop.devices
        }

    def of_tick(self, microseconds: float) -> dict[str, float]:
        """The stiffness by device, N/m, where a tick takes so long on this machine, beside what its devices state."""
        return self.stiffness(self.stated.latency + microseconds * 1e-6)

    def weakest_of_tick(self, microseconds: float) -> float:
        """The smallest value of :meth:`of_tick`, N/m."""
        return min(self.of_tick(microseconds).values())

    @property
    def no_delay(self) -> float:
        """The weakest device's without any delay, in periods that are never too long, N/m."""
        return self.weakest(0.0, 0.0)

    def weakest(self, tau: float, period_tolerance: float | None = None) -> float:
        """The smallest value of :meth:`stiffness`, N/m."""
        return min(self.stiffness(tau, period_tolerance).values())


@dataclass(frozen=True)
class Advice:
    """A change to the machine or the session, and its benefit.

    Attributes:
        change: the change.
        buys: what it was measured to give; or the most that it can, where a measurement cannot try it here.
        tried: whether it was measured.
    """

    change: str
    buys: str
    tried: bool = False


def stiffness_object(worth: Worth, ticking: tuple[Ticking, ...]) -> dict[str, Any]:
    """The object that ``--json`` prints: stiffness in N/m by device, without a delay and by way and quantile."""
    limit = worth.stiffness(0.0, 0.0)
    by_way = {t.way.key: {q: worth.of_tick(getattr(t.tau, q)) for q in QUANTILES} for t in ticking}
    return {
        device: {"no_delay": limit[device]}
        | {way: {q: found[q][device] for q in QUANTILES} for way, found in by_way.items()}
        for device in limit
    }


def advice(machine: Machine, measured: Measured, worth: Worth, chains: int) -> tuple[Advice, ...]:
    """What a measurement cannot try, because it needs other rights or another machine; the most useful first.

    Args:
        machine: the machine's properties.
        measured: what the probe measured.
        worth: the loop, from which the benefit of a change is computed.
        chains: number of users' chains in the session: devices with their couplings.
    """
    best = min(measured.ticking, key=lambda t: t.tau.p999)
    found = _rights(machine, measured, best, worth)
    tail = _tail(best.tau, worth)
    usable = len(machine.usable)
    if usable < chains + 1:
        found.append(
            Advice(
                f"give it more processors: {usable} usable, {counted(chains, 'user')} and an environment "
                f"need {chains + 1}",
                f"a separate processor for each chain; {tail}",
            )
        )
    if machine.virtual is not None:
        found.append(Advice(f"run on a machine of its own: this one is virtual ({machine.virtual})", tail))
    if machine.preemption != "PREEMPT_RT":
        found.append(Advice(f"boot a PREEMPT_RT kernel: this one is {machine.preemption}", tail))
    if machine.governors is not None and set(machine.governors) != {"performance"}:
        found.append(Advice(f"set the frequency governor to performance: found {', '.join(machine.governors)}", tail))
    if machine.clock_source is not None and machine.clock_source not in _STEADY:
        found.append(
            Advice(
                f"boot with the clock source tsc: found {machine.clock_source}", "clock readings without system calls"
            )
        )
    if not machine.compiled:
        found.append(
            Advice(
                "pip install . in its sources, without -e, where there is a C compiler: its tick is pure Python here",
                "a compiled tick, whose delays were a quarter shorter where they were compared; the same numbers",
            )
        )
    if not machine.curve:
        found.append(Advice("install a libzmq with CURVE", "sessions over tcp, which are refused without encryption"))
    return tuple(found)


def _tail(tau: Spread, worth: Worth) -> str:
    """The most that removing the slowest ticks can gain in stiffness, as a text."""
    now, even = (worth.weakest_of_tick(getattr(tau, q)) for q in reversed(QUANTILES))
    return f"at most {now:.0f} -> {even:.0f} {worth.loop.units()('N/m')}, were every tick like the median one"


def _right(machine: Machine, item: str, value: str, of_a_container: str) -> str:
    """How an administrator raises a limit for the user of this process."""
    if machine.container:
        return f"start this container with --ulimit {of_a_container}"
    return f"write '{user()} - {item} {value}' into /etc/security/limits.d/manyhands.conf, then log in again"


def user() -> str:
    """The name of this process's user, or its number with the form that limits.conf takes."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"{os.getuid()}:{os.getuid()}"  # a range of user ids


def _rights(machine: Machine, measured: Measured, best: Ticking, worth: Worth) -> list[Advice]:
    """Advice for each right that the kernel refused: the setting with which an administrator grants it."""
    found = []
    grants, tail = measured.waking.granted, _tail(best.tau, worth)
    if not grants["fifo"].granted:
        ulimits = f"rtprio={FIFO_PRIORITY} --ulimit nice={20 - NETWORK_NICE}"
        change = _right(machine, "rtprio", str(FIFO_PRIORITY), ulimits)
        found.append(
            Advice(
                f"permit SCHED_FIFO: {change} ({grants['fifo'].answer})",
                f"ticks that other programs do not delay; {tail}",
            )
        )
    if not grants["memory_locked"].granted:
        change = f"permit locked memory: {_right(machine, 'memlock', 'unlimited', 'memlock=-1')}"
        found.append(Advice(f"{change} ({grants['memory_locked'].answer})", "no tick waits for a page from disk"))
    if not grants["timer_slack"].granted:
        late: Mapping[str, Spread] = measured.waking.late
        found.append(
            Advice(
                f"permit setting the timer slack: prctl(PR_SET_TIMERSLACK) is refused ({grants['timer_slack'].answer})",
                f"wake-ups up to 50 us earlier; they are {late['default_slack'].p50:.0f} us late (median)",
            )
        )
    return found
