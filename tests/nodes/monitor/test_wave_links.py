"""A session with wave links as an observer sees it: sites of their own period, and what is felt of each link."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.nodes.monitor.health import Health
from manyhands.nodes.monitor.session_state import About, AboutError, LiveSession
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, PromiseStatus

from ...support.observed_frames import ABOUT, telemetry

SITE = {
    "d": replace(ABOUT.nodes["d"], period=0.00025),
    "cx": replace(ABOUT.nodes["cx"], period=0.00025, impedance=(20.0, 20.0)),
}
LINKED = replace(ABOUT, nodes={**ABOUT.nodes, **SITE})
"""The device d and the coupling cx are at a site of 4 kHz, behind a wave link."""


def test_its_description_is_read_back(tmp_path: Path) -> None:
    LINKED.save(tmp_path)
    assert About.load(tmp_path) == LINKED
    assert LINKED.linked == ("cx",)
    assert (LINKED.rate_of("d"), LINKED.rate_of("cy")) == (4.0, 1.0)


@pytest.mark.parametrize("period", [0.0, -1.0, "1"])
def test_a_period_that_makes_no_sense_is_refused(tmp_path: Path, period: object) -> None:
    plain = LINKED.as_plain()
    plain["nodes"]["d"]["period"] = period
    (tmp_path / "about.json").write_text(json.dumps(plain))
    with pytest.raises(AboutError):
        About.load(tmp_path)


def test_its_tick_is_the_sessions() -> None:
    scene = LiveSession(LINKED)
    scene.take(telemetry("d", 4000), Instant(0))
    scene.take(telemetry("cy", 990), Instant(0))
    assert scene.tick == 1000


def test_what_is_felt_of_a_link_is_known_once_both_ends_have_reported() -> None:
    scene = LiveSession(LINKED)
    figures = {"wave_lag_us": 1312.5, "wave_tank": 5e-3, "wave_clipped": 0.0, "wave_silences": 0.0,
               "wave_holding": 0.0}  # fmt: skip
    scene.take(telemetry("cx", 4000, **figures), Instant(0))
    assert scene.felt_links == {}
    scene.take(
        telemetry("environment", 1000, tables={names.of(name): {"cx": v} for name, v in figures.items()}), Instant(0)
    )
    assert scene.felt_links.keys() == {"cx"}
    assert scene.felt_links["cx"].round_trip == pytest.approx(2.625e-3)


CALM = {"wave_tank": 5e-3, "wave_clipped": 0.0, "wave_silences": 0.0, "wave_holding": 0.0}


@pytest.mark.parametrize(
    ("states", "figures", "line", "health"),
    [
        ({"d": "free", "cx": "free"}, True, "seat cx: free", Health.FREE),
        ({"d": "free", "cx": "starting"}, False, "seat cx: joining, waiting", Health.WAITING),
        ({"d": "ready", "cx": "running"}, False, "seat cx: joining, waiting", Health.WAITING),
        ({}, False, "seat cx: in, ok", Health.OK),
        ({}, True, "seat cx: in, R = 5 ms, K = 8000 N/m, M = 50 g, ok", Health.OK),
        ({"silent": "d"}, True, "seat cx: in, R = 5 ms, K = 8000 N/m, M = 50 g, silent", Health.SILENT),
        ({"frozen": "cx"}, True, "seat cx: in, R = 5 ms, K = 8000 N/m, M = 50 g, frozen", Health.FROZEN),
    ],
)
def test_the_lobby_shows_who_is_in(states: dict[str, str], figures: bool, line: str, health: Health) -> None:
    scene = LiveSession(replace(LINKED, seats={"cx": "d"}))
    if figures:
        scene.take(telemetry("cx", 4000, wave_lag_us=4e3, **CALM), Instant(0))
        world = {names.of(name): {"cx": value} for name, value in {**CALM, "wave_lag_us": 1e3}.items()}
        scene.take(telemetry("environment", 1000, tables=world), Instant(0))
    stand = {**dict.fromkeys(LINKED.nodes, "running"), **states}
    silent, frozen = (tuple(name for name in [stand.pop(what, "")] if name) for what in ("silent", "frozen"))
    rows = tuple(PromiseStatus("presence", "enforced", (name,), 1.0) for name in frozen)
    scene.take(encode(Condition("running", 1.0, stand, silent, promises=rows)), Instant(0))
    [seat] = scene.lobby
    assert (seat.sentence(), seat.health) == (line, health)
    assert seat.as_plain()["state"] == line.split(": ")[1].split(",")[0]
    assert (scene.link_health(LINKED.links[2]) is Health.FREE) == ("free" in stand.values())
    assert (scene.health is Health.OK) == (health in (Health.FREE, Health.OK))


def test_the_delay_that_is_covered_is_that_of_the_devices_own_certificate() -> None:
    assert ABOUT.certificate is not None
    certificate = replace(ABOUT.certificate, tau=1e-4, taus={"d": 2e-4})
    assert LiveSession(replace(LINKED, certificate=certificate)).covered_tau("d") == 2e-4
