"""The environment's tick for a model whose promise is enforced by a passivity controller.

At every tick the model returns the forces f_m that it wants to exert. Where its promise is *enforced*, the passivity
controller (:mod:`manyhands.nodes.kernel.passivity`) decides which part of them is exerted:

    f_e = part f_m + (1 - part) h,     x_e = r + S D_V S f_e,     h = (S D_V S)^{-1} (x_e(k-1) - r),

with the greatest part in [0, 1] that keeps the ledger from falling below zero. S and r are those of the blocks'
clutches (:mod:`manyhands.nodes.environment.clutch`), r = p and S = I while all are settled. At a port with s = 0 the
tool rests whatever the force is, and h does not matter. There are four kinds of laws:

- springs to the proxies of a model (:mod:`manyhands.nodes.environment.proxy`), which solve the algebraic loop. A test
  of their own keeps the level, so the controller has nothing to do but against rounding;
- a black box (:mod:`manyhands.nodes.environment.model`), which receives the tool positions predicted with its forces of
  the tick before. It is explicit, so the algebraic loop closes without any knowledge of the model;
- matrices E, whose own implicit force solves the algebraic loop. Their promise is proved, so the controller never acts;
- a scene (:mod:`manyhands.nodes.environment.scene`), whose force solves the algebraic loop with its contacts. Its
  promise is proved for an exact solution, so the controller acts on what an iteration leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.environment.chatter import Chatter
from manyhands.nodes.environment.clutch import (
    Blocks,
    Clutch,
    Clutches,
    held_force,
    holdable,
    ports_of,
    ports_of_blocks,
    require_within,
)
from manyhands.nodes.environment.energy import Energy
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.oriented_tools import OrientedTools
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.kernel.passivity import Ledger, PassivityController
from manyhands.nodes.kernel.timeouts import RAMP

Vector = NDArray[np.float64]


class ForceLaw(Protocol):
    """The source of the raw forces of an :class:`EnforcedCore`."""

    @property
    def failure(self) -> str | None:
        """The reason why it cannot be asked any more; None while it can."""
        ...

    def press(self, pressed: int) -> None:
        """Take in which buttons are held down from this tick on; called before the tick's first proposal."""
        ...

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The forces wanted at this tick, N; the core may call this several times in a tick, with different r.

        Args:
            r: tool positions without force, m.
            compliance: S D_V S, m/N; the same array as long as it does not change.
            x_e: tool positions under the forces of the tick before, r + S D_V S f_e(k-1), m; a new array in each call.
        """
        ...

    def advance(self, x_e: Vector, f: Vector) -> None:
        """Step to the next tick, with the tools at x_e(k), m, under the forces f_e(k) that were exerted, N."""
        ...

    @property
    def masses(self) -> Floats:
        """The positions of the masses after :meth:`advance`, m; empty where none are known."""
        ...

    @property
    def orientations(self) -> Floats:
        """The orientations of bodies after :meth:`advance`, a unit quaternion each; empty where none are reported."""
        ...

    @property
    def held(self) -> Sequence[int]:
        """By party, the ticks in which a test held its proxies; empty for a law without proxies."""
        ...

    @property
    def figures(self) -> Mapping[str, float]:
        """What it counts itself, by the names of :mod:`manyhands.nodes.rows.figures`; empty for most."""
        ...


class BlackBox:
    """The law of a model that is asked at the predicted tool position."""

    held: Sequence[int] = ()
    figures: Mapping[str, float] = MappingProxyType({})

    def __init__(self, model: AskedModel) -> None:
        """Ask ``model`` from its tick 0 on."""
        self._model, self._k = model, 0
        self._answer: Vector | None = None  # the forces of this tick, for which a model is asked once

    @property
    def failure(self) -> str | None:
        """What was wrong with the model's first bad answer; None without one."""
        return self._model.failure

    def press(self, pressed: int) -> None:
        """Tell the model, where it asks for buttons."""
        self._model.press(pressed)

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The model's forces at the ``x_e`` of the tick's first call, N."""
        if self._answer is None:
            self._answer = self._model.forces(x_e, self._k)
        return self._answer

    def advance(self, x_e: Vector, f: Vector) -> None:
        """Step to the next tick; the model needs no positions for it."""
        self._k += 1
        self._answer = None

    @property
    def masses(self) -> Floats:
        """Empty: a model's masses are not known."""
        return []

    @property
    def orientations(self) -> Floats:
        """Empty, likewise."""
        return []


class LinearLaw:
    """The law f_e = -(I + D_E S D_V S)^{-1} (C_E eta + D_E r), eta(k+1) = A_E eta + B_E x_e: E as it is proved."""

    failure: str | None = None
    held: Sequence[int] = ()
    figures: Mapping[str, float] = MappingProxyType({})

    def __init__(self, E: StateSpace, masses: int = 0) -> None:
        """Start at rest.

        Args:
            E: tool displacement (m) to force (N), m ports.
            masses: the number of entries of the state, after the m tools, that are positions of masses.
        """
        self._positions = slice(E.inputs, E.inputs + masses)
        self._output, self._D = np.hstack([E.C, E.D]), E.D
        self._state = np.hstack([E.A, E.B])  # over (eta, x_e)
        self._eta = np.zeros(E.order)
        self._compliance: Vector | None = None
        self._force: Vector = self._output

    def press(self, pressed: int) -> None:
        """Do nothing: no button acts on matrices."""

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The force that solves the algebraic loop; under a certificate there is exactly one."""
        if compliance is not self._compliance:
            loop = np.eye(len(self._D)) + self._D @ compliance
            self._force = np.asarray(-np.linalg.solve(loop, self._output), dtype=np.float64)
            self._compliance = compliance
        f: Vector = self._force @ np.concatenate([self._eta, r])
        return f

    def advance(self, x_e: Vector, f: Vector) -> None:
        """One step of E."""
        self._eta = self._state @ np.concatenate([self._eta, x_e])

    @property
    def masses(self) -> Floats:
        """The positions of the masses, m."""
        found: Floats = self._eta[self._positions].tolist()
        return found

    @property
    def orientations(self) -> Floats:
        """Empty: its masses move along axes, or turn about them."""
        return []


class EnforcedCore:
    """An environment between ticks, with the interface of :class:`manyhands.nodes.environment.core.EnvironmentCore`.

    Attributes:
        ledger: its energy ledger; None when it promises no level.
        controller: keeps the ledger from falling below zero; None where no level is enforced.
        energy: the energy that each coupling puts into the others, and their budgets.
        clutches: the clutches of the blocks.
        chatter: how often the forces f_c that the couplings receive reversed.
        oriented: the tools that hands turn; None without any.
        ill_posed: ticks in which the loop had no unique solution: always 0, by construction or by the certificate.
    """

    def __init__(
        self,
        law: ForceLaw,
        D_V: Vector,
        Phi_E: Vector | None,
        T: float,
        enforce: bool,
        blocks: Blocks | None = None,
        ramp: int = RAMP,
        budgets: Sequence[EnergyBudget] | None = None,
        stored: float = 0.0,
        oriented: OrientedTools | None = None,
    ) -> None:
        """Start at rest, all tools at 0, all blocks coupled.

        Args:
            law: the source of the raw forces.
            D_V: the couplings' feedthrough, m x m, m/N, from the handshakes.
            Phi_E: the declared level, m x m, N*s/m, or None.
            T: period, s.
            enforce: whether a controller keeps the level.
            blocks: the ports of each coupling, in its own order; None for one block of all ports.
            ramp: ticks from frozen to coupled.
            budgets: the energy that each coupling may put into the others; None for no bound.
            stored: the energy that the law stores at the start, with which its ledger begins, J.
            oriented: the tools that hands turn.

        Raises:
            ValueError: there is no level to enforce; or D_V joins ports of two blocks; or its symmetric part is not
                positive definite, so that possibly no force holds a tool.
        """
        m = len(D_V)
        if enforce and Phi_E is None:
            raise ValueError("found no level to enforce; expected the environment's Phi_E")
        self._law, self._Phi, self._T = law, Phi_E, T
        self.oriented = oriented
        self._D_V = np.array(D_V, dtype=np.float64)
        parts = ports_of_blocks(blocks, m)
        require_within(self._D_V, parts)
        self.energy = Energy(parts, budgets, T)
        self.clutches = Clutches(parts, ramp, self.energy)
        self._unsettled = self.clutches.unsettled
        self._x_e, self._f, self._w = np.zeros(m), np.zeros(m), np.zeros(m)  # those of the tick before, until react
        self._next = np.zeros(m)  # x_e of this tick
        self._S = np.ones(m)
        self._begins = budgets is not None
        self.chatter = Chatter(parts, T)
        self.ledger = None if Phi_E is None else Ledger(stored=stored)
        self.controller = PassivityController(T) if enforce else None
        self.ill_posed = 0
        self._stiffness = self._stiffness_of(self._D_V)
        self._compliance = self._D_V

    @property
    def failure(self) -> str | None:
        """Why the model is not asked any more, in one sentence; its forces are zero then, or its proxies rest."""
        return self._law.failure

    def press(self, pressed: int) -> None:
        """Take in which buttons are held down from the next :meth:`react` on, bit by bit as the bundle names them."""
        self._law.press(pressed)

    def react(self, p: Floats) -> Floats:
        """f_c(k) = S f_e(k), N, for the couplings, from the free tool positions p(k), m."""
        if self._begins:
            self._begins = False
            self._begin(np.array(p))
        if self._unsettled:
            return self._through_clutches(p)
        r = np.array(p)
        f: Floats = self._exert(self._law.propose(r, self._D_V, r + self._D_V @ self._f), r).tolist()
        return f

    def settle(self) -> None:
        """Step to the next tick and keep the ledger; all this can wait until the forces are on their way."""
        w = self._w
        if self.ledger is not None and self._Phi is not None:
            self.ledger.enter(self._T * float(-(w @ self._f) + w @ self._Phi @ w))
        if self.controller is not None:
            self.controller.settle()
        self.energy.enter(self._f.tolist(), self._next.tolist(), self._x_e.tolist())
        self.chatter.enter(self._S * self._f)
        self._x_e = self._next
        self._law.advance(self._x_e, self._f)
        if self.energy.restrained:
            self.clutches.restrain()

    @property
    def tools(self) -> Floats:
        """x_e of the tick that was settled last, m."""
        found: Floats = self._x_e.tolist()
        return found

    @property
    def masses(self) -> Floats:
        """The positions of the masses in that tick, m; empty where none are known."""
        return self._law.masses

    @property
    def orientations(self) -> Floats:
        """The orientations of bodies in that tick, a unit quaternion each; empty where none are reported."""
        return self._law.orientations

    @property
    def held(self) -> Sequence[int]:
        """By party, the ticks in which the test held its proxies; empty without proxies."""
        return self._law.held

    @property
    def figures(self) -> Mapping[str, float]:
        """What the law counts itself, by the names of :mod:`manyhands.nodes.rows.figures`."""
        return self._law.figures

    def load(self, block: int) -> float:
        """The greatest force at the block's tools in the last tick, N."""
        return max(map(abs, ports_of(self._f.tolist(), self.clutches.all[block])))

    def holdable(self, block: int) -> bool:
        """Whether a force can hold the end of the block's coupling: whether its D_V is regular."""
        return holdable(self.clutches.all[block], self._D_V)

    def holding_force(self, block: int, p: Floats) -> Floats:
        """f_c(k), N, of a block that is held in this tick, from its p(k), m (:func:`held_force`)."""
        return held_force(self.clutches.all[block], self._x_e.tolist(), self._D_V, p)

    def exchange(self, block: int, D_V: Vector) -> None:
        """Change the feedthrough of a frozen block.

        Args:
            block: the block's index.
            D_V: its feedthrough from now on, m_i x m_i, m/N.

        Raises:
            ValueError: the block is not frozen, the shape is wrong, or a core could not have been made with this D_V.
                The core has not changed then.
        """
        whole = self.clutches.exchanged(block, D_V, self._D_V)
        self._stiffness = self._stiffness_of(whole)
        self._D_V = whole
        self._compliance = self._S[:, None] * whole * self._S

    def _begin(self, r: Vector) -> None:
        """Before the first tick, let a block join by the ramp if its first step would overdraw its energy budget.

        The first p has no step that could be bounded, and a device may be switched on anywhere within its reach.
        """
        for clutch in self._unsettled:  # it joins by the ramp anyway, and its tool rests
            r[clutch.ports] = 0.0
        if not np.any(r):  # a tool at rest puts in -f^T D_V f at most
            return
        f = self._law.propose(r, self._D_V, r)
        work = -f * (r + self._D_V @ f)
        for party, clutch in enumerate(self.clutches.all):
            if work[clutch.ports].sum() > 0.5 * self.energy.room(party):
                self.clutches.freeze(party)
                self.clutches.engage(party)

    def _stiffness_of(self, D_V: Vector) -> Vector:
        """D_V^{-1}, N/m: the couplings' stiffness within one tick; D_V itself without a controller, which needs it."""
        if self.controller is None:
            return D_V
        if not float(np.linalg.eigvalsh((D_V + D_V.T) / 2.0)[0]) > 0.0:
            raise ValueError(
                "found a D_V whose symmetric part is not positive definite; an enforced environment needs a coupling, "
                "every one of whose ports gives way to a force; see 'design: coupling' in the session"
            )
        return np.asarray(np.linalg.inv(D_V), dtype=np.float64)

    def _exert(self, f: Vector, r: Vector) -> Vector:
        """The forces that are exerted for the raw forces f, N; sets f_e, w and x_e of this tick."""
        w = (r + self._compliance @ f - self._x_e) / self._T
        if self.controller is not None and self.ledger is not None and self._Phi is not None:
            # s is 0, where the tool rests and h does not matter, or at least one step of the ramp
            hold = self._stiffness @ (self._x_e - r) / np.where(self._S > 0.0, self._S * self._S, 1.0)
            part = self.controller.part(self.ledger.total, f, w, hold, float(w @ self._Phi @ w))
            if part < 1.0:
                f = part * f + (1.0 - part) * hold
                w *= part  # not computed from f again: a tool that is held must stand still to the last bit
        self._f, self._w, self._next = f, w, self._x_e + self._T * w
        return f

    def _through_clutches(self, p: Floats) -> Floats:
        """f_c(k) where any block is not settled; it allocates, for its sizes depend on which blocks these are."""
        clutches, before = self.clutches, self._f
        r = np.array(p)
        clutches.choose(p, before.tolist(), self._x_e.tolist(), lambda: self._asked(r, before).tolist(), self._supply)
        f_c = self._S * self._f
        for clutch in self._unsettled:
            ports = clutch.ports
            self._next[ports] = clutch.conclude((self._D_V[np.ix_(ports, ports)] @ f_c[ports]).tolist())
        if clutches.conclude():
            self._linked(r)
        sent: Floats = f_c.tolist()
        return sent

    def _supply(self, clutch: Clutch, f: Floats) -> float:
        """The energy that the clutch's tool puts into the environment in this tick, J, for f_e(k) at its ports, N."""
        return float(np.array(f) @ (self._x_e - self._next)[clutch.ports])

    def _asked(self, p: Vector, before: Vector) -> Vector:
        """f_e(k) at the clutches' present ratios, after the forces of the tick ``before``, N."""
        r = self._linked(p)
        return self._exert(self._law.propose(r, self._compliance, r + self._compliance @ before), r)

    def _linked(self, p: Vector) -> Vector:
        """Make S and S D_V S anew where a ratio has changed; returns r, m."""
        r, S = p.copy(), np.ones(len(p))
        for clutch in self._unsettled:
            r[clutch.ports], S[clutch.ports] = clutch.reference, clutch.ratio
        if np.any(S != self._S):
            self._S, self._compliance = S, S[:, None] * self._D_V * S
        if not self._unsettled:
            self._compliance = self._D_V
        return r
