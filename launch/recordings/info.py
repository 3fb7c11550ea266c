"""A summary of a recording: its session, its length, its channels and its missing ticks, without keeping its
numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Metadata

from manyhands.launch.recordings.mcap import End, Message, Messages, parts
from manyhands.launch.recordings.reading import cut_at, fitting, objects
from manyhands.launch.recordings.recording import RecordingError
from manyhands.nodes.recorder.away import Away
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party, spans_by_party, without
from manyhands.nodes.recorder.coverage import Gap as MissingTicks
from manyhands.nodes.recorder.format import METADATA, SUPERVISOR, Recorded, decode_condition, decode_figures
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.channels import CONDITION, DISPLACEMENT, TELEMETRY, topic_name, topics_of
from manyhands.protocol.messages import Role


@dataclass
class ChannelInfo:
    """One channel.

    Attributes:
        topic: its full name.
        messages: number of messages.
        first: log time of the first, ns since 1970; 0 without any.
        last: log time of the last.
    """

    topic: str
    messages: int = 0
    first: int = 0
    last: int = 0

    @property
    def rate(self) -> float | None:
        """Messages a second of the session's time; None for fewer than two, or all at one time."""
        return (self.messages - 1) * 1e9 / (self.last - self.first) if self.last > self.first else None


@dataclass(frozen=True)
class Info:
    """The content of a recording.

    Attributes:
        recorded: the session.
        size: of the file, bytes.
        first: the session's first tick of any device; None where there is none.
        ticks: one more than the session's last tick.
        channels: by node, in the session's order.
        attachments: size in bytes by name.
        missing: number of its own ticks that are missing between first and last, by device, for devices that miss some.
        gaps: the missing ticks by device; the first :data:`MOST_GAPS`.
        accounts: the least interface account of each device that reported one, J.
        by_itself: what devices do by themselves, which no certificate covers, by device.
        presses: how often each button was pressed, by its name; without those that were not.
        cut: why the file cannot be read to its end, and up to which tick it can; None for a whole file.
    """

    recorded: Recorded
    size: int
    first: int | None
    ticks: int
    channels: tuple[ChannelInfo, ...]
    attachments: Mapping[str, int]
    missing: Mapping[str, int]
    gaps: Mapping[str, tuple[MissingTicks, ...]]
    accounts: Mapping[str, float]
    by_itself: Mapping[str, tuple[str, ...]]
    presses: Mapping[str, int]
    cut: str | None

    @property
    def duration(self) -> float:
        """Time from the first tick to the end of the last, s of the session's time."""
        return (self.ticks - (self.first or 0)) * self.recorded.period

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        recorded = self.recorded
        return {
            "session": recorded.session,
            "certificate": recorded.certificate,
            "version": recorded.version,
            "clock": recorded.clock,
            "period": recorded.period,
            "periods": dict(recorded.periods),
            "bytes": self.size,
            "first": self.first,
            "ticks": self.ticks,
            "duration": self.duration,
            "channels": [{"topic": c.topic, "messages": c.messages, "rate": c.rate} for c in self.channels],
            "attachments": dict(self.attachments),
            "missing": dict(self.missing),
            "gaps": {device: [[gap.begin, gap.end] for gap in gaps] for device, gaps in self.gaps.items()},
            "accounts": dict(self.accounts),
            "by_itself": {device: list(own) for device, own in self.by_itself.items()},
            "presses": dict(self.presses),
            "cut": self.cut,
        }


def read_info(path: Path, progress: Callable[[float], None] | None = None) -> Info:
    """Read through a recording, whole or cut.

    Args:
        path: the recording.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: the file cannot be read, is no recording, or is cut before its metadata.
    """
    looking = _InfoReader(path)
    for part in parts(path, progress):
        looking.take(part)
    return looking.info()


def _node_of(topic: str) -> str:
    """The node in a topic's name; empty in a name of another form."""
    _, _, node, *_ = [*topic.split("/"), "", "", ""]
    return node


class _InfoReader:
    """Reads one file, part by part."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recorded: Recorded | None = None
        self._away: Away | None = None
        self._world = ""  # the topic of the environment's figures
        self._end = 0  # the tick after its last
        self._condition = ""  # the topic of the session's condition
        self._channels: dict[int, ChannelInfo] = {}
        self._devices: dict[str, tuple[str, Coverage]] = {}
        self._reporting: dict[str, str] = {}  # devices, by the topic of their figures
        self._accounts: dict[str, float] = {}
        self._by_itself: dict[str, tuple[str, ...]] = {}
        self._presses: Counter[str] = Counter()
        self._attachments: dict[str, int] = {}
        self._why: str | None = None

    def take(self, part: object) -> None:
        match part:
            case Metadata(name, texts) if name == METADATA and self._recorded is None:
                try:
                    self._begin(Recorded.from_metadata(texts))
                except ValueError as error:
                    raise RecordingError(f"{self._path}: {error}") from error
            case Channel():
                self._channels.setdefault(part.id, ChannelInfo(part.topic))
            case Attachment():
                self._attachments.setdefault(part.name, len(part.data))
            case Messages(found):
                self._count(found)
            case End(why):
                self._why = why

    def _begin(self, recorded: Recorded) -> None:
        self._recorded, self._away = recorded, Away(recorded)
        worlds = [name for name, role in recorded.roles.items() if role is Role.ENVIRONMENT]
        self._world = topic_name(recorded.session, worlds[0], TELEMETRY) if worlds else ""
        sample = next(topic.name for topic in topics_of(Role.DEVICE) if topic.trace == DISPLACEMENT)
        self._devices = {
            topic_name(recorded.session, device, sample): (device, Coverage()) for device in recorded.devices
        }
        self._condition = topic_name(recorded.session, SUPERVISOR, CONDITION)
        self._reporting = {topic_name(recorded.session, device, TELEMETRY): device for device in recorded.devices}

    def _count(self, found: list[Message]) -> None:
        together: dict[int, list[Message]] = {}
        for message in found:
            together.setdefault(message.channel, []).append(message)
        for number, own in together.items():
            channel = self._channels.get(number)
            if channel is None:
                continue  # the file declares no such channel
            times = [message.log_time for message in own]
            channel.first = min(times) if channel.messages == 0 else min(channel.first, *times)
            channel.last = max(channel.last, *times)
            channel.messages += len(own)
            if channel.topic in self._devices:
                ticks = np.fromiter((message.sequence for message in own), dtype=np.int64, count=len(own))
                self._devices[channel.topic][1].take_each(ticks)
            elif channel.topic in self._reporting:
                self._take_figures(self._reporting[channel.topic], own)
            elif channel.topic == self._world and self._away is not None:
                for tick, figures in fitting(objects([message.data for message in own]), decode_figures):
                    self._away.take(figures)
                    self._end = max(self._end, tick)
            elif channel.topic == self._condition:
                for _, condition in fitting(objects([message.data for message in own]), decode_condition):
                    self._by_itself |= condition.by_itself

    def _take_figures(self, device: str, found: list[Message]) -> None:
        """Take presses, and the least account; each message has the least since the device's process began."""
        for _, figures in fitting(objects([message.data for message in found]), decode_figures):
            least = figures.get(names.INTERFACE_LEAST, math.nan)
            self._presses.update(e.peer for e in events_in(figures) if e.kind is Kind.PRESSED and e.value)
            if math.isfinite(least):
                self._accounts[device] = min(least, self._accounts.get(device, math.inf))

    def info(self) -> Info:
        if self._recorded is None:
            raise RecordingError(
                f"{self._path}: found no metadata of a session ({self._why or 'another file'}); expected a recording"
            )
        devices = dict(self._devices.values())
        rate_of = self._recorded.rate_of
        begun = [session_tick(own.first, rate_of(name)) for name, own in devices.items() if own.first is not None]
        ends = (session_tick(own.next - 1, rate_of(name)) + 1 for name, own in devices.items())
        world = self._end if self._recorded.linked else 0  # a session of guests may go on without a device
        end = max([world, *ends])
        spans = spans_by_party(devices, rate_of)
        away = {} if self._away is None else self._away.of(spans)
        missing = missing_by_party(devices, spans, away)
        order = {node: place for place, node in enumerate([*self._recorded.roles, SUPERVISOR])}
        return Info(
            recorded=self._recorded,
            size=self._path.stat().st_size,
            first=min(begun, default=None),
            ticks=end,
            channels=tuple(sorted(self._channels.values(), key=lambda channel: order.get(_node_of(channel.topic), 0))),
            attachments=self._attachments,
            missing=missing,
            gaps={
                device: without(devices[device].gaps_in(spans[device].start, spans[device].stop), away.get(device, ()))
                for device in missing
            },
            accounts={device: self._accounts[device] for device in devices if device in self._accounts},
            by_itself=self._by_itself,
            presses=self._presses,
            cut=None if self._why is None else cut_at(self._why, end),
        )
