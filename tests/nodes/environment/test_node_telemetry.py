"""The environment's telemetry of tools and masses: rows in order, each of a tick that its core has settled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.environment.core import environment_core
from manyhands.nodes.environment.node import EnvironmentTelemetry, TelemetryLater
from manyhands.nodes.kernel.bundle import EnvironmentBundle
from manyhands.nodes.link.join import WaveRow
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.protocol.messages import Figures, Telemetry

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
T = 0.001
AB = ("ca", "cb")


def environment(*overrides: str) -> EnvironmentBundle:
    prepared = prepare(load_session(SESSIONS / "example1-centralised.yaml", overrides), uncertified=True)
    bundle = cut(prepared, RunPlan("simulated", None, ""))["environment"]
    assert isinstance(bundle, EnvironmentBundle)
    return bundle


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("environment.enforce=true",),
        ("environment.delay=2", "design.coupling=given", "design.stiffness=500", "design.damping=1"),
    ],
)
def test_the_masses_are_where_newton_has_them(overrides: tuple[str, ...], new_line: Callable[[], Any]) -> None:
    """m (v(k) - v(k-1))/T = sum of the springs' and dampers' forces, from the telemetry of x_e and q alone."""
    bundle = environment(*overrides)
    m = len(bundle.common.ports)
    core, account, line = environment_core(bundle, np.eye(m) * 1e-3), EnvironmentTelemetry(bundle.common), new_line()
    rng = np.random.default_rng(1)
    p = np.cumsum(rng.normal(size=(bundle.common.telemetry_first, m)) * 1e-4, axis=0)
    for tick, row in enumerate(p):
        core.react(row.tolist())
        core.settle()
        account.tick(tick, core)
    assert account.due
    account.publish(line, core, {"frozen": 0.0}, {}, [], TickEvents())
    (told,) = line.telemetry
    assert (told.tick, told.figures) == (len(p), Figures({"frozen": 0.0, "began@0": 1.0}))
    x_e, q = told.traces["x_e"], told.traces["q"]
    assert x_e.shape == (len(p), m)
    assert q.shape == (len(p), 1)
    if core.ledger is None:
        assert "ledger" not in told.traces
    else:
        assert told.traces["ledger"][-1, 0] == core.ledger.total
    late = next((int(o[-1]) for o in overrides if o.startswith("environment.delay")), 0)  # it feels tools of then
    x_e = np.vstack([np.zeros((late, m)), x_e])[: len(p)]
    mass, ground = 3.0, (2600.0, 0.5)
    hands = list(zip((3800.0, 3500.0, 3300.0), (0.1, 0.2, 0.3), strict=True))
    v, w = np.diff(q[:, 0], prepend=0.0) / T, np.diff(x_e, axis=0, prepend=np.zeros((1, m))) / T
    pull = sum(k * (x_e[:, i] - q[:, 0]) + b * (w[:, i] - v) for i, (k, b) in enumerate(hands))
    force = pull - ground[0] * q[:, 0] - ground[1] * v
    inertia = mass * np.diff(v, prepend=0.0) / T
    np.testing.assert_allclose(
        inertia, force, atol=1e-6 * np.abs(force).max()
    )  # second differences of doubles over T^2


def test_rows_are_consecutive_and_nothing_is_sent_twice(new_line: Callable[[], Any]) -> None:
    bundle = environment()
    core, account, line = environment_core(bundle, np.eye(3) * 1e-3), EnvironmentTelemetry(bundle.common), new_line()
    for tick in range(7):
        core.react([0.001 * tick, 0.0, 0.0])
        core.settle()
        account.tick(tick, core)
    account.publish(line, core, {}, {}, [], TickEvents())
    account.publish(line, core, {}, {}, [], TickEvents())
    (told,) = line.telemetry
    assert told.tick == 7
    assert told.traces["x_e"].shape == (7, 3)
    assert account.ticks == 7


def test_late_ticks_are_for_the_supervisor_alone(new_line: Callable[[], Any]) -> None:
    bundle = environment()
    core, account, line = environment_core(bundle, np.eye(3) * 1e-3), EnvironmentTelemetry(bundle.common), new_line()
    assert not account.publish(line, core, {}, {}, [(3, 2)], TickEvents())  # nothing is sent: they are for the next one
    core.react([0.0, 0.0, 0.0])
    core.settle()
    account.tick(0, core)
    assert account.publish(line, core, {}, {}, [(3, 2), (5, 2)], TickEvents())
    (told,) = line.telemetry
    assert told.traces[names.WAITED_IN].tolist() == [[3.0, 2.0], [5.0, 2.0]]
    others = names.shown(told)
    assert others.traces.keys() == told.traces.keys() - {names.WAITED_IN}
    assert (others.tick, others.figures) == (told.tick, told.figures)
    assert names.shown(others) is others


def test_the_ends_of_wave_links_have_rows_and_a_life_that_begins_is_an_event(new_line: Callable[[], Any]) -> None:
    bundle = environment()
    core, account, line = (
        environment_core(bundle, np.eye(3) * 1e-3),
        EnvironmentTelemetry(bundle.common, AB),
        new_line(),
    )
    for tick in range(4):
        core.react([0.0] * 3)
        core.settle()
        a = WaveRow([1.0 + tick], [0.1, 0.2, 0.3], [2.0], [3.0], begins=tick == 2)
        b = WaveRow([4.0, 5.0], [0.4, 0.5, 0.6], [6.0, 7.0], [8.0, 9.0], begins=tick == 0)
        account.tick(tick, core, [a, b])
    account.publish(line, core, {}, {}, [], TickEvents())
    (told,) = line.telemetry
    assert dict(told.figures) == {"began@0": 1.0, "linked:cb@0": 1.0, "linked:ca@2": 1.0}
    assert told.traces["c"].tolist() == [[1.0 + tick, 4.0, 5.0] for tick in range(4)]
    assert told.traces["p"].tolist() == [[2.0, 6.0, 7.0]] * 4
    assert told.traces["f_v"].tolist() == [[3.0, 8.0, 9.0]] * 4
    assert told.traces["tank"].tolist() == [[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]] * 4


def test_without_wave_links_there_are_no_such_rows(new_line: Callable[[], Any]) -> None:
    bundle = environment()
    core, account, line = environment_core(bundle, np.eye(3) * 1e-3), EnvironmentTelemetry(bundle.common), new_line()
    core.react([0.0] * 3)
    core.settle()
    account.tick(0, core)
    account.publish(line, core, {}, {}, [], TickEvents())
    (told,) = line.telemetry
    assert told.traces.keys() == {"x_e", "q", "ledger"}


def test_telemetry_that_is_sent_later_takes_a_step_in_each_tick() -> None:
    """Frames are sent in their order, none is kept back at the end, and no step both makes a frame and sends one."""
    steps: list[str] = []

    class Line:
        def frame(self, telemetry: Telemetry) -> bytes:
            steps.append(f"frame {telemetry.tick}")
            return bytes([telemetry.tick])

        def post(self, frame: bytes) -> None:
            steps.append(f"post {frame[0]}")

    later = TelemetryLater(Line())  # type: ignore[arg-type]
    taken = []
    for tick in range(8):
        before = len(steps)
        if tick in {1, 5, 6}:
            later.publish(Telemetry(tick, Figures(), {}))
        else:
            later.step()
        taken.append(steps[before:])
    later.finish()
    assert taken == [[], [], ["frame 1"], ["post 1"], [], [], ["frame 5", "post 5"], ["frame 6"]]
    assert steps[-1] == "post 6"
