"""The table of channels: what processes of a session exchange, who may send it to whom, and how often.

There is no other list. Sockets, permissions, documentation and displays are derived from this one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from manyhands.protocol.messages import (
    Absent,
    Condition,
    Connect,
    Echo,
    Fault,
    Force,
    Grasp,
    LinkHello,
    Message,
    NodeHello,
    Observation,
    Offer,
    Probe,
    Reaction,
    Ready,
    Refusal,
    Release,
    Report,
    Return,
    Role,
    Rung,
    Sample,
    Shift,
    Start,
    Stop,
    Telemetry,
    Tool,
    Welcome,
)


class Rate(StrEnum):
    """How often a channel carries a message."""

    EVERY_TICK = "every tick"
    TEN_HZ = "10 Hz"
    ONCE = "once"


@dataclass(frozen=True, slots=True)
class Channel:
    """One row of the table.

    Attributes:
        name: last part of the channel's full name.
        messages: the message types it carries.
        senders: roles that may send on it.
        receivers: roles that receive from it.
        symbol: the quantity in the paper's letters, empty where it carries none.
        unit: SI unit of the values (of a translational port), empty where there is none.
        rate: how often.
    """

    name: str
    messages: tuple[type[Message], ...]
    senders: tuple[Role, ...]
    receivers: tuple[Role, ...]
    symbol: str
    unit: str
    rate: Rate


_NODES: Final = (Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT)
_EVERYONE: Final = (*_NODES, Role.SUPERVISOR, Role.OBSERVER)

_TABLE: Final = (
    Channel("sample", (Sample,), (Role.DEVICE,), (Role.COUPLING,), "x", "m", Rate.EVERY_TICK),
    Channel("tool", (Tool,), (Role.COUPLING,), (Role.ENVIRONMENT,), "p", "m", Rate.EVERY_TICK),
    Channel("reaction", (Reaction,), (Role.ENVIRONMENT,), (Role.COUPLING,), "f_v", "N", Rate.EVERY_TICK),
    Channel("force", (Force,), (Role.COUPLING,), (Role.DEVICE,), "f_v", "N", Rate.EVERY_TICK),
    Channel("handshake", (LinkHello, Welcome, Refusal), _NODES, _NODES, "", "", Rate.ONCE),
    Channel(
        "rung",
        (Rung,),
        (Role.ENVIRONMENT, Role.COUPLING),
        (Role.COUPLING, Role.DEVICE),
        "",
        "",
        Rate.ONCE,
    ),
    Channel(
        "absence",
        (Absent,),
        (Role.DEVICE, Role.COUPLING),
        (Role.COUPLING, Role.ENVIRONMENT),
        "",
        "",
        Rate.ONCE,
    ),
    Channel(
        "control",
        (
            *(NodeHello, Welcome, Refusal, Connect, Ready, Start, Stop, Probe, Echo),
            *(Absent, Offer, Return, Shift, Report, Fault),
        ),
        _EVERYONE,
        _EVERYONE,
        "",
        "",
        Rate.ONCE,
    ),
    Channel("telemetry", (Telemetry,), _NODES, (Role.SUPERVISOR,), "", "", Rate.TEN_HZ),
    Channel("observation", (Observation, Condition), (Role.SUPERVISOR,), (Role.OBSERVER,), "", "", Rate.TEN_HZ),
    Channel("grip", (Grasp, Release), (Role.HAND,), (Role.DEVICE,), "", "m", Rate.ONCE),
)

CHANNELS: Final[Mapping[str, Channel]] = MappingProxyType({channel.name: channel for channel in _TABLE})
"""Every channel by its name."""
