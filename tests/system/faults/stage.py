"""A session of two users with scripted faults, and the invariants that must hold whatever happened.

Real processes over real sockets. A step is taken when the supervisor reports the progress that the step waits for.
Nothing waits for time to pass, and a step that never comes fails the test.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import Reach, reach
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.outcome import Outcome, Progress
from manyhands.launch.run.states import NodeState, SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import from_seconds

from ...support.rows import rows_of

HERE: Final = Path(__file__).parent
NODES: Final = frozenset({"dx", "dy", "cx", "cy", "environment"})
PORTS: Final = ("dx", "dy")
DEADLINE: Final = 45.0  # s, for a whole run
LOOK: Final = from_seconds(0.05)  # between two looks at the progress
PROMISE: Final = -1e-12  # J: no ledger of an honest party falls further below its bound
STEP: Final = 2.0
"""Of the largest step that the simulation of such faults finds at a user: so large may a step of the force be.

The simulation is exact (:func:`require_as_simulated`), but cannot try a fault at every tick."""

AWAY: Final = 300  # ticks
COUPLING_OF: Final = {"dx": "cx", "dy": "cy"}

When = Callable[[Progress], bool]
Then = Callable[[Progress], object]
Step = tuple[When, Then]


@cache
def prepared(*overrides: str) -> Prepared:
    """The session, designed once."""
    return prepare(load_session(HERE / "pair.yaml", list(overrides)))


@cache
def simulated(ticks: int, *faults: Silence) -> NDArray[np.float64]:
    """The users' forces in the single-process simulation, N."""
    return Simulation(prepared()).run(ticks, faults=faults).f_v


@cache
def largest_steps() -> tuple[Mapping[str, float], Mapping[str, float]]:
    """The largest steps of a user's force, N: while the other user is away and returns; when that user itself returns.

    At several phases of the hands' motion, and for long enough that the free hand has moved far.
    """
    of_others, own = dict.fromkeys(PORTS, 0.0), dict.fromkeys(PORTS, 0.0)
    for away in PORTS:
        for begin in range(100, 900, 160):
            f = simulated(1300, Silence(COUPLING_OF[away], begin, begin + AWAY))
            for i, port in enumerate(PORTS):
                steps, rows = (own, f[begin + AWAY :, i]) if port == away else (of_others, f[:, i])
                steps[port] = max(steps[port], largest_step(rows))
    return of_others, own


def largest_step(f: NDArray[np.float64]) -> float:
    """The largest step of one force from a tick to the next, N; over a gap there is none."""
    return float(np.nanmax(np.abs(np.diff(f))))


@dataclass
class Script:
    """Steps in sequence; after the last one the session is interrupted.

    Attributes:
        steps: the condition of each, and its action.
        taken: the number of steps taken.
        late: whether the wait for the next step was in vain.
    """

    steps: Sequence[Step]
    taken: int = 0
    late: bool = False
    _since: float = field(default_factory=time.monotonic)
    _interrupted: bool = False

    def show(self, progress: Progress) -> None:
        """Take the supervisor's progress."""
        if self._interrupted or progress.phase in (SessionPhase.ENDING, SessionPhase.OVER):
            return
        if self.taken < len(self.steps):
            when, then = self.steps[self.taken]
            if when(progress):
                self.taken += 1
                then(progress)
            self.late = time.monotonic() > self._since + DEADLINE
        if self.taken == len(self.steps) or self.late:
            self._interrupted = True
            os.kill(os.getpid(), signal.SIGINT)


def play(
    *steps: Step, clock: str = "simulated", ways: Reach | None = None, of: Prepared | None = None, ticks: int = 0
) -> Outcome:
    """Run the session until every step is taken, and interrupt it.

    Args:
        steps: the condition of each, and its action.
        clock: "realtime" or "simulated".
        ways: how the processes reach each other; over ipc by default.
        of: another session than that of two users.
        ticks: number of ticks; 0 runs until all steps are taken.
    """
    session = of or prepared()
    script = Script(steps)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(supervisor_module, "REFRESH", LOOK)
        outcome = Supervisor(
            session,
            clock=clock,
            reach=ways or reach(session, "ipc"),
            ticks=ticks,
            record=True,
            show=script.show,
        ).run()
    assert not script.late, f"step {script.taken} never came: {outcome}"
    assert script.taken == len(steps), f"it was over before step {script.taken}: {outcome}"
    return outcome


def nothing(_progress: Progress) -> None:
    """The action of a step that only waits."""


def at(tick: int) -> When:
    """A condition: all nodes take part and have sent telemetry of ``tick``."""

    def when(progress: Progress) -> bool:
        told = progress.telemetry
        return (
            progress.phase is SessionPhase.RUNNING
            and all(state == NodeState.RUNNING.value for state in progress.states.values())
            and told.keys() == progress.states.keys()
            and all(one.tick >= tick for one in told.values())
            and told["environment"].figures[names.FROZEN] == 0
        )

    return when


def all_on(ticks: int) -> When:
    """A condition: all nodes take part, and have done so for ``ticks``."""
    last: list[int] = []

    def when(progress: Progress) -> bool:
        if not at(0)(progress):
            last.clear()
            return False
        if not last:
            last.append(max(told.tick for told in progress.telemetry.values()))
        return at(last[0] + ticks)(progress)

    return when


def back(*victims: str) -> When:
    """A condition: ``victims`` are back, and all nodes take part again."""
    whole = all_on(150)

    def when(progress: Progress) -> bool:
        returned = all(any(told.endswith(f"{victim} is back") for told in progress.incidents) for victim in victims)
        return returned and whole(progress)

    return when


def told_of(tick: int) -> When:
    """A condition: all nodes have sent telemetry of ``tick``; in real time a busy machine may freeze some meanwhile."""

    def when(progress: Progress) -> bool:
        told = progress.telemetry
        return told.keys() == NODES and all(one.tick >= tick for one in told.values())

    return when


def returned(*victims: str, ticks: int = 100) -> When:
    """A condition: ``victims`` have sent telemetry of a tick ``ticks`` after the session's at the first check."""
    since: list[int] = []

    def when(progress: Progress) -> bool:
        told = progress.telemetry
        since[:] = since or [max(one.tick for one in told.values())]
        return all(victim in told and told[victim].tick >= since[0] + ticks for victim in victims)

    return when


def gone_on(without: Collection[str], ticks: int) -> When:
    """A condition: the others have gone on for ``ticks`` since ``without`` fell silent, with a frozen coupling."""
    since: dict[str, int] = {}

    def when(progress: Progress) -> bool:
        told = {name: one.tick for name, one in progress.telemetry.items() if name not in without}
        world = progress.telemetry.get("environment")
        if world is None or world.figures[names.FROZEN] < 1 or not progress.silent.issuperset(without):
            return False
        for name, tick in told.items():
            since.setdefault(name, tick)
        return all(tick >= since[name] + ticks for name, tick in told.items())

    return when


def send(which: signal.Signals, *victims: str) -> Then:
    """Send a signal to nodes' processes, all at once."""

    def then(progress: Progress) -> None:
        for victim in victims:
            os.kill(progress.pids[victim], which)

    return then


def nodes_of(outcome: Outcome) -> Mapping[str, Any]:
    """Each node's part of the report."""
    found: Mapping[str, Any] = outcome.report["nodes"]
    return found


def require_sound(outcome: Outcome, code: int = 130) -> None:
    """Check that the run has no fault, a report of every node, and every promise kept."""
    assert (outcome.code, outcome.faults) == (code, ())
    nodes = nodes_of(outcome)
    assert nodes.keys() == NODES
    for name, node in nodes.items():
        assert node["ledger"]["margin"] >= PROMISE, f"{name}: {node}"


def require_calm(outcome: Outcome, other: str) -> None:
    """Check that an unharmed user missed no tick up to the interrupt, and that its force made no large step."""
    _, f = rows_of(recording_of(outcome), other)
    allowed = STEP * largest_steps()[0][other]
    assert 0.0 < largest_step(f) <= allowed, f"{other}: found a step of {largest_step(f)} N; expected at most {allowed}"


def require_as_simulated(outcome: Outcome, victim: str, other: str) -> None:
    """Until ``victim`` is back, the force of ``other`` equals a session with a frozen user, to the last bit."""
    f = recording_of(outcome).f_v
    away = np.isnan(f[:, PORTS.index(victim)])
    (gap,) = np.nonzero(away[:-1] & ~away[1:])
    until = int(gap[-1])
    found = f[:until, PORTS.index(other)]
    (differs,) = np.nonzero(found != simulated(until)[:, PORTS.index(other)])
    frozen = int(differs[0])
    assert frozen < until
    expected = simulated(until, Silence(COUPLING_OF[victim], frozen))[:, PORTS.index(other)]
    assert found.tobytes() == expected.tobytes()


def require_eased_in(outcome: Outcome, victim: str) -> None:
    """Check that a returned user felt no force at first, and then a force that grew from zero."""
    f = recording_of(outcome).f_v[:, PORTS.index(victim)]
    (gaps,) = np.nonzero(np.isnan(f[:-1]) & ~np.isnan(f[1:]))
    assert len(gaps) > 0, f"{victim} was never away"
    for gap in gaps:
        assert f[gap + 1] == 0.0
    assert largest_step(f[gaps[-1] + 1 :]) <= STEP * largest_steps()[1][victim]


def recording_of(outcome: Outcome) -> Recording:
    """The recording of the run."""
    assert outcome.recording is not None
    return outcome.recording
