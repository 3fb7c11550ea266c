"""That the tip of a linkage bends by at most kappa, |s(v)| <= kappa for every unit v at every pose: by balls.

s(v) is the acceleration of the tip that moves with unit speed along v while no joint accelerates
(:mod:`manyhands.design.models.linkage` has the kinds; decision 50 has what follows for a held torque). It is quadratic,
s(v)_i = v^T S_i v, with symmetric S_i that depend on the pose.

**Directions.** Let |s| be greatest at v, with u = s(v)/|s(v)|. For a unit w at a right angle to v, v^T (sum u_i S_i) w
is 0, since v is greatest, and |w^T (sum u_i S_i) w| <= |s(v)|. So at an angle of theta from v, u^T s is at least
|s(v)| (cos^2 theta - sin^2 theta), and so is |s|. Directions of which every other is within theta of one, v and -v
being the same, are therefore enough:

    greatest |s| <= (greatest |s| over these directions) / cos(2 theta).

**Poses.** The box of poses is halved until on each part |s| is proved small enough, or a pose shows the contrary. With
the slopes s_k(v) from a part's middle (:mod:`manyhands.design.proof.jets`) and half its widths h_k,

    |s|^2 <= |s_0|^2 + 2 sum over k of h_k |s_0^T s_k| + (sum over k of h_k |s_k|)^2,    s_0 in the middle,

so that of the slopes those along s_0 count alone, up to squares of the widths.

**Inverses.** M over a part is inverted as (C M)^-1 C, with C the inverse in its middle, in floats. C M is about I,
whose cofactors have no cancellation that balls would miss; where rods are nearly parallel, M's own have. A part in
which C M is not proved regular is halved as well. So a box with a singular pose is never proved; nor is one in which a
tip passes the height of a shoulder, where it would be another elbow that is further outside.

The first angle of a chain turns everything, and changes no length: one value stands for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush
from typing import Final, NamedTuple, TypeVar

from flint import arb, arb_mat, fmpq

from manyhands.design.proof.exact import Item, exact_decimal
from manyhands.design.proof.finding import ProofInputError, Verdict
from manyhands.design.proof.jets import Jet

MOST_PARTS: Final = 6_000
"""Parts of boxes that the proof of one file looks at, for all its kinematics together: half a minute of a slow core."""

_ARM: Final = ("upper", "rod")
_THETA: Final = {2: 0.05, 3: 0.1}  # rad, how far the nearest direction is at most, by the tip's coordinates

Forms = list[list[Jet]]
"""By coordinate i of s, the entries S_i,jk for k <= j, row by row."""

Ranges = list[tuple[fmpq, fmpq]]


class _Part(NamedTuple):
    """A part of the box that is not looked at yet. Those of a whole that bends most come first, so that a pose that
    shows the contrary is found early.

    Attributes:
        order: minus the greatest |s(v)| in the middle of the whole that it is a half of, 1/m.
        number: of the part, for those of one order.
        ranges: of its poses.
    """

    order: float
    number: int
    ranges: Ranges


@dataclass(frozen=True)
class ChainData:
    """A chain of links one behind the other; see :class:`manyhands.design.models.linkage.SerialChain`.

    Attributes:
        low: the joints' least angles, rad.
        high: their greatest, rad.
        turns: by joint, 0, 1 or 2 for the axis x, y or z of its own frame.
        links: by joint, x, y and z of the link behind it, m.
    """

    low: tuple[fmpq, ...]
    high: tuple[fmpq, ...]
    turns: tuple[int, ...]
    links: tuple[tuple[fmpq, ...], ...]

    @property
    def whole(self) -> Ranges:
        """The box of poses; a single value where one stands for all."""
        ranges = list(zip(self.low, self.high, strict=True))
        return [(self.low[0], self.low[0]), *ranges[1:]]

    def forms(self, pose: Sequence[Jet]) -> Forms:
        """The S_i over a box of poses: of J^-T phi'' J^-1.

        Raises:
            ZeroDivisionError: J is not proved regular.
        """
        n = len(self.turns)
        nothing = pose[0] * arb(0)
        turned = [[nothing + arb(int(i == j)) for j in range(3)] for i in range(3)]
        place = [nothing] * 3
        about, at = [], []
        for turn, link, angle in zip(self.turns, self.links, pose, strict=True):
            about.append([row[turn] for row in turned])
            at.append(place)
            turned = [_turned(row, turn, angle) for row in turned]
            place = [to + _along(row, [arb(part) for part in link]) for to, row in zip(place, turned, strict=True)]
        columns = [_cross(axis, [a - b for a, b in zip(place, origin, strict=True)])
                   for axis, origin in zip(about, at, strict=True)]  # fmt: skip
        inverse = _inverse([[columns[j][i] for j in range(n)] for i in range(n)])
        second = {(i, j): _cross(about[i], columns[j]) for i in range(n) for j in range(i, n)}
        return [
            _between(inverse, [[second[min(i, j), max(i, j)][row] for j in range(n)] for i in range(n)])
            for row in range(n)
        ]


@dataclass(frozen=True)
class ArmsData:
    """Arms beside each other; see :class:`manyhands.design.models.linkage.ParallelArms`.

    Attributes:
        low: the tip's least coordinates, m.
        high: its greatest, m.
        shoulders: by arm, m.
        out: by arm, where it points at 0, a unit vector in balls.
        across: by arm, where it points at 90 degrees, likewise.
        upper: from shoulder to elbow, m.
        rod: from elbow to tip, m.
    """

    low: tuple[fmpq, ...]
    high: tuple[fmpq, ...]
    shoulders: tuple[tuple[arb, ...], ...]
    out: tuple[tuple[arb, ...], ...]
    across: tuple[tuple[arb, ...], ...]
    upper: fmpq
    rod: fmpq

    @classmethod
    def five_bar(cls, low: tuple[fmpq, ...], high: tuple[fmpq, ...], apart: fmpq, upper: fmpq, rod: fmpq) -> ArmsData:
        """Two arms in a plane; see :class:`manyhands.design.models.linkage.FiveBar`."""
        out = ((arb(-1), arb(0)), (arb(1), arb(0)))
        return cls._around(low, high, apart / 2, out, ((arb(0), arb(1)),) * 2, upper, rod)

    @classmethod
    def delta(cls, low: tuple[fmpq, ...], high: tuple[fmpq, ...], radius: fmpq, upper: fmpq, rod: fmpq) -> ArmsData:
        """Three arms at 120 degrees; see :class:`manyhands.design.models.linkage.Delta`. ``radius`` is its radii's
        difference, m.
        """
        turns = [arb(fmpq(2 * arm, 3)) for arm in range(3)]
        out = tuple((turn.cos_pi(), turn.sin_pi(), arb(0)) for turn in turns)
        return cls._around(low, high, radius, out, ((arb(0), arb(0), arb(1)),) * 3, upper, rod)

    @classmethod
    def _around(
        cls,
        low: tuple[fmpq, ...],
        high: tuple[fmpq, ...],
        radius: fmpq,
        out: tuple[tuple[arb, ...], ...],
        across: tuple[tuple[arb, ...], ...],
        upper: fmpq,
        rod: fmpq,
    ) -> ArmsData:
        shoulders = tuple(tuple(arb(radius) * part for part in row) for row in out)
        return cls(low, high, shoulders, out, across, upper, rod)

    @property
    def whole(self) -> Ranges:
        """The box of poses."""
        return list(zip(self.low, self.high, strict=True))

    def forms(self, pose: Sequence[Jet]) -> Forms:
        """The S_i over a box of poses.

        The rods keep their length. So for the rod d_i from elbow to tip, twice differentiated along the motion,

            d_i^T s = -g_i(v),    g_i(v) = |v|^2 - 2 (t_i^T v) w_i + (d_i + c_i)^T c_i w_i^2,

        with c_i from shoulder to elbow, t_i its derivative by q_i, and w_i = d_i^T v / d_i^T t_i the rate of q_i.

        Raises:
            ZeroDivisionError: the rods are not proved independent, or an arm not proved to reach.
        """
        arms = [self._arm(pose, *of) for of in zip(self.shoulders, self.out, self.across, strict=True)]
        inverse = _inverse([rod for rod, _ in arms])
        return [[-_dot(row, g) for g in zip(*(forms for _, forms in arms), strict=True)] for row in inverse]

    def _arm(
        self, pose: Sequence[Jet], shoulder: Sequence[arb], out: Sequence[arb], across: Sequence[arb]
    ) -> tuple[list[Jet], list[Jet]]:
        """The rod d and the entries of g for one arm, from a cos q + b sin q = k, which is (d + c)^T c / upper."""
        upper = arb(self.upper)
        r = [at - place for at, place in zip(pose, shoulder, strict=True)]
        a, b = _along(r, out), _along(r, across)
        k = (_dot(r, r) + (upper * upper - arb(self.rod) ** 2)) / (2 * upper)
        squared = a * a + b * b
        left = squared - k * k
        if not left > 0 or not (b > 0 or b < 0):
            raise ZeroDivisionError
        lever = left.sqrt() if b > 0 else -left.sqrt()  # the elbow that is further outside: cos q is the greater one
        over = squared.inverse()
        cos, sin = (a * k + b * lever) * over, (b * k - a * lever) * over
        rod = [at - (cos * o + sin * c) * upper for at, o, c in zip(r, out, across, strict=True)]
        tangent = [cos * c - sin * o for o, c in zip(out, across, strict=True)]
        over, k = lever.inverse(), k / upper
        rate = [part * over for part in rod]  # upper times that of q by the tip
        entries = [(i, j) for i in range(len(rod)) for j in range(i + 1)]
        return rod, [
            k * rate[i] * rate[j] - tangent[i] * rate[j] - rate[i] * tangent[j] + arb(int(i == j)) for i, j in entries
        ]


LinkageData = ChainData | ArmsData


def read_linkage(item: Item) -> LinkageData:
    """The linkage of plain data; :func:`manyhands.design.models.linkage.linkage_of` has their keys.

    Raises:
        ProofInputError: the data are not of the format.
    """
    found = item.entries(16)
    if "kind" not in found:
        raise ProofInputError(f"{item.path}: the key kind is missing")
    match found["kind"].text("chain", "five-bar", "delta"):
        case "chain":
            return _chain(item.fields(("kind", "turns", "links", "low", "high")))
        case "five-bar":
            parts = item.fields(("kind", "apart", "upper", "rod", "low", "high"))
            low, high = _box(parts, 2)
            return ArmsData.five_bar(
                low, high, _length(parts["apart"], zero=True), *(_length(parts[of]) for of in _ARM)
            )
        case _:
            parts = item.fields(("kind", "base", "platform", "upper", "rod", "low", "high"))
            low, high = _box(parts, 3)
            radius = _length(parts["base"], zero=True) - _length(parts["platform"], zero=True)
            return ArmsData.delta(low, high, radius, *(_length(parts[of]) for of in _ARM))


def _chain(parts: dict[str, Item]) -> ChainData:
    turns = tuple("xyz".index(turn.text("x", "y", "z")) for turn in parts["turns"].items(3))
    n = len(turns)
    links = parts["links"].items(n, exactly=n)
    rows = tuple(tuple(exact_decimal(part.number()) for part in link.items(3, exactly=3)) for link in links)
    if n not in (2, 3) or (n == 2 and (turns != (2, 2) or any(row[2] != 0 for row in rows))):
        raise parts["turns"].refusal("three axes, or z twice, with links in a plane")
    return ChainData(*_box(parts, n), turns, rows)


def _box(parts: dict[str, Item], axes: int) -> tuple[tuple[fmpq, ...], tuple[fmpq, ...]]:
    low, high = (tuple(exact_decimal(end.number()) for end in parts[of].items(axes, exactly=axes))
                 for of in ("low", "high"))  # fmt: skip
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise parts["high"].refusal("numbers greater than those of low")
    return low, high


def _length(item: Item, zero: bool = False) -> fmpq:
    """A length, m; 0 only where that is allowed."""
    length = exact_decimal(item.number())
    if length < 0 or (length == 0 and not zero):
        raise item.refusal("a length of 0 or more" if zero else "a length greater than 0")
    return length


def bends_at_most(linkage: LinkageData, kappa: fmpq, most_parts: int = MOST_PARTS) -> Verdict:
    """Whether |s(v)| <= kappa for every unit v and every pose of the box.

    Args:
        linkage: the linkage with its box.
        kappa: 1/m. It is decided soon where it is 10 % above the greatest |s(v)|, or below it.
        most_parts: of the box, that are looked at before it is given up. A thousand take a few seconds.
    """
    directions = _directions(len(linkage.low))
    bound = arb(kappa) * (2 * directions.nearest).cos()
    whole = linkage.whole
    parts = [_Part(-math.inf, 0, whole)]
    made, proved, greatest = 1, 0, 0.0
    while parts:
        ranges = heappop(parts).ranges
        if made > most_parts:
            return Verdict(False, greatest, f"not decided with {most_parts} parts of the box of poses")
        middle = _shown([(low + high) / 2 for low, high in ranges])
        try:
            forms = _forms(linkage, _arguments(ranges))
        except ZeroDivisionError:
            if not _regular(linkage, ranges):
                return Verdict(False, math.inf, f"the pose {middle} is not proved to be regular and within reach")
            order, halved = -math.inf, _widest(ranges, whole)
        else:
            at, along = _greatest(forms, directions, bound)
            greatest = max(greatest, float(at.mid()))
            if not at <= bound:  # no part that has this pose will be proved, however small
                bends = f"the tip bends by {float(at.mid()):.6g} 1/m at {middle}"
                return Verdict(False, greatest, f"{bends}; expected at most {float(bound.mid()):.6g}")
            if along is None:
                proved += 1
                continue
            order, halved = -float(at.mid()), along
        for half in _halves(ranges, halved):
            made += 1
            heappush(parts, _Part(order, made, half))
    return Verdict(True, greatest, f"by balls on {proved} parts of the box of poses")


def _arguments(ranges: Ranges) -> list[Jet]:
    """A pose in these ranges. Of a single value, the nearest float: it stands for all."""
    return Jet.arguments([arb(low).union(arb(high)) if low < high else arb(low).mid() for low, high in ranges])


def _forms(linkage: LinkageData, pose: Sequence[Jet]) -> Forms:
    """The S_i over a box of poses, finite in its middle.

    Raises:
        ZeroDivisionError: the poses are not proved regular and within reach.
    """
    forms = linkage.forms(pose)
    if not all(entry.middle.is_finite() for row in forms for entry in row):
        raise ZeroDivisionError
    return forms


def _regular(linkage: LinkageData, ranges: Ranges) -> bool:
    """Whether the pose in the middle of these ranges is proved regular and within reach."""
    middle = [argument.middle for argument in _arguments(ranges)]
    try:
        _forms(linkage, Jet.arguments(middle))
    except ZeroDivisionError:
        return False
    return True


def _widest(ranges: Ranges, whole: Ranges) -> int:
    """The coordinate of which most is left."""
    left = [fmpq(0) if top == base else (high - low) / (top - base)
            for (low, high), (base, top) in zip(ranges, whole, strict=True)]  # fmt: skip
    return max(range(len(left)), key=left.__getitem__)


def _halves(ranges: Ranges, axis: int) -> tuple[Ranges, Ranges]:
    """Two halves along a coordinate."""
    low, high = ranges[axis]
    middle = (low + high) / 2
    before, after = ranges[:axis], ranges[axis + 1 :]
    return [*before, (low, middle), *after], [*before, (middle, high), *after]


class _Directions(NamedTuple):
    """Unit vectors v.

    Attributes:
        table: a row for each: v_j v_k for k <= j, twice where k < j.
        rows: the rows as matrices.
        nearest: theta, which no direction is further from all of them, rad.
    """

    table: arb_mat
    rows: list[arb_mat]
    nearest: arb


def _greatest(forms: Forms, directions: _Directions, bound: arb) -> tuple[arb, int | None]:
    """Whether |s(v)| <= bound for each of the directions, all over the part of ``forms``.

    Directions are looked at from the one on that bends most in the middle. Where not even the greatest slope of any
    direction would lead to the bound, the rest is proved.

    Returns:
        The greatest |s(v)| in the middle, 1/m; and None if the bound is proved, or else the coordinate of the pose that
        most of the excess is due to.
    """
    m = len(forms)
    half = [step.abs_upper() for step in forms[0][0].steps]
    middles = (directions.table * _columns([[jet.middle for jet in row] for row in forms])).tolist()
    squares = [_dot(row, row) for row in middles]
    order = sorted(range(len(squares)), key=lambda n: -float(squares[n].upper()))
    slopes = [[jet.slopes[k] * half[k] for jet in row] for k in range(m) for row in forms]
    table = _columns(slopes)
    change = sum((_norm(slopes[m * k : m * k + m]) for k in range(m)), arb(0))
    at = squares[order[0]].sqrt()
    for n in order:
        if squares[n].sqrt() + change <= bound:
            break
        row = (directions.rows[n] * table).entries()
        steps = [row[m * k : m * k + m] for k in range(m)]
        first = [2 * abs(_dot(middles[n], step)) for step in steps]
        second = [_dot(step, step).abs_upper().sqrt() for step in steps]
        square = squares[n] + sum(first, arb(0)) + sum(second, arb(0)) ** 2
        if not square <= bound * bound:
            due = [float((a + b * b).abs_upper()) for a, b in zip(first, second, strict=True)]
            return at, max(range(m), key=due.__getitem__)
    return at, None


def _columns(rows: Sequence[Sequence[arb]]) -> arb_mat:
    """A matrix with these columns."""
    return arb_mat(len(rows[0]), len(rows), [entry for column in zip(*rows, strict=True) for entry in column])


def _norm(forms: Sequence[Sequence[arb]]) -> arb:
    """At least |s(v)| of every unit v: the root of all squares of all matrices' entries."""
    pairs = [(j, k) for j in range(len(forms)) for k in range(j + 1)]
    total = arb(0)
    for row in forms:
        for (j, k), entry in zip(pairs, row, strict=True):
            total += entry * entry if j == k else 2 * entry * entry
    return total.abs_upper().sqrt()


@lru_cache
def _directions(m: int) -> _Directions:
    """Directions of the plane or of space, one of each pair v and -v.

    In space they stand on rings about z. From a direction at the polar angle a to one of a ring at a', the chord is

        4 sin^2((a - a')/2) + 4 sin a sin a' sin^2(b/2) <= (a - a')^2 + sin a sin a' b^2

    squared, where b is the difference of their azimuths.
    """
    theta = _THETA[m]
    if m == 2:
        number = math.ceil(math.pi / (2.0 * theta))
        angles = [arb.pi() * k / number for k in range(number)]
        return _of([[angle.cos(), angle.sin()] for angle in angles], arb.pi() / (2 * number))
    rings = math.ceil(math.pi / 2.0 / (math.sqrt(2.0) * theta))
    half = arb.pi() / (4 * rings)  # from a ring to the middle between it and the next
    chord, vectors = arb(0), []
    for ring in range(rings):
        polar = half * (2 * ring + 1)
        number = math.ceil(2.0 * math.pi * float(polar.sin().mid()) / (math.sqrt(2.0) * theta)) + 1
        step = 2 * arb.pi() / number
        vectors += [
            [polar.sin() * (step * k).cos(), polar.sin() * (step * k).sin(), polar.cos()] for k in range(number)
        ]
        chord = chord.max(half**2 + polar.sin() * (polar.sin() + half) * (step / 2) ** 2)
    return _of(vectors, 2 * (chord.sqrt() / 2).asin())


def _of(vectors: Sequence[Sequence[arb]], nearest: arb) -> _Directions:
    m = len(vectors[0])
    rows = [[v[j] * v[k] * (1 if j == k else 2) for j in range(m) for k in range(j + 1)] for v in vectors]
    return _Directions(arb_mat(rows), [arb_mat([row]) for row in rows], nearest)


def _shown(pose: Sequence[fmpq]) -> str:
    return "(" + ", ".join(f"{float(arb(value).mid()):.4g}" for value in pose) + ")"


def _turned(row: list[Jet], turn: int, angle: Jet) -> list[Jet]:
    """A row of R times the rotation about x, y or z (0, 1, 2)."""
    one, other = (turn + 1) % 3, (turn + 2) % 3
    cos, sin, out = angle.cos(), angle.sin(), list(row)
    out[one], out[other] = row[one] * cos + row[other] * sin, row[other] * cos - row[one] * sin
    return out


def _between(inverse: list[list[Jet]], middle: list[list[Jet]]) -> list[Jet]:
    """The entries of J^-T M J^-1 on and below the diagonal."""
    columns = list(zip(*inverse, strict=True))
    right = [[_dot(row, column) for row in middle] for column in columns]
    return [_dot(columns[j], right[k]) for j in range(len(columns)) for k in range(j + 1)]


def _inverse(M: list[list[Jet]]) -> list[list[Jet]]:
    """The inverse (C M)^-1 C of a 2 x 2 or 3 x 3 matrix, with C that of its middle, nearly.

    Raises:
        ZeroDivisionError: it is not proved regular.
    """
    inverse = arb_mat([[entry.middle.mid() for entry in row] for row in M]).inv()
    C = [[entry.mid() for entry in row] for row in inverse.tolist()]
    near = _by_cofactors([[_along(column, row) for column in zip(*M, strict=True)] for row in C])
    return [[_along(row, column) for column in zip(*C, strict=True)] for row in near]


def _by_cofactors(M: list[list[Jet]]) -> list[list[Jet]]:
    if len(M) == 2:
        (a, b), (c, d) = M
        adjugate = [[d, -b], [-c, a]]
    else:
        rows = [_cross(M[1], M[2]), _cross(M[2], M[0]), _cross(M[0], M[1])]
        adjugate = [[rows[j][i] for j in range(3)] for i in range(3)]
    over = _dot(M[0], [row[0] for row in adjugate]).inverse()
    return [[entry * over for entry in row] for row in adjugate]


def _cross(a: Sequence[Jet], b: Sequence[Jet]) -> list[Jet]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


Real = TypeVar("Real", arb, Jet)


def _dot(a: Sequence[Real], b: Sequence[Real]) -> Real:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _along(a: Sequence[Jet], b: Sequence[arb]) -> Jet:
    """The product with numbers."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total
