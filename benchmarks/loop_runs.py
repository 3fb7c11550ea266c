"""A run of the chain with any middleware: its result, and the treatment of its processes."""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterable
from dataclasses import dataclass

import proc


class Failed(Exception):
    """A run did not come to its end; the text gives the reason."""


@dataclass
class Run:
    """How one run went.

    Attributes:
        tau_us: of each device, p50, p99, p999, max, us.
        ticks: of the device that did fewest.
        late: share of the planned ticks whose force was not there before the next tick was due, or never.
        processes: how many, whatever started them.
        cpu: processors used, all processes together.
        resident: MiB at the end of those that could be looked at, together.
        told: the description of the middleware.
    """

    tau_us: dict[str, dict[str, float]]
    ticks: int
    late: float
    processes: int
    cpu: float
    resident: float
    told: str = ""

    @property
    def median(self) -> float:
        """The median tau of the middle device, us."""
        return statistics.median(of["p50"] for of in self.tau_us.values())

    def worst(self, percentile: str) -> float:
        """A percentile of tau at the device where it is greatest, us."""
        return max(of[percentile] for of in self.tau_us.values())


def share_late(planned: int, done: Iterable[tuple[int, int]]) -> float:
    """Of ``planned`` ticks at each device, what was not done in time, from (ticks, late) of each."""
    each = list(done)
    return 1.0 - sum(ticks - late for ticks, late in each) / (planned * len(each))


@dataclass
class Treatment:
    """What a process is granted, read from a running one: processors, scheduling policy and priority.

    Attributes:
        main: of its main thread.
        others: of its other threads; None if it has none.
    """

    main: tuple[frozenset[int], int, int]
    others: tuple[frozenset[int], int, int] | None

    @classmethod
    def of(cls, pid: int) -> Treatment:
        """That of a running process.

        Raises:
            ProcessLookupError: it has ended.
        """

        def granted(thread: int) -> tuple[frozenset[int], int, int]:
            priority = os.sched_getparam(thread).sched_priority
            return (
                frozenset(os.sched_getaffinity(thread)),
                os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK,
                priority,
            )

        threads = [granted(thread) for thread in proc.threads(pid)]
        if not threads:
            raise ProcessLookupError(f"process {pid} has ended")
        return cls(threads[0], threads[1] if len(threads) > 1 else None)

    def give(self, pid: int) -> None:
        """Treat another process likewise, with the threads that it has now."""
        for thread in proc.threads(pid):
            cpus, policy, priority = self.main if thread == pid or self.others is None else self.others
            os.sched_setaffinity(thread, cpus)
            if policy != os.sched_getscheduler(thread):
                os.sched_setscheduler(thread, policy, os.sched_param(priority))

    def __str__(self) -> str:
        names = {os.SCHED_OTHER: "ordinary", os.SCHED_FIFO: "FIFO", os.SCHED_RR: "RR"}
        cpus, policy, priority = self.main
        return f"processors {sorted(cpus)}, {names.get(policy, policy)}{f' {priority}' if priority else ''}"
