"""The leaves of a session: names, quantities with their units, lists by axis, matrices.

Pydantic's own messages tell a programmer which type was missed. A session is written by hand, so each leaf here
refuses in the words of the field instead: what the quantity is, its unit, its bounds. Every refusal is a
:class:`Problem`, and one validator may report several.

Quantities known only to lie between two values, written ``{between: [low, high]}``.

A certificate of a session with intervals claims stability for every value in them, so what is read here keeps both
ends; nothing turns an interval into a number by itself.

What a device may exert and reach, axis by axis: checked at the device itself, last before its actuator.

A certificate speaks of energy and not of size: a session can be certified and still ask for more than a mechanism or a
hand should bear. The defaults stop nothing but a runaway; who knows the device states its own.

What a device may put into the *others* is watched by the environment, which scales a party beyond it down
(docs/decisions/0029-energy-budgets.md). No honest device puts more into the world than its greatest force at its
greatest speed, or over its whole reach; and no hand more than :data:`HAND_POWER` and :data:`HAND_ENERGY`.

From what pydantic reports to the one :class:`SessionError` that a person reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Annotated, Any, Final, NamedTuple, TypeAlias, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError, ValidationInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from manyhands.launch.session.errors import SessionError, key_text, listed, one_of, show
from manyhands.launch.session.limits import (
    DEFAULT_DISPLACEMENT,
    DEFAULT_FORCE,
    DEFAULT_SPEED,
    HAND_ENERGY,
    HAND_POWER,
    LONGEST_PERIOD,
    MAX_DOF,
    MAX_MAGNITUDE,
    MIN_POSITIVE,
    SHORTEST_PERIOD,
)
from manyhands.launch.session.yaml import KeyPath, SessionTree

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


BETWEEN: Final = "between"
_FORM: Final = "{between: [low, high]}"


@dataclass(frozen=True, slots=True)
class Interval:
    """All numbers from ``low`` to ``high``, ``low < high``, in the unit of the quantity.

    Attributes:
        low: the lower end.
        high: the higher end.
    """

    low: float
    high: float

    @classmethod
    def of(cls, value: float | Interval) -> Interval:
        """The interval of a quantity that may be one; a number is an interval without width."""
        return value if isinstance(value, Interval) else cls(value, value)

    @property
    def nominal(self) -> float:
        """The middle: what a run uses, which needs one value."""
        return (self.low + self.high) / 2.0


@dataclass(frozen=True, slots=True)
class LevelInterval:
    """All diagonal OSP levels between two, axis by axis, m_i x m_i in N·s/m."""

    low: Rows
    high: Rows


def is_interval(value: object) -> bool:
    """Whether a value is written as an interval, rightly or not."""
    return isinstance(value, Mapping)


def ends(value: object, check: Callable[[object], Any]) -> tuple[Any, Any]:
    """Both ends of ``{between: [low, high]}``, each checked; their order is the caller's to check."""
    if not isinstance(value, Mapping):
        raise refuse(show(value), _FORM)
    for key in value:
        if key != BETWEEN:
            raise refuse(f"the unknown key {show(key)}", one_of((BETWEEN,), key), at=(key,))
    pair = value.get(BETWEEN)
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        found = show(pair) if BETWEEN in value else f"no key {BETWEEN!r}"
        raise refuse(found, f"{_FORM}: two ends", at=(BETWEEN,) if BETWEEN in value else ())
    try:
        low, high = each(check, pair)
    except PydanticCustomError as error:
        raise refusal(*(problem._replace(at=(BETWEEN, *problem.at)) for problem in problems_of(error))) from None
    return low, high


def ordered(low: float, high: float) -> None:
    """Refuse an interval that is empty."""
    if low > high:
        raise refuse(
            f"the lower end {low:g} above the higher end {high:g}", "[low, high], low at most high", (BETWEEN,)
        )


@dataclass(frozen=True, slots=True)
class UncertainQuantity:
    """A quantity, or an interval of it; called with a value, it returns a ``float``, an interval, or refuses."""

    quantity: Quantity

    def __call__(self, value: object) -> float | Interval:
        """The number or interval; an interval without width is a number."""
        if isinstance(value, Interval):
            value = plain(value)
        if isinstance(value, list | tuple):
            raise refuse(show(value), f"{self.quantity.expected}, or {_FORM}")
        if not is_interval(value):
            return self.quantity(value)
        low, high = ends(value, self.quantity)
        ordered(low, high)
        return low if low == high else Interval(low, high)


def plain(value: float | Interval) -> float | dict[str, list[float]]:
    """The quantity as a session file has it."""
    return {BETWEEN: [value.low, value.high]} if isinstance(value, Interval) else value


_AS_WRITTEN: Final = PlainSerializer(plain)
UncertainMass: TypeAlias = Annotated[float | Interval, BeforeValidator(UncertainQuantity(MASS)), _AS_WRITTEN]
UncertainDamping: TypeAlias = Annotated[float | Interval, BeforeValidator(UncertainQuantity(DAMPING)), _AS_WRITTEN]
UncertainStiffness: TypeAlias = Annotated[float | Interval, BeforeValidator(UncertainQuantity(STIFFNESS)), _AS_WRITTEN]


_FORCE: Final = Quantity("a limit of the force", "N", above=0.0, smallest=MIN_POSITIVE)
_DISPLACEMENT: Final = Quantity("a limit of the displacement", "m", above=0.0, smallest=MIN_POSITIVE)
_SPEED: Final = Quantity("a limit of the speed", "m/s", above=0.0, smallest=MIN_POSITIVE)
_POWER: Final = Quantity("a power put into the others", "W", above=0.0, smallest=MIN_POSITIVE)
_ENERGY: Final = Quantity("an energy put into the others", "J", above=0.0, smallest=MIN_POSITIVE)


def _power(value: object, info: ValidationInfo) -> object:
    """P, W; by default the greatest force at the greatest speed, summed over the axes, and at most a hand's."""
    return _POWER(value) if value is not None else min(HAND_POWER, _products(info, "speed"))


def _energy(value: object, info: ValidationInfo) -> object:
    """E, J; by default the greatest force over the reach, there and back, and at most a hand's."""
    return _ENERGY(value) if value is not None else min(HAND_ENERGY, 2.0 * _products(info, "displacement"))


def _products(info: ValidationInfo, quantity: str) -> float:
    """The sum over the axes of force times ``quantity``; infinite where one of the two was refused."""
    forces, others = info.data.get("force"), info.data.get(quantity)
    if not forces or not others or len(forces) != len(others):
        return math.inf
    return float(sum(force * other for force, other in zip(forces, others, strict=True)))


class PortLimits(SessionModel):
    """The greatest sizes at a device's ports; every tuple has one entry for each axis.

    Units are those of a translational axis; of a rotational one N·m, rad and rad/s. A force beyond its limit is
    clipped; beyond a displacement or a speed the device lets go. Power and energy are the whole device's.
    """

    dof: Dof = Field(alias=DEVICE_AXES, exclude=True, repr=False)
    force: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_FORCE))] = defaulted(
        DEFAULT_FORCE, "the greatest force in N that is applied, either way: a number, or one for each axis"
    )
    displacement: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_DISPLACEMENT))] = defaulted(
        DEFAULT_DISPLACEMENT, "the greatest displacement in m from 0: a number, or one for each axis"
    )
    speed: Annotated[tuple[float, ...], BeforeValidator(PerAxis(_SPEED))] = defaulted(
        DEFAULT_SPEED, "the greatest speed in m/s: a number, or one for each axis"
    )
    power: Annotated[float, BeforeValidator(_power)] = defaulted(
        None, "the power in W that it may put into the other users for as long as it likes"
    )
    energy: Annotated[float, BeforeValidator(_energy)] = defaulted(
        None, "the energy in J that it may put into the other users at once"
    )


_COMPARED: Final = 64  # unknown keys of one part that are compared with a missing one


def problems_in(error: ValidationError, model: type[SessionModel]) -> Iterator[Problem]:
    """The problems of a failed validation of ``model``, each at its full path."""
    details = error.errors(include_url=False)
    unknown: dict[KeyPath, list[str]] = {}
    for detail in details:
        if detail["type"] == "extra_forbidden":
            unknown.setdefault(detail["loc"][:-1], []).append(str(detail["loc"][-1]))
    for detail in details:
        if detail["type"] == "missing":
            misspelt = unknown.get(detail["loc"][:-1], [])[:_COMPARED]
            if get_close_matches(str(detail["loc"][-1]), misspelt, n=1):
                continue  # the misspelt key is what to tell, not that the right one is missing
        yield from _translated(detail, model)


def nulls_in(data: object, path: KeyPath = ()) -> Iterator[Problem]:
    """Every key that is written without a value: left out and left empty are not the same."""
    if data is None:
        yield Problem(path, "nothing", "a value, or the key left out")
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, child in children:
        yield from nulls_in(child, (*path, step))


def first_error(tree: SessionTree, problems: list[Problem]) -> SessionError:
    """The error for the first problem in the order of the file; overrides come before it."""
    located = []
    seen = set()
    for problem in problems:
        path, place = tree.locate(problem.at)
        # what was written once may fail once for each axis
        if (path, problem.found) not in seen:
            seen.add((path, problem.found))
            located.append((place.line or 0, place, path, problem))
    _, place, path, problem = min(located, key=lambda entry: entry[0])
    return SessionError(
        place.source, place.line, key_text(path), problem.found, problem.expected, more=len(located) - 1
    )


def _translated(detail: ErrorDetails, model: type[SessionModel]) -> Iterator[Problem]:
    path: KeyPath = detail["loc"]
    match detail["type"]:
        case kind if kind == PROBLEMS:
            for problem in detail["ctx"]["problems"]:
                yield problem._replace(at=(*path, *problem.at))
        case "missing":
            inner = _model_at(model, path[:-1])
            meaning = keys_of(inner).get(str(path[-1]), "") if inner else ""
            yield Problem(path[:-1], f"no key {path[-1]!r}", f"{path[-1]}, {meaning}")
        case "extra_forbidden":
            inner = _model_at(model, path[:-1])
            valid = keys_of(inner) if inner else ()
            yield Problem(path, f"the unknown key {show(path[-1])}", one_of(valid, path[-1]))
        case "model_type":
            inner = _model_at(model, path)
            keys = f" with the keys {listed(keys_of(inner))}" if inner else ""
            yield Problem(path, show(detail["input"]), f"a mapping{keys}")
        case _:
            yield Problem(path, show(detail["input"]), detail["msg"])


def keys_of(model: type[SessionModel]) -> dict[str, str]:
    """The keys that a part may have, with what each is."""
    named = {field.alias or name: field.description or "" for name, field in model.model_fields.items()}
    return {name: meaning for name, meaning in named.items() if name != DEVICE_AXES}


def _model_at(model: type[SessionModel], path: KeyPath) -> type[SessionModel] | None:
    """The model that stands at a path, found by walking the annotations."""
    current: Any = model
    for step in path:
        if isinstance(current, type) and issubclass(current, SessionModel):
            fields = {field.alias or name: field for name, field in current.model_fields.items()}
            current = fields[str(step)].annotation if step in fields else None
        else:
            current = next(iter(get_args(current)[-1:]), None) if get_origin(current) is dict else _item(current)
        current = _without_none(current)
    return current if isinstance(current, type) and issubclass(current, SessionModel) else None


def _item(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is tuple else None


def _without_none(annotation: Any) -> Any:
    """X of ``X | None``."""
    options = [option for option in get_args(annotation) if option is not type(None)]
    return options[0] if type(None) in get_args(annotation) and len(options) == 1 else annotation
