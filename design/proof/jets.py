"""Balls that know their slopes: over a box of arguments, a function's value in the middle, and how it leaves it.

    f(x) = f(c) + sum over i of s_i (x_i - c_i)    for every x of the box, with c its middle and s_i in balls of slopes.

What this adds to the true range falls with the square of the box's width; what balls alone add falls with the width.
The slopes are from the middle, and no derivatives [Krawczyk1985]_: of a product, by

    x y - x_c y_c = (x - x_c) y + x_c (y - y_c),

with one factor over the box and the other one in the middle. They are about half as wide as derivatives over the box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from flint import arb


class Jet:
    """A function over a box of arguments.

    Attributes:
        middle: its value in the box's middle.
        slopes: for each argument, a ball of slopes from the middle.
        steps: for each argument, the ball of its differences from the middle.
        value: its values over the box.
    """

    __slots__ = ("middle", "slopes", "steps", "value")

    def __init__(self, middle: arb, slopes: tuple[arb, ...], steps: tuple[arb, ...], value: arb | None = None) -> None:
        """A function, whose values over the box are narrowed by what is known of them otherwise."""
        self.middle, self.slopes, self.steps = middle, slopes, steps
        total = middle
        for slope, step in zip(slopes, steps, strict=True):
            total = total + slope * step
        self.value = total if value is None else total.intersection(value)

    @classmethod
    def arguments(cls, box: Sequence[arb]) -> list[Jet]:
        """The arguments themselves, each in its ball."""
        middles = [ball.mid() for ball in box]
        steps = tuple(ball - middle for ball, middle in zip(box, middles, strict=True))
        return [
            cls(middle, tuple(arb(int(i == j)) for j in range(len(box))), steps, box[i])
            for i, middle in enumerate(middles)
        ]

    def _of(self, function: Callable[[arb], arb], slope: arb) -> Jet:
        """A function of this one, by its slopes from the middle."""
        slopes = tuple(slope * own for own in self.slopes)
        return Jet(function(self.middle), slopes, self.steps, function(self.value))

    def __add__(self, other: Jet | arb) -> Jet:
        if isinstance(other, arb):
            return Jet(self.middle + other, self.slopes, self.steps, self.value + other)
        slopes = tuple([a + b for a, b in zip(self.slopes, other.slopes, strict=True)])
        return Jet(self.middle + other.middle, slopes, self.steps, self.value + other.value)

    def __sub__(self, other: Jet | arb) -> Jet:
        if isinstance(other, arb):
            return Jet(self.middle - other, self.slopes, self.steps, self.value - other)
        slopes = tuple([a - b for a, b in zip(self.slopes, other.slopes, strict=True)])
        return Jet(self.middle - other.middle, slopes, self.steps, self.value - other.value)

    def __neg__(self) -> Jet:
        return Jet(-self.middle, tuple([-slope for slope in self.slopes]), self.steps, -self.value)

    def __mul__(self, other: Jet | arb) -> Jet:
        if isinstance(other, arb):
            slopes = tuple([slope * other for slope in self.slopes])
            return Jet(self.middle * other, slopes, self.steps, self.value * other)
        x, y = self.middle, other.value
        slopes = tuple([a * y + x * b for a, b in zip(self.slopes, other.slopes, strict=True)])
        return Jet(x * other.middle, slopes, self.steps, self.value * y)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Jet | arb) -> Jet:
        return self * (other.inverse() if isinstance(other, Jet) else 1 / other)

    def inverse(self) -> Jet:
        """1 over it.

        Raises:
            ZeroDivisionError: it may be 0.
        """
        if not (self.value > 0 or self.value < 0):
            raise ZeroDivisionError
        return self._of(lambda x: 1 / x, -1 / (self.value * self.middle))

    def sqrt(self) -> Jet:
        """Its root.

        Raises:
            ZeroDivisionError: it may be 0 or less.
        """
        if not self.value > 0:
            raise ZeroDivisionError
        return self._of(arb.sqrt, 1 / (self.value.sqrt() + self.middle.sqrt()))

    def cos(self) -> Jet:
        """Its cosine."""
        return self._of(arb.cos, -self.value.sin())

    def sin(self) -> Jet:
        """Its sine."""
        return self._of(arb.sin, self.value.cos())

    def __gt__(self, other: int) -> bool:
        return bool(self.value > other)

    def __lt__(self, other: int) -> bool:
        return bool(self.value < other)
