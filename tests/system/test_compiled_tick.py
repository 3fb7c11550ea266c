"""The build hook: a compiled tick has the numbers of pure Python; where it cannot be compiled, pure Python is left."""

from __future__ import annotations

import importlib.util
import os
import pkgutil
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterator
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.utils import parse_wheel_filename

import manyhands.launch
import manyhands.nodes
import manyhands.protocol
from manyhands.nodes.kernel.bundle import Bundle
from manyhands.nodes.monitor.session_state import About
from manyhands.nodes.recorder.node import RecordingPlan

from ..support.installed import PURE as PURE_WHEEL
from ..support.installed import run

ROOT = Path(__file__).parents[2]
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_COMPILER") == "1"


def load_hook() -> ModuleType:
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOOK = load_hook()


class App:
    def __init__(self) -> None:
        self.warnings: list[str] = []

    def display_warning(self, text: str) -> None:
        self.warnings.append(text)


def build(version: str, root: Path = ROOT) -> tuple[dict[str, Any], list[str]]:
    """What the hook does to a wheel without extensions, and its warnings."""
    app = App()
    data: dict[str, Any] = {"force_include": {}, "pure_python": True, "infer_tag": False}
    hook = HOOK.CompiledTick(str(root), {}, None, None, "", "wheel", app)
    hook.initialize(version, data)
    hook.finalize(version, data, "")
    return data, app.warnings


PURE = {"force_include": {}, "pure_python": True, "infer_tag": False}


def test_without_a_compiler_the_wheel_is_pure_python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    data, warnings = build("standard")
    assert data == PURE
    (warning,) = warnings
    assert "stays pure Python: found no C compiler" in warning


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("sysconfig", lambda _: "/nowhere", "found no /nowhere/Python.h; expected the headers of this Python"),
        ("importlib.util", lambda _: None, "found no mypyc; expected mypy[mypyc]"),
    ],
)
def test_without_what_a_compiler_needs_one_plain_warning_names_it(
    name: str, value: object, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setattr(f"{name}.{'get_path' if name == 'sysconfig' else 'find_spec'}", value)
    data, (warning,) = build("standard")
    assert data == PURE
    assert warning.startswith(f"the tick is not compiled, and stays pure Python: {reason}")


@pytest.mark.parametrize(
    ("environment", "hooks"), [({}, ["custom"]), ({"HATCH_BUILD_NO_HOOKS": "true"}, []), (PURE_WHEEL, [])]
)
def test_every_wheel_has_it_unless_a_variable_turns_it_off(
    environment: dict[str, str], hooks: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HATCH_BUILD_NO_HOOKS", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    config = WheelBuilder(str(ROOT)).config
    assert [*config.hook_config] == hooks
    assert any("mypyc" in needed for needed in config.dependencies) is bool(hooks)


def test_where_the_compiler_fails_the_wheel_is_pure_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HOOK, "_SETUP", "import sys; sys.exit('a thousand lines\\n\\ncannot compile this\\n')")
    monkeypatch.setattr(shutil, "which", lambda name: name)
    data, warnings = build("standard")
    assert data == PURE
    assert warnings == ["the tick is not compiled, and stays pure Python: cannot compile this"]


def test_an_error_counts_in_a_module_that_is_compiled_and_in_no_other(tmp_path: Path) -> None:
    """Newer types of a library may find fault with any module; those that are not compiled lend their types alone."""
    root = tmp_path / "root"
    package = root / "src" / "manyhands"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    for name in ("design", "protocol", "nodes"):
        (root / name).mkdir()
    (root / "design" / "wrong.py").write_text('def number() -> int:\n    return "none"\n')
    (root / "nodes" / "right.py").write_text("from manyhands.design.wrong import number\n\n\nx: int = number()\n")
    (root / "nodes" / "other.py").write_text('x: int = "none"\n')

    def tried(module: str) -> dict[str, str]:
        folder = tmp_path / module.replace("/", "-")
        folder.mkdir()
        found: dict[str, str] = HOOK.compiled(root, folder, [module])
        return found

    if shutil.which((sysconfig.get_config_var("CC") or "cc").split()[0]) is None:
        assert not REQUIRED, "MANYHANDS_REQUIRE_COMPILER is set, and there is no C compiler"
        pytest.skip("no C compiler")
    assert any("right" in file for file in tried("nodes/right").values())
    with pytest.raises(HOOK.NotCompiled, match="Incompatible types in assignment"):
        tried("nodes/other")


def test_an_editable_installation_is_never_compiled() -> None:
    assert build("editable") == (PURE, [])


def test_every_module_of_the_list_exists() -> None:
    assert [module for module in HOOK.MODULES if not (ROOT / f"{module}.py").is_file()] == []


def classes_in(annotation: Any) -> Iterator[type[Any]]:
    """The data classes that an annotation names, and those that their fields name."""
    if is_dataclass(annotation) and isinstance(annotation, type):
        yield annotation
        for hint in get_type_hints(annotation).values():
            yield from classes_in(hint)
    for part in get_args(annotation):
        yield from classes_in(part)


def test_no_class_that_is_written_as_plain_data_is_compiled() -> None:
    """A compiled class keeps no parameters of its annotations: ``tuple[float, ...]`` becomes ``tuple``."""
    written = {one for kind in (*get_args(Bundle), About, RecordingPlan) for one in classes_in(kind)}
    assert {"EnergyBudget", "Inertia", "SiteBounds", "SimulatedHand", "StateSpace"} <= {one.__name__ for one in written}
    homes = {one.__module__.removeprefix("manyhands.").replace(".", "/") for one in written}
    assert homes.isdisjoint(HOOK.MODULES)


def test_a_class_of_the_compiled_tick_is_derived_from_in_it_alone() -> None:
    """An interpreted class that inherits from a compiled one cannot be made: TypeError, in a wheel and nowhere else."""
    compiled = {f"manyhands.{module.replace('/', '.')}" for module in HOOK.MODULES}
    found = [
        f"{module.__name__}: {name} inherits from {base.__name__}"
        for package in (manyhands.protocol, manyhands.nodes, manyhands.launch)
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if info.name not in compiled and not info.name.endswith("__main__")
        for module in [importlib.import_module(info.name)]
        for name, value in vars(module).items()
        if isinstance(value, type) and value.__module__ == module.__name__
        for base in value.__bases__
        if base.__module__ in compiled and not issubclass(base, Enum | BaseException | tuple)
    ]
    assert found == []


@pytest.mark.long
@pytest.mark.alone  # real-time sessions of another worker leave the compiler no processor
def test_a_wheel_has_its_platforms_tag_and_the_numbers_of_pure_python(tmp_path: Path) -> None:
    """The same sessions under the simulated clock, recorded by both, to the last bit."""
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        assert not REQUIRED, "MANYHANDS_REQUIRE_COMPILER is set, and there is no C compiler"
        pytest.skip("no C compiler")
    command = [sys.executable, "-P", "-m", "build", "--no-isolation", "--wheel", "--outdir", tmp_path, ROOT]
    run(*command, cwd=tmp_path, HATCH_BUILD_NO_HOOKS="false")
    (wheel,) = tmp_path.glob("*.whl")
    ((interpreter, abi, platform),) = {(t.interpreter, t.abi, t.platform) for t in parse_wheel_filename(wheel.name)[3]}
    here = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert (interpreter, abi) == (here, here)
    assert platform == sysconfig.get_platform().replace("-", "_").replace(".", "_")
    folder = tmp_path / "compiled"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
        (tags,) = [name for name in archive.namelist() if name.endswith(".dist-info/WHEEL")]
        assert "Root-Is-Purelib: false" in archive.read(tags).decode()
    extensions = [path.relative_to(folder) for path in folder.rglob(f"*{sysconfig.get_config_var('EXT_SUFFIX')}")]
    assert len(extensions) == len(HOOK.MODULES) + 1  # and one that they share
    where = "import manyhands.nodes.device.node as node; print(node.__file__)"
    for session in ("example1.yaml", "example1-operator.yaml", "rub.yaml"):
        runs = []
        for path, ending in ((folder, "so"), (ROOT / "src", "py")):
            environment = {**os.environ, "PYTHONPATH": str(path)}
            found = subprocess.run([sys.executable, "-P", "-c", where], env=environment, capture_output=True, text=True)
            assert found.stdout.strip().endswith(ending), found.stderr
            record = tmp_path / f"{ending}-{session}.npz"
            subprocess.run(
                [sys.executable, "-P", "-m", "manyhands", "launch", session, "--clock", "simulated", "--duration", "1",
                 "--record", str(record)],
                env=environment, cwd=tmp_path, check=True, capture_output=True,
            )  # fmt: skip
            with np.load(record) as arrays:
                runs.append({name: arrays[name].tobytes() for name in arrays.files})
        assert runs[0] == runs[1], session
