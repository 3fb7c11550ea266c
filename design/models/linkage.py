"""Linkages: what joins a device's motors to its tip, and how much the tip's way bends while they move evenly.

A motor holds a torque from tick to tick, and no force. The torques tau = J(q)^T f that stand for a force f at the pose
q push the tip with another force once the tip has moved on. By how much follows from the acceleration of a tip that
moves with unit speed along v while no joint accelerates,

    s(v) = phi''[J^-1 v, J^-1 v],    kappa = greatest |s(v)| over unit v and all poses,    1/m,

with the tip x = phi(q) and J = phi'(q). Decision 50 has the theorem. Where the joints are given as functions of the
tip, q = psi(x), the same vector is s(v) = -J psi''[v, v].

Two kinds cover what devices are built of: a chain of links one behind the other (:class:`SerialChain`), and arms beside
each other that meet at the tip (:class:`ParallelArms`: a :class:`FiveBar` with two of them, and a :class:`Delta` robot
[Clavel1990]_ with three). Each has a box of poses, in which its device may move. Files state them as plain data
(:func:`linkage_of`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Final

import numpy as np

from manyhands.design.models.statespace import Matrix, matrix

_GRID = {1: 201, 2: 41, 3: 15}  # poses for each coordinate of the first, coarse search, by how many vary
_BEST = 8  # so many of them are the beginnings of a finer one
_SINGULAR: Final = 1e6  # 1/m: what bends by more is singular, but for rounding
_CLOSE: Final = 1e-12  # of the chain's length: how near a pose's tip is to the one that was asked for
_MOST_STEPS: Final = 50
_LONGEST_STEP: Final = 0.5  # rad
_OUTSIDE: Final = 1e-9  # rad or m: so far a pose may be out of the box by rounding


class LinkageError(ValueError):
    """The data describe no linkage, its poses include a singular one, or none of them has the tip that is asked for."""


@dataclass(frozen=True)
class Poses:
    """Where a linkage may be: a range for each coordinate of a pose.

    Attributes:
        low: the least of each, rad or m.
        high: the greatest, likewise.

    Raises:
        LinkageError: a range is empty.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.low) != len(self.high) or not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise LinkageError(f"found poses from {list(self.low)} to {list(self.high)}; expected each range to rise")


class Linkage(ABC):
    """What joins m motors to a tip with m coordinates, m = 2 or 3.

    Attributes:
        axes: m.
        poses: where the device may be.
    """

    axes: int
    poses: Poses

    @abstractmethod
    def tip(self, pose: Matrix) -> Matrix:
        """The tip's position x at a pose, m."""

    @abstractmethod
    def joints(self, pose: Matrix) -> Matrix:
        """The joints' angles q at a pose, rad."""

    @abstractmethod
    def jacobian(self, pose: Matrix) -> Matrix:
        """J = dx/dq at a pose, m x m, m/rad."""

    @abstractmethod
    def bending(self, pose: Matrix) -> Matrix:
        """The tensor S of s(v)_i = sum over j, k of S_ijk v_j v_k at a pose, m x m x m, 1/m; S_ijk = S_ikj."""

    @abstractmethod
    def pose_at(self, tip: Matrix, near: Matrix) -> Matrix:
        """The pose of the box whose tip is at ``tip``.

        Args:
            tip: m coordinates, m.
            near: a pose near it; of several that fit, one that is reached from there.

        Raises:
            LinkageError: no such pose is found, or it is more than 1e-9 (rad or m) out of the box.
        """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """The plain data that :func:`linkage_of` reads, to the last bit."""

    @property
    def home(self) -> Matrix:
        """The middle of the box of poses."""
        return np.asarray((np.array(self.poses.low) + np.array(self.poses.high)) / 2.0)

    def _inside(self, pose: Matrix) -> Matrix:
        """The pose; an error if it is out of the box."""
        low, high = np.array(self.poses.low), np.array(self.poses.high)
        if not np.all((pose >= low - _OUTSIDE) & (pose <= high + _OUTSIDE)):
            raise LinkageError(
                f"found the pose {pose.tolist()}; expected one from {low.tolist()} to {high.tolist()}, where the "
                "linkage may be"
            )
        return pose

    @property
    def searched(self) -> tuple[tuple[float, float], ...]:
        """The ranges over which :func:`greatest_bending` searches; a single value where nothing depends on it."""
        return tuple(zip(self.poses.low, self.poses.high, strict=True))


@dataclass(frozen=True, eq=False)
class SerialChain(Linkage):
    """Links one behind the other, each turned by a motor in the joint at its beginning.

    A pose is the joints' angles. Where all are 0, the frames of all links are parallel to the base's. Joint i turns
    everything behind it about its own axis.

    Attributes:
        poses: the ranges of the joints' angles, rad.
        turns: by joint, the axis that it turns about: 0, 1 or 2 for x, y or z of its own frame.
        links: by joint, from it to the next one, and from the last one to the tip, in the frame that it turns, m;
            m x 3.

    Raises:
        LinkageError: not two joints that turn about z, nor three.
    """

    poses: Poses
    turns: tuple[int, ...]
    links: Matrix

    def __post_init__(self) -> None:
        n = len(self.turns)
        if self.links.shape != (n, 3) or len(self.poses.low) != n:
            raise LinkageError(f"found {n} joints, links {self.links.shape} and {len(self.poses.low)} ranges")
        if n not in (2, 3) or (n == 2 and (set(self.turns) != {2} or bool(self.links[:, 2].any()))):
            found = ", ".join("xyz"[turn] for turn in self.turns)
            raise LinkageError(f"turns: found {found}; expected three axes, or z twice, with links in a plane")

    @property
    def axes(self) -> int:  # type: ignore[override]
        """One coordinate of the tip for each joint."""
        return len(self.turns)

    def _frames(self, pose: Matrix) -> tuple[list[Matrix], list[Matrix], Matrix]:
        """The joints' axes and places, and the tip, all in the base's frame."""
        turned, place = np.eye(3), np.zeros(3)
        about, at = [], []
        for turn, link, angle in zip(self.turns, self.links, pose, strict=True):
            about.append(turned[:, turn])
            at.append(place)
            turned = turned @ _rotation(turn, float(angle))
            place = place + turned @ link
        return about, at, place

    def tip(self, pose: Matrix) -> Matrix:
        """The tip's position, m."""
        return self._frames(pose)[2][: self.axes]

    def joints(self, pose: Matrix) -> Matrix:
        """The pose itself."""
        return pose

    def _columns(self, pose: Matrix) -> tuple[list[Matrix], list[Matrix]]:
        about, at, tip = self._frames(pose)
        return about, [np.cross(axis, tip - place) for axis, place in zip(about, at, strict=True)]

    def jacobian(self, pose: Matrix) -> Matrix:
        """Column i is the axis of joint i times the lever from it to the tip."""
        return np.stack(self._columns(pose)[1], axis=1)[: self.axes]

    def bending(self, pose: Matrix) -> Matrix:
        """In (i, j) phi'' has the axis of the earlier joint times the column of J of the later one."""
        about, columns = self._columns(pose)
        n = self.axes
        second = np.empty((n, n, n))
        for i, j in product(range(n), repeat=2):
            second[:, i, j] = np.cross(about[min(i, j)], columns[max(i, j)])[:n]
        inverse = np.linalg.inv(np.stack(columns, axis=1)[:n])
        return np.asarray(np.einsum("aij,ik,jl->akl", second, inverse, inverse))

    def pose_at(self, tip: Matrix, near: Matrix) -> Matrix:
        """By Newton's method from ``near`` on, until the tip is within 1e-12 of all links' length."""
        pose, close = np.array(near, dtype=np.float64), _CLOSE * float(np.sum(np.linalg.norm(self.links, axis=1)))
        for _ in range(_MOST_STEPS):
            left = tip - self.tip(pose)
            if float(np.linalg.norm(left)) <= close:
                return self._inside(pose)
            try:
                step = np.linalg.solve(self.jacobian(pose), left)
            except np.linalg.LinAlgError:
                break
            pose = pose + step * min(1.0, _LONGEST_STEP / float(np.max(np.abs(step))))
        raise LinkageError(f"found no pose with the tip at {np.asarray(tip).tolist()} m, from {near.tolist()} rad on")

    def describe(self) -> dict[str, Any]:
        """Its kind, its axes, its links and its box."""
        shape = {"turns": ["xyz"[turn] for turn in self.turns], "links": self.links.tolist()}
        return {"kind": "chain", **shape, **_box(self.poses)}

    @property
    def searched(self) -> tuple[tuple[float, float], ...]:
        """Nothing depends on the first angle, which turns the whole chain."""
        first, *others = super().searched
        return ((first[0], first[0]), *others)


@dataclass(frozen=True, eq=False)
class ParallelArms(Linkage):
    """Arms beside each other, each with a motor at its shoulder, whose rods meet at the tip.

    The elbow of arm i is at shoulder_i + upper (cos q_i out_i + sin q_i across_i), and at the distance ``rod`` of the
    tip. A pose is the tip's position. Of the two angles that fit, the arm has the one whose elbow is further outside,
    along out_i.

    Attributes:
        poses: the ranges of the tip's coordinates, m.
        upper: the length from shoulder to elbow, m.
        rod: the length from elbow to tip, m.

    Raises:
        LinkageError: the lengths or ranges are no such linkage.
    """

    poses: Poses
    upper: float
    rod: float

    def __post_init__(self) -> None:
        if len(self.poses.low) != self.axes:
            raise LinkageError(f"found {len(self.poses.low)} ranges of the tip; expected {self.axes}")
        if not (self.upper > 0.0 and self.rod > 0.0):
            raise LinkageError(f"found lengths of {self.upper} m and {self.rod} m; expected both above 0")

    @property
    @abstractmethod
    def out(self) -> Matrix:
        """A unit row for each arm: where it points at q = 0."""

    @property
    @abstractmethod
    def across(self) -> Matrix:
        """A unit row for each arm, at a right angle to that of ``out``: where it points at q = 90 degrees."""

    @property
    @abstractmethod
    def shoulders(self) -> Matrix:
        """A row for each arm, m."""

    def _arms(self, pose: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """a, b, their product's part in front of sin and cos, and both: of the equation a cos q + b sin q = k."""
        r = pose - self.shoulders
        a, b = np.sum(r * self.out, axis=1), np.sum(r * self.across, axis=1)
        k = (np.sum(r * r, axis=1) + self.upper**2 - self.rod**2) / (2.0 * self.upper)
        left = a * a + b * b - k * k
        if np.any(left <= 0.0):
            raise LinkageError(f"found the tip at {pose.tolist()} m; expected a position that every arm reaches")
        root, whole = np.sqrt(left), a * a + b * b
        outside = np.where(b >= 0.0, 1.0, -1.0)  # cos q is the greater one
        cos, sin = (a * k + outside * b * root) / whole, (b * k - outside * a * root) / whole
        return a, b, k, cos, sin

    def tip(self, pose: Matrix) -> Matrix:
        """The pose itself."""
        return pose

    def pose_at(self, tip: Matrix, near: Matrix) -> Matrix:
        """The tip itself."""
        pose = self._inside(np.array(tip, dtype=np.float64))
        self._arms(pose)
        return pose

    def joints(self, pose: Matrix) -> Matrix:
        """The angles whose elbows are outside, rad."""
        *_, cos, sin = self._arms(pose)
        return np.arctan2(sin, cos)

    def _first(self, pose: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """psi', and what its derivative needs."""
        a, b, k, cos, sin = self._arms(pose)
        by_angle = b * cos - a * sin
        by_tip = cos[:, None] * self.out + sin[:, None] * self.across - (pose - self.shoulders) / self.upper
        return -by_tip / by_angle[:, None], by_angle, k, cos, sin

    def jacobian(self, pose: Matrix) -> Matrix:
        """The inverse of psi'."""
        return np.asarray(np.linalg.inv(self._first(pose)[0]))

    def bending(self, pose: Matrix) -> Matrix:
        """By the derivative of each arm's equation along v, twice."""
        first, by_angle, k, cos, sin = self._first(pose)
        crossed = cos[:, None] * self.across - sin[:, None] * self.out
        mixed = np.einsum("ij,ik->ijk", crossed, first)
        second = np.eye(self.axes) / self.upper - mixed - np.swapaxes(mixed, 1, 2)
        second += k[:, None, None] * np.einsum("ij,ik->ijk", first, first)
        return np.asarray(-np.einsum("ai,ijk->ajk", np.linalg.inv(first), second / by_angle[:, None, None]))


@dataclass(frozen=True, eq=False)
class FiveBar(ParallelArms):
    """Two arms in a plane; the tip is at positive y.

    Attributes:
        apart: how far the shoulders are from each other, along x, m.
    """

    apart: float
    axes = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.apart >= 0.0:
            raise LinkageError(f"found shoulders {self.apart} m apart; expected 0 or more")

    @cached_property
    def out(self) -> Matrix:
        """Away from the other arm."""
        return matrix([[-1.0, 0.0], [1.0, 0.0]])

    @cached_property
    def across(self) -> Matrix:
        """Along y."""
        return matrix([[0.0, 1.0], [0.0, 1.0]])

    @cached_property
    def shoulders(self) -> Matrix:
        """On the x axis."""
        return matrix(self.apart / 2.0 * self.out)

    def describe(self) -> dict[str, Any]:
        """Its kind, its lengths and its box."""
        return {"kind": "five-bar", "apart": self.apart, "upper": self.upper, "rod": self.rod, **_box(self.poses)}


@dataclass(frozen=True, eq=False)
class Delta(ParallelArms):
    """Three arms at 120 degrees from each other about z; the tip is at positive z.

    The platform keeps its orientation. So its joints with the rods count as one point, and its radius is taken off that
    of the shoulders.

    Attributes:
        base: the radius of the circle of the shoulders, m.
        platform: that of the rods' joints at the platform, m.
    """

    base: float
    platform: float
    axes = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.base >= 0.0 and self.platform >= 0.0):
            raise LinkageError(f"found radii of {self.base} m and {self.platform} m; expected 0 or more")

    @cached_property
    def out(self) -> Matrix:
        """Away from the z axis; the first along x."""
        angles = [2.0 * np.pi * arm / 3.0 for arm in range(3)]
        return matrix([[np.cos(angle), np.sin(angle), 0.0] for angle in angles])

    @cached_property
    def across(self) -> Matrix:
        """Along z."""
        return matrix([[0.0, 0.0, 1.0]] * 3)

    @cached_property
    def shoulders(self) -> Matrix:
        """Around the z axis."""
        return matrix((self.base - self.platform) * self.out)

    def describe(self) -> dict[str, Any]:
        """Its kind, its lengths and its box."""
        lengths = {"base": self.base, "platform": self.platform, "upper": self.upper, "rod": self.rod}
        return {"kind": "delta", **lengths, **_box(self.poses)}


LENGTHS: Final[Mapping[str, tuple[str, ...]]] = {
    "five-bar": ("apart", "upper", "rod"),
    "delta": ("base", "platform", "upper", "rod"),
}
"""The lengths that plain data state of each kind of arms, m, by key."""

_KEYS: Final = {"chain": ("turns", "links"), **LENGTHS}


def linkage_of(data: Mapping[str, Any]) -> Linkage:
    """The linkage that plain data state, as a session and a certificate have them.

    Args:
        data: ``kind``, which is one of

            - ``chain`` with ``turns``, a letter x, y or z for each joint, and ``links``, a row of three for each, m;
            - ``five-bar`` with ``apart``, ``upper`` and ``rod``, m;
            - ``delta`` with ``base``, ``platform``, ``upper`` and ``rod``, m;

            and the box of poses, ``low`` and ``high``: of the joints of a chain, rad, or of the tip, m.

    Raises:
        LinkageError: a key is missing or unknown, or a value is not what the key asks for; the text names the key.
    """
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _KEYS:
        raise LinkageError(f"kind: found {_short(kind)}; expected one of {', '.join(_KEYS)}")
    keys = ("kind", *_KEYS[kind], "low", "high")
    missing, unknown = [key for key in keys if key not in data], [key for key in data if key not in keys]
    if missing or unknown:
        raise LinkageError(f"found {_short(unknown or list(data))}; expected the keys {', '.join(keys)} of a {kind}")
    turns = _turns(data["turns"]) if kind == "chain" else ()
    number = len(turns) or (2 if kind == "five-bar" else 3)
    low, high = (tuple(_numbers(data[key], key, number)) for key in ("low", "high"))
    try:
        poses = Poses(low, high)
    except LinkageError as error:
        raise LinkageError(f"low, high: {error}") from None
    if kind == "chain":
        rows = _listed(data["links"], "links", number, "rows of x, y and z")
        links = [_numbers(row, f"links[{i}]", 3) for i, row in enumerate(rows)]
        return SerialChain(poses, turns, matrix(links))
    apart_from_zero = ("upper", "rod")
    lengths = {key: _length(data[key], key, key not in apart_from_zero) for key in LENGTHS[kind]}
    return FiveBar(poses, **lengths) if kind == "five-bar" else Delta(poses, **lengths)


def _turns(found: object) -> tuple[int, ...]:
    """The axes of two or three joints."""
    if not isinstance(found, list | tuple) or len(found) not in (2, 3):
        raise LinkageError(f"turns: found {_short(found)}; expected a list of two or three of x, y and z")
    for i, turn in enumerate(found):
        if turn not in ("x", "y", "z"):
            raise LinkageError(f"turns[{i}]: found {_short(turn)}; expected x, y or z")
    return tuple("xyz".index(turn) for turn in found)


def _listed(found: object, key: str, number: int, what: str) -> list[Any]:
    if not isinstance(found, list | tuple) or len(found) != number:
        raise LinkageError(f"{key}: found {_short(found)}; expected a list of {number} {what}")
    return list(found)


def _numbers(found: object, key: str, number: int) -> list[float]:
    return [_number(value, f"{key}[{i}]") for i, value in enumerate(_listed(found, key, number, "numbers"))]


def _number(found: object, key: str) -> float:
    try:
        if isinstance(found, int | float) and not isinstance(found, bool) and math.isfinite(found):
            return float(found)
    except OverflowError:
        pass  # a whole number that no float holds
    raise LinkageError(f"{key}: found {_short(found)}; expected a finite number")


def _length(found: object, key: str, zero: bool) -> float:
    length = _number(found, key)
    if length < 0.0 or (length == 0.0 and not zero):
        raise LinkageError(f"{key}: found {length}; expected a length of {'0 or more' if zero else 'more than 0'}, m")
    return length


def _short(found: object) -> str:
    text = repr(found) if not isinstance(found, int) or abs(found) < 10**30 else "a whole number of many digits"
    return text if len(text) <= 60 else text[:57] + "..."


def _box(poses: Poses) -> dict[str, list[float]]:
    return {"low": list(poses.low), "high": list(poses.high)}


def bending_at(linkage: Linkage, pose: Matrix, along: Matrix) -> float:
    """The greatest |s(v)| at a pose over the rows v of ``along``, 1/m; infinite at a singular pose, or out of reach."""
    try:
        tensor = linkage.bending(pose)
    except (LinkageError, np.linalg.LinAlgError):
        return np.inf
    return float(np.sqrt(np.max(np.sum(np.einsum("aij,ni,nj->na", tensor, along, along) ** 2, axis=1))))


def greatest_bending(linkage: Linkage) -> float:
    """kappa, 1/m, by a search over poses and directions: from a grid on, the best places of which are improved.

    Raises:
        LinkageError: a pose that the search comes to is singular or out of reach.
    """
    from scipy.optimize import minimize  # a tenth of a second, which commands without a linkage would take too

    ranges, m = linkage.searched, linkage.axes
    along = _directions(m)
    number = _GRID[sum(b > a for a, b in ranges)]
    grid = [np.linspace(a, b, number) if b > a else np.array([a]) for a, b in ranges]
    found = sorted(((bending_at(linkage, np.array(pose), along), pose) for pose in product(*grid)), reverse=True)
    best = _regular(*found[0])

    def negative(place: Matrix) -> float:
        return -bending_at(linkage, place[:m], _unit(place[m:])[None, :])

    for _, pose in found[:_BEST]:
        tensor = linkage.bending(np.array(pose))
        size = np.sum(np.einsum("aij,ni,nj->na", tensor, along, along) ** 2, axis=1)
        start = np.array([*pose, *_angles(along[int(np.argmax(size))])])
        better = minimize(negative, start, method="L-BFGS-B", bounds=[*ranges, *[(None, None)] * (m - 1)])
        best = max(best, _regular(-float(better.fun), better.x[:m]))
    return best


def _regular(kappa: float, pose: Iterable[float]) -> float:
    """How much the tip bends at a pose, 1/m; an error if that is without limit."""
    if not kappa < _SINGULAR:
        raise LinkageError(f"found a pose at {[float(at) for at in pose]} that is singular or out of reach")
    return kappa


def _unit(angles: Matrix) -> Matrix:
    """The unit vector of m - 1 angles: from the x axis; then towards the z axis."""
    flat = np.array([np.cos(angles[0]), np.sin(angles[0])])
    return flat if len(angles) == 1 else np.array([*(np.cos(angles[1]) * flat), np.sin(angles[1])])


def _angles(unit: Matrix) -> Matrix:
    """The angles of :func:`_unit`."""
    flat = np.arctan2(unit[1], unit[0])
    return np.array([flat]) if len(unit) == 2 else np.array([flat, np.arcsin(np.clip(unit[2], -1.0, 1.0))])


def _directions(axes: int) -> Matrix:
    """Unit vectors, one of each pair v and -v, spread evenly."""
    if axes == 2:
        return np.stack([_unit(np.array([angle])) for angle in np.linspace(0.0, np.pi, 45)])
    number = 200
    up = (np.arange(number) + 0.5) / number  # a spiral over the half sphere
    around = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(number)
    return np.stack([_unit(np.array(angles)) for angles in zip(around, np.arcsin(up), strict=True)])


def _rotation(turn: int, angle: float) -> Matrix:
    """The rotation about x, y or z (0, 1, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    one, other = (turn + 1) % 3, (turn + 2) % 3
    out = np.eye(3)
    out[one, one] = out[other, other] = cos
    out[one, other], out[other, one] = -sin, sin
    return out
