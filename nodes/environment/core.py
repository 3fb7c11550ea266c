"""The environment's tick without its I/O: it closes the algebraic loop and never sees x.

From the free tool positions p(k) of all ports and the couplings' feedthrough D_V,

    f_e(k) = -(I + D_E D_V)^{-1} (C_E eta(k) + D_E p(k)),
    x_e(k) = p(k) + D_V f_e(k),     eta(k+1) = A_E eta(k) + B_E x_e(k).

All three are linear in (eta, p): one product with a matrix made beforehand gives them at once.

**Clutches** (:mod:`manyhands.nodes.environment.clutch`) stand between the blocks and the environment, with one ratio
in S for each block. With r = x_e(k-1) + S (p(k) - x_c(k-1)) the loop is x_e = r + S D_V S f_e, and the couplings are
sent f_c = S f_e. Since S D_V S = S^2 D_V differs from D_V at the ports J of blocks that are not settled alone,

    (I + F_JJ W) f_J = f_J(eta, r),    W = (I - S^2) D_V at J,    F = -(I + D_E D_V)^{-1} D_E,

and the matrix made beforehand gives everything else at r - W f_J in place of p. So a block that ramps costs a linear
system of its own size, once for each new S, and a frozen one two small products a tick. I + F_JJ W is
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
from manyhands.nodes.ledger import Ledger
from manyhands.nodes.linear_map import Floats, dot, linear_map
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
    ) -> None:
        """Start at rest, all tools at 0, all blocks coupled.

        Args:
            E: (A_E, B_E, C_E, D_E), tool displacement (m) to force (N), m ports.
            D_V: the couplings' feedthrough, m x m, m/N, as told at the handshake.
            Phi_E: the environment's level, m x m, N*s/m, or None.
            T: period, s.
            blocks: the ports of each coupling, in its own order; None for one block of all ports.
            ramp: ticks from frozen to coupled.

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
        self._Phi = None if Phi_E is None else linear_map(Phi_E)
        self._D_V = np.array(D_V, dtype=np.float64)
        self._step = _closed(E, self._D_V)
        self._known = np.zeros(n + m)  # (eta, p), filled in place
        self._x_e = np.zeros(m)
        self._tool: Floats = [0.0] * m  # the same, for the ledger
        self._next = np.zeros(2 * m + n)  # (f_e, x_e, eta of the next tick)
        self.ledger = None if Phi_E is None else Ledger()
        self.ill_posed = 0
        self._clutches = tuple(Clutch(part, ramp) for part in parts)
        self._unsettled: list[Clutch] = []
        self._regroup = False  # whether the next five are about others than these
        self._linked: tuple[float, ...] = ()  # the ratios that the last two are about
        self._sizes: list[int] = []
        self._J = np.zeros(0, dtype=np.intp)
        self._rows = np.zeros((0, n + m))  # of f_J
        self._D_J = np.zeros((0, 0))
        self._F_J = np.zeros((0, 0))
        self._taken = np.zeros((0, 0))  # W (I + F_JJ W)^{-1}
        self._S = np.ones(m)

    def react(self, p: Vector) -> Vector:
        """f_c(k) = S f_e(k), N, to be sent to the couplings, for the free tool positions p(k), m.

        What p says of a frozen block is not looked at.
        """
        self._known[self._n :] = p
        if self._unsettled:
            return self._through_clutches(p)
        self._next = self._step @ self._known
        return self._next[: self._m]

    def settle(self) -> None:
        """Step to the next tick and keep the ledger: what can wait until the forces are on their way."""
        m, T = self._m, self._T
        self._x_e = self._next[m : 2 * m]
        if self.ledger is not None and self._Phi is not None:
            now = self._x_e.tolist()
            w = [(at - last) / T for at, last in zip(now, self._tool, strict=True)]
            self.ledger.enter(T * (dot(w, self._Phi(w)) - dot(w, self._next[:m].tolist())))
            self._tool = now
        self._known[: self._n] = self._next[2 * m :]

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

    def settled(self, block: int) -> bool:
        """Whether s = 1 and the tool is where the coupling's end is."""
        return self._clutches[block].settled

    def offset(self, block: int) -> Vector:
        """x_e - x_c of the block's ports, m; 0 where it is settled, and of the last tick heard where it is frozen."""
        clutch = self._clutches[block]
        return np.zeros(len(clutch.ports)) if clutch.settled else clutch.offset

    def exchange(self, block: int, D_V: Vector) -> None:
        """Give a frozen block another feedthrough: the whole matrix is made anew, which may take longer than a tick.

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
        self._D_V = whole
        self._regroup = True

    def _happens(self, clutch: Clutch, event: Event) -> None:
        was_settled = clutch.settled
        clutch.handle(event)
        if was_settled and not clutch.settled:
            self._unsettled.append(clutch)
            self._regroup = True

    def _through_clutches(self, p: Vector) -> Vector:
        """f_c(k) where some block is not settled. Allocates, as what it makes depends on who that is."""
        m, before = self._m, self._next
        if self._regroup:
            self._group()
        for clutch in self._unsettled:
            clutch.advance(p[clutch.ports], before[clutch.ports])
        # one a tick, so that its own sign of energy decides
        going = next((clutch for clutch in self._unsettled if clutch.ready), None)
        for clutch in self._unsettled:
            clutch.ready = clutch is going
        if going is not None:
            going.let_go()
        self._solve()
        if going is not None and going.ready and going.gains(self._next[going.ports]):
            going.keep()
            self._solve()
        f_c = self._S * self._next[:m]
        for clutch in self._unsettled:
            ports = clutch.ports
            deflection = self._D_V[np.ix_(ports, ports)] @ f_c[ports]
            self._next[m + ports] = clutch.conclude(deflection)
        if going is not None and going.settled:
            self._unsettled.remove(going)
            self._regroup = True
        return f_c

    def _solve(self) -> None:
        """f_e(k), x_e(k) and eta(k+1) at this tick's ratios."""
        if self._linked != tuple(clutch.ratio for clutch in self._unsettled) and not self._link():
            self.ill_posed += 1
            for clutches in (tuple(self._unsettled), self._clutches):
                for clutch in clutches:
                    self._happens(clutch, Event.FREEZE)
                self._group()
                if self._link():
                    break
        at = self._n + self._J
        r = np.concatenate([clutch.reference for clutch in self._unsettled])
        self._known[at] = r
        self._known[at] = r - self._taken @ (self._rows @ self._known)
        self._next = self._step @ self._known

    def _group(self) -> None:
        """Take who is not settled as the group J; the clutches new in it take the tools' positions."""
        for clutch in self._unsettled:
            if clutch.fresh:
                clutch.seize(self._x_e[clutch.ports])
        self._regroup, self._linked = False, ()
        self._sizes = [len(clutch.ports) for clutch in self._unsettled]
        self._J = np.concatenate([clutch.ports for clutch in self._unsettled])
        self._rows = np.ascontiguousarray(self._step[self._J])
        self._F_J = np.ascontiguousarray(self._rows[:, self._n + self._J])
        self._D_J = np.ascontiguousarray(self._D_V[np.ix_(self._J, self._J)])

    def _link(self) -> bool:
        """Solve the loop for the present ratios, at the ports J; False when it has no unique solution."""
        ratios = tuple(clutch.ratio for clutch in self._unsettled)
        S = np.repeat(ratios, self._sizes)
        W = (1.0 - S * S)[:, None] * self._D_J
        change = self._F_J @ W
        try:
            inverse = np.linalg.inv(np.eye(len(S)) + change)
        except np.linalg.LinAlgError:
            return False
        # against 1 + ||F W||, and not ||I + F W||, which cancels with it at a single port; with all frozen it is open
        all_frozen = len(S) == self._m and not S.any()
        if not all_frozen and not (1.0 + np.linalg.norm(change, 1)) * np.linalg.norm(inverse, 1) < _SINGULAR:
            return False
        self._taken, self._linked = W @ inverse, ratios
        self._S[:] = 1.0
        self._S[self._J] = S
        return True


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
