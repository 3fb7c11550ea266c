"""All attacks by strangers and an observer on a running session, in one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import zmq

from manyhands.launch.run.outcome import Progress
from manyhands.nodes.rows import figures as names
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    Fault,
    Figures,
    NodeHello,
    Observation,
    Refusal,
    RefusalCode,
    Report,
    Role,
    Sample,
    Telemetry,
    Welcome,
)

from .acts import OUT_OF_TURN
from .links import DEADLINE_MS
from .stage import OBSERVER, SUPERVISOR, RogueSession, prepared
from .strangers import Claim, Fate, Knock, Stranger, crowd, fates, halfway, without_key
from .tries import AT_THE_HUB, CROWDS, CY_DY, HALFWAY, HUB, TRIES, WATCH, WITHOUT_KEYS, Door, Try, crowded

FLOOD: Final = 100_000


def hello() -> NodeHello:
    """The honest hello of the observer."""
    return NodeHello(PROTOCOL_VERSION, prepared().id, prepared().session.name, OBSERVER, Role.OBSERVER, 1, {})


LIES: Final[Mapping[RefusalCode, Callable[[NodeHello], NodeHello]]] = {
    RefusalCode.NAME: lambda honest: replace(honest, name="dx"),
    RefusalCode.ROLE: lambda honest: replace(honest, role=Role.DEVICE),
    RefusalCode.CERTIFICATE: lambda honest: replace(honest, certificate="0" * 64),
    RefusalCode.SESSION: lambda honest: replace(honest, session="another"),
    RefusalCode.VERSION: lambda honest: replace(honest, version=PROTOCOL_VERSION - 1),
    RefusalCode.ENDPOINTS: lambda honest: replace(honest, endpoints={"dx": "tcp://127.0.0.1:1"}),
}
"""What else an observer could say of itself, by what it is refused for."""

_ROWS: Final = np.zeros((10, 1))
WRITES: Final = (
    *OUT_OF_TURN,
    encode(Sample(1, 1, np.array([0.1]))),
    encode(Telemetry(10, Figures({"speed": 1e9}), {names.DISPLACEMENT: _ROWS, names.FORCE: _ROWS})),
    encode(Report(1, Figures())),
    encode(Fault("dx: it is all over")),
)
"""What an observer may not say to the supervisor, nor anybody on a second connection of a member."""


@dataclass(frozen=True)
class AttackResults:
    """The observations of the attackers.

    Attributes:
        fates: the end of each attempt with a key.
        without: the end of each attempt without a key.
        refused: the supervisor's counts when all but the flood was over.
        lies: the supervisor's answers to the observer's lies, by the expected reason.
        observations: the frames that the observer received.
        queued: frames of the flood that left.
    """

    fates: Mapping[Try, Fate]
    without: Mapping[tuple[str, Door], Fate]
    refused: Mapping[str, int]
    lies: Mapping[RefusalCode, str]
    observations: tuple[Observation, ...]
    queued: int


def attack(stage: RogueSession) -> AttackResults:
    """Make every attack while the session runs."""
    with Stranger() as stranger:
        line, told, observations = _look_on(stage, stranger)
        met = _knock(stage, stranger)
        without = {(how, door): without_key(door.endpoint(stage), how.encode()) for how, door in WITHOUT_KEYS}
        lies = {code: _answer(line, lie(hello())) for code, lie in LIES.items()}
        line.send(*WRITES)
        _say_as_member(stage, stranger)
        _crowd(stage)
        for door in HALFWAY:
            with halfway(stranger, door.endpoint(stage), Claim.of(stage, "dz", door.of)):
                stage.go_on()
        refused = stage.wait_for(lambda progress: _settled(progress.refused)).refused
        queued = _flood(stage, line, refused)
        line.close()
        told.close()
    return AttackResults(met, without, refused, lies, observations, queued)


def _settled(refused: Mapping[str, int]) -> bool:
    """Whether the slow attempts have been counted; a test checks the numbers."""
    return refused.get("unfinished", 0) >= crowded(HUB) and refused.get("out_of_turn", 0) >= len(LIES) + len(WRITES)


def _look_on(stage: RogueSession, stranger: Stranger) -> tuple[Knock, Knock, tuple[Observation, ...]]:
    """Observe honestly: the line to the hub, the observer's own link, and at least one observation of each node."""
    line = stranger.knock(stage.hub, Claim.of(stage, OBSERVER, SUPERVISOR))
    _must(line.fate(DEADLINE_MS) is Fate.ADMITTED, "found an observer that is not admitted; expected it to be")
    line.send(hello())
    _must(isinstance(line.receive(), Welcome) and isinstance(line.receive(), Connect), "found no welcome; expected one")
    told = stranger.knock(stage.observer, Claim.of(stage, OBSERVER, SUPERVISOR), WATCH.kind)
    _must(told.fate(DEADLINE_MS) is Fate.ADMITTED, "found an observer that is not served; expected it to be")
    stage.go_on(2)
    observations: list[Observation] = []
    while {observation.node for observation in observations} != set(prepared().session.roles):
        message = told.receive()
        _must(isinstance(message, Observation), f"found {message}; expected an observation")
        if isinstance(message, Observation):
            observations.append(message)
    return line, told, tuple(observations)


def _knock(stage: RogueSession, stranger: Stranger) -> Mapping[Try, Fate]:
    """Make every attempt with a key; connections admitted for a moment use it."""
    found = {}
    for door in dict.fromkeys(one.door for one in TRIES):
        tries = [one for one in TRIES if one.door == door]
        knocks = [
            stranger.knock(door.endpoint(stage), one.claim(stage, door.of), one.kind or door.kind) for one in tries
        ]
        met = fates(stage, knocks, held=door.of != SUPERVISOR)
        for one, knock, fate in zip(tries, knocks, met, strict=True):
            if fate is Fate.ADMITTED and knock.socket.type == zmq.PAIR:
                knock.send(*WRITES)  # unread frames, which the session must not notice
            found[one] = fate
            knock.close()
    return found


def _answer(line: Knock, lie: NodeHello) -> str:
    """The code of the refusal of a hello."""
    line.send(lie)
    answer = line.receive()
    return answer.code if isinstance(answer, Refusal) else f"found {answer}; expected a refusal"


def _say_as_member(stage: RogueSession, stranger: Stranger) -> None:
    """Send on a member's second connection: messages out of turn, bytes that are no frame, and overlong frames."""
    second = stranger.knock(stage.hub, Claim.of(stage, "cy", SUPERVISOR))
    _must(second.fate(DEADLINE_MS) is Fate.ADMITTED, "found a real key that is not admitted; expected it to be")
    second.send(*WRITES)
    second.socket.send_multipart([b"two", b"parts"])
    second.socket.send(bytes(2 * MAX_CONTROL_BYTES))
    _must(second.fate(DEADLINE_MS) is Fate.ENDED, "found a connection that outlives a frame too long; expected its end")
    second.close()


def _crowd(stage: RogueSession) -> None:
    """Open idle connections while the session waits; the session goes on with all of them at its doors."""
    with ExitStack() as stack:
        for says, size in CROWDS.values():
            stack.enter_context(crowd(CY_DY.endpoint(stage), size, says))
        stage.go_on()
    for says, size in CROWDS.values():  # one after the other: this process has both ends of them
        with crowd(HUB.endpoint(stage), size // AT_THE_HUB, says):
            stage.go_on()


def _flood(stage: RogueSession, line: Knock, before: Mapping[str, int]) -> int:
    """Send junk as fast as possible while the session goes on; returns the number of frames that left."""
    queued = 0
    for index in range(FLOOD):
        try:
            line.socket.send(b"junk", zmq.NOBLOCK)
            queued += 1
        except zmq.Again:
            pass
        if index % (FLOOD // 20) == 0:
            stage.go_on()

    def heard(progress: Progress) -> bool:
        return progress.refused.get("out_of_turn", 0) > before.get("out_of_turn", 0)

    stage.wait_for(heard)
    return queued


def _must(holds: bool, otherwise: str) -> None:
    if not holds:
        raise AssertionError(otherwise)
