"""Compares the work that a driver told of its motors with that of the stated linkage along the recorded motion.

A driver of another package whose motors hold torques tells their work W, and its account of lateness rests on it.
Where its session states the kinematics of its linkage, the joints follow from the recorded displacements, and so does
the work of the torques that stand for a recorded force f. From the displacement A to B, in which f was held,

    W = t^T (q_B - q_A),    t = J(q_r)^T f,    q_r the joints as they were read between the sample of f and its force.

A recording has A, B and the sample of f to e = q/2 on each axis, q the stated step, and not the joints that were read.
With w the same expression of what was recorded, an honest driver has, L a bound of the way from A to B, rho of the way
since the sample, and G = e^(kappa (rho + L)) - 1 of how far a pose on it may turn a force (decision 50),

    |W - w|  <=  2 |f| G L  +  2 (sum |f_i| e_i + |f| G |e|),

the joints' place, and the error of A and of B. Where it is not known how far the device was when f took the place of
other forces g, the way v h of the time h in which these may have acted counts besides, at the limit of speed v:

    (max |g - f|  +  2 max |g| G) v h.

So all rests on what the session states: the kinematics, the step, the limit of speed, and that the displacement is 0 in
the middle of the box of poses. What a recording does not fix is not judged: a force that ended by itself, a work that
the driver could not tell, poses beyond the box, and times in which a force may turn too far.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.launch.audit.device import DeviceRows
from manyhands.launch.audit.events import Course
from manyhands.launch.audit.findings import Check, CheckVerdict, UncheckedTicks, compare, gaps_of
from manyhands.launch.audit.recompute import Array
from manyhands.launch.recordings.run import there
from manyhands.nodes.device.mechanism import TipAstray, joints_of
from manyhands.nodes.kernel.arithmetic import Floats, dot, minus
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.protocol.channels import WORK_NAMES

NAME: Final = "torques"

_BEYOND: Final = 1e-12
"""m; what the arithmetic of a driver and of the joints adds to the error of a displacement, in doubles."""

_MOST_TURN: Final = 0.5
"""Of kappa times a way: beyond, a bound says nothing of a force that has turned by as much."""

_NS: Final = 1e-9

_SOURCE: Final = "the step of its encoder, where its joints were read, and which of two forces a way belongs to"

_BELIEVED: Final = "the work that its driver told of its motors is believed"

_WHAT: Final = "its motors did the work that its linkage does along its motion, until s_k and until a_k"


@dataclass(frozen=True)
class _Span:
    """What a work is of: the way between two recorded displacements.

    Attributes:
        begin: its first displacement, m.
        end: its last, m.
        since: the instant of the first, ns.
        until: of the last, ns.
        forces: the ticks of the forces that may have acted, the last one first.
    """

    begin: Floats
    end: Floats
    since: float
    until: float
    forces: Sequence[int]


class _Linkage:
    """The work of the motors of one device, by what was recorded of it."""

    def __init__(self, held: HeldTorque, step: Sequence[float], latency: float, speed: Sequence[float]) -> None:
        if held.linkage is None:
            raise AssertionError("asked only where kinematics are stated")
        self._kappa, self._joints, self._latency = held.kappa, joints_of(held.linkage), latency
        # a box of joints for a chain; for arms one of the tip, whose displacement is 0 in its middle
        low, high = (np.array(held.linkage[end], dtype=float) for end in ("low", "high"))
        self._of_joints = held.linkage["kind"] == "chain"
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._error = [0.5 * q + _BEYOND for q in step]
        self._off = math.hypot(*self._error)
        self._speed = math.hypot(*speed)
        self._near = self._joints.home

    def work(self, span: _Span, rows: DeviceRows) -> tuple[float, float] | str:
        """The work of the span and how far an honest one may be from it, J; or why that is not known."""
        last, sampled = span.forces[0], rows.instants[:, 0]
        f, kappa, off, v = rows.f[last].tolist(), self._kappa, self._off, self._speed
        size, d = math.hypot(*f), math.dist(span.begin, span.end) + 2.0 * off
        h = (span.until - span.since) * _NS
        if d > v * h + 4.0 * off:
            return "it was faster than its limit of speed"
        rho = v * ((span.until - float(sampled[span.forces[-1]])) * _NS + self._latency) + off
        if not kappa * (rho + d) < _MOST_TURN:
            return "its limit of speed allows poses that bend its forces too far"
        try:
            read, begin, end = (self._pose(x) for x in (rows.x[last].tolist(), span.begin, span.end))
        except TipAstray:
            return "it was beyond the box of poses that its linkage is stated for"
        w = dot(self._joints.torque(f, rows.x[last].tolist(), read), minus(end, begin))
        L, near = self._way(d), self._way(off)
        G = math.expm1(kappa * (rho + L))
        tolerance = 2.0 * size * G * L + 2.0 * (dot(list(map(abs, f)), self._error) + size * G * near)
        if len(span.forces) > 1:
            others = [rows.f[j].tolist() for j in span.forces[1:]]
            changes = float(rows.instants[last, 1]) * _NS + self._latency - span.since * _NS
            beside = max(math.dist(g, f) for g in others) + 2.0 * max(size, *(math.hypot(*g) for g in others)) * G
            tolerance += beside * v * min(h + self._latency, max(0.0, changes))
        return w, tolerance

    def _way(self, d: float) -> float:
        """The longest way between two places d apart (m) on which every joint, or the tip, moves evenly, m."""
        return 2.0 / self._kappa * math.asin(0.5 * self._kappa * d)

    def _pose(self, x: Floats) -> Floats:
        """The joints at x (m), rad.

        Raises:
            TipAstray: they are beyond the box.
        """
        q = self._joints.at(x, self._near)
        beside = np.array(q) - self._middle if self._of_joints else np.array(x)
        if np.any(np.abs(beside) > self._half):
            raise TipAstray(f"found the pose {q} rad; expected one in its box")
        self._near = q
        return q


def _spans(k: int, begun: int, rows: DeviceRows, latency: float) -> Iterator[tuple[int, _Span | str]]:
    """What the works of row ``k`` are of, by column; or why that is not known.

    Args:
        k: the tick.
        begun: the first of the rows since which nothing happened in between.
        rows: what was recorded.
        latency: of the device, ns.
    """
    sampled, applied, ended = rows.instants.T
    known, x = there(rows.applied), rows.x
    since, first = (applied[k - 1], rows.applied[k - 1]) if known[k - 1] else (sampled[k - 1], x[k - 1])
    ways = [(since, first, sampled[k], x[k])]
    if known[k]:
        ways.append((sampled[k], x[k], applied[k], rows.applied[k]))
    for column, (since, first, until, last) in enumerate(ways):
        forces = [k - 1]
        while forces[-1] >= begun and applied[forces[-1]] + latency > since:
            forces.append(forces[-1] - 1)
        early = any(ended[j + 1] < applied[j + 1] for j in forces[1:] if j >= begun) or ended[k] < until
        if forces[-1] < begun:
            yield column, "not all of its rows since the forces that acted are recorded"
        elif early:
            yield column, "a force ended by itself, before the work that was told of it"
        else:
            yield column, _Span(first.tolist(), last.tolist(), float(since), float(until), forces)


def torques_agree(
    name: str, bundle: DeviceBundle, factory: str, step: Sequence[float] | None, rows: DeviceRows, course: Course
) -> Check:
    """The check that the work which a driver told is that of the stated linkage; *not checked* where none is stated.

    Args:
        name: the device.
        bundle: its part of the session; its motors hold torques, and it was in wall time.
        factory: of its driver.
        step: of its encoder, m, by axis; None where none is stated.
        rows: what was recorded.
        course: what happened between the rows.
    """
    held, told = bundle.held, rows.work
    if held is None or told is None:
        raise AssertionError("asked only where motors hold torques")
    if held.linkage is None or step is None:
        lacks = "kappa is stated, and no kinematics" if held.linkage is None else "no step of its encoder is stated"
        gap = UncheckedTicks(0, len(told), f"{_BELIEVED}: {lacks}")
        return Check(NAME, name, _WHAT, CheckVerdict.UNCHECKED, gaps=(gap,))
    linkage = _Linkage(held, step, bundle.timing.latency, bundle.limits.speed)
    again, tolerance = np.full(told.shape, np.nan), np.zeros(told.shape)
    reasons: dict[str, set[int]] = {}
    whole = there(np.hstack([rows.x, rows.f, rows.instants]))
    begun = 0
    for k in range(len(told)):
        if k == 0 or not whole[k] or not whole[k - 1] or k in course.before:
            begun = k
            if whole[k] and k:
                reasons.setdefault("it began, or was without a force, since its row before", set()).add(k)
            continue
        for column, span in _spans(k, begun, rows, 1e9 * bundle.timing.latency):
            found = span if isinstance(span, str) else linkage.work(span, rows)
            if rows.unexerted is not None and k >= rows.unexerted:
                found = "its hardware exerted another force than it was given"
            elif not math.isfinite(told[k, column]):
                found = "its driver could not tell the work of its motors"
            if isinstance(found, str):
                reasons.setdefault(found, set()).add(k)
            else:
                again[k, column], tolerance[k, column] = found
    return _check(name, factory, told, again, tolerance, reasons)


def _check(
    name: str, factory: str, told: Array, again: Array, tolerance: Array, reasons: Mapping[str, Collection[int]]
) -> Check:
    """The check, with the driver's name where it told another work."""
    gaps = []
    for why, ticks in reasons.items():
        marked = np.zeros(len(told), dtype=np.bool_)
        marked[list(ticks)] = True
        gaps += gaps_of(marked, f"{_BELIEVED}: {why}")
    judged = np.where(np.isfinite(again), told, np.nan)
    none = np.zeros(len(told), dtype=np.bool_)  # every tick that is left out has its reason
    check = compare(
        NAME, name, _WHAT, WORK_NAMES, judged, again, gaps=gaps, tolerance=tolerance, source=_SOURCE, owed=none
    )
    if check.verdict is not CheckVerdict.BROKEN or check.first is None:
        return check
    first = check.first
    return replace(
        check,
        remark=f"{name}: the driver {factory} told another work of its motors than its linkage does along its motion: "
        f"at tick {first.tick} {first.recorded:.4g} J, and {first.recomputed:.4g} J follow; it tells a wrong work, or "
        "its displacement is not 0 in the middle of the stated box of poses",
    )
