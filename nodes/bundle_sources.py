"""What moves a device, as its bundle says it: a simulated hand, a recorded motion, or a person at a browser."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from manyhands.design.statespace import Matrix, StateSpace
from manyhands.nodes.bundle_values import array, floats, plain, system


@dataclass(frozen=True, eq=False)
class SimulatedHand:
    """The physics of a simulated device and its hand, one entry an axis.

    Attributes:
        mass: kg, device and hand together.
        damping: the device's, N*s/m.
        operator: H in continuous time.
        hand_damping: N*s/m.
        hand_stiffness: N/m.
        force: intended force (N): a number, a formula in t, or {"times", "values"}.
        motion: intended motion (m), likewise.

    Raises:
        ValueError: not as many of each.
    """

    mass: tuple[float, ...]
    damping: tuple[float, ...]
    operator: StateSpace
    hand_damping: tuple[float, ...]
    hand_stiffness: tuple[float, ...]
    force: tuple[Any, ...]
    motion: tuple[Any, ...]

    def __post_init__(self) -> None:
        vectors = (self.mass, self.damping, self.hand_damping, self.hand_stiffness, self.force, self.motion)
        _require_one_number({len(vector) for vector in vectors} | {self.operator.inputs})

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.mass)


@dataclass(frozen=True, eq=False)
class BrowserHand:
    """The physics of a device that a person's browser can hold; by itself the hand intends nothing.

    Attributes:
        physics: device and hand, the hand being what holds the device to the pointer.
    """

    physics: SimulatedHand

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.physics.axes


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """A motion that was recorded, and moves the device whatever force acts on it.

    Attributes:
        damping: Delta_D of the device that is moved, m x m, N*s/m.
        times: of the samples, s, growing from 0.
        values: of each axis, as many as there are times, m.

    Raises:
        ValueError: there are not as many, or the damping is not m x m.
    """

    damping: Matrix
    times: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if any(len(axis) != len(self.times) for axis in self.values):
            raise ValueError(f"found an axis without {len(self.times)} samples; expected one at each time")
        _require_one_number({len(self.values), *self.damping.shape})

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.values)


Source: TypeAlias = SimulatedHand | BrowserHand | RecordedMotion
"""What moves a device."""


def _require_one_number(numbers: set[int]) -> None:
    if len(numbers) != 1:
        raise ValueError(f"found entries of {sorted(numbers)} axes in a device's source; expected one number of axes")


def plain_source(source: Source) -> dict[str, Any]:
    """As a bundle's file has it."""
    kind = next(kind for kind, (of, _) in _KINDS.items() if isinstance(source, of))
    return {"kind": kind, **{field.name: plain(getattr(source, field.name)) for field in dataclasses.fields(source)}}


def source_from(data: Any) -> Source:
    """From what a bundle's file has.

    Raises:
        ValueError: no such kind, or numbers that do not fit each other.
        KeyError, TypeError: of another form.
    """
    kind = data["kind"]
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"found a device moved by {kind!r:.40}; expected one of {', '.join(_KINDS)}")
    return _KINDS[kind][1](data)


def _hand(data: Any) -> SimulatedHand:
    vectors = {name: floats(data[name]) for name in ("mass", "damping", "hand_damping", "hand_stiffness")}
    intentions = {name: tuple(data[name]) for name in ("force", "motion")}
    return SimulatedHand(operator=system(data["operator"]), **vectors, **intentions)


def _motion(data: Any) -> RecordedMotion:
    times, values = floats(data["times"]), tuple(floats(axis) for axis in data["values"])
    if not all(map(math.isfinite, (*times, *(value for axis in values for value in axis)))):
        raise ValueError("found a motion with a number that is not finite; expected finite numbers")
    return RecordedMotion(array(data["damping"]), times, values)


_KINDS: Final[Mapping[str, tuple[type[Any], Callable[[Any], Source]]]] = {
    "simulated": (SimulatedHand, _hand),
    "browser": (BrowserHand, lambda data: BrowserHand(_hand(data["physics"]))),
    "trace": (RecordedMotion, _motion),
}
