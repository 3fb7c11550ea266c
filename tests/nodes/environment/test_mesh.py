"""Proxies on meshes: on the surface, within the cone of friction, never through it, and no account below zero."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from manyhands.design.models.distance_grid import DistanceGrid, grid_of_mesh
from manyhands.design.models.triangle_mesh import solid
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.mesh import CONE_TOLERANCE, STEPS, Lookup, MeshProxies, MeshTool
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.proxy import ProxyLaw

from ...support.cases import WIDE_EXAMPLES, cases
from ...support.meshes import CELL, grid, parameters, proxies
from ...support.reaction import react

T = 1e-3
SHAPES = ["box", "ball", "torus", "star"]
Place = tuple[float, float, float]


def tool(made: DistanceGrid, at: Place, radius: float = 0.0, mu: float = 0.0, axes: tuple[int, ...] = (0, 1, 2)) -> Any:
    return MeshTool(Lookup(made), made.cell, at, axes, radius, mu)


def pressed(mesh_tool: MeshTool, rng: np.random.Generator, ticks: int, force: float = 5.0) -> Any:
    """A tool of 0.1 kg on a spring to its proxy, drawn to places about the solid: its ticks that touch."""
    x = np.array(mesh_tool.place)
    v = np.zeros(3)
    wanted = x
    for k in range(ticks):
        if k % 150 == 0:
            wanted = rng.uniform(-1.0, 1.0, 3) * (0.025, 0.02, 0.015)
        pull = np.clip(400.0 * (wanted - x), -force, force)
        v = v + (pull + 1500.0 * (np.array(mesh_tool.place) - x) - 8.0 * v) / 0.1 * T
        x = x + v * T
        a, b, c = x.tolist()
        answer = mesh_tool.follow((a, b, c))
        if answer != (a, b, c):
            yield x, np.array(answer), np.array(mesh_tool.place)


def test_a_tool_that_touches_nothing_is_its_own_proxy_to_the_last_bit() -> None:
    model = proxies(grid("box"), 0.3, a=((0.0, 0.0, 0.03), 0.002), b=((0.05, 0.0, 0.0), 0.0))
    x = np.array([0.1, -0.2, 1 / 3, 1 / 7, 0.2, -0.1])
    assert model.proxy(x, 0) == x.tolist()


def test_a_press_on_a_face_is_the_nearest_point() -> None:
    """A sphere of 2 mm on a face at 10 mm, in four tools' worth of places."""
    for x, y in ((0.0, 0.0), (0.007, -0.004), (-0.0111, 0.0042), (0.012, 0.009)):
        one = tool(grid("box"), (x, y, 0.02), 0.002)
        for depth in (1e-4, 1e-3, 4e-3):
            q = one.follow((x, y, 0.012 - depth))
            assert q == pytest.approx((x, y, 0.012), abs=2e-6)


def test_it_sticks_without_creep_and_slides_from_the_cone_on() -> None:
    one = tool(grid("box"), (0.0, 0.0, 0.012), 0.0, 0.5)
    touched = one.follow((0.0, 0.0, 0.008))
    assert touched == pytest.approx((0.0, 0.0, 0.01), abs=1e-6)
    for k in range(1000):
        assert one.follow((0.00099 * math.sin(0.1 * k), 0.0, 0.008)) == touched  # 0.99 of mu times the depth
    x, y, z = one.follow((0.003, 0.0, 0.008))
    assert (x, y, z) == pytest.approx((0.002, 0.0, 0.01), abs=5e-6)  # behind the tool by mu times the depth
    x, y, z = one.follow((0.003, 0.0, 0.008))
    assert (x, y, z) == pytest.approx((0.002, 0.0, 0.01), abs=5e-6)


@settings(max_examples=cases(8, WIDE_EXAMPLES), deadline=None)
@given(
    name=st.sampled_from(SHAPES),
    mu=st.sampled_from([0.0, 0.1, 0.5, 2.0]),
    radius=st.sampled_from([0.0, 0.003]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_spring_stays_within_the_cone_of_friction(name: str, mu: float, radius: float, seed: int) -> None:
    """At every tick that touches, on smooth faces, on edges and in hollows."""
    made = grid(name)
    lookup = Lookup(made)
    touched = finished = 0
    for goal, answer, place in pressed(tool(made, (0.0, 0.0, 0.05), radius, mu), np.random.default_rng(seed), 1500):
        distance, *slope = lookup((place[0], place[1], place[2]))
        n = np.array(slope) / np.linalg.norm(slope)
        spring = answer - goal
        depth = float(spring @ n)
        assert depth > 0.0
        assert np.linalg.norm(spring - depth * n) <= (mu + 1.01 * CONE_TOLERANCE) * depth + 1e-9
        touched += 1
        finished += abs(distance - radius) <= 1e-3 * CELL and np.array_equal(answer, place)
    assert finished >= 0.9 * touched


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_no_push_leads_through_a_plate(mu: float) -> None:
    """A plate of two cells, and places on its other side, near and far, at once and slowly."""
    corners = np.array([(x, y, z) for x in (-0.02, 0.02) for y in (-0.002, 0.002) for z in (-0.02, 0.02)])
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
    ]
    plate = grid_of_mesh(solid(corners, [*faces, (1, 5, 7), (1, 7, 3)]), CELL)
    rng = np.random.default_rng(3)
    one = tool(plate, (0.0, 0.01, 0.0), 0.0, mu)
    for k in range(3000):
        x, z = 0.008 * math.sin(0.01 * k), 0.008 * math.cos(0.013 * k)
        one.follow((x, -0.03 * float(rng.random() < 0.5) + 0.01 * float(rng.random()) - 0.005, z))
        assert one.place[1] > 0.0019


def test_a_fast_tool_is_caught_up_with_in_a_few_ticks() -> None:
    """Nothing is felt on the way, in the air; on the surface the spring is that of the plane where the proxy is."""
    one = tool(grid("box"), (0.0, 0.0, 0.05))
    ways = [one.follow((0.9, 0.0, 0.05)) for _ in range(3)]
    assert ways == [(0.9, 0.0, 0.05)] * 3
    assert one.place == (0.9, 0.0, 0.05)
    slow = tool(grid("box"), (-0.0185, 0.0, 0.012))
    slow.follow((-0.0185, 0.0, 0.0099))
    at_once = slow.follow((0.0185, 0.0, 0.0099))  # 37 mm along the face: more than a cell for each of the parts
    assert at_once == pytest.approx((0.0185, 0.0, 0.01), abs=5e-5)
    assert -0.0185 + (STEPS - 2) * CELL < slow.place[0] < 0.0165
    assert slow.follow((0.0185, 0.0, 0.0099)) == slow.place == pytest.approx((0.0185, 0.0, 0.01), abs=2e-4)


def test_a_way_through_the_air_ends_at_the_next_wall() -> None:
    """Across the hole of a torus: the tangent plane at the start is no reason to go through the other side."""
    one = tool(grid("torus"), (-0.0119, 0.0, 0.0))
    x, y, z = one.follow((0.05, 0.0, 0.0))
    assert (x, y, z) == pytest.approx((0.012, 0.0, 0.0), abs=3e-4)


@pytest.mark.parametrize("depth", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("name", SHAPES)
def test_a_tool_that_comes_to_its_proxy_is_free(name: str, depth: float) -> None:
    """Also where rounding has the proxy a little inside."""
    one = tool(grid(name), (0.013, 0.004, 0.03))
    for k in range(40):
        place = one.follow((0.013 + 1e-4 * k, 0.004, 0.012 - depth))
        assert one.follow(place) == place


@pytest.mark.parametrize(("axes", "at"), [((1,), (0.008, -0.03, 0.0)), ((0, 2), (0.03, 0.008, 0.005))])
def test_a_device_with_fewer_axes_moves_its_proxy_along_these(axes: tuple[int, ...], at: Place) -> None:
    ports = tuple("abc"[: len(axes)])
    one = {"ports": [*ports], "axes": [*axes], "at": [*at], "radius": 0.001}
    model = MeshProxies(ports, T, {"grid": grid("ball").text, "friction": 0.2, "tools": [one]})
    for k in range(25):
        q = np.array(at)
        moved = model.proxy(np.array([-math.copysign(1e-3 * k, at[axis]) for axis in axes]), k)
        q[[*axes]] += moved
        assert np.linalg.norm(q) > 0.0205
    assert np.linalg.norm(q) < 0.0215


STARTS = {"t0": ((0.0, 0.0, 0.05), 0.002), "t1": ((0.05, 0.0, 0.0), 0.0)}
BLOCKS = ([0, 1, 2], [3, 4, 5])


def core_of(model: Any, tools: int, stiffness: float, compliance: np.ndarray, blocks: Any) -> EnforcedCore:
    """A core with ramps of 20 ticks; without a controller, so that the test of the proxies alone keeps the ledger."""
    m = 3 * tools
    ports = tuple(f"t{i}.{axis}" for i in range(tools) for axis in "xyz")
    law = ProxyLaw(AskedModel("a:mesh", model, ports), stiffness * np.eye(m), None, T, blocks)
    return EnforcedCore(law, compliance, np.zeros((m, m)), T, False, blocks, 20)


def hostile(core: EnforcedCore, rng: np.random.Generator, ticks: int, clutched: bool) -> int:
    """Tools that rub, jump, shake with the forces and chase the proxies; blocks freeze and come back.

    Returns:
        The ticks in which something was felt. The ledger, less what the springs store, has been at least 0 in all.
    """
    m = len(core.tools)
    p, passed, felt, f, x_e = np.zeros(m), 0.0, 0, np.zeros(m), np.zeros(m)
    starts = -np.concatenate([at for at, _ in STARTS.values()])
    wanted, gain = starts, 0.0
    for k in range(ticks):
        if k % 100 == 0:
            wanted = starts + rng.uniform(-0.015, 0.015, m)  # in and around the solid
            gain = float(rng.choice([0.0, 0.0, 2e-4, -2e-4]))
        if k % 37 == 0 and rng.random() < 0.2:
            p = p + rng.normal(0.0, 0.02, m)
        p = np.clip(p + 0.03 * (wanted - p) + gain * f + rng.normal(0.0, 1e-5, m), -0.1, 0.1)
        if clutched and k % 60 == 59:
            verb = (core.clutches.freeze, core.clutches.engage, core.clutches.disengage, core.clutches.engage)[
                k // 60 % 4
            ]
            verb(k // 240 % 2)
        f = react(core, p)
        core.settle()
        tools = np.array(core.tools)
        passed += float(np.abs(tools - x_e) @ np.abs(f))
        felt += bool(f.any())
        x_e = tools
        assert core.ledger is not None
        assert core.ledger.minimum >= -1e-12 * (passed + 1e-3)
    assert core.failure is None
    return felt


@settings(max_examples=cases(3, 6), deadline=None, phases=(Phase.explicit, Phase.generate))  # shrinking takes minutes
@given(
    name=st.sampled_from(["star", "box", "torus"]),
    mu=st.sampled_from([0.0, 0.2, 1.0]),
    stiffness=st.sampled_from([500.0, 5e3, 1e6]),
    joined=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_account_of_a_mesh_is_never_below_zero(
    name: str, mu: float, stiffness: float, joined: bool, seed: int
) -> None:
    """Sharp edges, all clutch ratios, couplings with and without symmetry; 1.8 10^5 ticks in the wide search."""
    rng = np.random.default_rng(seed)
    D = np.eye(6) / 900.0
    if joined:
        turned = rng.uniform(-2e-4, 2e-4, (3, 3))
        D[:3, :3] += turned - turned.T
        D[3:, 3:] = np.diag([1 / 300, 1 / 900, 1 / 2000])
    core = core_of(proxies(grid(name), mu, **STARTS), 2, stiffness, D, BLOCKS)
    assert hostile(core, rng, cases(1200, 30_000), clutched=True) > 100


@pytest.mark.parametrize("kind", ["noise", "sign", "steep", "inside"])
def test_a_false_grid_breaks_no_account(kind: str) -> None:
    rng = np.random.default_rng(8)
    made = grid("star")
    d, band = made.distances, made.band * made.cell
    false = {
        "noise": rng.uniform(-band, band, d.shape),
        "sign": -d,
        "steep": np.where(rng.random(d.shape) < 0.5, -band, band),
        "inside": np.full(d.shape, -band),
    }[kind]
    lying = DistanceGrid(made.origin, made.cell, made.band, false, made.surface)
    core = core_of(proxies(lying, 0.3, **STARTS), 2, 5e3, np.eye(6) / 900.0, BLOCKS)
    assert hostile(core, rng, cases(1000, 20_000), clutched=True) > 100


def test_tools_do_not_feel_each_other() -> None:
    both = proxies(grid("star"), 0.2, **STARTS)
    alone = proxies(grid("star"), 0.2, t1=STARTS["t1"])
    rng = np.random.default_rng(2)
    x = np.cumsum(rng.normal(0.0, 1e-3, (500, 6)), axis=0)
    for k, row in enumerate(x):
        assert both.proxy(row, k)[3:] == alone.proxy(row[3:], k)


@pytest.mark.parametrize("change", [{"grid": "x"}, {"grid": 3}, {"tools": 3}, {"tools": [{}]}, {"friction": "x"}])
def test_what_makes_no_model(change: dict[str, Any]) -> None:
    good = parameters(grid("box"), 0.2, a=((0.0, 0.0, 0.03), 0.0))
    with pytest.raises((KeyError, TypeError, ValueError, AttributeError)):
        MeshProxies(("a.x", "a.y", "a.z"), T, {**good, **change})
