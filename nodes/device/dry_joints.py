"""Dry friction in the joints of a simulated linkage, N*m by joint (:class:`DryMechanism`).

**A step** is one of a :class:`Mechanism`, whose motors hold the torques t, and in which the friction of each joint is a
constant torque phi as well. With the *discrete* derivative P of the joints by the tip,

    P_j = P'_j + (dq_j - P'_j^T dx) dx^T / |dx|^2,    P' = (dq/dx(x) + dq/dx(x + dx))/2,    so that P dx = dq exactly,

the tip is pushed by R = P^T (t + phi), and the work of that is t^T dq + phi^T dq. phi is that of Coulomb's law between
the ends of the step,

    phi_j = -c_j sign(dq_j),    or    |phi_j| <= c_j    where dq_j = 0,

so that friction burns sum c_j |dq_j|, exactly. The tip moves in the step by dx = a + G R, as that of a plant without
joints does (:mod:`manyhands.nodes.device.friction`). So the joints move by P (a + G P^T t) + (P G P^T) phi. For the P
of the last round phi is the one solution of a linear complementarity problem with a symmetric positive matrix. With
two or three joints one of 9 or 27 patterns of joints that stand, or turn either way, has it. P changes so little with
dx that a few rounds settle both.

**A joint that stands** is stopped: what is left of its momentum is taken by an impulse of its own friction. Of all
velocities with which the joint stands, it leaves the nearest one by kinetic energy, so that it takes energy and gives
none. Where all joints stand, the tip is where it was, to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, Final

from manyhands.design.models.device import HeldDevice
from manyhands.nodes.device.mechanism import MOST_STEPS, ROUNDING, STEP, UNMOVED, Mechanism, astray
from manyhands.nodes.device.simulated import Intention
from manyhands.nodes.kernel.arithmetic import Floats, Rows, dot, minus, plus, solve
from manyhands.protocol.clock import Duration, seconds

_REGULAR: Final = 1e-15  # of a pivot of P G P^T, against its entries
_SETTLED: Final = 1e-12  # of c, and of the angle by which c would turn a joint: a pattern that is out by less is right
_KNOWN: Final = 16  # lengths of steps whose responses are kept


class DryMechanism(Mechanism):
    """A :class:`Mechanism` whose joints have dry friction; the impulse in its state has that of friction as well."""

    def __init__(self, device: HeldDevice, T: float, linkage: Mapping[str, Any], friction: Sequence[float]) -> None:
        """Sample ``device`` with the period ``T``, s.

        Args:
            device: the device with its hand; its axes are those of the linkage's tip.
            T: period, s.
            linkage: its kinematics as plain data.
            friction: c by joint, N*m, each greater than 0.

        Raises:
            ValueError: the data are no linkage, or there is not one c for each joint.
        """
        super().__init__(device, T, linkage)
        self.divides = True
        if len(friction) != self.axes or not all(c > 0.0 for c in friction):
            raise ValueError(f"friction: found {list(friction)} N*m; expected {self.axes} numbers above 0, one a joint")
        self._friction: Floats = list(friction)
        self._response = lru_cache(_KNOWN)(self._of_ones)

    def after(self, before: Floats, f: Floats, intention: Intention, part: int | None = None) -> Floats:
        """The state after one period, or a part of it, under the torques ``f``, N*m."""
        left = self._period if part is None else part
        state = before
        for number in range(-(-left // STEP), 0, -1):
            h = left // number
            state = self._stepped(state, f, intention, h)
            left -= h
        return state

    def _stepped(self, before: Floats, t: Floats, intention: Intention, h: int) -> Floats:
        """The state after a step of h ns under the torques t, N*m, and the friction of the joints."""
        n, m, c = self.order, self.axes, self._friction
        x, first = before[:m], before[n : n + m]
        response, free = self._response(h), self._linear(before[:n], [0.0] * m, intention, h, n)
        begin = rows = self._joints.by_tip(x, first)
        exact = ROUNDING * (max(map(abs, t)) + max(c))
        to, q, R, phi = x, first, [0.0] * m, [0.0] * m
        rates = [dot(row, before[m : 2 * m]) for row in rows]
        turns = tuple([(rate > 0.0) - (rate < 0.0) for rate in rates])  # most steps go on as they began
        for _ in range(MOST_STEPS):
            phi, turns = self._law(minus(free[:m], x), rows, response, t, turns)
            last, R = R, _transposed(rows, plus(t, phi))
            if not any(turns):
                break
            to = _pushed(free[:m], R, response)
            q, dx = self._joints.at(to, q), minus(to, x)
            if abs(dot(minus(R, last), dx)) <= exact:
                break
            rows = _discrete(begin, self._joints.by_tip(to, q), dx, minus(q, first))
        after, span = _pushed(free, R, response), seconds(Duration(h))
        impulse = [so_far + force * span for so_far, force in zip(before[n + m : n + 2 * m], R, strict=True)]
        if not any(turns):
            impulse = minus(impulse, [mass * v for mass, v in zip(self._mass, after[m : 2 * m], strict=True)])
            return [*x, *[0.0] * m, *after[2 * m :], *first, *impulse, before[-1]]
        q = self._joints.at(after[:m], q)
        standing = [joint for joint in range(m) if turns[joint] == 0]
        if standing:
            taken = self._stopping(standing, self._joints.by_tip(after[:m], q), after[m : 2 * m])
            impulse = plus(impulse, taken)
            for axis in range(m):
                after[m + axis] += taken[axis] / self._mass[axis]
        return [*after, *q, *impulse, before[-1] + dot(t, minus(q, first))]

    def _law(
        self, a: Floats, rows: Rows, response: Rows, t: Floats, guess: tuple[int, ...]
    ) -> tuple[Floats, tuple[int, ...]]:
        """Coulomb's torques (N*m), and by joint whether it stands (0) or which way it turns, 1 or -1.

        Args:
            a: how the tip moves without motors and friction, m.
            rows: P, 1/m.
            response: by axis what 1 N there does; its first entries are the motion of the tip, m/N.
            t: torques of the motors, N*m.
            guess: the pattern that is tried first.
        """
        m, c = self.axes, self._friction
        to_tip = [[dot(response[axis][:m], row) for axis in range(m)] for row in rows]  # P G, G symmetric
        G = [[dot(one, row) for row in rows] for one in to_tip]
        free = [dot(row, a) + dot(own, t) for row, own in zip(rows, G, strict=True)]
        best: tuple[float, Floats, tuple[int, ...]] | None = None
        for turns in (guess, *product((0, 1, -1), repeat=m)):
            phi = _balanced(free, G, c, turns)
            if phi is None:
                continue
            wrong = 0.0
            for joint in range(m):
                if turns[joint] == 0:
                    wrong = max(wrong, abs(phi[joint]) / c[joint] - 1.0)
                else:
                    turned = free[joint] + dot(G[joint], phi)
                    wrong = max(wrong, -turns[joint] * turned / (G[joint][joint] * c[joint]))
            if best is None or wrong < best[0]:
                best = wrong, phi, turns
            if wrong <= _SETTLED:
                break
        if best is None:
            raise astray(a)
        return best[1], best[2]

    def _stopping(self, standing: list[int], rows: Rows, v: Floats) -> Floats:
        """The impulse at the tip (N*s) after which the joints ``standing`` stand, by the way that takes most energy."""
        by_mass = [[entry / mass for entry, mass in zip(rows[joint], self._mass, strict=True)] for joint in standing]
        A = [[dot(one, rows[other]) for other in standing] for one in by_mass]
        least = _REGULAR * max(A[i][i] for i in range(len(A)))
        of_joints = solve(A, [-dot(rows[joint], v) for joint in standing], least)
        if of_joints is None:
            raise astray(v)
        return _transposed([rows[joint] for joint in standing], of_joints)

    def _of_ones(self, h: int) -> Rows:
        """By axis, the change of the state in h ns by a force of 1 N."""
        n, m = self.order, self.axes
        still = Intention([0.0] * m, [0.0] * m)
        ones = [[1.0 if axis == other else 0.0 for other in range(m)] for axis in range(m)]
        return [self._linear([0.0] * n, one, still, h, n) for one in ones]


def _balanced(free: Floats, G: Rows, c: Floats, turns: tuple[int, ...]) -> Floats | None:
    """The torques of friction where joints turn, or stand, in this pattern, N*m; None where G is nearly singular."""
    phi = [-turn * limit for turn, limit in zip(turns, c, strict=True)]
    standing = [joint for joint in range(len(c)) if turns[joint] == 0]
    if standing:
        A = [[G[joint][other] for other in standing] for joint in standing]
        least = _REGULAR * max(A[i][i] for i in range(len(A)))
        held = solve(A, [-free[joint] - dot(G[joint], phi) for joint in standing], least)
        if held is None:
            return None
        for joint, torque in zip(standing, held, strict=True):
            phi[joint] = torque
    return phi


def _discrete(begin: Rows, end: Rows, dx: Floats, dq: Floats) -> Rows:
    """P of a step: the mean of dq/dx at its ends, turned a little, so that P dx = dq."""
    square, rows = dot(dx, dx), []
    for one, other, turned in zip(begin, end, dq, strict=True):
        row = [0.5 * (a + b) for a, b in zip(one, other, strict=True)]
        if square > UNMOVED**2:
            lacks = (turned - dot(row, dx)) / square
            row = [entry + lacks * way for entry, way in zip(row, dx, strict=True)]
        rows.append(row)
    return rows


def _transposed(rows: Rows, t: Floats) -> Floats:
    """rows^T t."""
    return [sum([row[axis] * torque for row, torque in zip(rows, t, strict=True)]) for axis in range(len(rows[0]))]


def _pushed(free: Floats, R: Floats, response: Rows) -> Floats:
    """The first entries of the state under the force R, as many as ``free`` has."""
    state = list(free)
    for force, change in zip(R, response, strict=True):
        for entry in range(len(state)):
            state[entry] += force * change[entry]
    return state
