"""What an axis does, translate or turn, and the units that follow from it.

Everything linear holds for an angle as it does for a displacement: with x in rad, f is a torque in N·m, and the laws
of a coupling, a device and a network stay what they are. Only units differ. The code names every quantity by the unit
that it has where axes translate; :class:`Units` gives the unit that it has at some ports.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final


class AxisKind(StrEnum):
    """What an axis does."""

    TRANSLATION = "translation"
    ROTATION = "rotation"


_WHERE_IT_TURNS: Final = MappingProxyType(
    {
        "m": "rad",
        "mm": "mrad",
        "m/s": "rad/s",
        "m/s²": "rad/s²",
        "N": "N·m",
        "N/m": "N·m/rad",
        "N·s/m": "N·m·s/rad",
        "N·s": "N·m·s",
        "N s": "N m s",
        "kg": "kg·m²",
        "g": "g·m²",
        "m/N": "rad/(N·m)",
        "mm/N": "mrad/(N·m)",
        "m/(N·s)": "rad/(N·m·s)",
    }
)
"""By the unit of a translating axis, that of a turning one; a unit that is not here is the same for both."""


@dataclass(frozen=True, slots=True)
class Units:
    """The units of what is said of some axes together.

    Attributes:
        kinds: what these axes do; none means that they translate.

    Example:
        >>> Units.of([AxisKind.ROTATION])("N/m")
        'N·m/rad'
        >>> Units.of([AxisKind.ROTATION, AxisKind.TRANSLATION])("N/m")
        'N/m or N·m/rad'
        >>> Units.of([AxisKind.ROTATION])("J")
        'J'
    """

    kinds: frozenset[AxisKind] = frozenset()

    @classmethod
    def of(cls, kinds: Iterable[AxisKind]) -> Units:
        """Of axes that do this."""
        return cls(frozenset(kinds))

    def __call__(self, unit: str) -> str:
        """The unit of a quantity.

        Args:
            unit: that it has where axes translate.
        """
        turning = _WHERE_IT_TURNS.get(unit, unit)
        if AxisKind.ROTATION not in self.kinds or turning == unit:
            return unit
        return turning if len(self.kinds) == 1 else f"{unit} or {turning}"


TRANSLATING: Final = Units()
"""Of axes that translate."""

TURNING: Final = Units.of([AxisKind.ROTATION])
"""Of axes that turn."""


def kinds_of(axes: Iterable[object], turning: Iterable[object]) -> tuple[AxisKind, ...]:
    """What each of these axes does.

    Args:
        axes: by name or number.
        turning: those that turn, and perhaps others.
    """
    turn = frozenset(turning)
    return tuple(AxisKind.ROTATION if axis in turn else AxisKind.TRANSLATION for axis in axes)


def units_of(axes: Iterable[object], turning: Iterable[object]) -> Units:
    """The units of what is said of these axes together; arguments are those of :func:`kinds_of`."""
    return Units.of(kinds_of(axes, turning))


def units_by_port(ports: Iterable[str], turning: Iterable[str]) -> dict[str, Units]:
    """The units at each port.

    Args:
        ports: by name.
        turning: those that turn.
    """
    turn = frozenset(turning)
    return {port: TURNING if port in turn else TRANSLATING for port in ports}
