"""Environments known only by a declared level: what can be certified with them, and what the proof concludes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.budget import environment_share
from manyhands.design.certificate import content, differences, from_content, identity, load, save
from manyhands.design.errors import Infeasible
from manyhands.design.levels.contract import ENFORCED
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearWanted,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.synthesis import design

PORTS = ("dx", "dy", "dz")
APART = Partition(("cx", "cy", "cz"), ((0,), (1,), (2,)))
PAIR = Partition(("cxy", "cz"), ((0, 1), (2,)))
OSP = 1.37
SPRINGS = SpringDamper(900.0 * np.eye(3), 0.1 * np.eye(3))


def loop(level: Any, partition: Partition = APART, tau: float = 0.0, enforced: bool = True) -> HapticLoop:
    Phi = level * np.eye(3) if np.ndim(level) == 0 else np.diag(level) if np.ndim(level) == 1 else np.array(level)
    devices = tuple(DeviceLevel(name, (i,), np.array([[OSP]])) for i, name in enumerate(PORTS))
    return HapticLoop("declared", 1e-3, PORTS, devices, partition, DeclaredEnvironment(PORTS, Phi, enforced), tau)


def plain(level: Any, wanted: CouplingRequest | None = None, **options: Any) -> dict[str, Any]:
    certificate = design(loop(level, **options), wanted or SpringDamperWanted()).certificate
    return content(certificate) | {"id": certificate.id}


WISHES = {
    "springs, feasible": SpringDamperWanted(),
    "springs, stiffest": SpringDamperWanted(Wish("stiffest")),
    "springs, complementarity": SpringDamperWanted(Wish(algorithm="complementarity")),
    "linear, feasible": LinearWanted((2, 2)),
    "linear, stiffest": LinearWanted((2, 2), Wish("stiffest")),
    "given": SpringDamperGiven(SPRINGS),
}


@pytest.mark.parametrize("wish", WISHES)
@pytest.mark.parametrize("level", [-0.2, 0.0, 0.2])
def test_every_class_is_certified_with_the_declared_level(wish: str, level: float) -> None:
    certificate = design(loop(level, PAIR), WISHES[wish]).certificate
    np.testing.assert_array_equal(certificate.levels.Phi_E, level * np.eye(3))
    assert certificate.levels.P_E == ENFORCED
    assert certificate.loop.enforced == ("environment",)
    assert certificate.margins["(10)"] > 0.0


def test_a_delay_inside_the_tick_is_covered_too() -> None:
    assert design(loop(0.1, tau=2e-4), SpringDamperWanted()).certificate.tau == 2e-4


def test_levels_by_port_and_across_blocks() -> None:
    """Condition (10) is asked with the whole matrix, blocks of V or not."""
    joined = np.array([[0.3, 0.2, 0.0], [0.2, 0.3, -0.1], [0.0, -0.1, 0.0]])
    for level in ((0.9, 0.0, -0.1), joined):
        certificate = design(loop(level), SpringDamperWanted()).certificate
        m = certificate.levels
        left = np.block([[m.device.share * OSP * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), np.zeros((3, 3))]])
        left[3:, 3:] = certificate.loop.partition.embed(m.Delta_V)
        left -= np.kron(np.ones((2, 2)), loop(level).environment.level)  # type: ignore[attr-defined]
        assert np.linalg.eigvalsh(left)[0] == pytest.approx(certificate.margins["(10)"], rel=1e-9)


@pytest.mark.parametrize("wish", [name for name in WISHES if name != "given"])
def test_nothing_is_certified_beyond_what_the_devices_dissipate(wish: str) -> None:
    with pytest.raises(Infeasible):
        design(loop(1.01 * OSP, PAIR), WISHES[wish])


def test_a_given_coupling_without_room_is_refused_with_the_figure() -> None:
    with pytest.raises(Infeasible, match=r"\(10\) fails with the environment's declared level: .* is -1\.491 N·s/m"):
        design(loop(1.3), SpringDamperGiven(SPRINGS))


@pytest.mark.parametrize("wish", WISHES)
def test_what_nobody_enforces_certifies_nothing(wish: str) -> None:
    with pytest.raises(Infeasible, match="its level is not enforced"):
        design(loop(0.1, PAIR, enforced=False), WISHES[wish])


def test_objectives_that_need_dynamics_are_refused() -> None:
    one = Filter((1.0,), (1.0,))
    for objective in ("loop-shaping", "closed-loop"):
        aim = Transparency(objective, one, one)  # type: ignore[arg-type]
        for wanted in (
            SpringDamperWanted(Wish(objective, aim)),  # type: ignore[arg-type]
            LinearWanted((2, 2, 2), Wish(objective, aim)),  # type: ignore[arg-type]
            SpringDamperGiven(SPRINGS, aim),
        ):
            with pytest.raises(Infeasible, match="needs the dynamics of the environment") as caught:
                design(loop(0.1), wanted)
            assert "feasible or stiffest" in caught.value.condition


def test_the_budget_leaves_what_the_level_takes() -> None:
    assert environment_share(loop(0.5 * OSP).environment, OSP * np.eye(3), 1e-3) == pytest.approx(0.5)
    assert environment_share(loop(-0.5).environment, OSP * np.eye(3), 1e-3) == 0.0


def test_a_certificate_states_its_condition_and_round_trips(tmp_path: Path) -> None:
    certificate = design(loop(0.2), SpringDamperWanted()).certificate
    save(certificate, tmp_path / "c.json")
    again, data = load(tmp_path / "c.json")
    assert content(again) == content(certificate)
    assert data["environment"] == {"type": "declared", "level": (0.2 * np.eye(3)).tolist()}
    assert data["storage"]["E_hat"] == "enforced"
    assert again.loop.environment == certificate.loop.environment
    assert differences(again, loop(0.2), SpringDamperWanted()) == []
    for other in (loop(0.19), loop(0.2, enforced=False)):
        assert differences(again, other, SpringDamperWanted()) == ["the environment differs"]


def test_the_proof_proves_everything_else_and_reports_it() -> None:
    findings = prove(plain(0.2))
    assert all(finding.holds for finding in findings)
    (kept,) = (finding for finding in findings if finding.enforced)
    assert kept.condition == "E_hat is (-Phi_E)-ISP, (14)"
    assert "not proved" in kept.argument
    assert any(finding.condition == "the loop is well posed: the controller has one force" for finding in findings)


def mutated(data: dict[str, Any], *changes: tuple[tuple[str, ...], Any]) -> dict[str, Any]:
    """A certificate with other values, and an id that fits them."""
    for path, value in changes:
        part = data
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value
    data["id"] = identity(data)
    return data


@settings(max_examples=30)
@given(by=st.floats(1e-12, 1.0), port=st.integers(0, 2))
def test_a_level_above_what_was_counted_on_is_not_proved(by: float, port: int) -> None:
    data = plain(0.2)
    level = data["environment"]["level"]
    level[port][port] += by
    failing = [finding.condition for finding in prove(mutated(data)) if not finding.holds]
    assert "E_hat is (-Phi_E)-ISP, (14)" in failing


def test_a_stricter_level_than_was_counted_on_is_as_good() -> None:
    assert all(f.holds for f in prove(mutated(plain(0.2), (("environment", "level"), (0.1 * np.eye(3)).tolist()))))


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ([(("storage", "E_hat"), "energy")], "storage.E_hat"),
        ([(("storage", "E_hat"), [[1.0]])], "storage.E_hat"),
        ([(("environment",), {"type": "declared"})], "environment"),
        ([(("environment", "level"), [[0.2]])], "environment.level"),
        ([(("environment", "level"), [[0, 1, 0], [0, 0, 0], [0, 0, 0]])], "environment.level"),
        ([(("environment", "delay"), 0)], "environment"),
    ],
)
def test_forged_files_are_refused(changes: list[tuple[tuple[str, ...], Any]], refused: str) -> None:
    with pytest.raises(ProofInputError, match=refused):
        prove(mutated(plain(0.2), *changes))


def test_no_other_environment_may_call_itself_enforced(tmp_path: Path) -> None:
    """A network, or matrices, without a storage: neither read nor proved."""
    matrices = {"type": "state-space", "A": [], "B": [], "C": [], "D": (900.0 * np.eye(3)).tolist()}
    forged = mutated(plain(0.2), (("environment",), matrices | {"time": "discrete", "delay": 0}))
    with pytest.raises(ProofInputError, match=r"storage\.E_hat: found 'enforced'"):
        prove(forged)
    with pytest.raises(ValueError, match=r"storage\.E_hat: found 'enforced'"):
        from_content(forged)
    with pytest.raises(ValueError, match=r"storage\.E_hat: expected 'enforced'"):
        from_content(mutated(plain(0.2), (("storage", "E_hat"), "energy")))


def test_a_claim_on_transparency_is_not_proved() -> None:
    claim = {"objective": "loop-shaping", "gamma": 1e9, "P": []}
    one = {"num": [1.0], "den": [1.0]}
    findings = prove(mutated(plain(0.2), (("transparency",), claim | {"W1": one, "W2": one})))
    (failing,) = (finding for finding in findings if not finding.holds)
    assert failing.argument == "nothing is known of E but its declared level"


def test_levels_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="symmetric"):
        DeclaredEnvironment(("a", "b"), np.array([[0.0, 1.0], [0.0, 0.0]]))
    with pytest.raises(ValueError):  # noqa: PT011 -- the words are those of matrices in general
        DeclaredEnvironment(("a", "b"), np.eye(3))
    with pytest.raises(Infeasible, match="needs the dynamics"):
        loop(0.1).environment.environment(1e-3)
