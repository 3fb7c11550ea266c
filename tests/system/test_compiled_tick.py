"""The build hook: a compiled tick has the numbers of pure Python; where it cannot be compiled, pure Python is left."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

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


def test_where_the_compiler_fails_the_wheel_is_pure_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HOOK, "_SETUP", "raise SystemExit('cannot compile this')")
    monkeypatch.setattr(shutil, "which", lambda name: name)
    data, warnings = build("standard")
    assert data == PURE
    assert warnings == ["the tick is not compiled, and stays pure Python: cannot compile this"]


def test_an_editable_installation_is_never_compiled() -> None:
    assert build("editable") == (PURE, [])


def test_every_module_of_the_list_exists() -> None:
    assert [module for module in HOOK.MODULES if not (ROOT / f"{module}.py").is_file()] == []


@pytest.mark.long
@pytest.mark.alone  # real-time sessions of another worker leave the compiler no processor
def test_a_compiled_run_has_the_numbers_of_pure_python(tmp_path: Path) -> None:
    """The same sessions under the simulated clock, recorded by both, to the last bit."""
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        assert not REQUIRED, "MANYHANDS_REQUIRE_COMPILER is set, and there is no C compiler"
        pytest.skip("no C compiler")
    folder = tmp_path / "compiled"
    folder.mkdir()
    extensions = HOOK.compiled(ROOT, folder)
    assert len(extensions) == len(HOOK.MODULES) + 1  # and one that they share
    shutil.copytree(ROOT / "launch", folder / "manyhands" / "launch", ignore=shutil.ignore_patterns("__pycache__"))
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
