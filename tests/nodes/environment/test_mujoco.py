"""MuJoCo as an engine, and other engines: what is refused, what is reported, and that the promise is kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.conformance.judgement import Conformance, broken
from manyhands.launch.conformance.model import check_model
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import SessionError, load_session
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.environment.proxy import ProxyLaw
from manyhands.nodes.kernel.factory import ENGINES, FactoryError, published

from ...support.engine_runs import world_kept

SHIPPED = Path(__file__).parents[3] / "launch" / "sessions" / "mujoco.yaml"
MODEL = """<mujoco><option timestep="0.0005"/><worldbody>
<body name="avatar"><joint name="x" type="slide" axis="1 0 0" damping="0.2"/><geom size="0.01" mass="0.05"/></body>
<body name="wall" pos="0.03 0 0"><joint name="turn" type="hinge" axis="0 0 1"/><geom type="box" size="0.01 0.05 0.05"/>
</body>
<body pos="0.3 0 0"><joint name="loose" type="ball"/><geom size="0.01"/></body>
<body pos="0.4 0 0"><joint name="away" type="free"/><geom size="0.01"/></body>
</worldbody><option gravity="0 0 0"/></mujoco>"""
T = 1e-3


def made(**other: Any) -> MujocoEngine:
    given = {"model": MODEL, "tools": ["x"], "bodies": ["wall"], "stiffness": [2000.0]}
    return MujocoEngine(("p",), T, given | other)


@pytest.mark.parametrize(
    ("other", "error"),
    [
        ({"model": "<mujoco><worldbody>"}, "XML"),
        ({"tools": ["y"]}, "found no joint 'y' in the model"),
        (
            {"tools": ["turn"]},
            "found a hinge joint 'turn' for the port 'p', whose axis is a translation; expected a slide joint",
        ),
        (
            {"turning": ["p"]},
            "found a slide joint 'x' for the port 'p', whose axis is a rotation; expected a hinge joint",
        ),
        ({"tools": ["loose"]}, "found a ball joint 'loose' for the port 'p'"),
        ({"tools": ["away"]}, "found a free joint 'away' for the port 'p'"),
        ({"bodies": ["hub"]}, "found no body 'hub' in the model"),
        (
            {"stiffness": [2e4]},
            r"found an avatar of 0\.05 kg at the joint 'x'; expected at least 0\.08 kg for a stiffness of 20000 N/m",
        ),
        (
            {"tools": ["turn"], "turning": ["p"], "stiffness": [100.0]},
            r"found an avatar of 0\.000173 kg·m² at the joint 'turn'; expected at least 0\.0004 kg·m² for a "
            "stiffness of 100 N·m/rad",
        ),
    ],
)
def test_what_does_not_fit_is_refused(other: dict[str, Any], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        made(**other)


def test_an_avatar_is_pushed_by_the_opposite_of_the_force_and_stopped_by_a_body() -> None:
    engine = made()
    for _ in range(400):
        (q,) = engine.step(np.zeros(1), np.array([-0.5]))
    assert 0.005 < q < 0.02  # at the wall, whose near face is 20 mm away, less the avatar's radius
    assert len(engine.positions()) == 3


def test_an_avatar_that_turns_is_pushed_by_the_opposite_torque() -> None:
    engine = made(tools=["turn"], turning=["p"], stiffness=[20.0], bodies=[])
    inertia, ticks = 0.2 * (0.01**2 + 0.05**2) / 3.0, 100
    for _ in range(ticks):
        (q,) = engine.step(np.zeros(1), np.array([-0.01]))
    assert q == pytest.approx(0.5 * 0.01 / inertia * (ticks * T) ** 2, rel=0.02)


def test_two_axes_do_not_share_a_joint() -> None:
    given = {"model": MODEL, "tools": ["x", "x"], "bodies": [], "stiffness": [2000.0, 2000.0]}
    with pytest.raises(
        FactoryError, match="found the joint 'x' for two axes; expected a joint of its own for each axis"
    ):
        MujocoEngine(("p", "q"), T, given)


def test_a_model_that_grows_without_bound_is_a_failure_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = AskedModel("some:engine", made(), ("p",))
    for k in range(50):
        asked.proxies(np.zeros(1), np.array([-1e12 * k]), k)
    assert asked.failure is not None
    assert "the engine some:engine failed at tick" in asked.failure
    assert asked.failure.endswith("; its file is environment.model")
    assert "RuntimeError: MuJoCo warns:" in asked.failure
    assert not list(tmp_path.iterdir())


class Bodies:
    """An engine without any dynamics, which reports what it is given."""

    def __init__(self, positions: Any, orientations: Any = ()) -> None:
        self._positions, self._orientations = positions, orientations

    def step(self, x: np.ndarray, f: np.ndarray) -> np.ndarray:
        return np.minimum(x, 0.0)

    def positions(self) -> Any:
        return self._positions() if callable(self._positions) else self._positions

    def orientations(self) -> Any:
        return self._orientations() if callable(self._orientations) else self._orientations


@pytest.mark.parametrize("positions", [[1.0, 2.0], [0.0, 0.0, np.inf], [[0.0, 0.0, 0.0]], None, lambda: 1 / 0])
def test_positions_that_make_no_sense_are_a_failure(positions: Any) -> None:
    asked = AskedModel("some:engine", Bodies(positions), ("p",))
    law = ProxyLaw(asked, np.eye(1), None, T, [[0]], bodies=1)
    assert law.masses == [0.0, 0.0, 0.0]
    assert law.failure is not None
    assert "the engine some:engine failed" in law.failure


@pytest.mark.parametrize("found", [[1.0, 0.0], [0.9, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, np.nan], None, lambda: 1 / 0])
def test_orientations_that_make_no_sense_are_a_failure(found: Any) -> None:
    asked = AskedModel("some:engine", Bodies([0.0] * 3, found), ("p",))
    law = ProxyLaw(asked, np.eye(1), None, T, [[0]], bodies=1, oriented=1)
    assert law.masses == [0.0] * 3
    assert law.failure is None
    assert law.orientations == [1.0, 0.0, 0.0, 0.0]
    assert law.failure is not None
    assert "the engine some:engine failed" in law.failure


def test_a_body_is_said_to_turn_as_it_does() -> None:
    engine = made(tools=["turn"], turning=["p"], stiffness=[20.0], bodies=["wall"], orientations=["wall"])
    assert engine.orientations() == [1.0, 0.0, 0.0, 0.0]
    q = [float(engine.step(np.zeros(1), np.array([-0.01]))[0]) for _ in range(50)]
    w, x, y, z = engine.orientations()
    assert (x, y) == (0.0, 0.0)
    assert w == pytest.approx(np.sqrt(1.0 - z * z), abs=1e-12)
    assert 0.05 < q[-2] < 2.0 * np.arcsin(z) < q[-1]  # it is that of the second of two steps, before it


def test_an_engine_that_does_not_say_how_bodies_are_turned_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = prepare(load_session(SHIPPED, ["environment.orientations=[puck]"]))
    Simulation(prepared)
    monkeypatch.delattr(MujocoEngine, "orientations")
    with pytest.raises(FactoryError, match=r"^environment\.orientations: found puck with .*no method orientations"):
        Simulation(prepared)


def test_the_suite_tries_engines() -> None:
    def findings(make: Any) -> list[Any]:
        return list(check_model("some:engine", make, ("p",), T, 0.005, stiffness=2000.0))

    assert broken(findings(lambda: Bodies([0.0] * 3))) == []
    assert broken(findings(lambda: Bodies([0.0] * 4))) == ["wrong answer"]
    found = findings(made)
    assert broken(found) == []
    assert Conformance.OPEN not in {finding.verdict for finding in found if finding.check != "held"}


def test_a_bad_position_has_the_unit_of_its_axis() -> None:
    asked = AskedModel("some:engine", Bodies([]), ("p", "q"), ("q",))
    asked.proxies(np.array([0.0, -1e4]), np.zeros(2), 3)
    assert asked.failure is not None
    assert "found a position of -10000 rad at q; expected a finite number of at most 1000 rad" in asked.failure


def test_mujoco_has_its_short_name() -> None:
    assert published(ENGINES)["mujoco"] == f"{MujocoEngine.__module__}:{MujocoEngine.__name__}"


def test_the_shipped_session_is_certified_held_by_nobody_and_the_same_again() -> None:
    """Also while a user is away. The puck, gripped from both sides, is moved."""
    session = load_session(SHIPPED)
    assert haptic_loop(session).environment.level.max() == 0.0  # type: ignore[attr-defined]
    prepared = prepare(session)
    runs = []
    for _ in range(2):
        simulation = Simulation(prepared)
        traces = simulation.traces(1200)
        f = simulation.run(1200, faults=[Silence("cr", 800, 950)], traces=traces).f_v
        (masses,) = (kept.values for kept in traces.by_node["environment"] if kept.topic.name == "masses")
        world_kept(simulation)
        runs.append((f, masses))
    for one, again in zip(*runs, strict=True):
        np.testing.assert_array_equal(one, again)
    assert abs(f[:, 0]).max() > 1.0
    assert masses.shape == (1200, 3)
    assert masses[700, 0] > 0.01


def test_a_model_file_is_found_beside_the_session_and_kept_as_text(tmp_path: Path) -> None:
    text = SHIPPED.read_text(encoding="utf-8")
    start, end = text.index("  model: |"), text.index("design:")
    (tmp_path / "s.yaml").write_text(text[:start] + "  model: table.xml\n" + text[end:], encoding="utf-8")
    with pytest.raises(SessionError, match=r"environment\.model: found 'table\.xml', which cannot be read"):
        load_session(tmp_path / "s.yaml")
    (tmp_path / "table.xml").write_text(MODEL, encoding="utf-8")
    session = load_session(tmp_path / "s.yaml")
    assert session.environment.model == MODEL  # type: ignore[union-attr]
    assert type(session).model_validate(session.as_plain()) == session
    with pytest.raises(FactoryError, match="found no joint 'left_x' in the model"):
        Simulation(prepare(session))


@pytest.mark.parametrize(
    ("override", "error"),
    [
        ("environment.tools={left: [a, b]}", r"environment\.tools: found no name for .*right"),
        ("environment.tools.left=[a]", r"environment\.tools\.left: .*expected 2 names"),
        ("environment.tools.middle=[a]", r"environment\.tools\.middle: .*the name of a device"),
        ("environment.tools.left=['a b', c]", r"environment\.tools.*a name in the model"),
        ("environment.bodies=[puck, puck]", r"environment\.bodies.*different bodies"),
        ("environment.orientations=[table]", r"environment\.orientations: found 'table'; expected some of.*puck"),
        ("environment.engine=unknown", r"environment\.engine: found 'unknown'; expected mujoco"),
        ("environment.level=-1", r"environment\.level: .*no negative eigenvalue"),
    ],
)
def test_errors_are_reported_at_their_place(override: str, error: str) -> None:
    with pytest.raises(SessionError, match=error):
        load_session(SHIPPED, [override])


class Loaded:
    """An avatar of 50 g on a line, pushed by a constant force of 2 N, as by gravity or by a door with a spring."""

    def __init__(self) -> None:
        self.q, self.v = 0.0, 0.0

    def step(self, x: np.ndarray, f: np.ndarray) -> np.ndarray:
        for _ in range(4):
            self.v += 0.25 * T * (2.0 - f[0] - 2.0 * self.v) / 0.05
            self.q += 0.25 * T * self.v
        return np.array([self.q])

    def positions(self) -> list[float]:
        return []


def loaded(tank: float = 0.0) -> tuple[EnforcedCore, Loaded]:
    engine = Loaded()
    law = ProxyLaw(AskedModel("some:engine", engine, ("p",)), 2000.0 * np.eye(1), None, T, [[0]], tank=tank)
    return EnforcedCore(law, np.eye(1) / 800.0, np.zeros((1, 1)), T, False, stored=tank), engine


def test_a_held_avatar_is_pulled_back_to_its_tool() -> None:
    """The engine is given the force of the spring where the avatar is, not of the proxy that is held."""
    core, engine = loaded()
    for _ in range(3000):
        core.react([0.0])
        core.settle()
        assert abs(engine.q) < 8e-3  # 2 N stretch spring and coupling by 3.5 mm, and a blow twice as far
    assert core.held[0] > 2000
    assert core.failure is None
    assert core.ledger is not None
    assert core.ledger.minimum >= 0.0


def test_a_tank_lets_a_load_be_felt_from_the_start() -> None:
    """What the load may give out is stated, and bounded by the test; then nothing is held, and the hand feels 2 N."""
    core, _ = loaded(0.05)
    for _ in range(3000):
        (f,) = core.react([0.0])
        core.settle()
    assert core.held == [0]
    assert f == pytest.approx(2.0, abs=1e-6)
    assert core.ledger is not None
    assert 0.0 <= core.ledger.minimum < 0.05
    core, _ = loaded(1e-4)
    for k in range(3000):  # a hand that gives way takes out all that is there, and no more
        (f,) = core.react([1e-5 * k])
        core.settle()
    assert core.held[0] > 1000
    assert core.ledger is not None
    assert -1e-15 <= core.ledger.minimum < 1e-5
