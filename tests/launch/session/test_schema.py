"""The schema of session files accepts what the reader accepts, and refuses what is wrong in form."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft7Validator

from manyhands.launch.session import (
    Device,
    Faults,
    Hand,
    Pole,
    PortLimits,
    Session,
    SessionError,
    SessionLink,
    load_session,
)
from manyhands.launch.session.fields import Quantity
from manyhands.launch.session.schema import session_schema
from manyhands.launch.session.yaml import KeyPath, parse_tree, read_tree

from ...support.broken_sessions import BROKEN
from ...support.cases import cases
from ...support.commands import manyhands_command
from .test_properties import PLAINS, junk, paths, sessions, spoil
from .test_reference import EXAMPLES, OVERRIDES, base

ROOT = Path(__file__).parents[3]
SCHEMA = session_schema()
VALID = Draft7Validator(SCHEMA)

FILES = [path for folder in ("launch/sessions", "tests", "examples") for path in (ROOT / folder).rglob("*.yaml")]
BLOCKS = {
    f"{path.relative_to(ROOT)}:{number}": block
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))
    for number, block in enumerate(re.findall(r"^```yaml\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL))
}

NO_DATA = {
    "alias-bomb", "alias-of-itself", "binary", "control-character", "duplicate-key", "empty", "list-at-top", "not-yaml",
    "numeric-key", "only-comments", "tab-indentation", "tag", "text-at-top", "too-deep", "two-documents", "unclosed",
    "unknown-alias",
}  # fmt: skip
"""Broken files whose text is no session's: there is nothing that a schema could look at."""

FOR_THE_READER = {
    # a name that leads nowhere, or that two parts have
    "coupling-named-as-device", "dangling-device", "dangling-port", "mass-named-as-port", "mass-without-link",
    "matrices-missing-block",
    "matrices-unknown-block", "observer-named-as-coupling", "observer-named-as-device", "observer-reads-control",
    "observer-reads-environment", "observer-reads-everything", "observer-reads-force", "observer-reads-tool",
    "observer-reads-twice", "observer-reserved-name", "observer-unknown-channel", "observer-unknown-node",
    "order-missing-block", "order-unknown-block", "port-in-no-block", "port-in-two-blocks", "reserved-name",
    "unattached-port", "unknown-device", "unknown-port", "axis-twice", "link-to-itself",
    # sizes that do not fit each other
    "axes-count", "given-wrong-size", "limits-per-axis", "mass-per-axis", "matrices-shape", "order-of-large-block",
    "osp-interval-axes", "poles-count", "state-space-not-square", "state-space-order", "state-space-ports",
    "state-space-ragged", "transfer-function-ports", "transfer-function-rows", "wave-link-b-count",
    "wave-link-harvest-count", "wave-link-mass-matrix",
    # numbers against each other
    "given-outside-block", "given-unsymmetric", "interval-and-delay", "interval-reversed", "osp-above-damping",
    "osp-interval-above-damping", "osp-interval-reversed", "osp-unsymmetric", "tau-above-period",
    "wave-link-b-unsymmetric", "wave-link-ladder", "wave-link-part-of-device", "wave-link-tau",
    "wave-link-tau-of-design", "wave-link-transparency", "wave-link-uncoupled", "weight-band-beyond-ticks",
    "weight-band-reversed",
    # mathematics, formulas and other files
    "formula-attribute", "formula-division-by-zero", "formula-syntax", "formula-unknown-name", "given-not-positive",
    "hand-improper", "hand-not-passive", "hand-unstable", "hand-zero-denominator", "interval-of-nothing",
    "osp-indefinite", "trace-backwards", "trace-missing", "trace-not-numbers", "transfer-function-tustin-improper",
    "transfer-function-zero-denominator", "wave-link-b-indefinite", "weight-improper", "weight-integrator",
    "weight-unstable", "weight-zero", "weight-zero-denominator",
    # JSON has no NaN, so no bound of a schema excludes it
    "not-a-number",
}  # fmt: skip
"""Broken files that only the reader can judge."""


def problem(data: object) -> str | None:
    """The first thing that the schema finds wrong with a session's data."""
    found = next(iter(VALID.iter_errors(data)), None)
    return None if found is None else f"{list(found.absolute_path)}: {found.message[:200]}"


def forms(schema: object) -> Iterator[dict[str, Any]]:
    """Every mapping in the schema."""
    if isinstance(schema, dict):
        yield schema
    for child in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        yield from forms(child)


def test_it_is_a_schema_of_its_draft() -> None:
    Draft7Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == Draft7Validator.META_SCHEMA["$schema"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_accepts_every_session_of_the_repository(path: Path) -> None:
    session = load_session(path)
    assert problem(read_tree(path).data) is None
    assert problem(session.to_dict()) is None
    assert problem(session.as_plain()) is None


@pytest.mark.parametrize("place", BLOCKS)
def test_it_accepts_every_session_of_the_documents(place: str) -> None:
    """Blocks are sessions, some keys of a session, or some of its ``design`` or of a device."""
    data = parse_tree(BLOCKS[place], place).data
    if data.keys() <= SCHEMA["$defs"]["Device"]["properties"].keys():
        data = {"devices": {"d": {"dof": 2, "osp": 1, "driver": "simulated", "mass": 1, **data}}}
    if data.keys() <= SCHEMA["$defs"]["Design"]["properties"].keys():
        data = {"design": {"coupling": "spring-damper", **data}}
    assert problem(data if "session" in data else {**PLAINS[0], **data}) is None


@pytest.mark.parametrize(("section", "text"), EXAMPLES)
def test_it_accepts_every_example_of_the_reference(section: str, text: str, tmp_path: Path) -> None:
    key, _, value = text.removeprefix("{").partition(": ")
    value = value.removesuffix("}") if text.startswith("{") else value
    session = load_session(base(tmp_path), OVERRIDES[section].format(key=key, value=value).split("\n"))
    assert problem(session.to_dict()) is None
    assert problem(session.as_plain()) is None


@settings(max_examples=cases(30, 200))
@given(plain=sessions())
def test_it_accepts_what_the_reader_accepts(plain: dict[str, Any]) -> None:
    assert problem(plain) is None
    session = Session.model_validate(plain)
    assert problem(session.to_dict()) is None
    assert problem(session.as_plain()) is None


@settings(max_examples=cases(50, 400))
@given(
    place=st.sampled_from([(plain, path) for plain in PLAINS for path in paths(plain)]),
    action=st.sampled_from(["replace", "remove", "add"]),
    value=junk
    | st.sampled_from([0, 1, 2.5, "auto", "d.0", [1.0], [[1.0]], {"between": [1, 2]}, {"num": [1], "den": [1]}]),
)
def test_it_accepts_a_changed_session_that_the_reader_accepts(
    place: tuple[Any, KeyPath], action: str, value: object
) -> None:
    changed = json.dumps(spoil(*place, action, value))
    try:
        Session.from_dict(json.loads(changed))
        data = parse_tree(changed, "changed").data
    except SessionError:
        return
    assert problem(data) is None


WRITTEN = [
    "devices.dx.osp={between: [1, 1.37]}",
    "devices.dx.osp=[[1.37]]",
    "devices.dx.mass=[0.2]",
    "devices.dx.hand={operator: [[{num: [1], den: [1, 1]}]], motion: {times: [0, 1], values: [0, 0]}}",
    "devices.dx.hand={force: ['sin(t)'], damping: [1]}",
    "devices.dx={dof: 1, osp: 1, driver: trace, trace: {times: [0, 1], values: [[0, 0]]}}",
    "devices.dx={dof: 1, osp: 1, driver: 'a.b:c', axis_map: [-x], parameters: {a: [1, {b: c}], d: true}, scale: 2}",
    "devices.dx={dof: 1, osp: 1, driver: browser, mass: 1, limits: {}, hand: {stiffness: 300}}",
    "couplings.cx={ports: [dx.0]}",
    "couplings.cx.wave_link={b: [[2]], depth: 0}",
    "environment.masses.hub={between: [1, 2]}",
    "environment={type: python, model: 'a:b', level: [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]}",
    "environment={type: python, model: 'a:b', level: [0.1, 0.1, 0.1], enforce: false, parameters: {}}",
    "design.tau=auto",
    "design.ladder=[]",
    "design={coupling: given, stiffness: [700, 700, 700], damping: 0}",
    "design={coupling: given, stiffness: [[700, 0, 0], [0, 700, 0], [0, 0, 700]]}",
    "design={coupling: given, matrices: {cx: &v {A: [], B: [], C: [], static: [[1]]}, cy: *v, cz: *v}}",
    "design={coupling: linear, order: {cx: 2, cy: 2, cz: 2}}",
    "faults={tank: 0, restarts: 0}",
    "colocate=true",
]


@pytest.mark.parametrize("override", WRITTEN)
def test_it_accepts_every_way_to_write_a_value(override: str) -> None:
    """The short forms: one value for all axes, an interval, rows, a formula, the port of a device's only axis."""
    key, _, value = override.partition("=")
    load_session(ROOT / "launch/sessions/example1.yaml", [override])
    data = json.loads(json.dumps(read_tree(ROOT / "launch/sessions/example1.yaml").data))
    *parents, last = key.split(".")
    part = data
    for step in parents:
        part = part[step]
    part[last] = parse_tree(f"value: {value}", "value").data["value"]
    assert problem(data) is None


@pytest.mark.parametrize("name", BROKEN)
def test_it_refuses_what_is_wrong_in_form(name: str, tmp_path: Path) -> None:
    path = BROKEN[name].write(name, tmp_path)
    if name in NO_DATA:
        with pytest.raises(SessionError):
            read_tree(path)
    else:
        assert (problem(read_tree(path).data) is None) == (name in FOR_THE_READER)


def test_it_knows_the_names_that_are_published_here(monkeypatch: pytest.MonkeyPatch) -> None:
    data = {**PLAINS[0], "environment": {"type": "python", "model": "wall", "level": 0.1}}
    assert problem(data) is not None
    monkeypatch.setattr("manyhands.launch.session.foreign.published", lambda group: {"wall": "walls:make"})
    assert Draft7Validator(session_schema()).is_valid(data)


def test_it_refuses_a_key_without_a_value() -> None:
    assert not [form for form in forms(SCHEMA) if form.get("type") == "null"]
    for path in paths(PLAINS[0]):
        assert problem(spoil(PLAINS[0], path, "replace", None)) is not None, path


def test_every_key_has_its_description_and_every_default_is_accepted() -> None:
    parts = [form for form in forms(SCHEMA) if form.get("additionalProperties") is False and "description" in form]
    assert len(parts) == 32
    for part in parts:
        for key, form in part["properties"].items():
            assert form.get("description"), f"{part['description']}: {key}"
            if "default" in form:
                whole = {**form, "$defs": SCHEMA["$defs"]}
                assert Draft7Validator(whole).is_valid(form["default"]), f"{part['description']}: {key}"


def test_no_field_is_described_without_its_unit() -> None:
    """The description of a quantity, also of one by axis or of an interval, names its unit."""
    found = 0
    for model in (Device, Hand, PortLimits, SessionLink, Pole, Faults, Session):
        for name, field in model.model_fields.items():
            for check in field.metadata:
                quantity = getattr(check, "check", getattr(check, "quantity", check))
                if isinstance(quantity, Quantity) and quantity.unit:
                    found += 1
                    assert quantity.unit in (field.description or ""), f"{model.__name__}.{name}"
    assert found >= 12


@pytest.mark.usefixtures("own_interrupt")
def test_a_command_prints_it() -> None:
    done = manyhands_command("sessions", "--schema")
    assert (done.exit_code, json.loads(done.stdout)) == (0, SCHEMA)
    both = manyhands_command("sessions", "ball", "--schema")
    assert both.exit_code == 2
    assert both.stderr == "error: give either NAME or --schema\n"


@pytest.mark.usefixtures("own_interrupt")
def test_the_first_line_for_editors_leads_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's commands and its line: the schema is where the line of a session file beside it points."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "session-file" / "text.md").read_text()
    section = page.partition("## In an editor")[2].partition("\n## ")[0]
    (line,) = re.findall(r"^    (# yaml-language-server: \$schema=(\S+))$", section, re.MULTILINE)
    (target,) = re.findall(r"^manyhands sessions --schema > (\S+)$", section, re.MULTILINE)
    (new,) = re.findall(r"^manyhands (new .*)$", section, re.MULTILINE)
    Path(target).write_text(manyhands_command("sessions", "--schema").stdout)
    assert manyhands_command(*new.split()).exit_code == 0
    (file,) = tmp_path.glob("*.yaml")
    file.write_text(f"{line[0]}\n{file.read_text()}")
    load_session(file)
    assert Draft7Validator(json.loads((file.parent / line[1]).read_text())).is_valid(read_tree(file).data)


def test_the_schema_is_the_same_text_in_every_process() -> None:
    """No part of it stands in the order of a set, which differs from process to process."""
    command = (
        "import json; from manyhands.launch.session.schema import session_schema; print(json.dumps(session_schema()))"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", command], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in "12"
    }
    assert len(texts) == 1


@pytest.mark.parametrize(
    ("device", "accepted"),
    [
        ({"from": "omega.3", "osp": 0.5}, True),
        ({"from": "./my-stick.yaml"}, True),
        ({"from": "omega.33", "osp": 0.5}, False),
        ({"from": 3, "osp": 0.5}, False),
        ({"from": "omega.3", "ops": 0.5}, False),
        ({"osp": 0.5}, False),
    ],
)
def test_a_device_may_have_its_keys_from_a_file(device: dict[str, object], accepted: bool) -> None:
    """An editor does not read the file: what may be missing in the session is left to the reader."""
    data = {**read_tree(ROOT / "launch/sessions/example1.yaml").data, "devices": {"dx": device, "dy": device}}
    assert (problem(data) is None) == accepted
