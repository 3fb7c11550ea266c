"""What the compiled tick is worth on this machine, beside the same modules in pure Python.

A wheel has the source of every module beside what was compiled from it (docs/decisions/0032-a-compiled-tick.md). In a
folder of links to the sources alone, the same program runs in pure Python. The two take turns within one measurement,
so that other load on the machine meets both.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Final

import manyhands
from manyhands.launch.doctor.probe import Ticking, Way, at_rest, measure_ticks, ticks_in
from manyhands.launch.doctor.profile import ProbeInterrupted
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.run.directory import run_directory
from manyhands.launch.run.processes import Interrupt

TURNS: Final = 3
"""How often each of the two is measured."""

_PATH: Final = "PYTHONPATH"


@dataclass(frozen=True)
class CompiledWorth:
    """The ticks of both, by turns.

    Attributes:
        compiled: those of the compiled tick, one for each turn.
        pure: those in pure Python.
    """

    compiled: tuple[Ticking, ...]
    pure: tuple[Ticking, ...]

    @property
    def medians(self) -> tuple[float, float]:
        """The median delay of a tick, compiled and pure, us: of each the mean over the turns."""
        return _mean(self.compiled), _mean(self.pure)

    @property
    def ratio(self) -> float:
        """The compiled median over the pure one."""
        compiled, pure = self.medians
        return compiled / pure

    @property
    def spread(self) -> tuple[float, float]:
        """The least and the greatest ratio of one turn."""
        ratios = [one.tau.p50 / other.tau.p50 for one, other in zip(self.compiled, self.pure, strict=True)]
        return min(ratios), max(ratios)


def _mean(turns: Sequence[Ticking]) -> float:
    return sum(one.tau.p50 for one in turns) / len(turns)


def measure_worth(plan: Plan, seconds: float) -> CompiledWorth:
    """Measure the ticks of a session at rest by turns, as `manyhands launch` would run it.

    Args:
        plan: the session.
        seconds: how long to measure in all, s; the start of the processes takes additional time.

    Raises:
        ProbeInterrupted, ProbeFailed: as :func:`.measure_ticks`.
    """
    rested, way = unproved(at_rest(plan.session)), Way.of_run(plan)
    return by_turns(lambda: measure_ticks(rested, way, ticks_in(seconds / (2 * TURNS), plan.session.period)))


def by_turns(measure: Callable[[], Ticking]) -> CompiledWorth:
    """Measure both by turns.

    Args:
        measure: measures once, in processes that get the environment of this one.

    Raises:
        ProbeInterrupted: on Ctrl-C.
    """
    compiled, pure = [], []
    with Interrupt() as interrupt:
        for _ in range(TURNS):
            if interrupt.signal is not None:
                raise ProbeInterrupted(interrupt.signal)
            compiled.append(measure())
            with pure_python():
                pure.append(measure())
    return CompiledWorth(tuple(compiled), tuple(pure))


@contextmanager
def pure_python() -> Iterator[Path]:
    """While entered, processes that this one starts run the package's sources; yields the folder they are linked in."""
    before = os.environ.get(_PATH)
    with run_directory() as folder:  # which the next run removes, should this process be killed
        _link(Path(manyhands.__file__).parent, folder / manyhands.__name__)
        os.environ[_PATH] = str(folder) if before is None else f"{folder}{os.pathsep}{before}"
        try:
            yield folder
        finally:
            if before is None:
                del os.environ[_PATH]
            else:
                os.environ[_PATH] = before


def _link(package: Path, target: Path) -> None:
    """A folder of links to all files of a package but its extensions; what Python has compiled of sources as well."""
    target.mkdir()
    for entry in package.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            _link(entry, target / entry.name)
        elif not entry.name.endswith(tuple(EXTENSION_SUFFIXES)):
            (target / entry.name).symlink_to(entry)
