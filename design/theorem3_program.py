"""Theorem 3 of [Bianchini2010]_ as one semidefinite program over all parties' levels and storage functions.

    maximise t   subject to
      E_hat is (-Phi_E)-ISP               (Lemma 1 for Rest, storage P_E)
      V_hat,i is Delta_V,i-OSP, each i    (Lemma 1, storage P_V,i)
      [ share Delta_D - Phi_E       -Phi_E       ]
      [       -Phi_E          Delta_V - Phi_E    ]  >= t I                          (10)

Delta_V has the structure of V: each block keeps a promise of its own. The blocks' inequality is asked in the state
(zeta, phi) = ((xi - xi_)/T, f - f_): the force itself has dropped out, for its part of the storage is fixed by the
steady states,

    P12 = (A - I)^{-T} C^T / 2,        P22 = (V(1) - K)/(2T),

which is facial reduction done by hand. The program is dense and its cost grows with the fourth power of the states. It
is the reference that the other ways (:mod:`manyhands.design.environment_level`) are held against, and what couplings of
several ports a block and general order need.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from manyhands.design.contract import DeviceShare
from manyhands.design.coordinates import balancing, change_states, scale_ports
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    solve,
    storage_inequality_expression,
    symmetric,
    value,
)
from manyhands.design.split import Split
from manyhands.design.statespace import Matrix, StateSpace, block_diagonal, symmetric_part

GREATEST_LEVELS = (100.0, 1e4)  # of Delta_D, the first that leaves (10) a margin: storage matrices grow with it
_T_KEPT = (0.9999, 0.995, 0.9, 0.5)  # parts of the best t that the second program keeps, the first with enough room
_ENOUGH_ROOM = 1e-7  # ten times what the solver leaves open
_LEAST_STORAGE = 1e-9
_LEAST_LEVEL = 1e-6  # Delta_V > this times Delta_D: Definition 2 asks OSP levels to be positive, (10) does not
_MOST_ROOM = 1e-2  # cap on the room asked in the Lemma 1 inequalities, scaled coordinates


@dataclass(frozen=True, eq=False)
class JointLevels:
    """What the program found, in physical units.

    Attributes:
        t: the greatest margin of (10), N*s/m.
        Delta_V: by block, m_i x m_i.
        P_V: by block, n_i x n_i, in the state zeta of the block's realisation.
        Phi_E: m x m.
    """

    t: float
    Delta_V: tuple[Matrix, ...]
    P_V: tuple[Matrix, ...]
    Phi_E: Matrix


@dataclass(frozen=True, eq=False)
class BlockForm:
    """V_hat of one block in (zeta, phi), ports and states scaled.

    Attributes:
        system: zeta+ = A zeta + B phi / T, y = C zeta + (D - K) phi / T.
        P12: n x m, the part of the storage between zeta and the force.
        P22: m x m, that of the force alone.
        states: X with scaled zeta = X zeta.
    """

    system: StateSpace
    P12: Matrix
    P22: Matrix
    states: Matrix

    @classmethod
    def of(cls, block: StateSpace, K: Matrix, T: float, S: Matrix | None = None) -> BlockForm:
        """The form of a block V_i (stable, V(1) symmetric) for the loop gain K_i; ports scaled by S where given.

        Raises:
            SolverFailure: V(1) cannot be evaluated, for V has a pole at 1.
        """
        m = block.inputs
        inverse: Matrix = np.eye(m) if S is None else np.asarray(np.linalg.inv(S), dtype=np.float64)
        V = scale_ports(block, inverse, inverse)
        X = np.eye(block.order) if S is None else balancing(V)
        V = change_states(V, X)
        gain = inverse @ K @ inverse
        try:
            P12: Matrix = np.asarray(np.linalg.solve((V.A - np.eye(V.order)).T, V.C.T / 2.0), dtype=np.float64)
        except np.linalg.LinAlgError as error:
            raise SolverFailure("V has a pole at z = 1") from error
        static = V.D - 2.0 * P12.T @ V.B  # V(1)
        system = StateSpace(V.A, V.B / T, V.C, (V.D - gain) / T)
        return cls(system, P12, symmetric_part(static - gain) / (2.0 * T), X)

    def storage(self, P: Any) -> Any:
        """Pi = [P P12; P12^T P22] as an expression."""
        return cp.bmat([[P, self.P12], [self.P12.T, self.P22]]) if self.system.order else cp.Constant(self.P22)

    def inequality(self, P: Any, Delta: Any) -> Any:
        """M_V, (n+m) x (n+m), affine in P and Delta: V_hat is Delta-OSP when M_V <= 0 and Pi > 0."""
        A, B = self.system.A, self.system.B
        off = A.T @ self.P12
        fixed = np.block([[np.zeros_like(A), off], [off.T, B.T @ self.P12 + self.P12.T @ B + self.P22]])
        return storage_inequality_expression(self.system, P, Delta=Delta) + fixed

    def proved(self, P: Any, Delta: Any) -> bool:
        """Whether the unknowns' present values are strict in numbers: a solver's "optimal" may be a little outside."""
        P, Delta = symmetric_part(value(P)), symmetric_part(value(Delta))
        Pi = value(self.storage(P))
        M = value(self.inequality(P, Delta))
        return bool(np.linalg.eigvalsh(symmetric_part(M))[-1] < 0.0 < np.linalg.eigvalsh(symmetric_part(Pi))[0])


@dataclass(frozen=True, eq=False)
class BlockLevel:
    """The level of one block's V_hat and its proof.

    Attributes:
        Delta: Delta_V,i, m_i x m_i, N*s/m.
        P: storage matrix in the state zeta, n_i x n_i; None where the level is in closed form.
    """

    Delta: Matrix
    P: Matrix | None


def block_level(
    name: str, block: StateSpace, K: Matrix, Delta_D: Matrix, T: float, greatest: float = GREATEST_LEVELS[0]
) -> BlockLevel:
    """The greatest multiple of Delta_D that is an OSP level of one block's V_hat: on one port, its greatest level.

    Args:
        name: of the block, for messages.
        block: V_i, discrete, stable, V(1) symmetric.
        K: loop gain, m_i x m_i, m/N.
        Delta_D: m_i x m_i, N*s/m.
        T: period, s.
        greatest: cap on the multiple. (10) asks for about need/(share - need), with the parts of Delta_D that the
            environment needs and that the devices have.

    Raises:
        Infeasible: V_hat,i is OSP at no level.
        SolverFailure: the solver gave no usable answer, or one without room for a proof.
    """
    m, n = block.inputs, block.order
    values, vectors = np.linalg.eigh(Delta_D)
    S = symmetric_part(vectors @ np.diag(values**-0.5) @ vectors.T)
    form = BlockForm.of(block, K, T, S)
    P, level, room = _storage(n), cp.Variable(), cp.Variable()
    I = np.eye(m)
    constraints = [
        symmetric(form.inequality(P, level * I)) << -room * np.eye(n + m),
        symmetric(form.storage(P)) >> (_LEAST_STORAGE + room) * np.eye(n + m),
        level <= greatest,
        room <= _MOST_ROOM,
    ]
    what = f"level of coupling {name}"
    try:
        best = solve(cp.Problem(cp.Maximize(level), [*constraints, room >= 0.0]), what)
        if best <= _LEAST_LEVEL:
            raise ProgramInfeasible(what)
        found = _make_room(constraints, room, level, best, what, lambda: form.proved(P, value(level) * I))
    except ProgramInfeasible as error:
        raise Infeasible(f"coupling {name}: V_hat is output strictly passive at no level", RELAX) from error
    if not found:
        raise SolverFailure(f"{what}: no room is left in the storage inequality, so nothing can be proved")
    return BlockLevel(
        symmetric_part(float(value(level)) * Delta_D), symmetric_part(form.states.T @ value(P) @ form.states)
    )


def joint_levels(
    loop: HapticLoop,
    blocks: tuple[StateSpace, ...],
    split: Split,
    device: DeviceShare,
    greatest: float = GREATEST_LEVELS[0],
) -> JointLevels:
    """Find the levels with the greatest margin of (10), or a little less where that leaves no room to prove them.

    Args:
        loop: the haptic loop.
        blocks: realisations of V's blocks, in the partition's order; ports in the block's order.
        split: the environment's E_hat without integrators.
        device: kappa and share.
        greatest: cap on the blocks' levels, as for :func:`block_level`.

    Raises:
        Infeasible: no levels exist; the coupling is not certified.
        SolverFailure: the solver gave no usable answer.
    """
    m, T, partition = len(loop.ports), loop.period, loop.partition
    S = loop.scaling
    room, t = cp.Variable(), cp.Variable()
    rest = scale_ports(split.rest, S, S)
    rest = change_states(rest, balancing(rest))
    P_E, Phi = _storage(rest.order), cp.Variable((m, m), symmetric=True)
    static = symmetric_part(S @ split.stiffness @ S) * T / 2.0
    E_inequality = symmetric(storage_inequality_expression(rest, P_E, Phi=static - Phi))
    constraints = [
        E_inequality << -room * np.eye(rest.order + m),
        *_positive(P_E, rest.order),
        room <= _MOST_ROOM,
    ]
    Delta_V, P_V, forms = [], [], []
    embedded: Any = np.zeros((m, m))
    for block, select, S_i, K_i in zip(
        blocks, partition.selections(), partition.restrict(S), loop.loop_gain(device.kappa), strict=True
    ):
        form = BlockForm.of(block, K_i, T, S_i)
        n, m_i = form.system.order, len(S_i)
        P, Delta = _storage(n), cp.Variable((m_i, m_i), symmetric=True)
        constraints += [
            symmetric(form.inequality(P, Delta)) << -room * np.eye(n + m_i),
            symmetric(form.storage(P)) >> _LEAST_STORAGE * np.eye(n + m_i),
            Delta << greatest * np.eye(m_i),
            Delta >> _LEAST_LEVEL * np.eye(m_i),
        ]
        Delta_V.append(Delta)
        P_V.append(P)
        forms.append(form)
        embedded = embedded + select @ Delta @ select.T
    share = device.share * np.eye(m)
    square = block_diagonal([symmetric_part(S @ S)] * 2)
    condition_10 = symmetric(cp.bmat([[share - Phi, -Phi], [-Phi, embedded - Phi]]))
    constraints.append(condition_10 >> t * square)

    what = "Theorem 3 for a given coupling"
    try:
        best = solve(cp.Problem(cp.Maximize(t), [*constraints, room >= 0.0]), what)
        if best <= 0.0:
            raise Infeasible(f"condition (10) fails: its best margin is {best:.4g} N*s/m, expected > 0", RELAX)
        parts = list(zip(forms, P_V, Delta_V, strict=True))
        found = _make_room(constraints, room, t, best, what, lambda: all(f.proved(P, D) for f, P, D in parts))
    except ProgramInfeasible as error:
        raise Infeasible("no levels satisfy Theorem 3 with this coupling", RELAX) from error
    if not found:
        raise SolverFailure(f"{what}: no room is left in the storage inequalities, so nothing can be proved")
    inverse: Matrix = np.asarray(np.linalg.inv(S), dtype=np.float64)
    return JointLevels(
        t=best,
        Delta_V=tuple(
            symmetric_part(i @ value(D) @ i) for i, D in zip(partition.restrict(inverse), Delta_V, strict=True)
        ),
        P_V=tuple(symmetric_part(f.states.T @ value(P) @ f.states) for f, P in zip(forms, P_V, strict=True)),
        Phi_E=symmetric_part(inverse @ value(Phi) @ inverse),
    )


def _make_room(
    constraints: list[cp.Constraint],
    room: cp.Variable,
    t: cp.Variable,
    best: float,
    what: str,
    proved: Callable[[], bool],
) -> bool:
    """The second program, for the greatest part of ``best`` that leaves enough room; whether its answer is proved."""
    for kept in _T_KEPT:
        try:
            found = solve(cp.Problem(cp.Maximize(room), [*constraints, t >= kept * best]), what)
        except (ProgramInfeasible, SolverFailure):  # the best t is an edge: a solver may stumble there
            if kept == _T_KEPT[-1]:
                raise
        else:
            if found >= _ENOUGH_ROOM and proved():
                return True
    return float(value(room)) > 0.0 and proved()


RELAX = (
    "lower the coupling's stiffness",
    "shorten the period",
    "use devices with more damping (a greater osp)",
)


def _storage(n: int) -> Any:
    return cp.Variable((n, n), symmetric=True) if n else np.zeros((0, 0))


def _positive(P: Any, n: int) -> list[cp.Constraint]:
    return [P >> _LEAST_STORAGE * np.eye(n)] if n else []
