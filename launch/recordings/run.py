"""A recording read as a whole: every topic of every node, tick by tick, and what else the file holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Attachment, Channel, Metadata
from numpy.typing import NDArray

from manyhands.launch.recordings.gathering import Gatherer, fitting, most_ticks, objects
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.stream import End, Messages, parts
from manyhands.nodes.recorder.layout import METADATA, SUPERVISOR, Recorded, decode_condition, decode_figures
from manyhands.protocol.messages import Condition
from manyhands.protocol.topics import CONDITION, LEDGER, TELEMETRY, Topic, topic_name

Array = NDArray[np.float64]

MOST_VALUES: Final = 500_000_000
"""Most numbers that are read from one recording: 4 GB, about four hours of three users."""

MOST_MISSING: Final = 100_000_000
"""Most numbers that are filled with NaN where something is missing: 0.8 GB."""

MOST_OTHERS: Final = 10_000_000
"""Most figures and conditions, messages of both together."""

MOST_ATTACHED_BYTES: Final = 256 * 2**20
"""Most bytes of all attachments together."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One topic of one node.

    Attributes:
        topic: which.
        columns: names of its columns.
        values: ticks x columns; row k is tick k of the session, from 0; NaN where it was not recorded.
    """

    topic: Topic
    columns: tuple[str, ...]
    values: Array


@dataclass(frozen=True, eq=False)
class Run:
    """Everything of a recording.

    Attributes:
        recorded: the session.
        traces: by node and topic name, in the table's order, all of the same length; one of which nothing was recorded
            is NaN, but for ledgers, which a node has only where it keeps one.
        figures: by node, tick and figures of each telemetry.
        conditions: how the session was, each with the latest tick then.
        attachments: contents by name, of the session's file and the certificate's.
        cut: why the file is not whole, and up to which tick it is; None for one that is.
    """

    recorded: Recorded
    traces: Mapping[tuple[str, str], Trace]
    figures: Mapping[str, Sequence[tuple[int, Mapping[str, float]]]] = field(default_factory=dict)
    conditions: Sequence[tuple[int, Condition]] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    cut: str | None = None

    @property
    def ticks(self) -> int:
        """The number of ticks of the longest trace."""
        return max((len(trace.values) for trace in self.traces.values()), default=0)

    @property
    def time(self) -> Array:
        """The instants kT, s."""
        return np.arange(self.ticks, dtype=np.float64) * self.recorded.period


def read_run(path: Path, progress: Callable[[float], None] | None = None) -> Run:
    """Read an ``.mcap`` recording of this program, whole or cut anywhere behind its beginning.

    Args:
        path: the recording.
        progress: told which share of the file was read, from 0 to 1.

    Raises:
        RecordingError: not readable, no such recording, larger than is read, or cut before it says what it is.
    """
    reading = read_topics(path, lambda node, topic: True, progress)
    everyone = [*reading.gatherers.values()]
    ticks = most_ticks(everyone, MOST_MISSING)
    traces = {
        key: Trace(gatherer.topic, gatherer.columns, gatherer.rows(ticks)[0])
        for key, gatherer in reading.gatherers.items()
        if gatherer.count or gatherer.topic.trace != LEDGER
    }
    cut = None if reading.why is None else cut_at(reading.why, ticks)
    return Run(reading.recorded, traces, reading.figures, reading.conditions, reading.attachments, cut)


def cut_at(why: str, ticks: int) -> str:
    """Why a file is not whole, for people; ``ticks``: how far it goes all the same."""
    return f"{why}, and not as a recorder ends it; what it holds goes to tick {ticks}"


class Reading:
    """A recording while it is read.

    Attributes:
        recorded: the session.
        gatherers: the rows of the wanted topics, by node and topic name, in the table's order.
        figures: by node, tick and figures.
        conditions: tick and condition.
        attachments: contents by name.
        why: why the file is not whole; None if it is.
    """

    def __init__(self, path: Path, recorded: Recorded, wanted: Callable[[str, Topic], bool]) -> None:
        """A file that has said what it is of; ``wanted`` says which topics of which nodes to read."""
        self._path = path
        self.recorded = recorded
        self.gatherers = {
            (node, topic.name): Gatherer(topic, recorded.columns(node, topic))
            for node in recorded.roles
            for topic in recorded.topics(node)
            if wanted(node, topic)
        }
        self.figures: dict[str, list[tuple[int, Mapping[str, float]]]] = {node: [] for node in recorded.roles}
        self.conditions: list[tuple[int, Condition]] = []
        self.attachments: dict[str, bytes] = {}
        self.why: str | None = None
        name = recorded.session
        self._takers: dict[str, Callable[[list[bytes]], None]] = {
            **{topic_name(name, *key): gatherer.take for key, gatherer in self.gatherers.items()},
            **{topic_name(name, node, TELEMETRY): self._figures_of(node) for node in recorded.roles},
            topic_name(name, SUPERVISOR, CONDITION): self._take_conditions,
        }
        self._channels: dict[int, Callable[[list[bytes]], None]] = {}
        self._values = self._others = self._attached = 0

    def _figures_of(self, node: str) -> Callable[[list[bytes]], None]:
        def take(texts: list[bytes]) -> None:
            self._others += len(texts)
            self.figures[node] += fitting(objects(texts), decode_figures)

        return take

    def _take_conditions(self, texts: list[bytes]) -> None:
        self._others += len(texts)
        self.conditions += fitting(objects(texts), decode_condition)

    def take(self, part: object) -> None:
        """Take in a part of the file; what is nobody's is passed over.

        Raises:
            RecordingError: more than is read.
        """
        match part:
            case Channel():
                if part.topic in self._takers:
                    self._channels[part.id] = self._takers[part.topic]
            case Attachment():
                self._attached += len(part.data)
                self.attachments.setdefault(part.name, part.data)
            case Messages(found):
                texts: dict[int, list[bytes]] = {}
                for message in found:
                    texts.setdefault(message.channel, []).append(message.data)
                for channel, told in texts.items():
                    if channel in self._channels:
                        self._channels[channel](told)
            case End(why):
                self.why = why
        self._require_room()

    def _require_room(self) -> None:
        values = sum(gatherer.count * len(gatherer.columns) for gatherer in self.gatherers.values())
        for what, found, most in (
            ("numbers", values, MOST_VALUES),
            ("figures and conditions", self._others, MOST_OTHERS),
            ("bytes of attachments", self._attached, MOST_ATTACHED_BYTES),
        ):
            if found > most:
                raise RecordingError(f"{self._path}: found more than {most} {what}; expected a recording of fewer")


def read_topics(
    path: Path, wanted: Callable[[str, Topic], bool], progress: Callable[[float], None] | None = None
) -> Reading:
    """Read those topics of a recording that are ``wanted``, by node and topic; the rest as :func:`read_run`.

    Raises:
        RecordingError: as :func:`read_run`.
    """
    reading: Reading | None = None
    for part in parts(path, progress):
        match part:
            case Metadata(name, texts) if name == METADATA and reading is None:
                try:
                    reading = Reading(path, Recorded.from_metadata(texts), wanted)
                except ValueError as error:
                    raise RecordingError(f"{path}: {error}") from error
            case End(why) if reading is None:
                raise RecordingError(f"{path}: found no word of what was recorded, but {why or 'another file'}")
            case _ if reading is not None:
                reading.take(part)
    if reading is None:
        raise RecordingError(f"{path}: found no end")  # the last part is an end
    return reading
