"""The leaves of a session: names, quantities with their units, lists by axis, matrices.

Pydantic's own messages tell a programmer which type was missed. A session is written by hand, so each leaf here
refuses in the words of the field instead: what the quantity is, its unit, its bounds. Every refusal is a
:class:`Problem`, and one validator may report several.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo
from pydantic_core import PydanticCustomError

from manyhands.launch.session.error import one_of, show
from manyhands.launch.session.limits import (
    LONGEST_PERIOD,
    MAX_DOF,
    MAX_MAGNITUDE,
    MIN_POSITIVE,
    SHORTEST_PERIOD,
)
from manyhands.launch.session.source import KeyPath

PROBLEMS: Final = "session_problems"
"""Type of the pydantic errors that carry a tuple of :class:`Problem` as ``ctx["problems"]``."""

DEVICE_AXES: Final = "(axes of the device)"
"""Key under which a device tells its parts how many axes it has; no session file can sensibly use it."""

Rows: TypeAlias = tuple[tuple[float, ...], ...]
"""A matrix, row by row."""


class SessionModel(BaseModel):
    """A part of a session: frozen, strict, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def defaulted(value: object, description: str) -> Any:
    """A field whose default passes through its validators, which need the rest of the part to make it complete."""
    return Field(default=value, validate_default=True, description=description)


def optional(check: Callable[[object], Any]) -> Callable[[object], Any]:
    """The check, for a value that may be absent."""
    return lambda value: None if value is None else check(value)


class Problem(NamedTuple):
    """One thing that is wrong: where below the validated value, what was found, what would be right."""

    at: KeyPath
    found: str
    expected: str


def refusal(*problems: Problem) -> PydanticCustomError:
    """The error by which a validator hands problems to pydantic."""
    return PydanticCustomError(PROBLEMS, "refused", {"problems": problems})


def refuse(found: str, expected: str, at: KeyPath = ()) -> PydanticCustomError:
    """The error for a single problem."""
    return refusal(Problem(at, found, expected))


@dataclass(frozen=True, slots=True)
class Quantity:
    """A finite real number with a unit and bounds; called with a value, it returns a ``float`` or refuses.

    Attributes:
        what: with its article, such as ``a mass``.
        unit: ``kg``; empty for a number without one.
        above: the value must be greater than this.
        least: the value must be at least this.
        most: the value must be at most this.
        smallest: no other value than 0 may be smaller in size.
        magnitude: no value may be larger in size.
    """

    what: str
    unit: str = ""
    above: float | None = None
    least: float | None = None
    most: float | None = None
    smallest: float = 0.0
    magnitude: float = MAX_MAGNITUDE

    @property
    def expected(self) -> str:
        """What would be right, in words."""
        unit = f" in {self.unit}" if self.unit else ""
        at_most = f" and at most {self.most:g}" if self.most is not None else ""
        bound = f" greater than {self.above:g}{at_most}" if self.above is not None else ""
        if self.least is not None:
            between = f" from {self.least:g} to {self.most:g}" if self.most is not None else ""
            bound = between or f" of at least {self.least:g}"
        return f"{self.what}{unit}{bound}"

    def __call__(self, value: object) -> float:
        """The value as a float."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise refuse(show(value), self._expected_instead_of(value))
        if not math.isfinite(value):
            raise refuse(show(value), f"{self.expected}, and finite")
        low = self.above is not None and value <= self.above
        low = low or (self.least is not None and value < self.least)
        if low or (self.most is not None and value > self.most):
            raise refuse(show(value), self.expected)
        if value != 0.0 and not self.smallest <= abs(value) <= self.magnitude:
            raise refuse(show(value), f"{self.expected}, of a size from {self.smallest:g} to {self.magnitude:g}")
        return float(value)

    def _expected_instead_of(self, value: object) -> str:
        if not isinstance(value, str) or not re.match(r"\s*[-+]?\.?[0-9]", value):
            return self.expected
        quoted = re.fullmatch(r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*", value)
        unit = f" in {self.unit}" if self.unit else ""
        return f"a number{unit}, without {'quotes' if quoted or not self.unit else 'the unit'}"


MASS: Final = Quantity("a mass", "kg", above=0.0, smallest=MIN_POSITIVE)
HAND_MASS: Final = Quantity("a mass", "kg", least=0.0)
DAMPING: Final = Quantity("a damping", "N·s/m", least=0.0)
STIFFNESS: Final = Quantity("a stiffness", "N/m", least=0.0)
OSP_LEVEL: Final = Quantity("an OSP level", "N·s/m", above=0.0, smallest=MIN_POSITIVE)
OSP_ENTRY: Final = Quantity("an entry of the OSP level", "N·s/m")
PERIOD: Final = Quantity("a period", "s", least=SHORTEST_PERIOD, most=LONGEST_PERIOD)

Period: TypeAlias = Annotated[float, BeforeValidator(PERIOD)]


@dataclass(frozen=True, slots=True)
class Whole:
    """A whole number of something, within bounds; called with a value, it returns an ``int`` or refuses."""

    what: str
    least: int
    most: int

    def __call__(self, value: object) -> int:
        """The number."""
        if isinstance(value, bool) or not isinstance(value, int) or not self.least <= value <= self.most:
            raise refuse(show(value), f"a whole number of {self.what} from {self.least} to {self.most}")
        return value


Dof: TypeAlias = Annotated[int, BeforeValidator(Whole("degrees of freedom", 1, MAX_DOF))]


@dataclass(frozen=True, slots=True)
class Name:
    """A name of one kind; called with a value, it returns the name or refuses."""

    what: str
    pattern: str
    words: str

    def __call__(self, value: object) -> str:
        """The name."""
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise refuse(show(value), f"{self.what}: {self.words}")
        return value


_REST: Final = "then at most 31 lowercase letters, digits or _"
SESSION_NAME: Final = Name(
    "a session name", "[a-z][a-z0-9-]{0,47}", "a lowercase letter, then at most 47 lowercase letters, digits or -"
)
AXIS_NAME: Final = Name("an axis name", "[a-z0-9][a-z0-9_]{0,31}", f"a lowercase letter or digit, {_REST}")
SessionName: TypeAlias = Annotated[str, BeforeValidator(SESSION_NAME)]


def part_name(what: str) -> Name:
    """The form of a device's, coupling's or mass's name."""
    return Name(what, "[a-z][a-z0-9_]{0,31}", f"a lowercase letter, {_REST}")


@dataclass(frozen=True, slots=True)
class Choice:
    """One word of a few."""

    words: tuple[str, ...]

    def __call__(self, value: object) -> object:
        """The word."""
        if isinstance(value, str) and value in self.words:
            return value
        raise refuse(show(value), one_of(self.words, value))


@dataclass(frozen=True, slots=True)
class NamedParts:
    """A mapping from names to parts, of a bounded size; ``least`` is 0 or 1."""

    name: Name
    most: int
    least: int = 1

    def __call__(self, value: object) -> object:
        """The mapping, its keys checked."""
        if not isinstance(value, Mapping) or not self.least <= len(value) <= self.most:
            entries = f"{self.least} to {self.most} entries, each {self.name.what} and its value"
            raise refuse(show(value), f"a mapping with {entries}")
        problems = [
            Problem((key,), f"the name {show(key)}", f"{self.name.what}: {self.name.words}")
            for key in value
            if not isinstance(key, str) or not re.fullmatch(self.name.pattern, key)
        ]
        if problems:
            raise refusal(*problems)
        return value


@dataclass(frozen=True, slots=True)
class Items:
    """A list of a bounded length, handed on as a tuple; with ``item``, each entry is checked by it."""

    what: str
    most: int
    item: Callable[[object], Any] | None = None
    least: int = 1

    def __call__(self, value: object) -> tuple[Any, ...]:
        """The entries."""
        if not isinstance(value, list | tuple) or not self.least <= len(value) <= self.most:
            raise refuse(show(value), f"a list of {self.least} to {self.most} {self.what}")
        return tuple(value) if self.item is None else each(self.item, value)


def problems_of(error: PydanticCustomError) -> tuple[Problem, ...]:
    """The problems that a refusal carries."""
    problems: tuple[Problem, ...] = (error.context or {})["problems"]
    return problems


def each(check: Callable[[object], Any], values: Sequence[object]) -> tuple[Any, ...]:
    """Check every entry, and refuse all that are wrong at once, each at its position."""
    checked: list[Any] = []
    problems: list[Problem] = []
    for index, value in enumerate(values):
        try:
            checked.append(check(value))
        except PydanticCustomError as error:
            problems += [problem._replace(at=(index, *problem.at)) for problem in problems_of(error)]
    if problems:
        raise refusal(*problems)
    return tuple(checked)


def each_named(check: Callable[[object], Any], values: Mapping[str, object]) -> dict[str, Any]:
    """Check every value, and refuse all that are wrong at once, each at its name."""
    names = tuple(values)
    try:
        return dict(zip(names, each(check, tuple(values.values())), strict=True))
    except PydanticCustomError as error:
        named = [problem._replace(at=(names[int(problem.at[0])], *problem.at[1:])) for problem in problems_of(error)]
        raise refusal(*named) from None


@dataclass(frozen=True, slots=True)
class PerAxis:
    """One value for all axes, or a list with one for each; becomes a tuple as long as the part's ``dof``."""

    check: Callable[[object], Any]

    def __call__(self, value: object, info: ValidationInfo) -> object:
        """The values, one for each axis."""
        dof = info.data.get("dof", 1)
        if not isinstance(value, list | tuple):
            return (self.check(value),) * dof
        if len(value) != dof and "dof" in info.data:
            raise refuse(show(value), f"one value, or a list of {dof}, one for each axis")
        return each(self.check, value[:MAX_DOF])


def matrix(check: Callable[[object], Any], value: object, rows: int, columns: int) -> tuple[tuple[Any, ...], ...]:
    """A list of rows of checked entries, ``rows`` x ``columns``."""

    def row(entries: object) -> tuple[Any, ...]:
        if not isinstance(entries, list | tuple) or len(entries) != columns:
            raise refuse(show(entries), f"a row of {columns} entries ({rows} x {columns})")
        return each(check, entries)

    if not isinstance(value, list | tuple) or len(value) != rows:
        raise refuse(show(value), f"{rows} x {columns} entries, row by row")
    return each(row, value)


def unsymmetric(rows: Rows) -> Problem | None:
    """The first pair of entries that differ across the diagonal."""
    for i in range(len(rows)):
        for j in range(i):
            if rows[i][j] != rows[j][i]:
                found = f"{rows[i][j]!r} in row {i + 1}, column {j + 1} and {rows[j][i]!r} across the diagonal"
                return Problem((i, j), found, "a symmetric matrix")
    return None


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise refuse(show(value), "true or false")
    return value


Flag: TypeAlias = Annotated[bool, BeforeValidator(_flag)]
"""True or false, and nothing that only looks like it."""
