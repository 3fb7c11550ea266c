"""What a device can do in a box around the middle of its workspace, by the library's own kinematics: :class:`Survey`.

Nothing moves for that: the library says of every place which angles, Jacobian J = dx/dq and torques belong to it. With
J_j the j-th column of J, the motor j holds a force f by the torque J_j^T f, at most |J_j| |f|. So at a place every
force is held up to

    F = min over j of t_j / |J_j|,    t_j the greatest torque of motor j either way,

and the tip moves on axis i by at most the sum over j of |J_ij| c_j when each encoder moves by a count c_j. The tip's
way bends, where the joints move evenly, by kappa = greatest |s(v)| over unit v, s_i = sum of dJ_ia/dq_b w_a w_b with
w = J^-1 v (docs/mechanisms.md, *Motors hold torques*).

**It is checked before it is believed.** A Jacobian of another frame or order would make all forces wrong. So places
next to each other have to lie where J says (:func:`check`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.devices.force_dimension.library import ForceDimensionError, Kinematics

NUMBER: Final = 5
"""Places along each edge of the box that a driver asks for at its start."""

FINE: Final = 11
"""Those of the search for kappa."""

APART: Final = 50
"""Counts between two places that are compared with J: enough for the steps to matter little."""

OFF: Final = 0.02
"""By so much of the way between two places J may be wrong."""

BESIDE: Final = 5e-4
"""m; by so much a position may differ from the place of the same encoders."""

LONGEST: Final = 1.0
"""m/rad; the arms of no such device are as long."""

BEYOND: Final = 1.05
"""What is added to a kappa that was searched on a grid."""

_STEP: Final = 1e-4
"""rad; the differences of J."""

_DIRECTIONS: Final = 400


@dataclass(frozen=True)
class Survey:
    """What holds everywhere in the box.

    Attributes:
        force: the greatest force that is held in every direction, N.
        step: by axis, the greatest way of a count, m.
    """

    force: float
    step: tuple[float, float, float]


def survey(kinematics: Kinematics, reach: float) -> Survey:
    """Ask for all places of a grid within ``reach`` (m) of 0 on every axis.

    Raises:
        ForceDimensionError: the library knows no such place.
    """
    force, step = math.inf, [0.0, 0.0, 0.0]
    for counts, q in _grid(kinematics, reach, NUMBER):
        J = kinematics.jacobian(q)
        low, high = kinematics.torques(q)
        sizes = [math.hypot(J[j], J[3 + j], J[6 + j]) for j in range(3)]
        force = min(force, *(min(-a, b) / size for a, b, size in zip(low, high, sizes, strict=True)))
        on = kinematics.angles([count + 1 for count in counts])
        for i in range(3):
            step[i] = max(step[i], sum(abs(J[3 * i + j] * (on[j] - q[j])) for j in range(3)))
    return Survey(force, (step[0], step[1], step[2]))


def check(kinematics: Kinematics, reach: float, position: Sequence[float], around: Sequence[Sequence[int]]) -> None:
    """Refuse a library whose positions, encoders and Jacobian do not belong together.

    Args:
        kinematics: the device's.
        reach: the half edge of the box, m.
        position: as the library gives it by ``dhdGetPosition``, m.
        around: the encoders' counts before it and after it.

    Raises:
        ForceDimensionError: they do not; the message says by how much.
    """
    J = kinematics.jacobian(kinematics.angles(around[0]))
    longest = max(math.hypot(J[j], J[3 + j], J[6 + j]) for j in range(3))
    if longest > LONGEST:
        raise ForceDimensionError(
            f"{kinematics.name}: found a Jacobian of {longest:.3g} m/rad; expected less than {LONGEST:g}: this library "
            "has another unit of length than m, which its headers say"
        )
    before, after = (kinematics.place(counts) for counts in around)
    off = math.dist(position, before) - math.dist(before, after)
    if off > BESIDE:
        raise ForceDimensionError(
            f"{kinematics.name}: found its position {1e3 * off:.3g} mm from the place of its encoders; expected both "
            "in the same frame: set the device's base angles back to those of its foot (dhdSetDeviceAngle)"
        )
    for counts, q in _grid(kinematics, 0.8 * reach, 2):
        J = kinematics.jacobian(q)
        for joint in range(3):
            to = [count + APART * (j == joint) for j, count in enumerate(counts)]
            turn = kinematics.angles(to)[joint] - q[joint]
            way = [b - a for a, b in zip(kinematics.place(counts), kinematics.place(to), strict=True)]
            said = [J[3 * i + joint] * turn for i in range(3)]
            if math.dist(way, said) > OFF * math.hypot(*way):
                raise ForceDimensionError(
                    f"{kinematics.name}: found that {APART} counts of encoder {joint} move it by {_mm(way)} mm, where "
                    f"its Jacobian says {_mm(said)} mm; expected J = dx/dq: this driver does not know this library"
                )


def bending(kinematics: Kinematics, reach: float) -> float:
    """How much the tip bends in the box, kappa, 1/m: the greatest of a grid, and 5 % more; searched, not proved.

    Raises:
        ForceDimensionError: the library knows no such place.
    """
    number = np.arange(_DIRECTIONS)
    up, around = (number + 0.5) / _DIRECTIONS, math.pi * (1.0 + math.sqrt(5.0)) * number
    flat = np.sqrt(1.0 - up * up)
    v = np.stack([flat * np.cos(around), flat * np.sin(around), up])  # a spiral over the half sphere
    greatest = 0.0
    for _, q in _grid(kinematics, reach, FINE):
        w = np.linalg.solve(_matrix(kinematics, q), v)
        s = np.zeros_like(v)
        for b in range(3):
            more, less = ([angle + side * _STEP * (j == b) for j, angle in enumerate(q)] for side in (1.0, -1.0))
            slope = (_matrix(kinematics, more) - _matrix(kinematics, less)) / (2.0 * _STEP)
            s += (slope @ w) * w[b]
        greatest = max(greatest, float(np.sqrt((s * s).sum(axis=0)).max()))
    return BEYOND * greatest


def _grid(kinematics: Kinematics, reach: float, number: int) -> Iterator[tuple[list[int], list[float]]]:
    """The counts and angles of places that are spread evenly over the box."""
    edge = [reach * (2.0 * i / (number - 1) - 1.0) for i in range(number)]
    for place in product(edge, repeat=3):
        try:
            counts = kinematics.counts(place)
            yield counts, kinematics.angles(counts)
        except ForceDimensionError as error:
            raise ForceDimensionError(
                f"{error}; the place {_mm(place)} mm belongs to the box of {1e3 * reach:.3g} mm either way: give a "
                "smaller parameters.reach where the device cannot be there"
            ) from error


def _matrix(kinematics: Kinematics, q: Sequence[float]) -> NDArray[np.float64]:
    return np.array(kinematics.jacobian(q)).reshape(3, 3)


def _mm(place: Sequence[float]) -> str:
    return f"({', '.join(f'{1e3 * value:.3g}' for value in place)})"
