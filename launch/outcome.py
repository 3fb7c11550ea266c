"""What is told of a run: while it goes on, and how it went."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from manyhands.launch.conductor import Phase
from manyhands.launch.recordings.recording import Recording
from manyhands.protocol.messages import Telemetry


@dataclass(frozen=True)
class Progress:
    """What a display is told.

    Attributes:
        phase: where the session stands.
        states: where each node stands.
        pids: process ids of the nodes that run.
        telemetry: the latest telemetry of each node.
        elapsed: since the first tick, s.
        notices: assumptions found broken, each told once.
        refused: what strangers tried at the supervisor's door, and what members sent out of turn, by kind.
        silent: nodes that run, and whose telemetry has not come for a while.
        incidents: what the session withstood, the latest of it.
        faults: what went wrong.
    """

    phase: Phase
    states: Mapping[str, str]
    pids: Mapping[str, int]
    telemetry: Mapping[str, Telemetry]
    elapsed: float
    notices: tuple[str, ...]
    refused: Mapping[str, int]
    silent: frozenset[str] = frozenset()
    incidents: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """How a run went.

    Attributes:
        code: exit code: 0, 1 a process failed, 130 on Ctrl-C (143 on SIGTERM, 129 on SIGHUP, 131 on SIGQUIT). A process
            that failed and came back, or was on its way back at the end, is no failure of the run: it is an incident.
        faults: what went wrong, empty for a good run.
        notices: assumptions of the certificate that the run broke.
        report: the report's object.
        recording: every x and f_v, when wanted and any were received.
        lost: ticks missing from the recording, by device.
        refused: what strangers tried at the supervisor's door, and what members sent out of turn, by kind.
        incidents: what the session withstood, the latest of it.
    """

    code: int
    faults: tuple[str, ...]
    notices: tuple[str, ...]
    report: Mapping[str, Any]
    recording: Recording | None
    lost: Mapping[str, int]
    refused: Mapping[str, int]
    incidents: tuple[str, ...] = ()
