"""The session's condition goes to observers and recorder; one too long for a frame ends nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.seats import seat_nodes
from manyhands.launch.run.broadcast import Showing, condition_frame, describe
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.recorder import Recorder
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_SENTENCES, MAX_TEXT
from manyhands.protocol.messages import Condition, PromiseStatus

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


class Ear(Recorder):
    """Keeps every message."""

    def __init__(self) -> None:
        self.told: list[bytes | None] = []

    def take(self, frame: bytes | None) -> None:
        self.told.append(frame)


class Eye(Showing):
    """Keeps what it is shown."""

    def __init__(self) -> None:
        self.shown: list[bytes | None] = []

    def show(self, frame: bytes | None) -> None:
        self.shown.append(frame)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True)


def progress(*sentences: str) -> Progress:
    return Progress(
        SessionPhase.RUNNING, {"dx": "running"}, {}, {}, 1.5, sentences, {}, frozenset(), sentences, sentences
    )


def test_one_frame_is_for_both(prepared: Prepared) -> None:
    ear, eye = Ear(), Eye()
    supervisor = Supervisor(
        prepared, clock="simulated", reach=reach(prepared, "ipc"), ticks=1, record=False, recorder=ear
    )
    supervisor._showing = eye
    supervisor._report(progress("a spring broke"))
    (frame,) = ear.told
    assert eye.shown == ear.told
    assert frame is not None
    sentence = ("a spring broke",)
    assert decode(frame, MAX_CONTROL_BYTES) == Condition(
        "running", 1.5, {"dx": "running"}, (), sentence, sentence, sentence
    )


def test_who_came_and_went_is_said_apart(prepared: Prepared) -> None:
    frame = condition_frame(replace(progress(), visits=("dx has joined",)))
    assert frame is not None
    shown = decode(frame, MAX_CONTROL_BYTES)
    assert isinstance(shown, Condition)
    assert (shown.visits, shown.incidents) == (("dx has joined",), ())


def test_the_promises_go_with_it_and_a_remark_of_a_guest_holds_no_commands(prepared: Prepared) -> None:
    row = PromiseStatus("presence", "broken", ("dx",), 0.5, None, {"s": 2.0}, "dx: \x1b[31mlost")
    frame = condition_frame(replace(progress(), promises=(row,)))
    assert frame is not None
    shown = decode(frame, MAX_CONTROL_BYTES)
    assert isinstance(shown, Condition)
    assert shown.promises == (replace(row, remark="dx: \ufffd[31mlost"),)


def test_a_hosted_session_describes_its_seats() -> None:
    ball = prepare(load_session(SESSIONS / "ball.yaml"))
    seats = seat_nodes(ball.session)
    about = describe(ball, "realtime", "tcp", 0, seats, seats)
    assert about.seats == {"left_seat": "left", "right_seat": "right"}
    assert (about.terms.seats, about.terms.linked) == (about.seats, ("left_seat", "right_seat"))
    assert (about.terms.realtime, about.terms.certified, about.terms.bounded) == (True, True, True)
    assert describe(ball, "realtime", "tcp", 0, seats).seats == {}  # launched, and not hosted


def test_one_that_is_too_long_is_nobodys_loss(prepared: Prepared) -> None:
    ear, eye = Ear(), Eye()
    supervisor = Supervisor(
        prepared, clock="simulated", reach=reach(prepared, "ipc"), ticks=1, record=False, recorder=ear
    )
    supervisor._showing = eye
    long = progress(*["€" * MAX_TEXT] * MAX_SENTENCES)
    assert condition_frame(long) is None
    supervisor._report(long)
    assert (ear.told, eye.shown) == ([], [None])
    Showing.show(eye, None)  # which shows nothing, and needs no broadcast for it
