"""For any valid JSON a proof ends with findings or with one error that names the key."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.proof import Finding, ProofInputError, prove

from ...support.cases import cases

Data = dict[str, Any]

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 5),
    st.sampled_from([2**2000, -(2**1023), 10**400, 5e-324, -1e308, 1e308, 1e-300, 0.0, -0.0, 0.5]),
    st.floats(allow_nan=True, allow_infinity=True),  # json.load reads NaN and Infinity
    st.text(max_size=5),
    st.sampled_from(["\ud800", "ground", "hub", "p0", "energy", "zoh"]),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=4), inner, max_size=4)),
    max_leaves=12,
)


def bases(certificates) -> list[Data]:
    hub = certificates.hub()
    S = certificates.physical_level(hub, ["p0", "p1", "p2"])
    plain = certificates.certificate(hub, (certificates.K27, certificates.B27), -S * (1.0 - 1e-9))
    transfer = {"type": "transfer-function", "method": "tustin", "delay": 1}
    transfer["entries"] = [[{"num": [1.0, 300.0], "den": [0.5, 1.0]}]]
    one = (np.array([[300.0]]), np.array([[5.0]]))
    second = certificates.certificate(transfer, one, np.array([[1.0]]), np.eye(2).tolist(), osp=20.0, tau=1e-4)
    weight = {"num": [1.0], "den": [1.0]}
    second["transparency"] = {"objective": "closed-loop", "W1": weight, "W2": weight, "gamma": 2.0, "P": [[1.0]]}
    third = certificates.as_linear(plain)
    system = {"type": "state-space", "time": "continuous", "method": "zoh", "delay": 0}
    third["environment"] = system | {"A": [[-1.0]], "B": [[1.0, 1.0, 1.0]], "C": [[1.0]] * 3, "D": np.eye(3).tolist()}
    return [plain, second, third]


def paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    out = [path] if path else []
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            out += paths(item, (*path, key))
    return out


def outcome(data: Any) -> tuple[Finding, ...] | ProofInputError:
    try:
        return prove(data)
    except ProofInputError as error:
        return error


@given(data=st.data())
@settings(max_examples=cases(50, 250))
def test_one_value_is_anything(certificates, data: st.DataObject) -> None:
    base = data.draw(st.sampled_from(bases(certificates)))
    path = data.draw(st.sampled_from(paths(base)))
    value = data.draw(VALUES)
    hostile = copy.deepcopy(base)
    at = hostile
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    hostile = json.loads(json.dumps(hostile))
    found = outcome(hostile)
    if isinstance(found, ProofInputError):
        assert len(str(found)) < 3000
    else:
        assert all(isinstance(finding, Finding) for finding in found)


@given(value=VALUES)
def test_anything_at_all(value: Any) -> None:
    assert isinstance(outcome(json.loads(json.dumps(value))), ProofInputError)


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (("period",), "fast", "period"),
        (("period",), float("nan"), "period"),
        (("version",), 1, "version"),
        (("ports",), ["p0", "p0", "p2"], "ports"),
        (("structure", "c0"), ["p0", "p1", "elsewhere"], "structure.c0[2]"),
        (("environment", "links", 0, "between"), ["p0", "p0"], "environment.links[0].between"),
        (("environment", "links", 1, "stiffness"), [2.0, 1.0], "environment.links[1].stiffness"),
        (("environment", "links", 1, "stiffness"), True, "environment.links[1].stiffness"),
        (("environment", "masses"), {"p0": 1.0}, "environment.masses"),
        (("environment", "delay"), 10**9, "environment.delay"),
        (("coupling", "blocks", "c0", "stiffness", 0, 1), 5.0, "coupling.blocks.c0.stiffness"),
        (("levels", "Phi_E"), [[0.0]], "levels.Phi_E"),
        (("levels", "extra"), 1.0, "levels"),
        (("levels", "kappa"), 2**1024, "levels.kappa"),
        (("storage", "E_hat"), "trust me", "storage.E_hat"),
        (("devices", "d0", "osp"), [[]], "devices.d0.osp[0]"),
        (("method",), {"a": 1.5}, "method.a"),
        (("version",), 2, "version"),
        (("version",), 4, "period_tolerance"),
        (("version",), 6, "version"),
        (("period_tolerance",), 0.1, "period_tolerance"),
        (("asked",), None, "asked"),
        (("asked",), "stiffest", "asked"),
        (("asked", "objective"), "x" * 1001, "asked"),
        (("asked", "order"), {"x" * 1001: 1}, "asked"),
        (("asked", "order"), float("inf"), "asked"),
        (("asked", "order"), 2**1024, "asked"),
        (("asked", "order"), [[0] * 1000] * 60, "asked"),
        (("asked", "order"), [[[[[[[[0]]]]]]]], "asked"),
    ],
)
def test_the_key_is_named(certificates, path: tuple[Any, ...], value: Any, named: str) -> None:
    data = bases(certificates)[0]
    at = data
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(ProofInputError) as raised:
        prove(data)
    assert str(raised.value).startswith(f"{named}:")


def test_a_missing_key(certificates) -> None:
    data = bases(certificates)[0]
    del data["levels"]["share"]
    with pytest.raises(ProofInputError, match=r"levels: missing keys \['share'\]"):
        prove(data)


def test_what_was_asked_is_any_plain_data_of_bounded_size(certificates) -> None:
    """It is no claim: the rest is proved as it would be without it, whatever its content."""
    data = bases(certificates)[0]
    for asked in (
        {},
        {"objective": "the moon"},
        {"order": [None, True, -1, 0.5, {"a": [[]]}]},
        {"poles": [0] * 49_000},
    ):
        assert all(finding.holds for finding in prove(certificates.seal(data | {"asked": asked})))
    missing = {key: value for key, value in data.items() if key != "asked"}
    with pytest.raises(ProofInputError, match=r"certificate: missing keys \['asked'\]"):
        prove(missing)


def test_sizes_are_bounded_before_anything_is_built(certificates) -> None:
    """What a few bytes could make large: a delay's chain, a list of rows, an exponential."""
    data = bases(certificates)[0]
    data["environment"]["delay"] = 1000
    data["storage"]["E_hat"] = [[1.0]]
    assert any("too many" in finding.argument for finding in prove(data))
    data["storage"]["E_hat"] = [0] * 5000
    with pytest.raises(ProofInputError, match=r"storage\.E_hat: found 5000 rows"):
        prove(data)
    third = bases(certificates)[2]
    third["environment"]["A"] = [[1e300]]
    third["storage"]["E_hat"] = [[1.0]]
    assert any("too large" in finding.argument for finding in prove(third))
    deep: Any = 1.0
    for _ in range(500):
        deep = [deep]
    data["margins"] = {"(10)": deep}
    data["storage"]["E_hat"] = "energy"
    with pytest.raises(ProofInputError, match="margins"):
        prove(data)


@pytest.mark.parametrize("port", ["device", "block"])
def test_every_port_has_one_party(certificates, port: str) -> None:
    data = bases(certificates)[0]
    if port == "device":
        data["devices"]["d2"]["ports"] = ["p1"]
    else:
        data["structure"] = {"c0": ["p0", "p1", "p1"]}
    found = outcome(data)
    assert isinstance(found, ProofInputError) or any("is in" in f.argument for f in found if not f.holds)
