"""From a session's limits to each process's bounds: their addressees, and no honest tool is ever refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace
from manyhands.launch.plan import bundles
from manyhands.launch.plan.bundles import RunPlan, cut, limits_at, tool_bounds
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import certificate_files, prepare
from manyhands.launch.session import Session, load_session
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.kernel.arithmetic import feedthrough_digest
from manyhands.nodes.kernel.bundle import (
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    Limits,
    PluginDevice,
    SimulatedHand,
    encoded,
    load,
    save,
)
from manyhands.nodes.link.peer_link import bounds_by_peer
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Gate
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT, MAX_NAME
from manyhands.protocol.messages import Figures, Role, Telemetry, Tool
from tests.support.gates import admit

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
OVERRIDES = (
    "devices.dx.limits={force: 1, displacement: 0.1, speed: 2}",
    "devices.dy.limits={force: 3, displacement: 0.2, speed: 4}",
    "devices.dz.limits={force: 5, displacement: 0.3, speed: 6}",
)


def session(file: str = "example1.yaml", overrides: tuple[str, ...] = OVERRIDES) -> Session:
    return load_session(SESSIONS / file, overrides)


HELD = session("example1-centralised.yaml")


def test_limits_are_those_of_the_ports_in_their_order() -> None:
    assert limits_at(session(), ("dz", "dx")) == Limits((5.0, 1.0), (0.3, 0.1), (6.0, 2.0))
    axes = ("devices.d.limits={force: [1, 2, 3], displacement: 0.5, speed: [4, 5, 6]}",)
    held = session("example1-operator.yaml", axes)
    assert limits_at(held, held.ports[1:]) == Limits((2.0, 3.0), (0.5, 0.5), (5.0, 6.0))


@pytest.mark.parametrize(
    "more", [(), ("design.speed=0.1",), ("design.speed=0.1", "devices.dx.step=1e-5")], ids=["", "below", "in steps"]
)
def test_a_simulated_device_burns_its_friction_and_its_account_counts_it(tmp_path: Path, more: tuple[str, ...]) -> None:
    each = tuple(f"devices.{name}.friction={{least: 0.2}}" for name in ("dx", "dy", "dz"))
    prepared = prepare(session("example1.yaml", (*each, *more)))
    bundle = cut(prepared, RunPlan("simulated", tmp_path, ""))["dx"]
    assert isinstance(bundle, DeviceBundle)
    assert isinstance(bundle.source, SimulatedHand)
    assert bundle.source.friction == (0.2,)
    assert bundle.friction is not None
    assert (bundle.friction.least, bundle.friction.speed) == ((0.2,), 0.1 if more else None)
    certified = prepared.rungs[0].loop
    assert bundle.friction.kept == (certified.kept[0] if certified.kept else 0.0,)
    assert (bundle.friction.kept[0] > 0.0) == (len(more) == 2)
    for level, rung in zip(bundle.levels, prepared.rungs, strict=True):
        np.testing.assert_array_equal(level, rung.loop.Delta_D_blocks[0])
    assert (bundle.levels[0][0, 0] > bundle.osp[0, 0]) == bool(more)
    save(bundle, tmp_path / "dx")
    assert encoded(load(tmp_path / "dx", DeviceBundle)) == encoded(bundle)


PLUGIN = "{dof: 1, osp: 1.37, driver: 'devices_of.a_lab:device', friction: {least: 0.2}}"
OTHERS = ("devices.dy.friction={least: 0.2}", "devices.dz.friction={least: 0.2}")
IN_SPACE = (
    "{kind: chain, turns: [z, y, y], links: [[0, 0, 0.1], [0.13, 0, 0], [0.13, 0, 0]], "
    "low: [-0.5, -0.8, 0.7], high: [0.5, -0.2, 1.6]}"
)


@pytest.mark.long
def test_a_certified_run_with_friction_of_which_no_account_can_be_kept_is_refused(tmp_path: Path) -> None:
    run = RunPlan("simulated", tmp_path, "")
    slow = ("devices.d.limits={force: 1, speed: 0.1, displacement: 0.01}", "devices.d.friction={least: 0.2}")
    joints = session("example1-operator.yaml", (*slow, "devices.d.held=torque", f"devices.d.linkage={IN_SPACE}"))
    with pytest.raises(NotCertified, match=r"devices\.d\.friction: found friction behind the kinematics"):
        cut(prepare(joints), run)
    driver = session("example1.yaml", (f"devices.dx={PLUGIN}", "design.speed=0.1"))
    with pytest.raises(NotCertified, match=r"devices\.dx\.step: found none .*; expected the step to which its disp"):
        cut(prepare(driver), run)


@pytest.mark.parametrize(
    ("more", "found"),
    [
        ("step: 0.0001", "found 0.0001 m; expected less than the 0.0001 m that 0.1 m/s are in 0.001 s"),
        ("step: 0.00008, sample_age: 0.0003", "found 8e-05 m; expected less than the 7e-05 m"),
    ],
)
def test_a_step_that_looks_like_a_faster_motion_is_refused(tmp_path: Path, more: str, found: str) -> None:
    each = [f"devices.{name}.friction={{least: 2}}" for name in ("dx", "dy", "dz")]
    driver = session("example1.yaml", (f"devices.dx={PLUGIN[:-1]}, {more}}}", *each, "design.speed=0.1"))
    with pytest.raises(NotCertified, match=rf"devices\.dx\.step: {found}"):
        cut(prepare(driver), RunPlan("simulated", tmp_path, ""))


def test_the_account_of_a_driver_counts_friction_below_a_speed_by_the_step_of_its_encoder(tmp_path: Path) -> None:
    driver = f"devices.dx={PLUGIN[:-1]}, step: 0.00001}}"
    for speed, counts in ((("design.speed=0.1",), True), ((), False)):
        bundle = cut(prepare(session("example1.yaml", (driver, *OTHERS, *speed))), RunPlan("realtime", tmp_path, ""))[
            "dx"
        ]
        assert isinstance(bundle, DeviceBundle)
        assert isinstance(bundle.source, PluginDevice)
        assert (bundle.friction is not None, bundle.measured) == (counts, (1e-5,) if counts else None)
        save(bundle, tmp_path / f"{counts}")
        assert encoded(load(tmp_path / f"{counts}", DeviceBundle)) == encoded(bundle)
        if bundle.friction is not None:
            assert 0.0 < bundle.friction.kept[0] < 0.2
            with pytest.raises(ValueError, match="friction and a driver of another package without a step"):
                dataclasses.replace(bundle, source=dataclasses.replace(bundle.source, step=None))
            with pytest.raises(ValueError, match=r"the steps \(1e-05, 1e-05\) m; expected 1 finite"):
                dataclasses.replace(bundle.source, step=(1e-5, 1e-5))


@pytest.mark.long
def test_the_joints_of_a_simulated_linkage_burn_their_friction_and_the_certificate_is_the_one_without(
    tmp_path: Path,
) -> None:
    slow = ("devices.d.limits={force: 1, speed: 0.1, displacement: 0.01}", "devices.d.held=torque")
    linkages = (IN_SPACE, IN_SPACE.replace("low:", "friction: [0.01, 0.02, 0.03], low:"))
    smooth, rough = (prepare(session("example1-operator.yaml", (*slow, f"devices.d.linkage={of}"))) for of in linkages)
    assert certificate_files(rough) == certificate_files(smooth)
    bundle = cut(rough, RunPlan("realtime", tmp_path, ""))["d"]
    assert isinstance(bundle, DeviceBundle)
    assert isinstance(bundle.source, SimulatedHand)
    assert bundle.source.linkage is not None
    assert bundle.source.linkage["friction"] == [0.01, 0.02, 0.03]
    save(bundle, tmp_path / "d")
    moved = []
    for one in (load(tmp_path / "d", DeviceBundle), cut(smooth, RunPlan("realtime", tmp_path, ""))["d"]):
        assert isinstance(one, DeviceBundle)
        driver = driver_of(one)
        driver.sample(0, Instant(0))
        driver.apply([0.02] * 3, Instant(1000))
        moved.append(driver.sample(1, Instant(10**7)))
    assert moved[0] == [0.0] * 3  # 20 mN in each direction move no joint against its friction
    assert min(moved[1]) > 1e-7


def test_each_bundle_holds_its_own_ports_limits_and_the_environments_none(tmp_path: Path) -> None:
    prepared = prepare(session())
    cuts = cut(prepared, RunPlan("simulated", tmp_path, ""))
    for name, expected in (("dy", (3.0, 0.2, 4.0)), ("cz", (5.0, 0.3, 6.0))):
        bundle = cuts[name]
        assert isinstance(bundle, (DeviceBundle, CouplingBundle))
        assert bundle.limits == Limits(*((value,) for value in expected))
        save(bundle, tmp_path / name)
        assert load(tmp_path / name, type(bundle)).limits == bundle.limits
    environment = cuts["environment"]
    assert isinstance(environment, EnvironmentBundle)
    assert prepared.ladder is not None
    at_each_rung = [tool_bounds(prepared.session, rung.blocks) for rung in prepared.ladder.rungs]
    magnitude, step = (tuple(map(max, *bounds)) for bounds in zip(*at_each_rung, strict=True))
    assert environment.tool_magnitude == magnitude
    assert environment.tool_step == step
    assert (magnitude, step) != at_each_rung[0]
    save(environment, tmp_path / "environment")
    again = load(tmp_path / "environment", EnvironmentBundle)
    assert (again.tool_magnitude, again.tool_step) == (magnitude, step)
    assert again.feedthrough == {
        name: feedthrough_digest(block.D) for name, block in zip(("cx", "cy", "cz"), prepared.blocks, strict=True)
    }


def test_the_device_and_its_blocks_memory_bound_the_tools_reach() -> None:
    """In closed form for springs and dampers, h = gain (0, 1, a, a^2, ...)."""
    held = session()
    prepared = prepare(held)
    magnitude, step = tool_bounds(held, prepared.blocks)
    for i, (X, S, F) in enumerate(((0.1, 2.0, 1.0), (0.2, 4.0, 3.0), (0.3, 6.0, 5.0))):
        block = prepared.blocks[i]
        a, gain = float(block.A[0, 0]), float(block.B[0, 0] * block.C[0, 0])
        assert 0.0 < a < 1.0
        assert magnitude[i] == pytest.approx(X + F * gain / (1.0 - a), rel=1e-9)
        # the steps of h are gain, and then gain (a - 1) a^k, k = 0, 1, ...
        assert step[i] == pytest.approx(held.period * S + 2.0 * F * gain, rel=1e-9)


def test_bounds_are_in_the_sessions_order_whatever_that_of_the_blocks() -> None:
    held = session(overrides=(*OVERRIDES, "couplings={cz: {devices: [dz]}, cxy: {devices: [dx, dy]}}"))
    assert held.blocks == (("dz",), ("dx", "dy"))
    static = [StateSpace.static(np.zeros((m, m))) for m in (1, 2)]
    magnitude, step = tool_bounds(held, static)
    assert magnitude == (0.1, 0.2, 0.3)
    assert step == pytest.approx((0.002, 0.004, 0.006))


@pytest.fixture(scope="module")
def environment() -> EnvironmentBundle:
    """The environment of one block over all ports."""
    bundle = cut(prepare(HELD), RunPlan("simulated", None, ""))["environment"]
    assert isinstance(bundle, EnvironmentBundle)
    return bundle


@given(seed=st.integers(0, 2**16), radius=st.sampled_from([0.1, 0.9, 0.99]), extreme=st.booleans())
def test_an_honest_coupling_is_never_refused(
    seed: int, radius: float, extreme: bool, environment: EnvironmentBundle
) -> None:
    """A block of two devices under any force, with devices that keep to their limits, by the very gate."""
    rng = np.random.default_rng(seed)
    held = HELD
    n, m = 4, len(held.ports)
    A = rng.normal(size=(n, n))
    A *= radius / np.max(np.abs(np.linalg.eigvals(A)))
    block = StateSpace(A, rng.normal(size=(n, m)), 1e-3 * rng.normal(size=(m, n)), np.zeros((m, m)))
    magnitude, step = tool_bounds(held, [block])
    limits = limits_at(held, held.ports)
    (bounds,) = bounds_by_peer(environment.common, Role.COUPLING, magnitude, step).values()
    gate = Gate(Tool, m, bounds)
    core = CouplingCore(block, np.zeros((m, m)), None, held.period, limits.force)
    X, S = np.array(limits.displacement), np.array(limits.speed)
    x = X * rng.uniform(-1.0, 1.0, m)
    for tick in range(200):
        p = np.array(core.free_position(x.tolist()))
        assert admit(gate, encode(Tool(tick, 0, p)), tick) is not None
        f = rng.choice([-1e3, 1e3], m) if extreme else rng.normal(0.0, 3.0, m)
        core.absorb(core.limited(f))
        change = rng.choice([-1.0, 1.0], m) if extreme else rng.uniform(-1.0, 1.0, m)
        x = np.clip(x + held.period * S * change, -X, X)


def test_a_block_without_a_bound_leaves_its_ports_without_one(tmp_path: Path) -> None:
    prepared = prepare(session(overrides=(*OVERRIDES, "design.ladder=[]")))
    integrating = dataclasses.replace(prepared.blocks[1], A=np.eye(1))
    blocks = (prepared.blocks[0], integrating, prepared.blocks[2])
    magnitude, step = tool_bounds(prepared.session, blocks)
    assert [bound is None for bound in magnitude] == [False, True, False]
    assert [bound is None for bound in step] == [False, True, False]
    cuts = cut(dataclasses.replace(prepared, blocks=blocks), RunPlan("simulated", tmp_path, ""))
    environment = cuts["environment"]
    assert isinstance(environment, EnvironmentBundle)
    save(environment, tmp_path / "environment")
    again = load(tmp_path / "environment", EnvironmentBundle)
    assert again.tool_magnitude == magnitude
    bounds = bounds_by_peer(again.common, Role.COUPLING, again.tool_magnitude, again.tool_step)["cy"]
    assert bounds.magnitude == (np.inf,)
    assert bounds.step == (np.inf,)


def test_telemetry_is_sent_at_10_hz_or_as_traces_need(monkeypatch: pytest.MonkeyPatch) -> None:
    def ticks(period: float, name: str) -> int:
        prepared = prepare(load_session(SESSIONS / "example1-centralised.yaml", [f"period={period}"]), uncertified=True)
        return cut(prepared, RunPlan("simulated", None, ""))[name].common.telemetry_ticks

    assert [ticks(period, "c") for period in (0.05, 0.001, 0.0001)] == [2, 100, 1000]
    monkeypatch.setattr(bundles, "MOST_TRACE_VALUES", 1200)
    # x, f_v, ledger and tau of one port; p and f_v of three, and a ledger
    assert [ticks(0.0001, name) for name in ("dx", "c")] == [1200 // 4, 1200 // 7]


def test_many_wave_links_send_less_at_a_time(tmp_path: Path) -> None:
    """What takes long to encode goes more often: an environment of 64 links has 450 columns."""

    def ticks(users: int) -> int:
        names = range(users)
        plain = {
            "session": "many",
            "period": 0.001,
            "devices": {f"d{i}": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2} for i in names},
            "couplings": {f"c{i}": {"devices": [f"d{i}"], "wave_link": {"b": 20.0}} for i in names},
            "environment": {
                "type": "network",
                "masses": {"hub": 3.0},
                "links": [{"between": [f"d{i}", "hub"], "stiffness": 3500, "damping": 0.2} for i in names],
            },
            "design": {"coupling": "spring-damper", "objective": "feasible"},
        }
        (tmp_path / "many.yaml").write_text(yaml.safe_dump(plain))
        prepared = prepare(load_session(tmp_path / "many.yaml"), uncertified=True)
        return cut(prepared, RunPlan("simulated", None, ""))["environment"].common.telemetry_ticks

    # a tool's position, p, f_v, c, and three of the tank for each user; the mass and the ledger
    assert [ticks(users) for users in (4, 64, 128)] == [100, 8192 // (64 * 7 + 2), 10]


def test_the_largest_traces_fit_a_frame() -> None:
    rows = np.zeros((bundles.MOST_TRACE_VALUES // 2, 1))
    figures = {f"{i:0{MAX_NAME}}": 0.5 for i in range(100)}
    assert len(encode(Telemetry(MAX_COUNT, Figures(figures), {"x": rows, "f_v": rows}))) <= MAX_CONTROL_BYTES
