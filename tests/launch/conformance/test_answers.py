"""What a device answers to a gentle push: right ones, wrong ones, and each kind of nothing, explained."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from manyhands.launch.conformance.answers import AxisAnswer, Explained, Question, ask_device, called
from manyhands.launch.conformance.driver import Bench, NeverReturned, Push, run_apart
from manyhands.nodes.device.plugin import DeviceDriver, DriverFailure
from manyhands.protocol.clock import Instant

from ...support import plugin_drivers as drivers
from .test_driver import bench_of

TICKS = 100


def agreed(answer: bool = True) -> Question:
    question = Question()
    question.answer(answer)
    return question


def found(kind: type[DeviceDriver], axes: int = 2, push: Push | None = Push(), **parameters: Any) -> Explained:  # noqa: B008
    bench, stated = bench_of(kind, axes, **parameters)
    return ask_device(bench, stated, TICKS, push, agreed())


class Heavy(drivers.Counterpart):
    """Something pulls it by 0.3 N, whatever is exerted."""

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([force + 0.3 for force in f], at)

    def release(self, at: Instant) -> Sequence[float] | None:
        return self.apply([0.0] * self.n, at)

    def exerted(self) -> Sequence[float] | None:
        return None


class AtItsStop(drivers.Counterpart):
    """It goes nowhere beyond 0."""

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        super().sample(tick, at)
        for axis, x in enumerate(self.x):
            if x > 0.0:
                self.x[axis], self.v[axis] = 0.0, 0.0
        return list(self.x)


class Unpowered(drivers.Frozen):
    """Its motors get no current, and it measures that."""

    def exerted(self) -> Sequence[float] | None:
        return [0.0] * self.n


class Unmeasured(drivers.Frozen):
    def exerted(self) -> Sequence[float] | None:
        return None


class TestAnswers:
    @pytest.mark.parametrize(
        ("kind", "damping"), [(drivers.Counterpart, 0.0), (drivers.Counterpart, 1.5), (Heavy, 1.5)]
    )
    def test_a_device_that_obeys(self, kind: type[DeviceDriver], damping: float) -> None:
        answers = found(kind, damping=damping, step=1e-5).answers
        assert [(answer.axis, answer.force, answer.right) for answer in answers] == [
            ("axis 0", 0.5, True), ("axis 1", 0.5, True)
        ]  # fmt: skip
        for answer in answers:
            t = 0.06  # s: the push, which ends before 10 mm; one that falls has moved so far earlier
            assert kind is Heavy or answer.way == pytest.approx(0.5 / 0.2 * t**2 / 2.0, rel=0.2)
            [sentence] = answer.sentences()
            assert sentence.startswith(f"{answer.axis} answered +0.5 N by moving +")
            assert sentence.endswith(": in its direction")

    def test_a_push_ends_with_its_travel(self) -> None:
        [answer] = found(drivers.Counterpart, 1, Push(5.0, 0.002)).answers
        assert 0.002 < answer.way < 0.004

    @pytest.mark.parametrize(
        ("kind", "said"),
        [
            (drivers.WrongSign, "against the force. Its encoder or its motor has the wrong sign; do not close a loop"),
            (drivers.SwappedAxes, "axis 0 was pushed by ±0.5 N, and axis 1 moved instead, by +"),
        ],
    )
    def test_one_that_does_something_else_is_pushed_no_more(self, kind: type[DeviceDriver], said: str) -> None:
        [answer] = found(kind).answers
        assert (answer.right, answer.wrong) == (False, True)
        assert said in " ".join(answer.sentences())

    @pytest.mark.parametrize(
        ("kind", "parameters", "said"),
        [
            (
                drivers.Frozen,
                {},
                ", though its driver measured 0.5 N: the force is there; is it held, braked or at its",
            ),
            (
                drivers.Counterpart,
                {"friction": 1.0},
                ", though its driver measured 0.5 N: the force is there; is it held",
            ),
            (Unpowered, {}, ", and its driver measured 0 N of it: the motor was not given the force. Has it its power"),
            (
                Unmeasured,
                {},
                ": is its motor powered and enabled; is it held, braked or at its stop, or has it more fric",
            ),
        ],
    )
    def test_nothing_is_explained(self, kind: type[DeviceDriver], parameters: dict[str, float], said: str) -> None:
        answers = found(kind, **parameters).answers
        assert [answer.right for answer in answers] == [False, False]  # and the second is pushed all the same
        [sentence] = answers[0].sentences()
        assert sentence.startswith(f"axis 0 did not move under ±0.5 N{said}")
        assert sentence.endswith("friction than that (try --force 1)?") or kind is Unpowered

    def test_the_force_that_is_told_to_try_moves_it_and_is_none_beyond_its_limit(self) -> None:
        [answer] = found(drivers.Counterpart, 1, Push(0.5), friction=0.8).answers
        [sentence] = answer.sentences()
        told = float(sentence.partition("--force ")[2].partition(")")[0])
        [answer] = found(drivers.Counterpart, 1, Push(told), friction=0.8).answers
        assert answer.right
        bench, stated = bench_of(drivers.Counterpart, 1, friction=0.8)
        weak = replace(stated, force=(0.5,))
        [answer] = ask_device(bench, weak, TICKS, Push(2.0), agreed()).answers
        [sentence] = answer.sentences()
        assert "--force" not in sentence
        assert sentence.endswith("or has it more friction than that (the greatest force that its driver states)?")

    def test_one_that_moves_in_one_direction_alone_may_be_at_its_stop(self) -> None:
        [answer] = found(AtItsStop, 1, step=1e-5, damping=20.0).answers
        assert answer.right
        assert list(answer.sentences())[1:] == [
            "axis 0 moved under one sign alone, and not under +0.5 N: is it at its stop there?"
        ]

    def test_a_motion_without_force_is_no_answer(self) -> None:
        bench, stated = bench_of(drivers.MovesByItself, 1)
        stated = replace(stated, moved_by_force=True)
        [answer] = ask_device(bench, stated, TICKS, Push(), agreed()).answers
        assert not answer.right
        assert list(answer.sentences()) == [
            f"axis 0 moves by itself, by ±{1e3 * answer.own:.2f} mm without a force, and by no more under ±0.5 N: "
            "let it hang still; a driver whose device no force moves states moved_by_force=False"
        ]
        assert 1e-3 < answer.own < 5e-3
        [answer] = found(drivers.WrongSign, 1).answers
        assert answer.wrong

    def test_an_encoders_step_is_no_answer(self) -> None:
        assert not AxisAnswer("x", 0.5, 2e-5, -2e-5, 2e-5).moved
        assert AxisAnswer("x", 0.5, 2.1e-5, -2.1e-5, 2e-5).moved
        [answer] = found(drivers.Counterpart, 1, Push(0.5), step=0.01).answers
        assert (answer.moved, answer.noise) == (False, 0.02)

    def test_a_number_is_named_as_an_axis(self) -> None:
        assert (called("0"), called("x")) == ("axis 0", "x")

    def test_as_a_json_object(self) -> None:
        text = "x answered +0.5 N by moving +2.00 mm, and -0.5 N by moving -1.00 mm: in its direction"
        assert AxisAnswer("x", 0.5, 0.002, -0.001, 1e-6, 0.5).as_plain() == {
            "axis": "x", "force": 0.5, "there": 0.002, "back": -0.001, "moved": True, "right": True, "measured": 0.5,
            "sideways": None, "text": text,
        }  # fmt: skip


class TestReading:
    def test_without_a_push_it_is_read_alone(self) -> None:
        bench, stated = bench_of(drivers.Counterpart, 1)
        seen = ask_device(bench, stated, TICKS, None, Question())
        assert (seen.answers, len(bench.samples)) == ([], TICKS)
        assert [one.sentence() for one in seen.reads] == [
            "axis 0 stayed at 0.000 mm in every sample: move it by hand; if that changes nothing, its encoder is not "
            "read"
        ]
        assert seen.reads[0].sentence(moved=True) == "axis 0 stayed at 0.000 mm until it was pushed"

    def test_where_it_was_is_said(self) -> None:
        [read] = found(drivers.MovesByItself, 1).reads
        assert read.sentence().startswith("axis 0 was from -")
        assert found(drivers.MovesByItself, 1).answers == []  # no force moves it

    def test_it_is_read_on_until_the_question_is_answered(self) -> None:
        """A loop that stopped would let a device's watchdog end, or its buffer run over."""
        bench, stated = bench_of(drivers.Counterpart, 1)
        question, seen = Question(), list[Explained]()
        thread = threading.Thread(target=lambda: seen.append(ask_device(bench, stated, TICKS, Push(), question)))
        thread.start()
        try:
            assert question.asked.wait(10.0)
            before = len(bench.samples)
            for _ in range(1000):  # 10 s at most
                if len(bench.samples) >= before + 50:
                    break
                thread.join(0.01)
            else:
                pytest.fail("it is not read on")
        finally:
            question.answer(False)
            thread.join()
        assert (len(seen), seen[0].answers) == (1, [])

    @pytest.mark.parametrize("kind", [drivers.Raising, drivers.WrongAnswer])
    def test_a_driver_that_fails_is_closed(self, kind: type[DeviceDriver]) -> None:
        bench, stated = bench_of(kind, 1)
        with pytest.raises(DriverFailure):
            ask_device(bench, stated, TICKS, Push(), agreed())
        assert bench.driver._driver.closed  # type: ignore[attr-defined]


class TestApart:
    def test_somebody_looks_meanwhile(self) -> None:
        bench, _ = bench_of(drivers.Counterpart, 1)
        looked, go = list[int](), threading.Event()

        def look() -> None:
            looked.append(1)
            if len(looked) == 2:
                go.set()

        assert run_apart(bench, lambda: go.wait(10.0), 10.0, look)
        assert len(looked) >= 2

    def test_a_call_that_never_returns_is_named(self) -> None:
        bench, stated = bench_of(drivers.Endless, 1)
        try:
            with pytest.raises(NeverReturned, match=r"found that sample has not returned for 0\.2 s"):
                run_apart(bench, lambda: ask_device(bench, stated, 200, None, Question()), 0.2, lambda: None)
        finally:
            drivers.Endless.free()
            for thread in threading.enumerate():
                if thread is not threading.current_thread() and thread.daemon:
                    thread.join(10.0)

    def test_the_bench_keeps_what_a_driver_measured(self) -> None:
        bench, _ = bench_of(drivers.Counterpart, 1)
        assert isinstance(bench, Bench)
        bench.push([0.25], 5, 1.0)
        assert bench.exerted == [[0.25]] * 5
