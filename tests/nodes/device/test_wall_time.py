"""Devices in wall time: exact at any nanosecond, however the time is cut, and with an exact balance of energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import expm

from manyhands.design.models.device import HeldDevice, held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.operators import RationalMatrix
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import Driver, TraceDriver, WallTimeTrace
from manyhands.nodes.device.simulated import HeldDeviceDriver, IntentHand, Plant
from manyhands.nodes.device.wall_time import LONGEST_GAP
from manyhands.nodes.kernel.bundle import RecordedMotion
from manyhands.nodes.kernel.intent import Constant, intent_from
from manyhands.protocol.clock import Instant
from tests.support.instants import instant
from tests.support.small_drivers import Make, browser, carried, dragged, in_wall_time, simulated, trace, waving

T = 1e-3
PERIOD = instant(1)

OPERATOR = ((0.02, 1.2, 20.0), (1.0, 10.3, 100.0))


def operator(axes: int) -> StateSpace:
    none = ((0.0,), (1.0,))
    entries = tuple(tuple(OPERATOR if i == j else none for j in range(axes)) for i in range(axes))
    return RationalMatrix(entries).realisation()


positive = st.floats(0.02, 5.0)


@st.composite
def devices(draw: st.DrawFn) -> HeldDevice:
    """Masses from 20 g to 5 kg, hands open, stiff or with the operator of Example 1, on one to three axes."""
    m = draw(st.integers(1, 3))

    def each(values: st.SearchStrategy[float]) -> list[float]:
        return [draw(values) for _ in range(m)]

    H = operator(m) if draw(st.booleans()) else StateSpace.static(np.zeros((m, m)))
    stiffness = st.just(0.0) | st.floats(1.0, 1e5)
    return held_device(each(positive), each(positive), H, each(st.floats(0.0, 50.0)), each(stiffness))


def driver_of(device: HeldDevice, force: Sequence[float], velocity: Sequence[float]) -> HeldDeviceDriver:
    """A driver whose hand intends a constant force and a constant velocity."""
    motions = [intent_from(f"{v!r}*t") for v in velocity]
    hand = IntentHand(Plant(device, T, parts=True), [Constant(f) for f in force], motions, T)
    return HeldDeviceDriver(hand, T)


def generator(device: HeldDevice) -> np.ndarray:
    """M with (z, u)' = M (z, u)."""
    system = device.continuous()
    return np.block([[system.A, system.B], [np.zeros((system.inputs, system.order + system.inputs))]])


# 50 ms is how long a frozen loop holds a force
durations = st.one_of(st.integers(1, 2_000), st.integers(1, 1_000_000), st.integers(1, 50_000_000))


@given(devices(), durations, st.integers(0, 3_000_000), durations, st.data())
def test_it_is_exact_at_every_nanosecond(
    device: HeldDevice, first: int, begin: int, second: int, data: st.DataObject
) -> None:
    """Against one exponential for each force, 50 ms at most, to a relative error of 1e-12, or 1e-300 m.

    Numbers below 2e-308 have fewer digits than others.
    """
    m = device.axes
    forces = [np.array([data.draw(st.floats(-20.0, 20.0)) for _ in range(m)]) for _ in range(2)]
    pushed = [data.draw(st.floats(-5.0, 5.0)) for _ in range(m)]
    driver = driver_of(device, pushed, [0.0] * m)
    M = generator(device)
    n = len(M) - 2 * m
    z, size, at = np.zeros(len(M)), np.zeros(len(M)), begin
    driver.sample(0, Instant(at))
    for force, duration in zip(forces, (first, second), strict=True):
        driver.apply(force, Instant(at))
        z[n:] = np.concatenate([force + pushed, np.zeros(m)])
        size[n:] = np.abs(z[n:])
        transition = expm(M * (duration * 1e-9))
        z, size = transition @ z, np.abs(transition) @ size  # the size of the terms whose sum is z
        at += duration
        x = driver.sample(0, Instant(at))
        assert np.all(np.abs(x - z[:m]) <= 1e-12 * size[:m] + 1e-300)
        assert driver._present is not None
    state = np.array(driver._finished(driver._present, at).state)
    assert np.all(np.abs(state - z[:n]) <= 1e-12 * size[:n] + 1e-300)


WALL = [in_wall_time(make) for make in (simulated, waving, carried, browser, dragged, trace)]
events = st.lists(
    st.tuples(st.integers(0, 2_500_000), st.floats(-3.0, 3.0), st.none() | st.integers(0, 3_000_000)),
    min_size=1, max_size=12,
)  # fmt: skip
Event = tuple[int, float, int | None]


@pytest.fixture(params=WALL, ids=lambda make: make.__name__)
def make(request: pytest.FixtureRequest) -> Make:
    made: Make = request.param
    return made


def played(driver: Driver, events: Sequence[Event], cuts: Callable[[int, int], Sequence[int]]) -> np.ndarray:
    """Where the device is after each event, and the work of the intention between them; ``cuts`` gives more samples."""
    at, out = 1_234_567, []
    driver.sample(0, Instant(at))
    for wait, force, lasts in events:
        work = 0.0
        for to in (*cuts(at, at + wait), at + wait):
            x = driver.sample(0, Instant(to))
            work += driver.intended_work()
        at += wait
        driver.apply([force] * driver.axes, Instant(at), None if lasts is None else Instant(at + lasts))
        out.append([*x, work])
    return np.array(out)


@given(events=events, share=st.floats(0.0, 1.0))
def test_more_samples_change_nothing(make: Make, events: list[Event], share: float) -> None:
    def cuts(begin: int, end: int) -> list[int]:
        return [begin + int(share * (end - begin)), begin + int((1.0 + share) / 2.0 * (end - begin))]

    whole, cut = played(make(), events, lambda _begin, _end: []), played(make(), events, cuts)
    np.testing.assert_allclose(cut[:, :-1], whole[:, :-1], rtol=1e-12, atol=1e-16)
    if "trace" not in make.__name__:  # its friction counts where it is seen, and so more at more samples
        np.testing.assert_allclose(cut[:, -1], whole[:, -1], rtol=1e-10, atol=1e-14)
    else:
        assert np.all(cut[:, -1] >= whole[:, -1] - 1e-14)


@given(events=events)
def test_more_forces_of_the_same_strength_change_nothing(make: Make, events: list[Event]) -> None:
    once, again = make(), make()
    at = 0
    for wait, force, _ in events:
        at += wait
        for driver in (once, again):
            driver.sample(0, Instant(at))
            driver.apply([force] * driver.axes, Instant(at))
        again.apply([force] * again.axes, Instant(at + 400_000))
        at += 700_000
        np.testing.assert_allclose(once.sample(0, Instant(at)), again.sample(0, Instant(at)), rtol=1e-12, atol=1e-16)


@given(events=events, ahead=st.lists(st.booleans(), min_size=12, max_size=12))
def test_to_integrate_ahead_changes_no_bit(make: Make, events: list[Event], ahead: list[bool]) -> None:
    """Not even where a force comes before the instant to which the device was integrated."""
    lazy, eager = make(), make()
    at = 0
    for (wait, force, lasts), often in zip(events, ahead, strict=False):
        at += wait // 3
        assert lazy.sample(0, Instant(at)) == eager.sample(0, Instant(at))
        assert lazy.intended_work() == eager.intended_work()
        at += wait // 5
        until = None if lasts is None else Instant(at + lasts)
        for driver in (lazy, eager):
            driver.apply([force] * driver.axes, Instant(at), until)
        eager.idle(Instant((at // PERIOD + 1) * PERIOD))
        if often:
            eager.idle(Instant((at // PERIOD + 2) * PERIOD))
    assert lazy.sample(0, Instant(at + 777_777)) == eager.sample(0, Instant(at + 777_777))


@given(events=events, after=st.lists(st.integers(0, 900_000), min_size=12, max_size=12))
def test_a_device_that_runs_free_is_where_it_is_however_often_it_is_released(
    make: Make, events: list[Event], after: list[int]
) -> None:
    """A recording has the instant at which a force was released, and none of the periods without force after it."""
    once, often = make(), make()
    at = 0
    for (wait, force, lasts), again in zip(events, after, strict=False):
        at += wait
        assert once.sample(0, Instant(at)) == often.sample(0, Instant(at))
        for driver in (once, often):
            driver.apply([force] * driver.axes, Instant(at))
        at += lasts or 1
        for driver in (once, often):
            driver.release(Instant(at))
        read = [often.sample(0, Instant(at + again)), often.release(Instant(at + again))]
        assert read[0] == read[1]
        often.idle(Instant((at // PERIOD + 2) * PERIOD))
        at += 900_000


@given(events=events)
def test_the_end_of_a_force_is_a_release_at_that_instant(make: Make, events: list[Event]) -> None:
    limited, released = make(), make()
    at = 0
    for wait, force, lasts in events:
        at += wait
        assert limited.sample(0, Instant(at)) == released.sample(0, Instant(at))
        assert limited.intended_work() == pytest.approx(released.intended_work(), rel=1e-12, abs=1e-18)
        end = None if lasts is None else Instant(at + lasts)
        limited.apply([force] * limited.axes, Instant(at), end)
        released.apply([force] * released.axes, Instant(at))
        if end is not None:
            released.release(end)
            at = end
        at += 1


@pytest.mark.parametrize("make", [in_wall_time(simulated), in_wall_time(browser)], ids=lambda make: make.__name__)
def test_a_force_whose_end_has_come_moves_nothing(make: Make) -> None:
    driver = make()
    driver.sample(0, instant(1.5))
    for end in (0.0, 1.0, 1.5):
        driver.apply([5.0] * driver.axes, instant(1.5), instant(end))
        assert driver.sample(0, instant(3.0 + end)) == [0.0] * driver.axes


@given(events=events)
def test_an_instant_in_the_past_counts_as_the_last_event(make: Make, events: list[Event]) -> None:
    straight, astray = make(), make()
    at = 1_500_000
    for wait, force, lasts in events:
        until = None if lasts is None else Instant(at + lasts)
        x = straight.sample(0, Instant(at))
        assert astray.sample(0, Instant(at)) == x
        assert straight.intended_work() == astray.intended_work()
        assert astray.sample(1, Instant(at - 300_000)) == x
        assert astray.intended_work() == 0.0
        assert straight.apply([force] * straight.axes, Instant(at), until) == x
        assert astray.apply([force] * astray.axes, Instant(at - 1_000_000), until) == x
        astray.idle(Instant(at - 1))
        at += wait


@pytest.mark.parametrize("make", [simulated, waving, carried, browser, dragged], ids=lambda make: make.__name__)
def test_on_the_grid_it_has_every_bit_of_a_device_in_its_own_time(make: Callable[..., Driver]) -> None:
    own, wall = make(), make(wall=True)
    for tick in range(80):
        at = instant(tick)
        assert own.sample(tick, at) == wall.sample(tick, at)
        assert own.intended_work() == wall.intended_work()
        for driver in (own, wall):
            driver.apply([0.1 * tick, -1.0], at)
            driver.idle(instant(tick + 1))
    assert any(own.sample(80, instant(80)))


def test_it_begins_at_rest_at_its_first_event_whenever_that_is() -> None:
    late = simulated("5", "0.3*sin(20*t)", stiffness=100.0, wall=True)
    assert late.sample(0, instant(3.6e6 + 0.3)) == [0.0, 0.0]  # after an hour, of which no period is computed
    assert late.intended_work() == 0.0
    assert late.apply([1.0, 0.0], instant(3.6e6 + 0.3)) == [0.0, 0.0]
    assert late.sample(1, instant(3.6e6 + 0.9))[0] > 0.0


def test_the_hand_follows_the_session_s_time_not_the_samples() -> None:
    """Sampled in every period and in every seventh, it is moved alike."""
    often, seldom = in_wall_time(waving)(), in_wall_time(waving)()
    for tick in range(1, 700):
        x = often.sample(tick, instant(tick + 0.4))
        often.idle(instant(tick + 1))
        if tick % 7 == 1:
            np.testing.assert_allclose(seldom.sample(tick, instant(tick + 0.4)), x, rtol=1e-12, atol=1e-18)
    assert x[0] > 1e-3


class Counted:
    """An intention of 0 N; :attr:`count` is how often it was evaluated."""

    count = 0

    def __call__(self, t: float) -> float:
        self.count += 1
        return 0.0


@pytest.mark.parametrize("idle", [False, True])
def test_of_an_hour_in_which_nobody_called_only_the_first_seconds_are_integrated(idle: bool) -> None:
    force, device = Counted(), held_device([0.2], [1.37], operator(1), [0.0], [0.0])
    hand = IntentHand(Plant(device, T, parts=True), [force], [Constant(0.0)], T)
    stopped, went_on = HeldDeviceDriver(hand, T), driver_of(device, [0.0], [0.0])
    begin, end = instant(3.3), Instant(LONGEST_GAP + instant(3.3))
    hour = Instant(3600 * 1000 * PERIOD + 400_000)
    for driver in (stopped, went_on):
        driver.sample(0, begin)
        driver.apply([1.0], begin, instant(9.1))
    if idle:
        stopped.idle(instant(4))
    moved = went_on.sample(1, end)[0]
    assert stopped.sample(1, hour)[0] == moved > 1e-3
    assert stopped.intended_work() == 0.0
    assert force.count < LONGEST_GAP / PERIOD + 10
    assert stopped.apply([1.0], hour) == [moved]
    later = stopped.sample(2, Instant(hour + PERIOD))[0]
    assert moved + 1e-7 < later < moved + 1e-5


def test_a_recorded_motion_is_where_it_is_after_any_gap() -> None:
    motion = RecordedMotion(np.eye(1), (0.0, 100.0), ((0.0, 1.0),))
    driver = WallTimeTrace(motion, T)
    driver.sample(0, instant(1))
    driver.apply([0.0], instant(1))
    assert driver.sample(1, instant(50_000.5)) == pytest.approx([0.500005], rel=1e-12)
    own = 1.0 * (0.5 - 1e-5) ** 2 / 49.999  # Delta_D dx^2 / t is the least that such a motion costs
    assert own < driver.intended_work() < 2.0 * own


@given(devices(), st.lists(st.tuples(st.integers(1, 3_000_000), st.floats(-20.0, 20.0)), min_size=1, max_size=8))
@example(
    held_device([0.02], [5.0], operator(1), [50.0], [531.7173806061248]),
    [(3_000_000, 0.0)],
)
def test_forces_and_intention_do_the_work_that_is_stored_or_burned(
    device: HeldDevice, events: list[tuple[int, float]]
) -> None:
    """f^T dx + W = M v^2/2 + k d^2/2, and what the dampers burn, without approximation; the hand has no operator."""
    m = device.axes
    device = held_device(
        device.mass.tolist(), device.damping.tolist(), StateSpace.static(np.zeros((m, m))),
        device.hand_damping.tolist(), device.hand_stiffness.tolist(),
    )  # fmt: skip
    velocity = np.linspace(-0.3, 0.5, m)
    driver, pushed = driver_of(device, [0.7] * m, velocity.tolist()), np.full(m, 0.7)
    M = generator(device)
    n = len(M) - 2 * m
    v_of, d_of, goal_of = (np.eye(len(M))[i : i + m] for i in (m, 2 * m, n + m))
    w_of = v_of - goal_of
    stored = v_of.T @ np.diag(device.mass / 2.0) @ v_of + d_of.T @ np.diag(device.hand_stiffness / 2.0) @ d_of
    burned = v_of.T @ np.diag(device.damping) @ v_of + w_of.T @ np.diag(device.hand_damping) @ w_of
    z, at, before = np.zeros(len(M)), 500_000, np.zeros(m)
    driver.sample(0, Instant(at))
    given = taken = passed = 0.0
    for duration, force in events:
        driver.apply([force] * m, Instant(at))
        at += duration
        x = np.array(driver.sample(0, Instant(at)))
        work = force * float(np.sum(x - before)) + driver.intended_work()
        z[n:] = np.concatenate([force + pushed, velocity])
        # exp(-M^T t) grows: at once over 3 ms of a light, damped device this would have lost four of its digits
        steps = -(-duration // 500_000)
        whole = expm(np.block([[-M.T, burned], [np.zeros_like(M), M]]) * (duration * 1e-9 / steps))
        transition = whole[len(M) :, len(M) :]
        loss, lost = transition.T @ whole[: len(M), len(M) :], 0.0
        for _ in range(steps):
            lost, z = lost + float(z @ loss @ z), transition @ z
        before = x
        given, taken = given + work, taken + lost
        passed += abs(work) + lost + float(z @ stored @ z)
        assert abs(given - taken - float(z @ stored @ z)) <= 1e-10 * passed + 1e-20


times = st.lists(st.integers(1, 2_500_000), min_size=1, max_size=15)
MOTION = RecordedMotion(
    np.array([[1.37, 0.4], [0.4, 0.9]]), tuple(0.002 * k for k in range(20)),
    tuple(tuple(0.01 * np.sin(k * a) for k in range(20)) for a in (0.7, 1.9)),
)  # fmt: skip


@given(times)
def test_a_recorded_motion_is_played_by_the_clock(waits: list[int]) -> None:
    driver = WallTimeTrace(MOTION, T)
    at = 0
    for wait in waits:
        at += wait
        x = driver.sample(0, Instant(at))
        np.testing.assert_allclose(
            x, [np.interp(at * 1e-9, MOTION.times, axis) for axis in MOTION.values], rtol=1e-12, atol=1e-15
        )
        assert driver.apply([50.0, -50.0], Instant(at)) == x


def test_on_the_grid_a_recorded_motion_is_that_in_its_own_time() -> None:
    own, wall = TraceDriver(MOTION, T), WallTimeTrace(MOTION, T)
    for tick in range(60):
        assert own.sample(tick, instant(tick)) == wall.sample(tick, instant(tick))
        assert own.intended_work() == pytest.approx(wall.intended_work(), rel=1e-12, abs=1e-18)
        for driver in (own, wall):
            driver.apply([0.3, -0.1 * tick], instant(tick))
            driver.idle(instant(tick + 1))


@given(st.floats(0.0, 0.99), st.lists(st.tuples(*[st.floats(-50.0, 50.0)] * 2), min_size=1, max_size=40))
def test_whenever_in_the_period_a_trace_is_sampled_its_ledger_is_never_below_zero(
    offset: float, forces: list[tuple[float, float]]
) -> None:
    driver, K = WallTimeTrace(MOTION, T), T / 2.0 * np.linalg.inv(MOTION.damping)
    core, passed = DeviceCore(MOTION.damping, K, T), 1e-9
    for tick, f in enumerate(forces):
        x = driver.sample(tick, instant(tick + offset))
        core.sample(x)
        driver.apply(f, instant(tick + offset))
        driver.idle(instant(tick + 1))
        core.apply(list(f), driver.intended_work())
        passed += abs(driver.intended_work()) + float(np.array(f) @ K @ np.array(f))
    assert core.ledger.minimum >= -1e-9 * passed
