"""The delay that is measured and the delay that a driver states add up, in what is to be certified."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from manyhands.launch.app.start import SettledDelay, SettledForm, settle_delay
from manyhands.launch.doctor.advice import Worth
from manyhands.launch.doctor.probe import Form, longer_period
from manyhands.launch.doctor.profile import Lateness, Profile, Stated, allowance
from manyhands.launch.doctor.rates import form_figures
from manyhands.launch.plan.loop import NotCertified, haptic_loop
from manyhands.launch.plan.sites import site_loop
from manyhands.launch.run.options import StartOptions
from manyhands.launch.session import Session, load_session
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED

T = 1e-3


def session_of(folder: Path, **device: Any) -> Session:
    content = {
        "session": "plugged",
        "period": T,
        "devices": {"d": {"dof": 1, "osp": 1.37, "driver": "some.package:factory", **device}},
        "couplings": {"c": {"devices": ["d"]}},
        "environment": {"type": "network", "links": [{"between": ["d", "ground"], "stiffness": 100}]},
        "design": {"coupling": "spring-damper"},
    }
    (folder / "session.yaml").write_text(json.dumps(content), encoding="utf-8")
    return load_session(folder / "session.yaml")


def settled(session: Session, clock: str = REALTIME) -> SettledDelay:
    return settle_delay(SettledForm(session), StartOptions(clock), Console(quiet=True))


@pytest.fixture(autouse=True)
def profile(monkeypatch: pytest.MonkeyPatch) -> Profile:
    """This machine's, as if it had been measured before."""
    measured = Profile({}, Lateness(200.0, 320.0, 500.0, 900.0), 1010.0, 0.0, 5.0, time.time())
    monkeypatch.setattr("manyhands.launch.doctor.delay.kept_profile", lambda *_: measured)
    return measured


def test_a_stated_latency_is_added_to_the_measured_delay(tmp_path: Path, profile: Profile) -> None:
    chosen = allowance(profile, T)
    prompt = settled(session_of(tmp_path)).session
    assert haptic_loop(prompt).tau == chosen.tau
    found = settled(session_of(tmp_path, sample_age=2e-4, actuation_delay=1e-4))
    late = found.session
    assert found.profile is profile
    assert found.measured
    assert haptic_loop(late).tau == pytest.approx(chosen.tau + 3e-4, abs=1e-12)
    assert haptic_loop(late).period_tolerance == pytest.approx(chosen.period_tolerance + 0.2)
    steady = settled(session_of(tmp_path, sample_age=2e-4, age_jitter=0.0)).session
    assert haptic_loop(steady).period_tolerance == chosen.period_tolerance


@pytest.mark.parametrize("stated", [
    {}, {"sample_age": 2e-4, "actuation_delay": 1e-4}, {"sample_age": 3e-4, "age_jitter": 0.0},
    {"actuation_delay": 6e-4}, {"actuation_delay": 7e-4},
])  # fmt: skip
@pytest.mark.parametrize("tolerance", [0.0, 0.3])
def test_what_the_doctor_shows_is_what_a_launch_designs_for(
    tmp_path: Path, profile: Profile, stated: dict[str, float], tolerance: float
) -> None:
    """One model of the delay: its figures are those of the loop that is launched, or both say that there is none."""
    session = session_of(tmp_path, **stated)
    session = session.replace({"design.period_tolerance": tolerance})
    worth = Worth.of(haptic_loop(session.with_delay(0.0)), Stated.of(session))
    (shown,) = form_figures(worth, {Form(T, session.colocated): profile})
    assert shown.chosen is not None
    try:
        loop = haptic_loop(settled(session).session)
    except NotCertified:
        assert (shown.chosen.covered, shown.certified) == (False, 0.0)
        assert stated == {"actuation_delay": 7e-4}
        return
    assert (shown.chosen.tau, shown.chosen.period_tolerance) == (loop.tau, loop.period_tolerance)
    assert shown.certified == Worth.of(loop).weakest(loop.tau)
    assert worth.weakest_of_tick(100.0) == pytest.approx(worth.weakest(session.latency + 1e-4))


@pytest.mark.parametrize(
    ("delay", "p995", "longer"),
    [(7e-4, 320.0, 1.2e-3), (9e-4, 900.0, 2e-3)],  # in 1.9 ms, 0.9 ms are ten steps, and one in reserve: 1.045 ms
)
def test_where_the_stated_latency_leaves_no_room_the_doctor_measures_a_longer_period(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, delay: float, p995: float, longer: float
) -> None:
    profile = Profile({}, Lateness(200.0, p995, p995, p995), 1010.0, 0.0, 5.0, time.time())
    monkeypatch.setattr("manyhands.launch.doctor.delay.kept_profile", lambda *_: profile)
    session = session_of(tmp_path, actuation_delay=delay)
    assert longer_period(profile, Stated.of(session)) == longer
    slower = session.replace({"period": longer})
    assert haptic_loop(settled(slower).session).tau <= longer


def test_more_than_a_period_together_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        NotCertified, match=r"0\.4 ms \(measured here, just now: p99\.5 is 0\.32 ms\), and 0\.7 ms of sample_age"
    ):
        settled(session_of(tmp_path, actuation_delay=7e-4))
    settled(session_of(tmp_path, actuation_delay=6e-4))


def test_a_site_with_another_period_has_its_own_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    own = {1e-3: Lateness(150.0, 310.0, 400.0, 500.0)}
    measured = Profile({}, Lateness(40.0, 90.0, 120.0, 200.0), 255.0, 0.0, 5.0, time.time(), own)
    monkeypatch.setattr("manyhands.launch.doctor.delay.kept_profile", lambda *_: measured)
    plugged = "devices.dy={{dof: 1, osp: 1.37, driver: some.package:factory, actuation_delay: {}}}".format
    links = [f"couplings.{name}.wave_link={{b: 10, period: {T}}}" for name, T in (("cx", 25e-5), ("cy", 1e-3))]
    session = load_named("example1", [plugged(0.0001), *links, "couplings.cz.wave_link={b: 10}"])
    found = settled(session).session
    delays = {name: site_loop(found, name).tau for name in found.wave_links}
    # a device's own delay counts for its own site, and for the design's, which any device may have
    assert delays == pytest.approx({"cx": 2.125e-4, "cy": 5e-4, "cz": 4e-4}, abs=1e-12)
    late = load_named("example1", [plugged(0.0002), *links, "couplings.cz.wave_link={b: 10}"])
    with pytest.raises(NotCertified, match=r"expected at most the period of"):
        settled(late)


def test_without_a_measurement_the_latency_alone_is_certified(tmp_path: Path) -> None:
    found = settled(session_of(tmp_path, actuation_delay=7e-4), SIMULATED)
    assert haptic_loop(found.session).tau == 7e-4
    assert not found.measured
