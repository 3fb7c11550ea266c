"""Forged claims, improved and given the id and margins of their own content, are found and named."""

import copy
import dataclasses
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import Certificate, content, identity
from manyhands.design.levels.contract import margin_of
from manyhands.design.models.environment import DelayedNetwork
from manyhands.design.models.statespace import Matrix, block_diagonal
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import LinearGiven, SpringDamperGiven
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.synthesis import design

Data = dict[str, Any]


def plain(certificate: Certificate) -> Data:
    return content(certificate) | {"id": certificate.id}


@pytest.fixture(scope="module")
def proved(problems) -> Data:
    aim = Transparency("loop-shaping", Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), problems.T), Filter.one())
    return plain(design(problems.example_1(), SpringDamperGiven(problems.C26, aim)).certificate)


@pytest.fixture(scope="module")
def linear(problems) -> Data:
    loop = problems.example_1()
    return plain(design(loop, LinearGiven(problems.blocks(loop, problems.C26))).certificate)


@pytest.fixture(scope="module")
def late(problems) -> Data:
    """A tick late, and late inside the tick: levels, storage and share all have something to prove."""
    loop = dataclasses.replace(problems.example_1(osp=5.0), environment=DelayedNetwork(problems.network, 1), tau=1e-4)
    return plain(design(loop, SpringDamperGiven(problems.uniform(5000.0, 0.5))).certificate)


@pytest.fixture(scope="module")
def unsteady(problems) -> Data:
    """Late inside the tick, and with periods up to 1.1 T."""
    loop = dataclasses.replace(problems.example_1(), tau=1e-4, period_tolerance=0.1)
    return plain(design(loop, SpringDamperGiven(problems.uniform(800.0, 0.3))).certificate)


def resealed(data: Data) -> Data:
    """With the id and the margins of its own content, as a careful forger would have them."""
    levels = data["levels"]
    D, V, E = (block_diagonal([np.array(M) for M in levels[name].values()]) for name in ("Delta_D", "Delta_V", "Phi_E"))
    margin = margin_of(levels["share"] * D, V, E)
    data["margins"] = {"(10)": margin} if np.isfinite(margin) else {}
    data["id"] = identity(data)
    return data


def failing(data: Data) -> list[str]:
    try:
        return [f"{finding.condition} ({finding.argument})" for finding in prove(data) if not finding.holds]
    except ProofInputError as error:
        return [str(error)]


def test_what_design_returns_is_proved(proved: Data, linear: Data, late: Data, unsteady: Data) -> None:
    for data in (proved, linear, late, unsteady):
        assert failing(data) == []
        assert failing(resealed(copy.deepcopy(data))) == []  # and what a forger does on top spoils nothing
    assert proved["margins"]["(10)"] == pytest.approx(0.7979, abs=1e-3)


def change(*path: Any, by: Callable[[Matrix], Any]) -> Callable[[Data], None]:
    def apply(data: Data) -> None:
        inner: Any = data
        for key in path[:-1]:
            inner = inner[key]
        new = by(np.array(inner[path[-1]], dtype=float))
        inner[path[-1]] = new.tolist() if isinstance(new, np.ndarray | np.float64) else new

    return apply


def every(*changes: Callable[[Data], None]) -> Callable[[Data], None]:
    def apply(data: Data) -> None:
        for one in changes:
            one(data)

    return apply


def level(name: str, by: Callable[[Matrix], Matrix], *blocks: str) -> Callable[[Data], None]:
    return every(*(change("levels", name, block, by=by) for block in blocks or ("cx", "cy", "cz")))


def springs(stiffness: float, damping: float) -> Callable[[Data], None]:
    """Another coupling under the same levels."""
    return every(
        *(change("coupling", "blocks", block, "stiffness", by=lambda M: [[stiffness]]) for block in ("cx", "cy", "cz")),
        *(change("coupling", "blocks", block, "damping", by=lambda M: [[damping]]) for block in ("cx", "cy", "cz")),
    )


def tolerance(rho: float, *others: Callable[[Data], None]) -> Callable[[Data], None]:
    """Periods up to (1 + rho) T are claimed, in the version that has the key."""
    return every(lambda data: data.update(version=4, period_tolerance=rho), *others)


def links(by: float) -> Callable[[Data], None]:
    return every(*(change("environment", "links", i, "stiffness", by=lambda k: by * k) for i in range(4)))


def devices(osp: float) -> Callable[[Data], None]:
    """Less is promised, and the levels are stated accordingly."""
    return every(
        *(change("devices", f"d{i}", "osp", by=lambda M: [[osp]]) for i in range(3)),
        level("Delta_D", lambda D: osp * np.eye(1)),
    )


V_HAT, E_HAT = "V_hat of cx is Delta_V-OSP", "E_hat is (-Phi_E)-ISP"
FORGERIES = {
    "a greater Delta_V": ("proved", level("Delta_V", lambda D: 1.2 * D), V_HAT),
    "a hardly greater Delta_V": ("proved", level("Delta_V", lambda D: (1.0 + 1e-8) * D, "cx"), V_HAT),
    "a negative Delta_V": ("proved", level("Delta_V", lambda D: -D, "cx"), "Delta_V > 0"),
    "a Delta_V across blocks": ("proved", level("Delta_V", lambda D: np.full((2, 2), 0.1), "cx"), "levels.Delta_V.cx"),
    "a greater Delta_D": ("proved", level("Delta_D", lambda D: 1.01 * D), "Delta_D <= the devices' levels"),
    "a lower Phi_E": ("proved", level("Phi_E", lambda Phi: Phi - 0.5), E_HAT),
    "a hardly lower Phi_E": ("proved", level("Phi_E", lambda Phi: Phi - 1e-5), E_HAT),
    "a greater Phi_E": ("proved", level("Phi_E", lambda Phi: Phi + 2.0), "condition (10)"),
    "a scaled P_E": ("proved", change("storage", "E_hat", by=lambda P: 1.5 * P), E_HAT),
    "a shifted P_E": ("proved", change("storage", "E_hat", by=lambda P: P + 0.1 * P.max()), E_HAT),
    "a negative P_E": ("proved", change("storage", "E_hat", by=lambda P: -P), "E_hat's storage matrix is positive"),
    "a P_E of another size": ("proved", change("storage", "E_hat", by=lambda P: P[:1, :1]), "has 1 rows, Rest has 2"),
    "an energy that is too little": (
        "proved",
        every(change("storage", "E_hat", by=lambda P: "energy"), level("Phi_E", lambda Phi: Phi - 0.4)),
        E_HAT,
    ),
    "an energy where there is a delay": (
        "late",
        change("storage", "E_hat", by=lambda P: "energy"),
        "only a network without delay",
    ),
    "a stiffness beyond the limit": ("proved", springs(3000.0, 0.0), "J = Delta_D/(2 kappa) - (T/2) K > 0"),
    "another stiffness": ("proved", springs(650.0, 0.0372), V_HAT),
    "a damping beyond the limit": ("proved", springs(705.0, 1.1), "J - B >= 0"),
    "a damper alone": ("proved", springs(0.0, 0.5), "K > 0"),
    "other masses": ("proved", change("environment", "masses", "hub", by=lambda M: 300.0), E_HAT),
    "a mass of less than nothing": ("proved", change("environment", "masses", "hub", by=lambda M: -3.0), "masses are"),
    "other springs": ("proved", links(0.01), E_HAT),
    "intervals": (
        "proved",
        change("environment", "masses", "hub", by=lambda M: [2.0, 4.0]),
        "intervals need",
    ),
    "another tick of delay": ("late", change("environment", "delay", by=lambda d: 2), "the storage matrix has 5 rows"),
    "devices with less damping": ("proved", devices(0.3), "V_hat of cx"),
    "levels for devices with more damping": ("proved", devices(1.5), V_HAT),
    "a longer period": ("proved", change("period", by=lambda T: 4.1e-3), "V_hat of cx"),
    "a somewhat longer period": ("proved", change("period", by=lambda T: 1.1e-3), E_HAT),
    "a period beyond floating point": ("proved", change("period", by=lambda T: 5e-324), ""),
    "other blocks": (
        "proved",
        lambda data: data["structure"].update(cx=["dy"], cy=["dx"]),
        E_HAT,
    ),
    "a port in two blocks": ("proved", lambda data: data["structure"].update(cx=["dy"]), "every port has one"),
    "a delay": ("proved", change("tau", by=lambda _: 1e-4), "F_t >= 0"),
    "a longer delay": ("late", change("tau", by=lambda tau: 1.02 * float(tau)), "F_t >= 0"),
    "longer periods": ("proved", tolerance(0.1), "F_t >= 0"),
    "hardly longer periods": ("proved", tolerance(1e-12), "F_t >= 0"),
    "longer periods behind a delay": ("late", tolerance(0.02), "F_t >= 0"),
    "longer periods than were designed for": ("unsteady", tolerance(0.11), "F_t >= 0"),
    "longer periods with their gain, and the old share": (
        "proved",
        tolerance(0.1, change("levels", "kappa", by=lambda _: 0.56)),
        "F_t >= 0",
    ),
    "longer periods with their share, and the old gain": (
        "proved",
        tolerance(0.1, change("levels", "share", by=lambda _: 0.9)),
        "F_t >= 0",
    ),
    "no longer periods, in the version of longer ones": ("unsteady", tolerance(0.0), "0 < rho <= 1"),
    "periods of less than T": ("unsteady", tolerance(-0.1), "0 < rho <= 1"),
    "periods of more than 2 T": ("unsteady", tolerance(1.5), "0 < rho <= 1"),
    "a tolerance that is no number": ("unsteady", tolerance("0.1"), "period_tolerance"),  # type: ignore[arg-type]
    "a tolerance that an older version would ignore": (
        "unsteady",
        lambda data: data.update(version=3),
        "period_tolerance: expected it in version 4, and in no other",
    ),
    "a version of longer periods without them": (
        "unsteady",
        lambda data: data.pop("period_tolerance"),
        "period_tolerance: expected it in version 4, and in no other",
    ),
    "a greater share": ("late", change("levels", "share", by=lambda s: 1.001 * float(s)), "F_t >= 0"),
    "a smaller gain": ("late", change("levels", "kappa", by=lambda k: 0.999 * float(k)), V_HAT),
    "a gain for a stiffer coupling": ("late", change("levels", "kappa", by=lambda _: 0.5), "F_t >= 0"),
    "a greater loop gain without delay": ("proved", change("levels", "kappa", by=lambda _: 0.6), "F_t >= 0"),
    "numbers near the end of floating point": (
        "proved",
        every(change("storage", "E_hat", by=lambda P: 1e300 * P), level("Phi_E", lambda Phi: 1e300 * Phi)),
        "",
    ),
    "a lower gamma": ("proved", change("transparency", "gamma", by=lambda g: 0.99999 * float(g)), "transparency"),
    "another weight": ("proved", change("transparency", "W1", "num", 0, by=lambda b: 1.001 * float(b)), "transparency"),
    "another P of transparency": ("proved", change("transparency", "P", by=lambda P: 1.1 * P), "transparency"),
    "another objective": ("proved", lambda data: data["transparency"].update(objective="closed-loop"), "transparency"),
    "a softer linear block": (
        "linear",
        every(*(change("coupling", "blocks", "cx", key, by=lambda M: 1.02 * M) for key in "CD")),
        V_HAT,
    ),
    "an unstable linear block": ("linear", change("coupling", "blocks", "cx", "A", by=lambda A: A + 1.0), V_HAT),
    "a scaled P_V": ("linear", change("storage", "V_hat", "cx", by=lambda P: 2.0 * P), V_HAT),
    "a P_V of another size": ("linear", change("storage", "V_hat", "cx", by=lambda P: []), "storage.V_hat.cx"),
    "a block of another order": (
        "linear",
        change("coupling", "blocks", "cx", "A", by=lambda A: []),
        "coupling.blocks.cx",
    ),
    "a P_V for springs": ("proved", lambda data: data["storage"]["V_hat"].update(cx=[[1.0]]), "storage.V_hat"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_false_claim_is_found(proved: Data, linear: Data, late: Data, unsteady: Data, name: str) -> None:
    which, forge, words = FORGERIES[name]
    forged = copy.deepcopy({"proved": proved, "linear": linear, "late": late, "unsteady": unsteady}[which])
    forge(forged)
    try:
        forged = resealed(forged)
    except (ValueError, np.linalg.LinAlgError):  # levels that have no margin
        forged["id"] = identity(forged)
    found = failing(forged)
    assert found
    assert any(words in condition for condition in found), found


def test_fewer_periods_than_are_proved_are_a_true_claim(unsteady: Data) -> None:
    """A lower tolerance, or none in the version without the key, claims less of the same numbers."""
    for forge in (tolerance(0.05), lambda data: (data.pop("period_tolerance"), data.update(version=3))):
        less = copy.deepcopy(unsteady)
        forge(less)
        assert failing(resealed(less)) == []


def test_without_a_new_id_anything_is_found_at_once(proved: Data) -> None:
    changed = copy.deepcopy(proved)
    changed["method"]["algorithm"] = "by another way"
    assert failing(changed) == ["the id is the SHA-256 of the content (computed again)"]


def test_stated_margins_are_checked(proved: Data) -> None:
    better = copy.deepcopy(proved)
    better["margins"]["(10)"] *= 2.0
    better["id"] = identity(better)
    (found,) = failing(better)
    assert "the margin (10) is not overstated" in found


def test_no_solver_is_needed() -> None:
    """A certificate can be read and proved where neither solver nor scipy is installed."""
    code = (
        "import sys, manyhands.design.proof, manyhands.design.certificate, manyhands.design.certificate\n"
        "print(sorted({name.split('.')[0] for name in sys.modules} & "
        "{'cvxpy', 'clarabel', 'zmq', 'yaml', 'pydantic', 'control'}))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[]"


def test_the_proof_shares_nothing_with_the_design() -> None:
    code = (
        "import sys, manyhands.design.proof\n"
        "print(sorted(name for name in sys.modules if name.startswith('manyhands.design.')"
        " and not name.startswith('manyhands.design.proof')), 'scipy' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[] False"
