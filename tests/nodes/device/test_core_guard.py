"""A device's limits: which forces pass or are clipped, and how the device lets go and takes hold again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.device.core import RETURN, Guard
from manyhands.nodes.kernel.arithmetic import Saturation
from manyhands.nodes.kernel.bundle import Limits

T = 1e-3
AXES = ("arm.0", "arm.1")
LIMITS = Limits(force=(8.0, 2.0), displacement=(0.2, 0.5), speed=(2.0, 1.0))


def guard() -> Guard:
    return Guard(LIMITS, T, AXES)


def test_a_force_within_its_limits_is_handed_on_as_it_is() -> None:
    g = guard()
    f = [8.0, -2.0]
    assert g.clip(f) is f
    assert g.clipped == 0


def test_an_excessive_force_is_clipped_by_axis_and_counted_per_tick() -> None:
    g = guard()
    f = [-9.0, 3.0]
    np.testing.assert_array_equal(g.clip(f), [-8.0, 2.0])
    np.testing.assert_array_equal(f, [-9.0, 3.0])
    np.testing.assert_array_equal(g.clip([1.0, 2.5]), [1.0, 2.0])
    assert g.clipped == 2


def test_what_is_no_number_is_no_force() -> None:
    g = guard()
    np.testing.assert_array_equal(g.clip([math.nan, math.inf]), [0.0, 2.0])
    np.testing.assert_array_equal(g.clip([-math.inf, math.nan]), [-8.0, 0.0])
    assert g.clipped == 2


@given(st.lists(st.tuples(st.floats(), st.floats(0.0, 1e300)), min_size=1, max_size=6))
def test_any_force_ends_within_limits_and_changes_only_as_needed(pairs: list[tuple[float, float]]) -> None:
    f, limits = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    saturation = Saturation(limits.tolist())
    clipped = np.array(saturation.clip(f.tolist()))
    assert np.all(np.abs(clipped) <= limits)
    within = np.abs(f) <= limits
    np.testing.assert_array_equal(clipped[within], f[within])
    assert np.all((np.sign(clipped) == np.sign(f)) | np.isnan(f) | (limits == 0.0))
    assert saturation.ticks == (not np.all(within))


def test_within_its_limits_nothing_is_breached() -> None:
    g = guard()
    for x in ([0.2, -0.5], [0.1981, -0.4991], [0.2, -0.5]):
        assert g.breach(x) is None


@pytest.mark.parametrize(
    ("x", "sentence"),
    [
        ([0.21, 0.0], "found a displacement of 0.21 m at arm.0; expected at most 0.2 m, its limit; see"),
        ([0.0, -0.6], "found a displacement of -0.6 m at arm.1; expected at most 0.5 m"),
        ([math.nan, 0.0], "found a displacement of nan m at arm.0"),
        ([0.0, math.inf], "found a displacement of inf m at arm.1"),
    ],
)
def test_a_displacement_beyond_is_reported(x: list[float], sentence: str) -> None:
    g = guard()
    assert g.breach([0.0] * 2) is None
    found = g.breach(x)
    assert found is not None
    assert found.startswith(sentence)


def test_a_speed_beyond_is_reported() -> None:
    g = guard()
    assert g.breach([0.1, 0.1]) is None
    assert g.breach([0.1, 0.1009]) is None
    found = g.breach([0.1, 0.0994])
    assert found is not None
    assert found.startswith("found a speed of -1.5 m/s at arm.1; expected at most 1 m/s, its limit; see")


def test_the_first_sample_has_no_speed() -> None:
    assert guard().breach([-0.2, 0.5]) is None


def test_a_speed_is_that_of_one_period() -> None:
    slow = Guard(LIMITS, 1.0, AXES)
    assert slow.breach([0.0] * 2) is None
    assert slow.breach([0.0, 0.5]) is None


def test_a_device_within_its_limits_reports_its_position_unchanged() -> None:
    g = guard()
    for x in ([0.0, 0.0], [0.001, 0.0005], [0.2, 0.5]):
        assert g.report(x, 1000) is x
        assert g.clip([1.0, 1.0]) == [1.0, 1.0]
    assert (g.let_go, g.holds) == (0, True)


def test_beyond_its_speed_a_device_lets_go_and_returns_by_ramp() -> None:
    g = guard()
    g.report([0.0, 0.0])
    assert g.report([0.01, 0.0]) == [pytest.approx(0.002), 0.0]  # as far as its speed allows
    assert (g.let_go, g.holds, g.clip([1.0, 1.0])) == (1, False, [0.0, 0.0])
    assert "speed of 10 m/s at arm.0" in g.why
    for _ in range(RETURN):
        assert g.report([0.011, 0.0]) == [pytest.approx(0.002), 0.0]
        assert g.clip([1.0, 1.0]) == [0.0, 0.0]
    felt = []
    for _ in range(RETURN):
        g.report([0.011, 0.0])
        felt.append(g.clip([1.0, 1.0])[0])
    assert felt == sorted(felt)
    assert felt[0] < 1e-3
    assert max(np.diff(felt)) <= np.pi / 2.0 / RETURN
    assert felt[-1] == 1.0
    assert g.report([0.012, 0.0]) == [
        pytest.approx(0.003),
        0.0,
    ]  # the reported position stays behind, not the motion
    assert g.let_go == 1


def test_who_is_held_beyond_its_displacement_stays_out() -> None:
    g = guard()
    for _ in range(3 * RETURN):
        reported = g.report([0.3, 0.0])
        assert reported == [0.2, 0.0]
        assert g.clip([1.0, 1.0]) == [0.0, 0.0]
    assert g.let_go == 1


def test_a_non_number_is_sent_to_no_peer() -> None:
    g = guard()
    g.report([0.1, 0.0])
    for x in ([math.nan, 0.0], [0.1, math.inf], [0.1, 0.0]):
        assert g.report(x) == [0.1, 0.0]
        assert g.clip([1.0, 1.0]) == [0.0, 0.0]


@given(
    steps=st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=60),
    forces=st.lists(st.floats(-8.0, 8.0), min_size=1, max_size=60),
    calm=st.integers(RETURN, 2 * RETURN),
)
def test_letting_go_and_taking_hold_makes_no_energy(steps: list[float], forces: list[float], calm: int) -> None:
    """The reported work is done on the device, except in a tick in which the device is beyond its speed."""
    g = Guard(Limits((8.0,), (1e3,), (1.0,)), T, ("arm",))
    x = told = done = said = force = applied = 0.0
    g.report([0.0])
    for k in range(6 * calm):
        step = steps[k % len(steps)] if k % calm < len(steps) else 0.5e-3 * math.sin(k)
        let_go = g.let_go
        (now,) = g.report([x + step])
        assert abs(now - told) <= T * (1.0 + 1e-9)
        if g.let_go == let_go:
            done += applied * step
            said += force * (now - told)
        x, told = x + step, now
        force = forces[k % len(forces)]
        (applied,) = g.clip([force])
    assert said == pytest.approx(done, abs=1e-9)


class Test_a_device_that_leaves:
    def test_it_lets_go_by_the_ramp_and_for_good(self) -> None:
        g = guard()
        f = [4.0, 1.0]
        g.report([0.0, 0.0])
        assert g.clip(f) is f
        g.leave()
        applied = []
        for _ in range(2 * RETURN):
            g.report([0.0, 0.0])
            applied.append(g.clip(f)[0])
        assert applied[0] < 4.0
        assert applied[RETURN - 1 :] == [0.0] * (RETURN + 1)
        assert max(a - b for a, b in zip([4.0, *applied], applied, strict=False)) < 4.0 * math.pi / RETURN
        assert not g.holds
        assert (g.let_go, g.why) == (0, ""), "nothing was wrong"

    def test_what_it_reports_moves_by_as_much_as_it_exerts(self) -> None:
        """Its ledger counts x' and f: the work of f is then that of what is applied."""
        g = guard()
        g.leave()
        x, reported, work, counted, f = 0.0, 0.0, 0.0, 0.0, [2.0, 0.0]
        held = g.clip(f)[0]
        for _ in range(RETURN + 10):
            moved = g.report([x + 1e-4, 0.0])[0]
            work += held * 1e-4
            counted += f[0] * (moved - reported)
            x, reported, held = x + 1e-4, moved, g.clip(f)[0]
        assert work == pytest.approx(counted, rel=1e-9)

    def test_one_that_had_let_go_does_not_take_hold_again(self) -> None:
        g = guard()
        g.report([0.0, 0.0])
        g.report([9.0, 0.0])
        assert not g.holds
        g.leave()
        for _ in range(3 * RETURN):
            g.report([0.0, 0.0])
        assert not g.holds
