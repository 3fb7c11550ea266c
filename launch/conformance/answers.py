"""What a device answers to a gentle push, in words: for whoever has just plugged one in.

    read at rest -> a question -> on each axis: push, release, push the other way, release -> close

The suite for drivers (:mod:`manyhands.launch.conformance.driver`) judges; this explains. Each axis is pushed both ways
by the same force. Half the difference of both ways is the answer, for gravity, and a motion that the device had
already, are the same in both. An axis that does not answer is explained: by what the driver itself measured of its
force, by what an axis did in one direction alone, or by what the user can look at.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.launch.conformance.driver import PUSH_TICKS, Array, Bench, Push, Stretch
from manyhands.nodes.device.specification import DeviceSpecification

LEAST: Final = 1e-6
"""m; an answer below this is none, whatever the encoder's step is."""

ABOVE_NOISE: Final = 3.0
"""An answer is at least so many times the noise at rest."""

STEPS: Final = 2.0
"""An answer is at least so many of the encoder's stated steps."""

SIDEWAYS: Final = 1.0
"""Another axis that moves more than this part of the pushed one's way was moved in its place."""

_SETTLE: Final = 300  # ticks before a push, in which what moves slows down
_REST: Final = 40  # the last of them, which show noise and drift
_LOOKS: Final = (_SETTLE - 3 * _REST - PUSH_TICKS, _SETTLE - 2 * _REST - PUSH_TICKS)  # begins, once it has settled


def called(axis: str) -> str:
    """An axis as a sentence names it: one that has a number alone is an axis by its number."""
    return f"axis {axis}" if axis.isdecimal() else axis


@dataclass(frozen=True)
class AxisRead:
    """One axis as it was read: its least and greatest place, m, or rad by its units."""

    axis: str
    low: float
    high: float
    units: Units = TRANSLATING

    def sentence(self, moved: bool = False) -> str:
        """Where it was, and whether it changed at all; ``moved`` where it did so under a push."""
        unit = self.units("mm")
        if self.high == self.low and moved:
            return f"{self.axis} stayed at {1e3 * self.low:.3f} {unit} until it was pushed"
        if self.high == self.low:
            return (
                f"{self.axis} stayed at {1e3 * self.low:.3f} {unit} in every sample: move it by hand; if that changes "
                "nothing, its encoder is not read"
            )
        return f"{self.axis} was from {1e3 * self.low:.3f} to {1e3 * self.high:.3f} {unit}"


@dataclass(frozen=True)
class AxisAnswer:
    """What one axis answered to a push both ways.

    Attributes:
        axis: its name.
        force: of the push, N.
        there: by which way it moved under +force, beyond its motion before, m.
        back: likewise under -force.
        noise: below this way an axis has not moved, m.
        measured: the greatest force in the direction of the push that the driver measured, N; None if it measures none.
        sideways: the axis that moved more than this one, and its way; None for none.
        ticks: how long a push lasted, at most.
        own: by how much it moved differently in times as long as a push, without a force, m.
        most: the greatest force of this axis, N, as its driver states.
    """

    axis: str
    force: float
    there: float
    back: float
    noise: float
    measured: float | None = None
    sideways: tuple[str, float] | None = None
    ticks: int = PUSH_TICKS
    own: float = 0.0
    most: float = math.inf
    units: Units = TRANSLATING

    @property
    def way(self) -> float:
        """Half the difference of both ways, m: positive in the direction of the force."""
        return (self.there - self.back) / 2.0

    @property
    def moved(self) -> bool:
        """Whether it moved at all."""
        return abs(self.way) > self.noise

    @property
    def right(self) -> bool:
        """Whether it moved in the direction of the force, and no other axis in its place."""
        return self.moved and self.way > 0.0 and self.sideways is None

    @property
    def wrong(self) -> bool:
        """Whether the device does something else than it was told: it is not pushed any more."""
        return self.sideways is not None or (self.moved and self.way < 0.0)

    def sentences(self) -> Iterator[str]:
        """What happened, and where that is not as it should be, why it may be so and what to do."""
        N, mm = self.units("N"), self.units("mm")
        f, there, back = f"{self.force:g} {N}", f"{1e3 * self.there:+.2f} {mm}", f"{1e3 * self.back:+.2f} {mm}"
        if self.sideways is not None:
            other, way = self.sideways
            yield (
                f"{self.axis} was pushed by ±{f}, and {other} moved instead, by {1e3 * way:+.2f} {mm} under +: "
                "its motors or its encoders are crossed. Put that right in the driver or its wiring: axis_map of the "
                "session moves both alike, and leaves them crossed; do not close a loop with it before"
            )
        elif not self.moved and self.own >= self.noise:
            yield (
                f"{self.axis} moves by itself, by ±{1e3 * self.own:.2f} {mm} without a force, and by no more under "
                f"±{f}: let it hang still; a driver whose device no force moves states moved_by_force=False"
            )
        elif not self.moved:
            yield f"{self.axis} did not move under ±{f}{self._why()}"
        elif self.way < 0.0:
            yield (
                f"{self.axis} answered +{f} by moving {there}, and -{f} by moving {back}: against the force. Its "
                "encoder or its motor has the wrong sign; do not close a loop with it before that is put right"
            )
        else:
            yield f"{self.axis} answered +{f} by moving {there}, and -{f} by moving {back}: in its direction"
            stuck = [sign for sign, way in (("+", self.there), ("-", -self.back)) if way <= self.noise]
            for sign in stuck:
                yield f"{self.axis} moved under one sign alone, and not under {sign}{f}: is it at its stop there?"

    def _why(self) -> str:
        """Why an axis may not have moved, to follow the sentence."""
        more = min(2.0 * self.force, self.most)
        tried = f"try --force {more:g}" if more > self.force else "the greatest force that its driver states"
        look = f"is it held, braked or at its stop, or has it more friction than that ({tried})?"
        if self.measured is None:
            return f": is its motor powered and enabled; {look}"
        N = self.units("N")
        if self.measured < self.force / 2.0:
            return (
                f", and its driver measured {self.measured:.2g} {N} of it: the motor was not given the force. Has "
                "it its power, is it enabled, is its emergency stop out, and does the device count as calibrated?"
            )
        return f", though its driver measured {self.measured:.2g} {N}: the force is there; {look}"

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "axis": self.axis, "force": self.force, "there": self.there, "back": self.back, "moved": self.moved,
            "right": self.right, "measured": self.measured,
            "sideways": None if self.sideways is None else self.sideways[0], "text": " ".join(self.sentences()),
        }  # fmt: skip


@dataclass
class Question:
    """A question that is asked while the device is read on: the loop goes on, so that no watchdog of it ends.

    Attributes:
        asked: set once the reading is over, and the answer is wanted.
        answered: set with the answer.
        agreed: the answer.
    """

    asked: threading.Event = field(default_factory=threading.Event)
    answered: threading.Event = field(default_factory=threading.Event)
    agreed: bool = False

    def answer(self, agreed: bool) -> None:
        """Give the answer."""
        self.agreed = agreed
        self.answered.set()


@dataclass
class Explained:
    """What was read, and what was answered."""

    reads: list[AxisRead] = field(default_factory=list)
    answers: list[AxisAnswer] = field(default_factory=list)


def ask_device(
    bench: Bench, stated: DeviceSpecification, ticks: int, push: Push | None, question: Question
) -> Explained:
    """Read a device, push it where its user agrees, and close it.

    An axis that moves against its force, or another axis in its place, is the last that is pushed.

    Args:
        bench: the driver in its loop.
        stated: what the driver states, at the bench's ports.
        ticks: how long it is read, at least.
        push: how it may be pushed; None not to.
        question: whether it may be; asked once the reading is over.

    Raises:
        DriverFailure: the driver fails.
    """
    found = Explained()
    try:
        bench.rest(ticks)
        places = bench.samples.places
        found.reads = [
            AxisRead(called(axis), float(low), float(high), units)
            for axis, units, low, high in zip(
                stated.axes, stated.units_by_axis, places.min(axis=0), places.max(axis=0), strict=True
            )
        ]
        if push is None or not stated.moved_by_force:
            return found
        question.asked.set()
        while not question.answered.is_set():
            bench.rest(1)
        for axis in range(len(stated.axes) if question.agreed else 0):
            answer = _pushed(bench, stated, axis, push)
            found.answers.append(answer)
            if answer.wrong:
                break
        return found
    finally:
        bench.close()


def _pushed(bench: Bench, stated: DeviceSpecification, axis: int, push: Push) -> AxisAnswer:
    """Push one axis, both ways."""
    force = min(push.force, stated.force[axis])
    f = [force if i == axis else 0.0 for i in range(len(stated.axes))]
    ways, owns, noises, measured = [], [], [], list[float]()
    for sign in (1.0, -1.0):
        settled = bench.rest(_SETTLE - _REST)
        owns += [_beyond(*_unpushed(settled, begin))[0] for begin in _LOOKS]
        before = bench.rest(_REST)
        bench.exerted.clear()
        during = bench.push([sign * value for value in f], PUSH_TICKS, push.travel)
        measured += [sign * one[axis] for one in bench.exerted]
        moved, noise = _beyond(before, during)
        ways.append(moved)
        noises.append(noise)
    bench.rest(_REST)
    answer = (ways[0] - ways[1]) / 2.0
    step = 0.0 if stated.step is None else stated.step[axis]
    own = np.ptp(owns, axis=0) / 2.0  # as the answer is: what is the same in all, as gravity, is no motion of its own
    alike = [kind is stated.kinds[axis] for kind in stated.kinds]  # only these can be compared
    most = int(np.where(alike, np.abs(answer), -1.0).argmax())
    least = max(LEAST, STEPS * step, ABOVE_NOISE * float(max(noise[axis] for noise in noises)), float(own[axis]))
    beside = abs(answer[most]) > max(least, own[most], SIDEWAYS * abs(answer[axis])) and most != axis
    return AxisAnswer(
        called(stated.axes[axis]), force, float(ways[0][axis]), float(ways[1][axis]), least,
        max(measured) if measured else None, (called(stated.axes[most]), float(answer[most])) if beside else None,
        own=float(own[axis]), most=stated.force[axis], units=stated.units_by_axis[axis],
    )  # fmt: skip


def _unpushed(settled: Stretch, begin: int) -> tuple[Stretch, Stretch]:
    """Ticks without a force, as those before a push and in one."""
    split, end = begin + _REST, begin + _REST + PUSH_TICKS
    return Stretch(settled.at[begin:split], settled.x[begin:split]), Stretch(
        settled.at[split:end], settled.x[split:end]
    )


def _beyond(before: Stretch, during: Stretch) -> tuple[Array, Array]:
    """By which way each axis moved in a stretch beyond where its motion before led, m; and the noise of that motion."""
    t = before.times - before.at[-1]
    A = np.column_stack([np.ones_like(t), t])
    fit = np.linalg.lstsq(A, before.places, rcond=None)[0]
    noise = np.abs(before.places - A @ fit).max(axis=0)
    led = fit[0] + fit[1] * (during.at[-1] - before.at[-1])
    return np.asarray(during.places[-1] - led), np.asarray(noise)
