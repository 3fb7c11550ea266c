"""MuJoCo models from strangers: nothing but the session's own assets is read, and nothing is without a bound."""

from __future__ import annotations

import base64
import os
import resource
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from manyhands.nodes.environment import mujoco_compiler
from manyhands.nodes.environment.mjcf import MOST_STEPS, ModelRefused, require_bounded, steps_of
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.kernel.factory import FactoryError

T = 1e-3
TOOL = '<body><joint name="x" type="slide"/><geom size="0.01" mass="0.05"/></body>'
TETRAHEDRON = (
    "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"  # the faces point outwards
)


def model(world: str = "", before: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{TOOL}{world}</worldbody></mujoco>"


def made(text: str, assets: Mapping[str, bytes] | None = None) -> MujocoEngine:
    files = {name: base64.b64encode(file).decode() for name, file in (assets or {}).items()}
    given: dict[str, Any] = {"model": text, "tools": ["x"], "bodies": [], "stiffness": [100.0], "assets": files}
    return MujocoEngine(("p",), T, given)


def asset(kind: str, file: str) -> str:
    size = 'size="1 1 1 1"' if kind == "hfield" else ""
    return model(before=f'<asset><{kind} name="a" {file} {size}/></asset>')


PATHS = ["/etc/hostname", "../part.obj", "folder/part.obj", "part.obj", "http://example.org/part.obj", ""]


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("kind", ["mesh", "hfield", "texture", "skin"])
def test_a_file_that_is_no_asset_is_not_read(kind: str, path: str) -> None:
    with pytest.raises(FactoryError, match=r"environment\.model: found file='.*expected the name of a file that the"):
        made(asset(kind, f'file="{path}"'))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (model(before='<include file="/etc/hostname"/>'), "found <include>; expected the included text"),
        (model(world='<include file="part.obj"/>'), "found <include>"),
        (model(before='<asset><model name="m" file="part.obj"/></asset>'), "found <model>; expected one model"),
        (model(world='<attach model="m" body="b" prefix="p"/>'), "found <attach>"),
        (model(before='<extension><plugin plugin="mujoco.sdf.torus"/></extension>'), "found <extension>"),
        (model(before='<compiler meshdir="/etc"/>'), "found meshdir='/etc'; expected assets by name alone"),
        (model(before='<compiler texturedir=".."/>'), "found texturedir"),
        (model(before='<compiler assetdir="a"/>'), "found assetdir"),
        (asset("texture", 'type="cube" fileright="/etc/hostname"'), "found fileright='/etc/hostname'"),
        (model(world='<flexcomp name="f" type="gmsh" file="/etc/hostname"/>'), "found file='/etc/hostname'"),
        ('<robot name="r"><link name="l"/></robot>', "found <robot> around the model"),
        ('<!DOCTYPE m [<!ENTITY a "aaaa">]><mujoco>&a;</mujoco>', "found a document type or entities"),
        ("<mujoco><worldbody>", "not XML"),
        ("\ud800", "not XML"),
        ("\0", "not XML"),
    ],
)
def test_no_other_text_folder_or_code_is_reached(text: str, error: str) -> None:
    with pytest.raises(FactoryError, match=rf"^environment\.model: .*{error}"):
        made(text)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        *((model(before=f'<option timestep="{dt}"/>'), "found a timestep of") for dt in ("1e-12", "0", "-1", "nan")),
        (model(before='<option timestep="inf"/>'), "found a timestep of inf"),
        (model(before='<option timestep="0.1"/><option timestep="1e-12"/>'), "found a timestep of 1e-12"),
        (model(before='<option timestep="soon"/>'), "found timestep='soon' at <option>; expected a number"),
        (model(before='<option iterations="2000000000"/>'), "found iterations='2000000000' at <option>"),
        (model(world='<replicate count="100000000"><geom size="1"/></replicate>'), "more than 10000 parts"),
        (model(world='<replicate count="99"><replicate count="99"><site/></replicate></replicate>'), "10000 parts"),
        (model(world='<replicate count="2001"><geom size="1"/></replicate>'), "more than 2000 geoms"),
        (model(world='<replicate count="many"><site/></replicate>'), "found count='many' at <replicate>"),
        (model(world='<flexcomp name="f" type="grid" count="200 200 100"/>'), "more than 10000 parts"),
        (model(world='<composite type="cable" count="100000 1 1"/>'), "more than 10000 parts"),
        (asset("hfield", 'nrow="20000" ncol="2"'), "found nrow='20000' at <hfield>; expected at most 1024"),
        (asset("texture", 'builtin="flat" width="30000" height="2"'), "found width='30000' at <texture>"),
        (model(before='<default><texture height="30000"/></default>'), "found height='30000' at <texture>"),
        (model(before='<size memory="100G"/>'), "found memory='100G' at <size>; expected at most 64M"),
        (model(before='<size memory="many"/>'), "found memory='many'"),
        (model(before='<size nuserdata="400000000"/>'), "found nuserdata"),
        (model(before='<size nkey="100000000"/>'), "found nkey"),
        (model(before='<size nuser_geom="400000000"/>'), "found nuser_geom"),
        (model(world=120 * "<body>" + 120 * "</body>"), "elements 101 deep"),
        (model(world=10_001 * "<site/>"), "more than 10000 parts"),
    ],
)
def test_what_is_asked_for_has_bounds_before_anything_is_compiled(text: str, error: str) -> None:
    with pytest.raises(ModelRefused, match=error):
        require_bounded(text, (), T)


def test_steps_are_whole_and_at_most_so_many() -> None:
    assert [steps_of(dt, T) for dt in (1.0, T, 0.5 * T, 0.3 * T, T / MOST_STEPS)] == [1, 1, 2, 4, MOST_STEPS]
    with pytest.raises(ModelRefused):
        steps_of(T / (MOST_STEPS + 1), T)


def test_assets_are_found_by_name_and_no_file_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe of the asset's name stands in the working folder: to open it would wait for ever."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("part.obj")
    text = model(world='<geom type="mesh" mesh="a"/>', before='<asset><mesh name="a" file="part.obj"/></asset>')
    assert made(text, {"part.obj": TETRAHEDRON.encode()})._model.nmeshvert == 4
    with pytest.raises(FactoryError, match=r"found file='part\.obj'.*where there is none"):
        made(text)


def test_the_compiler_cannot_open_what_the_text_was_not_seen_to_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second line: even a text that is not looked at, as if MuJoCo read it in another way, opens nothing."""
    monkeypatch.setattr(mujoco_compiler, "require_bounded", lambda *_: None)
    part = tmp_path / "part.obj"
    part.write_text(TETRAHEDRON, encoding="utf-8")
    included = tmp_path / "included.xml"
    included.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", encoding="utf-8")
    for text in (asset("mesh", f'file="{part}"'), model(before=f'<include file="{included}"/>')):
        with pytest.raises(FactoryError, match=r"^environment\.model: "):
            made(text)
    with pytest.raises(FactoryError, match="found a timestep of 1e-12 s"):
        made(model(before='<option timestep="1e-12"/>'))
    with pytest.raises(FactoryError, match="ngeom = 3002; expected at most 2000"):
        made(model(world='<replicate count="3001" offset="1 0 0"><geom size="0.1"/></replicate>'))


def test_memory_has_a_limit_for_all_together() -> None:
    """200 fields of 4 MiB, each within its bound; nothing of it is left in this process."""
    fields = "".join(f'<hfield name="h{i}" nrow="1024" ncol="1024" size="1 1 1 1"/>' for i in range(200))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FactoryError, match=r"^environment\.model: .*and 512 MiB"):
        made(model(before=f"<asset>{fields}</asset>"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


def test_time_has_a_limit_and_the_compiler_is_gone_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco_compiler, "MOST_WAIT", 0.0)
    children: list[Any] = []
    popen = mujoco_compiler.subprocess.Popen

    def kept(*given: Any, **options: Any) -> Any:
        children.append(popen(*given, **options))
        return children[-1]

    monkeypatch.setattr(mujoco_compiler.subprocess, "Popen", kept)
    with pytest.raises(FactoryError, match="found a model that takes MuJoCo longer; expected one"):
        made(model(world="<site/>"))
    (child,) = children
    assert child.returncode is not None


@pytest.mark.parametrize(("code", "said"), [(-11, "ended by the signal SIGSEGV"), (1, "exit code 1"), (-24, "longer")])
def test_a_compiler_that_ends_without_an_answer_is_one_error(code: int, said: str) -> None:
    assert said in mujoco_compiler._unanswered(code)
    assert "expected one that it compiles and begins in 10 s and 512 MiB" in mujoco_compiler._unanswered(code)
