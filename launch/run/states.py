"""The states of nodes and of their session, the instructions to the supervisor, and the lists of what happened.

A message moves a node from one state to the next by the table :data:`TRANSITIONS`. The conductor decides and returns
instructions; the supervisor carries them out. An incident is a fault that the session survives; a visit is that of a
guest at a seat, who comes and goes as intended.
"""

from __future__ import annotations

import re
import signal
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from manyhands.protocol.messages import Fault, Fetch, Message, NodeHello, Probe, Ready, Report, Telemetry


class NodeState(StrEnum):
    """The state of a node, from its start to its end."""

    STARTING = "starting"
    WELCOMED = "connecting"
    CONNECTED = "shaking hands"
    READY = "ready"
    RUNNING = "running"
    REPORTED = "done"
    FAULTED = "failed"
    LEAVING = "leaving"  # it takes part no longer; the supervisor waits for its process to end
    LOST = "lost"  # its process died while the session ran; it may come back
    GONE = "gone for good"
    ENDED = "ended"


class SessionPhase(StrEnum):
    """The phase of a session."""

    STARTING = "starting"
    RUNNING = "running"
    ENDING = "ending"
    OVER = "over"


TRANSITIONS: Mapping[tuple[NodeState, type[Message]], NodeState] = {
    (NodeState.LOST, Fetch): NodeState.LOST,
    (NodeState.STARTING, NodeHello): NodeState.WELCOMED,
    (NodeState.WELCOMED, Probe): NodeState.WELCOMED,
    (NodeState.CONNECTED, Probe): NodeState.CONNECTED,
    (NodeState.CONNECTED, Ready): NodeState.READY,
    (NodeState.READY, Probe): NodeState.READY,
    (NodeState.RUNNING, Probe): NodeState.RUNNING,
    (NodeState.RUNNING, Telemetry): NodeState.RUNNING,
    (NodeState.RUNNING, Report): NodeState.REPORTED,
    (NodeState.STARTING, Fault): NodeState.FAULTED,
    (NodeState.WELCOMED, Fault): NodeState.FAULTED,
    (NodeState.CONNECTED, Fault): NodeState.FAULTED,
    (NodeState.READY, Fault): NodeState.FAULTED,
    (NodeState.RUNNING, Fault): NodeState.FAULTED,
}
"""Every message that a node may send of its own accord, and the state that follows. Any other is counted and ignored.

An Offer answers a request, so it is accepted from the node that was asked: see :mod:`manyhands.launch.run.recovery`.
"""

RETURNING: Final = frozenset({NodeState.STARTING, NodeState.WELCOMED, NodeState.CONNECTED, NodeState.READY})
"""The states of a node that is on its way back into a running session."""

OFFERING: Final = frozenset({NodeState.CONNECTED, NodeState.RUNNING})
"""In these states a node knows which peers are absent, and may offer an endpoint to them."""


@dataclass(frozen=True)
class Send:
    """Send a message to a node."""

    node: str
    message: Message


@dataclass(frozen=True)
class ReleaseName:
    """Make a name at the hub free for another connection: an observer's next visit, or a node's next process."""

    name: str


@dataclass(frozen=True)
class StartProcess:
    """Start a new process for a node; the earlier process has ended."""

    node: str


@dataclass(frozen=True)
class KillProcess:
    """Kill one node's process (SIGKILL), because it waits for a peer that will not come."""

    node: str


@dataclass(frozen=True)
class Terminate:
    """Ask every process that still runs to end (SIGTERM)."""


@dataclass(frozen=True)
class Kill:
    """End every process that still runs (SIGKILL)."""


Instruction = Send | ReleaseName | StartProcess | KillProcess | Terminate | Kill


MOST_KEPT: Final = 100
"""Number of incidents, and of visits, that are kept, the latest ones: a session may run for days."""


class Happenings:
    """The latest sentences about what happened in a session, and how many there were.

    Attributes:
        what: the word for all of them.
        total: number of all of them.
    """

    def __init__(self, what: str) -> None:
        """None yet."""
        self.what = what
        self._latest: deque[str] = deque(maxlen=MOST_KEPT)
        self.total = 0

    def add(self, sentence: str) -> None:
        """Add one, in one sentence."""
        self._latest.append(sentence)
        self.total += 1

    @property
    def sentences(self) -> tuple[str, ...]:
        """The latest ones, oldest first. If older ones were dropped, the first line states how many."""
        forgotten = self.total - len(self._latest)
        return (*([f"{forgotten} earlier {self.what}"] if forgotten else []), *self._latest)


class Incidents(Happenings):
    """What the session survived.

    Attributes:
        restarts: how often each node came back into the session.
    """

    def __init__(self) -> None:
        super().__init__("incidents")
        self.restarts: Counter[str] = Counter()


def is_summary(sentence: str) -> bool:
    """Whether a sentence is the line that counts those that were dropped, and says nothing else."""
    return re.fullmatch(r"\d+ earlier (incidents|visits)", sentence) is not None


def ending(code: int) -> str:
    """How a process with this exit code ended, to follow its name; a negative code is the signal that killed it."""
    return f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"


def signal_name(number: int) -> str:
    """The name of a signal. Realtime signals between the first and the last have no name, and are given by number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
