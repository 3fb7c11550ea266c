"""The errors of a design; their messages name what failed and what could be changed."""

from __future__ import annotations


class DesignError(Exception):
    """Base class of the errors of ``manyhands.design``.

    Example:
        >>> import manyhands as mh
        >>> session = mh.load("example1", {"environment.delay": 1})
        >>> try:
        ...     mh.certify(session)
        ... except mh.DesignError as error:
        ...     print(type(error).__name__)
        Infeasible
    """


class Infeasible(DesignError):
    """No coupling of the wanted class satisfies the conditions, or the given coupling does not.

    Attributes:
        condition: the condition that fails, with its number in [Bianchini2010]_ if it has one.
        relax: changes that could make the condition hold, each with a figure if one is known.

    Example:
        >>> import manyhands as mh
        >>> given = {"coupling": "given", "stiffness": 3000.0}
        >>> try:
        ...     mh.certify(mh.load("example1", {"design": given}))
        ... except mh.Infeasible as error:
        ...     print(error.relax[0])
        a stiffness below 2740 N/m
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


class OldCertificate(CertificateError):
    """A certificate file is of a format version that is read no more.

    Attributes:
        version: of the file's format.
        reader: the last release of manyhands that reads it.
    """

    def __init__(self, name: str, version: int, reader: str) -> None:
        self.version, self.reader = version, reader
        super().__init__(
            f"{name}: found a certificate of format version {version}, which manyhands {reader} is the last to read; "
            "design the session anew"
        )
