"""A simulated mechanism whose motors hold torques: the mass of :class:`Plant` behind the joints of a linkage.

A force f of the couplings stands for the torques t = J(q)^T f, with the joints q as they were at the last sample. The
motors hold t. The tip is then pushed by F = J(q)^-T t, which changes as it moves. This is the oldest reading of the
joints that a certificate covers, and so the one that takes most from it.

**The books are exact.** A step of at most :data:`STEP` has a constant force R on the linear plant, such that its work
is that of the motors, R^T dx = t^T dq: the discrete gradient of [Gonzalez1996]_

    R = F' + (t^T dq - F'^T dx) dx / |dx|^2,    F' = (F(q) + F(q + dq))/2.

It is the fixed point of a few steps, for R moves the end of a step by far less than F' changes on the way. So no energy
comes from the integration itself, and R differs from the mean push by the order of (kappa dx)^2 F.

The state of the plant is followed by that of the motors: the joints' angles, the impulse of R and its work so far.

**The joints** are computed in plain floats: a step needs them ten times, and numpy would take longer than a period. In
plain Python a step of two axes takes 0.1 ms to 0.2 ms, and one of a chain of three 0.5 ms. A certificate's bound of
kappa has its own arithmetic of the same data.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final

from manyhands.design.models.device import HeldDevice
from manyhands.nodes.device.simulated import Intention, Plant
from manyhands.nodes.kernel.arithmetic import Floats, Rows, dot, minus, plus, solve
from manyhands.protocol.clock import Duration, from_seconds, seconds

STEP: Final = from_seconds(500e-6)
"""The longest step of a torque that acts, ns: at 0.5 m/s and kappa = 20/m R is off by 2e-6 of it."""

_SINGULAR: Final = 1e-9  # of a pivot of J, m/rad
_NEAR: Final = 1e-8  # rad; a step of Newton's that is shorter leaves an error of its square
MOST_STEPS: Final = 20
"""The most rounds of an iteration."""

ROUNDING: Final = 2e-15
"""Of angles and their differences, rad."""

UNMOVED: Final = 1e-7
"""On a shorter way F' does the work of the motors to rounding, m."""


class TipAstray(ValueError):
    """The tip has come to where its linkage cannot be, or to a singular pose."""


class Joints(ABC):
    """The joints of a linkage by the place of its tip, in floats.

    Attributes:
        home: the joints' angles at x = 0, rad.
    """

    home: Floats

    @abstractmethod
    def at(self, x: Floats, near: Floats) -> Floats:
        """The angles at the displacement x (m) of the tip, next to the angles ``near``, rad.

        Raises:
            TipAstray: there are none.
        """

    @abstractmethod
    def torque(self, f: Floats, x: Floats, q: Floats) -> Floats:
        """J^T f, N*m."""

    @abstractmethod
    def push(self, t: Floats, x: Floats, q: Floats) -> Floats:
        """J^-T t, N."""

    @abstractmethod
    def by_tip(self, x: Floats, q: Floats) -> Rows:
        """The rows of dq/dx, one a joint, 1/m."""


class ChainJoints(Joints):
    """Those of a chain of links in space: from one place to the next by Newton's method."""

    def __init__(self, turns: list[int], links: list[Floats], home: Floats) -> None:
        """Take a chain.

        Args:
            turns: by joint, the axis that it turns about: 0, 1 or 2 for x, y or z of its own frame.
            links: by joint, from it to the next one, or to the tip, in the frame that it turns, m.
            home: the angles at x = 0, rad.
        """
        self._turns, self._links, self._m, self.home = turns, links, len(home), home
        self._origin: Floats = [0.0] * self._m
        self._origin = self._placed(home)[0]

    def at(self, x: Floats, near: Floats) -> Floats:
        """The angles at x."""
        q = near
        for _ in range(MOST_STEPS):
            tip, columns = self._placed(q)
            step = solve([[column[i] for column in columns] for i in range(self._m)], minus(x, tip), _SINGULAR)
            if step is None or not all(map(math.isfinite, step)):
                break
            q = plus(q, step)
            if max(map(abs, step)) < _NEAR:
                return q
        raise astray(x)

    def torque(self, f: Floats, x: Floats, q: Floats) -> Floats:
        """J^T f."""
        return [dot(column, f) for column in self._placed(q)[1]]

    def push(self, t: Floats, x: Floats, q: Floats) -> Floats:
        """J^-T t."""
        f = solve(self._placed(q)[1], t, _SINGULAR)
        if f is None:
            raise astray(x)
        return f

    def by_tip(self, x: Floats, q: Floats) -> Rows:
        """The rows of dq/dx, of the columns of J."""
        columns, rows = self._placed(q)[1], []
        for joint in range(self._m):
            row = solve(columns, [1.0 if joint == other else 0.0 for other in range(self._m)], _SINGULAR)
            if row is None:
                raise astray(x)
            rows.append(row)
        return rows

    def _placed(self, q: Floats) -> tuple[Floats, list[Floats]]:
        """The tip's displacement, and the columns of J."""
        m = self._m
        turned: list[Floats] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]  # the axes of the present frame
        place: Floats = [0.0, 0.0, 0.0]
        about: list[Floats] = []
        places: list[Floats] = []
        for turn, link, angle in zip(self._turns, self._links, q, strict=True):
            about.append(turned[turn])
            places.append(place)
            one, other = (turn + 1) % 3, (turn + 2) % 3
            cos, sin = math.cos(angle), math.sin(angle)
            a, b = turned[one], turned[other]
            after: list[Floats] = [turned[turn], turned[turn], turned[turn]]
            after[one] = [cos * a[i] + sin * b[i] for i in range(3)]
            after[other] = [cos * b[i] - sin * a[i] for i in range(3)]
            turned = after
            place = [place[i] + dot([axis[i] for axis in turned], link) for i in range(3)]
        columns = [_cross(axis, minus(place, at))[:m] for axis, at in zip(about, places, strict=True)]
        return minus(place[:m], self._origin), columns


class PlanarJoints(Joints):
    """Those of two links in a plane, in closed form."""

    def __init__(self, links: list[Floats], home: Floats) -> None:
        """Take both links, each in the frame that its joint turns, m, and the angles at x = 0, rad."""
        self._lengths = [math.hypot(link[0], link[1]) for link in links]
        self._offsets = [math.atan2(link[1], link[0]) for link in links]
        self.home = home
        first, second = self._ways(home)
        self._origin: Floats = plus(first, second)

    def at(self, x: Floats, near: Floats) -> Floats:
        """The angles at x; of both the ones whose elbow is on the same side as that of ``near``."""
        a, b = self._lengths
        X, Y = x[0] + self._origin[0], x[1] + self._origin[1]
        cos = (X * X + Y * Y - a * a - b * b) / (2.0 * a * b)
        if not -1.0 < cos < 1.0:
            raise astray(x)
        bend = self._offsets[1] - self._offsets[0]
        sin = math.copysign(math.sqrt(1.0 - cos * cos), math.sin(near[1] + bend))
        first = math.atan2(Y, X) - math.atan2(b * sin, a + b * cos) - self._offsets[0]
        second = math.atan2(sin, cos) - bend
        # the same way round as before, so that differences of angles are those of a motion
        return [_next_to(first, near[0]), _next_to(second, near[1])]

    def torque(self, f: Floats, x: Floats, q: Floats) -> Floats:
        """J^T f."""
        first, second = self._ways(q)
        outer = second[0] * f[1] - second[1] * f[0]
        return [first[0] * f[1] - first[1] * f[0] + outer, outer]

    def push(self, t: Floats, x: Floats, q: Floats) -> Floats:
        """J^-T t: a force along the first link turns the second joint alone, and one along the second the first."""
        first, second = self._ways(q)
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < _SINGULAR:
            raise astray(x)
        inner, outer = (t[0] - t[1]) / area, t[1] / area
        return [inner * second[0] - outer * first[0], inner * second[1] - outer * first[1]]

    def by_tip(self, x: Floats, q: Floats) -> Rows:
        """The rows of dq/dx, in closed form."""
        first, second = self._ways(q)
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < _SINGULAR:
            raise astray(x)
        return [[way / area for way in second], [-(a + b) / area for a, b in zip(first, second, strict=True)]]

    def _ways(self, q: Floats) -> tuple[Floats, Floats]:
        """Both links as they lie, m."""
        (a, b), one = self._lengths, q[0] + self._offsets[0]
        both = q[0] + q[1] + self._offsets[1]
        return [a * math.cos(one), a * math.sin(one)], [b * math.cos(both), b * math.sin(both)]


class ArmJoints(Joints):
    """Those of arms beside each other, in closed form."""

    def __init__(self, arms: list[tuple[Floats, Floats, Floats]], upper: float, rod: float, home: Floats) -> None:
        """Take arms.

        Args:
            arms: of each its shoulder, m, where it points at the angle 0, and where at a right angle.
            upper: from shoulder to elbow, m.
            rod: from elbow to tip, m.
            home: the tip's place at x = 0, m.
        """
        self._arms, self._tip, self._upper, self._rod = arms, home, upper, rod
        zero = [0.0] * len(home)
        self.home = self.at(zero, zero)

    def at(self, x: Floats, near: Floats) -> Floats:
        """The angles at x whose elbows are outside."""
        tip, q = plus(x, self._tip), []
        for shoulder, out, across in self._arms:
            r = minus(tip, shoulder)
            a, b = dot(r, out), dot(r, across)
            k = (dot(r, r) + self._upper**2 - self._rod**2) / (2.0 * self._upper)
            left = a * a + b * b - k * k
            if not left > 0.0:
                raise astray(x)
            root = math.copysign(math.sqrt(left), b if b != 0.0 else 1.0)
            q.append(math.atan2(b * k - a * root, a * k + b * root))
        return q

    def torque(self, f: Floats, x: Floats, q: Floats) -> Floats:
        """J^T f: of the transpose of dq/dx, backwards."""
        rows = self.by_tip(x, q)
        t = solve([[row[i] for row in rows] for i in range(len(f))], f, _SINGULAR)
        if t is None:
            raise astray(x)
        return t

    def push(self, t: Floats, x: Floats, q: Floats) -> Floats:
        """J^-T t."""
        rows = self.by_tip(x, q)
        return [sum(row[i] * torque for row, torque in zip(rows, t, strict=True)) for i in range(len(t))]

    def by_tip(self, x: Floats, q: Floats) -> Rows:
        """The rows of dq/dx, by each arm's equation."""
        tip, rows = plus(x, self._tip), []
        for (shoulder, out, across), angle in zip(self._arms, q, strict=True):
            r = minus(tip, shoulder)
            cos, sin = math.cos(angle), math.sin(angle)
            by_angle = dot(r, across) * cos - dot(r, out) * sin
            if abs(by_angle) < _SINGULAR:
                raise astray(x)
            to = [r[i] / self._upper - cos * out[i] - sin * across[i] for i in range(len(r))]
            rows.append([entry / by_angle for entry in to])
        return rows


def joints_of(linkage: Mapping[str, Any]) -> Joints:
    """The joints of a linkage, as its plain data have it; the tip is at x = 0 in the middle of the stated ranges.

    Raises:
        ValueError: the data are no linkage.
    """
    try:
        low, high = _numbers(linkage["low"]), _numbers(linkage["high"])
        home = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        match linkage["kind"]:
            case "chain":
                turns, links = (
                    [_TURNS[turn] for turn in linkage["turns"]],
                    [_numbers(link) for link in linkage["links"]],
                )
                if not len(turns) == len(links) == len(home) or any(len(link) != 3 for link in links):
                    raise ValueError(f"found {len(turns)} turns and {len(links)} links; expected {len(home)} of each")
                if len(home) == 2 and (set(turns) != {2} or any(link[2] for link in links)):
                    raise ValueError("found two joints that do not turn about z, or links out of its plane")
                return PlanarJoints(links, home) if len(home) == 2 else ChainJoints(turns, links, home)
            case "five-bar":
                half = 0.5 * float(linkage["apart"])
                arms = [([-half, 0.0], [-1.0, 0.0], [0.0, 1.0]), ([half, 0.0], [1.0, 0.0], [0.0, 1.0])]
                return ArmJoints(arms, float(linkage["upper"]), float(linkage["rod"]), home)
            case "delta":
                radius, arms = float(linkage["base"]) - float(linkage["platform"]), []
                for arm in range(3):
                    out = [math.cos(2.0 * math.pi * arm / 3.0), math.sin(2.0 * math.pi * arm / 3.0), 0.0]
                    arms.append(([radius * way for way in out], out, [0.0, 0.0, 1.0]))
                return ArmJoints(arms, float(linkage["upper"]), float(linkage["rod"]), home)
            case kind:
                raise ValueError(f"found the kind {kind!r:.40}; expected chain, five-bar or delta")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"linkage: found no kinematics: {error!r:.200}") from error


_TURNS: Final = {"x": 0, "y": 1, "z": 2}


def _next_to(angle: float, near: float) -> float:
    """The same angle, within half a turn of ``near``, rad."""
    return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))


def _numbers(data: Sequence[Any]) -> Floats:
    return list(map(float, data))


class Mechanism(Plant):
    """A :class:`Plant` behind the joints of a linkage; what its steps take as a force are the torques that are held."""

    def __init__(self, device: HeldDevice, T: float, linkage: Mapping[str, Any]) -> None:
        """Sample ``device`` with the period ``T``, s.

        Args:
            device: the device with its hand; its axes are those of the linkage's tip.
            T: period, s.
            linkage: its kinematics as plain data (:func:`joints_of`).

        Raises:
            ValueError: the data are no linkage, or one with another number of axes.
        """
        super().__init__(device, T, parts=True)
        self._joints = joints_of(linkage)
        if len(self._joints.home) != self.axes:
            raise ValueError(f"linkage: found {len(self._joints.home)} joints; expected {self.axes}, one an axis")

    def holding(self, x: Floats, v: Floats) -> Floats:
        """As of :class:`Plant`, with motors that have done nothing yet."""
        q = self._joints.at(x, self._joints.home)
        return [*super().holding(x, v), *q, *[0.0] * self.axes, 0.0]

    def holds(self, f: Floats, read: Floats) -> Floats:
        """The torques that stand for f (N) in the state ``read``, N*m."""
        return self._joints.torque(f, read[: self.axes], read[self.order : self.order + self.axes])

    def done(self, state: Floats) -> float:
        """What the motors have done so far, J."""
        return state[-1]

    def after(self, before: Floats, f: Floats, intention: Intention, part: int | None = None) -> Floats:
        """The state after one period, or a part of it, under the torques ``f``, N*m."""
        left = self._period if part is None else part
        if not any(f):
            return self._free(before, intention, left)
        steps = -(-left // STEP)
        state = before
        for number in range(steps, 0, -1):
            h = left // number
            state = self._stepped(state, f, intention, h)
            left -= h
        return state

    def seen(self, before: Floats, f: Floats, intention: Intention, part: int) -> Floats:
        """As :meth:`after`: what the motors do is seen as well."""
        return self.after(before, f, intention, part)

    def work(self, before: Floats, after: Floats, f: Floats, intention: Intention, part: int | None = None) -> float:
        """The intention's work over a step of :meth:`after`, J; both states are whole."""
        n, m = self.order, self.axes
        h = seconds(Duration(self._period if part is None else part))
        given = minus(after[n + m : n + 2 * m], before[n + m : n + 2 * m])
        impulse = [by + force * h for by, force in zip(given, intention.force, strict=True)]
        return self._work_by(impulse, before, after, intention)

    def _free(self, before: Floats, intention: Intention, h: int) -> Floats:
        """The state after h ns without a torque."""
        n, m = self.order, self.axes
        after = self._linear(before[:n], [0.0] * m, intention, h, n)
        return after + self._joints.at(after[:m], before[n : n + m]) + before[n + m :]

    def _linear(self, state: Floats, R: Floats, intention: Intention, h: int, rows: int) -> Floats:
        assert self._parts is not None  # noqa: S101
        return self._parts.step(state, plus(R, intention.force) + intention.velocity, h, rows)

    def _stepped(self, before: Floats, t: Floats, intention: Intention, h: int) -> Floats:
        """The state after a step of h ns, at most :data:`STEP`, under the torques t, N*m."""
        n, m, joints = self.order, self.axes, self._joints
        linear, x, first = before[:n], before[:m], before[n : n + m]
        begin = joints.push(t, x, first)
        R, q, exact = begin, first, ROUNDING * max(map(abs, t))
        for _ in range(MOST_STEPS):
            to = self._linear(linear, R, intention, h, m)
            q = joints.at(to, q)
            dx = minus(to, x)
            mean = [0.5 * (a + b) for a, b in zip(begin, joints.push(t, to, q), strict=True)]
            square, last = dot(dx, dx), R
            if square > UNMOVED**2:
                lacks = (dot(t, minus(q, first)) - dot(mean, dx)) / square
                mean = [force + lacks * way for force, way in zip(mean, dx, strict=True)]
            R = mean
            if abs(dot(minus(R, last), dx)) <= exact:
                break
        after = self._linear(linear, R, intention, h, n)
        dx = minus(after[:m], x)
        span = seconds(Duration(h))
        impulse = [so_far + force * span for so_far, force in zip(before[n + m : n + 2 * m], R, strict=True)]
        return [*after, *joints.at(after[:m], q), *impulse, before[-1] + dot(R, dx)]


def _cross(a: Floats, b: Floats) -> Floats:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def astray(x: Floats) -> TipAstray:
    """The error of a tip at x, m."""
    return TipAstray(f"found the tip of a simulated linkage at {x} m; expected it where its joints can bring it")
