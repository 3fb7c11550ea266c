"""A device at the pointer of a browser, held, released, forgotten or sent nonsense, keeps its promise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.pointer import PATIENCE, REACH, SPEED, Pointer, PointerHand, browser_goal, pointer_hand
from manyhands.nodes.device.simulated import OwnTimeDriver
from manyhands.nodes.kernel.bundle import Common, DeviceBundle, Limits, SimulatedHand, load, save
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport.pointer import PointerOutlet, pointer_path
from tests.support.instants import instant

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
T = 1e-3
LIMITS = Limits((30.0,), (0.1,), (3.0,))
OPERATOR = StateSpace(np.array([[-10.0]]), np.array([[1.0]]), np.array([[3.0]]), np.array([[0.1]]))  # 3/(s + 10) + 0.1
HAND = SimulatedHand((0.2,), (1.37,), OPERATOR, (5.0,), (200.0,), (0.0,), (0.0,))


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "browser.yaml", ["design.ladder=[]"]))


def at(*position: float) -> Grasp:
    return Grasp(np.array(position))


class FedInlet:
    """An inlet that a test feeds."""

    malformed = 0

    def __init__(self) -> None:
        self.said: Grasp | Release | None = None

    def latest(self) -> Grasp | Release | None:
        said, self.said = self.said, None
        return said

    def close(self) -> None:
        """Nothing is open."""


class HeldDevice:
    """A driver with its ledger, at a given force."""

    def __init__(self) -> None:
        self.inlet = FedInlet()
        self.hand = pointer_hand(HAND, LIMITS, T, browser_goal(T, self.inlet))  # type: ignore[arg-type]
        self.driver = OwnTimeDriver(self.hand)
        self.core = DeviceCore(np.array([[1.37]]), np.array([[T / 2.0 / 1.37]]), T)
        self.ticks = 0
        self.x: list[float] = []

    def go(self, ticks: int, said: Grasp | Release | None = None, force: float = 0.0) -> float:
        """Go on; returns where the device is."""
        self.inlet.said = said
        for _ in range(ticks):
            x = self.driver.sample(self.ticks, instant(self.ticks))
            self.x += x
            self.core.sample(x)
            self.driver.apply([force], instant(self.ticks))
            self.driver.idle(instant(self.ticks + 1))
            self.core.apply([force], self.driver.intended_work())
            self.ticks += 1
        return self.x[-1]

    @property
    def grasped(self) -> bool:
        return self.driver.figures()[names.GRASPED] == 1.0


def test_held_it_follows_the_pointer_and_pushes_back_like_its_hand() -> None:
    device = HeldDevice()
    assert device.go(100) == 0.0
    assert not device.grasped
    assert device.go(1500, at(0.06)) == pytest.approx(0.06, rel=1e-3)
    assert device.grasped
    # at rest the spring alone holds against the force
    assert device.go(1500, at(0.06), force=2.0) == pytest.approx(0.06 + 2.0 / 200.0, rel=1e-3)


def test_let_go_it_is_a_mass_with_its_damping() -> None:
    device = HeldDevice()
    device.go(1500, at(0.06), force=2.0)
    device.go(1, Release(), force=0.0)
    assert not device.grasped
    resting = device.go(2000)
    assert resting == pytest.approx(0.07, rel=1e-3)  # nothing draws it back to the pointer
    free = HeldDevice()
    free.go(1)
    moved = np.array(device.x)
    device.go(50, force=1.0)
    free.go(50, force=1.0)
    np.testing.assert_allclose(
        np.array(device.x[len(moved) :]) - resting, np.array(free.x[1:]) - free.x[0], rtol=1e-4, atol=1e-9
    )


def test_caught_again_it_is_drawn_from_where_it_is() -> None:
    device = HeldDevice()
    device.go(1000, at(0.06))
    device.go(1000, Release())
    begin = device.x[-1]
    device.go(4, at(-0.06))
    assert abs(device.x[-1] - begin) < 1e-5
    assert device.go(1500, at(-0.06)) == pytest.approx(-0.06, rel=1e-3)


def test_a_silent_hand_opens_after_two_seconds_of_ticks() -> None:
    device = HeldDevice()
    device.go(1, at(0.01))
    device.go(round(PATIENCE / T) - 1)
    assert device.grasped
    device.go(1)
    assert not device.grasped
    assert device.driver.figures()[names.GRASPS_LAPSED] == 1.0
    device.go(1, at(0.02))
    device.go(1500)
    device.go(1500, at(0.02))  # repeated in time
    assert device.grasped


def test_what_makes_no_sense_is_counted_and_changes_nothing() -> None:
    pointer = Pointer(2, lambda position: [min(max(x, -0.1), 0.1) for x in position], T)
    for said in (at(0.1), at(0.1, 0.1, 0.1), at(float("nan"), 0.0), at(0.0, float("inf"))):
        pointer.tick(said)
        assert pointer.goal is None
    pointer.tick(at(0.05, -0.02))
    assert pointer.goal == [0.05, -0.02]
    pointer.tick(at(7.0, -0.02))
    assert pointer.goal == [0.1, -0.02]
    pointer.tick(at(1.0))
    assert pointer.goal == [0.1, -0.02]
    assert dict(pointer.figures(3)) == {
        names.GRASPED: 1.0, names.GRASPS: 2.0, names.GRASPS_CLIPPED: 1.0, names.GRASPS_REFUSED: 8.0,
        names.GRASPS_LAPSED: 0.0,
    }  # fmt: skip


said = st.none() | st.just(Release()) | st.floats(-0.3, 0.3).map(at) | st.just(at(0.0, 0.0))


@given(st.lists(st.tuples(said, st.integers(1, 40), st.floats(-5.0, 5.0)), min_size=1, max_size=12))
def test_the_promise_is_kept_whoever_holds_it_when(acts: list[tuple[Grasp | Release | None, int, float]]) -> None:
    device = HeldDevice()
    for word, ticks, force in acts:
        device.go(ticks, word, force)
    assert device.core.ledger.minimum >= -1e-15
    assert np.all(np.isfinite(device.x))


def test_keeping_the_tension_at_closing_would_break_the_level() -> None:
    """What the check above is able to see: a spring that is tense from the beginning is energy from nowhere."""
    device = HeldDevice()
    device.hand._held.holding = lambda x, v: [*x, *v, 0.0, 0.05]  # type: ignore[method-assign]
    device.go(300, at(0.0), force=0.2)
    assert device.core.ledger.minimum < -1e-4


def test_a_wild_pointer_does_not_take_it_out_of_its_limits() -> None:
    device = HeldDevice()
    for tick in range(400):
        device.go(10, at(1e300 * (-1) ** (tick // 20)))
    x = np.array(device.x)
    assert np.abs(x).max() < LIMITS.displacement[0]
    assert np.abs(x).max() > REACH * LIMITS.displacement[0] * 0.9  # and it was drawn there
    assert np.abs(np.diff(x)).max() / T < LIMITS.speed[0]
    assert np.abs(np.diff(x)).max() / T > 0.9 * SPEED


def bundle_of(prepared: Prepared, clock: str, directory: Path | None) -> DeviceBundle:
    bundle = cut(prepared, RunPlan(clock, directory, ""))["left"]
    assert isinstance(bundle, DeviceBundle)
    return bundle


def test_what_comes_from_the_pointer_moves_the_device(prepared: Prepared, tmp_path: Path) -> None:
    """From the datagram to the displacement, through a bundle's file."""
    save(bundle_of(prepared, "realtime", tmp_path), tmp_path / "left.bundle")
    driver = driver_of(load(tmp_path / "left.bundle", DeviceBundle))
    outlet = PointerOutlet(tmp_path, "left")
    try:
        for turn, (word, grasped) in enumerate(((at(0.05), 1.0), (Release(), 0.0), (at(0.05), 1.0))):
            assert outlet.send(word)
            for tick in range(500 * turn, 500 * (turn + 1)):
                (x,) = driver.sample(tick, instant(tick))
                driver.idle(instant(tick + 1))
            assert driver.figures()[names.GRASPED] == grasped
        assert x == pytest.approx(0.05, rel=1e-2)
        assert outlet.send(at(0.0, 1.0))
        driver.sample(tick + 1, instant(tick + 1))
        driver.idle(instant(tick + 2))
        assert driver.figures()[names.GRASPS_REFUSED] == 1.0
    finally:
        driver.close()
        outlet.close()
    assert not pointer_path(tmp_path, "left").exists()


@pytest.mark.parametrize(("clock", "here"), [("simulated", True), ("realtime", False), ("simulated", False)])
def test_nobody_can_hold_it_in_another_time_or_place(
    prepared: Prepared, tmp_path: Path, clock: str, here: bool
) -> None:
    driver = driver_of(bundle_of(prepared, clock, tmp_path if here else None))
    assert list(tmp_path.iterdir()) == []
    driver.sample(0, instant(0))
    driver.idle(instant(1))
    assert driver.figures()[names.GRASPED] == 0.0
    driver.close()


def test_a_drag_moves_the_other_user_and_every_promise_is_kept(prepared: Prepared) -> None:
    simulation = Simulation(prepared)
    inlet = FedInlet()
    left = simulation.devices["left"].driver
    assert isinstance(left, OwnTimeDriver)
    assert isinstance(left._hand, PointerHand)
    left._hand._source._inlet = inlet  # type: ignore[attr-defined]
    inlet.said = at(0.11)
    dragged = simulation.run(1500)
    inlet.said = Release()
    rested = simulation.run(3000)
    assert dragged.x[-1, 1] > 0.02  # the right tool, m
    assert dragged.f_v[-1, 1] > 1.0  # and its force, N
    assert np.abs(rested.x[-1]).max() < 1e-3
    assert all(ledger.minimum >= 0.0 for ledger in simulation.ledgers.values())


def test_a_bundle_of_another_width_is_refused(prepared: Prepared, tmp_path: Path) -> None:
    bundle = bundle_of(prepared, "realtime", tmp_path)
    with pytest.raises(ValueError, match="a source of 1 axes; expected 2"):
        dataclasses.replace(bundle, common=wider(bundle.common))


def wider(common: Common) -> Common:
    return dataclasses.replace(common, ports=(*common.ports, "another"))
