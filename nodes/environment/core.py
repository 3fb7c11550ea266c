"""The environment's tick without its I/O: it closes the algebraic loop and never sees x.

From the free tool positions p(k) of all ports and the couplings' feedthrough D_V,

    f_e(k) = -(I + D_E D_V)^{-1} (C_E eta(k) + D_E p(k)),
    x_e(k) = p(k) + D_V f_e(k),     eta(k+1) = A_E eta(k) + B_E x_e(k).

All three are linear in (eta, p), so products with a matrix made beforehand give them: the forces first, and the rest
when the forces are on their way.

**Clutches** (:mod:`manyhands.nodes.environment.clutch`) stand between the blocks and the environment, with one ratio
in S for each block. With r = x_e(k-1) + S (p(k) - x_c(k-1)) the loop is x_e = r + S D_V S f_e, and the couplings
receive f_c = S f_e. Since S D_V S = S^2 D_V differs from D_V only at the ports J of blocks that are not settled,

    (I + F_JJ W) f_J = f_J(eta, r),    W = (I - S^2) D_V at J,    F = -(I + D_E D_V)^{-1} D_E,

and the matrix made beforehand gives everything else at r - W f_J in place of p. So a block that is not settled costs
a linear system of its own size in each tick; a block that works an offset off may do so for the rest of a session.
As s is one number for each block, F_JJ W is F_JJ D_V with the columns of each block times its 1 - s^2. I + F_JJ W is
regular exactly when I + D_E S D_V S is, which a certificate implies for every S (docs/decisions/0015-the-clutch.md).
Without a certificate it may be singular: the core then freezes blocks until it is regular, and with all blocks frozen
it is the identity.

The environment promises that E_hat is (-Phi_E)-ISP: from the tool velocity w to -f_e, the sum of
T (w^T (-f_e) + w^T Phi_E w) is never below zero.

:func:`environment_core` makes the core that a bundle asks for: E as it is proved, in an :class:`EnvironmentCore`, or
a model, a scene or E under a controller (:mod:`manyhands.nodes.environment.enforced`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import mul
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.environment.chatter import Chatter
from manyhands.nodes.environment.clutch import (
    SINGULAR,
    Blocks,
    Clutch,
    Clutches,
    ClutchEvent,
    held_force,
    holdable,
    ports_of,
    ports_of_blocks,
    require_within,
)
from manyhands.nodes.environment.energy import BOUND_TICKS, Energy
from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore, ForceLaw, LinearLaw
from manyhands.nodes.environment.model import PROXY, REACT, AskedModel, EnvironmentModel, make_model
from manyhands.nodes.environment.oriented_tools import OrientedTools
from manyhands.nodes.environment.proxy import ProxyLaw
from manyhands.nodes.environment.scene import SceneLaw
from manyhands.nodes.kernel.arithmetic import FEW, Floats, LinearMap, Rows, dot, linear_map, minus, solve
from manyhands.nodes.kernel.bundle import EnvironmentBundle
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.passivity import Ledger, PassivityController
from manyhands.nodes.kernel.timeouts import RAMP
from manyhands.nodes.rows.two_port import Row

Vector = NDArray[np.float64]


class EnvironmentCore:
    """The state of the environment between ticks.

    Attributes:
        failure: always None, for matrices cannot fail; see :class:`manyhands.nodes.environment.enforced.EnforcedCore`.
        controller: always None, for the promise is proved and needs no controller.
        held: always empty, for matrices have no proxies.
        figures: always empty, for nothing else is counted.
        chatter: always None, for matrices are solved within the tick.
        oriented: always None, for nothing is turned in space.
        ledger: its energy ledger; None when the session is not certified.
        energy: the energy that each coupling puts into the others, and their budgets.
        clutches: the clutches of the blocks.
        ill_posed: ticks in which blocks were frozen because the loop had no unique solution; 0 under a certificate.
    """

    failure: str | None = None
    controller: PassivityController | None = None
    held: Sequence[int] = ()
    figures: Mapping[str, float] = MappingProxyType({})
    chatter: Chatter | None = None
    oriented: OrientedTools | None = None

    def __init__(
        self,
        E: StateSpace,
        D_V: Vector,
        Phi_E: Vector | None,
        T: float,
        blocks: Blocks | None = None,
        ramp: int = RAMP,
        masses: int = 0,
        budgets: Sequence[EnergyBudget] | None = None,
        storage: Vector | None = None,
    ) -> None:
        """Start at rest, all tools at 0, all blocks coupled.

        Args:
            E: (A_E, B_E, C_E, D_E), tool displacement (m) to force (N), m ports.
            D_V: the couplings' feedthrough, m x m, m/N, from the handshakes.
            Phi_E: the environment's level, m x m, N*s/m, or None.
            T: period, s.
            blocks: the ports of each coupling, in its own order; None for one block of all ports.
            ramp: ticks from frozen to coupled.
            masses: the number of entries of the state, after the m tools, that are positions of masses.
            budgets: the energy that each coupling may put into the others; None for no bound.
            storage: the environment stores 1/2 eta^T storage eta, J; None where that is not known.

        Raises:
            ValueError: the algebraic loop has no unique solution, the blocks do not hold every port once, or D_V joins
                ports of two blocks.
        """
        n, m = E.order, E.inputs
        parts = ports_of_blocks(blocks, m)
        require_within(D_V, parts)
        self._E, self._T, self._m, self._n = E, T, m, n
        self._positions = slice(m, m + masses)
        self._Phi = None if Phi_E is None else linear_map(Phi_E)
        self._D_V = np.array(D_V, dtype=np.float64)
        self._step = _closed(E, self._D_V)
        self._force, self._rest = linear_map(self._step[:m]), linear_map(self._step[m:])
        self._rest_of_tick = self._rest  # the map that fits the feedthrough of the tick's forces
        self._eta: Floats = [0.0] * n
        self._known: Floats = [0.0] * (n + m)  # (eta, p); where clutches are not settled r - W f_J in place of p
        self._x_e: Floats = [0.0] * m  # that of the tick before, until settle
        self._f: Floats = [0.0] * m  # f_e, that of the tick before until react
        self._concluded: list[tuple[int, float]] = []  # port and exact x_e, from the clutches that are not settled
        self.ledger = None if Phi_E is None else Ledger()
        self.ill_posed = 0
        self.energy = Energy(parts, budgets, T, storage is not None)
        self.clutches = Clutches(parts, ramp, self.energy)
        self._storage, self._bound_in = storage, BOUND_TICKS
        self._begins = budgets is not None
        self._unsettled = self.clutches.unsettled
        self._group: list[Clutch] = []  # the clutches that the rest belongs to
        self._J: list[int] = []  # their ports
        self._slacks: Floats = []  # 1 - s^2 of this tick, by port of J
        self._f_J: LinearMap = list  # from (eta, r)
        self._deflections: list[LinearMap] = []  # D_V f, by clutch of the group
        self._deflection: LinearMap = list  # the same for all of J
        self._F_D = np.zeros((0, 0))  # F_JJ D_V at J

    def press(self, pressed: int) -> None:
        """Do nothing: no button acts on matrices."""

    def react(self, p: Floats) -> Floats:
        """f_c(k) = S f_e(k), N, for the couplings, from the free tool positions p(k), m; ignores p of frozen blocks."""
        self._rest_of_tick = self._rest
        if self._begins:
            self._begins = False
            self._begin(p)
        if self._unsettled:
            return self._through_clutches(p)
        self._known = known = self._eta + p
        self._f = f = self._force(known)
        return f

    def settle(self) -> None:
        """Step to the next tick and keep the ledger; all this can wait until the forces are on their way."""
        m, T = self._m, self._T
        rest = self._rest_of_tick(self._known)
        x_e, self._eta = rest[:m], rest[m:]
        for port, at in self._concluded:
            x_e[port] = at
        self._concluded = []
        if self.ledger is not None and self._Phi is not None:
            w = [step / T for step in minus(x_e, self._x_e)]
            self.ledger.enter(T * (dot(w, self._Phi(w)) - dot(w, self._f)))
        self.energy.enter(self._f, x_e, self._x_e)
        self._x_e = x_e
        self._bound_in -= 1
        if self._bound_in == 0:
            self._bound_in = BOUND_TICKS
            self._bound()
        if self.energy.restrained:
            self.clutches.restrain()

    def load(self, block: int) -> float:
        """The greatest force at the block's tools in the last tick, N."""
        return max(map(abs, ports_of(self._f, self.clutches.all[block])))

    def holdable(self, block: int) -> bool:
        """Whether a force can hold the end of the block's coupling: whether its D_V is regular."""
        return holdable(self.clutches.all[block], self._D_V)

    def holding_force(self, block: int, p: Floats) -> Floats:
        """f_c(k), N, of a block that is held in this tick, from its p(k), m (:func:`held_force`)."""
        return held_force(self.clutches.all[block], self._x_e, self._D_V, p)

    @property
    def tools(self) -> Floats:
        """x_e of the tick that was settled last, m."""
        return self._x_e

    @property
    def masses(self) -> Floats:
        """The positions of the masses in that tick, m; empty where the environment is no network."""
        return self._eta[self._positions]

    @property
    def orientations(self) -> Floats:
        """Empty: nothing is turned in space."""
        return []

    def exchange(self, block: int, D_V: Vector) -> None:
        """Change the feedthrough of a frozen block: the whole matrix is made anew, which may take longer than a tick.

        Between :meth:`react` and :meth:`settle` the change takes effect in the next tick.

        Args:
            block: the block's index.
            D_V: its feedthrough from now on, m_i x m_i, m/N.

        Raises:
            ValueError: the block is not frozen, the shape is wrong, or the loop would have no unique solution. The core
                has not changed then.
        """
        whole = self.clutches.exchanged(block, D_V, self._D_V)
        self._step = _closed(self._E, whole)
        self._force, self._rest = linear_map(self._step[: self._m]), linear_map(self._step[self._m :])
        self._D_V = whole
        self._group = []  # made anew with the next tick that needs it

    def _begin(self, p: Floats) -> None:
        """Before the first tick, let a block join by the ramp if its first step would overdraw its energy budget.

        The first p has no step that could be bounded, and a device may be switched on anywhere within its reach.
        """
        known = self._eta + p
        f, x_e = self._force(known), self._rest(known)[: self._m]
        for party, clutch in enumerate(self.clutches.all):
            if -dot(ports_of(f, clutch), ports_of(x_e, clutch)) > 0.5 * self.energy.room(party):
                self.clutches.freeze(party)
                self.clutches.engage(party)

    def _bound(self) -> None:
        """Give the accounts the energy that E stores; between two calls dissipated energy counts as stored."""
        if self._storage is not None:
            eta = np.array(self._eta)
            self.energy.bound(0.5 * float(eta @ self._storage @ eta))

    def _through_clutches(self, p: Floats) -> Floats:
        """f_c(k) where any block is not settled; it allocates, for its sizes depend on which blocks these are."""
        clutches = self.clutches
        self._f = f = clutches.choose(p, self._f, self._x_e, lambda: self._solve(p), self._supply)
        f_c = f.copy()
        ratios = [clutch.ratio for clutch in self._group for _ in clutch.ports]
        forces = [ratio * f[port] for ratio, port in zip(ratios, self._J, strict=True)]
        x_e: Floats = []
        deflected = self._deflection(forces)
        for clutch in self._group:
            at = len(x_e)
            x_e += clutch.conclude(deflected[at : at + len(clutch.ports)])
        for port, force in zip(self._J, forces, strict=True):
            f_c[port] = force
        self._concluded = list(zip(self._J, x_e, strict=True))
        clutches.conclude()
        return f_c

    def _supply(self, clutch: Clutch, f: Floats) -> float:
        """The energy that the clutch's tool puts into the environment in this tick, J, for f_e(k) at its ports, N."""
        return clutch.supply(f, self._deflections[self._group.index(clutch)]([clutch.ratio * force for force in f]))

    def _solve(self, p: Floats) -> Floats:
        """f_e(k) at this tick's ratios, N; keeps (eta, r - W f_J), from which the rest of the tick follows."""
        n = self._n
        f_J = self._at_clutches(p)
        if f_J is None:
            self.ill_posed += 1
            for clutches in (tuple(self._unsettled), self.clutches.all):
                for clutch in clutches:
                    self.clutches.handle(clutch, ClutchEvent.FREEZE)
                self.clutches.seize(self._x_e)
                f_J = self._at_clutches(p)
                if f_J is not None:
                    break
        if f_J:
            known = self._known
            for port, slack, by in zip(self._J, self._slacks, self._deflection(f_J), strict=True):
                if slack > 0.0:
                    known[n + port] -= slack * by
        return self._force(self._known)

    def _at_clutches(self, p: Floats) -> Floats | None:
        """f_J(k), N; puts r in place of p at the ports J. None where the loop has no unique solution.

        Where all ratios are 1, f_J is not needed, and the result is empty.
        """
        if self._group != self._unsettled:
            self._regroup()
        self._known = known = self._eta + p
        references = [at for clutch in self._group for at in clutch.reference]
        for port, at in zip(self._J, references, strict=True):
            known[self._n + port] = at
        self._slacks = slacks = [1.0 - clutch.ratio * clutch.ratio for clutch in self._group for _ in clutch.ports]
        if not any(slacks):
            return []
        A, size = _weighted(self._F_D, slacks)
        # pivots are compared with 1 + ||F W||, for ||I + F W|| would cancel with them at a single port; with all
        # blocks frozen the loop is open, and the equations always have a solution
        open_ = len(slacks) == self._m and all(slack == 1.0 for slack in slacks)
        return solve(A, self._f_J(known), 0.0 if open_ else (1.0 + size) / SINGULAR)

    def _regroup(self) -> None:
        """Make the matrices of the group J, the blocks that are not settled."""
        self._group = self._unsettled.copy()
        self._J = J = [port for clutch in self._group for port in clutch.ports]
        self._f_J = linear_map(self._step[J])
        F_J = self._step[np.ix_(J, [self._n + port for port in J])]
        self._F_D = F_J @ self._D_V[np.ix_(J, J)]
        self._deflections = [linear_map(self._D_V[np.ix_(clutch.ports, clutch.ports)]) for clutch in self._group]
        self._deflection = self._deflection_of_group()

    def _deflection_of_group(self) -> LinearMap:
        """D_V f at all of J, clutch by clutch."""
        if len(self._J) == len(self._group):  # one port each
            diagonal = self._D_V[self._J, self._J].tolist()
            return lambda f: list(map(mul, diagonal, f))
        deflections, sizes = self._deflections, [len(clutch.ports) for clutch in self._group]

        def by_clutch(f: Floats) -> Floats:
            image: Floats = []
            for deflection, size in zip(deflections, sizes, strict=True):
                image += deflection(f[len(image) : len(image) + size])
            return image

        return by_clutch


def _weighted(matrix: Vector, weights: Floats) -> tuple[Rows | Vector, float]:
    """I + M W for W = diag(``weights``), and the norm of M W: its greatest sum of absolute values by row."""
    if len(weights) > FEW:
        product = matrix * np.array(weights)
        size = float(np.abs(product).sum(axis=1).max())
        product.flat[:: len(weights) + 1] += 1.0
        return product, size
    rows = [list(map(mul, weights, row)) for row in matrix.tolist()]
    size = max(sum(map(abs, row)) for row in rows)
    for i, row in enumerate(rows):
        row[i] += 1.0
    return rows, size


def _closed(E: StateSpace, D_V: Vector) -> Vector:
    """The matrix from (eta(k), p(k)) to (f_e(k), x_e(k), eta(k+1)) with all blocks coupled.

    Raises:
        ValueError: I + D_E D_V is singular.
    """
    n, m = E.order, E.inputs
    loop = np.eye(E.outputs) + E.D @ D_V
    if not np.linalg.cond(loop) < SINGULAR:
        raise ValueError("I + D_E D_V is singular: force and tool position have no unique solution in a tick")
    f = -np.linalg.solve(loop, np.hstack([E.C, E.D]))
    x_e = np.hstack([np.zeros((m, n)), np.eye(m)]) + D_V @ f
    eta = np.hstack([E.A, np.zeros((n, m))]) + E.B @ x_e
    return np.ascontiguousarray(np.vstack([f, x_e, eta]))


Core: TypeAlias = EnvironmentCore | EnforcedCore
"""A core of the environment, with or without a controller."""


def respond(core: Core, signals: Floats, tick: int) -> Floats:
    """The forces f_c(k) for the couplings, N, and what rides with them, from p(k), m, and what rides with that.

    Where no orientation rides, this is :meth:`EnvironmentCore.react`.
    """
    oriented = core.oriented
    if oriented is None:
        return core.react(signals)
    m = len(signals) - oriented.width
    oriented.hear(signals[m:], tick)
    return core.react(signals[:m]) + oriented.answer()


def row_of(core: Core) -> Row:
    """Tools, masses, orientations and the ledger's total of the tick that was settled last, and of the tools that hands
    turn what was heard and told; the rows of wave links follow.
    """
    ledger, oriented = core.ledger, core.oriented
    turned: Row = ([], []) if oriented is None else (oriented.heard, oriented.told)
    return core.tools, core.masses, core.orientations, [] if ledger is None else [ledger.total], *turned


def environment_core(bundle: EnvironmentBundle, D_V: Vector, blocks: Blocks | None = None) -> Core:
    """The core that a bundle asks for, at rest; it imports and makes the model that the bundle names.

    Args:
        bundle: the environment's part of the session.
        D_V: the couplings' feedthrough, m x m, m/N, from the handshakes.
        blocks: the ports of each coupling; None for one block of all ports.

    Raises:
        FactoryError: the model cannot be made.
        ValueError: the bundle has neither matrices nor a model nor a scene, or the core cannot be made with this D_V.
    """
    common, E = bundle.common, bundle.E
    law: ForceLaw
    turned: OrientedTools | None = None
    if bundle.model is not None:
        K = bundle.stiffness
        model = make_model(bundle.model, common.ports, common.period, REACT if K is None else PROXY)
        if bundle.oriented and not callable(getattr(model, "orientations", None)):
            raise FactoryError(
                f"environment.orientations: found {', '.join(bundle.oriented)} with {bundle.model.factory}, which has "
                "no method orientations(); expected an engine that has it, or no such key"
            )
        asked = AskedModel(bundle.model.factory, model, common.ports, common.turning, common.buttons)
        if K is None:
            law = BlackBox(asked)
        else:
            parties = ports_of_blocks(blocks, len(common.ports))
            bodies, oriented = len(bundle.masses) // 3, len(bundle.oriented)
            law = ProxyLaw(asked, K, bundle.Phi_E, common.period, parties, bodies, bundle.tank, oriented)
        if bundle.oriented_tools:
            _require(model, bundle)
            turned = OrientedTools(bundle.oriented_tools, asked)
    elif bundle.scene is not None:
        law = SceneLaw(bundle.scene, common.period, common.buttons)
    elif E is None:
        raise ValueError("found an environment without matrices, a model and a scene; expected one of them")
    elif bundle.enforce:
        law = LinearLaw(E, len(bundle.masses))
    else:
        return EnvironmentCore(
            E,
            D_V,
            bundle.Phi_E,
            common.period,
            blocks,
            masses=len(bundle.masses),
            budgets=bundle.budgets,
            storage=bundle.storage,
        )
    return EnforcedCore(
        law,
        D_V,
        bundle.Phi_E,
        common.period,
        bundle.enforce,
        blocks,
        budgets=bundle.budgets,
        stored=bundle.energy_at_start,
        oriented=turned,
    )


def _require(model: EnvironmentModel, bundle: EnvironmentBundle) -> None:
    """Require an engine whose avatars can be turned."""
    if bundle.model is not None and not all(callable(getattr(model, name, None)) for name in ("turn", "avatars")):
        raise FactoryError(
            f"environment.tools: found {', '.join(of.device for of in bundle.oriented_tools)} turned with "
            f"{bundle.model.factory}, which has no turn(torques) and avatars(); expected an engine that has them"
        )
