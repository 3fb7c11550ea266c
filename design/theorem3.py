"""Theorem 3 of [Bianchini2010]_: is the loop stable with a *given* coupling?

Each party's level is found by the cheapest exact method available. The parties share only one number, the gain kappa.

- The device keeps the part of Delta_D that a delay inside the tick leaves (:mod:`manyhands.design.levels.device`).
- Each block of V has a level of its own. Springs and dampers have a greatest level in closed form
  (:mod:`manyhands.design.levels.spring_damper`). A linear block on one port has a greatest level too, found by a small
  program. A linear block on several ports has many levels that are not comparable; the joint program below chooses.
- The environment gets the level that leaves (10) the greatest margin (:mod:`manyhands.design.levels.environment`), with
  a storage function from one Riccati equation. Large networks, and networks known up to intervals, are proved by their
  mechanical energy instead, which needs no matrix (:mod:`manyhands.design.levels.network`).

The result is a claim. :mod:`manyhands.design.proof` proves it by other means.

**Necessary conditions.** Some conditions on a block are cheap enough to be tested before any solver runs.
V_hat,i = (z-1)/(Tz) [V_i - K_i] is OSP at some level only if its Hermitian part is non-negative on the unit circle. At
the circle's two ends, z -> 1 and z = -1, this means

    V(1) = V(1)^T > K,            for springs and dampers   K_s T/2 < Delta_D,
    V(-1) + V(-1)^T > 2 K,                                  K_s T/2 + B_s < Delta_D

(K_s, B_s stiffness and damping). A block that fails is refused with the limit.

**The joint program** is Theorem 3 as one semidefinite program over all parties' levels and storage functions:

    maximise t   subject to
      E_hat is (-Phi_E)-ISP               (Lemma 1 for Rest, storage P_E)
      V_hat,i is Delta_V,i-OSP, each i    (Lemma 1, storage P_V,i)
      [ share Delta_D - Phi_E       -Phi_E       ]
      [       -Phi_E          Delta_V - Phi_E    ]  >= t I                          (10)

Delta_V has the structure of V: each block keeps a promise of its own. The blocks' inequality is stated in the state
(zeta, phi) = ((xi - xi_)/T, f - f_). The force itself has dropped out, because the steady states fix its part of the
storage,

    P12 = (A - I)^{-T} C^T / 2,        P22 = (V(1) - K)/(2T),

which is facial reduction done by hand. The program is dense and its cost grows with the fourth power of the states.
Linear couplings with several ports in a block need it. It is also the reference for the tests of the other methods
(:mod:`manyhands.design.levels.environment`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from manyhands.design import convex as cp
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.levels.contract import ENERGY, ENFORCED, NO_DELAY_GAIN, DeviceShare, Levels, Storage, margin
from manyhands.design.levels.device import device_share, least_gain
from manyhands.design.levels.environment import level_and_storage
from manyhands.design.levels.network import physical_level
from manyhands.design.levels.spring_damper import greatest_level
from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.design.models.coupling import CouplingBlock, SpringDamper, realisations, transformed_coupling
from manyhands.design.models.integrators import Split
from manyhands.design.models.statespace import Matrix, StateSpace, block_diagonal, symmetric_part
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    balancing,
    change_states,
    scale_ports,
    solve,
    storage_inequality_expression,
    symmetric,
    value,
)

# Necessary conditions on one block of V

_SPRING = "expected a spring of positive stiffness between hand and tool in every direction"
_FREQUENCIES = 400
_ROUNDING = 1e-9  # relative to the largest gain on the circle
_EDGE = 1e-12  # relative: exact arithmetic may find a coupling that is this near to the limit beyond it
# relative: nearer than this to the limit, rounding may leave a level in closed form above the greatest one, for that
# grows with the inverse of the distance, and its error with the inverse once more
_BAND = 1e-5


def check_spring_damper(
    name: str, coupling: SpringDamper, Lambda: Matrix, T: float, kappa: float, units: Units = TRANSLATING
) -> None:
    """Test K_s > 0, J = Lambda - T/2 K_s > 0 and J - B >= 0: V_hat of springs and dampers is OSP exactly then.

    Args:
        name: of the block, for the message.
        coupling: stiffness and damping of the block.
        Lambda: Delta_D / (2 kappa), m_i x m_i, N*s/m.
        T: period, s.
        kappa: gain of the loop transformation, 1/2 without delay.
        units: of the block's ports, for the message.

    Raises:
        Infeasible: V_hat is OSP at no level.
    """
    if float(np.linalg.eigvalsh(coupling.stiffness)[0]) <= 0.0:
        raise Infeasible(
            f"coupling {name}: V(1) is not positive, so that V_hat is output strictly passive at no level; {_SPRING}"
        )
    limit = 2.0 / T * float(np.linalg.eigvalsh(Lambda)[0])
    # where there is a damping, its sum with the stiffness is the stricter of both, and the limit to state
    both = T / 2.0 * coupling.stiffness + coupling.damping
    for part, damped in ((both, bool(coupling.damping.any())), (T / 2.0 * coupling.stiffness, False)):
        used = _used(part, Lambda)
        if not used < 1.0 - _EDGE:
            raise TooStiff(name, used, limit, kappa, damped, units)


def nearly_too_stiff(
    loop: HapticLoop, coupling: tuple[CouplingBlock, ...], kappa: float, broken: Collection[str]
) -> TooStiff | None:
    """The refusal of springs whose levels did not survive the proof, for rounding near their limit; None of others.

    Args:
        loop: the haptic loop.
        coupling: V's blocks in the partition's order.
        kappa: the gain of the levels.
        broken: the blocks whose levels did not survive the proof.
    """
    parts = zip(loop.partition.names, coupling, loop.partition.blocks, loop.Delta_D_blocks, strict=True)
    for name, part, ports, Delta_D in parts:
        if name in broken and isinstance(part, SpringDamper):
            units = loop.units(*(loop.ports[port] for port in ports))
            if error := _near(name, part, Delta_D / (2.0 * kappa), loop.period, kappa, units):
                return error
    return None


def _near(name: str, coupling: SpringDamper, Lambda: Matrix, T: float, kappa: float, units: Units) -> TooStiff | None:
    """The refusal of one block's springs, if they are so near to their limit; arguments as check_spring_damper."""
    used = _used(T / 2.0 * coupling.stiffness, Lambda)
    limit = 2.0 / T * float(np.linalg.eigvalsh(Lambda)[0])
    return TooStiff(name, used, limit, kappa, False, units) if used > 1.0 - _BAND else None


def _used(part: Matrix, Lambda: Matrix) -> float:
    """The part of Lambda that a stiffness or damping, N*s/m, uses in the direction where it uses most."""
    inverse = np.linalg.inv(np.linalg.cholesky(Lambda))
    return float(np.linalg.eigvalsh(symmetric_part(inverse @ part @ inverse.T))[-1])


class TooStiff(Infeasible):
    """A block of V is beyond the limit of its stiffness at one gain kappa.

    Attributes:
        name: of the block.
        limit: N/m.
        over: what the block has, in units of the limit.
    """

    def __init__(self, name: str, over: float, limit: float, kappa: float, damped: bool, units: Units) -> None:
        formula = "2 Delta_D / T" if kappa == NO_DELAY_GAIN else f"Delta_D / ({kappa:.4g} T)"
        meaning = "stiffness plus 2/T times its damping" if damped else "stiffness"
        self.name, self.limit, self.over = name, limit, over
        unit = units("N/m")
        found, most = f"{over * limit:.4g} {unit}", f"{formula} = {limit:.4g} {unit}"
        if over < 1.0 - _EDGE:
            below = f"too little below {most}, by {1.0 - over:.1g} of it, for floating point to find a level of V_hat"
        else:
            below = f"not below {most}, so that V_hat is output strictly passive at no level"
        super().__init__(f"coupling {name}: its {meaning}, {found}, is {below}")


def check_block(
    name: str, block: StateSpace, K: Matrix, T: float, kappa: float = NO_DELAY_GAIN, units: Units = TRANSLATING
) -> None:
    """Test the necessary conditions on the linear block ``name`` of V.

    Args:
        name: of the coupling, for the message.
        block: V_i, discrete, force (N) to displacement (m).
        K: the block K_i of the transformation, m/N.
        T: period, s.
        kappa: gain of the loop transformation, for the message.
        units: of the block's ports, likewise.

    Raises:
        Infeasible: V_hat,i is OSP at no level.
    """
    if np.max(np.abs(np.linalg.eigvals(block.A)), initial=0.0) >= 1.0:
        raise Infeasible(
            f"coupling {name}: V is not stable; expected a damping of every mode, and a spring of positive stiffness "
            "in every direction"
        )
    limit = 1.0 / float(np.linalg.eigvalsh(K)[-1])
    beyond: list[TooStiff] = []
    for point in (1.0, -1.0):
        compliance = block.response(point).real
        # (z-1)/(Tz) vanishes at z = 1, so that a skew part, however small, outweighs the symmetric part there
        if point == 1.0 and np.max(np.abs(compliance - compliance.T)) > _ROUNDING * np.max(
            np.abs(compliance), initial=1e-300
        ):
            raise Infeasible(
                f"coupling {name}: V({point:g}) is not symmetric, so that V_hat is output strictly passive at no level"
            )
        compliance = symmetric_part(compliance)
        softest = float(np.linalg.eigvalsh(compliance)[0])
        if float(np.linalg.eigvalsh(compliance - K)[0]) > 0.0:
            continue
        if softest <= 0.0:
            raise Infeasible(
                f"coupling {name}: V({point:g}) is not positive, so that V_hat is output strictly passive at no level; "
                f"{_SPRING}"
            )
        beyond.append(TooStiff(name, 1.0 / (softest * limit), limit, kappa, point == -1.0, units))
    if beyond:  # at -1 the damping counts as well, so that both limits may be passed
        raise max(beyond, key=lambda error: error.over)
    V_hat = transformed_coupling(block, K, T)
    for angle in np.linspace(np.pi / _FREQUENCIES, np.pi, _FREQUENCIES):
        response = V_hat.response(np.exp(1j * angle))
        least = float(np.linalg.eigvalsh((response + response.conj().T) / 2.0)[0])
        if not least >= -_ROUNDING * float(np.max(np.abs(response))):
            raise Infeasible(
                f"coupling {name}: V_hat is not passive at {angle / T:.4g} rad/s: the least eigenvalue of its "
                f"Hermitian part is {least:.3g} {units('m/(N·s)')}"
            )


# The joint program, and the small program for one block

# caps, as multiples of Delta_D; the first that leaves (10) a margin is used, because storage matrices grow with the cap
GREATEST_LEVELS = (100.0, 1e4)
_T_KEPT = (0.9999, 0.995, 0.9, 0.5)  # parts of the best t that the second program tries to keep, in this order
_ENOUGH_ROOM = 1e-7  # ten times the solver's tolerance
_LEAST_STORAGE = 1e-9
_LEAST_LEVEL = 1e-6  # Delta_V > this times Delta_D: Definition 2 requires positive OSP levels, (10) does not
_MOST_ROOM = 1e-2  # cap on the room in the inequalities of Lemma 1, in scaled coordinates


@dataclass(frozen=True, eq=False)
class JointLevels:
    """The joint program's answer, in physical units.

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
        """The form of a block V_i (stable, V(1) symmetric) for the loop gain K_i; ports are scaled by S if it is given.

        Raises:
            SolverFailure: V(1) cannot be evaluated, because V has a pole at 1.
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
        """Whether the unknowns' values fulfil both inequalities strictly; a solver's "optimal" may lie just outside."""
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
    """Find the greatest multiple of Delta_D that is an OSP level of one block's V_hat; on one port, its greatest level.

    Args:
        name: of the block, for messages.
        block: V_i, discrete, stable, V(1) symmetric.
        K: loop gain, m_i x m_i, m/N.
        Delta_D: m_i x m_i, N*s/m.
        T: period, s.
        greatest: cap on the multiple. (10) asks for about need/(share - need), where the environment needs the part
            ``need`` of Delta_D, and the devices have the part ``share``.

    Raises:
        Infeasible: V_hat,i is OSP at no level.
        SolverFailure: the solver gave no usable answer, or an answer without room for a proof.
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
        raise Infeasible(f"coupling {name}: V_hat is output strictly passive at no level") from error
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
    """Find the levels with the greatest margin of (10), or slightly less if that margin leaves no room for a proof.

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
            raise Infeasible(
                f"condition (10) fails: its best margin is {best:.4g} {loop.units()('N·s/m')}; expected > 0"
            )
        parts = list(zip(forms, P_V, Delta_V, strict=True))
        found = _make_room(constraints, room, t, best, what, lambda: all(f.proved(P, D) for f, P, D in parts))
    except ProgramInfeasible as error:
        raise Infeasible("no levels satisfy Theorem 3 with this coupling") from error
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
    """Solve the second program, for the greatest part of ``best`` that leaves enough room.

    The best t lies on the edge of the feasible set, where a storage inequality is not strict. So a part of it is given
    up until the inequalities hold strictly.

    Returns:
        Whether the values left in the unknowns are strict in numbers.
    """
    for kept in _T_KEPT:
        try:
            found = solve(cp.Problem(cp.Maximize(room), [*constraints, t >= kept * best]), what)
        except (ProgramInfeasible, SolverFailure):  # so near to the edge the solver may fail; the next part is smaller
            if kept == _T_KEPT[-1]:
                raise
        else:
            if found >= _ENOUGH_ROOM and proved():
                return True
    return float(value(room)) > 0.0 and proved()


def _storage(n: int) -> Any:
    return cp.Variable((n, n), symmetric=True) if n else np.zeros((0, 0))


def _positive(P: Any, n: int) -> list[cp.Constraint]:
    return [P >> _LEAST_STORAGE * np.eye(n)] if n else []


# Certification: levels for all parties of a loop

Progress = Callable[[str], None]

MOST_SEARCHED = 250  # order of Rest above which a passive network is proved by its energy instead of a matrix
MOST_JOINT = 48  # ports and states of Rest up to which the joint program is solved; cost: their fourth power
_GIVEN_UP = 1e-9  # of a level in closed form, so that it holds in exact arithmetic: far above rounding
_ROUNDING = 1e-12  # of the least gain without a delay, which serves, but is not always a floating-point number
# values of (2 kappa - 1 - rho - 3 tau/T) T/tau to be tried; the share is greatest at 2
_GAINS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5, 2.0, 3.0)


def certify_given(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    progress: Progress | None = None,
    hint: DeviceShare | None = None,
    known: tuple[BlockLevel, ...] = (),
) -> Levels:
    """Find levels that prove the loop stable with this coupling.

    Args:
        loop: the haptic loop.
        coupling: V's blocks in the partition's order, springs and dampers or linear; ports in the block's order.
        progress: called with a line of text for each step.
        hint: the gain kappa that the coupling was made for; it is tried first.
        known: levels of the blocks at that gain which the synthesis has already proved. They are used if the search for
            greater levels fails, or finds none with which (10) holds.

    Returns:
        The levels with the greatest margin of (10) that was found. The margin is the greatest possible up to rounding
        and small reserves, except for linear blocks of several ports in large sessions and for environments proved by
        their energy.

    Raises:
        Infeasible: no levels exist; the coupling is not certified. One that is too stiff at every gain is refused at
            the gain that allows most.
        SolverFailure: a solver gave no usable answer. Of several reasons the first is raised that is no limit of
            stiffness, because a different gain has mended that.
    """
    blocks = realisations(coupling, loop.period)
    best: Levels | None = None
    greatest = 0.0
    first: Infeasible | SolverFailure | None = None
    for most in _caps(coupling):
        for device in dict.fromkeys((*((hint,) if hint is not None else ()), *devices(loop))):
            try:
                found = _levels(loop, device, _promises(loop, coupling, blocks, device, most), progress)
            except (Infeasible, SolverFailure) as error:
                first = _more_telling(first, error)
                continue
            reached = margin(loop.partition, found)
            if best is None or reached > greatest:
                best, greatest = found, reached
        if best is not None:
            return best
    if hint is not None and known:
        with suppress(Infeasible, SolverFailure):  # the first failure is more useful: it is about the greatest levels
            return _levels(loop, hint, known, progress)
    raise first or Infeasible("no levels satisfy Theorem 3 with this coupling")


def certifies(loop: HapticLoop, coupling: tuple[CouplingBlock, ...]) -> bool:
    """Whether :func:`certify_given` finds levels; the gain that allows the stiffest coupling is tried first."""
    for most in _caps(coupling):
        for device in reversed(devices(loop)):
            try:
                _levels(
                    loop, device, _promises(loop, coupling, realisations(coupling, loop.period), device, most), None
                )
            except (Infeasible, SolverFailure, ValueError, np.linalg.LinAlgError):
                continue
            return True
    return False


def _more_telling(
    first: Infeasible | SolverFailure | None, other: Infeasible | SolverFailure
) -> Infeasible | SolverFailure:
    """Of the reasons at several gains: the first that is no limit of stiffness, or else the greatest limit."""
    if first is None or not isinstance(first, TooStiff):
        return first or other
    return first if isinstance(other, TooStiff) and other.over >= first.over else other


def certify_beside(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    environment: Levels,
    hint: DeviceShare | None = None,
) -> Levels:
    """Find levels that fit a known level of the environment, which no delay inside the tick changes.

    Args:
        loop: the haptic loop.
        coupling: V's blocks, as for :func:`certify_given`.
        environment: levels whose Phi_E and storage are taken; they are proved for the same environment and period.
        hint: a gain kappa to be tried first.

    Returns:
        The levels at the first gain at which (10) holds. The greatest share is tried first: this is quick, not optimal.

    Raises:
        Infeasible: there is no such gain.
        SolverFailure: a solver gave no usable answer.
    """
    blocks = realisations(coupling, loop.period)
    first: Infeasible | SolverFailure | None = None
    for most in _caps(coupling):
        for device in dict.fromkeys((*((hint,) if hint is not None else ()), *devices(loop))):
            try:
                own = _promises(loop, coupling, blocks, device, most)
            except (Infeasible, SolverFailure) as error:
                first = first or error
                continue
            Delta_V, P_V = tuple(level.Delta for level in own), tuple(level.P for level in own)
            found = Levels(device, loop.Delta_D_blocks, Delta_V, environment.Phi_E, environment.P_E, P_V)
            if margin(loop.partition, found) > 0.0:
                return found
    raise first or Infeasible("condition (10) fails beside the environment's level")


def _caps(coupling: tuple[CouplingBlock, ...]) -> tuple[float, ...]:
    """The caps on the blocks' levels, to be tried in turn; one is enough where closed forms, which ignore it, serve."""
    closed = all(isinstance(part, SpringDamper) for part in coupling)
    return GREATEST_LEVELS[:1] if closed else GREATEST_LEVELS


def devices(loop: HapticLoop) -> tuple[DeviceShare, ...]:
    """The gains kappa to be tried, the greatest share first: one gain without delay, up to ten with a delay."""
    if loop.punctual:
        return (DeviceShare(),)
    out = []
    tau_hat, rho = loop.tau / loop.period, loop.period_tolerance
    least = least_gain(tau_hat, rho)
    for kappa in [least + gain * tau_hat / 2.0 for gain in _GAINS] if tau_hat else [least * (1.0 + _ROUNDING)]:
        try:
            found = device_share(kappa, tau_hat, period_tolerance=rho)
        except ValueError:  # so near to the least gain that no share is left in floating point
            continue
        out.append(DeviceShare(kappa, found.share, found.c))
    return tuple(sorted(out, key=lambda device: -device.share))


def _levels(loop: HapticLoop, device: DeviceShare, own: tuple[BlockLevel, ...], progress: Progress | None) -> Levels:
    """The levels for one gain kappa, with the levels ``own`` that the blocks promise there."""
    Delta_V = tuple(level.Delta for level in own)
    Phi_E, P_E = _environment(loop, device, Delta_V, progress)
    return Levels(device, loop.Delta_D_blocks, Delta_V, Phi_E, P_E, tuple(level.P for level in own))


def _promises(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    blocks: tuple[StateSpace, ...],
    device: DeviceShare,
    most: float,
) -> tuple[BlockLevel, ...]:
    """The level of each block for one gain kappa; the levels of linear blocks are capped at ``most``."""
    gains = loop.loop_gain(device.kappa)
    own_units = [loop.units(*(loop.ports[p] for p in block)) for block in loop.partition.blocks]
    parts = [*zip(loop.partition.names, coupling, gains, loop.Delta_D_blocks, own_units, strict=True)]
    for name, part, K, Delta_D, units in parts:
        if isinstance(part, SpringDamper):
            check_spring_damper(name, part, Delta_D / (2.0 * device.kappa), loop.period, device.kappa, units)
        else:
            check_block(name, part, K, loop.period, device.kappa, units)
    # Each block gets its greatest level. Where levels are not comparable, the joint program chooses them together.
    own: list[BlockLevel] = []
    for name, part, K, Delta_D, units in parts:
        if isinstance(part, SpringDamper):
            own.append(BlockLevel(_closed_form(name, part, Delta_D, loop.period, device.kappa, units), None))
        elif part.inputs == 1 or not _small(loop) or loop.environment.declared_level is not None:
            own.append(block_level(name, part, K, Delta_D, loop.period, most))
    if len(own) == len(blocks):
        return tuple(own)
    joint = joint_levels(loop, blocks, loop.split, device, most)
    return tuple(BlockLevel(Delta, P) for Delta, P in zip(joint.Delta_V, joint.P_V, strict=True))


def _small(loop: HapticLoop) -> bool:
    return len(loop.ports) <= MOST_JOINT and loop.environment.order + len(loop.ports) <= MOST_JOINT


def _closed_form(name: str, coupling: SpringDamper, Delta_D: Matrix, T: float, kappa: float, units: Units) -> Matrix:
    """Delta_V slightly below the greatest level of a block."""
    Lambda = Delta_D / (2.0 * kappa)
    greatest = greatest_level(coupling, Lambda, T)
    level = symmetric_part((1.0 - _GIVEN_UP) * greatest - _GIVEN_UP * Lambda)
    least = float(np.linalg.eigvalsh(level)[0])
    if least <= 0.0:
        raise _near(name, coupling, Lambda, T, kappa, units) or Infeasible(
            f"coupling {name}: the greatest level of V_hat has the eigenvalue {least:.4g} {units('N·s/m')}; "
            "expected > 0"
        )
    return level


def _environment(
    loop: HapticLoop, device: DeviceShare, Delta_V: tuple[Matrix, ...], progress: Progress | None
) -> tuple[Matrix, Storage]:
    """Phi_E, m x m, and its storage matrix; or the word for what proves or enforces it instead."""
    environment, T, partition = loop.environment, loop.period, loop.partition
    promised = environment.promised()
    if promised is not None:
        return _declared(loop, promised, device, Delta_V), ENFORCED
    Delta_G = tuple(device.share * Delta for Delta in loop.Delta_D_blocks)
    network = environment.passive_network
    if network is not None and (environment.only_energy or environment.order > MOST_SEARCHED):
        return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY
    try:
        split = loop.split
        if network is not None and split.rest.order < environment.order:
            # no storage matrix of drifting masses is definite
            return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY
        levels = partition.embed(Delta_G), partition.embed(Delta_V), partition
        # a network has its energy where its states show no room
        found, P_E = level_and_storage(split, T, *levels, progress, changed=network is None)
        return found.Phi_E, P_E
    except (Infeasible, SolverFailure, np.linalg.LinAlgError):
        if network is None:
            raise
        return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY


def _declared(loop: HapticLoop, Phi_E: Matrix, device: DeviceShare, Delta_V: tuple[Matrix, ...]) -> Matrix:
    """The declared level Phi_E, m x m, if (10) holds with it.

    Raises:
        Infeasible: (10) fails with it.
    """
    left = margin(loop.partition, Levels(device, loop.Delta_D_blocks, Delta_V, Phi_E, ENFORCED, ()))
    if left <= 0.0:
        raise Infeasible(
            "condition (10) fails with the environment's declared level: "
            f"its least eigenvalue is {left:.4g} {loop.units()('N·s/m')}; expected > 0"
        )
    return Phi_E
