"""Rational functions of s, given by their coefficients: operators of hands, environments, weights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import dropwhile
from typing import Final

from manyhands.launch.session.error import one_of, show
from manyhands.launch.session.fields import Items, Quantity, SessionModel, each_named, refuse
from manyhands.launch.session.limits import MAX_COEFFICIENT, MAX_DEGREE

COEFFICIENTS: Final = Items(
    "coefficients, the highest power of s first",
    MAX_DEGREE + 1,
    Quantity("a coefficient: a number", smallest=1.0 / MAX_COEFFICIENT, magnitude=MAX_COEFFICIENT),
)


class Rational(SessionModel):
    """A rational function of s: numerator and denominator, the highest power of s first."""

    num: tuple[float, ...]
    den: tuple[float, ...]

    @property
    def degrees(self) -> tuple[int, int]:
        """Degrees of numerator and denominator, without leading zeros; -1 for a polynomial that is 0."""
        return len(trimmed(self.num)) - 1, len(trimmed(self.den)) - 1

    @property
    def proper(self) -> bool:
        """Whether the numerator's degree is at most the denominator's."""
        num, den = self.degrees
        return num <= den


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of a rational matrix: a number, or ``{num: [...], den: [...]}``.

    Attributes:
        unit: of a plain number.
    """

    unit: str

    @property
    def _gain(self) -> Quantity:
        # as small as a coefficient may be: the session is written with num and den
        return Quantity("an entry: a number", self.unit, smallest=1.0 / MAX_COEFFICIENT)

    def __call__(self, value: object) -> Rational:
        """The entry as a rational function."""
        if isinstance(value, Rational):
            return value
        if not isinstance(value, Mapping):
            if isinstance(value, list | tuple):
                raise refuse(show(value), f"one entry there: a number in {self.unit} or {{num: [...], den: [...]}}")
            return Rational(num=(self._gain(value),), den=(1.0,))
        for key in value:
            if key not in ("num", "den"):
                raise refuse(f"the unknown key {show(key)}", one_of(("num", "den"), key), at=(key,))
        for key in ("num", "den"):
            if key not in value:
                raise refuse(f"no key {key!r}", f"both num and den, or a plain number in {self.unit}")
        checked = each_named(COEFFICIENTS, {key: value[key] for key in ("num", "den")})
        return Rational(num=checked["num"], den=checked["den"])


def trimmed(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """The coefficients without leading zeros."""
    return tuple(dropwhile(lambda c: c == 0.0, coefficients))


def is_hurwitz(coefficients: Sequence[float]) -> bool:
    """Whether every root has a negative real part: Routh's test in exact arithmetic, so no root is on the edge of it.

    Args:
        coefficients: a polynomial of s other than 0, the highest power first.
    """
    exact = [Fraction(c) for c in dropwhile(lambda c: c == 0, coefficients)]
    above, row = exact[0::2], exact[1::2]
    while row:
        if row[0] * exact[0] <= 0:
            return False
        ratio = above[0] / row[0]
        longer = [*row[1:], *[Fraction(0)] * (len(above) - len(row))]
        above, row = row, [a - ratio * b for a, b in zip(above[1:], longer, strict=True)]
    return True
