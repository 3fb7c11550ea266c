"""`colocate: auto`: which form a machine gives a session, what is said of it, and that no certificate depends on it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from manyhands.launch.doctor import profile as profiles
from manyhands.launch.doctor.colocation import Where, choose, process_counts, settle_colocation
from manyhands.launch.doctor.probe import Way
from manyhands.launch.doctor.profile import Lateness, Profile, keep_profile
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare, unproved
from manyhands.launch.plan.sites import in_tick
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import SessionError
from manyhands.launch.session.shipped import load_named

HERE, MANY = Where.HERE, 64


def a_profile(p995: float, late: float = 0.0) -> Profile:
    """A profile whose p99.5 is this, us."""
    return Profile({}, Lateness(p995 / 2, p995, 2 * p995, 3 * p995), 1000.0, late, 2.0, 0.0)


def of_both(apart: float, together: float, late: tuple[float, float] = (0.0, 0.0)) -> dict[bool, Profile]:
    return {False: a_profile(apart, late[0]), True: a_profile(together, late[1])}


# --- the rule


def test_a_session_that_says_nothing_leaves_it_to_the_machine() -> None:
    session = load_named("example1")
    assert session.colocate == "auto"
    assert session == load_named("example1", ["colocate=auto"])
    assert session.to_dict().get("colocate") is None
    assert "expected auto, true or false" in refusal("colocate=yes please")
    assert "expected auto, true or false" in refusal("colocate=1")


def refusal(override: str) -> str:
    with pytest.raises(SessionError) as caught:
        load_named("example1", [override])
    return str(caught.value)


def test_what_nobody_has_settled_has_a_process_for_each_coupling() -> None:
    session = load_named("example1")
    assert topology(session) == topology(load_named("example1", ["colocate=false"]))
    assert len(topology(session.with_colocation(True)).carriers) == 3
    assert topology(session.with_colocation(True).with_colocation(False)).carriers == {}  # a copy keeps no carriers


@pytest.mark.parametrize(
    ("name", "processors", "colocate"),
    [
        ("example1", 1, True),
        ("example1", 6, True),
        ("example1", 7, False),  # three devices, three couplings and the environment
        ("example1", MANY, False),
        ("example1-operator", 4, True),  # one device with three couplings
        ("example1-operator", 5, False),
        ("example1-centralised", 1, False),  # no device may run a coupling of several
    ],
)
def test_processes_are_counted_against_processors(name: str, processors: int, colocate: bool) -> None:
    assert choose(load_named(name), HERE, processors).colocate is colocate


@pytest.mark.parametrize("where", Where)
@pytest.mark.parametrize("processors", [1, MANY])
@pytest.mark.parametrize("word", [True, False])
def test_the_sessions_own_word_wins(word: bool, processors: int, where: Where) -> None:
    session = load_named("example1", [f"colocate={str(word).lower()}"])
    found = choose(session, where, processors, of_both(900.0, 200.0) if word is False else of_both(200.0, 900.0))
    assert (found.colocate, found.reason) == (word, "")


@pytest.mark.parametrize(("where", "colocate"), [(Where.SIMULATED, False), (Where.APART, False), (Where.HOSTED, True)])
@pytest.mark.parametrize("processors", [1, MANY])
def test_where_it_runs_may_decide_alone_and_silently(where: Where, colocate: bool, processors: int) -> None:
    found = choose(load_named("example1"), where, processors, of_both(200.0, 900.0))
    assert (found.colocate, found.reason) == (colocate, "")


@pytest.mark.parametrize(
    ("measured", "colocate"),
    [
        (of_both(720.0, 530.0), True),
        (of_both(530.0, 720.0), False),
        (of_both(540.0, 530.0), False),  # one step of the grid of tau: nothing is gained
        (of_both(2000.0, 1500.0, late=(0.3, 0.2)), True),  # both beyond a tick: fewer ticks are late
        (of_both(2000.0, 1500.0, late=(0.2, 0.2)), False),
        ({True: a_profile(900.0)}, True),  # one form alone says nothing
        ({False: a_profile(200.0)}, True),
    ],
)
def test_a_measurement_of_both_forms_decides_where_processors_are_few(
    measured: dict[bool, Profile], colocate: bool
) -> None:
    session = load_named("example1")
    assert choose(session, HERE, 2, measured).colocate is colocate
    assert choose(session, HERE, MANY, measured).colocate is False, "there is a processor for each process"


def test_a_launch_is_told_how_it_is_placed() -> None:
    assert Where.of(realtime=True) is HERE
    assert Where.of(realtime=False) is Where.SIMULATED
    assert Where.of(realtime=True, elsewhere=True) is Where.of(realtime=False, elsewhere=True) is Where.APART


def test_the_counts_are_those_of_the_processes_that_run() -> None:
    for name in ("example1", "example1-operator", "ball", "rub"):
        session = load_named(name)
        for colocate, count in zip((False, True), process_counts(session), strict=True):
            graph = topology(session.with_colocation(colocate))
            assert len({graph.together(node) for node in graph.nodes}) == count


# --- the line


def test_one_line_has_the_choice_its_reason_and_the_alternative() -> None:
    session = load_named("example1")
    assert choose(session, HERE, 2).reason == (
        "couplings run in their devices' processes: 4 processes on 2 processors (colocate: false has 7)"
    )
    assert choose(session, HERE, 8).reason == (
        "couplings run in processes of their own: 7 processes on 8 processors (colocate: true has 4)"
    )
    assert choose(session, HERE, 1).reason.startswith("couplings run in their devices' processes: 4 processes on 1 pro")
    assert choose(session, HERE, 2, of_both(720.0, 530.0)).reason == (
        "couplings run in their devices' processes: 4 processes on 2 processors (colocate: false has 7), p99.5 of a "
        "tick 0.53 ms in place of 0.72 ms"
    )
    assert choose(session, HERE, 2, of_both(530.0, 720.0)).reason == (
        "couplings run in processes of their own: 7 processes on 2 processors (colocate: true has 4), p99.5 of a "
        "tick 0.53 ms in place of 0.72 ms"
    )
    assert choose(load_named("example1-centralised"), HERE, 1).reason == ""


# --- on this machine


@pytest.fixture
def processors(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two processors that this process may use, of many, and a cache of its own."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5})
    monkeypatch.setattr(os, "cpu_count", lambda: MANY)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.usefixtures("processors")
def test_it_is_settled_for_the_processors_that_may_be_used() -> None:
    session, reason = settle_colocation(load_named("example1"), HERE)
    assert session.colocate is True
    assert "4 processes on 2 processors" in reason
    assert settle_colocation(session, HERE) == (session, "")
    assert settle_colocation(load_named("example1"), Where.SIMULATED)[0].colocate is False


@pytest.mark.usefixtures("processors")
def test_a_profile_that_doctor_has_kept_is_used_for_a_day(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = load_named("example1")
    for colocate, p995 in ((False, 300.0), (True, 600.0)):
        plan = Plan(loaded.with_colocation(colocate))
        key = Way.of_run(plan).profile_key(plan)
        assert keep_profile(Profile(key, Lateness(100.0, p995, 900.0, 950.0), 1050.0, 0.0, 2.0, time.time()))
    session, reason = settle_colocation(loaded, HERE)
    assert session.colocate is False
    assert reason.endswith("p99.5 of a tick 0.3 ms in place of 0.6 ms")
    assert settle_colocation(loaded, HERE, transport="tcp")[0].colocate is True, "nothing is known of tcp"
    monkeypatch.setattr(profiles, "MOST_AGE", -1.0)
    assert settle_colocation(loaded, HERE)[0].colocate is True


# --- certificates


def test_a_certificate_of_one_machine_is_good_on_any_other() -> None:
    """Designed where couplings are apart, and run where they are not, and the other way about."""
    auto = load_named("example1")
    forms = [auto, auto.with_colocation(False), auto.with_colocation(True)]
    designed = [in_tick(form).design().certificate for form in forms]
    assert len({certificate.id for certificate in designed}) == 1
    for certificate in designed:
        for form in forms:
            assert prepare(form, certificate).id == certificate.id


def test_a_run_without_a_certificate_has_the_id_of_its_form() -> None:
    """Recordings of earlier versions have these ids: "auto" is not in them, and false and true still differ."""
    auto = load_named("example1-uncoupled")
    ids = [unproved(one).id for one in (auto, auto.with_colocation(False), auto.with_colocation(True))]
    assert ids[0] == ids[1] != ids[2]
