"""The certificate file: exact, tamper-evident; a file that is not a certificate is refused by name."""

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.certificate import MAX_FILE_BYTES, Certificate, content, identity, load, save, seal, to_json
from manyhands.design.errors import CertificateError, OldCertificate
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import SpringDamperGiven
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.synthesis import design

from ..support.cases import cases


def aim(objective: str = "loop-shaping") -> Transparency:
    return Transparency(objective, Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), 1e-3), Filter.one())


@pytest.fixture(scope="module")
def certificate(problems) -> Certificate:
    """With a claim on transparency, so that every section of the file is there."""
    return design(problems.example_1(problems.centralised), SpringDamperGiven(problems.C27, aim())).certificate


def all_hold(data: Any) -> bool:
    return all(finding.holds for finding in prove(data))


@pytest.fixture(scope="module")
def data(certificate) -> dict[str, Any]:
    return json.loads(to_json(certificate))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "broken.json"


def leaves(value: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths to everything in the file that is not an object or a list."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*at, key))
    else:
        yield at


def put(data: Any, at: tuple[str | int, ...], value: Any) -> Any:
    """A copy of ``data`` with one thing replaced."""
    out = copy.deepcopy(data)
    inner = out
    for key in at[:-1]:
        inner = inner[key]
    inner[at[-1]] = value
    return out


def get(data: Any, at: tuple[str | int, ...]) -> Any:
    for key in at:
        data = data[key]
    return data


def test_the_file_round_trips_bit_for_bit(certificate, path: Path) -> None:
    save(certificate, path)
    read, data = load(path)
    assert to_json(read) == to_json(certificate) == path.read_text()
    assert content(read) == content(certificate)
    np.testing.assert_array_equal(read.levels.P_E, certificate.levels.P_E)
    assert read.id == certificate.id == identity(data)
    assert list(path.parent.iterdir()) == [path]  # nothing half-written stays


def test_the_id_is_the_same_for_the_same_content(certificate, data: dict[str, Any]) -> None:
    assert identity(copy.deepcopy(data)) == certificate.id == seal(certificate).id
    assert len(certificate.id) == 64


def test_the_order_of_every_key_is_in_the_id(certificate, data: dict[str, Any], path: Path) -> None:
    """A file re-ordered by hand no longer has its id, by the writer's rule and by the proof's own."""
    objects = [at for at in ((), *sections(data)) if isinstance(get(data, at), dict) and len(get(data, at)) > 1]
    assert {(), ("devices",), ("environment",), ("asked",), ("levels",)} <= {*objects}
    for at in objects:
        turned = dict(reversed(get(data, at).items()))
        other = put(data, at, turned) if at else turned
        assert other == data  # as objects they are equal
        assert identity(other) != certificate.id, at
        path.write_text(json.dumps(other))
        found = [finding.condition for finding in prove(load(path)[1]) if not finding.holds]
        assert found == ["the id is the SHA-256 of the content"], at


@pytest.mark.parametrize(("version", "release"), [(1, "0.1.0"), (2, "0.6.0")])
def test_a_version_that_is_read_no_more_names_its_last_reader(path: Path, version: int, release: str) -> None:
    path.write_text(json.dumps({"format": "manyhands-certificate", "version": version}))
    with pytest.raises(OldCertificate) as error:
        load(path)
    assert str(error.value) == (
        f"{path}: found a certificate of format version {version}, which manyhands {release} is the last to read; "
        "design the session anew"
    )
    assert (error.value.version, error.value.reader) == (version, release)


def test_what_was_asked_is_recorded_and_no_claim(certificate, data: dict[str, Any], path: Path) -> None:
    """A change of it is found by the id; with a new id everything holds, because the proof does not cover it."""
    aimed = aim()
    weights = {name: {"num": list(W.num), "den": list(W.den)} for name, W in (("W1", aimed.W1), ("W2", aimed.W2))}
    assert data["asked"] == {"coupling": "given", "objective": "loop-shaping", "weights": weights}
    forged = put(data, ("asked", "objective"), "stiffest")
    assert [finding.condition for finding in prove(forged) if not finding.holds] == [
        "the id is the SHA-256 of the content"
    ]
    forged["id"] = identity(forged)
    assert forged["id"] != certificate.id
    path.write_text(json.dumps(forged))
    read, read_data = load(path)
    assert all_hold(read_data)
    assert read.asked == forged["asked"]
    assert json.loads(to_json(read)) == forged


@given(st.data())
@settings(max_examples=cases(50, 200))
def test_any_changed_leaf_changes_the_id(certificate, data: dict[str, Any], draw: st.DataObject) -> None:
    at = draw.draw(st.sampled_from([leaf for leaf in leaves(data) if leaf != ("id",)]))
    old = get(data, at)
    if isinstance(old, str):
        new: Any = old + "x"
    elif isinstance(old, int):
        new = old + 1
    else:
        new = math.nextafter(old, draw.draw(st.sampled_from([-math.inf, math.inf])))
    changed = put(data, at, new)
    assert identity(changed) != certificate.id


def test_a_changed_file_is_found_by_its_id(data: dict[str, Any], path: Path) -> None:
    at = ("transparency", "gamma")
    path.write_text(json.dumps(put(data, at, math.nextafter(get(data, at), math.inf))))
    failing = [finding.condition for finding in prove(load(path)[1]) if not finding.holds]
    assert failing == ["the id is the SHA-256 of the content"]


BROKEN_TEXTS = {
    "": ":1: not JSON",
    "{": ":1: not JSON",
    "[1, 2]": "not a certificate",
    "null": "not a certificate",
    "17": "not a certificate",
    '"certificate"': "not a certificate",
    "{}": "key 'format' is missing",
    '{"format": "manyhands-certificate", "version": 0}': "0; expected manyhands-certificate version 3 to 6",
    '{"format": "other", "version": 3}': "found 'other' 3",
    '{"format": "manyhands-certificate", "version": 2.0}': "found 'manyhands-certificate' 2.0",
    '{"a": 1, "a": 2}': "every key once",
    '{"a": NaN}': "found NaN; expected finite numbers",
    '{"a": -Infinity}': "found -Infinity; expected finite numbers",
    '{"a": 1e999}': "found 1e999; expected finite numbers",
    '{"a": ' + "9" * 5000 + "}": "cannot be read",
    "[" * 200_000: "cannot be read",
}


@pytest.mark.parametrize("text", BROKEN_TEXTS, ids=lambda text: text[:24] or "empty")
def test_what_is_no_certificate_is_refused(path: Path, text: str) -> None:
    path.write_text(text)
    with pytest.raises(CertificateError) as error:
        load(path)
    assert str(error.value).startswith(str(path))
    assert BROKEN_TEXTS[text] in str(error.value)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path, path: Path) -> None:
    path.write_bytes(b'{"a": "\xff"}')
    for bad in (path, tmp_path, tmp_path / "absent.json"):
        with pytest.raises(CertificateError, match="cannot be read") as error:
            load(bad)
        assert str(bad) in str(error.value)


def test_a_file_too_large_is_refused(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)  # a sparse file: nothing is written
    with pytest.raises(CertificateError, match="Is longer than 268435456 bytes"):
        load(path)


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (("version",), 7, "found 'manyhands-certificate' 7; expected manyhands-certificate version 3 to 6"),
        (("asked",), None, "expected asked to be an object"),
        (("asked",), ["stiffest"], "expected asked to be an object"),
        (("asked", "colour"), "red", "asked: found the keys ['colour']; expected some of"),
        (("session",), 3, "session to be a text"),
        (("environment", "type"), "engine", "environment.type: found 'engine'"),
        (("environment", "delay"), -1, "environment.delay: found -1"),
        (("environment", "delay"), 65, "environment.delay: found 65; expected a whole number from 0 to 64"),
        (("environment", "delay"), 0.5, "environment.delay: found 0.5"),
        (("environment", "links", 0, "stiffness"), -1.0, "found stiffness -1.0"),
        (("environment", "links", 0, "stiffness"), [1.0, 2.0, 3.0], "expected an interval [low, high]"),
        (("environment", "links", 0, "damping"), [0.2, 0.1], "at or below its upper end"),
        (("environment", "links", 0, "between"), ["dx", "nowhere"], "nowhere"),
        (("environment", "masses", "hub"), 0.0, "mass hub"),
        (("coupling", "class"), "magic", "coupling.class: found 'magic'"),
        (("coupling", "blocks", "c", "stiffness"), [[1.0]], "found 1 x 1; expected a 3 x 3 matrix"),
        (("coupling", "blocks", "c", "damping"), np.triu(np.ones((3, 3))).tolist(), "symmetric stiffness and damping"),
        (("coupling", "blocks"), {}, "coupling.blocks: found []"),
        (("storage", "E_hat"), [[1.0, 2.0]], "found 1 x 2; expected a 1 x 1 matrix"),
        (("storage", "E_hat"), "trust me", "storage.E_hat: found 'trust me'; expected 'energy' or a matrix"),
        (("levels", "Delta_D"), [[1.0]], ""),
        (("levels", "Delta_V", "c"), [[1.0]], "expected a 3 x 3 matrix"),
        (("levels", "Phi_E"), {"c": "no matrix"}, ""),
        (("structure", "c"), ["dx", "dx", "dz"], "expected every port in exactly one"),
        (("devices", "d0", "osp"), [[-1.0]], "d0: expected a symmetric positive definite OSP level"),
        (("period",), 10**400, "too large"),
        (("period",), 0, "positive period"),
        (("tau",), 2e-3, "expected 0 to the period"),
        (("period_tolerance",), 0.1, "found the keys ['period_tolerance']"),
        (("version",), 4, "period_tolerance"),
        (("transparency", "objective"), "beauty", "transparency.objective: found 'beauty'"),
        (("transparency", "W1", "den"), [1.0, -1.5], "pole of modulus 1.5"),
        (("transparency", "P"), [[1.0, 2.0]], "expected a 1 x 1 matrix"),
        (("method", "algorithm"), [], "method"),
        (("more",), 1, "found the keys ['more']"),
    ],
)
def test_a_certificate_with_a_wrong_part_is_refused(data, path: Path, at, value: Any, words: str) -> None:
    path.write_text(json.dumps(put(data, at, value)))
    with pytest.raises(CertificateError) as error:
        load(path)
    assert str(error.value).startswith(f"{path}: not a certificate of a known version: ")
    assert words in str(error.value)


SYSTEM = {"type": "state-space", "A": [[0.5]], "B": [[1.0]], "C": [[1.0]], "D": [[1.0]], "time": "discrete", "delay": 0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "found 1 inputs and 1 outputs; expected 3 of each"),
        ({"time": "eternal"}, "environment.time: found 'eternal'"),
        ({"time": "continuous", "method": "guess"}, "environment.method: found 'guess'"),
        ({"A": []}, "expected B and C without entries where A has none"),
        ({"static": [[1.0]]}, "found both D and static; expected one of them"),
        ({"type": "transfer-function", "entries": [], "method": "zoh"}, "environment.method: found 'zoh'"),
        ({"type": "transfer-function", "entries": [], "method": "tustin"}, "expected 3 rows of 3 entries"),
    ],
)
def test_an_environment_of_matrices_that_is_none_is_refused(data, path: Path, change, words: str) -> None:
    path.write_text(json.dumps(put(data, ("environment",), SYSTEM | change)))
    with pytest.raises(CertificateError, match="not a certificate of a known version") as error:
        load(path)
    assert words in str(error.value)


def sections(value: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths to every key of every object."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*at, key)
            yield from sections(item, (*at, key))


def test_no_key_can_be_missing(data: dict[str, Any], path: Path) -> None:
    """Refused when read, or found when verified; never an exception of another kind."""
    for at in sections(data):
        less = copy.deepcopy(data)
        del get(less, at[:-1])[at[-1]]
        path.write_text(json.dumps(less))
        assert not accepted(path), at


def accepted(path: Path) -> bool:
    """Read and proved; refusals are the two errors of their own, and nothing else leaves this."""
    try:
        _, data = load(path)
    except CertificateError as error:
        assert str(path) in str(error)  # noqa: PT017  either way of refusing is right
        return False
    try:
        return all_hold(data)
    except ProofInputError:
        return False


SPOILT = [None, True, "x", "0.5", -1, 0, 1e300, -1e308, 5e-324, 1e17, 10**400, [], {}, [[]], [[1.0]], [["x"]]]


@given(st.data())
@settings(max_examples=cases(50, 250))
def test_nothing_but_a_certificate_error_leaves_a_spoilt_file(data, path: Path, draw: st.DataObject) -> None:
    """Also with the right id, as a forger would compute it."""
    at = draw.draw(st.sampled_from([*leaves(data), *sections(data)]))
    spoilt = put(data, at, draw.draw(st.sampled_from(SPOILT)))
    if draw.draw(st.booleans()):
        spoilt["id"] = identity(spoilt)
    path.write_text(json.dumps(spoilt))
    accepted(path)
