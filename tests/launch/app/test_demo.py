"""What the demonstration concludes: its last sentence, its exit code, and what became of the run without coupling."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.app.demo import LIMITED, how_it_ended, velocities_of_run, verdict
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace
from manyhands.launch.session.shipped import load_named
from manyhands.protocol.channels import TOPICS
from manyhands.protocol.messages import Role

from ...support.small_recordings import RECORDED

PROMISE = {"tau": 0.0007, "period_tolerance": 0.25, "enforced": True, "tank": 0.005, "power": 0.001}


def device(least: float = 0.0, final_speed: float = 0.0, margin: float = 0.005) -> dict[str, Any]:
    account = {
        "min": least,
        "margin": 0.005 + least,
        "final": 0.02,
        "changed_ticks": 3,
        "kept_back": 0.0005,
        "offset": 0.0,
    }
    return {
        **{"ticks": 1000, "late": 5, "tau_breaches": 2, "peak_speed": 0.4, "final_speed": final_speed},
        **{"interface": account, "ledger": {"min": 0.0, "final": 0.02, "at": 0, "margin": margin}},
    }


def report(dx: dict[str, Any], promise: dict[str, Any] | None = None) -> dict[str, Any]:
    coupling = {"ticks": 1000, "ledger": {"min": 0.0, "final": 0.0, "at": 0, "margin": 0.0}}
    nodes = {"dx": dx, "dy": device(), "cx": coupling, "environment": coupling}
    return {"nodes": nodes, "lateness": PROMISE if promise is None else promise}


def test_a_run_that_kept_everything() -> None:
    sentence, kept = verdict(report(device(least=-0.002)))
    assert kept
    assert sentence == (
        "all 4 promises were kept, and every device came to rest; the least energy account was -2 mJ (bound "
        "-5 mJ, falling by 1 mW); "
        "10 of 2000 ticks were late, 4 beyond the certified τ; 1 mJ was held back by enforcement"
    )


@pytest.mark.parametrize(
    ("dx", "words"),
    [
        (device(least=-0.0051), "promises broken by dx, and every device came to rest"),
        (device(margin=-1e-6), "promises broken by dx, and every device came to rest"),
        (device(final_speed=0.4e-3), "all 4 promises were kept, and not every device came to rest (dx)"),
    ],
)
def test_a_run_that_did_not(dx: dict[str, Any], words: str) -> None:
    sentence, kept = verdict(report(dx))
    assert not kept
    assert sentence.startswith(words)


def test_without_devices_in_wall_time_nothing_is_reported_of_lateness() -> None:
    still = {key: value for key, value in device().items() if key != "interface"}
    sentence, kept = verdict({"nodes": {"dx": still, "dy": still}})
    assert (sentence, kept) == ("all 2 promises were kept, and every device came to rest", True)


def recorded_run(f_v: list[list[float]], **instants: list[float]) -> RecordedRun:
    """A run of two devices with these forces, whose positions are 0, 0.1 and 0.4 m; T is 0.1 s."""
    about = replace(RECORDED, clock="realtime", period=0.1, roles=dict.fromkeys(("dx", "dy"), Role.DEVICE),
                    ports={"dx": ("x",), "dy": ("y",)}, masses=())  # fmt: skip
    topics = {topic.name: topic for topic in TOPICS[Role.DEVICE]}
    traces = {}
    for name, f in zip(("dx", "dy"), f_v, strict=True):
        x = np.array([[0.0], [0.1], [0.4]])[: len(f)]
        traces[name, "sample"] = RecordedTrace(topics["sample"], (name,), x)
        traces[name, "force"] = RecordedTrace(topics["force"], (name,), np.array(f)[:, None])
    for name, at in instants.items():
        ns = np.array([[sampled, sampled, sampled] for sampled in at]) * 1e9
        traces[name, "instants"] = RecordedTrace(topics["instants"], ("sampled", "applied", "ended"), ns)
    return RecordedRun(about, traces)


def test_how_a_run_without_coupling_ended() -> None:
    run = recorded_run([[0.0, np.nan, 0.0], [1.0, -2.0, 0.0]])
    ended = how_it_ended(run, {"dx": {"let_go": 1}, "dy": {"let_go": 2}, "cx": {}})
    assert ended == "dx, dy exceeded 0.2 m or 3 m/s and let go; no force after 0.2 s"
    within = how_it_ended(run, {"dx": {"let_go": 0, "peak_speed": 2.0}, "cx": {}})
    assert within == "within 0.2 m and 3 m/s to the end, up to 2 m/s"
    assert how_it_ended(recorded_run([[0.0], [0.0]]), {"dx": {"let_go": 1}}).endswith("no force after 0.0 s")


def test_velocities_are_those_between_the_instants_of_the_samples() -> None:
    forces = [[0.0] * 3, [0.0] * 3]
    x, y = velocities_of_run(recorded_run(forces, dx=[0.0, 0.1, 0.4], dy=[0.0, 0.1, 0.1]), "title").panel.curves
    np.testing.assert_allclose(x.values, [np.nan, 1.0, 1.0])  # the second period was three times as long
    np.testing.assert_allclose(y.values, [np.nan, 1.0, np.nan])
    x, _ = velocities_of_run(recorded_run(forces), "title").panel.curves  # in own time every period is T
    np.testing.assert_allclose(x.values, [0.0, 1.0, 3.0])


def test_the_session_without_coupling_has_the_limits_that_the_picture_names() -> None:
    session = load_named(Path("example1-uncoupled.yaml"), [*LIMITED])
    for own in session.devices.values():
        assert (own.limits.displacement, own.limits.speed) == ((0.2,), (3.0,))
