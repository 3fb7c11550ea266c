"""The scene built from a running session's broadcast: rates and health, frame by frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.monitor.health import Health
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.monitor.session_state import (
    LATE_SHARE,
    RATE_ACCURACY,
    RATE_OVER,
    About,
    LinkAbout,
    LiveSession,
    NodeAbout,
)
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role, Stop

STEP = 100_000_000  # ns between two telemetries


def about() -> About:
    return About(
        session="s", id="i", pid=1, clock="realtime", transport="ipc", period=0.001, ticks=0, started=0.0,
        nodes={"d": NodeAbout(Role.DEVICE, ("d",)), "c": NodeAbout(Role.COUPLING, ("d",)),
               "environment": NodeAbout(Role.ENVIRONMENT, ("d",))},
        links=(LinkAbout(("c", "environment"), ("d",)), LinkAbout(("d", "c"), ("d",))),
        masses={}, springs=(), grips=(), reach={}, certificate=None, environment="network",
    )  # fmt: skip


class Seen:
    """A scene whose frames come by a clock of the test's own."""

    def __init__(self) -> None:
        self.live, self.at = LiveSession(about()), 0
        self.model = HealthModel(about().terms)

    def tell(self, node: str, tick: int, after: int = STEP, **numbers: float) -> None:
        self.at += after
        figures = Figures(numbers)
        self.model.take(node, tick, figures)
        self.live.take(encode(Observation(node, tick, figures, {"x": np.zeros((1, 1))})), Instant(self.at))

    def condition(self, silent: tuple[str, ...] = (), phase: str = "running", **states: str) -> None:
        stand = {"d": "running", "c": "running", "environment": "running", **states}
        self.model.look(stand, silent)
        self.live.take(encode(Condition(phase, 1.0, stand, silent, promises=self.model.rows())), Instant(self.at))

    def telemetries(self, node: str, count: int, ticks: int = 100, late: int = 0) -> None:
        """So many telemetries, with so many ticks and late ones between any two."""
        for number in range(1, count + 1):
            self.tell(node, number * ticks, late=float(number * late))


def test_the_rate_counts_ticks_between_looks_half_a_second_apart() -> None:
    seen = Seen()
    seen.tell("d", 100)
    assert seen.live.nodes["d"].rate is None
    for number in range(2, 6):
        seen.tell("d", 100 * number)
        assert seen.live.nodes["d"].rate is None  # not yet half a second
    seen.tell("d", 600)
    assert seen.live.nodes["d"].rate == pytest.approx(1000.0)
    for number in range(1, 1 + RATE_OVER // STEP):
        seen.tell("d", 600 + 50 * number)
    assert seen.live.nodes["d"].rate == pytest.approx(500.0)


@pytest.mark.parametrize("restarted", [{"tick": 40, "late": 300.0}, {"tick": 5000, "late": 0.0}])
def test_a_new_process_that_counts_from_nothing_is_looked_at_anew(restarted: dict[str, float]) -> None:
    """It may count its ticks from 0, or, where it joined the session again, its late ones alone."""
    seen = Seen()
    seen.condition()
    seen.telemetries("d", 8, late=50)
    assert seen.live.nodes["d"].health is Health.LATE
    seen.tell("d", int(restarted["tick"]), late=restarted["late"])
    assert (seen.live.nodes["d"].rate, seen.live.nodes["d"].health) == (None, Health.OK)
    for number in range(1, 6):
        seen.tell("d", int(restarted["tick"]) + 100 * number, late=restarted["late"])
    assert seen.live.nodes["d"].rate == pytest.approx(1000.0)
    assert seen.live.nodes["d"].health is Health.OK


@pytest.mark.parametrize(
    ("state", "silent", "late", "health"),
    [
        ("running", False, 0, Health.OK),
        ("running", False, 1, Health.OK),  # as many as every machine has now and then
        ("running", False, 2, Health.LATE),
        ("running", True, 0, Health.SILENT),
        ("running", True, 2, Health.SILENT),
        ("starting", False, 0, Health.WAITING),
        ("ready", False, 2, Health.WAITING),
        ("done", False, 0, Health.WAITING),
        ("ended", False, 0, Health.WAITING),
        ("lost", False, 0, Health.AWAY),
        ("lost", True, 2, Health.AWAY),
        ("leaving", False, 0, Health.AWAY),
        ("gone for good", False, 0, Health.AWAY),
        ("failed", False, 0, Health.AWAY),
        ("a word of another version", False, 0, Health.WAITING),
    ],
)
def test_how_a_node_is(state: str, silent: bool, late: int, health: Health) -> None:
    assert LATE_SHARE == 0.01
    seen = Seen()
    seen.condition()
    seen.telemetries("d", 6, late=late)
    seen.condition(silent=("d",) if silent else (), d=state)
    assert seen.live.nodes["d"].health is health
    rated = seen.live.nodes["d"].rate is not None
    assert rated == (state == "running" and not silent)  # a lost or silent node has no rate


def test_before_anything_is_heard_all_wait() -> None:
    scene = LiveSession(about())
    assert (scene.tick, scene.rate, scene.frozen, scene.condition) == (0, None, (), None)
    assert scene.health is Health.WAITING
    assert scene.link_health(scene.about.links[0]) is Health.WAITING


def test_links_show_their_worse_end_and_sessions_their_worst_node() -> None:
    seen = Seen()
    seen.condition(silent=("c",), d="lost")
    inner, outer = (seen.live.link_health(link) for link in seen.live.about.links)
    assert (inner, outer) == (Health.SILENT, Health.AWAY)
    assert seen.live.health is Health.AWAY
    seen.condition()
    assert seen.live.health is Health.OK


@pytest.mark.parametrize(
    ("frozen", "health"),
    [(0.0, Health.OK), (1.0, Health.FROZEN), (math.nan, Health.OK), (-1.0, Health.OK), (math.inf, Health.OK)],
)
def test_frozen_couplings_are_the_sessions_health(frozen: float, health: Health) -> None:
    seen = Seen()
    seen.condition()
    seen.tell("environment", 100, **({"frozen:c@50": frozen} if frozen != 0.0 else {}))
    seen.condition()
    assert seen.live.health is health
    assert seen.live.frozen == (("c",) if frozen == 1.0 else ())
    assert seen.live.nodes["c"].health is health  # it is named
    assert [seen.live.link_health(link) for link in seen.live.about.links] == [health, health]
    seen.condition(d="lost")
    assert seen.live.health is Health.AWAY  # which is worse


def test_the_sessions_rate_is_the_environments() -> None:
    seen = Seen()
    seen.telemetries("d", 6, ticks=50)
    assert seen.live.rate is None
    seen.telemetries("environment", 6)
    assert seen.live.rate == pytest.approx(1000.0)
    assert seen.live.tick == 600


@pytest.mark.parametrize(
    ("clock", "after", "words"),
    [
        ("realtime", 1.0, "1000 of 1000 / s"),
        ("realtime", 1.004, "996 of 1000 / s"),
        ("realtime", 1.0 - 0.9 * RATE_ACCURACY, "1000 of 1000 / s"),
        ("realtime", 1.0 - 1.5 * RATE_ACCURACY, "1015 of 1000 / s, catching up"),
        ("simulated", 0.25, "4000 / s, 4.0 times real time"),
        ("simulated", 2.0, "500 / s, 0.5 times real time"),
    ],
)
def test_no_rate_is_above_that_of_the_period_without_a_word(clock: str, after: float, words: str) -> None:
    seen = Seen()
    seen.live = LiveSession(replace(about(), clock=clock))
    assert seen.live.pace == ""
    for number in range(1, 30):  # more than half a second, however fast it is
        seen.tell("environment", 100 * number, after=round(after * STEP))
    assert seen.live.pace == words


@given(st.lists(st.one_of(
    st.binary(max_size=40),
    st.builds(Observation, st.sampled_from(["d", "c", "environment", "stranger"]), st.integers(0, 2**62),
              st.builds(Figures, st.dictionaries(st.sampled_from([names.LATE, names.FROZEN, "speed"]), st.floats())),
              st.just({})),
    st.builds(Condition, st.sampled_from(["running", "over"]), st.floats(0, 1e9),
              st.dictionaries(st.sampled_from(["d", "c", "x"]), st.sampled_from(["running", "lost", "odd"]))),
    st.just(Stop("no word of a broadcast's")),
), max_size=20))  # fmt: skip
def test_whatever_comes_is_taken_in_or_counted(frames: list[bytes | Observation | Condition | Stop]) -> None:
    scene, taken = LiveSession(about()), 0
    for number, frame in enumerate(frames):
        got = scene.take(frame if isinstance(frame, bytes) else encode(frame), Instant(number * STEP))
        known = isinstance(frame, Condition) or (isinstance(frame, Observation) and frame.node in scene.nodes)
        assert (got is not None) == known
        taken += got is not None
        assert scene.health in Health
        assert set(scene.frozen) <= set(scene.nodes)
    assert scene.malformed == len(frames) - taken
