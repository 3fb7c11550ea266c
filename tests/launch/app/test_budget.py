"""The budget of a session: its figures for people and for programs, and the picture."""

from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import DelayedNetwork, StateSpaceEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.launch.app.budget import (
    PERIODS,
    budget,
    budget_object,
    draw_speeds,
    friction_object,
    plot_budget,
    print_budget,
    print_friction,
    print_steps,
    print_wave_links,
    series_budget,
    session_budget,
    speed_budget,
    step_budget,
    wave_link_budgets,
    wave_links_object,
)
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named


def loop(levels: list[float], tau: float = 0.0, environment: Environment | None = None, T: float = 1e-3) -> HapticLoop:
    """One-axis devices d0, d1, ... on springs to the ground, a block each."""
    m = len(levels)
    ports = tuple(f"d{i}" for i in range(m))
    springs = Network(ports, (), tuple(NetworkLink((port, GROUND), 1000.0, 0.1) for port in ports))
    return HapticLoop(
        "example",
        T,
        ports,
        tuple(
            DeviceLevel(port, (i,), np.array([[level]]))
            for i, (port, level) in enumerate(zip(ports, levels, strict=True))
        ),
        Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m))),
        environment or springs,
        tau,
    )


def printed(of: HapticLoop) -> str:
    console = Console(width=140, highlight=False)
    with console.capture() as capture:
        print_budget(console, budget(of))
    return capture.get()


def test_the_figures_of_example_1() -> None:
    found = budget(loop([1.37, 1.37, 1.37], tau=0.25e-3))
    device = found.devices[0]
    certified = {row.tau: row.certified for row in device.against_delay}
    assert certified[0.0] == pytest.approx(2740.0)
    assert certified[0.25e-3] == pytest.approx(1565.7, abs=0.05)
    assert certified[1e-3] == pytest.approx(685.0)
    assert list(certified) == sorted(certified)
    against_period = {(row.T, row.tau): row for row in device.against_period}
    assert against_period[4e-3, 4e-3].certified == pytest.approx(685.0 / 4.0)
    assert against_period[4e-3, 0.25e-3].certified == pytest.approx(1.37 / (2e-3 + 0.375e-3))
    assert against_period[0.5e-3, 0.0].colgate == pytest.approx(2 * 1.37 / 0.5e-3)


def test_the_sessions_own_delay_and_period_are_among_them() -> None:
    found = budget(loop([1.37], tau=0.31e-3, T=0.9e-3))
    assert 0.31e-3 in {row.tau for row in found.devices[0].against_delay}
    assert found.periods == tuple(sorted({*PERIODS, 0.9e-3}))
    for row in found.devices[0].against_period:
        assert 0.0 <= row.tau <= row.T  # 0.31 ms does not fit into 0.25 ms


def test_the_object_is_plain_json() -> None:
    said = json.loads(json.dumps(budget_object(budget(loop([1.37, 2.0], tau=3e-4))), allow_nan=False))
    assert set(said) == {"session", "period", "tau", "period_tolerance", "environment", "devices"}
    assert set(said["devices"]) == {"d0", "d1"}
    rows = said["devices"]["d1"]["against_tau"]
    assert {"T", "tau", "certified", "colgate", "kappa"} == set(rows[0])
    assert rows[0]["certified"] == pytest.approx(4000.0)
    assert said["environment"] == [{"T": T, "share": 0.0} for T in PERIODS]


def test_the_tables_say_what_is_what() -> None:
    text = printed(loop([1.37, 1.37, 2.5], tau=0.3e-3))
    assert "τ [ms]" in text
    assert "T [ms]" in text
    assert "d0, d1" in text
    (row,) = [line for line in text.splitlines() if "(session)" in line and "1442" in line]
    assert "0.3" in row
    assert "1713" in row
    assert "longer than T" in text
    assert "The environment is passive" in text
    assert printed(loop([1.37])).count("τ = 0") == 2  # its own and Colgate's: no third for the session's


def test_the_worlds_own_springs_in_series() -> None:
    """1/(1/K - p/k), with the delay's own p; without `series` there is no table of it."""
    found = session_budget(load_named("example1", ["design.series=true", "design.tau=0.0005"]))
    rows = series_budget(found)
    assert {row.port for row in rows} == {"dx", "dy", "dz"}
    own = {(row.port, row.tau): row for row in rows}
    assert own["dx", 0.0].certified == pytest.approx(9797.0, abs=1.0)
    assert own["dz", 0.001].certified == pytest.approx(864.0, abs=1.0)
    for row in rows:
        assert 1.0 / row.certified + row.part / row.contact == pytest.approx(1.0 / row.without)
    assert json.loads(json.dumps(budget_object(found)))["series"][0]["port"] == "dx"
    plainly = session_budget(load_named("example1"))
    assert series_budget(plainly) == ()
    assert "series" not in budget_object(plainly)


def test_a_line_for_each_encoder_says_what_its_step_can_add() -> None:
    steps = ["devices.dx.step=1e-5", "devices.dy.step=1e-5"]
    friction = ["devices.dx.friction={least: 0.01}", "devices.dy.friction={least: 0.02}"]
    found = session_budget(load_named("example1", [*steps, *friction]))
    assert [(row.port, row.friction) for row in step_budget(found)] == [("dx", 0.01), ("dy", 0.02)]
    assert step_budget(found)[0].force == pytest.approx(2740.0 * 1e-5 / 2.0)
    assert json.loads(json.dumps(budget_object(found)))["steps"][1]["port"] == "dy"
    console = Console(width=140, highlight=False)
    with console.capture() as capture:
        print_steps(console, found)
        print_steps(console, session_budget(load_named("example1", steps[:1])))
    lines = capture.get().splitlines()
    assert [line.partition("; ")[2] for line in lines] == [
        "the dry friction of 10 mN does not cover it",
        "the dry friction of 20 mN covers it",
        "no dry friction is stated",
    ]
    assert lines[0].startswith("dx: the encoder's step can add 13.7 mN to a spring of 2740 N/m")


RUBBING = ["devices.dx.friction={least: 0.2}", "devices.dy.friction={least: 0.2}", "design.tau=0.0002"]


def test_a_line_says_what_friction_gives_below_which_speed() -> None:
    found = session_budget(load_named("example1", [*RUBBING, "design.speed=0.05"]))
    below = {v: (1.37 + 0.2 / v) / 0.8e-3 for v in (0.03, 0.05, 0.1, 0.3, 1.0)}
    told = friction_object(found)["below_speeds"]
    assert told.keys() == {"dx", "dy"}
    assert {row["speed"]: row["certified"] for row in told["dx"]} == pytest.approx(below)
    assert friction_object(session_budget(load_named("example1"))) == {}
    console = Console(width=140, highlight=False)
    with console.capture() as capture:
        print_friction(console, found)
        print_friction(console, session_budget(load_named("example1")))
    [line] = capture.get().splitlines()
    assert line.startswith(
        "dx, dy: the tables hold at every speed; with a design.speed dry friction damps, too, 0.2 ms"
    )
    assert f"{below[0.05]:.0f} N/m below 0.05 m/s (session)" in line


def test_devices_with_friction_have_a_curve_over_the_speed() -> None:
    """Below v* friction is a damping of c/v*; devices with equal limits share a curve, and others have none."""
    (both,) = speed_budget(session_budget(load_named("example1", [*RUBBING, "design.speed=0.05"])))
    assert both.names == ("dx", "dy")
    assert both.certified == pytest.approx((1.37 + 0.2 / both.speeds) / 0.8e-3)
    assert both.every == pytest.approx(1.37 / 0.8e-3)
    assert both.own == pytest.approx((1.37 + 0.2 / 0.05) / 0.8e-3)
    (unasked,) = speed_budget(session_budget(load_named("example1", RUBBING)))
    assert unasked.own is None
    assert unasked.speeds[[0, -1]] == pytest.approx([0.01, 1.0])
    (fast,) = speed_budget(session_budget(load_named("example1", [*RUBBING, "design.speed=2"])))
    assert fast.speeds[-1] == pytest.approx(4.0)
    assert speed_budget(session_budget(load_named("example1"))) == ()


def test_the_panel_over_the_speed() -> None:
    budget = session_budget(load_named("example1", [*RUBBING, "design.speed=0.05"]))
    found, axes = speed_budget(budget), Figure().subplots()
    draw_speeds(axes, found, budget.loop)
    curve, line, mark = axes.lines
    assert curve.get_ydata() == pytest.approx(found[0].certified)
    assert list(line.get_ydata()) == [found[0].every] * 2
    assert (list(mark.get_xdata()), list(mark.get_ydata())) == ([0.05], [found[0].own])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed v* [m/s]", "stiffness [N/m]")
    assert [curve.get_label(), line.get_label(), mark.get_label()] == [
        "dx, dy",
        "dx, dy: at every speed, without its friction",
        "this session: 6712 N/m below 0.05 m/s",
    ]
    axes = Figure().subplots()
    coarse = [f"devices.{name}.step=0.0005" for name in ("dx", "dy")]
    budget = session_budget(load_named("example1", RUBBING + coarse))
    draw_speeds(axes, speed_budget(budget), budget.loop)
    assert "dx, dy: nothing below any speed, because of the encoders' steps" in [one.get_label() for one in axes.lines]
    assert not any(one.get_marker() == "o" for one in axes.lines)


def test_the_picture_has_the_panel_only_where_friction_is_stated(tmp_path: Path) -> None:
    for overrides in (RUBBING, []):
        path = tmp_path / "budget.svg"
        plot_budget(session_budget(load_named("example1", overrides)), path)
        text = path.read_text()
        assert "delay τ inside the tick [ms]" in text
        assert ("speed v* [m/s]" in text) == bool(overrides)


def test_longer_periods_cost_stiffness() -> None:
    """The limits are b/(lambda T/2 + 3 tau/2), and Colgate's at a constant period of lambda T; they meet at tau = 0."""
    of = dataclasses.replace(loop([1.37], tau=0.3e-3), period_tolerance=0.1)
    rows = {row.tau: row for row in budget(of).devices[0].against_delay}
    assert rows[0.0].certified == pytest.approx(1.37 / 0.55e-3)
    assert rows[0.0].colgate == pytest.approx(rows[0.0].certified)
    assert rows[0.3e-3].certified == pytest.approx(1.37 / (0.55e-3 + 0.45e-3))
    assert rows[0.3e-3].colgate == pytest.approx(1.37 / (0.55e-3 + 0.3e-3))
    assert budget_object(budget(of))["period_tolerance"] == 0.1
    assert "Periods may be up to 1.1 T long" in printed(of)
    assert "Periods may be" not in printed(loop([1.37], tau=0.3e-3))


def test_many_devices_of_many_levels_stay_readable() -> None:
    text = printed(loop([1.0 + 0.01 * (i % 40) for i in range(200)]))
    assert "the 28 stronger levels are not shown; --json has every device" in text
    assert len(text.splitlines()) < 200


def springs_late(stiffness: float) -> DelayedNetwork:
    return DelayedNetwork(Network(("d0",), (), (NetworkLink(("d0", GROUND), stiffness, 0.0),)), 1)


def test_a_world_that_is_late_takes_its_share() -> None:
    """A spring k one tick late: E_hat = T k/(z - 1), He E_hat = -T k/2 at every frequency."""
    of = loop([1.37], tau=0.3e-3, environment=springs_late(100.0))
    found = budget(of)
    assert found.share_at(1e-3) == pytest.approx(0.5 * 1e-3 * 100.0 / 1.37, rel=1e-9)
    assert found.share_at(4e-3) == pytest.approx(4.0 * found.share_at(1e-3), rel=1e-9)
    late, prompt = found.devices[0].against_delay, budget(loop([1.37], tau=0.3e-3)).devices[0].against_delay
    assert late[0].certified == prompt[0].certified
    assert all(0.0 < a.certified < b.certified for a, b in zip(late[1:4], prompt[1:4], strict=True))
    assert "takes 3.6% of what the devices dissipate" in printed(of)


def test_a_world_that_takes_too_much() -> None:
    of = loop([1.37], environment=springs_late(3500.0))
    assert all(row.certified == 0.0 for row in budget(of).devices[0].against_delay)
    assert "nothing can be certified" in printed(of)
    assert "none" in printed(of)


def test_a_world_that_is_passive_at_no_level(tmp_path: Path) -> None:
    of = loop([1.0, 1.0], environment=StateSpaceEnvironment(("d0", "d1"), StateSpace.static([[2.0, 1.0], [0.0, 2.0]])))
    found = budget(of)
    assert budget_object(found)["environment"] == [{"T": 1e-3, "share": None}]
    json.dumps(budget_object(found), allow_nan=False)
    plot_budget(found, tmp_path / "nothing.png")


def test_a_world_in_discrete_time_has_one_period() -> None:
    E = StateSpaceEnvironment(("d0",), StateSpace.static([[500.0]]))
    assert budget(loop([1.0], environment=E)).periods == (1e-3,)
    continuous = StateSpaceEnvironment(("d0",), StateSpace.static([[500.0]]), "backward-euler")
    assert budget(loop([1.0], environment=continuous)).periods == PERIODS


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_the_picture(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"budget{suffix}"
    plot_budget(budget(loop([1.37, 2.5] if suffix == ".png" else [1.37], tau=0.3e-3)), path)
    start = path.read_bytes()[:24]
    assert start.startswith({".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix])
    if suffix == ".png":
        width, height = struct.unpack(">II", start[16:24])
        assert width > 800
        assert height > 800
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def linked(*overrides: str) -> Session:
    links = ["couplings.cx={devices: [dx], wave_link: {mass: 0.05, round_trip: 0.004, period: 0.0005, tau: 0.00005}}"]
    links += ["couplings.cy={devices: [dy], wave_link: {b: 20}}"]
    return load_named("example1", [*links, *overrides])


def test_the_budget_of_wave_links() -> None:
    cx, cy = wave_link_budgets(linked())
    assert (cx.name, cx.period, cx.tau, cx.round_trip) == ("cx", 0.5e-3, 0.05e-3, 4e-3)
    assert (cy.name, cy.period, cy.tau, cy.round_trip) == ("cy", 1e-3, 0.0, None)
    assert cx.periods == (0.5e-3, 0.25e-3)
    assert cy.periods == (1e-3, 0.5e-3, 0.25e-3)
    assert 4e-3 in cx.round_trips
    # the felt mass stays, and b = 2 M/R; where b is given, the mass grows with the distance
    assert {round(cx.at(0.5e-3, R).mass, 12) for R in cx.round_trips} == {0.05}
    assert cy.at(1e-3, 0.1).mass == pytest.approx(1.0)
    K = 1.37 / (0.25e-3 + 0.075e-3)
    assert cx.at(0.5e-3, 4e-3).felt == pytest.approx(1.0 / (1.0 / K + 0.002 / 25.0))
    assert wave_link_budgets(load_named("example1")) == ()
    both = wave_link_budgets(linked("couplings.cy.wave_link.harvest=0.3"))[1]
    assert both.at(1e-3, 0.1).felt <= cy.at(1e-3, 0.1).felt


def test_the_table_and_the_object_of_wave_links() -> None:
    found = wave_link_budgets(linked())
    console = Console(width=140, highlight=False)
    with console.capture() as capture:
        print_wave_links(console, found)
    said = capture.get()
    assert "cx: over a wave link, τ = 0.05 ms at the site" in said
    assert "4 (session)" in said
    for column in (
        "R [ms]",
        "felt, 2 kHz [N/m]",
        "felt, 4 kHz [N/m]",
        "felt mass [g]",
        "least mass [g]",
        "loop through R [N/m]",
    ):
        assert column in said
    plain = json.loads(json.dumps(wave_links_object(found), allow_nan=False))
    assert set(plain) == {"cx", "cy"}
    assert set(plain["cx"][0]) == {
        "T", "tau", "round_trip", "coupling", "felt", "mass", "least_mass", "naive"
    }  # fmt: skip
    with console.capture() as capture:
        print_wave_links(console, ())
    assert capture.get() == ""


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_picture_of_wave_links(tmp_path: Path, suffix: str) -> None:
    session = linked()
    path = tmp_path / f"links{suffix}"
    plot_budget(dataclasses.replace(budget(loop([1.37])), wave_links=wave_link_budgets(session)), path)
    assert path.stat().st_size > 10_000
