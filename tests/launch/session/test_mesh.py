"""Meshes in session files: what they become, what the certificate depends on, and the place of every error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.design.environments import environment_of
from manyhands.design.models.declared import ProxyEnvironment
from manyhands.design.models.scene import geometry_of
from manyhands.launch.session import MeshEnvironment, Session, SessionError, load_session
from manyhands.nodes.environment.mesh import MeshProxies
from manyhands.nodes.kernel.factory import FactoryError, FactoryName, made_by, require_allowed

from ...support.meshes import grid, shape

TEXT = """
session: touch
period: 0.001
devices:
  anna: {dof: 3, osp: 1.37, driver: simulated, mass: 0.2, hand: {}}
  ben: {dof: 2, axes: [z, x], osp: 1.37, driver: simulated, mass: 0.2, hand: {}}
couplings: {ca: {devices: [anna]}, cb: {devices: [ben]}}
environment:
  type: mesh
  model: box.grid
  stiffness: 3000
  friction: 0.3
  tools:
    anna: {at: [0, 0, 0.02], radius: 0.003}
    ben: {at: [0.03, 0, 0]}
design: {coupling: spring-damper}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "box.grid").write_text(grid("box").text, encoding="utf-8")
    file = tmp_path / "touch.yaml"
    file.write_text(TEXT, encoding="utf-8")
    return file


def environment(path: Path, *overrides: str) -> ProxyEnvironment:
    session = load_session(path, overrides)
    found = session.environment.for_design(session.ports)
    assert isinstance(found, ProxyEnvironment)
    return found


def test_a_file_becomes_springs_to_proxies(path: Path) -> None:
    session = load_session(path)
    found = environment(path)
    np.testing.assert_array_equal(found.stiffness, 3000.0 * np.eye(5))
    assert not found.level.any()
    name = session.foreign_code["environment.model"]
    model = made_by(name, "model", session.ports, session.period)
    assert isinstance(model, MeshProxies)
    pressed = np.array([0.0, 0.0, -0.01, 0.0, -0.02])  # ben's second port moves along x
    assert model.proxy(pressed, 0) == pytest.approx([0.0, 0.0, -0.007, 0.0, -0.01], abs=1e-5)


def test_a_session_holds_its_grid_without_the_file(path: Path) -> None:
    session = load_session(path)
    again = Session.model_validate(session.as_plain())
    assert isinstance(again.environment, MeshEnvironment)
    assert again.environment.model == grid("box").text
    assert again.environment.for_design(again.ports) == session.environment.for_design(session.ports)


@pytest.mark.parametrize(
    "change",
    ["friction=0.31", "tools.anna.radius=0.002", "tools.ben.at=[0.03, 0, 0.001]", "model=other.grid", "stiffness=2999"],
)
def test_another_world_has_another_certificate(path: Path, change: str) -> None:
    (path.parent / "other.grid").write_text(grid("box", 0.0021).text, encoding="utf-8")
    own, other = environment(path), environment(path, f"environment.{change}")
    assert own != other
    assert own.terms() != other.terms()
    assert environment_of(own.terms(), own.ports) == own


def test_what_is_drawn_has_tools_and_triangles(path: Path) -> None:
    session = load_session(path)
    scene = session.environment.geometry(session.ports)
    assert scene is not None
    assert [tool.name for tool in scene.tools] == ["anna", "ben"]
    (mesh,) = scene.obstacles
    corners = np.array(mesh.points)[np.array(mesh.triangles)]
    volume = float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    assert volume == pytest.approx(0.04 * 0.03 * 0.02)
    assert geometry_of(scene.geometry_terms()) == scene
    low, high = scene.bounds
    np.testing.assert_array_equal(high[2], 0.02)  # a tool
    np.testing.assert_array_equal(low, shape("box").bounds[0])


@pytest.mark.parametrize(
    ("override", "at", "found"),
    [
        ("model=missing.grid", "model", "missing.grid"),
        ("model=3", "model", "3"),
        ("model=touch.yaml", "model", "the first line ''; expected 'manyhands distance grid 1'"),
        ('model="solid box\\nfacet"', "model", "the first line 'solid box'"),
        ("stiffness=0", "stiffness", "0"),
        ("stiffness=[1, 2, 3, 4, 5]", "stiffness", "[1, 2"),
        ("stiffness=1e9", "stiffness", "1"),
        ("friction=-0.1", "friction", "-0.1"),
        ("friction=11", "friction", "11"),
        ("tools={anna: {}}", "tools", "no tool for the device 'ben'"),
        ("tools.cleo={}", "tools.cleo", "'cleo'"),
        ("tools.anna.at=[0, 0, 0.012]", "tools.anna", "begins 1 mm inside the mesh"),
        (
            "tools.anna.radius=0.0045",
            "tools.anna.radius",
            "0.0045; expected at most 0.004, or a grid of manyhands mesh --band 5",
        ),
        ("level=-1", "level", "-1"),
        ("grid=x", "grid", "grid"),
    ],
)
def test_an_error_names_its_place(path: Path, override: str, at: str, found: str) -> None:
    with pytest.raises(SessionError) as error:
        load_session(path, [f"environment.{override}"])
    text = str(error.value)
    assert f"environment.{at}: " in text
    assert found in text
    assert len(text) < 400


def test_its_own_proxies_need_no_permission_and_other_code_does(path: Path) -> None:
    name = load_session(path).foreign_code["environment.model"]
    require_allowed(name, None)
    with pytest.raises(FactoryError, match="no permission for it"):
        require_allowed(FactoryName("some.module:Mesh", name.parameters), None)
