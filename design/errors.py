"""What can go wrong in a design, as errors of our own that say what to do next."""

from __future__ import annotations


class DesignError(Exception):
    """Base of the errors of this room."""


class Infeasible(DesignError):
    """No coupling of the wanted class, or not the given one, satisfies the conditions.

    Attributes:
        condition: which condition fails, with its number in [Bianchini2010]_ where it has one.
        relax: what could be changed so that it holds, each with a figure where one is known.
    """

    def __init__(self, condition: str, relax: tuple[str, ...]) -> None:
        self.condition = condition
        self.relax = relax
        super().__init__(condition + ("; to relax: " + "; or ".join(relax) if relax else ""))


class NotConverged(DesignError):
    """The cone complementarity iteration reached its cap before W Z = I."""


class SolverFailure(DesignError):
    """The solver gave no usable answer, or one that does not survive a check of its own numbers."""


class TooLarge(DesignError):
    """The loop is larger than the programs of this version can take."""


class CertificateError(DesignError):
    """A certificate file cannot be read, or contradicts itself."""
