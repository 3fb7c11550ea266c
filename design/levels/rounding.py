"""An exact number as a float that is on the safe side of it."""

from __future__ import annotations

import math
from fractions import Fraction


def rounded_up(exact: Fraction) -> float:
    """The least float that is no less than ``exact``."""
    rounded = float(exact)
    return rounded if Fraction(rounded) >= exact else math.nextafter(rounded, math.inf)


def rounded_down(exact: Fraction) -> float:
    """The greatest float that is no more than ``exact``."""
    rounded = float(exact)
    return rounded if Fraction(rounded) <= exact else math.nextafter(rounded, -math.inf)
