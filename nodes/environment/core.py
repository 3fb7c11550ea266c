"""The environment's tick without its I/O: it closes the algebraic loop and never sees x.

From the free tool positions p(k) of all ports and the couplings' feedthrough D_V,

    f_e(k) = -(I + D_E D_V)^{-1} (C_E eta(k) + D_E p(k)),
    x_e(k) = p(k) + D_V f_e(k),     eta(k+1) = A_E eta(k) + B_E x_e(k).

All three are linear in (eta, p): products with a matrix made beforehand give them, the forces first and the rest when
they are on their way.

**Clutches** (:mod:`manyhands.nodes.environment.clutch`) stand between the blocks and the environment, with one ratio
in S for each block. With r = x_e(k-1) + S (p(k) - x_c(k-1)) the loop is x_e = r + S D_V S f_e, and the couplings are
sent f_c = S f_e. Since S D_V S = S^2 D_V differs from D_V at the ports J of blocks that are not settled alone,

    (I + F_JJ W) f_J = f_J(eta, r),    W = (I - S^2) D_V at J,    F = -(I + D_E D_V)^{-1} D_E,

and the matrix made beforehand gives everything else at r - W f_J in place of p. So a block that is not settled costs
a linear system of its own size each tick, and one that works an offset off may do so for the rest of a session.
As s is one number for each block, F_JJ W is F_JJ D_V with the columns of each block times its 1 - s^2. I + F_JJ W is
regular exactly when I + D_E S D_V S is, which a certificate implies for every S (docs/decisions/0015-the-clutch.md).
Without one it may not be: then blocks are frozen until it is, and with all frozen it is the identity.

It promises that E_hat is (-Phi_E)-ISP: from the tool velocity w to -f_e, T (w^T (-f_e) + w^T Phi_E w) sums to
no less than zero.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.design.statespace import StateSpace
from manyhands.nodes.environment.clutch import RAMP, Clutch, Event, Phase
from manyhands.nodes.environment.energy import BOUND_TICKS, Budget, Energy
from manyhands.nodes.ledger import Ledger
from manyhands.nodes.linear_map import Floats, LinearMap, Rows, dot, linear_map, solve
from manyhands.nodes.passivity_controller import PassivityController

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]

_SINGULAR = 1e12  # condition above which an algebraic loop counts as having no unique solution


class EnvironmentCore:
    """The state of the environment between ticks.

    Attributes:
        failure: why it cannot go on; matrices always can.
        controller: a passivity controller that keeps its promise; none is needed where that is proved.
        ledger: its energy ledger; None when the session is not certified.
        energy: who puts how much into whom.
        ill_posed: ticks in which blocks were frozen because the loop had no unique solution; 0 under a certificate.
    """

    failure: str | None = None
    controller: PassivityController | None = None

    def __init__(
        self,
        E: StateSpace,
        D_V: Vector,
        Phi_E: Vector | None,
        T: float,
        blocks: Sequence[slice | Sequence[int] | Indices] | None = None,
        ramp: int = RAMP,
        masses: int = 0,
        budgets: Sequence[Budget] | None = None,
        storage: Vector | None = None,
    ) -> None:
        """Start at rest, all tools at 0, all blocks coupled.

        Args:
            E: (A_E, B_E, C_E, D_E), tool displacement (m) to force (N), m ports.
            D_V: the couplings' feedthrough, m x m, m/N, as told at the handshake.
            Phi_E: the environment's level, m x m, N*s/m, or None.
            T: period, s.
            blocks: the ports of each coupling, in its own order; None for one block of all ports.
            ramp: ticks from frozen to coupled.
            masses: how many entries of the state, behind the m tools, are positions of masses.
            budgets: what each coupling may put into the others; None for no bound.
            storage: the environment stores 1/2 eta^T storage eta, J; None where that is not known.

        Raises:
            ValueError: the algebraic loop has no unique solution, the blocks do not hold every port once, or D_V joins
                ports of two blocks.
        """
        n, m = E.order, E.inputs
        if ramp < 1:
            raise ValueError(f"found a ramp of {ramp} ticks; expected 1 or more")
        parts = [_ports(part, m) for part in ([slice(None)] if blocks is None else blocks)]
        if sorted(int(port) for part in parts for port in part) != list(range(m)) or not all(map(len, parts)):
            raise ValueError(f"found the blocks {[part.tolist() for part in parts]}; expected each of {m} ports in one")
        inside = np.zeros((m, m), dtype=np.bool_)
        for part in parts:
            inside[np.ix_(part, part)] = True
        if np.any(np.asarray(D_V)[~inside]):
            raise ValueError("found a feedthrough D_V between ports of two blocks; expected one within each block")
        self._E, self._T, self._m, self._n = E, T, m, n
        self._positions = slice(m, m + masses)
        self._Phi = None if Phi_E is None else linear_map(Phi_E)
        self._D_V = np.array(D_V, dtype=np.float64)
        self._step = _closed(E, self._D_V)
        self._force, self._rest = linear_map(self._step[:m]), linear_map(self._step[m:])
        self._rest_of_tick = self._rest  # of the feedthrough that its forces were found with
        self._eta: Floats = [0.0] * n
        self._known: Floats = [0.0] * (n + m)  # (eta, p); where clutches are not settled r - W f_J in place of p
        self._x_e: Floats = [0.0] * m  # of the tick before, until settle
        self._f: Floats = [0.0] * m  # f_e, likewise until react
        self._concluded: list[tuple[int, float]] = []  # port and x_e of clutches, for whom it is known exactly
        self.ledger = None if Phi_E is None else Ledger()
        self.ill_posed = 0
        self._clutches = tuple(Clutch(part.tolist(), ramp) for part in parts)
        self.energy = Energy([clutch.ports for clutch in self._clutches], budgets, T, storage is not None)
        self._storage, self._bound_in = storage, BOUND_TICKS
        self._begins = budgets is not None
        self._unsettled: list[Clutch] = []
        self._regroup = False  # whether the next three are about others than these
        self._f_J: LinearMap = list  # from (eta, r)
        self._deflections: list[LinearMap] = []  # D_V f, by clutch of the group
        self._F_D: Rows = []  # F_JJ D_V at J

    def react(self, p: Floats) -> Floats:
        """f_c(k) = S f_e(k), N, to be sent to the couplings, for the free tool positions p(k), m.

        What p says of a frozen block is not looked at.
        """
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
        """Step to the next tick and keep the ledger: what can wait until the forces are on their way."""
        m, T = self._m, self._T
        rest = self._rest_of_tick(self._known)
        x_e, self._eta = rest[:m], rest[m:]
        for port, at in self._concluded:
            x_e[port] = at
        self._concluded = []
        if self.ledger is not None and self._Phi is not None:
            w = [(at - last) / T for at, last in zip(x_e, self._x_e, strict=True)]
            self.ledger.enter(T * (dot(w, self._Phi(w)) - dot(w, self._f)))
        self.energy.enter(self._f, x_e, self._x_e)
        self._x_e = x_e
        self._bound_in -= 1
        if self._bound_in == 0:
            self._bound_in = BOUND_TICKS
            self._bound()
        if self.energy.restrained:
            self._restrain()

    @property
    def tools(self) -> Floats:
        """x_e of the tick that was settled last, m."""
        return self._x_e

    @property
    def masses(self) -> Floats:
        """Where the masses were then, m; none where the environment is no network."""
        return self._eta[self._positions]

    def freeze(self, block: int) -> None:
        """From the next tick on s = 0: the block's tool rests, and no force goes to it."""
        self._happens(self._clutches[block], Event.FREEZE)

    def engage(self, block: int) -> None:
        """Take the block's next p as its reference, with s = 0, and raise s to 1 over the ticks of a ramp after it.

        A block that is leaving turns round from where its ratio is; for a coupled one nothing changes.
        """
        self._happens(self._clutches[block], Event.ENGAGE)

    def disengage(self, block: int) -> None:
        """Lower s to 0 from where it is; then the block is frozen."""
        self._happens(self._clutches[block], Event.DISENGAGE)

    def ratio(self, block: int) -> float:
        """The block's s: that of the last tick, or 0 if it has been frozen since."""
        return self._clutches[block].ratio

    def frozen(self, block: int) -> bool:
        """Whether s = 0."""
        return self._clutches[block].ratio == 0.0

    def rests(self, block: int) -> bool:
        """Whether s was 0 in the last tick and in the one before it."""
        return self._clutches[block].rests

    def settled(self, block: int) -> bool:
        """Whether s = 1 and the tool is where the coupling's end is."""
        return self._clutches[block].settled

    def offset(self, block: int) -> Floats:
        """x_e - x_c of the block's ports, m; 0 where it is settled, and of the last tick heard where it is frozen."""
        clutch = self._clutches[block]
        return [0.0] * len(clutch.ports) if clutch.settled else clutch.offset

    def exchange(self, block: int, D_V: Vector) -> None:
        """Give a frozen block another feedthrough: the whole matrix is made anew, which may take longer than a tick.

        Between :meth:`react` and :meth:`settle` it is that of the next tick: this one ends as it began.

        Args:
            block: its index.
            D_V: m_i x m_i, m/N.

        Raises:
            ValueError: the block is not frozen, the shape is another, or the loop would have no unique solution;
                nothing has changed then.
        """
        clutch = self._clutches[block]
        if clutch.phase not in (Phase.FROZEN, Phase.JOINING):
            raise ValueError(
                f"found block {block} at the ratio {clutch.ratio:.3g}; expected it frozen: disengage first"
            )
        size = len(clutch.ports)
        if np.shape(D_V) != (size, size):
            raise ValueError(f"found a feedthrough of shape {np.shape(D_V)}; expected {size} x {size}")
        whole = self._D_V.copy()
        whole[np.ix_(clutch.ports, clutch.ports)] = D_V
        self._step = _closed(self._E, whole)
        self._force, self._rest = linear_map(self._step[: self._m]), linear_map(self._step[self._m :])
        self._D_V = whole
        self._regroup = True

    def _begin(self, p: Floats) -> None:
        """Before the first tick: who begins so far from its tool that it would overdraw its budget comes by the ramp.

        The first p has no step that could be bounded, and a device may be switched on anywhere within its reach.
        """
        known = self._eta + p
        f, x_e = self._force(known), self._rest(known)[: self._m]
        for party, clutch in enumerate(self._clutches):
            if -dot(_of(f, clutch), _of(x_e, clutch)) > 0.5 * self.energy.room(party):
                self.freeze(party)
                self.engage(party)

    def _bound(self) -> None:
        """Tell what is stored, now and then: between, what is burned counts as stored."""
        if self._storage is not None:
            eta = np.array(self._eta)
            self.energy.bound(0.5 * float(eta @ self._storage @ eta))

    def _restrain(self) -> None:
        """Hold every party's ratio to what its budget allows, from the next tick on."""
        for party, clutch in enumerate(self._clutches):
            was_settled = clutch.settled
            clutch.restrain(self.energy.ratio(party))
            if was_settled and not clutch.settled:
                self._unsettled.append(clutch)
                self._regroup = True

    def _happens(self, clutch: Clutch, event: Event) -> None:
        was_settled = clutch.settled
        clutch.handle(event)
        if was_settled and not clutch.settled:
            self._unsettled.append(clutch)
            self._regroup = True

    def _through_clutches(self, p: Floats) -> Floats:
        """f_c(k) where some block is not settled. Allocates, as what it makes depends on who that is."""
        before = self._f
        if self._regroup:
            self._group()
        for clutch in self._unsettled:
            clutch.advance(_of(p, clutch), _of(before, clutch))
        # one a tick, so that its own sign of energy decides
        going = next((clutch for clutch in self._unsettled if clutch.ready), None)
        for clutch in self._unsettled:
            clutch.ready = clutch is going
        if going is not None:
            going.let_go()
        self._solve(p)
        if going is not None and going.ready and going.gains(_of(self._f, going)):
            going.keep()
            self._solve(p)
        while self.energy.restrained and self._overdraws():
            self._solve(p)
        f_c = self._f.copy()
        self._concluded = []
        for clutch, deflection in zip(self._unsettled, self._deflections, strict=True):
            forces = [clutch.ratio * self._f[port] for port in clutch.ports]
            x_e = clutch.conclude(deflection(forces))
            for port, force, at in zip(clutch.ports, forces, x_e, strict=True):
                f_c[port] = force
                self._concluded.append((port, at))
        if going is not None and going.settled:
            self._unsettled.remove(going)
            self._regroup = True
        return f_c

    def _overdraws(self) -> bool:
        """Halt a party that would put more into the world in this tick than it has room for; whether there is one."""
        for party, clutch in enumerate(self._clutches):
            if self.energy.ratio(party) == 1.0 or clutch.ratio == 0.0:
                continue
            f = _of(self._f, clutch)
            deflection = self._deflections[self._unsettled.index(clutch)]([clutch.ratio * force for force in f])
            if clutch.supply(f, deflection) > self.energy.room(party):
                clutch.halt()
                return True
        return False

    def _solve(self, p: Floats) -> None:
        """f_e(k) at this tick's ratios, and what the rest follows from."""
        n = self._n
        f_J = self._at_clutches(p)
        if f_J is None:
            self.ill_posed += 1
            for clutches in (tuple(self._unsettled), self._clutches):
                for clutch in clutches:
                    self._happens(clutch, Event.FREEZE)
                self._group()
                f_J = self._at_clutches(p)
                if f_J is not None:
                    break
        at = 0
        for clutch, deflection in zip(self._unsettled, self._deflections, strict=True):
            slack, size = 1.0 - clutch.ratio * clutch.ratio, len(clutch.ports)
            if slack > 0.0 and f_J is not None:
                for port, by in zip(clutch.ports, deflection(f_J[at : at + size]), strict=True):
                    self._known[n + port] -= slack * by
            at += size
        self._f = self._force(self._known)

    def _at_clutches(self, p: Floats) -> Floats | None:
        """f_J(k), N, with r in place of p at the ports J of what is known; None when the loop has no unique solution.

        Where all ratios are 1 it is not asked for, and empty.
        """
        self._known = known = self._eta + p
        slacks: Floats = []
        for clutch in self._unsettled:
            slacks += [1.0 - clutch.ratio * clutch.ratio] * len(clutch.ports)
            for port, at in zip(clutch.ports, clutch.reference, strict=True):
                known[self._n + port] = at
        if not any(slacks):
            return []
        A = [[slack * entry for slack, entry in zip(slacks, row, strict=True)] for row in self._F_D]
        # against 1 + ||F W||, and not ||I + F W||, which cancels with it at a single port; with all frozen it is open
        size = max(sum(map(abs, row)) for row in A)
        for i, row in enumerate(A):
            row[i] += 1.0
        open_ = len(slacks) == self._m and all(slack == 1.0 for slack in slacks)
        return solve(A, self._f_J(known), 0.0 if open_ else (1.0 + size) / _SINGULAR)

    def _group(self) -> None:
        """Take who is not settled as the group J; the clutches new in it take the tools' positions."""
        for clutch in self._unsettled:
            if clutch.fresh:
                clutch.seize(_of(self._x_e, clutch))
        self._regroup = False
        J = [port for clutch in self._unsettled for port in clutch.ports]
        self._f_J = linear_map(self._step[J])
        F_J = self._step[np.ix_(J, [self._n + port for port in J])]
        self._F_D = (F_J @ self._D_V[np.ix_(J, J)]).tolist()
        self._deflections = [linear_map(self._D_V[np.ix_(clutch.ports, clutch.ports)]) for clutch in self._unsettled]


def _ports(part: slice | Sequence[int] | Indices, m: int) -> Indices:
    """The indices of a block's ports among m."""
    return np.arange(m)[part] if isinstance(part, slice) else np.array(part, dtype=np.intp)


def _closed(E: StateSpace, D_V: Vector) -> Vector:
    """The matrix from (eta(k), p(k)) to (f_e(k), x_e(k), eta(k+1)) with all blocks coupled.

    Raises:
        ValueError: I + D_E D_V is singular.
    """
    n, m = E.order, E.inputs
    loop = np.eye(E.outputs) + E.D @ D_V
    if not np.linalg.cond(loop) < _SINGULAR:
        raise ValueError("I + D_E D_V is singular: force and tool position have no unique solution in a tick")
    f = -np.linalg.solve(loop, np.hstack([E.C, E.D]))
    x_e = np.hstack([np.zeros((m, n)), np.eye(m)]) + D_V @ f
    eta = np.hstack([E.A, np.zeros((n, m))]) + E.B @ x_e
    return np.ascontiguousarray(np.vstack([f, x_e, eta]))


def _of(values: Floats, clutch: Clutch) -> Floats:
    """A clutch's part of ``values``."""
    return [values[port] for port in clutch.ports]
