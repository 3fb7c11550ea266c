"""A process that has no turn for half a second to a minute, while honest peers repeat their signals.

Whole sessions in virtual time under the realtime clock. The links hold all that is sent meanwhile, as ZeroMQ's queues
and the kernel's buffers together may.
"""

from __future__ import annotations

import pytest

from manyhands.launch.run.states import SessionPhase

from . import wires
from .campaign import prepared
from .world import SimulatedSession

AWAKE = 60  # ticks in which everybody takes part before the sleep, and again after it
S = 1_000_000_000  # ns


def slept(session: str, sleeper: str, duration: int, seed: int = 1) -> SimulatedSession:
    """A session of which one process sleeps for ``duration``, ns, after some ticks; it ends some ticks later."""
    world = SimulatedSession(prepared(session), "realtime", seed)
    stops = [AWAKE]
    awake_from: list[int] = []

    def watch() -> bool:
        conductor = world.conductor
        if conductor.phase is SessionPhase.OVER:
            return not world.processes
        if conductor.phase is not SessionPhase.RUNNING or not world.whole:
            return bool(conductor.faults)
        if stops and world.tick >= stops[0]:
            stops.clear()
            world.stop(sleeper, duration)
            awake_from.append(world.scheduler.now + duration)
        elif awake_from and world.scheduler.now > awake_from[0]:
            if len(awake_from) == 1:
                awake_from.append(world.tick + AWAKE)
            elif world.tick >= awake_from[1]:
                awake_from.append(-1)
                world.interrupt()
        return False

    world.scheduler.watch = watch
    world.scheduler.run()
    assert world.scheduler.join() == []
    assert awake_from[2:], f"it never went on: {world.conductor.faults}"
    return world


@pytest.mark.long
@pytest.mark.parametrize("seconds", [0.5, 5.0, 60.0])
@pytest.mark.parametrize("sleeper", ["environment", "c", "d"])
def test_who_slept_blames_nobody(monkeypatch: pytest.MonkeyPatch, sleeper: str, seconds: float) -> None:
    monkeypatch.setattr(wires, "LINK_QUEUE_FRAMES", 10**9)
    world = slept("alone", sleeper, int(seconds * S))
    assert world.violations == []
    assert world.conductor.faults == []
