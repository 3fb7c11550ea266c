"""Users whose samples come late, within the environment's timeouts, and the effect on the others.

Whole sessions in virtual time under the realtime clock, with the product's conductor and its judgement of delays.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest
from chaos_kinds import FOLDER, RESTLESS

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.run import breaches
from manyhands.launch.run.breaches import Cause
from manyhands.launch.session import load_session
from manyhands.nodes.environment.late_arrivals import BURST, SHARE
from manyhands.nodes.rows import figures as names

from .late import Delay, LateSession

TELEMETRY = 100  # ticks
SETTLED = 2 * TELEMETRY
"""A guest that is late in every other tick at least is frozen by then, and back a few times."""


@cache
def prepared() -> Prepared:
    """Three users, certified for 0.3 ms, with a ladder for 0.5 and 1 ms."""
    return prepare(load_session(FOLDER.parent / "launch" / "sessions" / "example1-delayed.yaml", RESTLESS))


def uncovered(session: LateSession, device: str, begin: int) -> float:
    """Share of the ticks from ``begin`` on whose force came later than the certificate covers."""
    taus = session.taus(device)[begin:]
    return float(np.mean(taus[~np.isnan(taus)] > prepared().ladder.taus[0] * 1e6))  # type: ignore[union-attr]


def named(session: LateSession) -> set[str]:
    """The couplings that the notice names for the waits of others."""
    text = session.assumptions.notices.get(Cause.WAITS, "")
    assert all(coupling in text for coupling in session.assumptions.waited_for)
    return set(session.assumptions.waited_for)


def softened(session: LateSession) -> set[str]:
    return {shift.coupling for shift in session.shifts if shift.rung > 0}


def sound(session: LateSession) -> LateSession:
    assert session.violations == []
    assert session.conductor.faults == []
    return session


@pytest.mark.parametrize(
    "delays",
    [
        {"dx": lambda _: 2.2},  # which is read first, at the beginning
        {"dz": lambda _: 0.7},
        {"dx": lambda tick: 0.7 * (tick % 2)},
        {"dy": lambda tick: 2.2 * (tick % 2), "dz": lambda tick: 2.2 * (1 - tick % 2)},
    ],
    ids=["always", "a little", "every other tick", "two in turns"],
)
def test_guests_late_within_the_timeout_are_held_and_others_stay_certified(delays: dict[str, Delay]) -> None:
    session = sound(LateSession(prepared(), 600, delays))
    guests = {f"c{device[1:]}" for device in delays}
    for device in {"dx", "dy", "dz"} - delays.keys():
        assert uncovered(session, device, SETTLED) <= (len(guests) + 1) * SHARE
        assert session.lateness(f"c{device[1:]}") is None
    for guest in guests:
        lateness = session.lateness(guest)
        assert lateness is not None
        assert BURST < lateness.ticks < BURST + 20
        assert lateness.frozen == 0
        assert lateness.held > 100
        assert lateness.waived > 0
    assert named(session) == guests
    assert softened(session) <= guests


@pytest.mark.parametrize("delay", [lambda _: 0.0, lambda tick: 0.8 * (tick % 2)], ids=["always", "and late in turns"])
def test_who_samples_before_a_tick_is_due_makes_nobody_late(delay: Delay) -> None:
    session = sound(LateSession(prepared(), 300, {"dz": delay}, early={"dz"}))
    assert session.lateness("cx") is None
    assert session.lateness("cy") is None
    assert softened(session) <= {"cz"}
    assert session.conductor.reports["environment"].figures[names.ABSENCES] == 0


def test_what_it_cost_is_what_the_others_waited() -> None:
    session = sound(LateSession(prepared(), 300, {"dz": lambda _: 2.2}))
    lateness = session.lateness("cz")
    assert lateness is not None
    waited = np.nansum(session.taus("dx") - np.nanmedian(session.taus("dx")[SETTLED:]))
    assert lateness.time == pytest.approx(waited, rel=0.05)


@pytest.mark.parametrize(
    "delays",
    [
        {"dz": lambda tick: 2.2 * (200 <= tick < 240)},
        {"dz": lambda tick: 2.8 * (tick < 40)},
        dict.fromkeys(("dx", "dy", "dz"), lambda _: 1.3),
        {device: lambda tick, n=n: 2.0 * (tick % 7 == n) for n, device in enumerate(("dx", "dy", "dz"))},
    ],
    ids=["a burst", "a slow start", "all alike", "all in turns"],
)
def test_devices_late_briefly_or_like_all_others_are_not_frozen(delays: dict[str, Delay]) -> None:
    session = sound(LateSession(prepared(), 700, delays))
    assert session.conductor.reports["environment"].figures[names.ABSENCES] == 0
    assert named(session) == set()
    if len(delays) == 1:
        assert softened(session) == set()


def rungs(session: LateSession, coupling: str) -> Iterable[int]:
    """The rungs that the coupling was asked to run, in order."""
    return (shift.rung for shift in session.shifts if shift.coupling == coupling)


def test_a_coupling_climbs_again_when_the_cause_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(breaches, "CALM", 0.3)
    session = sound(LateSession(prepared(), 1400, dict.fromkeys(("dx", "dy", "dz"), lambda tick: 0.3 * (tick < 350))))
    for device in ("dx", "dy", "dz"):  # 0.3 ms and what is its own: more than rung 0 covers, less than rung 1
        assert list(rungs(session, f"c{device[1:]}")) == [1, 0]
        assert session.conductor.reports[device].figures[names.RUNG] == 0
        assert uncovered(session, device, 1200) == 0.0
    assert named(session) == set()
