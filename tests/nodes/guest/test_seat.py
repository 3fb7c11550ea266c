"""A guest at a seat: what it expects to feel, the question, and how its life ends."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from manyhands.design.models.axis import AxisKind
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.guest import seat
from manyhands.nodes.guest.invitation import Invitation
from manyhands.nodes.guest.seat import (
    SeatLife,
    answered_yes,
    felt,
    felt_as_measured,
    force_sentence,
    is_calm,
    turning_sentence,
    with_force,
)
from manyhands.nodes.kernel.bundle import SIMULATED, CouplingBundle, DeviceBundle, OrientationPart, TurnedHand
from manyhands.nodes.kernel.lifetime import Sight, Stopped
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Echo, Stop

MS = 1_000_000


def coupling(
    b: list[float], period: float = 1e-3, peer: float = 1e-3, kinds: tuple[AxisKind, ...] = ()
) -> CouplingBundle:
    wave = SimpleNamespace(b=np.diag(b), peer_period=peer, depth=None, every=1, peer_every=1)
    return cast(CouplingBundle, SimpleNamespace(common=SimpleNamespace(period=period, kinds=kinds), wave=wave))


def test_the_law_of_distance() -> None:
    found = felt(coupling([10.0, 20.0]), [Duration(40 * MS), Duration(41 * MS), Duration(49 * MS)])
    assert found.network == pytest.approx(0.040)
    assert found.play_out == pytest.approx(0.009 + 0.001)
    assert found.round_trip == pytest.approx(0.050)
    assert found.stiffness == pytest.approx(2 * 10.0 / 0.050)  # the softest direction
    assert found.mass == pytest.approx(20.0 * 0.050 / 2)  # the heaviest
    assert found.sentence() == (
        "round trip R of about 50 ms: 40 ms of network and 10 ms of play-out\n"
        "a wall will feel no stiffer than about K = 400 N/m, and free space will weigh about M = 500 g more"
    )


def test_a_seat_that_turns_is_told_in_its_units() -> None:
    sentence = felt(coupling([10.0], kinds=(AxisKind.ROTATION,)), [Duration(40 * MS)] * 3).sentence()
    assert "K = 487.8 N·m/rad, and free space will weigh about M = 205 g·m² more" in sentence


def test_a_rare_late_frame_is_no_part_of_what_is_felt() -> None:
    steady = [Duration(40 * MS)] * 198
    found = felt(coupling([10.0]), [Duration(1700 * MS), *steady])
    assert found.play_out == pytest.approx(0.001)
    assert "K = 487.8 N/m, and free space will weigh about M = 205 g more" in found.sentence()
    assert "M = 1.7 kg more" in felt(coupling([10.0]), [Duration(339 * MS)]).sentence()


@pytest.mark.parametrize(
    "link",
    [
        "network: {delay: 0.01}",
        "interval: 0.008, network: {delay: 0.01}",
        "depth: 6, network: {delay: 0.01}",
        "depth: 6, interval: 0.004, network: {delay: 0.01, jitter: 0.002}",
    ],
)
def test_what_is_foretold_is_what_the_wave_link_then_shows(link: str) -> None:
    """Within a tenth, of the link's own network; a wave in several ticks, or a stated depth, lengthens both alike."""
    far = f"couplings.cx={{devices: [dx], wave_link: {{mass: 0.5, round_trip: 0.04, {link}}}}}"
    session = load_named("example1", [far])
    prepared, own = prepare(session), session.wave_links["cx"]
    simulation = Simulation(prepared)
    simulation.run(1000)
    shown = simulation.links["cx"].felt((1.0, 1.0))
    assert own.network is not None
    rng = np.random.default_rng(1)
    under_way = 2.0 * own.network.delay + rng.uniform(0.0, own.network.jitter, (400, 2)).sum(axis=1)
    trips = [Duration(int(1e9 * one)) for one in under_way]
    bundle = cast(CouplingBundle, cut(prepared, RunPlan(SIMULATED, None, ""))["cx"])
    foretold = felt(bundle, trips)
    assert foretold.round_trip == pytest.approx(shown.round_trip, rel=0.1)


def test_what_both_ends_measure_is_told_by_the_same_law() -> None:
    assert felt_as_measured(coupling([10.0, 20.0]), 0.005) == (
        "both ends measure a round trip R of 5 ms: a wall feels no stiffer than K = 4000 N/m, and free space weighs "
        "M = 50 g more"
    )
    turning = felt_as_measured(coupling([10.0], kinds=(AxisKind.ROTATION,)), 0.005)
    assert "K = 4000 N·m/rad, and free space weighs M = 25 g·m² more" in turning


@pytest.mark.parametrize(
    ("network", "said"),
    [
        (0.004, "turning drags like about 0.004 N·m·s/rad, for what the tool answers is 4 ms old; its spring of 1 "
                "N·m/rad is what a wall feels like"),
        (0.0401, "turning drags like about 0.0401 N·m·s/rad, for what the tool answers is 40.1 ms old; its spring of "
                 "1 N·m/rad is what a wall feels like, and buzzes: 0.0998 N·m/rad would not"),
    ],
)  # fmt: skip
def test_a_guest_is_told_what_turning_feels_like_so_far_away(network: float, said: str) -> None:
    part = OrientationPart(0.001, 1.0, 0.2, 30.0, TurnedHand(2e-5, 0.001, (0.0, 0.0, 0.0)))
    device = cast(DeviceBundle, SimpleNamespace(orientation=part))
    assert turning_sentence(device, network) == said
    assert turning_sentence(cast(DeviceBundle, SimpleNamespace(orientation=None)), network) is None


@pytest.fixture
def visit() -> Any:
    invitation = cast(Invitation, SimpleNamespace(session="ball", seat="right_seat", device="right", address="h:7400"))
    return seat._Visit(invitation, "h", True, None, None, 1.0)


@pytest.mark.parametrize(
    ("asked", "R", "holding", "told", "tcp"),
    [
        (7.9, 0.005, False, False, False),  # not all has settled
        (8.1, 0.005, False, True, False),
        (8.1, 0.005, False, True, True),
        (8.1, 0.005, True, False, True),  # nothing comes, and the tool is held
        (8.1, None, False, False, False),
        (None, None, False, False, False),
    ],
)
def test_a_guest_is_told_once_what_it_feels(
    asked: float | None,
    R: float | None,
    holding: bool,
    told: bool,
    tcp: bool,
    visit: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    """It has joined at 5 s; the host has told its coupling R, in answer to what that asked."""
    end = SimpleNamespace(face=SimpleNamespace(holding=holding), without_datagrams=tcp)
    echo = None if asked is None else Echo(from_seconds(asked), 0, 0, R)
    lines = [SimpleNamespace(echo=Echo(from_seconds(8.2), 0, 0)), SimpleNamespace(echo=echo)]
    monkeypatch.setattr(seat, "UserEnd", SimpleNamespace)
    monkeypatch.setattr(seat, "RealtimeClock", lambda: SimpleNamespace(now=lambda: Instant(from_seconds(5.0))))
    visit._distance = felt(coupling([10.0]), [Duration(1 * MS)] * 90 + [Duration(40 * MS)] * 10)
    visit._lines = lines
    visit._tell(coupling([10.0]), SimpleNamespace(joins=[end]))  # before it has joined
    visit._joined(1e-3)
    assert capsys.readouterr().err == (
        "right_seat: in, at 1000 ticks a second, round trip R of about 41 ms; Ctrl-C leaves\n"
    )
    for _ in range(3):
        visit._tell(coupling([10.0]), SimpleNamespace(joins=[end]))
    said = capsys.readouterr().err
    assert said.count("right_seat: both ends measure a round trip R of 5 ms") == told
    assert said.count("right_seat: no datagram comes through, so the waves go by TCP") == (told and tcp)
    assert said.count("\n") == told + (told and tcp)


@pytest.mark.parametrize(
    ("stop", "code", "says"),
    [
        (Stop("the session ends"), 0, "ball: the host has ended the session\n"),
        (None, 0, "ball: the session is over: its last tick is done\n"),
        (None, 1, ""),
    ],
)
def test_a_guest_is_told_that_the_host_has_ended_the_session(
    stop: Stop | None, code: int, says: str, visit: Any, life: SeatLife, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def attempt(_: SeatLife) -> int:
        visit._lines = [SimpleNamespace(stop=stop)]
        visit._joined(1e-3)
        return code

    monkeypatch.setattr(visit, "_attempt", attempt)
    assert visit.stay(life) == code
    assert capsys.readouterr().err.endswith(f"right_seat: out, after 0.0 s\n{says}")
    life.signal = signal.SIGINT  # its user has ended it, and knows that
    monkeypatch.setattr(life, "begin", lambda: None)
    visit.stay(life)
    assert capsys.readouterr().err.endswith("right_seat: out, after 0.0 s\n")


@pytest.mark.parametrize(
    ("stopping", "says"), [(False, "the host ended the session before the seat was taken"), (True, "")]
)
def test_a_guest_that_measured_until_the_host_ended_is_told_so(
    stopping: bool, says: str, visit: Any, life: SeatLife, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def attempt(_: SeatLife) -> int:
        life.stopping = stopping  # its user did not want it, and knows that
        return 0

    monkeypatch.setattr(visit, "_attempt", attempt)
    assert visit.stay(life) == 0
    assert capsys.readouterr().err == (f"ball: {says}\n" if says else "")


@pytest.mark.parametrize(
    ("trips", "calm"), [([4] * 200, True), ([4] * 150 + [7] * 50, True), ([4] * 190 + [90] * 10, False), ([], False)]
)
def test_a_burst_is_measured_again(trips: list[int], calm: bool) -> None:
    assert is_calm([Duration(trip * MS) for trip in trips]) is calm


def test_where_nothing_came_back_nothing_is_known() -> None:
    with pytest.raises(ValueError, match="found 0 round trips; expected one at least"):
        felt(coupling([10.0]), [])


@contextmanager
def typed(text: str | None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A terminal at which ``text`` was typed; with None nothing comes."""
    reading, writing = os.pipe()
    if text is not None:
        os.write(writing, text.encode())
    with open(reading) as stdin, open(writing, "w"):
        monkeypatch.setattr("sys.stdin", stdin)
        yield


@pytest.mark.parametrize(
    ("text", "expected"), [("y\n", True), ("YES\n", True), ("n\n", False), ("\n", False), ("yesterday\n", False)]
)
def test_only_yes_is_yes(text: str, expected: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with typed(text, monkeypatch):
        assert answered_yes("? ", lambda: None) is expected


def test_no_answer_in_time_is_no_and_the_life_is_looked_at_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []
    monkeypatch.setattr(seat, "TIME_TO_ANSWER", 0.25)
    with typed(None, monkeypatch):
        assert not answered_yes("? ", lambda: looks.append(1))
    assert looks


def test_the_end_of_the_input_is_no(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115 -- closed below
    import sys

    assert not answered_yes("? ", lambda: None)
    sys.stdin.close()


@pytest.fixture
def life() -> Iterator[SeatLife]:
    handled = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    before = {which: signal.getsignal(which) for which in handled}
    yield SeatLife()
    for which, handler in before.items():
        signal.signal(which, handler)


def test_before_the_loop_ctrl_c_ends_it_at_once(life: SeatLife) -> None:
    with pytest.raises(Stopped):
        os.kill(os.getpid(), signal.SIGINT)
    assert (life.stopping, life.leaving, life.signal) == (True, False, signal.SIGINT)
    with pytest.raises(Stopped):
        life.begin()


@pytest.mark.parametrize("sight", [Sight.GONE, Sight.ENDING])
def test_in_the_loop_it_lets_go_first(life: SeatLife, sight: Any) -> None:
    seen: list[int] = []
    life.seen = lambda: seen.append(1)
    life.check()
    assert not seen, "nothing is felt before the loop"
    life.enter_loop()
    try:
        life.check()
        assert seen
        assert not life.leaving
        life.watch = lambda: sight
        life.check()
        assert (life.stopping, life.leaving, life.orphaned) == (False, True, sight is Sight.GONE)
        os.kill(os.getpid(), signal.SIGTERM)
        assert (life.stopping, life.signal) == (True, signal.SIGTERM), "a request while it leaves ends it at once"
    finally:
        life.leave_loop()


def test_a_life_begins_anew_for_another_attempt(life: SeatLife) -> None:
    life.enter_loop()
    life.watch = lambda: Sight.GONE
    life.check()
    life.leave_loop()
    life.begin()
    assert (life.stopping, life.leaving, life.orphaned, life.failure) == (False, False, False, None)
    life.check()
    assert not life.leaving


@pytest.mark.parametrize(("own", "most"), [(None, 8.0), (3.0, 3.0), (100.0, 8.0)])
def test_the_force_that_a_guest_may_feel_is_the_lesser_of_two_limits_and_is_shown(
    own: float | None, most: float
) -> None:
    session = load_named("ball")
    bundle = cut(prepare(session), RunPlan("realtime", None, "tcp://192.0.2.7:7400"))["right"]
    assert isinstance(bundle, DeviceBundle)
    device = with_force(bundle, own)
    assert device.limits.force == (most,)
    assert (device.limits.speed, device.limits.displacement) == (bundle.limits.speed, bundle.limits.displacement)
    assert force_sentence(device) == f"the device may push with up to {most:g} N"
    assert force_sentence(with_force(bundle, None)) == "the device may push with up to 8 N"
