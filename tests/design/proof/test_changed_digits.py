"""A certificate that has been made false is not proved, and one changed digit is found."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from manyhands.design.proof import ProofInputError, prove

Data = dict[str, Any]
T = 1e-3
APART = [[0], [1], [2]]
PORTS = ["p0", "p1", "p2"]
NUMBERS = ("period", "tau", "devices", "environment", "coupling", "levels", "margins", "transparency")


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the numbers stand."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(item, (*path, key))
    elif isinstance(value, int | float):
        yield path


def changed(data: Data, path: tuple[Any, ...], change: Any) -> Data:
    """A deep copy with one number changed."""
    out = copy.deepcopy(data)
    at = out
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = change(at[path[-1]])
    return out


def proved(data: Data) -> bool:
    try:
        return all(finding.holds for finding in prove(data))
    except ProofInputError:
        return False


def example(certificates, which: str, blocks: list[list[int]] | None) -> Data:
    hub = certificates.hub()
    S = certificates.physical_level(hub, PORTS)
    coupling = getattr(certificates, f"K{which}"), getattr(certificates, f"B{which}")
    return certificates.certificate(hub, coupling, -S * (1.0 - 1e-9), blocks=blocks)


def late(certificates) -> Data:
    """A delay inside the tick, and an environment by a storage matrix."""
    environment = {"type": "state-space", "time": "continuous", "method": "zoh", "delay": 0}
    environment |= {"A": [[0.0, 1.0], [-1500.0, -2.0]], "B": [[0.0], [500.0]], "C": [[-200.0, 0.0]], "D": [[200.0]]}
    E1, rest = certificates.rest(certificates.system(environment, ["p0"]))
    z = np.exp(1j * np.linspace(1e-4, np.pi, 4000))
    E_hat = certificates.response(environment, ["p0"], z)[:, 0, 0] * (T * z / (z - 1.0))
    Phi = np.array([[-E_hat.real.min() + 0.01]])
    P = certificates.storage(E1, rest, Phi).tolist()
    gains = (1.25, 0.34, 0.0707)
    coupling = (np.array([[300.0]]), np.array([[1.0]]))
    return certificates.certificate(environment, coupling, Phi, P, gains=gains, tau=2e-4, osp=4.0)


def cases(certificates) -> dict[str, Data]:
    return {
        "26": example(certificates, "26", APART),
        "27": example(certificates, "27", None),
        "28": example(certificates, "28", APART),
        "linear": certificates.as_linear(example(certificates, "26", APART)),
        "late": late(certificates),
    }


CHANGES = (
    lambda x: -x,
    lambda x: 10.0 * x,
    lambda x: 0.1 * x,
    lambda x: 1.01 * x,
    lambda x: 0.99 * x,
    lambda x: 1.0001 * x,
    lambda x: x + 1.0,
    lambda x: 0.0,
)


@pytest.mark.parametrize("name", ["26", "27", "28", "linear", "late"])
def test_what_is_made_false_is_not_proved(certificates, name: str) -> None:
    """100 perturbations of one entry, each of them false by an independent frequency-domain opinion."""
    data = cases(certificates)[name]
    assert proved(data)
    assert certificates.refuted(data) == []
    choose = random.Random(name)
    spots = list(places({key: data[key] for key in NUMBERS if data[key] is not None}))
    false = 0
    for _ in range(2000):
        path, change = choose.choice(spots), choose.choice(CHANGES)
        mutant = certificates.seal(changed(data, path, change))
        try:
            reasons = certificates.refuted(mutant)
        except np.linalg.LinAlgError:
            continue  # a singular matrix: no opinion
        if not reasons:
            continue
        false += 1
        assert not proved(mutant), (path, reasons)
        if false == 100:
            return
    pytest.fail(f"only {false} perturbations made it false")


@pytest.mark.parametrize("name", ["27", "linear", "late"])
def test_one_digit_is_found_by_the_id(certificates, name: str) -> None:
    data = cases(certificates)[name]
    for path in places(data):
        number = data
        for key in path:
            number = number[key]
        if path == ("version",):
            continue
        mutant = changed(data, path, lambda x: x + 1 if isinstance(x, int) else float(np.nextafter(x, np.inf)))
        try:
            findings = prove(mutant)
        except ProofInputError:
            continue  # an entry that has lost its equal on the other side of the diagonal
        assert not findings[0].holds, path


def test_the_order_of_blocks_and_devices_is_found_by_the_id(certificates) -> None:
    data = example(certificates, "26", APART)
    for key in ("devices", "structure"):
        mutant = data | {key: dict(reversed(data[key].items()))}
        assert mutant == data
        assert not prove(mutant)[0].holds
        assert proved(certificates.seal(mutant))


def test_a_storage_matrix_that_proves_nothing(certificates) -> None:
    """The claim stays true; what is offered as its proof is not one."""
    data = late(certificates)
    for change in (lambda x: -x, lambda x: 100.0 * x, lambda x: 0.0):
        mutant = certificates.seal(changed(data, ("storage", "E_hat", 0, 0), change))
        assert certificates.refuted(mutant) == []
        assert not proved(mutant)


def test_the_static_stiffness_must_be_symmetric(certificates) -> None:
    """A static force without energy is passive at no level, however small it is."""
    for skew, holds in ((0.0, True), (1e-11, False), (1e-6, False)):
        environment = {"type": "state-space", "time": "discrete", "delay": 0, "A": [], "B": [], "C": []}
        environment["D"] = [[300.0, 50.0 + skew], [50.0, 200.0]]
        coupling = (300.0 * np.eye(2), 8.0 * np.eye(2))
        data = certificates.certificate(environment, coupling, 0.01 * np.eye(2), [], osp=20.0)
        assert proved(data) is holds, skew
        assert holds or any("50.0 and 50.0000" in finding.argument for finding in prove(data)), skew


def test_a_static_gain_that_a_pole_removes_cannot_be_stated(certificates) -> None:
    for A, time in (([[1.0]], {"time": "discrete"}), ([[0.0]], {"time": "continuous", "method": "zoh"})):
        environment = {
            "type": "state-space",
            "delay": 0,
            "A": A,
            "B": [[1.0]],
            "C": [[1.0]],
            "static": [[100.0]],
            **time,
        }
        coupling = (np.array([[300.0]]), np.array([[8.0]]))
        data = certificates.certificate(environment, coupling, np.array([[0.01]]), [[1.0]], osp=20.0)
        assert any("no static gain" in finding.argument for finding in prove(data) if not finding.holds), time


def test_the_static_stiffness_must_not_be_negative(certificates) -> None:
    """C (I - A)^-1 B and D cancel in E1, exactly: nothing is left for rounding."""
    coupling = (np.array([[300.0]]), np.array([[8.0]]))
    for less, holds in ((0.0, True), (1e-13, False), (1e-6, False)):
        environment = {"type": "state-space", "time": "discrete", "delay": 0}
        environment |= {"A": [[0.5]], "B": [[1.0]], "C": [[-100.0]], "D": [[200.0 * (1.0 - less)]]}
        E1, rest = certificates.rest(certificates.system(environment, ["p0"]))
        P = certificates.storage(E1, rest, np.array([[0.01]]))
        data = certificates.certificate(environment, coupling, np.array([[0.01]]), P.tolist(), osp=20.0)
        assert proved(data) is holds, less


def test_the_static_compliance_must_be_symmetric(certificates) -> None:
    data = certificates.as_linear(example(certificates, "27", None))
    for skew, holds in ((0.0, True), (1e-18, False), (1e-9, False)):  # of 1e-6 m/N, the least of them 1e-12 of it
        mutant = certificates.seal(
            changed(data, ("coupling", "blocks", "c0", "static", 0, 1), lambda x, skew=skew: x + skew)
        )
        assert proved(mutant) is holds, skew


def test_margins(certificates) -> None:
    data = example(certificates, "26", APART)
    for name, holds in (("(10)", True), ("something", False)):
        mutant = copy.deepcopy(data)
        mutant["margins"] = {name: data["margins"]["(10)"] * 0.5}
        assert proved(certificates.seal(mutant)) is holds
    over = changed(data, ("margins", "(10)"), lambda x: x * (1.0 + 2e-6))
    assert not proved(certificates.seal(over))
    over["margins"] = {"J": 1.02}
    assert not proved(certificates.seal(over))  # 1.37 - 704.9336 T/2 = 1.01753
    over["margins"] = {"J": 1.0175}
    assert proved(certificates.seal(over))


def test_a_delay_may_not_join_devices(certificates) -> None:
    """Devices are late each by itself: a Delta_D that joins them means nothing then."""
    hub = certificates.hub()
    S = certificates.physical_level(hub, PORTS)
    coupling = (200.0 * np.eye(3), 0.05 * np.eye(3))
    data = certificates.certificate(hub, coupling, -S * (1.0 - 1e-9), gains=(1.25, 0.3, 0.12), tau=2e-4)
    assert proved(data)
    data["levels"]["Delta_D"]["c0"] = [[1.36, 0.005, 0.0], [0.005, 1.36, 0.0], [0.0, 0.0, 1.36]]
    findings = prove(certificates.seal(data))
    assert any("join devices" in finding.argument for finding in findings if not finding.holds)
