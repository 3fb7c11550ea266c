"""The reference of the format agrees with the models."""

import re
from pathlib import Path

import pytest

from manyhands.launch.session import (
    BROWSER_HAND,
    BlockMatrices,
    CouplingBlock,
    Design,
    Device,
    EngineEnvironment,
    Faults,
    Hand,
    MeshEnvironment,
    ModelEnvironment,
    Motion,
    NetworkEnvironment,
    Observer,
    Pole,
    PortLimits,
    PythonEnvironment,
    Rational,
    SceneEnvironment,
    Session,
    SessionLink,
    StateSpaceEnvironment,
    TraceData,
    TransferFunctionEnvironment,
    WaveLink,
    Weight,
    Weights,
    limits,
    load_session,
)
from manyhands.launch.session.fields import OnAxes, SessionModel, keys_of
from manyhands.launch.session.friction import Friction
from manyhands.launch.session.kind import EnvironmentKind
from manyhands.launch.session.orientation import Orientation, OrientationLimits
from manyhands.launch.session.scene import (
    SceneBody,
    SceneContact,
    SceneHoldByButton,
    SceneObstacle,
    ScenePair,
    SceneSpring,
    SceneTool,
    ShapedThing,
)
from manyhands.launch.session.wave_link import SimulatedNetwork
from manyhands.nodes.device import pointer

from ...support.meshes import grid

DOCS = Path(__file__).parents[3] / "docs"
INDEX = (DOCS / "session-file.md").read_text(encoding="utf-8")
PAGES = list(dict.fromkeys(re.findall(r"\]\((session-file/\w+\.md)\)", INDEX)))  # in its order
PAGE = "\n".join([INDEX, *((DOCS / name).read_text(encoding="utf-8") for name in PAGES)])
SECTIONS = dict(re.findall(r"^##? (.+?)\n(.*?)(?=^##? |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))
MODELS: dict[str, tuple[type[SessionModel], ...]] = {
    "Session": (Session,),
    "Device": (Device,),
    "Trace": (Motion,),
    "Limits": (PortLimits,),
    "Friction": (Friction,),
    "Orientation": (Orientation, OrientationLimits),
    "Hand": (Hand, Rational, TraceData),
    "Coupling": (CouplingBlock,),
    "Wave link": (WaveLink,),
    "Simulated network": (SimulatedNetwork,),
    "Network": (NetworkEnvironment,),
    "Link": (SessionLink,),
    "Scene": (SceneEnvironment,),
    "Tool": (SceneTool,),
    "Body": (SceneBody,),
    "Obstacle": (SceneObstacle,),
    "Contact": (SceneContact,),
    "Contact pair": (ScenePair,),
    "Spring": (SceneSpring,),
    "Hold": (SceneHoldByButton,),
    "State space": (StateSpaceEnvironment,),
    "Transfer function": (TransferFunctionEnvironment,),
    "Model": (PythonEnvironment,),
    "Engine": (EngineEnvironment,),
    "Mesh": (MeshEnvironment,),
    "Design": (Design, Pole),
    "Weights": (Weights, Weight),
    "Matrices": (BlockMatrices,),
    "Observer": (Observer,),
    "Faults": (Faults,),
}


@pytest.mark.parametrize("section", MODELS)
def test_every_key_has_its_row_and_every_row_its_key(section: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \|", SECTIONS[section], flags=re.MULTILINE)
    assert rows == [key for model in MODELS[section] for key in keys_of(model)]
    assert "\nExample: `" in SECTIONS[section]


def test_every_part_of_a_session_has_a_section() -> None:
    def parts(model: type[SessionModel]) -> set[type[SessionModel]]:
        return set(model.__subclasses__()).union(*(parts(part) for part in model.__subclasses__()))

    own = {part for part in parts(SessionModel) if part.__module__.startswith("manyhands.")}
    assert own - {ModelEnvironment, EnvironmentKind, OnAxes, ShapedThing} == {
        model for models in MODELS.values() for model in models
    }


def test_every_page_of_the_format_is_in_its_index() -> None:
    assert {DOCS / name for name in PAGES} == {*(DOCS / "session-file").glob("*.md")}


def test_the_example_is_a_session(tmp_path: Path) -> None:
    (example,) = re.findall(r"^```yaml\n(.*?)^```", INDEX, flags=re.MULTILINE | re.DOTALL)
    path = tmp_path / "two-hands.yaml"
    path.write_text(example, encoding="utf-8")
    assert load_session(path).blocks == (("left",), ("right.x", "right.y"))


BASE = """
session: one-port
period: 0.001
devices: {dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, buttons: [grip], hand: {}}}
couplings: {cx: {devices: [dx]}}
environment:
  type: network
  masses: {hub: 3.0}
  links: [{between: [dx, hub], stiffness: 1}, {between: [hub, ground], stiffness: 1}]
design: {coupling: spring-damper}
"""
OVERRIDES = {
    "Session": "{key}={value}",
    "Device": "devices.{key}={value}",
    "Trace": "devices.dx={{dof: 1, osp: 1.37, driver: trace, {key}: {value}}}",
    "Limits": "devices.dx.{key}={value}",
    "Friction": "devices.dx.{key}={value}",
    "Orientation": "devices.dx={{dof: 3, osp: 1.37, driver: simulated, mass: 0.2, buttons: [grip], {key}: {value}}}\n"
    "environment={{type: engine, engine: mujoco, model: <mujoco/>, stiffness: 500, tools: {{dx: [x, y, z]}}, "
    "avatars: {{dx: turn}}}}",
    "Hand": "devices.dx.hand.{key}={value}",
    "Coupling": "couplings.{key}={value}",
    "Wave link": "couplings.cx.wave_link={{{key}: {value}}}",
    "Simulated network": "couplings.cx.wave_link={{b: 20, network: {{{key}: {value}}}}}",
    "Interval": "environment.links.0.{key}={value}",
    "Network": "environment.{key}={value}",
    "Link": "environment.links.0={{{key}: {value}}}",
    "Scene": "environment={{{key}: {value}}}",
    "Tool": "environment={{type: scene, tools: {{{key}: {value}}}}}",
    "Body": "environment={{type: scene, tools: {{dx: {{}}}}, bodies: {{{key}: {value}}}}}",
    "Obstacle": "environment={{type: scene, tools: {{dx: {{at: [9, 9, 9]}}}}, obstacles: {{{key}: {value}}}}}",
    "Contact": "environment={{type: scene, tools: {{dx: {{}}}}, contact: {{{key}: {value}}}}}",
    "Contact pair": "environment={{type: scene, tools: {{dx: {{}}}}, "
    "obstacles: {{floor: {{shape: sphere, at: [0, 0, -1], radius: 0.1}}}}, contacts: [{{{key}: {value}}}]}}",
    "Spring": "environment={{type: scene, tools: {{dx: {{}}}}, bodies: {{ball: {{mass: 1, at: [0, 0, 0]}}}}, "
    "links: [{{{key}: {value}}}]}}",
    "Hold": "environment={{type: scene, tools: {{dx: {{}}}}, holds: [{{{key}: {value}}}]}}",
    "State space": "{key}={value}",
    "Transfer function": "{key}={value}",
    "Model": "{key}={value}",
    "Engine": "{key}={value}",
    "Mesh": "environment={{{key}: {value}}}",
    "Design": "{key}={value}",
    "Weights": "design={{coupling: spring-damper, objective: loop-shaping, {key}: {value}}}",
    "Matrices": "design={{coupling: given, matrices: {{{key}: {value}}}}}",
    "Observer": "observers={{{key}: {value}}}",
    "Faults": "{key}={value}",
}
EXAMPLES = [
    (section, text) for section in SECTIONS for text in re.findall("^Example: `(.+)`$", SECTIONS[section], re.M)
]


def base(folder: Path) -> Path:
    """A session into which the examples fit, beside the grid that one of them names."""
    (folder / "base.yaml").write_text(BASE, encoding="utf-8")
    (folder / "part.grid").write_text(grid("box").text, encoding="utf-8")
    return folder / "base.yaml"


@pytest.mark.parametrize(("section", "text"), EXAMPLES)
def test_every_example_may_stand_in_a_session(section: str, text: str, tmp_path: Path) -> None:
    key, _, value = text.removeprefix("{").partition(": ")
    value = value.removesuffix("}") if text.startswith("{") else value
    load_session(base(tmp_path), OVERRIDES[section].format(key=key, value=value).split("\n"))


def test_the_hand_at_a_browser_is_the_one_in_force() -> None:
    hand = SECTIONS["Hand"]
    assert f"`stiffness` ({BROWSER_HAND['stiffness']:g} N/m unless" in hand
    assert f"`damping` ({BROWSER_HAND['damping']:g} N·s/m)" in hand
    assert f"{pointer.SPEED:g} m/s, or half its limit of speed" in hand
    assert f"{pointer.ACCELERATION:g} m/s²" in hand
    assert f"than {pointer.REACH:g} of its limit" in hand
    assert f"silent for {pointer.PATIENCE:g} s" in hand


def test_the_limits_are_the_ones_in_force() -> None:
    told = PAGE.replace(",", "")
    for limit in (
        f"most {limits.MAX_NODES} values",
        f"most {limits.MAX_DEPTH} deep",
        f"most {limits.MAX_OVERRIDES} overrides",
        f"whole 1 to {limits.MAX_DOF} |",
        f"devices by name | | required | 1 to {limits.MAX_DEVICES} |",
        f"by name | | required | 1 to {limits.MAX_COUPLINGS} |",
        f"at most {limits.MAX_PORTS}.",
        f"at most {limits.MAX_MASSES} |",
        f"1 to {limits.MAX_LINKS} |",
        f"states (at most {limits.MAX_ORDER})",
        f"degree at most {limits.MAX_DEGREE})",
        f"whole 1 to {limits.MAX_PORT_ORDER};",
        f"1 to {limits.MAX_POLES} pairs",
        f"at most {limits.MAX_ORDER} states",
        f"n states (at most {limits.MAX_ENVIRONMENT_ORDER})",
        f"all entries together at most {limits.MAX_ENVIRONMENT_ORDER}",
        f"whole 1 to {limits.MAX_ITERATIONS};",
        f"at most {limits.MAX_FACTORY_NAME} characters",
        f"at most {limits.MAX_OBSERVERS} |",
        f"1 to {limits.MAX_READS} distinct",
        f"| | {limits.DEFAULT_RESTARTS} | whole 0 to {limits.MAX_RESTARTS} |",
        f"| s | {limits.DEFAULT_WINDOW:g} | greater than 0 at most {limits.LONGEST_WINDOW:.0f} |",
        f"| N | {limits.DEFAULT_FORCE:g} | greater than 0 |",
        f"| m | {limits.DEFAULT_DISPLACEMENT:g} | greater than 0 |",
        f"| m/s | {limits.DEFAULT_SPEED:g} | greater than 0 |",
        f"| s | required with `mass` | greater than 0 at most {limits.LONGEST_ROUND_TRIP:g} |",
        f"| J | {limits.DEFAULT_WAVE_TANK:g} | 0 to {limits.LARGEST_TANK:g} |",
        f"| measured while joining | whole 0 to {limits.MAX_DEPTH_TICKS} |",
    ):
        assert limit in told
    assert told.count(f"| whole 0 to {limits.MAX_DELAY}") == 3  # every kind of environment
    assert (limits.MAX_FILE_BYTES, limits.MAX_MAGNITUDE, limits.MIN_POSITIVE) == (8 << 20, 1e12, 1e-12)
    assert f"at most {limits.MAX_MOTION_NUMBERS} numbers together" in told
    assert (limits.MAX_TRACE_ROWS, limits.MAX_COEFFICIENT) == (10**6, 1e24)
