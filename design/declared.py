"""An environment of which nothing is known but the level that it promises, and that somebody keeps it at run time.

A physics engine or a neural simulator has no matrices to prove anything about. Condition (10) of [Bianchini2010]_ asks
for no more than its level: a controller at its ports that keeps E_hat (-Phi_E)-ISP makes Theorem 3 hold as well as a
proof would, for the passivity argument cares neither for linearity nor for time invariance. A certificate of such a
loop is conditional, and says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from manyhands.design.environment import WithoutEnergy
from manyhands.design.errors import Infeasible
from manyhands.design.split import Split
from manyhands.design.statespace import Matrix, StateSpace, matrix


@dataclass(frozen=True, eq=False)
class DeclaredEnvironment(WithoutEnergy):
    """An environment known by its declared level alone.

    Attributes:
        ports: names of the m ports.
        level: Phi_E, m x m symmetric, N*s/m; 0 for a passive environment, above 0 for one that lacks passivity.
        enforced: whether a passivity controller keeps that level at run time.

    Raises:
        ValueError: the level is not symmetric, or has not the ports' size.
    """

    ports: tuple[str, ...]
    level: Matrix
    enforced: bool = True

    def __post_init__(self) -> None:
        m = len(self.ports)
        object.__setattr__(self, "level", matrix(self.level, m, m))
        if np.any(self.level != self.level.T):
            raise ValueError("environment.level: expected a symmetric matrix")

    def __eq__(self, other: object) -> bool:
        """Equal when every number is."""
        if not isinstance(other, DeclaredEnvironment):
            return NotImplemented
        same = (self.ports, self.enforced) == (other.ports, other.enforced)
        return same and np.array_equal(self.level, other.level)

    __hash__ = None  # type: ignore[assignment]  # matrices have none

    @property
    def order(self) -> int:
        """0: there is no Rest."""
        return 0

    def promised(self) -> Matrix:
        """The level that a design may count on.

        Raises:
            Infeasible: nobody keeps it.
        """
        if not self.enforced:
            raise Infeasible(
                "the environment is a model of which nothing is proved, and its level is not enforced",
                ("set 'enforce: true' in environment",),
            )
        return self.level

    def environment(self, T: float) -> StateSpace:
        """Refused: E is not known.

        Raises:
            Infeasible: always.
        """
        self._refuse()

    def split(self, T: float) -> Split:
        """Refused: E_hat is not known.

        Raises:
            Infeasible: always.
        """
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise Infeasible(
            "this needs the dynamics of the environment, and of a model nothing is known but its declared level",
            (
                "use an objective that asks nothing of the environment's dynamics: feasible or stiffest",
                "give the environment as a network or as matrices",
            ),
        )
