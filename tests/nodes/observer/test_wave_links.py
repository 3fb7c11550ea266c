"""A session with wave links as an observer sees it: sites of their own period, and what is felt of each link."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.nodes.observer.scene import About, AboutError, Scene
from manyhands.protocol.clock import Instant

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
    scene = Scene(LINKED)
    scene.take(telemetry("d", 4000), Instant(0))
    scene.take(telemetry("cy", 990), Instant(0))
    assert scene.tick == 1000


def test_what_is_felt_of_a_link_is_known_once_both_ends_have_reported() -> None:
    scene = Scene(LINKED)
    figures = {"wave_lag_us": 1312.5, "wave_tank": 5e-3, "wave_clipped": 0.0, "wave_silences": 0.0,
               "wave_deaf": 0.0}  # fmt: skip
    scene.take(telemetry("cx", 4000, **figures), Instant(0))
    assert scene.felt_links == {}
    scene.take(telemetry("environment", 1000, **{f"{name}_cx": v for name, v in figures.items()}), Instant(0))
    assert scene.felt_links.keys() == {"cx"}
    assert scene.felt_links["cx"].round_trip == pytest.approx(2.625e-3)


def test_the_delay_that_is_covered_is_that_of_the_devices_own_certificate() -> None:
    assert ABOUT.certificate is not None
    certificate = replace(ABOUT.certificate, tau=1e-4, taus={"d": 2e-4})
    assert Scene(replace(LINKED, certificate=certificate)).covered_tau("d") == 2e-4
