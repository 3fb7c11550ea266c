"""An orientation in a recording: an audit computes torques, accounts and grants again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from manyhands.design.levels.contract import DeviceShare
from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.orientation import BOUND, NAME, _followed, device_checks, world_checks
from manyhands.launch.audit.simulation import Silence, Simulation, simulate
from manyhands.launch.look.plots import NotDrawable, picture_of_run
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace
from manyhands.launch.session import Session
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.device.tick import tick_of
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import (
    REALTIME,
    DeviceBundle,
    DeviceRung,
    EnvironmentBundle,
    OrientationPart,
    TurnedHand,
)
from manyhands.nodes.kernel.orientation import NO_RIDER, turned_by
from manyhands.nodes.kernel.timeouts import RAMP
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.channels import ACCOUNT, INSTANTS, ORIENTATION, PROPOSED, PROXY, TOPICS, TORQUE
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Role
from tests.support.slot import MODEL, SENSED, joined, sensed, session, slot, slot_by, told, values

pytest.importorskip("mujoco")
TICKS = 450


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(session(), None)


@pytest.fixture(scope="module")
def run(prepared: Prepared) -> RecordedRun:
    return simulate(prepared, TICKS)


def test_the_slot_holds_its_hand_about_one_axis_and_lets_it_turn_about_another(run: RecordedRun) -> None:
    R, torque = values(run, "pen", "R"), values(run, "pen", "t_v")
    assert abs(torque[:, 2]).max() == pytest.approx(0.03, rel=0.2)
    assert abs(R[:, 1]).max() > 3.0 * abs(R[:, 3]).max()
    account = values(run, "pen", "account")
    assert (account[:, 0] >= account[:, 1] - account[:, 2] - 1e-15).all()
    assert account[-1, 1] > 0.0  # the hand has given energy, and the bank was asked for it
    assert account[-1, 2] > 0.0


def checks(prepared: Prepared, run: RecordedRun) -> dict[tuple[str, str], CheckVerdict]:
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    device, world = bundles["pen"], bundles["environment"]
    assert isinstance(device, DeviceBundle)
    assert isinstance(world, EnvironmentBundle)
    course = Course({0: Happening(began=True)}, {}, run.ticks)
    found = [*device_checks(run, "pen", device, course), *world_checks(run, "environment", world)]
    return {(check.name, check.party): check.verdict for check in found}


def test_all_of_it_follows(prepared: Prepared, run: RecordedRun) -> None:
    assert set(checks(prepared, run).values()) == {CheckVerdict.HOLDS}
    assert set(checks(prepared, run)) == {
        (NAME, "pen"),
        (BOUND, "pen"),
        ("agreement", "pen"),
        (BOUND, "environment"),
    }


def test_it_follows_of_joints_that_hold_force_and_torque() -> None:
    prepared = prepare(Session.from_dict(joined()), None)
    run = simulate(prepared, 300)
    assert set(checks(prepared, run).values()) == {CheckVerdict.HOLDS}
    assert abs(values(run, "pen", "t_v")).max() > 0.0


@pytest.mark.parametrize(
    ("node", "trace", "column", "by", "broken"),
    [
        ("pen", "t_v", 2, 1e-12, {(NAME, "pen")}),
        ("pen", "Q", 1, 1e-12, {(NAME, "pen")}),
        ("pen", "account", 0, 1e-9, {(NAME, "pen")}),
        ("pen", "account", 0, -1e-3, {(NAME, "pen"), (BOUND, "pen")}),
        ("pen", "proposed", 1, 1e-5, {(NAME, "pen"), ("agreement", "pen")}),
        ("environment", "told", 4, 1.0, {("agreement", "pen"), (BOUND, "environment")}),
        ("environment", "told", 0, 1e-9, {("agreement", "pen")}),
    ],
)
def test_a_number_that_was_changed_is_found(
    prepared: Prepared, node: str, trace: str, column: int, by: float, broken: set[tuple[str, str]]
) -> None:
    run = simulate(prepared, 300)
    for (of, _), one in run.traces.items():
        if of == node and one.topic.trace == trace:
            one.values[200, column] += by
    found = checks(prepared, run)
    assert {about for about, verdict in found.items() if verdict is CheckVerdict.BROKEN} == broken


FAR = {"b": 20, "network": {"delay": 0.02, "jitter": 0.004, "loss": 0.02}}


@pytest.mark.parametrize(
    ("node", "trace", "column", "by", "verdict"),
    [
        ("pen", "proposed", 1, 0.0, CheckVerdict.HOLDS),
        ("pen", "proposed", 1, 1e-5, CheckVerdict.BROKEN),
        ("environment", "told", 0, 1e-9, CheckVerdict.BROKEN),
        ("environment", "told", 0, np.nan, CheckVerdict.HOLDS),  # who knows what it told in that tick?
    ],
)
def test_what_comes_over_a_wave_link_was_told_in_some_tick(
    node: str, trace: str, column: int, by: float, verdict: CheckVerdict
) -> None:
    prepared = prepare(slot_by(FAR), None)
    run = simulate(prepared, 300)
    came, told = (values(run, of, which) for of, which in (("pen", "proposed"), ("environment", "told")))
    (tick,) = np.flatnonzero((told == came[200]).all(axis=1)).tolist()
    assert tick <= 180  # it was under way for so long
    at = {"pen": [200], "environment": [tick]}[node]
    for (of, _), one in run.traces.items():
        if of == node and one.topic.trace == trace:
            one.values[at, column] += by
    assert checks(prepared, run)["agreement", "pen"] is verdict
    assert checks(prepared, run)[NAME, "pen"] is (CheckVerdict.BROKEN if node == "pen" and by else CheckVerdict.HOLDS)


SOFTENED = 150
"""The tick in which the device is told of another rung."""


@pytest.fixture(scope="module")
def on_the_ladder() -> Prepared:
    own = {"osp": 0.0005, "damping": 0.001}
    return prepare(Session.from_dict(slot(own, design={"coupling": "spring-damper", "tau": 0.0, "ladder": [0.001]})))


def softened(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> RecordedRun:
    """A run in which the device alone changes to the next rung; nothing here asks its coupling or the world."""
    tick = Simulation._tick

    def changing(self: Simulation, k: int, *rest: Any) -> Any:
        if k == SOFTENED:
            self.devices["pen"].change(1)
        return tick(self, k, *rest)

    monkeypatch.setattr(Simulation, "_tick", changing)
    return simulate(prepared, TICKS)


def test_a_softer_rung_has_a_softer_spring(on_the_ladder: Prepared) -> None:
    assert on_the_ladder.ladder is not None
    levels = [rung.loop.devices[0].orientation for rung in on_the_ladder.ladder.rungs]
    assert [level.stiffness for level in levels if level is not None] == [0.3, pytest.approx(0.99 * 0.25, rel=1e-12)]
    pen = cut(on_the_ladder, RunPlan("simulated", None, ""))["pen"]
    assert isinstance(pen, DeviceBundle)
    assert [rung.turning for rung in pen.rungs] == [level.stiffness for level in levels if level is not None]


@pytest.mark.parametrize("told", [True, False])
def test_the_stiffness_of_each_tick_is_known(
    told: bool, on_the_ladder: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = softened(on_the_ladder, monkeypatch)
    torque = values(run, "pen", "t_v")
    (rests,) = np.nonzero(~torque[SOFTENED:].any(axis=1))
    assert rests.tolist() == [RAMP - 1, RAMP]  # for two ticks, at the end of a ramp
    assert np.abs(torque[SOFTENED + RAMP + 1 :]).max() > 1e-3
    bundle = cut(on_the_ladder, RunPlan("simulated", None, ""))["pen"]
    assert isinstance(bundle, DeviceBundle)
    course = Course({0: Happening(began=True)}, {SOFTENED: 1} if told else {}, run.ticks)
    follows, _ = device_checks(run, "pen", bundle, course)
    assert follows.verdict is (CheckVerdict.HOLDS if told else CheckVerdict.BROKEN)
    if follows.first is not None:
        assert follows.first.tick > SOFTENED + RAMP


def test_a_hand_whose_coupling_is_silent_is_free_meanwhile(prepared: Prepared) -> None:
    run = simulate(prepared, TICKS, [Silence("c", 100, 300)])
    proposed, heard = values(run, "pen", "proposed"), values(run, "environment", "heard")
    assert not proposed[100:300].any()
    assert not heard[100:300].any()
    assert proposed[301:, :4].any(axis=1).all()
    Q = values(run, "pen", "Q")
    account = values(run, "pen", "account")
    assert (account[:, 0] >= account[:, 1] - account[:, 2] - 1e-15).all()
    assert Q.shape == (TICKS, 4)


@pytest.fixture(scope="module")
def with_a_grip() -> Prepared:
    return prepare(Session.from_dict(sensed()), None)


def test_of_a_hand_that_feels_nothing_there_is_its_orientation_alone(with_a_grip: Prepared) -> None:
    run = simulate(with_a_grip, 200)
    assert (run.recorded.hands, run.recorded.sensed) == (("pen",), ("pen",))
    assert [topic.trace for topic in run.recorded.topics("pen") if topic.hands] == ["R"]
    assert {topic.trace for topic in run.recorded.topics("environment") if topic.hands} == {"heard", "told"}
    found = checks(with_a_grip, run)
    assert found == {(NAME, "pen"): CheckVerdict.HOLDS, ("agreement", "pen"): CheckVerdict.HOLDS}
    assert Recorded.from_metadata(run.recorded.as_metadata()) == run.recorded
    assert picture_of_run(run, ["orientation"]).panels
    with pytest.raises(NotDrawable):
        picture_of_run(run, ["angle"])


def test_torques_of_joints_and_a_ladder_change_nothing_of_it(with_a_grip: Prepared) -> None:
    data = sensed(design={"coupling": "spring-damper", "tau": 1e-4, "ladder": [2e-4]})
    data["devices"]["pen"] |= {"held": "torque", "linkage": {"kappa": 0.01}}
    run = simulate(prepare(Session.from_dict(data), None), 100)
    assert (values(run, "pen", "R") == values(simulate(with_a_grip, 100), "pen", "R")).all()


@pytest.mark.parametrize(
    ("node", "trace", "column", "by", "broken"),
    [
        ("pen", "R", 0, 1e-6, (NAME, "pen")),
        ("environment", "heard", 4, 1e-9, ("agreement", "pen")),
        ("environment", "told", 4, 1e-9, ("agreement", "pen")),
    ],
)
def test_a_hand_that_feels_nothing_and_has_an_account_is_found(
    with_a_grip: Prepared, node: str, trace: str, column: int, by: float, broken: tuple[str, str]
) -> None:
    run = simulate(with_a_grip, 50)
    for (of, _), one in run.traces.items():
        if of == node and one.topic.trace == trace:
            one.values[20, column] += by
    found = checks(with_a_grip, run)
    assert {about for about, verdict in found.items() if verdict is CheckVerdict.BROKEN} == {broken}


def test_a_recording_says_whose_orientation_is_a_port(run: RecordedRun) -> None:
    assert run.recorded.hands == ("pen",)
    assert {topic.trace for topic in run.recorded.topics("pen") if topic.hands} == {
        "R", "Q", "t_v", "proposed", "account"
    }  # fmt: skip
    assert {topic.trace for topic in run.recorded.topics("environment") if topic.hands} == {"heard", "told"}
    assert not any(topic.hands for topic in run.recorded.topics("c"))


FELT = slot()["devices"]["pen"]["orientation"]


def _both() -> Session:
    """A sensed stick beside one that is felt, across its end, so that it turns it."""
    data = sensed()
    grip = data["devices"]["pen"] | {"hand": {}}
    grip["orientation"] = SENSED | {"torque": [0, 0, "0.01*sin(2*pi*2*t)"]}
    pen = slot()["devices"]["pen"] | {"hand": {}, "orientation": {**FELT, "torque": [0, 0, 0.001]}}
    stick = MODEL[MODEL.index("<body name") : MODEL.index("</worldbody>")]
    other = stick.replace('"stick"', '"bar" pos="0.031 0.0115 0"').replace("-0.03 0 0 0.03 0 0", "0 -0.02 0 0 0.02 0")
    for name in ("x", "y", "z", "turn"):
        other = other.replace(f'joint name="{name}"', f'joint name="g{name}"')
    head = MODEL[: MODEL.index("<geom type=")]
    data["devices"] = {"grip": grip, "pen": pen}
    data["couplings"] = {"g": {"devices": ["grip"]}, "c": {"devices": ["pen"]}}
    data["environment"] |= {
        "tools": {"grip": ["gx", "gy", "gz"], "pen": ["x", "y", "z"]},
        "avatars": {"grip": "gturn", "pen": "turn"},
        "model": f"{head}{stick}{other}</worldbody></mujoco>",
    }
    return Session.from_dict(data)


def test_beside_a_hand_that_feels_nothing_the_accounts_of_others_are_their_own() -> None:
    """The bar of the sensed hand swings against the other's stick, whose hand is turned only as far as it has given."""
    prepared = prepare(_both(), None)
    run = simulate(prepared, 300)
    account, heard = values(run, "pen", "account"), values(run, "environment", "heard")
    assert abs(values(run, "pen", "t_v")[:, 2]).max() > 1e-3
    assert not heard[:, 4].any()
    assert heard[-1, 10] > 0.0
    assert (account[:, 0] >= account[:, 1] - account[:, 2] - 1e-15).all()
    assert account[:, 0].min() >= -1e-15  # there is no other hand that could have granted it anything
    bundles = cut(prepared, RunPlan("simulated", None, ""))
    world = bundles["environment"]
    assert isinstance(world, EnvironmentBundle)
    found = world_checks(run, "environment", world)
    assert [(check.name, check.party) for check in found] == [
        ("agreement", "grip"),
        ("agreement", "pen"),
        (BOUND, "environment"),
    ]
    assert {check.verdict for check in found} == {CheckVerdict.HOLDS}
    run.traces["environment", "told"].values[200, 9] += 1.0  # to the hand that feels
    broken = {check.name for check in world_checks(run, "environment", world) if check.verdict is CheckVerdict.BROKEN}
    assert broken == {"agreement", BOUND}


@pytest.mark.parametrize("cut_short", [False, True])
def test_a_torque_that_ended_before_the_next_sample_leaves_nothing_stored_there_either(
    cut_short: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In wall time, in ticks that are not late: their account has ended the force, and the instants tell when."""
    prepared = prepare(Session.from_dict(told()), None)
    bundle = cut(prepared, RunPlan(REALTIME, None, ""))["pen"]
    assert isinstance(bundle, DeviceBundle)
    tick, period, ticks = tick_of(bundle, driver_of(bundle)), 1_000_000, 60
    own, interface = tick.orientation, tick.interface
    assert isinstance(own, DeviceOrientation)
    assert interface is not None
    before, rows, lost = interface.force, list[list[list[float]]](), 0

    def force(f: list[float], held: list[float], at: Instant) -> tuple[list[float], Instant | None]:
        held, until = before(f, held, at)
        return held, Instant(at + period // 2) if cut_short and at // period % 3 == 0 else until

    monkeypatch.setattr(interface, "force", force)
    for k in range(ticks):
        at = Instant(k * period)
        turned = any(own.torque)
        tick.sample(k, at)
        lost += turned and own.spring.proxy == own.R
        proxy = turned_by(own.R, (0.02 * math.sin(0.3 * k), 0.01, 0.0))
        tick.exert([0.0] * 3, at, came=[*proxy, own.spring.deposited, own.life])
        tick.book()
        rows.append([list(part) for part in (tick.instants, *tick.row()[7:])])
    assert (lost > 10) == cut_short
    assert own.spring.late == 0.0
    run = simulate(prepared, ticks)
    names = (INSTANTS, ORIENTATION, PROXY, TORQUE, PROPOSED, ACCOUNT)
    topics = {topic.trace: topic for topic in TOPICS[Role.DEVICE]}
    for i, trace in enumerate(names):
        values_of = np.array([row[i] for row in rows], dtype=np.float64)
        columns = topics[trace].columns_of(run.recorded.ports["pen"], ())
        run.traces["pen", topics[trace].name] = RecordedTrace(topics[trace], columns, values_of)  # type: ignore[index]
    course = Course({0: Happening(began=True)}, {}, ticks)
    assert {check.verdict for check in device_checks(run, "pen", bundle, course)} == {CheckVerdict.HOLDS}
    instants = run.traces["pen", "instants"].values
    instants[:, 2] = instants[:, 0]  # as if every torque had lasted until the next sample
    found = {check.name: check.verdict for check in device_checks(run, "pen", bundle, course)}
    assert found[NAME] is (CheckVerdict.BROKEN if cut_short else CheckVerdict.HOLDS)


@pytest.mark.parametrize(("acted", "follows"), [(0.0, True), (1.0, False)])
def test_a_spring_that_lets_go_begins_anew_after_a_tick_without_a_torque_alone(acted: float, follows: bool) -> None:
    """What seemed to be stored in that tick may not be credited, so a row without that credit follows, too."""
    k, period = 0.5, from_seconds(1e-3)
    part = OrientationPart(1e-3, k, 0.4, 100.0, TurnedHand(1e-6, 1e-3, (0.02, 0.0, 0.0)))
    tank = LatenessAllowance(1e-6)
    of = DeviceOrientation(part, 1e-3, DeviceRung(0.0, 0.0, DeviceShare()), tank, Duration(6 * period))
    of.sample(0, Instant(0))
    of.exert(NO_RIDER, Instant(0))
    of.spring.charge(1.0)  # more than lateness may put in
    _, Q, u, _, account = of.row()
    assert not any(u)
    before = np.array([*Q, *account[:5]])
    of.sample(1, Instant(40 * period))
    of.exert([1.0, 0.0, 0.0, 0.0, 0.0, of.life], Instant(40 * period))
    R, Q, u, came, account = map(np.array, of.row())
    assert account[0] == 0.0
    recorded = np.array([*u, *Q, *account[:3]])
    assert (tuple(_followed(k, before, R, came, account, recorded, acted == 0.0)) == tuple(recorded)) is follows
