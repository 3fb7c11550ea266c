"""What the conductor has the supervisor do: the only way in which a decision becomes a deed."""

from __future__ import annotations

from dataclasses import dataclass

from manyhands.protocol.messages import Message


@dataclass(frozen=True)
class Send:
    """Send a message to a node."""

    node: str
    message: Message


@dataclass(frozen=True)
class Release:
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


Instruction = Send | Release | StartProcess | KillProcess | Terminate | Kill
