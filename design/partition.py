"""The block structure BD(m; m_1, ..., m_N) of the virtual coupling: which ports belong to which block.

Blocks need not be contiguous, nor follow the devices ([Bianchini2010]_, Remark 4). A matrix *has the
structure* when every entry between ports of different blocks is exactly zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from manyhands.design.statespace import Matrix, StateSpace


@dataclass(frozen=True)
class Partition:
    """A partition of the ports 0 ... m-1 into named blocks.

    Attributes:
        names: one name for each block.
        blocks: the ports of each block, in the block's own order.

    Raises:
        ValueError: a port in no block or in two, an empty block, or two blocks of one name.
    """

    names: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        ports = sorted(port for block in self.blocks for port in block)
        if ports != list(range(len(ports))) or not all(self.blocks):
            raise ValueError(f"expected every port in exactly one block, found {self.blocks}")
        if len(set(self.names)) != len(self.names) or len(self.names) != len(self.blocks):
            raise ValueError(f"expected one distinct name for each block, found {self.names}")

    @property
    def size(self) -> int:
        """Number m of ports."""
        return sum(len(block) for block in self.blocks)

    def mask(self) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        """M x m, true where an entry joins two ports of the same block."""
        out = np.zeros((self.size, self.size), dtype=np.bool_)
        for block in self.blocks:
            out[np.ix_(block, block)] = True
        return out

    def admits(self, M: Matrix) -> bool:
        """Whether the m x m matrix M has the structure, exactly."""
        return not np.any(M[~self.mask()])

    def selections(self) -> tuple[Matrix, ...]:
        """S_i (m x m_i) for each block: S_i^T y are the block's entries of y."""
        return tuple(np.eye(self.size)[:, list(block)] for block in self.blocks)

    def restrict(self, M: Matrix) -> tuple[Matrix, ...]:
        """The diagonal blocks S_i^T M S_i of an m x m matrix."""
        return tuple(M[np.ix_(block, block)] for block in self.blocks)

    def embed(self, parts: Sequence[Matrix]) -> Matrix:
        """The m x m matrix with the structure whose blocks are ``parts``."""
        out = np.zeros((self.size, self.size))
        for block, part in zip(self.blocks, parts, strict=True):
            out[np.ix_(block, block)] = part
        return out

    def join(self, systems: Sequence[StateSpace]) -> StateSpace:
        """The system with the structure whose blocks are ``systems``, states stacked by block."""
        order = sum(s.order for s in systems)
        A, B = np.zeros((order, order)), np.zeros((order, self.size))
        C, D = np.zeros((self.size, order)), np.zeros((self.size, self.size))
        at = 0
        for block, s in zip(self.blocks, systems, strict=True):
            states, ports = range(at, at + s.order), list(block)
            A[np.ix_(states, states)], B[np.ix_(states, ports)] = s.A, s.B
            C[np.ix_(ports, states)], D[np.ix_(ports, ports)] = s.C, s.D
            at += s.order
        return StateSpace(A, B, C, D)
