"""The format of a recording: the channels of its MCAP file, the form of their messages, and the session's metadata.

Each tick and topic has one JSON message, which every viewer of MCAP files can draw: the tick, its time since tick 0,
and the topic's row. Writer and readers both use this module; docs/files.md describes the format for people.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Annotated, Any, Final

from manyhands import __version__
from manyhands.design.models.scene import ContactScene
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.kernel.json_number import json_figures
from manyhands.nodes.monitor.session_state import GEOMETRY, PERIOD, About
from manyhands.nodes.recorder.engine_messages import EngineMessages
from manyhands.nodes.recorder.hand_messages import HandMessages
from manyhands.nodes.recorder.scene_messages import POSE, POSE_SCHEMA, SCENE_SCHEMAS, SceneMessages, SpaceMessages
from manyhands.nodes.rows.figures import FIGURES as DECLARED
from manyhands.nodes.rows.figures import WAVE_HOLDING
from manyhands.nodes.rows.units import unit_of_all
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic, hands_at, links_at, topic_name, topics_of
from manyhands.protocol.messages import Condition, Figures, PromiseStatus, Role
from manyhands.protocol.plain import Added, read, written

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

CARTESIAN: Final = 3
"""The number of axes of a device whose position is a point in space."""

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


def schema_of(topic: Topic, unit: str) -> tuple[str, str]:
    """Name and text of the JSON schema of a topic's messages, whose values have this unit."""
    one = topic.columns is Columns.ONE
    value = _NUMBER if one else {"type": "array", "items": _NUMBER}
    about = f"{topic.symbol}, {unit}{'' if one else ', in the order of the columns'}; null: not a finite number"
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
            "by_itself": {"type": "object", "properties": {}, "additionalProperties": _TEXTS},
            "visits": _TEXTS,
        },
    ),
    **SCENE_SCHEMAS,
    POSE: POSE_SCHEMA,
}
"""Names and texts of the schemas of the messages that belong to no topic of the table: figures, condition, and what
shows a scene, or how a hand has turned its device.
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
    plain = written(condition)
    # the schema allows no null
    rows = [{key: value for key, value in row.items() if value is not None} for row in plain["promises"]]
    return json.dumps({TICK: tick, **plain, "promises": rows}, ensure_ascii=False).encode()


def decode_condition(plain: Any) -> tuple[int, Condition]:
    """Tick and condition of a message that was read as JSON; keys of later versions are ignored.

    Raises:
        ValueError: the message holds no condition.
    """
    if not (isinstance(plain, dict) and type(plain.get(TICK)) is int and 0 <= plain[TICK] < 2**63):
        raise ValueError("found another object; expected tick and condition")
    own = _known(Condition, plain)
    if isinstance(rows := own.get("promises"), list):
        own["promises"] = [_known(PromiseStatus, row) for row in rows]
    return plain[TICK], read(Condition, own)


def _known(kind: type[Any], plain: Any) -> Any:
    """The keys of an object that are the fields of ``kind``; what is no object stays as it is."""
    names = {one.name for one in dataclasses.fields(kind)}
    return {key: value for key, value in plain.items() if key in names} if isinstance(plain, dict) else plain


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


_KEYS: Final[Mapping[str, str]] = {"version": "manyhands", "linked": "wave_links"}
"""The keys of a recording's metadata that are not named as the fields of :class:`Recorded`."""

_MAY_BE_EMPTY: Final = ("periods", "linked", "scene", "turning", "oriented", "drawing", "hands", "sensed")
"""The fields of which metadata have nothing where they are empty."""


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
        turning: the ports and masses that turn, whose columns are in rad and N·m.
        oriented: the bodies whose orientations the environment reports.
        drawing: what the world of an engine looks like; None for other worlds, and where no engine says it.
        hands: the devices whose orientation is a port, in the session's order.
        sensed: those of them that only sense it, and feel no torque.
    """

    session: str
    certificate: str
    period: Annotated[float, PERIOD]
    clock: str
    roles: Mapping[str, Role]
    ports: Mapping[str, tuple[str, ...]]
    masses: tuple[str, ...] = ()
    version: str = __version__
    periods: Added[Mapping[str, Annotated[float, PERIOD]]] = field(default_factory=dict)
    linked: Added[tuple[str, ...]] = ()
    scene: Added[Annotated[ContactScene | None, GEOMETRY]] = None
    turning: Added[tuple[str, ...]] = ()
    oriented: Added[tuple[str, ...]] = ()
    drawing: Added[WorldDrawing | None] = None
    hands: Added[tuple[str, ...]] = ()
    sensed: Added[tuple[str, ...]] = ()

    @property
    def devices(self) -> dict[str, tuple[str, ...]]:
        """The ports of each device, in the session's order."""
        return {name: self.ports[name] for name, role in self.roles.items() if role is Role.DEVICE}

    def topics(self, node: str) -> tuple[Topic, ...]:
        """The topics that a node has or may have, in the table's order; empty for an unknown node."""
        role = self.roles.get(node)
        wall = self.clock == REALTIME
        if role is None:
            return ()
        links, hands = bool(self.links_of(node)), hands_at(node, role, self.hands)
        own = self.masses, wall, links, wall
        return topics_of(role, *own, oriented=self.oriented, hands=hands, sensed=self.sensed)

    def columns(self, node: str, topic: Topic) -> tuple[str, ...]:
        """Names of the columns of a node's topic."""
        hands = hands_at(node, self.roles[node], self.hands)
        return topic.columns_of(self.ports[node], self.masses, self.links_of(node), self.oriented, hands)

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
        unit = unit_of_all(topic, self.columns(node, topic), self.turning)
        metadata |= {"symbol": topic.symbol, "unit": unit, "columns": columns}
        return ChannelAbout(topic_name(self.session, node, topic.name), *schema_of(topic, unit), metadata)

    def scene_messages(self) -> SpaceMessages | None:
        """What makes the messages that show the scene, or an engine's world; None without both.

        Raises:
            ValueError: its ports or bodies are not those of the environment.
        """
        if self.scene is None and self.drawing is None:
            return None
        (node,) = (name for name, role in self.roles.items() if role is Role.ENVIRONMENT)
        if self.drawing is not None:
            names = self.ports[node], self.masses, self.oriented
            hands = {hand: self.ports[hand] for hand in self.hands}
            return EngineMessages(self.drawing, self.session, node, *names, self.tick_ns(node), hands)
        if self.scene is None:
            return None
        return SceneMessages(self.scene, self.session, node, self.ports[node], self.masses, self.tick_ns(node))

    def space_messages(self) -> dict[str, SpaceMessages | HandMessages]:
        """What makes messages that are shown in space, by the node of whose traces they are made.

        Raises:
            ValueError: as :meth:`scene_messages`.
        """
        scene = self.scene_messages()
        frames = [] if self.drawing is None else [one for one in self.drawing.frames.values() if one.pivot is not None]
        own = {
            hand: [frame for frame in frames if {*frame.ports} == {*self.ports[hand]}]
            for hand in self.hands
            if len(self.ports[hand]) == CARTESIAN
        }
        hands = {
            hand: HandMessages(self.session, hand, self.ports[hand], self.tick_ns(hand), next(iter(found), None))
            for hand, found in own.items()
        }
        return {**hands, **({} if scene is None else {scene.node: scene})}

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
        plain = {name: value for name, value in written(self).items() if value or name not in _MAY_BE_EMPTY}
        texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in plain.items()}
        return {"format": FORMAT, "version": VERSION, **{_KEYS.get(name, name): texts[name] for name in texts}}

    @classmethod
    def from_metadata(cls, texts: Mapping[str, str]) -> Recorded:
        """The session of a file's metadata.

        Raises:
            ValueError: the metadata is not of this format and version, or makes no sense.
        """
        found = f"{texts.get('format', '')!r:.40} version {texts.get('version', '')!r:.40}"
        if (texts.get("format"), texts.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"found {found}; expected {FORMAT!r} version {VERSION!r}")
        fields = {_KEYS.get(one.name, one.name): one for one in dataclasses.fields(cls)}
        known = [(fields[key], text) for key, text in texts.items() if key in fields]
        try:
            out = read(cls, {one.name: text if one.type == "str" else json.loads(text) for one, text in known})
        except (ValueError, RecursionError) as error:
            raise ValueError(f"found metadata that make no sense ({error}); expected those of a recording") from error
        if not (out.roles.keys() == out.ports.keys() >= out.periods.keys() and out.devices):
            raise ValueError("found metadata without a device, or of unknown nodes; expected the ports of every node")
        if not all(out.roles.get(name) is Role.COUPLING for name in out.linked):
            raise ValueError("found a wave link of another node than a coupling in the metadata; expected couplings")
        things = () if out.scene is None else (*out.scene.things, *out.scene.obstacles)
        own = (thing.name for thing in things)
        for name in (
            out.session,
            *out.roles,
            *out.masses,
            *chain.from_iterable(out.ports.values()),
            *out.turning,
            *out.oriented,
            *out.hands,
            *out.sensed,
            *own,
        ):
            if not _NAME.fullmatch(name):
                raise ValueError(
                    f"found the name {name!r:.60} in the metadata; expected letters, digits, '_', '.', '-'"
                )
        for text in (out.certificate, out.clock, out.version):
            if len(text) > _LONGEST_TEXT or not text.isprintable():
                raise ValueError("found a long text, or one that is not printable, in the metadata; expected neither")
        if not all(out.roles.get(name) is Role.DEVICE for name in out.hands):
            raise ValueError("found a hand that is no device in the metadata; expected devices")
        try:
            out.scene_messages()
        except (ValueError, OverflowError) as error:
            raise ValueError("found a scene of other ports or bodies in the metadata; expected its own") from error
        return out


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
        turning=about.turning,
        oriented=about.oriented,
        drawing=about.drawing,
        hands=about.hands,
        sensed=about.sensed,
    )
