"""Theorem 4 of [Bianchini2010]_: a stabilising coupling of given structure, by cone complementarity linearisation.

The program searches V with the wanted structure, the levels Delta_V and Phi_E, and the storage functions, all at once.
The conditions (13)-(16) are linear matrix inequalities in

    P, Phi_E, Delta_V, Sigma, Q, Y, A_V, B_V, C_V, D_V.

Only Sigma = Delta_V^{-1} and Y = Q^{-1} (17) are not linear. Q, Y, Sigma and Delta_V have the structure of V, one small
cone for each block.

Ports are scaled by S = Delta_D^{-1/2}, so that Delta_D = I and K = kappa T I. With B_V/T and D_V/T as unknowns, all
entries of (12) are of order one and T drops out. (14) is stated for E_hat without its integrators
(:mod:`manyhands.design.models.integrators`), because with them it has no interior.

**Classes.** In the spring-damper class (20)-(22), B_V = T A_V and D_V = T C_V. In the linear class, block V_i has n_i
states and m_i ports, and all of

    A_V,i (n_i x n_i),   B_V,i (n_i x m_i),   C_V,i (m_i x n_i),   D_V,i (m_i x m_i)

is free: the transformed coupling (12) is linear in them, so (15), (16) are linear matrix inequalities as they
stand. A block of order 0 is a static compliance.

The program finds *a* coupling of the set. Without a further aim this is mostly a spring without dynamics (A_V, B_V,
C_V near zero), in the middle of a large set. Higher orders pay only if something is asked beyond stability.

**Cone complementarity linearisation** [ElGhaoui1997]_, steps 1 to 4 of section 4.1 in [Bianchini2010]_, treats (17).
The program is linear in its unknowns except that pairs of symmetric unknowns must be inverses of each other,

    W_i Z_i = I,    W_i, Z_i of the same size, in units that make them of order one.

Each pair is relaxed to the cone [W_i I; I Z_i] >= 0 (18). The relaxed program is solved once for a feasible point; then

    minimise sum_i trace(W_i^j Z_i + Z_i^j W_i)    around the last iterate W^j, Z^j

is repeated. On the cone, trace(W Z) has its least value, the size of W, exactly where W Z = I. The objective never
grows, but nothing guarantees that it reaches this value. So the iterations have a cap, and the best iterate is
reported and returned with the error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from manyhands.design import convex as cp
from manyhands.design.errors import DesignError, Infeasible, NotConverged, SolverFailure, TooLarge
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import StateSpace, symmetric_part
from manyhands.design.problem import HapticLoop
from manyhands.design.solver import (
    ProgramInfeasible,
    balancing,
    change_states,
    positive,
    scale_ports,
    solve,
    storage_inequality_expression,
    symmetric,
    value,
)

# Cone complementarity linearisation

TOLERANCE = 1e-4  # on ||W Z - I||, spectral norm
MOST_ITERATIONS = 200

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Convergence:
    """How the iteration went.

    Attributes:
        residuals: ||W Z - I|| after each program, starting with step 2; empty before step 2 is done.
    """

    residuals: tuple[float, ...]

    @property
    def iterations(self) -> int:
        """Number of linearised programs solved after the first feasible point."""
        return max(len(self.residuals) - 1, 0)


class Interrupted(DesignError):
    """The user ended the iteration with Ctrl-C.

    Attributes:
        best: the coupling of the best iterate so far, or None; nothing is proved about it.
        convergence: the residuals until then.
    """

    def __init__(self, message: str, best: Any, convergence: Convergence) -> None:
        self.best = best
        self.convergence = convergence
        super().__init__(message)


class StoppedShort(NotConverged):
    """The iteration ended before W Z = I.

    Attributes:
        best: the coupling of the best iterate, or None; :func:`manyhands.design.theorem3.certify_given` may still
            prove it.
        convergence: the residuals until then.
    """

    def __init__(self, message: str, best: Any, convergence: Convergence) -> None:
        self.best = best
        self.convergence = convergence
        super().__init__(message)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two symmetric unknowns, r x r each, that are to become inverses of each other (17).

    Attributes:
        W: one of them, e.g. Sigma or Q.
        Z: its inverse at the end, e.g. Delta_V or Y.
    """

    W: cp.Variable
    Z: cp.Variable

    def cone(self) -> cp.Constraint:
        """[W I; I Z] >= 0 (18): W > 0 and Z >= W^{-1}."""
        I = np.eye(self.W.shape[0])
        return cp.bmat([[self.W, I], [I, self.Z]]) >> 0

    def residual(self) -> float:
        """||W Z - I||, spectral norm, at the unknowns' present values."""
        return float(np.linalg.norm(value(self.W) @ value(self.Z) - np.eye(self.W.shape[0]), 2))


@dataclass(frozen=True, eq=False)
class Relaxed(Generic[Found]):
    """A program whose pairs are relaxed to their cones, and the rule that reads a coupling from its solution.

    Attributes:
        constraints: all constraints except (18).
        pairs: the pairs of (17).
        recover: returns the coupling at the unknowns' present values; None if they give none (a singular C_V, say).
        what: name of the program for messages, e.g. "Theorem 4".
    """

    constraints: Sequence[cp.Constraint]
    pairs: Sequence[Pair]
    recover: Callable[[], Found | None]
    what: str


def complement(
    relaxed: Relaxed[Found], *, iterations: int = MOST_ITERATIONS, progress: Callable[[str], None] | None = None
) -> tuple[Found, Convergence]:
    """Iterate until ||W Z - I|| < :data:`TOLERANCE` for every pair.

    Args:
        relaxed: the program.
        iterations: cap on the linearised programs solved after the first feasible point, >= 0.
        progress: called after each program, with a line such as ``iteration 3, |WZ - I| = 1.2e-03``.

    Returns:
        What ``recover`` returns for the last iterate, and the convergence. It satisfies the program only up to the
        tolerance: the caller has to prove it by other means.

    Raises:
        ProgramInfeasible: the relaxed program has no solution, hence the program has none (step 2).
        StoppedShort: the cap was reached, or a solver failed on the way; ``best`` is what ``recover`` returned for the
            iterate with the least residual, or None.
        Interrupted: KeyboardInterrupt arrived; ``best`` likewise.
        SolverFailure: the solver gave no usable first point.
        ValueError: a negative cap.
    """
    if iterations < 0:
        raise ValueError(f"found a cap of {iterations} iterations; expected one >= 0")
    path: _Path[Found] = _Path(relaxed, progress)
    try:
        return path.follow(iterations)
    except KeyboardInterrupt as error:
        message = f"{relaxed.what}: interrupted {path.reached()}"
        raise Interrupted(message, path.best, path.convergence()) from error


class _Path(Generic[Found]):
    """The iterates so far: their residuals, and the coupling of the best one."""

    def __init__(self, relaxed: Relaxed[Found], progress: Callable[[str], None] | None) -> None:
        self.relaxed = relaxed
        self.progress = progress
        self.residuals: list[float] = []
        self.least = np.inf
        self.best: Found | None = None

    def follow(self, iterations: int) -> tuple[Found, Convergence]:
        """Step 2, then step 3 until step 4 accepts the iterate.

        The problem is compiled once: W_j and Z_j are parameters, which every iteration sets to the last iterate.
        """
        pairs, what = self.relaxed.pairs, self.relaxed.what
        constraints = [*self.relaxed.constraints, *(pair.cone() for pair in pairs)]
        solve(cp.Problem(cp.Minimize(0), constraints), f"{what}, first feasible point")
        found = self.arrive()
        around = [(_parameter(pair.W), _parameter(pair.Z)) for pair in pairs]
        objective = sum(
            cp.trace(W_j @ pair.Z) + cp.trace(Z_j @ pair.W) for pair, (W_j, Z_j) in zip(pairs, around, strict=True)
        )
        linearised = cp.Problem(cp.Minimize(objective), constraints)
        while not self.residuals[-1] < TOLERANCE:
            iteration = len(self.residuals)
            if iteration > iterations:
                raise self.short(f"stopped after {iterations} iterations at ||W Z - I|| = {self.residuals[-1]:.2e}")
            for pair, (W_j, Z_j) in zip(pairs, around, strict=True):
                W_j.value, Z_j.value = symmetric_part(value(pair.W)), symmetric_part(value(pair.Z))
            try:
                solve(linearised, f"{what}, iteration {iteration}")
            except (ProgramInfeasible, SolverFailure) as error:  # the last iterate is feasible, so the solver is wrong
                raise self.short(f"the solver found no solution in iteration {iteration}, {self.reached()}") from error
            found = self.arrive()
        if found is None:
            raise self.short(f"the last iterate gives no coupling, {self.reached()}")
        return found, self.convergence()

    def short(self, why: str) -> StoppedShort:
        """The error for an iteration that ends here, with the reason ``why``."""
        message = f"{self.relaxed.what}: {why}, wanted < {TOLERANCE:.0e}"
        return StoppedShort(message, self.best, self.convergence())

    def convergence(self) -> Convergence:
        """The residuals so far."""
        return Convergence(tuple(self.residuals))

    def arrive(self) -> Found | None:
        """Record the iterate that a solver has just left in the unknowns, and return its coupling."""
        residual = max((pair.residual() for pair in self.relaxed.pairs), default=0.0)
        found = self.relaxed.recover()
        if found is not None and residual < self.least:
            self.least, self.best = residual, found
        self.residuals.append(residual)
        if self.progress is not None:
            self.progress(f"iteration {len(self.residuals) - 1}, |WZ - I| = {residual:.1e}")
        return found

    def reached(self) -> str:
        """The iteration and its residual, for messages."""
        if not self.residuals:
            return "before the first feasible point"
        return f"after {len(self.residuals) - 1} iterations at ||W Z - I|| = {self.residuals[-1]:.2e}"


def _parameter(variable: Any) -> cp.Parameter:
    return cp.Parameter(variable.shape, symmetric=True)


# The program, and the spring-damper class

_STRICT = 1e-6  # the solver reads "> 0" as ">= this", in scaled coordinates of order one
_STRICT_E = 1e-9  # the same for (14): a mode of frequency omega without a damper dissipates (omega T)^2 at most


@dataclass(frozen=True, eq=False)
class BlockUnknowns:
    """The unknowns of one block of V, of n states and m ports, in scaled ports.

    Attributes:
        A: A_V, n x n.
        B: B_V/T, n x m.
        C: C_V, m x n.
        D: D_V/T, m x m.
        levels: Sigma and Delta_V of the block, m x m.
        storage: Q and Y, (n+m) x (n+m), in the coordinates (xi, u of the tick before) of (12).
    """

    A: Any
    B: Any
    C: Any
    D: Any
    levels: Pair
    storage: Pair

    @classmethod
    def of(cls, A: Any, B: Any, C: Any, D: Any, n: int) -> BlockUnknowns:
        """Unknowns for the realisation (A, B, C, D) of expressions; without states, A, B and C are None."""
        m = D.shape[0]
        return cls(A, B, C, D, Pair(_symmetric(m), _symmetric(m)), Pair(_symmetric(n + m), _symmetric(n + m)))

    @classmethod
    def spring_damper(cls, m: int) -> BlockUnknowns:
        """Unknowns of the class (20): B_V = T A_V, D_V = T C_V (21), C_V symmetric."""
        A, C = cp.Variable((m, m)), _symmetric(m)
        return cls.of(A, A, C, C, m)

    @property
    def pairs(self) -> tuple[Pair, Pair]:
        """The diagonal blocks of W and Z (19)."""
        return self.levels, self.storage

    def constraints(self, kappa: float, room: float = 0.0) -> list[cp.Constraint]:
        """(15), (16) for this block, with K = kappa T.

        A constant force u is neutral for every V: the coupling is deflected by V(1) u, and V_hat stands still with zero
        output. In (15) this force is the vector (0, u; u; *, *; 0), so the matrix there cannot be definite. ``room``
        asks for

            [Y R^T; R S] >= room * N,    N = the squares of xi, of u - u-, and of Delta_V y.

        All neutral vectors fulfil this with equality, so it is strictness on a complement of them.
        """
        I, O = np.eye(self.D.shape[0]), np.zeros(self.D.shape)
        D = self.D - kappa * I
        if self.A is None:
            A, B, C, n = O, I, -D, 0
        else:
            n = self.A.shape[0]
            A = cp.bmat([[self.A, -self.B], [np.zeros((len(I), n)), O]])
            B = cp.bmat([[self.B], [I]])
            C = cp.bmat([[self.C, -D]])
        (Sigma, Delta), (Q, Y) = ((pair.W, pair.Z) for pair in self.pairs)
        between = np.zeros((n + len(I), len(I)))
        M = cp.bmat(
            [
                [Y, C.T / 2, A.T, C.T],
                [C / 2, symmetric(D), B.T, D.T],
                [A, B, Q, between],
                [C, D, between.T, Sigma],
            ]
        )
        N = np.zeros(M.shape)
        N[:n, :n] = np.eye(n)
        forces = slice(n, n + 2 * len(I))  # u of the tick before, u
        N[forces, forces] = np.block([[I, -I], [-I, I]]) / 2.0
        N[-len(I) :, -len(I) :] = I
        return [
            symmetric(M) - room * N >> 0,
            Delta >> _STRICT * I,
            Q >> _STRICT * np.eye(n + len(I)),
        ]


def solve_theorem_4(
    loop: HapticLoop,
    blocks: Sequence[BlockUnknowns],
    recover: Callable[[], Found | None],
    *,
    kappa: float,
    share: float,
    room: float,
    iterations: int,
    progress: Callable[[str], None] | None,
) -> tuple[Found, Convergence]:
    """Solve (13)-(17) for the given unknowns of each block.

    Args:
        loop: the haptic loop; its E_hat, structure and Delta_D are used.
        blocks: unknowns, in the partition's order.
        recover: returns the coupling at their present values, or None.
        kappa: K = kappa T Delta_D^{-1}, dimensionless.
        share: G_hat is (share Delta_D)-OSP, dimensionless, > 0.
        room: see :meth:`BlockUnknowns.constraints`.
        iterations: cap, see :func:`manyhands.design.theorem4.complement`.
        progress: as for :func:`complement`.

    Raises:
        Infeasible: step 2 has no solution.
        StoppedShort, Interrupted, SolverFailure: as for :func:`complement`.
        ValueError: kappa or share is not positive.
    """
    if not (0.0 < kappa < np.inf and 0.0 < share < np.inf):
        raise ValueError(f"found kappa = {kappa}, share = {share}; expected finite ones > 0")
    m = len(loop.ports)
    Phi, constraints = _environment(loop)
    Delta = sum(
        (select @ block.levels.Z @ select.T for select, block in zip(loop.partition.selections(), blocks, strict=True)),
        start=cp.Constant(np.zeros((m, m))),
    )
    condition_10 = cp.bmat([[share * np.eye(m) - Phi, -Phi], [-Phi, Delta - Phi]])
    constraints.append(symmetric(condition_10) >> _STRICT * np.eye(2 * m))
    for block in blocks:
        constraints += block.constraints(kappa, room)
    pairs = [pair for block in blocks for pair in block.pairs]
    try:
        return complement(Relaxed(constraints, pairs, recover, "Theorem 4"), iterations=iterations, progress=progress)
    except ProgramInfeasible as error:
        raise Infeasible(
            "no coupling of this structure satisfies Theorem 4: E_hat + Delta_D is not passive"
            + (f", with {share:.3g} of Delta_D left by the delay" if share != 1.0 else "")
        ) from error


def design_spring_damper(
    loop: HapticLoop,
    progress: Callable[[str], None] | None = None,
    *,
    kappa: float = 0.5,
    share: float = 1.0,
    iterations: int = MOST_ITERATIONS,
) -> tuple[SpringDamper, Convergence]:
    """Find a stabilising spring-damper coupling with the loop's block structure.

    Args:
        loop: the haptic loop.
        progress: called with a line of text after each iteration.
        kappa: factor of the loop gain K = kappa T Delta_D^{-1}; 1/2 without delay.
        share: G_hat is (share Delta_D)-OSP; 1 without delay.
        iterations: cap on the iterations.

    Returns:
        The coupling (symmetric parts of K and B, exactly zero outside the blocks) and the convergence. The caller lets
        :func:`manyhands.design.theorem3.certify_given` find the levels for a proof that it stabilises the loop.

    Raises:
        Infeasible: step 2 has no solution.
        StoppedShort: the cap on iterations was reached; ``best`` is the best iterate's coupling, or None.
        Interrupted: KeyboardInterrupt arrived; ``best`` likewise.
        SolverFailure: the solver gave no usable answer.
        ValueError: kappa or share is not positive, or the cap is negative.
    """
    blocks = [BlockUnknowns.spring_damper(len(ports)) for ports in loop.partition.blocks]
    return solve_theorem_4(
        loop,
        blocks,
        lambda: _spring_damper(loop, blocks),
        kappa=kappa,
        share=share,
        room=0.0,
        iterations=iterations,
        progress=progress,
    )


def _environment(loop: HapticLoop) -> tuple[cp.Expression, list[cp.Constraint]]:
    """Phi_E in scaled ports, and (14) for it, stated for E_hat without its integrators.

    For a declared environment Phi_E is its declared level, without any constraint.
    """
    m, S, T = len(loop.ports), loop.scaling, loop.period
    promised = loop.environment.promised()
    if promised is not None:
        return cp.Constant(S @ promised @ S), []
    split = loop.split
    rest = scale_ports(split.rest, S, S)
    rest = change_states(rest, balancing(rest))
    P, Phi = _symmetric(rest.order) if rest.order else cp.Constant(np.zeros((0, 0))), _symmetric(m)
    M = storage_inequality_expression(rest, P, Phi=T / 2.0 * S @ split.stiffness @ S - Phi)
    return Phi, [*positive(P, _STRICT), symmetric(M) << -_STRICT_E * np.eye(M.shape[0])]


def _spring_damper(loop: HapticLoop, blocks: Sequence[BlockUnknowns]) -> SpringDamper | None:
    """K and B by (22), block by block, in physical ports again; None if a C_V is singular."""
    parts = []
    for block, S_i in zip(blocks, loop.partition.restrict(loop.scaling), strict=True):
        try:
            scaled = SpringDamper.from_realisation(value(block.A), value(block.C), loop.period)
        except np.linalg.LinAlgError:
            return None
        parts.append(scaled.scaled(symmetric_part(np.linalg.inv(S_i))))
    return SpringDamper(
        loop.partition.embed([p.stiffness for p in parts]), loop.partition.embed([p.damping for p in parts])
    )


def _symmetric(m: int) -> cp.Variable:
    return cp.Variable((m, m), symmetric=True)


# The linear class

MOST_STATES = 24  # n_i + m_i of one block: (15) has 2 n_i + 4 m_i rows, and its program grows with their sixth power
ROOM = 1e-3  # of (15), in scaled ports: W Z = I holds only up to 1e-4, and what it leaves is enough for a proof
_ROUNDING = 1e-8  # of V/T in scaled ports, which is of order one: far below what W Z = I up to 1e-4 means


@dataclass(frozen=True, eq=False)
class LinearCoupling:
    """A linear coupling as Theorem 4 finds it, with static compliances made symmetric.

    V_hat,i can only be output strictly passive if V_i(1) is symmetric. (15) implies this in the limit, where W Z = I
    exactly. Before the limit a skew part remains and is removed: V_i(1) is stated, and D_V,i follows from it.

    Attributes:
        blocks: V_i in the partition's order, of the wanted orders, stable, from force (N) to displacement (m).
        skew: the largest removed part, ||V_i(1) - V_i(1)^T|| / (2 ||V_i(1)||), in spectral norms.
    """

    blocks: tuple[StateSpace, ...]
    skew: float


def design_linear(
    loop: HapticLoop,
    orders: Sequence[int],
    progress: Callable[[str], None] | None = None,
    *,
    kappa: float = 0.5,
    share: float = 1.0,
    iterations: int = MOST_ITERATIONS,
) -> tuple[LinearCoupling, Convergence]:
    """Find a stabilising linear coupling with the loop's block structure.

    ``orders`` has n_i >= 0 for each block, in the partition's order. All other arguments, the returned pair and the
    errors are those of :func:`design_spring_damper`; two errors are added.

    Raises:
        TooLarge: a block has more than :data:`MOST_STATES` states and ports.
        ValueError: ``orders`` is not one number >= 0 for each block.
    """
    partition = loop.partition
    if len(orders) != len(partition.blocks) or min(orders) < 0:
        raise ValueError(
            f"found orders {list(orders)}; expected one >= 0 for each of the {len(partition.blocks)} blocks of V"
        )
    for name, n, ports in zip(partition.names, orders, partition.blocks, strict=True):
        if n + len(ports) > MOST_STATES:
            raise TooLarge(
                f"coupling {name}: found {n} states and {len(ports)} ports; expected at most {MOST_STATES} together; "
                "lower its order, or divide it"
            )
    blocks = [linear_unknowns(n, len(ports)) for n, ports in zip(orders, partition.blocks, strict=True)]
    return solve_theorem_4(
        loop,
        blocks,
        lambda: recover_linear(loop, blocks),
        kappa=kappa,
        share=share,
        room=ROOM,
        iterations=iterations,
        progress=progress,
    )


def recover_linear(loop: HapticLoop, blocks: Sequence[BlockUnknowns]) -> LinearCoupling | None:
    """The coupling at the unknowns' present values, in physical ports; None if a block is not stable.

    With scaled forces S^{-1} f, and with B_V/T and D_V/T as unknowns, V = S V_scaled S. Dynamics that are only rounding
    become zeros. Their states stay, because the session asks for that order.
    """
    found, skew, T = [], 0.0, loop.period
    for block, S_i in zip(blocks, loop.partition.restrict(loop.scaling), strict=True):
        D = value(block.D)
        scaled = StateSpace.static(D)
        if block.A is not None:
            scaled = StateSpace(value(block.A), value(block.B), value(block.C), D)
            if np.max(np.abs(np.linalg.eigvals(scaled.A))) >= 1.0:
                return None
            scaled = _without_rounding(scaled)
        V = StateSpace(scaled.A, T * scaled.B @ S_i, S_i @ scaled.C, T * S_i @ scaled.D @ S_i)
        compliance = V.response(1.0).real
        left = (compliance - compliance.T) / 2.0
        skew = max(skew, float(np.linalg.norm(left, 2)) / max(float(np.linalg.norm(compliance, 2)), 1e-300))
        found.append(StateSpace.with_static_gain(V.A, V.B, V.C, symmetric_part(compliance)))
    return LinearCoupling(tuple(found), skew)


def _without_rounding(system: StateSpace) -> StateSpace:
    """The system, with A, B, C zero if ||C (zI - A)^{-1} B|| <= ||C|| ||B|| / (1 - ||A||) is as small as rounding."""
    A, B, C = (float(np.linalg.norm(M, 2)) for M in (system.A, system.B, system.C))
    if B * C >= _ROUNDING * (1.0 - A):
        return system
    return StateSpace(np.zeros_like(system.A), np.zeros_like(system.B), np.zeros_like(system.C), system.D)


def linear_unknowns(n: int, m: int) -> BlockUnknowns:
    """The unknowns of a linear block of order n >= 0 with m ports: all entries of its matrices."""
    D = cp.Variable((m, m))
    if n == 0:
        return BlockUnknowns.of(None, None, None, D, 0)
    return BlockUnknowns.of(cp.Variable((n, n)), cp.Variable((n, m)), cp.Variable((m, n)), D, n)
