"""The errors of a design; their messages name what failed and what could be changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any, Protocol, Self


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


class TriedChange(Protocol):
    """A change with which a design was tried, and is certified; as a text it is the whole of its sentence."""

    @property
    def changes(self) -> Mapping[str, Any]:
        """The values that were tried, by path of a session's keys."""


class Infeasible(DesignError):
    """No coupling of the wanted class satisfies the conditions, or the given coupling does not.

    What would help is searched when it is asked for, by trying it, which may take seconds. A design alone knows no keys
    of a session, and so no remedies; ``mh.certify`` and the commands do.

    Attributes:
        condition: the condition that fails, with its number in [Bianchini2010]_ if it has one.
        search: tries what would help, and yields what does as soon as it was tried.
        untried: what the latest search has not tried to the end, for lack of time.

    Example:
        >>> import manyhands as mh
        >>> given = {"coupling": "given", "stiffness": 3000.0}
        >>> try:
        ...     mh.certify(mh.load("example1", {"design": given}))
        ... except mh.Infeasible as error:
        ...     remedy = error.remedies[0]
        >>> print(remedy)
        a stiffness below 2740 N/m: --set design.stiffness=2737.1 is certified at 2737 N/m
        >>> mh.certify(mh.load("example1", {"design": given, **remedy.changes})).stiffness[0, 0].item()  # N/m
        2737.1
    """

    def __init__(self, condition: str) -> None:
        self.condition = condition
        self.search: Callable[[], Iterable[TriedChange]] = tuple
        self.untried: list[str] = []
        super().__init__(condition)

    def searching(self, search: Callable[[], Iterable[TriedChange]]) -> Self:
        """This error, with the search of what helps."""
        self.search = search
        return self

    @cached_property
    def remedies(self) -> tuple[TriedChange, ...]:
        """Changes with which a design was tried and is certified, with what they give."""
        return tuple(self.search())

    @property
    def relax(self) -> tuple[str, ...]:
        """:attr:`remedies` in words."""
        return tuple(map(str, self.remedies))


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
