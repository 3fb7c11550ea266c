"""The table of topics: which quantities a running session shows of itself, of whom, in which letters and units.

A topic is what an onlooker sees of a node, tick by tick: a *trace* of its telemetry. The signals among them bear the
names of the channels that carry them (:mod:`manyhands.protocol.channels`); the others are findings of the node itself.
Recordings, live plots, and what is printed of a session are derived from this table; there is no other list.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from manyhands.protocol.messages import Role

DISPLACEMENT: Final = "x"
FREE_POSITION: Final = "p"
FORCE: Final = "f_v"
TOOL_POSITION: Final = "x_e"
MASS_POSITION: Final = "q"
LEDGER: Final = "ledger"
TAU: Final = "tau_us"

TELEMETRY: Final = "telemetry"
"""The topic of a node's figures, ten times a second, which every node has besides those of its role."""

CONDITION: Final = "condition"
"""The topic of the session as a whole, told by the supervisor: phase, states, notices, incidents."""


class Columns(StrEnum):
    """What the columns of a trace are of."""

    PORTS = "ports"
    MASSES = "masses"
    ONE = "one"


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table.

    Attributes:
        name: last part of its full name, ``/session/node/name``.
        trace: the trace of the node's telemetry that holds it, a row a tick.
        symbol: the quantity in the paper's letters.
        unit: SI unit (of a translational port), but for delays, which are in microseconds.
        columns: what the columns of the trace are of.
    """

    name: str
    trace: str
    symbol: str
    unit: str
    columns: Columns

    def columns_of(self, ports: tuple[str, ...], masses: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the columns, for a node with these ports; ``masses`` are the environment's."""
        return {Columns.PORTS: ports, Columns.MASSES: masses, Columns.ONE: (self.symbol,)}[self.columns]


_LEDGER: Final = Topic("ledger", LEDGER, "E", "J", Columns.ONE)

TOPICS: Final[Mapping[Role, tuple[Topic, ...]]] = MappingProxyType(
    {
        Role.DEVICE: (
            Topic("sample", DISPLACEMENT, "x", "m", Columns.PORTS),
            Topic("force", FORCE, "f_v", "N", Columns.PORTS),
            _LEDGER,
            Topic("tau", TAU, "τ", "us", Columns.ONE),
        ),
        Role.COUPLING: (
            Topic("tool", FREE_POSITION, "p", "m", Columns.PORTS),
            Topic("reaction", FORCE, "f_v", "N", Columns.PORTS),
            _LEDGER,
        ),
        Role.ENVIRONMENT: (
            Topic("tools", TOOL_POSITION, "x_e", "m", Columns.PORTS),
            Topic("masses", MASS_POSITION, "q", "m", Columns.MASSES),
            _LEDGER,
        ),
    }
)
"""The topics of each role, in the order in which they are shown."""


def topics_of(role: Role, masses: tuple[str, ...] = ()) -> tuple[Topic, ...]:
    """The topics of a node; an environment without masses has none of them to show."""
    return tuple(topic for topic in TOPICS.get(role, ()) if masses or topic.columns is not Columns.MASSES)


def topic_name(session: str, node: str, topic: str) -> str:
    """The full name of a node's topic, ``/session/node/topic``."""
    return f"/{session}/{node}/{topic}"
