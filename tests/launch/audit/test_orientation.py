"""An orientation in a recording: an audit computes torques, accounts and grants again."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.design.levels.contract import DeviceShare
from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.orientation import BOUND, NAME, _followed, device_checks, world_checks
from manyhands.launch.audit.simulation import Silence, simulate
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.kernel.bundle import DeviceBundle, DeviceRung, EnvironmentBundle, OrientationPart, TurnedHand
from manyhands.nodes.kernel.orientation import NO_RIDER
from manyhands.protocol.clock import Duration, Instant, from_seconds
from tests.support.slot import session, values

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


def test_a_recording_says_whose_orientation_is_a_port(run: RecordedRun) -> None:
    assert run.recorded.hands == ("pen",)
    assert {topic.trace for topic in run.recorded.topics("pen") if topic.hands} == {
        "R", "Q", "t_v", "proposed", "account"
    }  # fmt: skip
    assert {topic.trace for topic in run.recorded.topics("environment") if topic.hands} == {"heard", "told"}
    assert not any(topic.hands for topic in run.recorded.topics("c"))


@pytest.mark.parametrize(("acted", "follows"), [(0.0, True), (1.0, False)])
def test_a_spring_begins_anew_after_a_late_tick_without_a_torque_alone(acted: float, follows: bool) -> None:
    """What seemed to be stored in that tick may not be credited, so a row without that credit follows, too."""
    k, period = 0.5, from_seconds(1e-3)
    part = OrientationPart(1e-3, k, 0.4, 100.0, TurnedHand(1e-6, 1e-3, (0.02, 0.0, 0.0)))
    of = DeviceOrientation(part, 1e-3, DeviceRung(0.0, 0.0, DeviceShare()), longest=Duration(6 * period))
    of.sample(0, Instant(0))
    of.exert(NO_RIDER, Instant(0))
    _, Q, u, _, account = of.row()
    assert not any(u)
    before = np.array([*Q, *account[:5], acted])
    of.sample(1, Instant(40 * period))
    of.exert([1.0, 0.0, 0.0, 0.0, 0.0, of.life], Instant(40 * period))
    R, Q, u, came, account = map(np.array, of.row())
    assert account[0] == 0.0
    recorded = np.array([*u, *Q, *account[:3]])
    assert (tuple(_followed(k, before, R, came, account, recorded)) == tuple(recorded)) is follows
