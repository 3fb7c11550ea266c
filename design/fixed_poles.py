"""Linear couplings over fixed poles as a family for the minimax programs (:mod:`manyhands.design.minimax`).

The convex set of :mod:`manyhands.design.basis`, block by block; loop shaping is affine over it, so that its
optimum over the basis is global. Units are those of :mod:`manyhands.design.frame`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from manyhands.design.basis import FixedPoleBlock
from manyhands.design.conic import LinearMatrixProgram
from manyhands.design.frame import NormalisedLoop
from manyhands.design.hinfinity import frequency_grid
from manyhands.design.minimax import Family
from manyhands.design.statespace import Matrix, StateSpace

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class FixedPoleFamily(Family):
    """Linear couplings over given poles; x holds the gains of all blocks, then their storage matrices.

    Attributes:
        loop: the normalised loop.
        blocks: the unknowns of each block.
        room: least eigenvalue asked of the blocks' conditions.
    """

    loop: NormalisedLoop
    blocks: tuple[FixedPoleBlock, ...]
    room: float

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(block.size for block in self.blocks)

    @property
    def affine(self) -> bool:
        """Loop shaping is."""
        return self.loop.aim.objective == "loop-shaping"

    def grid(self, x: Matrix) -> Matrix:
        """Angles that see the poles of the loop and of the coupling."""
        return self.loop.grid(self.coupling(x))

    def coupling(self, x: Matrix) -> StateSpace:
        """V in physical units."""
        blocks = zip(self.blocks, self.parts(x), strict=True)
        return self.loop.partition.join(
            [self.loop.physical(block.realisation(part), i) for i, (block, part) in enumerate(blocks)]
        )

    @cached_property
    def _sizes(self) -> tuple[Matrix, ...]:
        """Of each block's gains: the greatest modulus of their functions."""
        return tuple(
            block.sizes(frequency_grid(np.array(block.basis.poles, dtype=np.complex128))) for block in self.blocks
        )

    @cached_property
    def positions(self) -> tuple[NDArray[np.intp], ...]:
        """Where each block's unknowns are in x."""
        out, gains, rest = [], 0, sum(block.gains for block in self.blocks)
        for block in self.blocks:
            storage = block.size - block.gains
            out.append(np.concatenate([np.arange(gains, gains + block.gains), np.arange(rest, rest + storage)]))
            gains, rest = gains + block.gains, rest + storage
        return tuple(out)

    def parts(self, x: Matrix) -> list[Matrix]:
        """Each block's unknowns."""
        return [x[position] for position in self.positions]

    def joined(self, parts: Sequence[Matrix]) -> Matrix:
        """The vector of unknowns from each block's unknowns."""
        x = np.zeros(self.size)
        for position, part in zip(self.positions, parts, strict=True):
            x[position] = part
        return x

    def _slopes(self, angles: Matrix) -> list[ComplexArray]:
        return [block.derivatives(angles) for block in self.blocks]

    def _blocks(self, x: Matrix, slopes: Sequence[ComplexArray]) -> list[ComplexArray]:
        return [
            np.tensordot(slope, part[: block.gains], axes=((1,), (0,)))
            for block, part, slope in zip(self.blocks, self.parts(x), slopes, strict=True)
        ]

    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G at ``angles``."""
        V = self.loop.coupling(self._blocks(x, self._slopes(angles)), len(angles))
        return self.loop.weighted.factors(V, angles)[0]

    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """The slopes of G at ``angles``."""
        slopes = self._slopes(angles)
        return self.loop.derivatives(self._blocks(x, slopes), slopes, angles)

    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require the conditions of every block, exactly."""
        for block, position in zip(self.blocks, self.positions, strict=True):
            block.constrain(program, position, self.room)

    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Gains move by a part of the block's static compliance, measured by the size of their functions."""
        spans = []
        for block, part, sizes in zip(self.blocks, self.parts(x), self._sizes, strict=True):
            static = np.tensordot(part[: block.gains], block.derivatives(np.zeros(1))[0].real, axes=1)
            spans.append(radius * max(float(np.max(np.abs(static))), block.kappa) / sizes)
        gains, span = self.gains(x), np.concatenate(spans)
        return gains - span, gains + span

    def restored(self, x: Matrix) -> Matrix | None:
        """X itself: the program keeps the conditions, with room."""
        return x

    def gains(self, x: Matrix) -> Matrix:
        """C and D of all blocks."""
        return x[: sum(block.gains for block in self.blocks)]

    def nearest(self, gains: Matrix) -> Matrix:
        """The member whose gains are nearest to ``gains``, each measured by the size of its function.

        Raises:
            ProgramInfeasible: there is no member.
            SolverFailure: the solver gave no usable answer.
        """
        count = len(gains)
        program = LinearMatrixProgram(self.size + 1)
        self.constrain(program, np.zeros(self.size))
        rows = np.zeros((count, self.size + 1))
        rows[:, :count] = np.diag(np.concatenate(self._sizes))
        offset = rows[:, :count] @ gains
        rows[:, -1] = 1.0
        program.nonnegative(-offset, rows)
        rows = -rows
        rows[:, -1] = 1.0
        program.nonnegative(offset, rows)
        cost = np.zeros(self.size + 1)
        cost[-1] = 1.0
        return program.solve(cost, "the nearest passive coupling")[:-1]

    def stiffest(self) -> Matrix:
        """The member with the least static compliance, trace v(1) summed over the blocks; see :meth:`cheapest`."""
        traces = [np.trace(b.derivatives(np.zeros(1))[0].real, axis1=1, axis2=2) for b in self.blocks]
        cost = np.zeros(self.size)
        cost[: sum(len(t) for t in traces)] = np.concatenate(traces)
        return self.cheapest(cost, "the stiffest linear coupling")

    def roomiest(self, most: float) -> Matrix:
        """The member with the most room in every condition among those with v(1) <= ``most`` kappa I.

        Raises:
            ProgramInfeasible: there is no member.
            SolverFailure: the solver gave no usable answer.
        """
        program = LinearMatrixProgram(self.size + 1)
        for block, position in zip(self.blocks, self.positions, strict=True):
            block.constrain(program, position, self.room, spare=self.size)
            static = block.derivatives(np.zeros(1))[0].real
            linear = np.zeros((self.size + 1, block.ports, block.ports))
            linear[position[: block.gains]] = -static
            program.positive(most * block.kappa * np.eye(block.ports), linear)
        row = np.zeros((1, self.size + 1))
        row[0, -1] = 1.0
        program.nonnegative(np.zeros(1), row)
        cost = np.zeros(self.size + 1)
        cost[-1] = -1.0
        return program.solve(cost, "a linear coupling with room")[:-1]
