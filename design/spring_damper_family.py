"""Spring-damper couplings (20) as a family for the minimax programs (:mod:`manyhands.design.minimax`).

Units are those of :mod:`manyhands.design.frame`: ports scaled by S = Delta_D^{-1/2}, time by T.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from manyhands.design.basis import symmetric_units
from manyhands.design.conic import LinearMatrixProgram, coefficients
from manyhands.design.coupling import SpringDamper
from manyhands.design.frame import NormalisedLoop
from manyhands.design.minimax import Family
from manyhands.design.statespace import Matrix, symmetric_part

ComplexArray = NDArray[np.complex128]

ROOM = 1e-4  # of Lambda: J stays this far from zero, which keeps as much of the greatest stiffness back
_ROOM_LEVEL = 1e-5  # of Lambda, in the other conditions of the class


@dataclass(frozen=True, eq=False)
class SpringDamperFamily(Family):
    """Spring-damper couplings; x holds the lower triangles of k and b, block by block.

    In physical units K = S^{-1} k S^{-1}/T and B = S^{-1} b S^{-1}.

    The class is exactly J > 0, J - B >= 0 and, for (10) at the greatest level, with a = 2 kappa share,

        [ a Lambda - Phi_E    -a J       0            ]
        [      .              J + B      sqrt(1-a) J  ]  > 0,      Lambda = Delta_D/(2 kappa),  J = Lambda - (T/2) K.
        [      .                .        Lambda       ]

    Attributes:
        loop: the normalised loop.
        Phi: Phi_E in scaled ports, m x m.
        share: G_hat is (share Delta_D)-OSP.
    """

    loop: NormalisedLoop
    Phi: Matrix
    share: float

    @cached_property
    def _units(self) -> tuple[Matrix, ...]:
        return tuple(symmetric_units(len(ports)) for ports in self.loop.partition.blocks)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 2 * sum(len(units) for units in self._units)

    @property
    def affine(self) -> bool:
        """The response is not."""
        return False

    def grid(self, x: Matrix) -> Matrix:
        """Angles that see the poles of the loop and of the coupling."""
        return self.loop.grid(self.coupling(x).realisation(self.loop.T))

    def matrices(self, x: Matrix) -> list[tuple[Matrix, Matrix]]:
        """(k, b) of each block."""
        out, at = [], 0
        for units in self._units:
            count = len(units)
            k, b = x[at : at + count], x[at + count : at + 2 * count]
            out.append((np.tensordot(k, units, axes=1), np.tensordot(b, units, axes=1)))
            at += 2 * count
        return out

    def coupling(self, x: Matrix) -> SpringDamper:
        """The coupling in physical units."""
        K, B = [], []
        for (k, b), S in zip(self.matrices(x), self.loop.scaling, strict=True):
            inverse = np.linalg.inv(S)
            K.append(symmetric_part(inverse @ k @ inverse / self.loop.T))
            B.append(symmetric_part(inverse @ b @ inverse))
        partition = self.loop.partition
        return SpringDamper(partition.embed(K), partition.embed(B))

    def _blocks(self, x: Matrix, angles: Matrix) -> tuple[list[ComplexArray], ComplexArray]:
        s = (1.0 - np.exp(-1j * angles))[:, None, None]
        return [np.linalg.inv(k + b * s) for k, b in self.matrices(x)], s

    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G at ``angles``."""
        v, _ = self._blocks(x, angles)
        return self.loop.weighted.factors(self.loop.coupling(v, len(angles)), angles)[0]

    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """The slopes of G at ``angles``."""
        v, s = self._blocks(x, angles)
        slopes = []
        for v_i, units in zip(v, self._units, strict=True):
            stiff = -v_i[:, None] @ units @ v_i[:, None]
            slopes.append(np.concatenate([stiff, s[:, None] * stiff], axis=1))
        return self.loop.derivatives(v, slopes, angles)

    def conditions(self, x: Matrix) -> tuple[Matrix, ...]:
        """The left-hand sides, to be positive: k, J, J - B of each block, then (10)'s for all ports."""
        half = 0.5 / self.loop.kappa  # Lambda in scaled ports
        m, a = self.loop.partition.size, 2.0 * self.loop.kappa * self.share
        J, B, out = [], [], []
        for k, b in self.matrices(x):
            I = np.eye(len(k))
            J.append(half * I - k / 2.0)
            B.append(b)
            out += [k - ROOM * half * I, J[-1] - ROOM * half * I, J[-1] - b - _ROOM_LEVEL * half * I]
        J_all, B_all, I = self.loop.partition.embed(J), self.loop.partition.embed(B), np.eye(m)
        rows = [[a * half * I - self.Phi, -a * J_all], [-a * J_all, J_all + B_all]]
        if a < 1.0:
            side = np.sqrt(1.0 - a) * J_all
            rows = [[*rows[0], np.zeros((m, m))], [*rows[1], side], [np.zeros((m, m)), side, half * I]]
        whole = np.block(rows)
        return (*out, whole - _ROOM_LEVEL * half * np.eye(len(whole)))

    @cached_property
    def _coefficients(self) -> tuple[tuple[Matrix, Matrix], ...]:
        count = len(self.conditions(np.zeros(self.size)))

        def condition(i: int) -> tuple[Matrix, Matrix]:
            return coefficients(lambda x: self.conditions(x)[i], self.size)

        return tuple(condition(i) for i in range(count))

    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require the conditions of the class, exactly."""
        for constant, linear in self._coefficients:
            wide = np.zeros((program.size, *constant.shape))
            wide[: self.size] = linear
            program.positive(constant, wide)

    def stiffest(self) -> Matrix:
        """The member with the greatest trace of k; see :meth:`cheapest`."""
        unit = np.eye(self.size)
        cost = np.array([-sum(float(np.trace(k)) for k, _ in self.matrices(row)) for row in unit])
        return self.cheapest(cost, "the stiffest spring-damper coupling")

    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Every entry of k and b moves by a part of Lambda."""
        span = radius / (2.0 * self.loop.kappa)
        return x - span, x + span

    def restored(self, x: Matrix) -> Matrix | None:
        """X itself: the program keeps the conditions, with room."""
        return x
