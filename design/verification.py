"""Proving a certificate again, from its physical data, with numpy's eigenvalues and no solver.

What is rebuilt, not read: E_hat from masses, springs and dampers; the blocks of V from K and B; V_hat by
(12); Delta_D from the devices. Then every condition of Theorem 3 [Bianchini2010]_ is tested at the
certificate's levels and storage matrices. An inequality holds when its eigenvalue is beyond a bound on the
rounding of its own evaluation; an equality (the faces of :mod:`manyhands.design.passivity`) when its
relative residual is at rounding level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from manyhands.design.certificate import Certificate, identity, read_system
from manyhands.design.contract import loop_inequality
from manyhands.design.errors import Infeasible
from manyhands.design.necessary import check_block
from manyhands.design.passivity import (
    NeutralAt,
    equality_residual,
    kernel,
    neutral_pairs,
    storage_inequality,
)
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
)
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.transformation import transformed_coupling

_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)  # of a sum of a few dozen products, relative to its largest term
_EQUAL = 1e-9  # relative; rebuilding a matrix by another order of operations differs by far less
_MARGIN = 1e-6  # relative, of a stated margin
_FACE = 1e-8  # relative residual of the neutral equalities: the rank decision's own tolerance, times ten


@dataclass(frozen=True)
class Finding:
    """One condition and how it came out.

    Attributes:
        condition: what was tested, with its number in the paper where it has one.
        value: the figure found: an eigenvalue that must exceed ``bound``, or a residual that must not.
        bound: the figure it is held against.
        holds: whether it holds.
        key: its name among the certificate's margins, empty when it is not a margin.
    """

    condition: str
    value: float
    bound: float
    holds: bool
    key: str = ""


def verify(certificate: Certificate, data: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Test everything the certificate claims.

    Args:
        certificate: as loaded.
        data: the file's plain data (for the id).

    Returns:
        Every finding; the certificate is proved when all of them hold.
    """
    findings = [_equal("the id is the SHA-256 of the content", float(identity(data) != certificate.id), 0.0)]
    findings += _evaluated(lambda: _restatement(certificate, data))
    findings += conditions(certificate)
    found = {finding.key: finding for finding in findings if finding.key}
    if set(found) != set(certificate.margins):
        findings.append(_equal("the margins are those of this version's conditions", 1.0, 0.0))
    else:
        # another machine's eigenvalues differ by as much as the rounding bound
        allowed = {k: max(_MARGIN * abs(f.value), f.bound) for k, f in found.items()}
        off = [abs(certificate.margins[k] - f.value) / allowed[k] for k, f in found.items()]
        worst = float(np.max(off, initial=0.0))
        findings.append(_equal("the stated margins are the ones found", worst, 1.0))
    return tuple(findings)


def differences(certificate: Certificate, loop: HapticLoop, wanted: CouplingRequest) -> list[str]:
    """Where the certificate is about another loop, or another coupling, than these; empty when it fits."""
    own = certificate.loop
    out = [
        f"the {what} differs: the certificate has {mine}, the session {theirs}"
        for what, mine, theirs in (
            ("session's name", own.session, loop.session),
            ("period", own.period, loop.period),
            ("list of ports", ", ".join(own.ports), ", ".join(loop.ports)),
        )
        if mine != theirs
    ]
    out += [
        f"the {what} differs"
        for what, mine, theirs in (
            ("block structure", own.partition, loop.partition),
            ("environment", own.network, loop.network),
            ("level or order of devices", [_level(d) for d in own.devices], [_level(d) for d in loop.devices]),
        )
        if mine != theirs
    ]
    match wanted:
        case SpringDamperGiven(given):
            held = certificate.coupling
            if held is None or np.any(held.stiffness != given.stiffness) or np.any(held.damping != given.damping):
                out.append("the coupling is not the one that the session gives")
        case LinearGiven(blocks):
            if [_system(b) for b in certificate.blocks] != [_system(b) for b in blocks]:
                out.append("the coupling is not the one that the session gives")
        case SpringDamperWanted():
            if certificate.coupling is None:
                out.append("the coupling is not of the spring-damper class that the session wants")
        case NoCoupling():
            out.append("the session wants no coupling")
    return out


def _level(device: DeviceLevel) -> tuple[str, tuple[int, ...], list[list[float]]]:
    return device.name, device.ports, device.level.tolist()


def _system(system: StateSpace) -> list[list[list[float]]]:
    return [M.tolist() for M in (system.A, system.B, system.C, system.D)]


def margins(certificate: Certificate) -> dict[str, float]:
    """The margins of every condition, by name, recomputed."""
    return {finding.key: finding.value for finding in conditions(certificate) if finding.key}


def conditions(certificate: Certificate) -> list[Finding]:
    """The conditions of Theorem 3, rebuilt from the certificate's physical data."""
    return _evaluated(lambda: _conditions(certificate))


def _evaluated(test: Callable[[], list[Finding]]) -> list[Finding]:
    """What ``test`` finds; numbers that overflow, or have no eigenvalues, are one more way of not being proved."""
    try:
        with np.errstate(all="ignore"):  # what is not finite fails the comparison that it ends in
            return test()
    except ValueError as error:  # also numpy's LinAlgError
        return [_equal(f"the conditions can be evaluated in floating point ({error})", 1.0, 0.0)]


def _conditions(certificate: Certificate) -> list[Finding]:
    loop, levels = certificate.loop, certificate.levels
    partition = loop.partition
    findings = [
        _equal("Delta_V, K and B have the block structure", _off_structure(certificate), 0.0),
        _equal("tau = 0, which is what Theorem 2 assumes", abs(certificate.tau), 0.0),
    ]
    if certificate.coupling is not None:
        residuals = [
            _realisation_residual(block, K, B, loop.period)
            for block, K, B in zip(
                certificate.blocks,
                partition.restrict(certificate.coupling.stiffness),
                partition.restrict(certificate.coupling.damping),
                strict=True,
            )
        ]
        findings.append(_equal("the blocks of V realise K and B, (21)", float(np.max(residuals)), _EQUAL))
    findings += _dissipation("E_hat is (-Phi_E)-ISP, (14)", "E_hat", loop.E_hat, levels.P_E, "input", -levels.Phi_E)
    for name, block, P, Delta, K in zip(
        partition.names,
        certificate.blocks,
        levels.P_V,
        partition.restrict(levels.Delta_V),
        partition.restrict(loop.K),
        strict=True,
    ):
        findings.append(_stable_and_passive(name, block, K, loop.period))
        V_hat = transformed_coupling(block, K, loop.period)
        findings += _dissipation(f"V_hat of {name} is Delta_V-OSP, Lemma 1", f"V_hat.{name}", V_hat, P, "output", Delta)
    findings.append(_positive("Delta_V > 0", "Delta_V", levels.Delta_V))
    matrix_10 = loop_inequality(loop.Delta_D, levels.Delta_V, levels.Phi_E)
    findings.append(_positive("condition (10)", "(10)", matrix_10))
    return findings


def _dissipation(
    condition: str, key: str, system: StateSpace, P: Matrix, at: NeutralAt, level: Matrix
) -> list[Finding]:
    """P > 0, the neutral equalities, and Lemma 1 strictly on a complement of the neutral pairs."""
    n = system.order
    if P.shape != (n, n):
        return [_equal(f"{condition}: the storage matrix is {n} x {n}", 1.0, 0.0)]
    system, P = _in_units_of_storage(system, P)
    residual = equality_residual(system, P, at) if n else 0.0
    M = storage_inequality(system, P, Phi=level) if at == "input" else storage_inequality(system, P, Delta=level)
    W = kernel(neutral_pairs(system, at).T)
    findings = [
        _equal(f"{condition}: the steady states are neutral", residual, _FACE),
        _positive(f"{condition}: dissipation", key, -W.T @ M @ W, scale=_largest_term(system, P, level)),
    ]
    if n:
        findings.append(_positive(f"{condition}: the storage is positive", f"{key}.P", P))
    return findings


def _largest_term(system: StateSpace, P: Matrix, level: Matrix) -> float:
    """A bound on the terms that cancel in M(P): with the same matrices, every entry made positive."""
    A, B, C, D, P, level = (np.abs(M) for M in (system.A, system.B, system.C, system.D, P, level))
    G, y = np.hstack([A, B]), np.hstack([C, D])
    terms = (G.T @ P @ G, P, y, level, y.T @ level @ y)
    return max(float(np.max(term, initial=0.0)) for term in terms)


def _in_units_of_storage(system: StateSpace, P: Matrix) -> tuple[StateSpace, Matrix]:
    """The same system and storage, in states scaled so that P has a diagonal near 1.

    What is small, or equal, is judged in these units and not in those of somebody's realisation. The scales are
    powers of two, so that nothing is rounded.
    """
    diagonal = np.diag(P)
    d = np.exp2(-np.round(np.log2(np.where(diagonal > 0.0, diagonal, 1.0)) / 2.0))
    scaled = StateSpace(system.A * d / d[:, None], system.B / d[:, None], system.C * d, system.D)
    return scaled, P * d * d[:, None]


def _stable_and_passive(name: str, block: StateSpace, K: Matrix, T: float) -> Finding:
    """The frequency-domain necessary conditions, a test of another kind than the matrix inequality."""
    try:
        check_block(name, block, K, T)
    except Infeasible as error:
        return Finding(f"V_hat of {name} is passive over frequency: {error.condition}", 1.0, 0.0, False)
    return Finding(f"V_hat of {name} is passive over frequency", 0.0, 0.0, True)


def _restatement(certificate: Certificate, data: Mapping[str, Any]) -> list[Finding]:
    """Whether what the file restates for its readers is what its physical data give."""
    E_hat, stated = certificate.loop.E_hat, read_system(data["storage"]["E_hat"])
    pairs = [(getattr(E_hat, name), getattr(stated, name)) for name in "ABCD"]
    pairs.append((certificate.loop.Delta_D, np.array(data["levels"]["Delta_D"], dtype=np.float64)))
    residual = float(np.max([_relative_difference(right, found) for right, found in pairs]))
    return [_equal("the stated E_hat and Delta_D are those of the physical data", residual, _EQUAL)]


def _relative_difference(right: Matrix, found: Matrix) -> float:
    if found.shape != right.shape:
        return float("inf")
    scale = max(float(np.max(np.abs(right), initial=0.0)), 1e-300)
    return float(np.max(np.abs(found - right), initial=0.0)) / scale


def _off_structure(certificate: Certificate) -> float:
    mask = certificate.loop.partition.mask()
    matrices = [certificate.levels.Delta_V]
    if certificate.coupling is not None:
        matrices += [certificate.coupling.stiffness, certificate.coupling.damping]
    return max(float(np.max(np.abs(M[~mask]), initial=0.0)) for M in matrices)


def _realisation_residual(block: StateSpace, K: Matrix, B: Matrix, T: float) -> float:
    """Relative residual of (T K + B) C_V = I, A_V = B C_V, B_V = T A_V, D_V = T C_V."""
    if block.order != K.shape[0]:
        return float("inf")
    C = block.C
    pairs = (
        ((T * K + B) @ C, np.eye(K.shape[0])),
        (block.A, B @ C),
        (block.B, T * B @ C),
        (block.D, T * C),
    )
    return float(np.max([np.max(np.abs(left - right)) / max(float(np.max(np.abs(right))), T) for left, right in pairs]))


def _positive(condition: str, key: str, M: Matrix, scale: float = 0.0) -> Finding:
    """M > 0, beyond the rounding of its evaluation (relative to its own norm, or to ``scale`` if larger)."""
    if M.size == 0:
        return Finding(condition, 0.0, 0.0, True)
    if float(np.max(np.abs(M - M.T))) > _EQUAL * float(np.max(np.abs(M))):
        return Finding(f"{condition}: the matrix is symmetric", 1.0, 0.0, False)
    least = float(np.linalg.eigvalsh(symmetric_part(M))[0])
    bound = _ROUNDING * M.shape[0] * max(float(np.max(np.abs(M))), scale)
    return Finding(condition, least, bound, least > bound, key)


def _equal(condition: str, residual: float, bound: float) -> Finding:
    return Finding(condition, residual, bound, residual <= bound)
