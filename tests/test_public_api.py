"""`import manyhands as mh`: its names are declared once, load nothing before their use, and each has an example."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import os
import re
import subprocess
import sys
from enum import Enum
from pathlib import Path
from types import ModuleType

import pytest

import manyhands as mh

from .support.rooms import ROOMS
from .support.site import site_module

ROOT = Path(__file__).parents[1]
SITE = site_module("generated")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
LIGHT = ("numpy", "scipy", "cvxpy", "zmq", "pydantic", "matplotlib", "typer", "yaml", "ast")
"""What nobody pays for who only imports the package."""


def modules_with_examples() -> list[str]:
    found = [] if ">>>" not in (ROOT / "src/manyhands/__init__.py").read_text() else ["manyhands"]
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            if ">>> " in path.read_text(encoding="utf-8"):
                parts = path.relative_to(ROOT).with_suffix("").parts
                found.append(".".join(("manyhands", *(parts[:-1] if parts[-1] == "__init__" else parts))))
    return found


def public(package: ModuleType) -> dict[str, object]:
    return {name: getattr(package, name) for name in package.__all__}


def in_fresh_python(code: str) -> str:
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": ""})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", modules_with_examples())
def test_every_example_of_a_docstring_prints_what_it_shows(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    tests = doctest.DocTestFinder(recurse=True).find(importlib.import_module(name))
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    for test in tests:
        runner.run(test, out=report.append)
    assert runner.tries > 0
    assert runner.failures == 0, "".join(report)


@pytest.mark.parametrize("package", [mh, mh.passivity], ids=["manyhands", "passivity"])
def test_every_public_name_has_an_example(package: ModuleType) -> None:
    without = [
        name for name, one in public(package).items() if not isinstance(one, ModuleType) and ">>>" not in own_text(one)
    ]
    assert without == []


def test_every_public_attribute_is_documented() -> None:
    """Of the public classes, of what public functions return, and of what is reached from there by attributes."""
    todo: list[type] = []
    for one in (one for package in (mh, mh.passivity) for one in public(package).values()):
        todo += [one] if inspect.isclass(one) else SITE.returned(one) if inspect.isfunction(one) else []
    without: list[str] = []
    seen: set[type] = set()
    while todo:
        found = todo.pop()
        if found in seen or found.__name__.startswith("_"):
            continue
        seen.add(found)
        told = documented(found)
        for part in (part for part in found.__mro__ if part.__module__.startswith("manyhands.")):
            without += [f"{found.__name__}.{name}" for name in attributes(part) if name not in told]
            todo += [one for annotation in annotations(part) for one in SITE.classes_in(annotation, part.__module__)]
    assert {"BackgroundRun", "RecordedRun", "Proof", "DelayBudget"} <= {one.__name__ for one in seen}
    assert sorted(set(without)) == []


def function_of(value: object) -> object:
    """The function behind a method, a property or a class method; any other value itself."""
    for inner in ("__func__", "fget", "func"):
        value = getattr(value, inner, None) or value
    return value


def attributes(part: type) -> list[str]:
    """The public names that a class declares: fields, properties, methods, and what its ``__init__`` keeps."""
    if issubclass(part, Enum):
        return []  # the docstring of the class and the value of a member say what it is
    kept = re.findall(r"^ +self\.([a-z]\w*)(?:: [^=\n]+)? = ", inspect.getsource(part), re.MULTILINE)
    declared = [name for name in (*vars(part).get("__annotations__", {}), *vars(part)) if not name.startswith("_")]
    return [name for name in dict.fromkeys([*declared, *kept]) if name != "model_config"]


def annotations(part: type) -> list[object]:
    """What the public fields, properties and methods of a class are, or return."""
    functions = [function_of(value) for name, value in vars(part).items() if not name.startswith("_")]
    fields = [one for name, one in vars(part).get("__annotations__", {}).items() if not name.startswith("_")]
    return [*fields, *(one.__annotations__.get("return", "") for one in functions if inspect.isfunction(one))]


def documented(found: type) -> set[str]:
    """The attributes of a class that it documents, or a class that it is made of.

    That is in a list of attributes, in double backticks in the docstring, by a docstring of their own, or in the schema
    of session files.
    """
    told = {*getattr(found, "model_fields", ())}
    for part in (part for part in found.__mro__ if part.__module__.startswith("manyhands.")):
        text = part.__doc__ or ""
        for names in re.findall(r"^ {8}(\w+(?:, \w+)*)(?: \(.*?\))?:", text, re.MULTILINE):
            told |= {*names.split(", ")}
        told |= {*re.findall(r"``(\w+)``", text)}
        functions = {name: function_of(value) for name, value in vars(part).items()}
        told |= {name for name, one in functions.items() if inspect.isfunction(one) and inspect.getdoc(one)}
        told |= {*re.findall(r"^    (\w+)(?:: .*)?(?: = .*)?\n    \"\"\"", inspect.getsource(part), re.MULTILINE)}
    return told


def own_text(one: object) -> str:
    """The docstring of a name, and those of a class's own methods."""
    texts = [inspect.getdoc(one) or ""]
    if inspect.isclass(one):
        texts += [inspect.getdoc(value) or "" for key, value in vars(one).items() if not key.startswith("_")]
    return "\n".join(texts)


def test_importing_the_package_loads_no_library() -> None:
    code = f"import sys, manyhands; print([name for name in {LIGHT} if name in sys.modules])"
    assert in_fresh_python(code) == "[]\n"


def test_a_node_loads_no_solver_by_the_package() -> None:
    code = "import sys, manyhands.nodes.device.node; print([n for n in ('cvxpy', 'pydantic') if n in sys.modules])"
    assert in_fresh_python(code) == "[]\n"


@pytest.mark.parametrize("package", [mh, mh.passivity], ids=["manyhands", "passivity"])
def test_the_stub_declares_what_the_package_gives(package: ModuleType) -> None:
    assert package.__file__ is not None
    stub = ast.parse(Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    declared = [alias.asname for one in stub.body if isinstance(one, ast.ImportFrom) for alias in one.names]
    assert package.__all__ == sorted(declared) == sorted(set(declared))
    assert set(package.__all__) <= set(dir(package))
    for name, one in public(package).items():
        home = getattr(one, "__module__", name)
        assert isinstance(one, ModuleType) or home.startswith("manyhands."), f"{name} of {home}"


def test_a_wrong_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'manyhands' has no attribute 'desing'"):
        mh.desing  # noqa: B018
