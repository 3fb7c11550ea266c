"""The weights W1, W2 of the transparency objectives: by their coefficients, or by the band that they emphasise.

    (23): || W1 (F(E, V) - E) W2 ||,   (24): || W1 E V W2 ||    ([Bianchini2010]_)

One scalar weight stands for all ports. It must be stable and proper, which keeps it stable under backward Euler.
"""

import math
from typing import Annotated, Final, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from manyhands.launch.session.error import show
from manyhands.launch.session.fields import Quantity, SessionModel, each, optional, refuse
from manyhands.launch.session.limits import MIN_POSITIVE
from manyhands.launch.session.rational import COEFFICIENTS, Rational, is_hurwitz, trimmed

_EDGE: Final = Quantity("an edge of the band", "Hz", least=0.0, smallest=MIN_POSITIVE)
_FORMS: Final = "{num: [...], den: [...]} in s, or {emphasise: [low, high]} in Hz"


def _band(value: object) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise refuse(show(value), "the two edges of a band, [low, high] in Hz")
    low, high = each(_EDGE, value)
    if low >= high:
        raise refuse(f"a band from {low:g} to {high:g} Hz", "[low, high] in Hz with low less than high")
    return low, high


class Weight(SessionModel):
    """A stable, proper, scalar weight, in continuous time.

    ``emphasise: [0, f]`` is the low-pass 1/(1 + s/w), w = 2 pi f; ``emphasise: [f1, f2]`` the band-pass

        (w2 - w1) s / (s^2 + (w2 - w1) s + w1 w2),    w1 = 2 pi f1, w2 = 2 pi f2,

    whose gain is 1 at sqrt(w1 w2) and 1/sqrt(2) at both edges.
    """

    num: Annotated[tuple[float, ...] | None, BeforeValidator(optional(COEFFICIENTS))] = Field(
        default=None, description="coefficients of the numerator, the highest power of s first"
    )
    den: Annotated[tuple[float, ...] | None, BeforeValidator(optional(COEFFICIENTS))] = Field(
        default=None, description="coefficients of the denominator, the highest power of s first"
    )
    emphasise: Annotated[tuple[float, float] | None, BeforeValidator(optional(_band))] = Field(
        default=None, description="the band [low, high] in Hz, in place of num and den"
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        written = [name for name in ("num", "den") if getattr(self, name) is not None]
        if self.emphasise is not None:
            if written:
                raise refuse(f"emphasise besides {written[0]}", _FORMS, at=("emphasise",))
            return self
        if len(written) != 2:
            raise refuse(f"{written[0]} alone" if written else "nothing in it", _FORMS)
        return self

    @model_validator(mode="after")
    def _stable_and_proper(self) -> Self:
        if self.num is None or self.den is None:
            return self
        weight = self.rational
        if -1 in weight.degrees:
            name = "den" if weight.degrees[1] < 0 else "num"
            raise refuse("coefficients that are all 0", "a coefficient other than 0", at=(name,))
        if not weight.proper:
            num, den = weight.degrees
            found = f"an improper weight, of degree {num} over {den}"
            raise refuse(found, "a numerator of no higher degree than the denominator", at=("num",))
        if not is_hurwitz(self.den):
            with np.errstate(all="ignore"):
                rightmost = max(np.roots(trimmed(self.den)), key=lambda root: float(root.real))
            found = f"an unstable weight, with a pole at about {rightmost:.3g} rad/s"
            raise refuse(found, "every pole in the open left half plane", at=("den",))
        return self

    @property
    def rational(self) -> Rational:
        """The weight as a rational function of s."""
        if self.emphasise is None:
            return Rational(num=self.num or (), den=self.den or ())
        low, high = (2.0 * math.pi * edge for edge in self.emphasise)
        if low == 0.0:
            return Rational(num=(1.0,), den=(1.0 / high, 1.0))
        return Rational(num=(high - low, 0.0), den=(1.0, high - low, low * high))


_NEUTRAL: Final = Weight(num=(1.0,), den=(1.0,))


class Weights(SessionModel):
    """The two weights of an objective; one that is left out is 1."""

    W1: Weight = Field(default=_NEUTRAL, description="the weight W1, at the output")
    W2: Weight = Field(default=_NEUTRAL, description="the weight W2, at the input")
