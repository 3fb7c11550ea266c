"""The values of a session file: names, quantities with units, intervals, limits, matrices, and their error messages.

Pydantic's own messages are for programmers: they name the type that was expected. People write session files by hand,
so each check here names the quantity, its unit and its bounds instead. A refused value is a :class:`Problem`; one check
may report several. :func:`first_error` turns what pydantic collected into the one :class:`SessionError` that is shown.

An interval, ``{between: [low, high]}``, is a quantity of which only two bounds are known. A certificate of a session
with intervals claims stability for every value in them. Both ends are therefore kept; nothing turns an interval into a
number without being asked.

Limits bound what a device may exert and reach, axis by axis; the device checks them last before its actuator. A
certificate bounds energy, not size: a certified session can still demand more than a mechanism or a hand should bear.
The default limits only stop a runaway; the author of a session states the limits of the real device.

The environment watches the energy that a device puts into the *others*, and scales down a party that exceeds its
budget (docs/decisions/0029-energy-budgets.md). No honest device puts more into the world than its greatest force at its
greatest speed, or over its whole reach. No hand puts in more than :data:`HAND_POWER` and :data:`HAND_ENERGY`.

Each check also has the form that it accepts as a JSON schema (:mod:`manyhands.launch.session.forms`). A schema cannot
compare two values. So it accepts more than the check does, and never less.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, TypeAlias, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    ValidationError,
    ValidationInfo,
)
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema

from manyhands.design.models.axis import AxisKind, Units
from manyhands.launch.session.errors import SessionError, key_text, listed, one_of, show
from manyhands.launch.session.forms import JsonSchema, either, list_of, mapping_of
from manyhands.launch.session.limits import (
    DEFAULT_DISPLACEMENT,
    DEFAULT_FORCE,
    DEFAULT_SPEED,
    HAND_ENERGY,
    HAND_FORCE,
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
"""Key under which a device passes to its parts what its axes do; no session file can sensibly use it."""

Rows: TypeAlias = tuple[tuple[float, ...], ...]
"""A matrix, row by row."""


class SessionModel(BaseModel):
    """A part of a session: frozen, strict, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def defaulted(value: object, description: str) -> Any:
    """A field whose default value also passes through its validators: they complete it from other fields."""
    return Field(default=value, validate_default=True, description=description)


class FieldCheck:
    """A check of one value, which returns it or refuses, with the form that it accepts.

    It annotates the type of a field: values pass through it first. Where the type allows ``None``, a value may also be
    absent; no file can state that.
    """

    __slots__ = ()

    if TYPE_CHECKING:  # of every check its own; ``json_schema`` may be a field or a property

        @property
        def json_schema(self) -> JsonSchema:
            """The form of the values that it accepts."""

        def in_part(self, value: object, info: ValidationInfo) -> Any:
            """The value of a field; ``info`` has the fields of its part before it, and the folder of the file."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's schema of a field of the type ``source`` with this check."""
        field = _OfField(self, NoneType in get_args(source))
        return core_schema.with_info_before_validator_function(field, handler(source))


class ValueCheck(FieldCheck):
    """A check that needs nothing but the value, and is called with it."""

    __slots__ = ()

    if TYPE_CHECKING:

        def __call__(self, value: object, /) -> Any:
            """The value."""

    def at(self, units: Units) -> ValueCheck:
        """The same check on axes with these units; the check itself where it names none."""
        return self

    def in_part(self, value: object, info: ValidationInfo) -> Any:
        """The value of a field."""
        return self(value)


@dataclass(frozen=True, slots=True)
class _OfField:
    """A check of a field, as pydantic calls it."""

    check: FieldCheck
    optional: bool

    @property
    def json_schema(self) -> JsonSchema:
        return self.check.json_schema

    def __call__(self, value: object, info: ValidationInfo) -> Any:
        return None if value is None and self.optional else self.check.in_part(value, info)


@dataclass(frozen=True, slots=True)
class Described(ValueCheck):
    """A check that is a function, with the form that it accepts."""

    check: Callable[[object], Any]
    json_schema: JsonSchema

    def __call__(self, value: object) -> Any:
        """The value, as the function returns it."""
        return self.check(value)


@dataclass(frozen=True, slots=True)
class Completed(FieldCheck):
    """A check that is a function of a value and of its part, and completes a value that is absent."""

    check: Callable[[object, ValidationInfo], Any]
    json_schema: JsonSchema

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """As of :class:`FieldCheck`; the function gets ``None`` as well."""
        return core_schema.with_info_before_validator_function(_OfField(self, False), handler(source))

    def in_part(self, value: object, info: ValidationInfo) -> Any:
        """The value, as the function returns it."""
        return self.check(value, info)


class Problem(NamedTuple):
    """One error in a session.

    Attributes:
        at: its path below the validated value.
        found: what stands there, in words.
        expected: what would be right.
    """

    at: KeyPath
    found: str
    expected: str


def refusal(*problems: Problem) -> PydanticCustomError:
    """The error with which a validator reports these problems to pydantic."""
    return PydanticCustomError(PROBLEMS, "refused", {"problems": problems})


def refuse(found: str, expected: str, at: KeyPath = ()) -> PydanticCustomError:
    """The error for a single problem."""
    return refusal(Problem(at, found, expected))


@dataclass(frozen=True, slots=True)
class Quantity(ValueCheck):
    """A finite real number with a unit and bounds; called with a value, it returns a ``float`` or refuses.

    Attributes:
        what: name of the quantity with its article, such as ``a mass``.
        unit: such as ``kg``; empty for a number without a unit.
        above: the value must be greater than this.
        least: the value must be at least this.
        most: the value must be at most this.
        smallest: the magnitude of any value other than 0 must be at least this.
        magnitude: the magnitude of any value must be at most this.
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
        """The expected value as text: the quantity, its unit and its bounds."""
        unit = f" in {self.unit}" if self.unit else ""
        at_most = f" and at most {self.most:g}" if self.most is not None else ""
        bound = f" greater than {self.above:g}{at_most}" if self.above is not None else ""
        if self.least is not None:
            between = f" from {self.least:g} to {self.most:g}" if self.most is not None else ""
            bound = between or f" of at least {self.least:g}"
        return f"{self.what}{unit}{bound}"

    @property
    def json_schema(self) -> JsonSchema:
        """A number within the bounds; that it may not be NaN, or nearly 0, is left to the check."""
        least = {"minimum": -self.magnitude if self.least is None else self.least}
        low = least if self.above is None else {"exclusiveMinimum": self.above}
        return {"type": "number", **low, "maximum": self.magnitude if self.most is None else self.most}

    def at(self, units: Units) -> Quantity:
        """The same quantity of axes with these units."""
        unit = units(self.unit)
        return self if unit == self.unit else replace(self, unit=unit)

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
INERTIA: Final = Quantity("an inertia", "kg·m²", above=0.0, smallest=MIN_POSITIVE)
HAND_MASS: Final = Quantity("a mass", "kg", least=0.0)
DAMPING: Final = Quantity("a damping", "N·s/m", least=0.0)
STIFFNESS: Final = Quantity("a stiffness", "N/m", least=0.0)
OSP_LEVEL: Final = Quantity("an OSP level", "N·s/m", above=0.0, smallest=MIN_POSITIVE)
OSP_ENTRY: Final = Quantity("an entry of the OSP level", "N·s/m")
PERIOD: Final = Quantity("a period", "s", least=SHORTEST_PERIOD, most=LONGEST_PERIOD)

Period: TypeAlias = Annotated[float, PERIOD]


@dataclass(frozen=True, slots=True)
class Whole(ValueCheck):
    """A whole number within bounds; called with a value, it returns an ``int`` or refuses."""

    what: str
    least: int
    most: int

    @property
    def json_schema(self) -> JsonSchema:
        """A whole number within the bounds."""
        return {"type": "integer", "minimum": self.least, "maximum": self.most}

    def __call__(self, value: object) -> int:
        """The number."""
        if isinstance(value, bool) or not isinstance(value, int) or not self.least <= value <= self.most:
            raise refuse(show(value), f"a whole number of {self.what} from {self.least} to {self.most}")
        return value


Dof: TypeAlias = Annotated[int, Whole("degrees of freedom", 1, MAX_DOF)]

Axes: TypeAlias = tuple[str, ...] | dict[str, AxisKind] | AxisKind
"""The names of a device's axes; by name what each of them does; or what all of them do, without names."""


def kinds_of_axes(axes: Axes | None, dof: int) -> tuple[AxisKind, ...]:
    """What each of ``dof`` axes does; those that only have names translate."""
    if isinstance(axes, AxisKind):
        return (axes,) * dof
    return tuple(axes.values()) if isinstance(axes, Mapping) else (AxisKind.TRANSLATION,) * dof


class OnAxes(SessionModel):
    """A part of a device whose tuples have one entry for each of its axes.

    Attributes:
        kinds: what each axis does.
    """

    kinds: SkipJsonSchema[tuple[AxisKind, ...]] = Field(alias=DEVICE_AXES, exclude=True, repr=False)


def axis_kinds(info: ValidationInfo) -> tuple[AxisKind, ...] | None:
    """What the axes of the device do whose part is checked; None where that was refused."""
    if "kinds" in info.data:
        kinds: tuple[AxisKind, ...] = info.data["kinds"]
        return kinds
    return kinds_of_axes(info.data.get("axes"), info.data["dof"]) if "dof" in info.data else None


def axis_units(info: ValidationInfo) -> Units:
    """The units of the axes of the device whose part is checked."""
    return Units.of(axis_kinds(info) or ())


@dataclass(frozen=True, slots=True)
class Name(ValueCheck):
    """The form of one kind of name; called with a value, it returns the name or refuses."""

    what: str
    pattern: str
    words: str

    @property
    def json_schema(self) -> JsonSchema:
        """Text of the pattern."""
        return {"type": "string", "pattern": f"^({self.pattern})$"}

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
SessionName: TypeAlias = Annotated[str, SESSION_NAME]


def part_name(what: str) -> Name:
    """The form of a device's, coupling's or mass's name."""
    return Name(what, "[a-z][a-z0-9_]{0,31}", f"a lowercase letter, {_REST}")


@dataclass(frozen=True, slots=True)
class Text(ValueCheck):
    """Text of any kind, whose meaning is checked with the whole session; ``expected`` is for the message."""

    expected: str

    @property
    def json_schema(self) -> JsonSchema:
        """Text."""
        return {"type": "string"}

    def __call__(self, value: object) -> str:
        """The text."""
        if not isinstance(value, str):
            raise refuse(show(value), self.expected)
        return value


@dataclass(frozen=True, slots=True)
class NamedParts(ValueCheck):
    """A mapping from names to parts with ``least`` (0 or 1) to ``most`` entries."""

    name: Name
    most: int
    least: int = 1

    @property
    def json_schema(self) -> JsonSchema:
        """A mapping with such keys; the type that it is checked for describes its values."""
        names = {"propertyNames": {"pattern": self.name.json_schema["pattern"]}}
        return {"type": "object", **names, "minProperties": self.least, "maxProperties": self.most}

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
class Items(ValueCheck):
    """A list of a bounded length, handed on as a tuple; with ``item``, each entry is checked by it."""

    what: str
    most: int
    item: ValueCheck | None = None
    least: int = 1

    @property
    def json_schema(self) -> JsonSchema:
        """A list of such a length; without ``item``, the type that it is checked for describes its entries."""
        form = list_of(self.item.json_schema if self.item else {}, self.most, self.least)
        return form if self.item else {key: value for key, value in form.items() if key != "items"}

    def __call__(self, value: object) -> tuple[Any, ...]:
        """The entries."""
        if not isinstance(value, list | tuple) or not self.least <= len(value) <= self.most:
            raise refuse(show(value), f"a list of {self.least} to {self.most} {self.what}")
        return tuple(value) if self.item is None else each(self.item, value)


def problems_of(error: PydanticCustomError) -> tuple[Problem, ...]:
    """The problems in an error made by :func:`refusal`."""
    problems: tuple[Problem, ...] = (error.context or {})["problems"]
    return problems


def each(check: Callable[[object], Any], values: Sequence[object]) -> tuple[Any, ...]:
    """The checked entries; if any are wrong, one error reports all of them, each at its position."""
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
    """The checked values; if any are wrong, one error reports all of them, each at its name."""
    names = tuple(values)
    try:
        return dict(zip(names, each(check, tuple(values.values())), strict=True))
    except PydanticCustomError as error:
        named = [problem._replace(at=(names[int(problem.at[0])], *problem.at[1:])) for problem in problems_of(error)]
        raise refusal(*named) from None


@dataclass(frozen=True, slots=True)
class PerAxis(FieldCheck):
    """One value for all axes, or a list with one for each; the result is a tuple with one value for each.

    Its messages have the units of the axes: see :class:`.Units`.
    """

    check: ValueCheck

    @property
    def json_schema(self) -> JsonSchema:
        """The value, or a list; a schema does not compare its length with ``dof``."""
        return either(self.check.json_schema, list_of(self.check.json_schema, MAX_DOF))

    def in_part(self, value: object, info: ValidationInfo) -> Any:
        """The values, one for each axis."""
        kinds = axis_kinds(info)
        if not isinstance(value, list | tuple):
            return (self.check.at(Units.of(kinds or ()))(value),) * len(kinds or (None,))
        if kinds is None:  # another error has been reported
            return each(self.check, value[:MAX_DOF])
        if len(value) != len(kinds):
            raise refuse(show(value), f"one value, or a list of {len(kinds)}, one for each axis")
        checks = iter([self.check.at(Units.of([kind])) for kind in kinds])
        return each(lambda entry: next(checks)(entry), value)


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


Flag: TypeAlias = Annotated[bool, Described(_flag, {"type": "boolean"})]
"""``true`` or ``false``; no number or text in their place."""


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
        """The value as an interval; a number becomes an interval without width."""
        return value if isinstance(value, Interval) else cls(value, value)

    @property
    def nominal(self) -> float:
        """The middle of the interval; a run, which needs one value, uses this one."""
        return (self.low + self.high) / 2.0


@dataclass(frozen=True, slots=True)
class LevelInterval:
    """All diagonal OSP levels between ``low`` and ``high``, axis by axis; both ends are m_i x m_i in N·s/m."""

    low: Rows
    high: Rows


def is_interval(value: object) -> bool:
    """Whether a value is written as an interval (a mapping), whether correct or not."""
    return isinstance(value, Mapping)


def between(end: JsonSchema) -> JsonSchema:
    """``{between: [low, high]}`` with ends of this form."""
    return mapping_of({BETWEEN: list_of(end, 2, 2)})


def ends(value: object, check: Callable[[object], Any]) -> tuple[Any, Any]:
    """Both ends of ``{between: [low, high]}``, each checked; the caller checks their order."""
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
    """Refuse an empty interval: ``low`` must be at most ``high``."""
    if low > high:
        raise refuse(
            f"the lower end {low:g} above the higher end {high:g}", "[low, high], low at most high", (BETWEEN,)
        )


@dataclass(frozen=True, slots=True)
class UncertainQuantity(ValueCheck):
    """A quantity or an interval of it; called with a value, it returns a ``float`` or an interval, or refuses."""

    quantity: Quantity

    @property
    def json_schema(self) -> JsonSchema:
        """A number or an interval."""
        return either(self.quantity.json_schema, between(self.quantity.json_schema))

    def __call__(self, value: object) -> float | Interval:
        """The number or the interval; an interval without width becomes a number."""
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
    """The quantity in the notation of a session file."""
    return {BETWEEN: [value.low, value.high]} if isinstance(value, Interval) else value


_AS_WRITTEN: Final = PlainSerializer(plain)
UncertainInertia: TypeAlias = Annotated[float | Interval, UncertainQuantity(INERTIA), _AS_WRITTEN]
UncertainMass: TypeAlias = Annotated[float | Interval, UncertainQuantity(MASS), _AS_WRITTEN]
UncertainDamping: TypeAlias = Annotated[float | Interval, UncertainQuantity(DAMPING), _AS_WRITTEN]
UncertainStiffness: TypeAlias = Annotated[float | Interval, UncertainQuantity(STIFFNESS), _AS_WRITTEN]


def require_spring_or_damper(stiffness: float | Interval, damping: float | Interval) -> None:
    """Refuse a link with neither."""
    if stiffness == 0.0 and damping == 0.0:
        raise refuse("neither stiffness nor damping", "a stiffness in N/m, a damping in N·s/m, or both, greater than 0")


_FORCE: Final = Quantity("a limit of the force", "N", above=0.0, smallest=MIN_POSITIVE)
_DISPLACEMENT: Final = Quantity("a limit of the displacement", "m", above=0.0, smallest=MIN_POSITIVE)
_SPEED: Final = Quantity("a limit of the speed", "m/s", above=0.0, smallest=MIN_POSITIVE)
_HAND: Final = Quantity("the greatest force of its hand", "N", above=0.0, smallest=MIN_POSITIVE)
_POWER: Final = Quantity("a power put into the others", "W", above=0.0, smallest=MIN_POSITIVE)
_ENERGY: Final = Quantity("an energy put into the others", "J", above=0.0, smallest=MIN_POSITIVE)


def _power(value: object, info: ValidationInfo) -> object:
    """P in W; by default the greatest force times the greatest speed, summed over the axes, at most HAND_POWER."""
    return _POWER(value) if value is not None else min(HAND_POWER, _products(info, "speed"))


def _energy(value: object, info: ValidationInfo) -> object:
    """E in J; by default the greatest force over the reach, both ways, summed over the axes, at most HAND_ENERGY."""
    return _ENERGY(value) if value is not None else min(HAND_ENERGY, 2.0 * _products(info, "displacement"))


def _products(info: ValidationInfo, quantity: str) -> float:
    """The sum over the axes of force times ``quantity``; infinite where one of the two was refused."""
    forces, others = info.data.get("force"), info.data.get(quantity)
    if not forces or not others or len(forces) != len(others):
        return math.inf
    return float(sum(force * other for force, other in zip(forces, others, strict=True)))


class PortLimits(OnAxes):
    """The limits at a device's ports; every tuple has one entry for each axis.

    The units are those of a translational axis; a rotational axis has N·m, rad and rad/s. The device clips a force that
    exceeds its limit, and lets go when a displacement or a speed does. Nothing limits its hand: what is stated of it is
    believed until a motion shows more. Power and energy are limits of the whole device.
    """

    force: Annotated[tuple[float, ...], PerAxis(_FORCE)] = defaulted(
        DEFAULT_FORCE, "the greatest force in N that is applied, either way: a number, or one for each axis"
    )
    displacement: Annotated[tuple[float, ...], PerAxis(_DISPLACEMENT)] = defaulted(
        DEFAULT_DISPLACEMENT, "the greatest displacement in m from 0: a number, or one for each axis"
    )
    speed: Annotated[tuple[float, ...], PerAxis(_SPEED)] = defaulted(
        DEFAULT_SPEED, "the greatest speed in m/s: a number, or one for each axis"
    )
    hand: Annotated[tuple[float, ...], PerAxis(_HAND)] = defaulted(
        HAND_FORCE, "the greatest force in N by which its hand speeds it up: a number, or one for each axis"
    )
    power: Annotated[float, Completed(_power, _POWER.json_schema)] = defaulted(
        None, "the power in W that it may put into the other users for as long as it likes"
    )
    energy: Annotated[float, Completed(_energy, _ENERGY.json_schema)] = defaulted(
        None, "the energy in J that it may put into the other users at once"
    )


_COMPARED: Final = 64  # a missing key is compared with at most this many unknown keys of its part


def problems_in(error: ValidationError, model: type[SessionModel]) -> Iterator[Problem]:
    """The problems in a failed validation of ``model``, each with its full path."""
    details = error.errors(include_url=False)
    unknown: dict[KeyPath, list[str]] = {}
    for detail in details:
        if detail["type"] == "extra_forbidden":
            unknown.setdefault(detail["loc"][:-1], []).append(str(detail["loc"][-1]))
    for detail in details:
        if detail["type"] == "missing":
            misspelt = unknown.get(detail["loc"][:-1], [])[:_COMPARED]
            if get_close_matches(str(detail["loc"][-1]), misspelt, n=1):
                continue  # the message about the misspelt key is enough
        yield from _translated(detail, model)


def nulls_in(data: object, path: KeyPath = ()) -> Iterator[Problem]:
    """A problem for every key without a value: an empty key is not the same as an absent one."""
    if data is None:
        yield Problem(path, "nothing", "a value, or the key left out")
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, child in children:
        yield from nulls_in(child, (*path, step))


def first_error(tree: SessionTree, problems: list[Problem]) -> SessionError:
    """The error for the first problem in the order of the file; problems of overrides come first."""
    located = []
    seen = set()
    for problem in problems:
        path, place = tree.locate(problem.at)
        # one value for all axes may fail once for each axis
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
        case "literal_error":
            words = get_args(_type_at(model, path))
            yield Problem(path, show(detail["input"]), one_of(words, detail["input"]))
        case _:
            yield Problem(path, show(detail["input"]), detail["msg"])


def keys_of(model: type[SessionModel]) -> dict[str, str]:
    """The valid keys of a part, each with its description."""
    named = {field.alias or name: field.description or "" for name, field in model.model_fields.items()}
    return {name: meaning for name, meaning in named.items() if name != DEVICE_AXES}


def _model_at(model: type[SessionModel], path: KeyPath) -> type[SessionModel] | None:
    """The model at a path below ``model``; None where there is none."""
    found = _type_at(model, path)
    return found if isinstance(found, type) and issubclass(found, SessionModel) else None


def _type_at(model: type[SessionModel], path: KeyPath) -> Any:
    """The type at a path below ``model``, found from the annotations; None where there is none."""
    current: Any = model
    for step in path:
        if isinstance(current, type) and issubclass(current, SessionModel):
            fields = {field.alias or name: field for name, field in current.model_fields.items()}
            current = fields[str(step)].annotation if step in fields else None
        else:
            current = next(iter(get_args(current)[-1:]), None) if get_origin(current) is dict else _item(current)
        current = _without_none(current)
    return current


def _item(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is tuple else None


def _without_none(annotation: Any) -> Any:
    """X of ``X | None``."""
    options = [option for option in get_args(annotation) if option is not type(None)]
    return options[0] if type(None) in get_args(annotation) and len(options) == 1 else annotation
