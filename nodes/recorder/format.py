"""The format of a recording: the channels of its MCAP file, the form of their messages, and the session's metadata.

Each tick and topic has one JSON message, which every viewer of MCAP files can draw: the tick, its time since tick 0,
and the topic's row. Writer and readers both use this module; docs/files.md describes the format for people.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final

from manyhands import __version__
from manyhands.design.models.scene import ContactScene, geometry_of
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.kernel.json_number import json_figures
from manyhands.nodes.monitor.health import as_plain
from manyhands.nodes.monitor.session_state import About
from manyhands.nodes.recorder.scene_messages import SCENE_SCHEMAS, SceneMessages
from manyhands.nodes.rows.figures import FIGURES as DECLARED
from manyhands.nodes.rows.figures import WAVE_HOLDING
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic, links_at, topic_name, topics_of
from manyhands.protocol.messages import Condition, Figures, PromiseStatus, Role

FORMAT: Final = "manyhands-recording"
VERSION: Final = "2"
METADATA: Final = "session"
"""The name of the metadata record that describes the session."""

SESSION_FILE: Final = "session.yaml"
CERTIFICATE_FILE: Final = "certificate.json"
MEDIA_TYPES: Final[Mapping[str, str]] = {SESSION_FILE: "application/yaml", CERTIFICATE_FILE: "application/json"}
"""The attachments: the session as it ran, and the certificate it ran under, if it had one."""

_PART: Final = re.compile(r"certificate\.\w[\w.-]{0,199}\.json")
"""The certificate of one part of a session with wave links; :data:`CERTIFICATE_FILE` is then that of its world."""


def media_type(name: str) -> str | None:
    """The media type of an attachment; None for a name that no recording's attachment has."""
    return "application/json" if _PART.fullmatch(name) else MEDIA_TYPES.get(name)


SUPERVISOR: Final = "supervisor"
"""The node name under which the session's condition is recorded."""

MESSAGE_ENCODING: Final = "json"
SCHEMA_ENCODING: Final = "jsonschema"

TICK: Final = "tick"
TIME: Final = "time"
FIGURES: Final = "figures"

SEQUENCES: Final = 2**32
"""An MCAP sequence number has 32 bits: it is the tick modulo this number."""

MAX_TIME_NS: Final = 2**63 - 1
"""The latest time of a message, ns since 1970."""

_NAME: Final = re.compile(r"\w[\w.-]{0,199}")
"""A name in a recording. It becomes a heading in a table, and a spreadsheet computes a cell that begins with
``=+-@``."""

_LONGEST_TEXT: Final = 200

_NUMBER: Final = {"type": "number", "nullable": True}  # a single type: viewers refuse a list of types
_TIME: Final = {"type": "number", "description": "kT, s since tick 0, to the nanosecond"}
_TEXT: Final = {"type": "string"}
_TEXTS: Final = {"type": "array", "items": _TEXT}
_NUMBERS: Final = {"type": "object", "properties": {}, "additionalProperties": _NUMBER}
_FIGURES: Final = {
    **_NUMBERS,
    "properties": {name: _NUMBERS for name, figure in DECLARED.items() if figure.key is not None},
}
_PROMISE: Final = {
    "type": "object",
    "properties": {
        **dict.fromkeys(("promise", "state", "remark"), _TEXT),
        "who": _TEXTS,
        **dict.fromkeys(("since", "until"), _NUMBER),
        "cost": _NUMBERS,
    },
}


def schema_of(topic: Topic) -> tuple[str, str]:
    """Name and text of the JSON schema of a topic's messages."""
    one = topic.columns is Columns.ONE
    value = _NUMBER if one else {"type": "array", "items": _NUMBER}
    about = f"{topic.symbol}, {topic.unit}{'' if one else ', in the order of the columns'}; null: not a finite number"
    return object_schema(topic.name, {TIME: _TIME, topic.trace: {**value, "description": about}})


def object_schema(name: str, properties: Mapping[str, Any]) -> tuple[str, str]:
    """Name and text of a JSON schema of messages with a tick and these properties, all of them required."""
    every = {TICK: {"type": "integer", "description": "k, from 0"}, **properties}
    return f"manyhands.{name}", json.dumps({"type": "object", "properties": every, "required": [*every]})


OTHER_SCHEMAS: Final[Mapping[str, tuple[str, str]]] = {
    TELEMETRY: object_schema(TELEMETRY, {FIGURES: _FIGURES}),
    CONDITION: object_schema(
        CONDITION,
        {
            "phase": _TEXT,
            "elapsed": {"type": "number", "description": "since the first tick, s, by the clock on the wall"},
            "states": {"type": "object", "properties": {}, "additionalProperties": _TEXT},
            **dict.fromkeys(("silent", "notices", "incidents", "faults"), _TEXTS),
            "promises": {"type": "array", "items": _PROMISE},
        },
    ),
    **SCENE_SCHEMAS,
}
"""Names and texts of the schemas of the messages that belong to no topic of the table: figures, condition, and what
shows a scene.
"""


def encode_figures(tick: int, figures: Figures) -> bytes:
    """The message of figures up to ``tick``; an infinite value or NaN becomes null."""
    return json.dumps({TICK: tick, FIGURES: json_figures(figures)}, allow_nan=False).encode()


def decode_figures(plain: Any) -> tuple[int, Figures]:
    """Tick and figures of a message that was read as JSON; null becomes NaN.

    Raises:
        ValueError: the message holds no figures.
    """
    match plain:
        case {"tick": int(tick), "figures": dict(found)} if 0 <= tick < 2**63:
            return tick, _figures_of(found)
        case _:
            raise ValueError("found another object; expected tick and figures")


def _figures_of(found: Mapping[str, Any]) -> Figures:
    """Numbers and tables in an object; names of before protocol 6 are read as those of tables."""
    numbers, tables = dict[str, float](), dict[str, dict[str, float]]()
    for stated, value in found.items():
        name = stated.replace("wave_deaf", WAVE_HOLDING, 1)  # its name of before protocol 6
        if isinstance(value, dict):
            tables[name] = {str(key): _finding(number) for key, number in value.items()}
        elif (former := _FORMER.match(name)) is not None and name not in DECLARED:
            table = _TABLES[former[1]]
            tables.setdefault(table, {})[name.removeprefix(former[0])] = _finding(value)
        else:
            numbers[str(name)] = _finding(value)
    return Figures(numbers, tables)


_TABLES: Final = {name.removesuffix("_of"): name for name, figure in DECLARED.items() if figure.key is not None}
"""Before protocol 6 a number of a table was a figure with a prefix, such as ``moved_cx/cy``: the tables by prefix."""

_FORMER: Final = re.compile(f"({'|'.join(sorted(_TABLES, key=len, reverse=True))})_")


def _finding(value: object) -> float:
    return math.nan if value is None else _number(value)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"found {type(value).__name__}; expected a number")
    try:
        return float(value)
    except OverflowError as error:
        raise ValueError("found an integer beyond all doubles; expected a number") from error


def encode_condition(tick: int, condition: Condition) -> bytes:
    """The message of the session's condition when ``tick`` was the latest known tick."""
    return json.dumps(
        {
            TICK: tick,
            "phase": condition.phase,
            "elapsed": condition.elapsed,
            "states": dict(condition.states),
            "silent": condition.silent,
            "notices": condition.notices,
            "incidents": condition.incidents,
            "faults": condition.faults,
            "promises": [_without_null(as_plain(status)) for status in condition.promises],
        },
        ensure_ascii=False,
    ).encode()


def _without_null(plain: Mapping[str, Any]) -> dict[str, Any]:
    """An object without the keys that hold null, which its schema would not allow."""
    return {key: value for key, value in plain.items() if value is not None}


def decode_condition(plain: Any) -> tuple[int, Condition]:
    """Tick and condition of a message that was read as JSON.

    Raises:
        ValueError: the message holds no condition.
    """
    match plain:
        case {"tick": int(tick), "phase": str(phase), "elapsed": elapsed, "states": dict(states)} if (
            0 <= tick < 2** 63 and all(type(state) is str for state in states.values())
        ):
            silent, notices, incidents, faults = (
                _texts(plain.get(key)) for key in ("silent", "notices", "incidents", "faults")
            )
            promises = _promises(plain.get("promises", []))  # recordings before 0.7 have none
            return tick, Condition(phase, _number(elapsed), states, silent, notices, incidents, faults, promises)
        case _:
            raise ValueError("found another object; expected tick and condition")


def _promises(found: object) -> tuple[PromiseStatus, ...]:
    if not isinstance(found, list):
        raise ValueError("found no list of promises; expected one")
    return tuple(map(_status, found))


def _status(plain: Any) -> PromiseStatus:
    match plain:
        case {"promise": str(promise), "state": str(state), "remark": str(remark), "cost": dict(cost)}:
            since, until = (None if (at := plain.get(key)) is None else _number(at) for key in ("since", "until"))
            costs = {str(unit): math.nan if value is None else _number(value) for unit, value in cost.items()}
            return PromiseStatus(promise, state, _texts(plain.get("who")), since, until, costs, remark)
        case _:
            raise ValueError("found another object; expected how a promise stands")


def _texts(found: object) -> tuple[str, ...]:
    if not isinstance(found, list) or not all(type(text) is str for text in found):
        raise ValueError("found no list of texts; expected one")
    return tuple(found)


@dataclass(frozen=True)
class ChannelAbout:
    """What a viewer has to know of a channel before its first message.

    Attributes:
        topic: its full name, ``/session/node/topic``.
        schema: the name of its messages' JSON schema.
        schema_text: the schema.
        metadata: node, role, and of a topic of the table symbol, unit, and the names of the columns as a JSON list.
    """

    topic: str
    schema: str
    schema_text: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class Recorded:
    """The session of a recording.

    Attributes:
        session: the session's name.
        certificate: id of the certificate (or of the uncertified session) it ran under.
        period: T, s.
        clock: "realtime" or "simulated".
        roles: every node's role.
        ports: the ports of each node, in the order of its traces' columns.
        masses: the environment's masses, in the order of its traces' columns; empty where they are not known.
        version: of the program that recorded it.
        periods: T of the nodes that have a period of their own, s: those at the site of a wave link with one.
        linked: the couplings that have a wave link, in the session's order.
        scene: the geometry of its tools, bodies and obstacles; None if the environment is neither a scene nor a mesh.
    """

    session: str
    certificate: str
    period: float
    clock: str
    roles: Mapping[str, Role]
    ports: Mapping[str, tuple[str, ...]]
    masses: tuple[str, ...] = ()
    version: str = __version__
    periods: Mapping[str, float] = field(default_factory=dict)
    linked: tuple[str, ...] = ()
    scene: ContactScene | None = None

    @property
    def devices(self) -> dict[str, tuple[str, ...]]:
        """The ports of each device, in the session's order."""
        return {name: self.ports[name] for name, role in self.roles.items() if role is Role.DEVICE}

    def topics(self, node: str) -> tuple[Topic, ...]:
        """The topics of a node, in the table's order; empty for an unknown node."""
        role = self.roles.get(node)
        wall = self.clock == REALTIME
        return () if role is None else topics_of(role, self.masses, wall, bool(self.links_of(node)))

    def columns(self, node: str, topic: Topic) -> tuple[str, ...]:
        """Names of the columns of a node's topic."""
        return topic.columns_of(self.ports[node], self.masses, self.links_of(node))

    def channel(self, node: str, topic: Topic | str) -> ChannelAbout:
        """A node's channel, the same in a recording and on a live connection.

        Args:
            node: its name.
            topic: a topic of the table, or the name of one of :data:`OTHER_SCHEMAS`.
        """
        metadata = {"node": node, "role": self.roles.get(node, Role.SUPERVISOR).value}
        if isinstance(topic, str):
            return ChannelAbout(topic_name(self.session, node, topic), *OTHER_SCHEMAS[topic], metadata)
        columns = json.dumps(self.columns(node, topic), ensure_ascii=False)
        metadata |= {"symbol": topic.symbol, "unit": topic.unit, "columns": columns}
        return ChannelAbout(topic_name(self.session, node, topic.name), *schema_of(topic), metadata)

    def scene_messages(self) -> SceneMessages | None:
        """What makes the messages that show the scene; None without one.

        Raises:
            ValueError: the scene's ports or bodies are not those of the environment.
        """
        if self.scene is None:
            return None
        (node,) = (name for name, role in self.roles.items() if role is Role.ENVIRONMENT)
        return SceneMessages(self.scene, self.session, node, self.ports[node], self.masses, self.tick_ns(node))

    def behind_wave_link(self, node: str) -> bool:
        """Whether a wave link stands between a device or coupling and the environment."""
        linked = {port for name in self.linked for port in self.ports[name]}
        return self.roles[node] is not Role.ENVIRONMENT and bool(linked & {*self.ports[node]})

    def links_of(self, node: str) -> dict[str, tuple[str, ...]]:
        """The ports of each wave link that ends at a node, by its coupling."""
        return links_at(node, self.roles[node], self.ports, self.linked)

    def period_of(self, node: str) -> float:
        """T of a node, s."""
        return self.periods.get(node, self.period)

    def rate_of(self, node: str) -> float:
        """Ticks of a node in one of the session's."""
        return self.period / self.period_of(node)

    def tick_ns(self, node: str) -> float:
        """T of a node, ns. It is a whole number if it differs from one only by the rounding of its decimals."""
        exact = self.period_of(node) * 1e9
        return float(round(exact)) if math.isclose(exact, round(exact), rel_tol=1e-12) else exact

    def as_metadata(self) -> dict[str, str]:
        """As the metadata of a file: texts by name, structure as JSON."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "manyhands": self.version,
            "session": self.session,
            "certificate": self.certificate,
            "period": repr(self.period),
            "clock": self.clock,
            "roles": json.dumps(dict(self.roles)),
            "ports": json.dumps(dict(self.ports)),
            "masses": json.dumps(self.masses),
            **({"periods": json.dumps(dict(self.periods))} if self.periods else {}),
            **({"wave_links": json.dumps(self.linked)} if self.linked else {}),
            **({} if self.scene is None else {"scene": json.dumps(self.scene.geometry_terms())}),
        }

    @classmethod
    def from_metadata(cls, texts: Mapping[str, str]) -> Recorded:
        """The session of a file's metadata.

        Raises:
            ValueError: the metadata is not of this format and version, or makes no sense.
        """
        found = f"{texts.get('format', '')!r:.40} version {texts.get('version', '')!r:.40}"
        if (texts.get("format"), texts.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"found {found}; expected {FORMAT!r} version {VERSION!r}")
        try:
            ports: dict[str, Any] = json.loads(texts["ports"])
            out = cls(
                texts["session"],
                texts["certificate"],
                float(texts["period"]),
                texts["clock"],
                {name: Role(role) for name, role in json.loads(texts["roles"]).items()},
                {name: tuple(own) for name, own in ports.items()},
                tuple(json.loads(texts["masses"])),
                texts["manyhands"],
                {name: _number(own) for name, own in json.loads(texts.get("periods", "{}")).items()},
                tuple(json.loads(texts.get("wave_links", "[]"))),
                _scene_in(texts),
            )
        except (KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"found metadata without {error}; expected that of a recording") from error
        if not (0.0 < out.period < math.inf and out.roles.keys() == out.ports.keys() and out.devices):
            raise ValueError("found metadata without a period, or without the ports of every node; expected both")
        if not (out.periods.keys() <= out.roles.keys() and all(0.0 < own < math.inf for own in out.periods.values())):
            raise ValueError("found the period of an unknown node, or one that is not positive, in the metadata")
        if not all(type(name) is str and out.roles.get(name) is Role.COUPLING for name in out.linked):
            raise ValueError("found a wave link of another node than a coupling in the metadata; expected couplings")
        if any(type(name) is not str for names in (*out.ports.values(), out.masses) for name in names):
            raise ValueError("found a port or a mass that is no text in the metadata; expected names")
        things = () if out.scene is None else (*out.scene.things, *out.scene.obstacles)
        own = (thing.name for thing in things)
        names = (out.session, *out.roles, *out.masses, *chain.from_iterable(out.ports.values()), *own)
        for name in names:
            if not _NAME.fullmatch(name):
                raise ValueError(
                    f"found the name {name!r:.60} in the metadata; expected letters, digits, '_', '.', '-'"
                )
        for text in (out.certificate, out.clock, out.version):
            if len(text) > _LONGEST_TEXT or not text.isprintable():
                raise ValueError("found a long text, or one that is not printable, in the metadata; expected neither")
        try:
            out.scene_messages()
        except (ValueError, OverflowError) as error:
            raise ValueError("found a scene of other ports or bodies in the metadata; expected its own") from error
        return out


def _scene_in(texts: Mapping[str, str]) -> ContactScene | None:
    """The scene of a file's metadata; None without one.

    Raises:
        ValueError: it makes no sense.
    """
    if "scene" not in texts:
        return None
    try:
        return geometry_of(json.loads(texts["scene"]))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"found a scene that is none in the metadata ({error}); expected tools and bodies") from error


def recorded_of(about: About) -> Recorded:
    """The session of a recording, from the session's description."""
    return Recorded(
        session=about.session,
        certificate=about.id,
        period=about.period,
        clock=about.clock,
        roles={name: node.role for name, node in about.nodes.items()},
        ports={name: node.ports for name, node in about.nodes.items()},
        masses=tuple(about.masses),
        periods={name: node.period for name, node in about.nodes.items() if node.period is not None},
        linked=about.linked,
        scene=about.scene,
    )
