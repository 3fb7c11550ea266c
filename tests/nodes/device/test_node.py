"""A device without its force lets go in time, goes on with samples and its guard, and hears again later."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel.bundle import REALTIME, DeviceBundle, PluginDevice
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.nodes.kernel.timeouts import STALE_TICKS
from manyhands.nodes.link.peer_link import PeerLink, hello_to
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, Force, Sample, Start

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
PERIOD = 1_000_000  # ns
SILENT = 5  # the tick from which on the coupling is silent
REACH = 0.25  # m


class SteppedTime:
    """Time that passes where something waits."""

    def __init__(self) -> None:
        self.ns = 0

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        self.ns = max(self.ns, instant)


class Coupling:
    """The other end of the device's link: it answers at once, then falls silent, then answers by ``later``."""

    def __init__(self, time: SteppedTime, later: Callable[[int], Force | None], takes: int = 0) -> None:
        self._time, self._later, self._takes = time, later, takes  # ns until an answer is there
        self._coming: deque[bytes] = deque()
        self.samples: list[Sample] = []

    def send(self, frame: bytes) -> bool:
        sample = decode(frame, MAX_CONTROL_BYTES)
        assert isinstance(sample, Sample)
        self.samples.append(sample)
        answer = Force(sample.tick, 0, np.array([1.0])) if sample.tick < SILENT else self._later(sample.tick)
        if answer is not None:
            self._coming.append(encode(answer))
        return True

    def recv(self, timeout: Duration) -> bytes | None:
        if self._coming:
            self._time.ns += self._takes
            return self._coming.popleft()
        self._time.ns += timeout
        return None

    def close(self) -> None:
        pass


class MovingDriver:
    """A driver that moves a little every period, notes when force is applied, and ends the session at last."""

    axes = 1

    def __init__(self, time: SteppedTime, life: Any, periods: int, speed: float = 0.01) -> None:
        self._time, self._life, self._periods, self._speed = time, life, periods, speed
        self.sampled: list[int] = []
        self.exerted: list[tuple[int, float]] = []
        self._x = np.zeros(1)

    def sample(self, turn: int, at: Instant) -> np.ndarray:
        self._life.stopping = turn + 1 >= self._periods
        self.sampled.append(self._time.ns)
        self._x = np.array([self._speed * turn * PERIOD / 1e9])
        return self._x

    def apply(self, f: np.ndarray, at: Instant, until: Instant | None = None) -> np.ndarray:
        self.exerted.append((self._time.ns, float(f[0])))
        return self._x

    def release(self, at: Instant) -> np.ndarray:
        return self.apply(np.zeros(1), at)

    def idle(self, due: Instant) -> None:
        """Nothing was put off."""

    def intended_work(self) -> float:
        return 0.0

    def figures(self) -> Figures:
        return Figures()

    def close(self) -> None:
        """Nothing is open."""


class Alone:
    """A device in its loop, with everything around it the test's."""

    def __init__(
        self,
        prepared: Prepared,
        life: Any,
        line: Any,
        later: Callable[[int], Force | None],
        latency: DeviceTiming | None = None,
        takes: int = 0,
        **hand: Any,
    ) -> None:
        bundle = cut(prepared, RunPlan(REALTIME, None, ""))["dx"]
        assert isinstance(bundle, DeviceBundle)
        if latency is not None:
            bundle = replace(bundle, source=PluginDevice(FactoryName("some:driver", {}), 1, timing=latency))
        self.time, self.line, self.life = SteppedTime(), line, life
        self.hand, self.coupling = MovingDriver(self.time, life, **hand), Coupling(self.time, later, takes)
        node = self.node = DeviceNode(bundle, self.hand, self.time)  # type: ignore[arg-type]
        (peer,) = bundle.common.peers
        own = hello_to(bundle.common, peer, None)
        node.joins = [PeerLink(own, peer, self.coupling, Force, slice(0, 1), self.time)]  # type: ignore[arg-type]
        node.loop(Start(0, 0), life, line)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(
        load_session(
            SESSIONS / "example1.yaml", [f"devices.dx.limits={{displacement: {REACH}}}", "devices.dx.time=own"]
        )
    )


@pytest.fixture(scope="module")
def in_wall_time() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture
def alone(prepared: Prepared, new_life: Callable[[], Any], new_line: Callable[[], Any]) -> Callable[..., Alone]:
    return lambda later, **hand: Alone(prepared, new_life(), new_line(), later, **hand)


def nothing(_tick: int) -> None:
    return None


def test_a_stale_force_is_let_go_and_the_device_runs_free(alone: Callable[..., Alone]) -> None:
    one = alone(nothing, periods=40)
    due = SILENT * PERIOD
    held = [at for at, force in one.hand.exerted if force != 0.0]
    assert held == [tick * PERIOD for tick in range(SILENT)]
    first_zero = min(at for at, force in one.hand.exerted if force == 0.0)
    assert first_zero == due + STALE_TICKS * PERIOD
    after = [at for at in one.hand.sampled if at > first_zero]
    assert np.all(np.diff(after) == PERIOD)  # it goes on, period by period
    assert len(after) > 20
    asked = one.coupling.samples[SILENT:]
    assert {sample.tick for sample in asked} == {SILENT}
    assert len({float(sample.values[0]) for sample in asked}) == len(asked)  # where it is, not where it was
    report = one.node.report()
    assert (report.ticks, report.figures["stale"]) == (SILENT, 1)
    assert report.figures["released"] >= len(after) - 1
    assert report.figures["jumps"] == 0


def test_in_wall_time_the_same_motion_is_sent_until_the_tick_is_answered(
    in_wall_time: Prepared, new_life: Callable[[], Any], new_line: Callable[[], Any]
) -> None:
    """The account knows what the couplings received only if every copy of a sample is the same."""
    one = Alone(in_wall_time, new_life(), new_line(), nothing, periods=40)
    asked = one.coupling.samples[SILENT:]
    assert len(asked) > 20
    assert {(sample.tick, float(sample.values[0])) for sample in asked} == {(SILENT, float(asked[0].values[0]))}


def test_a_process_that_did_not_run_is_counted_apart(
    in_wall_time: Prepared, new_life: Callable[[], Any], new_line: Callable[[], Any]
) -> None:
    def sleepy(self: MovingDriver, turn: int, at: Instant) -> np.ndarray:
        if turn == 3:
            self._time.ns += 300 * PERIOD
        return awake(self, turn, at)

    awake = MovingDriver.sample
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MovingDriver, "sample", sleepy)
        one = Alone(in_wall_time, new_life(), new_line(), lambda tick: Force(tick, 0, np.array([0.5])), periods=30)
    report = one.node.report()
    assert report.figures["suspended"] == 1
    assert report.figures["suspended_us"] == pytest.approx(300e3, rel=0.01)
    assert report.figures["suspended_energy"] >= 0.0


@pytest.mark.parametrize(("takes", "breaches"), [(0, 29), (600_000, 29), (700_000, 29), (990_000, 29)])
@pytest.mark.parametrize("latency", [DeviceTiming(), DeviceTiming(5e-4, 0.0, 2e-4)], ids=["prompt", "late by itself"])
def test_a_latency_of_the_device_is_a_part_of_every_delay_and_no_lateness_of_the_loop(
    in_wall_time: Prepared,
    new_life: Callable[[], Any],
    new_line: Callable[[], Any],
    takes: int,
    breaches: int,
    latency: DeviceTiming,
) -> None:
    """The rate is 1/T as long as the loop ends its tick in time, even where the force acts after the next sample."""

    def answer(tick: int) -> Force:
        return Force(tick, 0, np.array([1.0]))

    one = Alone(in_wall_time, new_life(), new_line(), answer, latency=latency, takes=takes, periods=30)
    assert set(np.diff(one.hand.sampled)) == {PERIOD}
    report = one.node.report()
    tau = 1e6 * latency.latency + takes / 1e3
    assert list(report.figures.table("tau_us").values()) == pytest.approx([tau] * 4, rel=0.01, abs=1e-9)
    assert report.figures["late"] == 0
    # the session is certified without a delay
    assert report.figures["tau_breaches"] == (breaches if tau > 0.0 else 0)
    assert report.figures["interface"] >= -1e-9 or tau > 0.0


def test_a_late_loop_is_late_whatever_the_device(
    in_wall_time: Prepared, new_life: Callable[[], Any], new_line: Callable[[], Any]
) -> None:
    def answer(tick: int) -> Force:
        return Force(tick, 0, np.array([1.0]))

    for latency in (DeviceTiming(), DeviceTiming(5e-4, 0.0, 2e-4)):
        one = Alone(in_wall_time, new_life(), new_line(), answer, latency=latency, takes=PERIOD + 100_000, periods=30)
        assert set(np.diff(one.hand.sampled)) == {2 * PERIOD}
        assert one.node.report().figures["late"] == 29


@pytest.mark.parametrize(("age", "jitter", "breaches"), [(0.0, None, 0), (1e-4, 0.0, 0), (1e-4, None, 28)])
def test_the_age_of_samples_that_varies_is_a_part_of_the_period(
    in_wall_time: Prepared,
    new_life: Callable[[], Any],
    new_line: Callable[[], Any],
    age: float,
    jitter: float | None,
    breaches: int,
) -> None:
    """The session is certified for punctual samples alone."""
    one = Alone(
        in_wall_time, new_life(), new_line(), lambda tick: Force(tick, 0, np.array([1.0])),
        latency=DeviceTiming(age, jitter), periods=30,
    )  # fmt: skip
    assert one.node.report().figures["period_breaches"] == breaches


def test_while_it_runs_free_its_limits_hold(alone: Callable[..., Alone]) -> None:
    one = alone(nothing, periods=400, speed=5.0)
    assert one.life.failure == ""
    assert one.node.report().figures["let_go"] == 1
    said = [sample.values[0] for sample in one.coupling.samples]
    assert max(said) == pytest.approx(REACH, abs=5.0 * PERIOD / 1e9)
    assert max(said) <= REACH < 399 * 5.0 * PERIOD / 1e9  # where the hand has gone


def test_it_hears_again_and_goes_on_where_the_session_is(alone: Callable[..., Alone]) -> None:
    asked: list[int] = []

    def later(tick: int) -> Force | None:
        asked.append(tick)
        if tick == SILENT:
            return Force(77, 0, np.array([0.0])) if len(asked) >= 10 else None
        return Force(tick, 0, np.array([0.5]))

    one = alone(later, periods=40)
    after = asked[10:]
    assert after[0] == 78  # the tick after the one that was over
    assert after == list(range(78, 78 + len(after)))
    assert one.hand.exerted[-2][1] == 0.5
    report = one.node.report()
    assert (report.figures["stale"], report.figures["jumps"]) == (1, 1)
    assert report.ticks >= 78 + len(after) - 1
    first, second = one.line.telemetry
    assert (first.tick, len(first.traces["x"])) == (SILENT, SILENT)
    assert second.tick == report.ticks
    assert len(second.traces["x"]) == report.ticks - 77  # the tick that was over is its first


def test_a_force_of_a_later_tick_is_exerted_and_the_device_goes_on_after_it(alone: Callable[..., Alone]) -> None:
    one = alone(lambda _tick: Force(77, 0, np.array([0.5])), periods=40)
    assert one.node.report().figures["jumps"] == 1
    assert one.node.report().ticks == 78
    assert {force for _, force in one.hand.exerted} == {1.0, 0.0, 0.5}
