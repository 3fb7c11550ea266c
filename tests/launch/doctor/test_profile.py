"""A machine's profile: from measured delays to tau, and the file that is kept of it."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.doctor import profile as profiles
from manyhands.launch.doctor.probe import Way
from manyhands.launch.doctor.profile import (
    LEAST_KEPT,
    MOST_AGE,
    QUANTILE,
    STEPS,
    Lateness,
    Profile,
    allowance,
    allowances_of_sites,
    cache_folder,
    drop_profile,
    keep_profile,
    kept_profile,
    outlived,
)
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.sites import site_loop
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named

NOW = 1_800_000_000.0
KEY: dict[str, Any] = {"period": 1e-3, "places": [[0, 1]]}


def a_profile(p995: float = 680.0, **changes: Any) -> Profile:
    """Measured just now on a machine whose slowest device has this p99.5, us."""
    tau = Lateness(p995 / 2, p995, 2 * p995, 3 * p995)
    return replace(Profile(KEY, tau, 1076.0, 0.004, 2.0, NOW), **changes)


# --- from what was measured to what is designed for


@pytest.mark.parametrize(
    ("p995", "T", "tau"),
    [
        (680.0, 1e-3, 0.75e-3),  # 14 steps of 50 us, and one in reserve
        (700.0, 1e-3, 0.75e-3),
        (700.1, 1e-3, 0.8e-3),
        (1.0, 1e-3, 0.1e-3),
        (949.0, 1e-3, 1e-3),
        (999.0, 1e-3, 1e-3),
        (5000.0, 1e-3, 1e-3),
        (120.0, 0.25e-3, 0.1375e-3),
    ],
)
def test_tau_is_the_quantile_rounded_up_with_a_reserve_at_most_the_period(p995: float, T: float, tau: float) -> None:
    assert allowance(a_profile(p995), T).tau == tau


@given(st.floats(1e-3, 1e5), st.floats(1e-3, 1e5), st.sampled_from([1e-2, 1e-3, 5e-4, 1e-5]))
def test_a_longer_delay_never_asks_for_less(a: float, b: float, T: float) -> None:
    less, more = (allowance(a_profile(p995), T) for p995 in sorted((a, b)))
    assert less.tau <= more.tau <= T
    assert less.tau >= 2 * T / STEPS * (1 - 1e-9)
    for chosen in (less, more):
        assert chosen.covered is (chosen.found <= T)
        assert not chosen.covered or chosen.tau >= chosen.found * (1 - 1e-9)


@pytest.mark.parametrize(
    ("period", "rho"), [(1000.0, 0.05), (990.0, 0.05), (1001.0, 0.1), (1076.0, 0.15), (1900.0, 0.95), (9000.0, 1.0)]
)
def test_longer_periods_are_covered_likewise(period: float, rho: float) -> None:
    assert allowance(a_profile(period=period), 1e-3).period_tolerance == pytest.approx(rho)


@given(st.lists(st.integers(1, 10**7), min_size=1, max_size=500))
def test_the_quantile_is_a_delay_and_leaves_out_no_more_than_it_may(delays: list[int]) -> None:
    found = Lateness.of(delays)
    assert found.p50 <= found.p995 <= found.p999 <= found.max == max(delays) / 1e3
    assert sum(delay / 1e3 > found.p995 for delay in delays) <= (1 - QUANTILE) * len(delays)


@pytest.mark.parametrize(
    ("p99", "p999", "ticks", "found"),
    [
        (600.0, 900.0, 5000, False),
        (751.0, 2000.0, 5000, True),  # the run was slower than what was designed for
        (300.0, 679.0, 5000, True),  # and quicker: its p99.9 is below the profile's p99.5
        (300.0, 679.0, 500, False),  # of too few ticks to say so
    ],
)
def test_a_run_may_show_that_a_profile_does_not_hold(p99: float, p999: float, ticks: int, found: bool) -> None:
    device = {"ticks": ticks, "tau_us": {"p50": 200.0, "p99": p99, "p999": p999, "max": 3000.0}}
    assert outlived(a_profile(), load_named("example1"), {"dx": device, "cx": {"ticks": ticks}}) is found


def test_what_a_driver_states_of_its_device_is_no_part_of_a_profile() -> None:
    device = {"ticks": 5000, "tau_us": {"p50": 800.0, "p99": 900.0, "p999": 1000.0, "max": 4000.0}}
    assert outlived(a_profile(), load_named("example1"), {"dx": device})
    plugged = "devices.dx={dof: 1, osp: 1.37, driver: some.package:factory, actuation_delay: 0.0002}"
    assert not outlived(a_profile(), load_named("example1", [plugged]), {"dx": device})


def test_a_run_without_figures_shows_nothing() -> None:
    assert not outlived(a_profile(), load_named("example1"), {"cx": {"ticks": 5000}})


# --- sites with a period of their own


@pytest.fixture(scope="module")
def sites() -> Session:
    """dx ticks at 4 kHz; dy and dz, as their world, at 1 kHz."""
    link = "{mass: 0.05, round_trip: 0.004}"
    of_dx = "couplings.cx.wave_link={mass: 0.05, round_trip: 0.004, period: 0.00025}"
    return load_named("example1", [of_dx, *(f"couplings.{name}.wave_link={link}" for name in ("cy", "cz"))])


def of_sites(quick: float = 90.0, slow: float = 310.0) -> Profile:
    """The delays of dx, and of the slower one of dy and dz, us."""
    return a_profile(quick, period=250.0, others={1e-3: Lateness(slow / 2, slow, 2 * slow, 3 * slow)})


def test_each_period_has_the_delay_of_its_own_devices(sites: Session) -> None:
    chosen = allowance(of_sites(), sites.device_period)
    taus = {name: one.tau for name, one in allowances_of_sites(of_sites(), sites).items()}
    assert (chosen.tau, taus) == (0.1125e-3, {"cy": 0.4e-3, "cz": 0.4e-3})
    settled = sites.with_delay(chosen.tau, chosen.period_tolerance, taus)
    delays = {name: site_loop(settled, name).tau for name in sites.wave_links}
    assert delays == {"cx": 0.1125e-3, "cy": 0.4e-3, "cz": 0.4e-3}
    assert all(link.tau is None for link in sites.wave_links.values())  # the session itself is as it was


def test_a_delay_that_a_wave_link_states_is_its_own(sites: Session) -> None:
    stated = sites.with_delay(1e-4, 0.0, {"cy": 0.7e-3}).with_delay(1e-4, 0.0, {"cy": 0.4e-3, "cz": 0.4e-3})
    assert {name: link.tau for name, link in stated.wave_links.items()} == {"cx": None, "cy": 0.7e-3, "cz": 0.4e-3}


@pytest.mark.parametrize(
    ("dx", "dy", "found"), [(100.0, 390.0, False), (120.0, 390.0, True), (100.0, 420.0, True), (50.0, 100.0, True)]
)
def test_a_run_is_held_against_the_delays_of_each_period(sites: Session, dx: float, dy: float, found: bool) -> None:
    nodes = {
        name: {"ticks": 5000, "tau_us": {"p50": 1.0, "p99": p99, "p999": 1.5 * p99, "max": 5000.0}}
        for name, p99 in (("dx", dx), ("dy", dy))
    }
    assert outlived(of_sites(), sites, nodes) is found


# --- the key


def key(*overrides: str, transport: str = "ipc", encrypted: bool = False, name: str = "example1") -> dict[str, Any]:
    return profiles.profile_key(Plan(load_named(name, overrides)), transport, encrypted, {})


def test_sessions_of_one_form_share_a_profile() -> None:
    same = ["devices.dx.mass=0.4", "design.objective=stiffest", "environment.links.0.stiffness=1000", "session=other"]
    assert key(*same) == key() == key(name="example1-delayed")
    assert json.loads(json.dumps(key())) == key()


@pytest.mark.parametrize(
    "other",
    [
        lambda: key("period=0.002"),
        lambda: key("colocate=true"),
        lambda: key(name="example1-centralised"),
        lambda: key(name="browser"),
        lambda: key(transport="tcp"),
        lambda: key(transport="tcp", encrypted=True),
        lambda: profiles.profile_key(Plan(load_named("example1")), "ipc", False, {"dx": 0}),
    ],
)
def test_another_form_has_another_key(other: Callable[[], dict[str, Any]]) -> None:
    assert other() != key()


def test_another_machine_or_version_has_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    before = key()
    for name, value in (("__version__", "0"), ("may_raise", lambda: None), ("has_compiled_tick", lambda: None)):
        with monkeypatch.context() as context:
            context.setattr(profiles, name, value)
            assert key() != before
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {77})
    assert key()["processors"] == [77]


def test_links_over_ipc_have_no_encryption_in_their_key() -> None:
    plan = Plan(load_named("example1"))
    assert Way.of_run(plan, "ipc", encrypted=True).profile_key(plan) == Way.of_run(plan, "ipc", False).profile_key(plan)
    assert Way.of_run(plan, "tcp", encrypted=True).profile_key(plan)["encrypted"] is True


# --- the file


def test_what_is_kept_is_read_as_it_was_by_this_user_alone(tmp_path: Path) -> None:
    folder = tmp_path / "cache" / "manyhands" / "profiles"
    assert keep_profile(a_profile(), folder)
    assert kept_profile(KEY, NOW + 60.0, folder) == a_profile()
    (file,) = folder.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
    assert keep_profile(a_profile(500.0), folder)
    assert kept_profile(KEY, NOW, folder) == a_profile(500.0)
    assert keep_profile(of_sites(), folder)
    assert kept_profile(KEY, NOW, folder) == of_sites()
    assert kept_profile(KEY | {"period": 2e-3}, NOW, folder) is None
    drop_profile(a_profile(), folder)
    drop_profile(a_profile(), folder)
    assert list(folder.iterdir()) == []
    assert kept_profile(KEY, NOW, folder) is None


@pytest.mark.parametrize(
    ("now", "used"), [(NOW, True), (NOW + MOST_AGE, True), (NOW + MOST_AGE + 1.0, False), (NOW - 1.0, False)]
)
def test_a_profile_is_used_for_a_day_and_not_before_it_was_measured(now: float, used: bool, tmp_path: Path) -> None:
    keep_profile(a_profile(), tmp_path)
    assert (kept_profile(KEY, now, tmp_path) is not None) is used


def test_too_short_a_measurement_is_not_kept(tmp_path: Path) -> None:
    assert not keep_profile(a_profile(seconds=LEAST_KEPT / 2), tmp_path / "none")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_is_not_used(mode: int, tmp_path: Path) -> None:
    keep_profile(a_profile(), tmp_path)
    (file,) = tmp_path.iterdir()
    file.chmod(mode)
    assert kept_profile(KEY, NOW, tmp_path) is None


def test_a_file_of_another_user_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_profile(a_profile(), tmp_path)
    monkeypatch.setattr(os, "geteuid", lambda: 4_000_000_000)
    assert kept_profile(KEY, NOW, tmp_path) is None


BROKEN: dict[str, Callable[[dict[str, Any]], object]] = {
    "no object": lambda _: [1],
    "another key": lambda plain: plain | {"key": {"period": 1.0}},
    "no delays": lambda plain: plain | {"tau": None},
    "a delay that is missing": lambda plain: plain | {"tau": {"p50": 1.0}},
    "delays that do not grow": lambda plain: plain | {"tau": plain["tau"] | {"p50": 9e9}},
    "a delay of 0": lambda plain: plain | {"tau": dict.fromkeys(plain["tau"], 0.0)},
    "a text": lambda plain: plain | {"period": "1076"},
    "a truth": lambda plain: plain | {"period": True},
    "a negative number": lambda plain: plain | {"late": -0.1},
    "no other periods": lambda plain: plain | {"others": None},
    "another period without delays": lambda plain: plain | {"others": {"0.001": None}},
    "another period that is no number": lambda plain: plain | {"others": {"T": plain["tau"]}},
    "other delays that do not grow": lambda plain: plain | {"others": {"0.001": plain["tau"] | {"p50": 9e9}}},
    "the format of version 0.6": lambda plain: plain | {"format": 2, "others": [[1e-3, plain["tau"]]]},
}


@pytest.mark.parametrize("change", BROKEN.values(), ids=BROKEN)
def test_a_damaged_file_is_no_profile(change: Callable[[dict[str, Any]], object], tmp_path: Path) -> None:
    keep_profile(a_profile(), tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_text(json.dumps(change(json.loads(file.read_text()))))
    assert kept_profile(KEY, NOW, tmp_path) is None


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"[" * 100_000, b'{"late": NaN}'])
def test_what_is_no_json_is_no_profile(content: bytes, tmp_path: Path) -> None:
    keep_profile(a_profile(), tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(content)
    assert kept_profile(KEY, NOW, tmp_path) is None
    assert keep_profile(a_profile(), tmp_path)
    assert kept_profile(KEY, NOW, tmp_path) == a_profile()


def test_the_folder_is_the_users_cache() -> None:
    assert cache_folder({"XDG_CACHE_HOME": "/c", "HOME": "/h"}) == Path("/c/manyhands/profiles")
    assert cache_folder({"XDG_CACHE_HOME": "c", "HOME": "/h"}) == Path("/h/.cache/manyhands/profiles")
    assert cache_folder({"HOME": "/h"}) == Path("/h/.cache/manyhands/profiles")
