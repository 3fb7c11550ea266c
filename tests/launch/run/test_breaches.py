"""From the devices' measurements to softer couplings, notices or an end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.run.breaches import (
    CALM,
    IN_A_ROW,
    MARGIN,
    MOST_DOUBLINGS,
    MOST_HELD,
    REPLIES,
    Assumptions,
    Breach,
    BreachPolicy,
    Cause,
    Covered,
    Decision,
    EndSession,
    Notice,
    Policy,
    ShiftCoupling,
)
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.given import MEASURE
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures, Telemetry

TICKS = 100  # between two telemetry messages
CHAINS = {"dx": ("cx",), "dy": ("cx", "cy"), "dz": ("cz",)}


@dataclass
class Rungs:
    """A ladder without its couplings."""

    taus: tuple[float, ...] = (100e-6, 250e-6, 500e-6, 1000e-6)
    independent: bool = True


class Measured:
    """Devices that send telemetry, one message after the other; what is decided is carried out."""

    def __init__(self, policy: Policy, ladder: Rungs | None = None, period_tolerance: float = 0.0) -> None:
        self.rungs: dict[str, int] = {}
        covered = dict.fromkeys(CHAINS, Covered(100e-6, 1e-3, period_tolerance))
        self.policy = BreachPolicy(policy, CHAINS, covered, ladder, self.rungs)
        self.notices: dict[Cause, str] = {}
        self._counts: dict[str, dict[str, float]] = {}
        self._ticks: dict[str, int] = {}

    def tell(self, device: str, breaches: int, worst: float = 200.0, late_periods: int = 0) -> list[Decision]:
        """Send one telemetry of ``device``: in so many ticks the delay (us) was too long, or the period was not T."""
        counts = self._counts.setdefault(device, {names.TAU_BREACHES: 0.0, names.PERIOD_BREACHES: 0.0})
        counts[names.TAU_BREACHES] += breaches
        counts[names.PERIOD_BREACHES] += late_periods
        self._ticks[device] = self._ticks.get(device, 0) + TICKS
        figures = {**counts, names.TAU_WORST: worst}
        return self._carry_out(self.policy.judge(device, self._ticks[device], Figures(figures)))

    def _carry_out(self, decisions: list[Decision]) -> list[Decision]:
        self.rungs.update({d.coupling: d.rung for d in decisions if isinstance(d, ShiftCoupling)})
        self.notices.update({d.cause: d.text for d in decisions if isinstance(d, Notice)})
        return decisions

    def tell_taus(self, device: str, *taus: tuple[int, float]) -> list[Decision]:
        """One message of ``device``: so many of its ticks with each delay, us; it is at the rung that was asked for."""
        each = [tau for ticks, tau in taus for _ in range(ticks)]
        assert len(each) == TICKS
        covered = min(Rungs.taus[self.rungs.get(coupling, 0)] for coupling in CHAINS[device]) * 1e6
        breaches = sum(tau > covered for tau in each)
        counts = self._counts.setdefault(device, {names.TAU_BREACHES: 0.0, names.PERIOD_BREACHES: 0.0})
        counts[names.TAU_BREACHES] += breaches
        self._ticks[device] = self._ticks.get(device, 0) + TICKS
        figures = {**counts, names.TAU_WORST: max(each)}
        return self._carry_out(
            self.policy.judge(device, self._ticks[device], Figures(figures), [tau * 1e-6 for tau in each])
        )

    def late(self, until: int, **ticks: range) -> list[Decision]:
        """Send the environment's telemetry: the ticks in which each coupling was late."""
        return self._carry_out(self.policy.take_waits(until, ticks))

    def restart(self, device: str) -> None:
        """It has a new process, which counts from 0."""
        self.policy.forget(device)
        self._counts.pop(device)


def ends(decisions: list[Decision]) -> bool:
    return any(isinstance(decision, EndSession) for decision in decisions)


def shifts(decisions: list[Decision]) -> dict[str, int]:
    return {d.coupling: d.rung for d in decisions if isinstance(d, ShiftCoupling)}


class Test_a_notice_of_late_ticks:
    def test_comes_with_more_than_a_hundredth_of_all_ticks_and_not_before(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        for _ in range(80):
            assert m.tell("dx", 1, 900.0) == []
        assert m.notices == {}
        (notice,) = m.tell("dx", 10, 800.0)
        assert notice == Notice(
            Cause.DELAY,
            "forces came later than the certificate covers (0.1 ms): dx in 1.1% of its ticks, up to 0.9 ms so far; "
            f"{MEASURE}",
        )
        assert m.rungs == {}

    def test_needs_more_than_a_few(self) -> None:
        m = Measured(Policy.WARN)
        assert m.tell("dx", 25) + m.tell("dx", 25) == []
        assert [type(d) for d in m.tell("dx", 1)] == [Notice]

    def test_is_one_for_all_devices_and_changes_with_them_alone(self) -> None:
        m = Measured(Policy.WARN)
        assert len(m.tell("dx", 60, 300.0)) == 1
        assert m.tell("dx", 60, 400.0) == []
        (notice,) = m.tell("dz", 70, 200.0)
        assert isinstance(notice, Notice)
        assert "dx in 60.0% of its ticks, up to 0.4 ms, dz in 70.0% of its ticks, up to 0.2 ms so far" in notice.text
        assert m.notices.keys() == {Cause.DELAY}

    def test_says_what_was_softened(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        for device in ("dx", "dz"):
            for _ in range(3):
                m.tell(device, 90, 240.0)
        assert "to what is certified for 0.25 ms: cx, cz; " in m.notices[Cause.DELAY]
        for _ in range(3):
            m.tell("dx", 90, 5000.0)
        assert "to what is certified for 1 ms: cx, cz; none is certified for more than 1 ms; " in m.notices[Cause.DELAY]

    @pytest.mark.parametrize("policy", [Policy.WARN, Policy.STOP])
    def test_says_nothing_of_softening_where_that_is_not_wished(self, policy: Policy) -> None:
        m = Measured(policy, Rungs())
        m.tell("dx", 90)
        assert "soft" not in m.notices[Cause.DELAY]

    def test_at_a_whole_period_advises_nothing_that_was_not_measured(self) -> None:
        m = Measured(Policy.SOFTEN)
        covered = dict.fromkeys(CHAINS, Covered(1e-3, 1e-3))
        m.policy = BreachPolicy(Policy.SOFTEN, CHAINS, covered, None, m.rungs)
        m.tell("dx", 60, 1500.0)
        assert m.notices[Cause.DELAY] == (
            "forces came later than the certificate covers (1 ms): dx in 60.0% of its ticks, up to 1.5 ms so far; "
            f"{MEASURE}"
        )

    def test_has_late_periods_apart(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.tell("dx", 0, late_periods=60)
        assert m.notices == {
            Cause.PERIOD: "the time between samples exceeded what the certificate covers (1 ms, more after an "
            f"early force): dx in 60.0% of its ticks so far; {MEASURE}"
        }

    def test_a_device_that_came_back_keeps_what_it_had(self) -> None:
        m = Measured(Policy.WARN)
        m.tell("dx", 49)
        m.restart("dx")
        assert [type(d) for d in m.tell("dx", 2)] == [Notice]


class Test_what_counts_as_a_burst:
    def test_more_than_a_twentieth_of_the_ticks_twice_in_a_row(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.tell("dx", 50)  # ticks before the first message belong to no window
        assert shifts(m.tell("dx", 6)) == {}
        assert shifts(m.tell("dx", 6)) == {"cx": 1}

    def test_a_twentieth_is_none(self) -> None:
        m = Measured(Policy.STOP)
        m.tell("dx", 1)
        assert not any(ends(m.tell("dx", 5)) for _ in range(50))

    def test_with_a_pause_between_them_two_are_none(self) -> None:
        m = Measured(Policy.STOP)
        m.tell("dx", 1)
        assert not any(ends(m.tell("dx", breaches)) for breaches in (90, 0) * 20)

    def test_each_device_by_itself(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.tell("dx", 1)
        m.tell("dz", 1)
        assert shifts(m.tell("dx", 90)) == {}
        assert shifts(m.tell("dz", 90)) == {}
        assert shifts(m.tell("dx", 90)) == {"cx": 1}
        assert shifts(m.tell("dz", 90)) == {"cz": 1}

    def test_a_device_that_came_back_begins_anew(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.tell("dx", 1)
        m.tell("dx", 90)
        m.restart("dx")
        assert shifts(m.tell("dx", 90)) == {}
        assert shifts(m.tell("dx", 90)) == {}
        assert shifts(m.tell("dx", 90)) == {"cx": 1}


class Test_softening:
    def broken(self, m: Measured, device: str, *worst: float) -> dict[str, int]:
        """So many messages, each with these breaches."""
        m.tell(device, 1)
        for microseconds in worst[:-1]:
            assert shifts(m.tell(device, 90, microseconds)) == {}
        return shifts(m.tell(device, 90, worst[-1]))

    @pytest.mark.parametrize(("worst", "rung"), [(240.0, 1), (250.0, 1), (251.0, 2), (900.0, 3), (5000.0, 3)])
    def test_to_the_first_rung_that_covers_what_was_measured(self, worst: float, rung: int) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        assert self.broken(m, "dx", worst, worst) == {"cx": rung}
        assert ("none is certified for more" in m.notices[Cause.DELAY]) == (worst > 1000.0)
        assert f"certified for {Rungs.taus[rung] * 1e3:g} ms: cx" in m.notices[Cause.DELAY]

    def test_one_outlier_does_not_decide(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        assert self.broken(m, "dx", 5000.0, 240.0) == {"cx": 1}

    def test_all_couplings_of_the_device_and_no_others(self) -> None:
        assert self.broken(Measured(Policy.SOFTEN, Rungs()), "dy", 200.0, 200.0) == {"cx": 1, "cy": 1}

    def test_all_couplings_where_only_all_together_are_certified(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs(independent=False))
        assert self.broken(m, "dx", 200.0, 200.0) == {"cx": 1, "cy": 1, "cz": 1}

    def test_further_where_it_does_not_help(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        assert self.broken(m, "dx", 200.0, 200.0) == {"cx": 1}
        assert self.broken(m, "dx", 400.0, 400.0) == {"cx": 2}
        assert self.broken(m, "dx", 200.0, 200.0) == {}
        assert self.broken(m, "dy", 200.0, 200.0) == {"cy": 1}  # cx is softer already
        assert m.rungs == {"cx": 2, "cy": 1}

    def test_without_a_ladder_one_notice_names_the_key_for_one(self) -> None:
        m = Measured(Policy.SOFTEN)
        assert self.broken(m, "dx", 200.0, 200.0) == {}
        assert "; no softer coupling was designed beforehand (design.ladder); " in m.notices[Cause.DELAY]
        assert [m.tell("dx", 90) for _ in range(10)] == [[]] * 10

    def test_without_a_ladder_that_cannot_be_the_notice_says_why(self) -> None:
        why = "no rungs: dry friction covers what the steps of encoders add"
        m = Measured(Policy.SOFTEN)
        covered = dict.fromkeys(CHAINS, Covered(100e-6, 1e-3))
        m.policy = BreachPolicy(Policy.SOFTEN, CHAINS, covered, None, m.rungs, no_ladder=why)
        assert self.broken(m, "dx", 200.0, 200.0) == {}
        assert f"; {why}; " in m.notices[Cause.DELAY]

    def test_a_device_that_does_not_tell_its_longest_delay(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.policy.judge("dx", 100, Figures())
        m.policy.judge("dx", 200, Figures({names.TAU_BREACHES: 90.0}, {names.TAU: {"p99": 300.0}}))
        assert ShiftCoupling("cx", 2) in m.policy.judge(
            "dx", 300, Figures({names.TAU_BREACHES: 180.0}, {names.TAU: {"p99": 300.0}})
        )


class Test_waiting_for_another_user:
    def test_is_not_judged(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        for end in range(TICKS, 6 * TICKS, TICKS):
            assert m.late(end, cz=range(end - TICKS, end)) == []
            assert shifts(m.tell_taus("dx", (TICKS, 2300.0))) == {}
        assert m.rungs == {}

    def test_is_not_judged_where_a_session_is_to_stop(self) -> None:
        m = Measured(Policy.STOP)
        for end in range(TICKS, 6 * TICKS, TICKS):
            m.late(end, cz=range(end - TICKS, end))
            assert not any(isinstance(d, EndSession) for d in m.tell_taus("dx", (TICKS, 2300.0)))

    def test_is_not_reported_as_its_own(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.late(TICKS, cz=range(TICKS - 50, TICKS))
        m.tell_taus("dx", (50, 50.0), (50, 2300.0))
        m.late(2 * TICKS, cz=range(2 * TICKS - 50, 2 * TICKS))
        m.tell_taus("dx", (50, 50.0), (50, 2300.0))
        assert m.notices == {}
        m.late(3 * TICKS, cz=range(3 * TICKS - 20, 3 * TICKS))
        m.tell_taus("dx", (70, 240.0), (10, 50.0), (20, 2300.0))
        assert m.notices.keys() == {Cause.DELAY}
        assert "up to 0.24 ms" in m.notices[Cause.DELAY]

    @pytest.mark.parametrize(("own", "softened"), [(14, False), (16, True)])  # a third of 45 is 15
    def test_what_nobody_can_tell_apart_softens_nobody(self, own: int, softened: bool) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        for end in range(TICKS, 4 * TICKS, TICKS):
            m.late(end, cz=range(end - TICKS, end - TICKS + 45))
            m.tell_taus("dx", (45 + own, 1100.0), (TICKS - 45 - own, 50.0))
        assert bool(m.rungs) is softened
        assert bool(m.notices) is softened

    def test_for_its_own_coupling_it_is(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        decided: dict[str, int] = {}
        for end in range(TICKS, 4 * TICKS, TICKS):
            m.late(end, cx=range(end - TICKS, end))
            decided |= shifts(m.tell_taus("dx", (TICKS, 2300.0)))
        assert decided == {"cx": 3}

    def test_the_remaining_ticks_are_judged_by_their_longest_delay(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        for end in range(TICKS, 4 * TICKS, TICKS):
            m.late(end, cz=range(end - TICKS, end - 50))
            m.tell_taus("dx", (50, 2300.0), (50, 200.0))
        assert m.rungs == {"cx": 1}

    def test_a_message_is_held_until_the_environment_reports_its_ticks(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.late(50)
        assert m.tell_taus("dx", (TICKS, 50.0)) == []
        assert m.tell_taus("dx", (60, 2300.0), (40, 50.0)) == []
        assert m.tell_taus("dx", (60, 2300.0), (40, 50.0)) == []
        assert shifts(m.late(150, cz=range(100, 150))) == {}
        assert shifts(m.late(350, cz=(*range(150, 160), *range(200, 260)))) == {}  # type: ignore[arg-type]
        assert m.rungs == {}
        assert shifts(m.tell_taus("dx", (60, 240.0), (40, 50.0))) == {}
        assert shifts(m.tell_taus("dx", (60, 240.0), (40, 50.0))) == {}
        assert shifts(m.late(500)) == {"cx": 1}

    def test_an_environment_that_falls_silent_is_not_waited_for(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.late(50)
        decided = [shifts(m.tell_taus("dx", (TICKS, 240.0))) for _ in range(MOST_HELD + 3)]
        assert decided == [{}] * (MOST_HELD + 2) + [{"cx": 1}]

    def test_an_environment_that_comes_back_counts_anew(self) -> None:
        m = Measured(Policy.SOFTEN, Rungs())
        m.late(10_000, cz=range(10_000))
        m.late(50)
        for end in (100, 200, 300):
            m.late(end)
            m.tell_taus("dx", (TICKS, 240.0))
        assert m.rungs == {"cx": 1}


def messages(seconds: float) -> int:
    """So many messages of a device in so many seconds."""
    return round(seconds / (TICKS * 1e-3))


class Test_climbing:
    def softened(self, *devices: str, ladder: Rungs | None = None) -> Measured:
        """Devices that had long delays."""
        m = Measured(Policy.SOFTEN, ladder or Rungs())
        for _ in range(3):
            for device in devices:
                m.tell_taus(device, (TICKS, 450.0))
        return m

    def calm(self, m: Measured, device: str, tau: float = 30.0) -> int:
        """How many messages with such delays it takes until something changes."""
        for count in range(1, 10_000):
            if shifts(m.tell_taus(device, (TICKS, tau))):
                return count
        raise AssertionError("nothing changes")

    def test_rung_by_rung_once_the_cause_is_gone_for_long_enough(self) -> None:
        m = self.softened("dz")
        assert m.rungs == {"cz": 2}
        assert self.calm(m, "dz") == messages(CALM)
        assert m.rungs == {"cz": 1}
        assert self.calm(m, "dz") == messages(CALM)
        assert m.rungs == {"cz": 0}
        assert not any(shifts(m.tell_taus("dz", (TICKS, 30.0))) for _ in range(3 * messages(CALM)))

    @pytest.mark.parametrize(("tau", "climbs"), [(250.0 * MARGIN, True), (250.0 * MARGIN + 1, False)])
    def test_with_a_margin(self, tau: float, climbs: bool) -> None:
        m = self.softened("dz")
        for _ in range(2 * messages(CALM)):
            m.tell_taus("dz", (TICKS, tau))
        assert m.rungs == {"cz": 1 if climbs else 2}

    @pytest.mark.parametrize(("late", "climbs"), [(5, True), (6, False)])
    def test_but_for_what_every_machine_has_now_and_then(self, late: int, climbs: bool) -> None:
        m = self.softened("dz")
        for _ in range(messages(CALM)):
            m.tell_taus("dz", (TICKS - late, 30.0), (late, 450.0))
        assert m.rungs == {"cz": 1 if climbs else 2}

    def test_only_when_all_devices_of_the_coupling_are_calm(self) -> None:
        m = self.softened("dy")
        assert m.rungs == {"cx": 2, "cy": 2}
        for _ in range(3 * messages(CALM)):
            m.tell_taus("dy", (TICKS, 30.0))
        assert m.rungs == {"cx": 2, "cy": 0}  # dx, which cx has as well, has sent nothing
        assert self.calm(m, "dx") == 1 + messages(CALM)  # ticks before the first message belong to no window
        assert m.rungs == {"cx": 1, "cy": 0}

    def test_all_together_where_only_that_is_certified(self) -> None:
        m = self.softened("dz", ladder=Rungs(independent=False))
        assert m.rungs == {"cx": 2, "cy": 2, "cz": 2}
        for _ in range(messages(CALM)):
            for device in CHAINS:
                assert shifts(m.tell_taus(device, (TICKS, 30.0))) == {}
        together = {
            "cx": 1,
            "cy": 1,
            "cz": 1,
        }  # dz sent telemetry before and has been calm for long enough
        assert [shifts(m.tell_taus(device, (TICKS, 30.0))) for device in CHAINS] == [{}, together, {}]

    def test_who_was_made_to_wait_is_calm(self) -> None:
        m = self.softened("dz")
        for number in range(3, 3 + messages(CALM)):
            m.late((number + 1) * TICKS, cx=range(number * TICKS, number * TICKS + 40))
            m.tell_taus("dz", (40, 2300.0), (60, 30.0))
        assert m.rungs == {"cz": 2}  # six tenths of its ticks are its own
        assert self.calm(m, "dz") <= messages(CALM)
        assert m.rungs == {"cz": 1}

    def test_a_device_that_does_not_tell_its_delays_does_not_climb(self) -> None:
        m = self.softened("dz")
        for _ in range(2 * messages(CALM)):
            m.tell("dz", 0, worst=30.0)
        assert m.rungs == {"cz": 2}

    def test_softening_after_a_climb_doubles_the_required_calm(self) -> None:
        m, waits = self.softened("dz"), []
        for _ in range(4):
            waits.append(self.calm(m, "dz"))
            assert m.rungs == {"cz": 1}
            assert self.calm(m, "dz", 450.0) == IN_A_ROW
            assert m.rungs == {"cz": 2}
        assert waits == [messages(CALM) * 2**n for n in range(4)]


stretches = st.lists(st.tuples(st.integers(1, 150), st.sampled_from([30.0, 200.0, 240.0, 450.0])), max_size=12)


@settings(max_examples=30)
@given(stretches)
def test_changes_grow_with_the_logarithm_of_time(stretches: list[tuple[int, float]]) -> None:
    """Whatever the delays do, no coupling climbs more often than stretches of calm that double fit into the time."""
    m = Measured(Policy.SOFTEN, Rungs())
    climbs = ticks = 0
    for count, tau in stretches:
        for _ in range(count):
            before = m.rungs.get("cz", 0)
            m.tell_taus("dz", (TICKS, tau))
            climbs += m.rungs.get("cz", 0) < before
            ticks += TICKS
    doublings = math.log2(1.0 + ticks * 1e-3 / CALM)
    assert doublings < MOST_DOUBLINGS
    assert climbs <= (len(Rungs.taus) - 1) * (1.0 + doublings)


class Test_devices_with_certificates_of_their_own:
    """dx is behind a wave link, at 4 kHz; dz is in the tick."""

    def measured(self, policy: Policy = Policy.WARN, ladder: Rungs | None = None) -> Measured:
        m = Measured(policy)
        covered = dict.fromkeys(CHAINS, Covered(100e-6, 1e-3)) | {"dx": Covered(50e-6, 250e-6, in_tick=False)}
        m.policy = BreachPolicy(policy, {**CHAINS, "dy": ("cy",)}, covered, ladder, m.rungs)
        return m

    def test_a_notice_names_what_each_covers(self) -> None:
        m = self.measured()
        m.tell("dx", 60, 90.0)
        m.tell("dz", 70, 300.0)
        assert m.notices == {
            Cause.DELAY: "forces came later than the certificate covers for each device: dx in 60.0% of its ticks, up "
            "to 0.09 ms (covered 0.05 ms), dz in 70.0% of its ticks, up to 0.3 ms (covered 0.1 ms) so far; " + MEASURE
        }

    def test_a_guest_is_told_what_a_guest_can_do(self) -> None:
        """A wave link has no ladder, and its delay is that of one machine."""
        m = self.measured(Policy.SOFTEN)
        m.tell("dx", 60, 90.0)
        text = m.notices[Cause.DELAY]
        assert "design.ladder" not in text
        assert text.endswith("; the delay is that of the user's own machine, and not of the network")

    def test_a_ladder_is_that_of_the_users_in_the_tick(self) -> None:
        m = self.measured(Policy.SOFTEN, Rungs())
        for device in ("dx", "dz"):
            m.tell(device, 1)
            m.tell(device, 90, 300.0)
            m.tell(device, 90, 300.0)
        assert "cx" not in m.rungs
        assert m.rungs["cz"] > 0

    def test_a_ladder_whose_couplings_change_together_has_none_of_a_wave_link(self) -> None:
        m = self.measured(Policy.SOFTEN, Rungs(independent=False))
        m.tell("dz", 1)
        m.tell("dz", 90, 300.0)
        m.tell("dz", 90, 300.0)
        assert m.rungs.keys() == {"cy", "cz"}

    def test_so_does_one_of_periods(self) -> None:
        m = self.measured()
        m.tell("dx", 0, late_periods=60)
        m.tell("dz", 0, late_periods=70)
        assert m.notices == {
            Cause.PERIOD: "the time between samples exceeded what the certificate covers (more after an early "
            "force): dx in 60.0% of its ticks (covered 0.25 ms), dz in 70.0% of its ticks (covered 1 ms) so far; "
            + MEASURE
        }

    def test_a_session_ends_for_what_the_device_itself_has_covered(self) -> None:
        m = self.measured(Policy.STOP)
        m.tell("dx", 1)
        m.tell("dx", 90, 90.0)
        (end,) = [d for d in m.tell("dx", 90, 90.0) if isinstance(d, EndSession)]
        assert "dx: its delay (0.09 ms) keeps exceeding what the certificate covers (0.05 ms)" in end.reason

    def test_behind_a_wave_link_nobody_is_waited_for(self) -> None:
        """It is judged at once, and no tick is excused in which a user in the tick was late."""
        m = self.measured()
        m.late(10, cz=range(10))
        (notice,) = m.tell("dx", 60, 90.0)
        assert isinstance(notice, Notice)
        assert m.tell("dy", 60) == []  # held until the environment has reported its ticks
        assert len(m.late(TICKS)) == 1


def test_the_period_that_the_certificate_covers_is_named() -> None:
    m = Measured(Policy.WARN, period_tolerance=0.4)
    (notice,) = m.tell("dx", 0, late_periods=60)
    assert isinstance(notice, Notice)
    assert notice.text.startswith(
        "the time between samples exceeded what the certificate covers (1.4 ms, more after an early force): "
        "dx in 60.0% of its ticks"
    )


@pytest.mark.parametrize("policy", Policy)
def test_a_wrong_period_is_no_matter_of_softness(policy: Policy) -> None:
    m = Measured(policy, Rungs())
    m.tell("dx", 0)
    m.tell("dx", 0, late_periods=60)
    decisions = m.tell("dx", 0, late_periods=60)
    text = "dx: the time between its samples keeps exceeding what the certificate covers (1 ms, more after an early "
    text += "force)"
    if policy is Policy.STOP:
        assert decisions == [EndSession(f"{text}; the session's faults.breach is stop")]
    else:
        assert decisions == []
    assert m.notices.keys() == {Cause.PERIOD}


def test_stop_ends_the_session_and_warn_only_reports() -> None:
    for policy in (Policy.STOP, Policy.WARN):
        m = Measured(policy, Rungs())
        m.tell("dx", 1)
        m.tell("dx", 90)
        assert ends(m.tell("dx", 90)) is (policy is Policy.STOP)
        assert m.notices.keys() == {Cause.DELAY}
        assert m.rungs == {}


def test_there_is_a_remedy_for_every_case() -> None:
    assert REPLIES.keys() == {(policy, breach) for policy in Policy for breach in Breach}


counts = st.floats() | st.sampled_from([0.0, 1.0, 1e300, math.nan, math.inf, -1.0])


@given(
    st.sampled_from(list(Policy)),
    st.booleans(),
    st.lists(st.tuples(st.sampled_from([*CHAINS, "cx", "stranger"]), st.integers(0, 300), counts, counts, counts)),
)
def test_without_tick_delays_couplings_only_soften_and_notices_are_few(
    policy: Policy, independent: bool, messages: list[tuple[str, int, float, float, float]]
) -> None:
    m = Measured(policy, Rungs(independent=independent))
    texts = []
    for device, tick, breaches, periods, worst in messages:
        figures = {names.TAU_BREACHES: breaches, names.PERIOD_BREACHES: periods, names.TAU_WORST: worst}
        for decision in m.policy.judge(device, tick, Figures(figures)):
            match decision:
                case ShiftCoupling(coupling, rung):
                    assert policy is Policy.SOFTEN
                    assert m.rungs.get(coupling, 0) < rung < len(Rungs.taus)
                    m.rungs[coupling] = rung
                case Notice(_, text):
                    texts.append(text)
    assert len(texts) <= len(CHAINS) * (len(Breach) + len(Rungs.taus))
    assert IN_A_ROW > 1 or not messages


# --- what a run reports


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_named("example1"))


def the_environment(tick: int, **late: int) -> Telemetry:
    """Telemetry of an environment in which each of these couplings was late and held in so many ticks."""
    tables = {
        names.WAITED_TICKS: {name: float(ticks) for name, ticks in late.items()},
        names.WAITED_TIME: {name: 900.0 * ticks for name, ticks in late.items()},
        names.WAIVED: dict.fromkeys(late, 1.0),
    }
    return Telemetry(tick, Figures({}, tables), {})


class Test_notices_of_a_run:
    @pytest.mark.parametrize(
        ("first", "offset", "tick", "told"),
        [(0.05, 0.04, 3, True), (0.05, 0.01, 3, False), (0.0005, 0.0005, 3, False), (0.05, 0.04, 103, False)],
    )
    def test_a_device_that_begins_away_from_zero_is_told_once(
        self, first: float, offset: float, tick: int, told: bool, prepared: Prepared
    ) -> None:
        assumptions = Assumptions(prepared, prepared.graph, REALTIME, {})
        x = np.array([[first], [0.0], [0.0]])
        figures = Figures({names.INTERFACE_OFFSET: offset})
        assumptions.check("dx", Telemetry(tick, figures, {names.DISPLACEMENT: x}))
        assert bool(assumptions.notices) is told
        if told:
            (text,) = assumptions.notices.values()
            assert "0, where the world expects it: dx 0.05 m (its tool 0.04 m behind); it gets a part of" in text
        assumptions.notices.clear()
        assumptions.check("dx", Telemetry(3, figures, {names.DISPLACEMENT: x}))
        assert assumptions.notices == {}

    def test_name_all_couplings_that_were_waited_for_often(self, prepared: Prepared) -> None:
        assumptions = Assumptions(prepared, prepared.graph, REALTIME, {})
        assumptions.check("environment", the_environment(600, cx=10))
        assumptions.check("environment", the_environment(5000, cx=50))
        assert assumptions.notices == {}
        assumptions.check("environment", the_environment(5100, cx=52))
        assumptions.check("environment", the_environment(5200, cx=52, cz=60))
        assert assumptions.waited_for == ["cx", "cz"]
        (text,) = assumptions.notices.values()
        assert text.startswith("late too often: cx, cz; ")
