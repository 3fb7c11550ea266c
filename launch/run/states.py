"""Where nodes and their session stand, and which message leads a node where.

What the conductor has the supervisor do: the only way in which a decision becomes a deed.

What happened to a session that it withstood: told in order, and counted for each node.

How a process ended, in words.
"""

from __future__ import annotations

import signal
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from manyhands.protocol.messages import Fault, Message, NodeHello, Probe, Ready, Report, Telemetry


class NodeState(StrEnum):
    """Where a node stands in its life."""

    STARTING = "starting"
    WELCOMED = "connecting"
    CONNECTED = "shaking hands"
    READY = "ready"
    RUNNING = "running"
    REPORTED = "done"
    FAULTED = "failed"
    LEAVING = "leaving"  # its process is as good as over, and is waited for
    LOST = "lost"  # it died while the session ran; it may come back
    GONE = "gone for good"
    ENDED = "ended"


class SessionPhase(StrEnum):
    """Where the session stands."""

    STARTING = "starting"
    RUNNING = "running"
    ENDING = "ending"
    OVER = "over"


TRANSITIONS: Mapping[tuple[NodeState, type[Message]], NodeState] = {
    (NodeState.STARTING, NodeHello): NodeState.WELCOMED,
    (NodeState.WELCOMED, Probe): NodeState.WELCOMED,
    (NodeState.CONNECTED, Probe): NodeState.CONNECTED,
    (NodeState.CONNECTED, Ready): NodeState.READY,
    (NodeState.RUNNING, Probe): NodeState.RUNNING,
    (NodeState.RUNNING, Telemetry): NodeState.RUNNING,
    (NodeState.RUNNING, Report): NodeState.REPORTED,
    (NodeState.STARTING, Fault): NodeState.FAULTED,
    (NodeState.WELCOMED, Fault): NodeState.FAULTED,
    (NodeState.CONNECTED, Fault): NodeState.FAULTED,
    (NodeState.READY, Fault): NodeState.FAULTED,
    (NodeState.RUNNING, Fault): NodeState.FAULTED,
}
"""Every message a node may send unasked, and where it leaves the node. Anything else is counted and ignored.

An Offer is an answer, and heard from whoever was asked for it: see :mod:`manyhands.launch.run.recovery`."""

RETURNING: Final = frozenset({NodeState.STARTING, NodeState.WELCOMED, NodeState.CONNECTED, NodeState.READY})
"""While the session runs: on the way back into it."""

OFFERING: Final = frozenset({NodeState.CONNECTED, NodeState.RUNNING})
"""In these states a node has been told who is absent, and may offer a place for them."""


@dataclass(frozen=True)
class Send:
    """Send a message to a node."""

    node: str
    message: Message


@dataclass(frozen=True)
class ReleaseName:
    """Let another connection have this name at the hub: an observer's next visit, or a node's next process."""

    name: str


@dataclass(frozen=True)
class StartProcess:
    """Start the process of a node anew; the earlier one has ended."""

    node: str


@dataclass(frozen=True)
class KillProcess:
    """End one node's process (SIGKILL): what it waits for will not come."""

    node: str


@dataclass(frozen=True)
class Terminate:
    """Ask every process that still runs to end (SIGTERM)."""


@dataclass(frozen=True)
class Kill:
    """End every process that still runs (SIGKILL)."""


Instruction = Send | ReleaseName | StartProcess | KillProcess | Terminate | Kill


MOST_INCIDENTS: Final = 100
"""How many are kept, the latest: a session may run for days."""


_FORGOTTEN = " earlier incidents"


class Incidents:
    """The latest incidents, and how many there were.

    Attributes:
        total: how many were told in all.
        restarts: how often each node came back into the session.
    """

    def __init__(self) -> None:
        self._latest: deque[str] = deque(maxlen=MOST_INCIDENTS)
        self.total = 0
        self.restarts: Counter[str] = Counter()

    def tell(self, sentence: str) -> None:
        """One more happened."""
        self._latest.append(sentence)
        self.total += 1

    @property
    def sentences(self) -> tuple[str, ...]:
        """The latest, oldest first; the first line says how many are no longer kept, if any are not."""
        forgotten = self.total - len(self._latest)
        return (*([f"{forgotten}{_FORGOTTEN}"] if forgotten else []), *self._latest)


def is_summary(sentence: str) -> bool:
    """Whether a sentence says how many incidents are no longer kept, and tells none."""
    return sentence.endswith(_FORGOTTEN) and sentence.removesuffix(_FORGOTTEN).isdecimal()


def ending(code: int) -> str:
    """What an exit code says (negative: the signal that killed it), to follow the process's name."""
    return f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"


def signal_name(number: int) -> str:
    """A signal's name; the realtime signals between the first and the last have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
