"""Theorem 3 of [Bianchini2010]_: is the loop stable with a *given* coupling?

One semidefinite program looks for storage functions and levels of all parties at once,

    maximise t   subject to
      E_hat is (-Phi_E)-ISP               (Lemma 1, storage P_E)
      V_hat,i is Delta_V,i-OSP, each i    (Lemma 1, storage P_V,i)
      [ Delta_D - Phi_E       -Phi_E       ]
      [    -Phi_E        Delta_V - Phi_E   ]  >= t I                          (10)

and the loop is certified when t > 0. Delta_V is given the structure of V: each block then keeps a promise
of its own, which its process can watch from its own data. A second program keeps t just below its
optimum, or lower where that leaves next to nothing, and maximises the room left in the other inequalities, so that a
check in floating point has something to hold.

All of it is solved in ports scaled by S = Delta_D^{-1/2}, where Delta_D = I and, for networks in energy
coordinates, P_E is near I.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from manyhands.design.contract import Levels
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.necessary import check_block
from manyhands.design.passivity import storage_face
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    positive,
    solve,
    storage_inequality_expression,
    storage_on,
    symmetric,
    value,
)
from manyhands.design.statespace import Matrix, StateSpace, block_diagonal, symmetric_part
from manyhands.design.transformation import transformed_coupling

_GREATEST_LEVEL = 100.0  # of Delta_D: (10) gains nothing from more, and storage matrices grow with it
_T_KEPT = (0.995, 0.9, 0.5)  # parts of the best t that the second program keeps, the first that leaves enough room
_ENOUGH_ROOM = 1e-7  # ten times what the solver leaves open
_LEAST_STORAGE = 1e-9  # P > this, in scaled coordinates where P_E is near I
_LEAST_LEVEL = 1e-6  # Delta_V > this times Delta_D: Definition 2 asks OSP levels to be positive, (10) does not
_HIDDEN = 1e-100  # a state whose Gramian is less is not seen in any units that somebody would choose
_PHYSICAL_LEVEL = 1e-3  # of Delta_D: what (10) gives away for it is as small
_MOST_ROOM = 1e-2  # cap on the room asked in the Lemma 1 inequalities, same coordinates


def certify_given(loop: HapticLoop, blocks: tuple[StateSpace, ...]) -> Levels:
    """Find levels that prove the loop stable with the coupling blockdiag(``blocks``).

    Args:
        loop: the haptic loop.
        blocks: realisations of V's blocks, in the partition's order; ports in the block's order.

    Raises:
        Infeasible: no levels exist; the coupling is not certified.
        SolverFailure: the solver gave no usable answer.
    """
    for name, block, K_i in zip(loop.partition.names, blocks, loop.partition.restrict(loop.K), strict=True):
        check_block(name, block, K_i, loop.period)
    try:
        return _levels(loop, blocks, _searched_environment)
    except (Infeasible, SolverFailure) as first:
        try:
            return _levels(loop, blocks, _physical_environment)
        except (Infeasible, SolverFailure):
            raise first from None


@dataclass(frozen=True, eq=False)
class _Environment:
    """E_hat's part of the program: storage matrix, level, and what is asked of them."""

    P: Any
    Phi: Any
    constraints: list[cp.Constraint]


def _searched_environment(E_hat: StateSpace, room: cp.Variable) -> _Environment:
    """Any storage and any level."""
    face = storage_face(E_hat, "input")
    if face is None:
        raise Infeasible("the environment's static stiffness is not symmetric: E_hat cannot be passive", ())
    P, Phi = storage_on(face), cp.Variable((E_hat.inputs, E_hat.inputs), symmetric=True)
    dissipation = _reduced(storage_inequality_expression(E_hat, P, Phi=-Phi), face.complement, room)
    return _Environment(P, Phi, [*positive(P, _LEAST_STORAGE), dissipation])


def _physical_environment(E_hat: StateSpace, _room: cp.Variable) -> _Environment:
    """The network's own energy, in whose coordinates it is the identity, and a level a little above none.

    Nothing is searched, so nothing can stumble: for networks whose slow modes dissipate less in a tick than a solver
    resolves. The level is what makes the dissipation strict where a network can drift freely.
    """
    return _Environment(np.eye(E_hat.order), _PHYSICAL_LEVEL * np.eye(E_hat.inputs), [])


def _levels(
    loop: HapticLoop,
    blocks: tuple[StateSpace, ...],
    environment: Callable[[StateSpace, cp.Variable], _Environment],
) -> Levels:
    """Solve both programs, with one way of treating the environment."""
    m = len(loop.ports)
    partition, S = loop.partition, loop.scaling
    room, t = cp.Variable(), cp.Variable()
    E = environment(scale_ports(loop.E_hat, S, S), room)
    constraints = [*E.constraints, room <= _MOST_ROOM]
    Delta_V: list[cp.Variable] = []
    P_V = []
    embedded: Any = np.zeros((m, m))
    back: list[Matrix] = []
    for name, block, select, S_i, K_i in zip(
        partition.names,
        blocks,
        partition.selections(),
        partition.restrict(S),
        partition.restrict(loop.K),
        strict=True,
    ):
        V_hat, states = _scaled_block(block, S_i, K_i, loop.period)
        face = storage_face(V_hat, "output")
        if face is None:
            raise SolverFailure(f"coupling {name}: its steady states admit no storage function")
        P, Delta = storage_on(face), cp.Variable((len(S_i), len(S_i)), symmetric=True)
        constraints += [
            *positive(P, _LEAST_STORAGE),
            _reduced(storage_inequality_expression(V_hat, P, Delta=Delta), face.complement, room),
            Delta << _GREATEST_LEVEL * np.eye(len(S_i)),
            Delta >> _LEAST_LEVEL * np.eye(len(S_i)),
        ]
        Delta_V.append(Delta)
        P_V.append(P)
        back.append(states)
        embedded = embedded + select @ Delta @ select.T
    square = block_diagonal([symmetric_part(S @ S)] * 2)
    condition_10 = symmetric(cp.bmat([[np.eye(m) - E.Phi, -E.Phi], [-E.Phi, embedded - E.Phi]]))
    constraints.append(condition_10 >> t * square)

    what = "Theorem 3 for a given coupling"
    try:
        best = solve(cp.Problem(cp.Maximize(t), [*constraints, room >= 0.0]), what)
        if best <= 0.0:
            raise Infeasible(f"condition (10) fails: its best margin is {best:.4g} N*s/m, expected > 0", _RELAX)
        _make_room(constraints, room, t, best, what)
    except ProgramInfeasible as error:
        raise Infeasible("no levels satisfy Theorem 3 with this coupling", _RELAX) from error
    if float(value(room)) <= 0.0:
        raise SolverFailure(f"{what}: no room is left in the storage inequalities, so nothing can be verified")
    inverse: Matrix = np.asarray(np.linalg.inv(S), dtype=np.float64)
    return Levels(
        Delta_V=partition.embed(
            [symmetric_part(i @ value(D) @ i) for i, D in zip(partition.restrict(inverse), Delta_V, strict=True)]
        ),
        Phi_E=symmetric_part(inverse @ value(E.Phi) @ inverse),
        P_E=symmetric_part(value(E.P)),
        P_V=tuple(symmetric_part(X.T @ value(P) @ X) for X, P in zip(back, P_V, strict=True)),
    )


def _make_room(constraints: list[cp.Constraint], room: cp.Variable, t: cp.Variable, best: float, what: str) -> None:
    """The second program, for the greatest part of ``best`` that leaves enough room."""
    for kept in _T_KEPT:
        try:
            found = solve(cp.Problem(cp.Maximize(room), [*constraints, t >= kept * best]), what)
        except (ProgramInfeasible, SolverFailure):  # the best t is an edge: a solver may stumble there
            if kept == _T_KEPT[-1]:
                raise
        else:
            if found >= _ENOUGH_ROOM:
                return


_RELAX = (
    "lower the coupling's stiffness",
    "shorten the period",
    "use devices with more damping (a greater osp)",
)


def scale_ports(system: StateSpace, left: Matrix, right: Matrix) -> StateSpace:
    """The system left * Sigma * right, for square matrices on its outputs and inputs."""
    return StateSpace(system.A, system.B @ right, left @ system.C, left @ system.D @ right)


def _reduced(M: Any, complement: Matrix, room: cp.Variable) -> Any:
    """W^T M W <= -room I on the complement W of the neutral pairs."""
    return symmetric(complement.T @ M @ complement) << -room * np.eye(complement.shape[1])


def _scaled_block(block: StateSpace, S: Matrix, K: Matrix, T: float) -> tuple[StateSpace, Matrix]:
    """V_hat of a block in scaled ports and states, and X with (scaled state) = X (state of (12)).

    The force of the tick before is scaled like the ports. Of xi, with one entry a port (the spring-damper
    class), a force times a second over a length, S is the scaling too; and every xi is balanced, so that it does not
    matter in which units a given realisation counts its states.
    """
    inverse: Matrix = np.asarray(np.linalg.inv(S), dtype=np.float64)
    K_scaled: Matrix = np.asarray(inverse @ K @ inverse)
    V_hat = transformed_coupling(scale_ports(block, inverse, inverse), K_scaled, T)
    X_xi: Matrix = S if block.order == block.inputs else np.eye(block.order)
    n = block.order
    balance = _balance(
        X_xi @ V_hat.A[:n, :n] @ np.linalg.inv(X_xi), X_xi @ V_hat.B[:n], V_hat.C[:, :n] @ np.linalg.inv(X_xi)
    )
    X_xi = balance[:, None] * X_xi
    X = block_diagonal([X_xi, np.eye(block.inputs)])  # the scaled V_hat remembers a scaled force already
    X_inverse = np.linalg.inv(X)
    scaled = StateSpace(X @ V_hat.A @ X_inverse, X @ V_hat.B, V_hat.C @ X_inverse, V_hat.D)
    return scaled, block_diagonal([X_xi, S])


def _balance(A: Matrix, B: Matrix, C: Matrix) -> Matrix:
    """Powers of two d such that every state d_i xi_i of the stable (A, B, C) is as controllable as it is observable."""
    controllable = np.diag(solve_discrete_lyapunov(A, B @ B.T)) if len(A) else np.zeros(0)
    observable = np.diag(solve_discrete_lyapunov(A.T, C.T @ C)) if len(A) else np.zeros(0)
    both = np.minimum(controllable, observable) > _HIDDEN
    ratio = np.where(both, observable, 1.0) / np.where(both, controllable, 1.0)
    return np.asarray(np.exp2(np.round(np.log2(ratio) / 4.0)), dtype=np.float64)
