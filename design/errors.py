"""The errors of a design; their messages name what failed and what could be changed."""

from __future__ import annotations


class DesignError(Exception):
    """Base class of the errors of ``manyhands.design``."""


class Infeasible(DesignError):
    """No coupling of the wanted class satisfies the conditions, or the given coupling does not.

    Attributes:
        condition: the condition that fails, with its number in [Bianchini2010]_ if it has one.
        relax: changes that could make the condition hold, each with a figure if one is known.
    """

    def __init__(self, condition: str, relax: tuple[str, ...]) -> None:
        self.condition = condition
        self.relax = relax
        super().__init__(condition + ("; to relax: " + "; or ".join(relax) if relax else ""))


class NotConverged(DesignError):
    """The cone complementarity iteration reached its cap before W Z = I."""


class SolverFailure(DesignError):
    """The solver gave no usable answer, or an answer that does not survive a check of its numbers."""


class TooLarge(DesignError):
    """The loop is larger than the programs of this version can handle."""


class CertificateError(DesignError):
    """A certificate file cannot be read, or contradicts itself."""
