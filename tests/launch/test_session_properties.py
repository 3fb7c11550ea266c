"""Properties: a session read back is the same session, and nothing but SessionError leaves a spoilt file."""

import json
import string
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.session import Session, SessionError, load_session
from manyhands.launch.session.source import KeyPath, read_tree

EXAMPLE = Path(__file__).parents[2] / "launch" / "sessions" / "example1.yaml"

positive = st.floats(1e-3, 1e4)
signed = st.floats(-1e4, 1e4)
letters = st.text(string.ascii_lowercase, min_size=1, max_size=6)
# also names that look like numbers or truth values to some YAML reader
axis_names = st.sampled_from(["x", "y", "z", "no", "on", "1e3", "0x1", "012", "null"])
intents = st.one_of(
    signed,
    st.sampled_from(["2*pulse(t, 0.1, 0.2)", "sin(2*pi*t)", "-1 if t > 1 else 0"]),
    st.lists(signed, min_size=1, max_size=4).map(lambda v: {"times": [float(i) for i in range(len(v))], "values": v}),
)


def per_axis(draw: st.DrawFn, values: st.SearchStrategy[Any], dof: int) -> Any:
    return draw(st.one_of(values, st.lists(values, min_size=dof, max_size=dof)))


@st.composite
def devices(draw: st.DrawFn) -> dict[str, Any]:
    dof = draw(st.integers(1, 3))
    device: dict[str, Any] = {"dof": dof, "driver": "simulated", "mass": per_axis(draw, positive, dof)}
    device["osp"] = per_axis(draw, positive, dof)
    if draw(st.booleans()):
        device["axes"] = draw(st.lists(axis_names, min_size=dof, max_size=dof, unique=True))
    if draw(st.booleans()):
        device["damping"] = 1e4
    if draw(st.booleans()):
        device["hand"] = {
            "operator": draw(st.sampled_from([0.5, {"num": [1.0, 2.0], "den": [1.0, 1.0]}])),
            **{key: per_axis(draw, positive, dof) for key in ("mass", "damping", "stiffness")},
            "force": per_axis(draw, intents, dof),
            "motion": per_axis(draw, intents, dof),
        }
    return device


def ports_of(name: str, device: dict[str, Any]) -> list[str]:
    if "axes" not in device and device["dof"] == 1:
        return [name]
    return [f"{name}.{axis}" for axis in device.get("axes", range(device["dof"]))]


@st.composite
def sessions(draw: st.DrawFn) -> dict[str, Any]:
    parts = {
        f"d_{name}": device
        for name, device in draw(st.dictionaries(letters, devices(), min_size=1, max_size=3)).items()
    }
    ports = [port for name, device in parts.items() for port in ports_of(name, device)]
    ends = st.sampled_from(["hub", "ground"])
    links = [{"between": [port, draw(ends)], "stiffness": draw(positive)} for port in ports]
    links.append({"between": ["hub", "ground"], "damping": draw(positive)})
    cut = draw(st.integers(1, len(ports)))
    couplings = {"c_one": {"ports": ports[:cut]}}
    if cut < len(ports):
        couplings["c_two"] = {"ports": ports[cut:]}
    design = st.sampled_from(
        [
            {"coupling": "spring-damper"},
            {"coupling": "none", "objective": "feasible"},
            {"coupling": "given", "stiffness": 700, "damping": [0.5] * len(ports)},
        ]
    )
    return {
        "session": draw(letters),
        "period": draw(st.floats(1e-5, 0.1)),
        "devices": parts,
        "couplings": couplings,
        "environment": {"type": "network", "masses": {"hub": draw(positive)}, "links": links},
        "design": draw(design),
    }


def reread(text: str) -> Session:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.yaml"
        path.write_text(text, encoding="utf-8")
        return load_session(path)


@settings(deadline=None, max_examples=50)
@given(plain=sessions())
def test_a_session_survives_being_written_and_read(plain: dict[str, Any]) -> None:
    session = Session.model_validate(plain)
    # JSON is YAML 1.2; PyYAML writes for readers of 1.1 and leaves 1e3 unquoted, so it is asked to quote
    assert reread(json.dumps(plain)) == session
    assert reread(json.dumps(session.as_plain())) == session
    assert reread(yaml.safe_dump(json.loads(json.dumps(plain)), sort_keys=False).replace("- 1e3", "- '1e3'")) == session
    assert sorted(port for block in session.blocks for port in block) == sorted(session.ports)


def refused(read: Callable[[], Session]) -> SessionError | None:
    """The SessionError of a reading; any other exception fails the test."""
    try:
        read()
    except SessionError as error:
        return error
    return None


def paths(value: object, path: KeyPath = ()) -> Iterator[KeyPath]:
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield (*path, key)
        yield from paths(child, (*path, key))


PLAIN = read_tree(EXAMPLE).data
PATHS = list(paths(PLAIN))
junk = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=12)
    | st.sampled_from(["dx", "hub", "1e3", "0.2 kg"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=8,
)


def spoil(plain: Any, path: KeyPath, action: str, value: object) -> Any:
    spoilt = json.loads(json.dumps(plain))
    parent = spoilt
    for step in path[:-1]:
        parent = parent[step]
    match action:
        case "replace":
            parent[path[-1]] = value
        case "remove":
            del parent[path[-1]]
        case "add" if isinstance(parent, dict):
            parent[str(value)] = value
        case _:
            parent.append(value)
    return spoilt


@settings(deadline=None, max_examples=100)
@given(path=st.sampled_from(PATHS), action=st.sampled_from(["replace", "remove", "add"]), value=junk)
def test_a_spoilt_key_raises_nothing_else(path: KeyPath, action: str, value: object) -> None:
    text = yaml.safe_dump(spoil(PLAIN, path, action, value), allow_unicode=True)
    error = refused(lambda: reread(text))
    assert error is None or (str(error).isprintable() and error.line is not None)


@settings(deadline=None, max_examples=100)
@given(
    start=st.integers(0, EXAMPLE.stat().st_size),
    length=st.integers(0, 30),
    inserted=st.text(max_size=4) | st.text("[]{}:,&*!|>'\"#%@`-? \n\t", max_size=6),
)
def test_spoilt_text_raises_nothing_else(start: int, length: int, inserted: str) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    spoilt = text[:start] + inserted + text[start + length :]
    error = refused(lambda: reread(spoilt.encode("utf-8", "surrogatepass").decode("utf-8", "replace")))
    assert error is None or str(error).isprintable()  # printable, and so one line


@settings(deadline=None, max_examples=100)
@given(path=st.sampled_from(PATHS), value=st.text(max_size=20) | junk.map(json.dumps))
def test_overrides_raise_nothing_else(path: KeyPath, value: str) -> None:
    error = refused(lambda: load_session(EXAMPLE, [f"{'.'.join(map(str, path))}={value}"]))
    assert error is None or str(error).isprintable()


def test_the_example_itself_is_not_spoilt() -> None:
    assert reread(json.dumps(PLAIN)) == load_session(EXAMPLE)
    with pytest.raises(SessionError):
        reread(json.dumps(spoil(PLAIN, ("period",), "remove", None)))
