"""Every key path that a message names is one that a session file has."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.session.schema import session_schema

ROOT = Path(__file__).parents[3]
FOLDERS = ("launch", "nodes", "devices")
NO_KEYS = ("limits.conf",)  # the system's file of limits
SCHEMA: Mapping[str, Any] = session_schema()
PATH = re.compile(r"(?<![\w./'-])([a-z_]+(?:\.[a-zA-Z_0-9]+)+)(?![\w/(.-])")
ANY = "NAME"
"""What stands for a value in a formatted text: a name, or a position."""


def alternatives(node: Any) -> Iterator[Mapping[str, Any]]:
    """The forms that a value may have."""
    if not isinstance(node, Mapping):
        return
    if "$ref" in node:
        yield from alternatives(SCHEMA["$defs"][node["$ref"].rpartition("/")[2]])
        return
    yield node
    for key in ("anyOf", "oneOf", "allOf"):
        for one in node.get(key, ()):
            yield from alternatives(one)


def below(nodes: list[Any], key: str) -> list[Any]:
    """The forms of what a key leads to, from any of these."""
    out = []
    for form in (form for node in nodes for form in alternatives(node)):
        own = form.get("properties", {})
        out += [own[key]] if key in own else []
        out += [one for name, one in own.items() if key == ANY and isinstance(one, Mapping)]
        out += [form["additionalProperties"]] if isinstance(form.get("additionalProperties"), Mapping) else []
        out += [form["items"]] if "items" in form and (key.isdigit() or key == ANY) else []
    return out


def keys() -> dict[str, list[Any]]:
    """Every key at any depth, with the forms of its values."""
    found: dict[str, list[Any]] = {}
    left, seen = [SCHEMA], set[int]()
    while left:
        for form in alternatives(left.pop()):
            if id(form) in seen:
                continue
            seen.add(id(form))
            for key, one in form.get("properties", {}).items():
                found.setdefault(key, []).append(one)
                left.append(one)
            left += [form[key] for key in ("additionalProperties", "items") if isinstance(form.get(key), Mapping)]
    return found


KEYS = keys()


def wrong_paths(text: str) -> list[str]:
    """The paths in a text that begin with a session's key and lead to nothing."""
    out = []
    for path in PATH.findall(text):
        first, *others = path.split(".")
        if first not in KEYS or path in NO_KEYS:
            continue
        nodes = [SCHEMA["properties"][first]] if first in SCHEMA["properties"] else KEYS[first]
        for key in others:
            nodes = below(nodes, key)
        out += [] if nodes else [path]
    return out


def sentences(source: str) -> Iterator[str]:
    """The texts of several words in a module, without its documentation."""
    tree = ast.parse(source)
    documentation = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(one.value) if isinstance(one, ast.Constant) else ANY for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation:
            yield node.value


@pytest.mark.parametrize("folder", FOLDERS)
def test_key_paths_in_messages_exist(folder: str) -> None:
    modules = [*(ROOT / folder).rglob("*.py")]
    assert modules
    texts = [(module, text) for module in modules for text in sentences(module.read_text()) if " " in text]
    wrong = [(str(module.relative_to(ROOT)), path) for module, text in texts for path in wrong_paths(text)]
    assert wrong == []


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("state design.tau or faults.tank", []),
        ("couplings.NAME.wave_link: found", []),
        ("see couplings.cx.wave_link.tau, devices.dx.limits.force and environment.links.0.stiffness", []),
        ("state design.delay", ["design.delay"]),
        ("a longer wave_link.periods of it", ["wave_link.periods"]),
        ("devices.dx.osp.least is", ["devices.dx.osp.least"]),
        ("see limits.conf and docs/models.md", []),
    ],
)
def test_the_check_sees_a_path_that_leads_nowhere(text: str, wrong: list[str]) -> None:
    assert wrong_paths(text) == wrong
