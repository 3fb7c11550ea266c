"""The command that turns a mesh into a distance grid, and what it says of files that are no solids."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from manyhands.design.models.distance_grid import grid_of_text
from manyhands.launch.session import limits, load_session

from ....support.commands import manyhands_command
from ....support.meshes import shape

pytestmark = pytest.mark.usefixtures("own_interrupt")

ROOT = Path(__file__).parents[4]
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def exported(path: Path, **options: Any) -> Path:
    """The box, in mm."""
    box = shape("box")
    trimesh.Trimesh(box.vertices * 1e3, box.triangles, process=False).export(path, **options)
    return path


@pytest.mark.parametrize("name", ["box.stl", "box.obj", "text.stl"])
def test_every_kind_of_file_gives_the_same_grid(name: str, folder: Path) -> None:
    exported(folder / name, **({"file_type": "stl_ascii"} if name == "text.stl" else {}))
    done = manyhands_command("mesh", name, "-o", "out.grid", "--cell", "0.002")
    assert (done.exit_code, done.stdout) == (0, "")
    assert done.stderr == (
        "out.grid: 12 triangles of 40 x 30 x 20 mm, in 29 x 24 x 19 nodes 2 mm apart; next: environment: {type: mesh, "
        "model: out.grid, ...}\n"
    )
    made = grid_of_text((folder / "out.grid").read_text())
    middle = made.distances[14, 12, 9]
    assert middle == pytest.approx(-0.008)
    assert len(made.surface.triangles) == 12


def test_what_is_not_stated(folder: Path) -> None:
    """The grid's name is the mesh's, and a cell is a 64th of the longest side."""
    exported(folder / "box.stl")
    assert manyhands_command("mesh", "box.stl").exit_code == 0
    made = grid_of_text((folder / "box.grid").read_text())
    assert made.cell == pytest.approx(0.00063, abs=1e-5)


def test_other_files_that_a_mesh_names_are_not_read(folder: Path) -> None:
    (folder / "a.obj").write_text(f"mtllib /proc/self/mem\nusemtl m\n{TETRAHEDRON}")
    done = manyhands_command("mesh", "a.obj", "--unit", "cm")
    assert done.exit_code == 0
    assert "4 triangles of 10 x 10 x 10 mm" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"hello", "found no triangles"),
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100, "found no"),
        ("a.obj", b"", "found no triangles"),
        ("a.obj", b"v 1 2\nf 1 2 3 4\nf 9 9 9", "found no mesh"),
        ("a.obj", TETRAHEDRON.replace("f 1 4 3\n", "").encode(), "3 edges with one triangle alone"),
        ("a.obj", TETRAHEDRON.replace("v 0 0 0", "v nan 0 0").encode(), "not finite"),
        ("a.obj", TETRAHEDRON.replace("v 1 0 0", "v 0 0 0.5").encode(), "without area"),
        ("a.ply", b"", "found the suffix '.ply'; expected .stl or .obj"),
        ("a.stl", None, "found no readable file"),
    ],
)
def test_what_is_no_solid_ends_with_one_sentence_and_no_file(
    name: str, content: bytes | None, said: str, folder: Path
) -> None:
    if content is not None:
        (folder / name).write_bytes(content)
    done = manyhands_command("mesh", name, "-o", "out.grid")
    assert (done.exit_code, done.stdout) == (2, "")
    assert re.fullmatch(f"error: {re.escape(name)}: found .*; expected .*\n", done.stderr)
    assert said in done.stderr
    assert not (folder / "out.grid").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--unit", "ft"], "--unit: found 'ft'; expected one of m, cm, mm, inch"),
        (["--cell", "nan"], "--cell, --band: found cells of nan m"),
        (["--cell", "-1"], "--cell, --band: found cells of -1 m"),
        (["--band", "1"], "--cell, --band: found cells of"),
        (["--cell", "0.0001"], "expected at most 1048576, which takes cells of about 0.00029 m"),
        (["-o", "no/such/out.grid"], "found no folder no"),
    ],
)
def test_options(options: list[str], said: str, folder: Path) -> None:
    exported(folder / "box.stl")
    done = manyhands_command("mesh", "box.stl", *options)
    assert done.exit_code == 2
    assert said in done.stderr
    assert [path.name for path in folder.iterdir()] == ["box.stl"]


@pytest.mark.parametrize(
    ("limit", "most", "said"), [("MAX_MESH_BYTES", 600, "longer"), ("MAX_MODEL_BYTES", 900, "grid of")]
)
def test_sizes(limit: str, most: int, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exported(folder / "box.stl")  # 684 bytes
    from manyhands.launch.app import mesh

    assert getattr(limits, limit) > most
    monkeypatch.setattr(mesh, limit, most)
    done = manyhands_command("mesh", "box.stl")
    assert done.exit_code == 2
    assert said in done.stderr
    assert "takes larger cells" in done.stderr or limit == "MAX_MESH_BYTES"


def test_the_shipped_grid_is_that_of_the_shipped_mesh(folder: Path) -> None:
    """``examples/relief.py`` and this command make what ``stroke.yaml`` holds."""
    relief = runpy.run_path(str(ROOT / "examples" / "relief.py"))
    data = relief["stl"](relief["corners"]())
    assert len(data) < 100_000
    (folder / "relief.stl").write_bytes(data)
    assert manyhands_command("mesh", "relief.stl", "--cell", "0.002").exit_code == 0
    made = grid_of_text((folder / "relief.grid").read_text())
    shipped = grid_of_text(load_session(ROOT / "launch" / "sessions" / "stroke.yaml").environment.model)
    np.testing.assert_array_equal(made.distances, shipped.distances)
    assert made.digest == shipped.digest
