"""Properties: a session read back is the same session, and a spoilt file raises nothing except SessionError."""

import json
import string
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.session import Interval, NetworkEnvironment, Session, SessionError, load_session
from manyhands.launch.session.yaml import KeyPath, read_tree

from ...support.cases import cases

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
EXAMPLE = SESSIONS / "example1.yaml"

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


def between(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Intervals as a session writes them, also such without width."""
    return st.tuples(values, values).map(lambda ends: {"between": sorted(ends)})


def maybe_between(values: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    return values | between(values)


def per_axis(draw: st.DrawFn, values: st.SearchStrategy[Any], dof: int) -> Any:
    return draw(st.one_of(values, st.lists(values, min_size=dof, max_size=dof)))


@st.composite
def devices(draw: st.DrawFn) -> dict[str, Any]:
    dof = draw(st.integers(1, 3))
    device: dict[str, Any] = {"dof": dof, "driver": "simulated", "mass": per_axis(draw, positive, dof)}
    device["osp"] = per_axis(draw, positive, dof)
    if draw(st.booleans()):
        device["osp"] = {"between": [device["osp"], per_axis(draw, st.floats(1e4, 1e5), dof)]}
    if draw(st.booleans()):
        device["axes"] = draw(st.lists(axis_names, min_size=dof, max_size=dof, unique=True))
    if draw(st.booleans()):
        device["damping"] = 1e4  # at least every lower end
    if draw(st.booleans()):
        limits = st.sampled_from(["force", "displacement", "speed"])
        device["limits"] = {name: per_axis(draw, positive, dof) for name in sorted(draw(st.sets(limits)))}
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


gains = signed.filter(lambda c: c == 0.0 or abs(c) > 1e-20)  # what a session takes for a coefficient
coefficients = st.lists(gains, min_size=1, max_size=4).filter(any)
stable = st.lists(positive, max_size=4).map(lambda roots: np.atleast_1d(np.poly([-r for r in roots])).tolist())


@st.composite
def weights(draw: st.DrawFn) -> dict[str, Any]:
    if draw(st.booleans()):
        low, width = draw(st.just(0.0) | st.floats(0.01, 2.0)), draw(st.floats(0.1, 2.0))
        return {"emphasise": [low, low + width]}
    den = draw(stable)
    return {"num": draw(st.lists(positive, min_size=1, max_size=len(den))), "den": den}


@st.composite
def designs(draw: st.DrawFn, blocks: list[str], ports: int, period: float) -> dict[str, Any]:
    coupling = draw(st.sampled_from(["spring-damper", "linear", "given", "none"]))
    design: dict[str, Any] = {"coupling": coupling, "tau": draw(st.sampled_from([0.0, period / 3, period]))}
    transparent = ["loop-shaping", "closed-loop"]
    objectives = {"none": ["feasible"], "given": ["feasible", *transparent]}
    design["objective"] = draw(st.sampled_from(objectives.get(coupling, ["feasible", "stiffest", *transparent])))
    if design["objective"] in transparent and draw(st.booleans()):
        design["weights"] = {name: draw(weights()) for name in sorted(draw(st.sets(st.sampled_from(["W1", "W2"]))))}
    match coupling:
        case "given":
            design |= {"stiffness": 700, "damping": [0.5] * ports}
        case "linear" if draw(st.booleans()):
            pairs = draw(st.integers(1, 8))
            design["order"] = 2 * pairs
            pole = st.fixed_dictionaries({"frequency": positive}, optional={"damping": st.floats(0.01, 1.0)})
            design["poles"] = draw(st.lists(pole, min_size=pairs, max_size=pairs))
        case "linear":
            order = st.integers(1, 16)
            design["order"] = draw(order | st.fixed_dictionaries(dict.fromkeys(blocks, order)))
    if coupling in ("linear", "spring-damper") and design["objective"] == "feasible" and "poles" not in design:
        design["algorithm"] = draw(st.sampled_from(["convex", "complementarity"]))
        if design["algorithm"] == "complementarity":
            design["iterations"] = draw(st.integers(1, 500))
    return design


def rows(height: int, width: int) -> st.SearchStrategy[list[list[float]]]:
    row = st.lists(signed, min_size=width, max_size=width)
    return st.lists(row, min_size=height, max_size=height)


@st.composite
def environments(draw: st.DrawFn, ports: list[str]) -> dict[str, Any]:
    m = len(ports)
    environment: dict[str, Any] = {"type": draw(st.sampled_from(["network", "state-space", "transfer-function"]))}
    match environment["type"]:
        case "network":
            values = draw(st.sampled_from([positive, maybe_between(positive)]))
            end = st.sampled_from(["hub", "ground"])
            links = [{"between": [port, draw(end)], "stiffness": draw(values)} for port in ports]
            links.append({"between": ["hub", "ground"], "damping": draw(values)})
            environment |= {"masses": {"hub": draw(values)}, "links": links}
            if values is not positive:
                return environment  # late forces and intervals exclude each other
        case "state-space":
            n = draw(st.integers(0, 3))
            shapes = {"A": (n, n), "B": (n, m), "C": (m, n) if n else (0, 0), "D": (m, m)}
            environment |= {name: draw(rows(*shape)) for name, shape in shapes.items()}
            if draw(st.booleans()):
                environment["method"] = draw(st.sampled_from(["backward-euler", "tustin", "zoh"]))
            else:
                environment["time"] = draw(st.sampled_from(["continuous", "discrete"]))
        case _:
            entry = gains | st.fixed_dictionaries({"num": coefficients, "den": coefficients})
            row = st.lists(entry, min_size=m, max_size=m)
            environment["entries"] = draw(st.lists(row, min_size=m, max_size=m))
    return environment | {"delay": draw(st.integers(0, 16))}


@st.composite
def observers(draw: st.DrawFn, parts: list[str], couplings: list[str]) -> dict[str, Any]:
    channels = ["telemetry", "environment/telemetry"]
    channels += [f"{name}/{channel}" for name in parts for channel in ("sample", "force", "telemetry")]
    channels += [f"{name}/{channel}" for name in couplings for channel in ("tool", "reaction", "telemetry")]
    reads = st.lists(st.sampled_from(channels), min_size=1, max_size=4, unique=True)
    names = letters.map("o_{}".format)
    return draw(st.dictionaries(names, st.fixed_dictionaries({"reads": reads}), max_size=2))


@st.composite
def sessions(draw: st.DrawFn) -> dict[str, Any]:
    parts = {
        f"d_{name}": device
        for name, device in draw(st.dictionaries(letters, devices(), min_size=1, max_size=3)).items()
    }
    ports = [port for name, device in parts.items() for port in ports_of(name, device)]
    cut = draw(st.integers(1, len(ports)))
    couplings = {"c_one": {"ports": ports[:cut]}}
    if cut < len(ports):
        couplings["c_two"] = {"ports": ports[cut:]}
    period = draw(st.floats(1e-5, 0.1))
    return {
        "session": draw(letters),
        "period": period,
        "devices": parts,
        "couplings": couplings,
        "environment": draw(environments(ports)),
        "design": draw(designs(list(couplings), len(ports), period)),
        "observers": draw(observers(list(parts), list(couplings))),
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


@settings(deadline=None, max_examples=50)
@given(plain=sessions())
def test_ends_enclose_the_value_that_a_run_takes(plain: dict[str, Any]) -> None:
    session = Session.model_validate(plain)
    environment = session.environment
    if isinstance(environment, NetworkEnvironment):
        values = [*environment.masses.values()]
        values += [value for link in environment.links for value in (link.stiffness, link.damping)]
        for interval in map(Interval.of, values):
            assert 0.0 <= interval.low <= interval.nominal <= interval.high
        assert environment.uncertain == any(isinstance(value, Interval) for value in values)
        assert not (environment.uncertain and environment.delay)
    for name, device in session.devices.items():
        low, high = np.diag(device.osp_low), np.diag(getattr(device.osp, "high", device.osp))
        assert np.all(low <= high)
        assert np.all(low <= np.array(device.damping) * (1.0 + 1e-12))  # the rounding that the check itself allows
        np.testing.assert_array_equal(session.osp_level(name), device.osp_low)


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
THREE = [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]]
STATES: dict[str, object] = {"type": "state-space", **dict.fromkeys("ABCD", THREE), "method": "zoh", "delay": 1}
ENTRIES: dict[str, object] = {"type": "transfer-function", "entries": [[{"num": [1.0], "den": [2.0, 1.0]}, 0, 0]] * 3}
LINEAR: dict[str, object] = {
    "coupling": "linear",
    "order": {"cx": 2, "cy": 2, "cz": 2},
    "poles": [{"frequency": 52.0, "damping": 0.05}],
    "objective": "closed-loop",
    "weights": {"W1": {"emphasise": [0, 20]}},
    "tau": 0.0005,
}
PLAINS: list[dict[str, Any]] = [
    PLAIN,
    read_tree(SESSIONS / "example1-uncertain.yaml").data,
    read_tree(SESSIONS / "example2.yaml").data,
    {**PLAIN, "environment": STATES},
    {**PLAIN, "environment": {**ENTRIES, "method": "tustin"}},
    {**PLAIN, "design": LINEAR},
    {**PLAIN, "observers": {"watch": {"reads": ["telemetry"]}, "scope": {"reads": ["dx/force", "cx/tool"]}}},
]
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


@settings(deadline=None, max_examples=cases(50, 150))
@given(
    place=st.sampled_from([(plain, path) for plain in PLAINS for path in paths(plain)]),
    action=st.sampled_from(["replace", "remove", "add"]),
    value=junk,
)
def test_a_spoilt_key_raises_nothing_else(place: tuple[Any, KeyPath], action: str, value: object) -> None:
    text = yaml.safe_dump(spoil(*place, action, value), allow_unicode=True)
    error = refused(lambda: reread(text))
    assert error is None or (str(error).isprintable() and error.line is not None)


@settings(deadline=None, max_examples=cases(50, 100))
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


@settings(deadline=None, max_examples=cases(50, 100))
@given(path=st.sampled_from(PATHS), value=st.text(max_size=20) | junk.map(json.dumps))
def test_overrides_raise_nothing_else(path: KeyPath, value: str) -> None:
    error = refused(lambda: load_session(EXAMPLE, [f"{'.'.join(map(str, path))}={value}"]))
    assert error is None or str(error).isprintable()


def test_the_examples_themselves_are_not_spoilt() -> None:
    assert reread(json.dumps(PLAIN)) == load_session(EXAMPLE)
    for plain in PLAINS:
        assert reread(json.dumps(plain)) == Session.model_validate(plain)
    with pytest.raises(SessionError):
        reread(json.dumps(spoil(PLAIN, ("period",), "remove", None)))
