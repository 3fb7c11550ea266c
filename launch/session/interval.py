"""Quantities known only to lie between two values, written ``{between: [low, high]}``.

A certificate of a session with intervals claims stability for every value in them, so what is read here keeps both
ends; nothing turns an interval into a number by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypeAlias

from pydantic import BeforeValidator, PlainSerializer
from pydantic_core import PydanticCustomError

from manyhands.launch.session.error import one_of, show
from manyhands.launch.session.fields import DAMPING, MASS, STIFFNESS, Quantity, Rows, each, problems_of, refusal, refuse

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
