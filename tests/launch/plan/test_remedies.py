"""What would help a refused session: each remedy, applied as it is printed, is certified; each limit is a limit."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import manyhands as mh
from manyhands.design.budget import certified_limit
from manyhands.design.errors import DesignError, Infeasible, SolverFailure
from manyhands.launch.doctor.advice import Worth
from manyhands.launch.plan import remedies as module
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.remedies import Lever, settings, with_remedies

from ...support.cases import cases
from ...support.slot import joined

ROOT = Path(__file__).parents[3]


@pytest.fixture
def campaign(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The benchmark, which is run from the repository's root."""
    monkeypatch.syspath_prepend(ROOT)
    return import_module("benchmarks.refusals")


KINDS = (
    "too stiff", "too stiff, matrices", "a late world", "a rational world", "a declared level", "not enforced",
    "held torques", "no coupling", "a far user",
    *(pytest.param(kind, marks=pytest.mark.long) for kind in ("a late world, shaped", "below a speed")),
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_refusal_prints_is_accepted_improves_and_is_a_limit(kind: str, campaign: Any) -> None:
    found = campaign.refusals(3, {kind: campaign.KINDS[kind]})
    for refused, _ in zip(found, range(cases(1, 5)), strict=False):
        for text in refused.printed:
            assert campaign.check(refused, text).faults == [], (text, refused.plain)


@pytest.mark.parametrize(
    ("printed", "fault"),
    [
        ("a stiffness below 2900 N/m: --set design.stiffness=2734 is certified at 2734 N/m", "not enough"),
        ("a stiffness below 2500 N/m: --set design.stiffness=2495 is certified at 2495 N/m", "more than is needed"),
        ("a stiffness below 2740 N/m: --set design.stiffness=2741 is certified at 2741 N/m", "not accepted"),
        ("a stiffness below 2740 N/m: --set design.stiffness=2734 is certified at 2740 N/m", "gives at 2734 N/m"),
        ("a stiffness below 2740 N/m: --set design.stifness=2734 is certified at 2734 N/m", "not accepted"),
        ("a softer spring", "cannot be read"),
    ],
)
def test_the_campaign_sees_what_is_not_so(printed: str, fault: str, campaign: Any) -> None:
    plain = mh.load("example1", {"design": {"coupling": "given", "stiffness": 3000.0}}).to_dict()
    (found, *_) = campaign.check(campaign.Refusal("", plain, "in-tick", ()), printed).faults
    assert fault in found


def refused(changes: dict[str, Any], name: str | mh.Session = "example1") -> Infeasible:
    with pytest.raises(Infeasible) as error:
        mh.certify(mh.load(name, changes))
    return error.value


def test_too_stiff_a_coupling_has_its_limit_and_what_else_would_do() -> None:
    error = refused({"design": {"coupling": "given", "stiffness": 3000.0}})
    assert error.relax[:4] == (
        "a stiffness below 2740 N/m: --set design.stiffness=2737.1 is certified at 2737 N/m",
        "a coupling that is designed: --set 'design={coupling: spring-damper}' is certified at 1110 N/m",
        "devices with an osp above 1.5 N·s/m: --set devices.dx.osp=1.5016 --set devices.dy.osp=1.5016 "
        "--set devices.dz.osp=1.5016 is certified at 3000 N/m",
        "a period below 0.9134 ms: --set period=0.00091237 is certified at 3000 N/m",
    )
    assert "could help" not in str(error)  # nothing is searched before it is asked for


def test_dry_friction_may_count_below_a_speed_and_the_limit_is_one() -> None:
    rubbing = {f"devices.{name}.friction": {"least": 0.2} for name in ("dx", "dy", "dz")}
    session = mh.load("example1", {**rubbing, "design": {"coupling": "given", "stiffness": 3000.0}})
    (printed,) = (text for text in refused({}, session).relax if text.startswith("a design.speed"))
    most = float(printed.split()[3])
    assert printed.startswith(f"a design.speed below {most:g} m/s, beyond which nothing is proved: --set design.speed=")
    assert 2.0 * (1.37 + 0.2 / most) / 1e-3 == pytest.approx(3000.0, rel=1e-3)
    assert mh.certify(session.replace({"design.speed": 0.999 * most})).loop.speed == 0.999 * most
    with pytest.raises(Infeasible):
        mh.certify(session.replace({"design.speed": 1.001 * most}))


@pytest.mark.parametrize(
    ("stiffness", "damping", "printed"),
    [
        ([3000.0, 1200.0, 900.0], None, "a stiffness below 2740 N/m at dx and 1000 N/m at dy: "
         "--set 'design.stiffness=[2736.9, 998.89, 900]' is certified at 900 to 2737 N/m"),
        ([500.0, 1200.0, 900.0], None, "a stiffness below 1000 N/m: "
         "--set 'design.stiffness=[500, 998.89, 900]' is certified at 500 to 998.9 N/m"),
        ([705.0, 500.0, 500.0], 1.1, "a stiffness plus 2/T times its damping below 2740 N/m at dx and 1000 N/m at dy"),
    ],
)  # fmt: skip
def test_only_what_is_too_stiff_is_to_be_softer(stiffness: list[float], damping: float | None, printed: str) -> None:
    """Each coupling has the limit of its own device; where dampers count, a softer spring alone would not help."""
    given = {"coupling": "given", "stiffness": stiffness} | ({} if damping is None else {"damping": damping})
    session = mh.load("example1", {"design": given, "devices.dy.osp": 0.5})
    first = str(next(iter(refused({}, session).search())))
    assert first.startswith(printed), first


def test_one_limit_in_the_refusal_the_budget_and_the_doctor() -> None:
    """What one of them calls the limit is the limit of the others: with and without delay and tolerance."""
    for changes in ({}, {"design.tau": 0.0003}, {"design.tau": 0.0003, "design.period_tolerance": 0.2}):
        session = mh.load("example1", changes)
        loop = haptic_loop(session)
        budget = mh.budget(session).at(loop.tau)["dx"].certified
        assert Worth.of(loop).weakest(loop.tau) == budget
        assert certified_limit(loop, loop.devices[0], loop.period, loop.tau, 0.0).certified == budget
        given = session.replace({"design": {**session.to_dict()["design"], "coupling": "given", "stiffness": 3000.0}})
        stated = float(str(next(iter(refused({}, given).search()))).split()[3])
        assert stated == pytest.approx(budget, rel=0.01)
        assert Worth.of(loop).no_delay == pytest.approx(2740.0)


def test_a_change_that_does_not_help_is_not_offered() -> None:
    """A world of a wave link that is late lacks passivity at any damping of the devices, and at any period."""
    link = {"devices": ["dx"], "wave_link": {"mass": 0.5, "round_trip": 0.02}}
    session = mh.load("example1", {"couplings.cx": link, "environment.delay": 1})
    with pytest.raises(Infeasible) as error:
        mh.certify(session, "environment")
    (only,) = error.value.relax
    assert only.startswith("a world without delay: --set environment.delay=0 is certified with a margin of")


def test_what_only_a_solver_refuses_has_no_remedies() -> None:
    error = SolverFailure("no answer")
    assert with_remedies(error, mh.load("example1")) is error


def large(monkeypatch: pytest.MonkeyPatch, trial: float) -> tuple[list[str], list[str]]:
    """What is offered, and what is not tried to the end, where few ports are many and each trial takes so long, s."""
    time, untried = [0.0], list[str]()

    def slow(trying: Any) -> Any:
        def run(*args: Any) -> Any:
            time[0] += trial
            return trying(*args)

        return run

    monkeypatch.setattr(module, "FEW_PORTS", 2)
    monkeypatch.setattr(module, "_gives", slow(module._gives))
    monkeypatch.setattr(module, "_finds_levels", slow(module._finds_levels))
    session = mh.load("example1", {"design": {"coupling": "given", "stiffness": 3000.0}})
    offered = [one.what for one in module.remedies(session, untried=untried, now=lambda: time[0])]
    assert time[0] <= module.MOST_SECONDS + trial * (2 + len(untried))  # a trial that has begun is finished
    return offered, untried


def test_a_large_session_is_tried_as_long_as_there_is_time(monkeypatch: pytest.MonkeyPatch) -> None:
    every = large(monkeypatch, 0.0)
    assert every[1] == []
    monkeypatch.undo()
    assert every == large(monkeypatch, 0.1)
    monkeypatch.undo()
    offered, untried = large(monkeypatch, 3.0)
    assert offered == ["a coupling that is designed"]  # it takes one trial, and limits take many
    assert untried[:2] == ["a stiffness", "devices with an osp"]
    monkeypatch.undo()
    offered, untried = large(monkeypatch, 61.0)
    assert offered == []
    assert untried[:2] == ["a stiffness", "a coupling that is designed"]


def test_what_was_not_tried_to_the_end_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from rich.console import Console

    from manyhands.launch.look.display import could_help

    monkeypatch.setattr(module, "FEW_PORTS", 2)
    monkeypatch.setattr(module, "MOST_SECONDS", 0.0)
    error = refused({"design": {"coupling": "given", "stiffness": 3000.0}})
    assert could_help(Console(width=200), error) == ()
    assert capsys.readouterr().out.startswith("  not tried to the end, for lack of time: a stiffness, a coupling that")


def test_a_lever_keeps_zeros_signs_and_forms_and_rounds_towards_help() -> None:
    values = {"k": {"between": [1.23456789, -2.0]}, "D": [[0.0, 3.14159265]]}
    less = Lever("x", "N", values, ())
    assert less.at(0.5) == {"k": {"between": [0.61728, -1.0]}, "D": [[0.0, 1.5707]]}
    assert Lever("x", "N", values, (), up=True).at(0.5) == {"k": {"between": [2.4692, -4.0]}, "D": [[0.0, 6.2832]]}
    assert Lever("x", "N", values, (), inverse=frozenset("D")).at(0.5)["D"] == [[0.0, 6.2832]]
    assert less.limit(0.25) == "x below 0.25 times the session's"
    assert Lever("x", "N", values, (2.0, 2.0), up=True, note=", so").limit(0.25) == "x above 8 N, so"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.00001, "--set a.b=1.0e-05"),
        (2734.0, "--set a.b=2734"),
        ([[1.5, 0.0]], "--set 'a.b=[[1.5, 0]]'"),
        ({"coupling": "spring-damper", "tau": 0.0003}, "--set 'a.b={coupling: spring-damper, tau: 0.0003}'"),
        (True, "--set a.b=true"),
    ],
)
def test_a_value_is_written_as_yaml_reads_it(value: object, text: str) -> None:
    assert settings({"a.b": value}) == text


def test_a_gap_right_below_is_no_limit() -> None:
    """A change that helps only close to what the session has, and not a little further, has no limit to state."""
    assert module._limit(lambda share: share < 0.3) == pytest.approx(0.3, rel=3e-4)
    assert module._limit(lambda share: 0.495 < share < 0.505) is None
    assert module._limit(lambda share: False) is None


def test_the_search_ends_where_its_user_ends_it(capsys: pytest.CaptureFixture[str]) -> None:
    """What was found before a Ctrl-C stays."""
    from rich.console import Console

    from manyhands.launch.look.display import could_help

    def search() -> Iterator[Any]:
        yield module.Remedy("one", {"a": 1}, "at 1 N/m")
        raise KeyboardInterrupt

    found = could_help(Console(), Infeasible("no").searching(search))
    assert [str(one) for one in found] == ["one: --set a=1 is certified at 1 N/m"]
    assert capsys.readouterr().out == "  could help: one: --set a=1 is certified at 1 N/m\n"
    assert could_help(Console(), DesignError("no")) == ()


def test_joints_that_take_all_of_an_orientations_damping_have_remedies_that_are_certified() -> None:
    session = mh.Session.from_dict(joined(60.0))
    with pytest.raises(Infeasible, match="that torques of its joints may give out"):
        mh.certify(session)
    found = {one.what.split(" below ")[0].split(" above ")[0]: one for one in module.remedies(session)}
    for what in ("a greatest force", "an orientation with an osp"):
        mh.certify(mh.load(session, found[what].changes))
