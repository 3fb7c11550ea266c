"""The scene of a session: tools and bodies in space, springs between them, obstacles, contacts with friction.

A device with one to three axes is one tool, under the device's own name. Positions are in m, in one frame for all. The
positions in the file are those at the start; everything starts at rest.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, ValidationInfo, model_validator

from manyhands.design.models.contacts import AXES, GROUND, Point, Surface, coordinates
from manyhands.design.models.declared import DeclaredScene
from manyhands.design.models.network import NetworkLink
from manyhands.design.models.scene import (
    BODY_SHAPES,
    MOST_DRIVE,
    MOST_OBSTACLES,
    MOST_POINTS,
    MOST_SAMPLES,
    SHAPES,
    STIFFEST,
    Body,
    ContactScene,
    Obstacle,
    SceneError,
    SceneHold,
    SceneLink,
    ToolSphere,
)
from manyhands.launch.session.device import BUTTON, Intent, ports_by_device
from manyhands.launch.session.errors import listed, one_of, show
from manyhands.launch.session.fields import (
    DAMPING,
    MASS,
    STIFFNESS,
    Described,
    FieldCheck,
    Items,
    NamedParts,
    Problem,
    Quantity,
    SessionModel,
    ValueCheck,
    defaulted,
    each,
    part_name,
    refuse,
    require_spring_or_damper,
)
from manyhands.launch.session.forms import JsonSchema, either, list_of, where
from manyhands.launch.session.kind import EnvironmentKind
from manyhands.launch.session.limits import MAX_LINKS, MOST_HOLDS
from manyhands.launch.session.motion import TraceData, plain_intent
from manyhands.nodes.kernel.intent import intent_from

_XYZ: Final = ("x", "y", "z")
TOUCH: Final = 1e-9  # m; a tool may touch at the start
_FARTHEST: Final = 1e3  # m; positions beyond it would lose the micrometres in which contacts are felt


def _vector(check: ValueCheck, what: str) -> Described:
    def of_three(value: object) -> Point:
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise refuse(show(value), f"{what} [x, y, z]")
        x, y, z = each(check, value)
        return x, y, z

    return Described(of_three, list_of(check.json_schema, 3, 3))


_COORDINATE: Final = Quantity("a coordinate", "m", least=-_FARTHEST, most=_FARTHEST)
_PLACE: Final = _vector(_COORDINATE, "a place")
_DIRECTION: Final = _vector(Quantity("a component", least=-_FARTHEST, most=_FARTHEST), "a direction")
_ACCELERATION: Final = _vector(Quantity("an acceleration", "m/s²", least=-100.0, most=100.0), "an acceleration")
_RADIUS: Final = Quantity("a radius", "m", least=0.0, most=_FARTHEST)
_ROUND: Final = Quantity("a radius", "m", above=0.0, most=_FARTHEST)
_CONTACT_STIFFNESS: Final = Quantity("a stiffness", "N/m", least=0.0, most=STIFFEST)
_SPRING: Final = Quantity("a stiffness", "N/m", above=0.0, most=STIFFEST)
_TANK: Final = Quantity("a tank", "J", least=0.0, most=MOST_DRIVE)
FRICTION: Final = Quantity("a coefficient of friction", least=0.0, most=10.0)

Place: TypeAlias = Annotated[tuple[float, float, float], _PLACE]
Radius: TypeAlias = Annotated[float, _RADIUS]


class SceneTool(SessionModel):
    """A point or a sphere that a device moves."""

    at: Place = Field(default=(0.0, 0.0, 0.0), description="where it is when all displacements are 0, in m: [x, y, z]")
    radius: Radius = Field(default=0.0, description="its radius in m; 0 for a point")


def _keys_by_shape(shapes: Collection[str], default: str = "", optional_keys: Collection[str] = ()) -> dict[str, Any]:
    """The part of the schema that gives each shape its keys; ``optional_keys`` are those of the default shape."""
    named = {shape: SHAPES[shape] for shape in shapes}
    return {
        "allOf": [
            {
                "if": where("shape", shape)
                if shape != default
                else {"not": where("shape", *(other for other in named if other != default))},
                "then": {
                    "required": [key for key in keys if shape != default or key not in optional_keys],
                    "properties": {key: False for others in named.values() for key in others if key not in keys},
                },
            }
            for shape, keys in named.items()
        ]
    }


def _two_places(value: object) -> tuple[Point, Point]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise refuse(show(value), "two places [[x, y, z], [x, y, z]]")
    a, b = each(_PLACE, value)
    return a, b


_ENDS: Final = Described(_two_places, list_of(_PLACE.json_schema, 2, 2))


_OptionalPlace: TypeAlias = Annotated[tuple[float, float, float] | None, _PLACE]


_OptionalEnds: TypeAlias = Annotated[tuple[tuple[float, float, float], tuple[float, float, float]] | None, _ENDS]


class ShapedThing(SessionModel):
    """What a body and an obstacle have in common: the keys of their shape, and no others."""

    _optional_keys: ClassVar[tuple[str, ...]] = ()

    shape: str
    at: _OptionalPlace = defaulted(None, "a point of a wall, or a sphere's centre, in m: [x, y, z]")
    low: _OptionalPlace = defaulted(None, "the corner of a room or a box with the least coordinates, in m: [x, y, z]")
    high: _OptionalPlace = defaulted(None, "the corner with the greatest coordinates, in m: [x, y, z]")
    ends: _OptionalEnds = defaulted(None, "the two ends of a capsule's axis, in m: [[x, y, z], [x, y, z]]")
    radius: Annotated[float | None, _ROUND] = defaulted(None, "the radius of a sphere or a capsule in m")

    @model_validator(mode="after")
    def _of_its_shape(self) -> Self:
        keys = SHAPES[self.shape]
        stated = {key for of_one in SHAPES.values() for key in of_one if getattr(self, key, None) is not None}
        needed = [key for key in keys if key not in self._optional_keys or self.shape != "sphere"]
        if missing := [key for key in needed if key not in stated]:
            raise refuse(f"a {self.shape} without {listed(missing)}", f"the keys {listed(needed)} for a {self.shape}")
        if other := sorted(stated.difference(keys)):
            raise refuse(
                f"{other[0]} of a {self.shape}", f"only the keys {listed(keys)} for a {self.shape}", (other[0],)
            )
        if self.low is not None and self.high is not None:
            for axis, low, high in zip(_XYZ, self.low, self.high, strict=True):
                if not low < high:
                    raise refuse(f"{low:g} m in low and {high:g} m in high along {axis}", "low below high", ("high",))
        return self


@dataclass(frozen=True, slots=True)
class _Motion(FieldCheck):
    """The check of a driven body's motion: x, y and z, each a number, a formula in t or a trace."""

    _axis: ClassVar[Quantity] = Quantity("a motion", "m")

    @property
    def json_schema(self) -> JsonSchema:
        """A list of three."""
        return list_of(Intent(self._axis, Path()).json_schema, 3, 3)

    def in_part(self, value: object, info: ValidationInfo) -> Any:
        """The three motions; the files of traces are in the folder of the session file."""
        if not isinstance(value, list | tuple) or len(value) != len(_XYZ):
            raise refuse(show(value), "a motion [x, y, z], each a number in m, a formula in t, or a trace")
        motions = each(Intent(self._axis, (info.context or {}).get("folder", Path())), value)
        for axis, motion in zip(_XYZ, motions, strict=True):
            start = intent_from(plain_intent(motion))(0.0)  # type: ignore[arg-type]  # what plain_intent returns
            if abs(start) > TOUCH:
                raise refuse(f"{start:g} m at t = 0 along {axis}", "0 m there: the body begins where it is put")
            if isinstance(motion, TraceData) and len(motion.times) > MOST_SAMPLES:
                raise refuse(f"a trace of {len(motion.times)} samples", f"at most {MOST_SAMPLES}")
        return motions


class SceneBody(ShapedThing):
    """A point, a sphere, a capsule or a box that moves freely or as it is driven, without turning."""

    model_config = ConfigDict(
        json_schema_extra={
            **_keys_by_shape(BODY_SHAPES, "sphere", ("radius",)),
            **either({"required": ["mass"]}, {"required": ["motion"]}),
        }
    )
    _optional_keys = ("radius",)

    mass: Annotated[float | None, MASS] = defaulted(None, "its mass in kg")
    motion: Annotated[tuple[float | str | TraceData, ...] | None, _Motion()] = defaulted(
        None, "its displacement in m, in place of a mass, where it is driven: [x, y, z]"
    )
    shape: Literal["sphere", "capsule", "box"] = Field(
        default="sphere", description="its shape: sphere, capsule or box"
    )
    at: _OptionalPlace = defaulted(None, "where a sphere's centre is at the start, in m: [x, y, z]")
    radius: Annotated[float | None, _RADIUS] = defaulted(
        None, "the radius of a sphere or a capsule in m; a sphere without it is a point"
    )

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.shape == "capsule" and self.radius == 0.0:
            raise refuse("0", f"{_ROUND.what} in m greater than 0", ("radius",))
        if (self.mass is None) == (self.motion is None):
            raise refuse(
                "neither a mass nor a motion" if self.mass is None else "a mass and a motion",
                "a mass in kg, or the motion of a driven body",
            )
        return self

    def body(self, name: str) -> Body:
        """The same as design has it."""
        least, most = self.ends or (self.low or self.at, self.high or self.at)
        if least is None or most is None:
            raise ValueError(f"found the body {name} without a place; expected one")
        (x, a), (y, b), (z, c) = zip(least, most, strict=True)
        at, half = ((x + a) / 2.0, (y + b) / 2.0, (z + c) / 2.0), ((a - x) / 2.0, (b - y) / 2.0, (c - z) / 2.0)
        motion = tuple(plain_intent(axis) for axis in self.motion or ())
        return Body(name, self.mass or 0.0, at, self.radius or 0.0, self.shape, half, motion)


class SceneObstacle(ShapedThing):
    """A thing that stands still: a wall or a room that things stay inside of, or a shape that they stay outside of."""

    model_config = ConfigDict(json_schema_extra=_keys_by_shape(SHAPES))

    shape: Literal["wall", "room", "box", "sphere", "capsule"] = Field(
        description="its shape: wall, room, box, sphere or capsule"
    )
    normal: Annotated[tuple[float, float, float] | None, _DIRECTION] = defaulted(
        None, "the direction from a wall to the side where things are: [x, y, z]"
    )

    @model_validator(mode="after")
    def _has_direction(self) -> Self:
        if self.normal is not None and not any(self.normal):
            raise refuse("the normal [0, 0, 0]", "a direction", at=("normal",))
        return self

    def obstacle(self, name: str) -> Obstacle:
        """The same as design has it."""
        given = {"wall": (self.at, self.normal), "sphere": (self.at,), "capsule": self.ends or ()}
        points = given.get(self.shape, (self.low, self.high))
        return Obstacle(name, self.shape, tuple(point for point in points if point is not None), self.radius or 0.0)


class SceneContact(SessionModel):
    """How things touch; with the stiffness 0 they do not."""

    stiffness: Annotated[float, _CONTACT_STIFFNESS] = Field(
        default=2000.0, description="the contact's stiffness in N/m, at most 1e6"
    )
    damping: Annotated[float, DAMPING] = Field(
        default=0.0, description="the damping of a contact along its normal in N·s/m"
    )
    friction: Annotated[float, FRICTION] = Field(default=0.0, description="the coefficient of Coulomb friction")

    @property
    def surface(self) -> Surface:
        """The same as design has it."""
        return Surface(self.stiffness, self.damping, self.friction)


def _two_names(value: object) -> tuple[str, str]:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(isinstance(end, str) for end in value):
        raise refuse(show(value), "two names [a, b]")
    if value[0] == value[1]:
        raise refuse(f"{show(value[0])} twice", "two different names")
    return value[0], value[1]


_BETWEEN: Final = Described(_two_names, list_of({"type": "string"}, 2, 2))


class ScenePair(SceneContact):
    """How two things touch that do not touch as all others do."""

    between: Annotated[tuple[str, str], _BETWEEN] = Field(
        description="the two things [a, b]: a tool or a body, and a tool, a body or an obstacle"
    )


class SceneSpring(SessionModel):
    """A spring and a damper in parallel between two tools or bodies, or one of them and the ground."""

    model_config = ConfigDict(json_schema_extra=either({"required": ["stiffness"]}, {"required": ["damping"]}))

    between: Annotated[tuple[str, str], _BETWEEN] = Field(
        description=f"the two ends [a, b], each a tool, a body or {GROUND}"
    )
    stiffness: Annotated[float, STIFFNESS] = Field(default=0.0, description="the stiffness in N/m")
    damping: Annotated[float, DAMPING] = Field(default=0.0, description="the damping in N·s/m")
    rest: _OptionalPlace = defaulted(
        None, "a less b where the spring has no force, in m: [x, y, z]; as at the start without it"
    )

    @model_validator(mode="after")
    def _has_spring_or_damper(self) -> Self:
        require_spring_or_damper(self.stiffness, self.damping)
        return self


class SceneHoldByButton(SessionModel):
    """A tool holds the nearest body while a button of its device is pressed."""

    tool: str = Field(description="the tool, by its device's name")
    button: Annotated[str, BUTTON] = Field(description="the button of that device, by its name")
    stiffness: Annotated[float, _SPRING] = Field(description="the stiffness in N/m of the spring that holds the body")
    damping: Annotated[float, DAMPING] = Field(default=0.0, description="the damping in N·s/m beside it")
    within: Annotated[float, _RADIUS] = Field(
        default=0.0, description="the greatest gap in m at which it takes hold; 0 for what the tool touches"
    )

    @property
    def hold(self) -> SceneHold:
        """The same as design has it."""
        return SceneHold(self.tool, f"{self.tool}.{self.button}", self.stiffness, self.damping, self.within)


def _axes_of(ports: list[str]) -> tuple[int, ...]:
    """The axis along which each of a device's ports moves its tool: by their names, else x, y and z in order."""
    names = [port.partition(".")[2] for port in ports]
    return tuple(_XYZ.index(name) for name in names) if set(names) <= {*_XYZ} else tuple(range(len(ports)))


def tool_problems(tools: Mapping[str, SceneTool], ports: tuple[str, ...]) -> Iterator[Problem]:
    """The problems of the tools' names in a session with these ports: each device has one, with one to three axes."""
    devices = ports_by_device(ports)
    for name in devices:
        if name not in tools:
            yield Problem(("tools",), f"no tool for the device {name!r}", "one tool for each device, by its name")
    for name in tools:
        if name not in devices:
            yield Problem(("tools", name), f"the name {name!r}", one_of(tuple(devices), name))
        elif len(devices[name]) > len(_XYZ):
            found = f"a device with {len(devices[name])} axes"
            yield Problem(("tools", name), found, "a device with one to three axes")


def tool_spheres(tools: Mapping[str, SceneTool], ports: tuple[str, ...]) -> tuple[ToolSphere, ...]:
    """The tools as design has them, in a session with these ports and without :func:`tool_problems`."""
    devices = ports_by_device(ports)
    index = {port: i for i, port in enumerate(ports)}
    return tuple(
        ToolSphere(name, tuple(index[port] for port in devices[name]), _axes_of(devices[name]), tool.at, tool.radius)
        for name, tool in tools.items()
    )


class SceneEnvironment(EnvironmentKind):
    """Tools, bodies and obstacles in space, with springs, gravity, contacts and friction."""

    turns: ClassVar[bool] = False

    type: Literal["scene"] = Field(description="the kind of environment: scene")
    tools: Annotated[dict[str, SceneTool], NamedParts(part_name("a device's name"), MOST_POINTS)] = Field(
        description="the tool of each device, by the device's name"
    )
    bodies: Annotated[dict[str, SceneBody], NamedParts(part_name("a body's name"), MOST_POINTS, least=0)] = Field(
        default={}, description="the bodies that move freely or are driven, by name"
    )
    obstacles: Annotated[
        dict[str, SceneObstacle], NamedParts(part_name("an obstacle's name"), MOST_OBSTACLES, least=0)
    ] = Field(default={}, description="the things that stand still, by name")
    links: Annotated[tuple[SceneSpring, ...], Items("links", MAX_LINKS, least=0)] = Field(
        default=(), description="the springs and dampers; things that one joins do not touch each other"
    )
    contact: SceneContact = Field(default=SceneContact(), description="how all things touch")
    contacts: Annotated[tuple[ScenePair, ...], Items("contacts", MAX_LINKS, least=0)] = Field(
        default=(), description="how pairs of things touch that do not touch as all others do"
    )
    gravity: Annotated[tuple[float, float, float], _ACCELERATION] = Field(
        default=(0.0, 0.0, 0.0), description="the acceleration of free bodies in m/s²: [x, y, z]"
    )
    tank: Annotated[float, _TANK] = Field(
        default=0.0, description="the energy in J that the driven bodies together may give out"
    )
    holds: Annotated[tuple[SceneHoldByButton, ...], Items("holds", MOST_HOLDS, least=0)] = Field(
        default=(), description="which button of a tool's device holds the body that the tool touches"
    )
    enforce: ClassVar[bool] = True

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of the scene in a session with these ports."""
        basic = list(self._names(ports))
        yield from basic or self._beginning(ports)

    def _names(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of names and numbers."""
        yield from tool_problems(self.tools, ports)
        movable = (*self.tools, *self.bodies)
        if len(movable) > MOST_POINTS:
            yield Problem(("bodies",), f"{len(movable)} tools and bodies", f"at most {MOST_POINTS}")
        for kind, taken in (("bodies", self.tools), ("obstacles", {**self.tools, **self.bodies})):
            for name in getattr(self, kind):
                if name in taken or name == GROUND:
                    owner = "the ground" if name == GROUND else "a different thing"
                    yield Problem((kind, name), f"the name {name!r} of {owner}", "a name of its own")
        for key, ends in (("links", (*movable, GROUND)), ("contacts", (*movable, *self.obstacles))):
            for index, pair in enumerate(getattr(self, key)):
                for position, end in enumerate(pair.between):
                    if end not in ends:
                        yield Problem(
                            (key, index, "between", position), f"the unknown end {show(end)}", one_of(ends, end)
                        )
        if self.tank and not any(body.motion for body in self.bodies.values()):
            yield Problem(("tank",), "a tank, and no body with a motion", "a driven body, or no tank")
        for index, hold in enumerate(self.holds):
            if hold.tool not in self.tools:
                yield Problem(("holds", index, "tool"), f"the name {hold.tool!r}", one_of(tuple(self.tools), hold.tool))
        for index, contact in enumerate(self.contacts):
            if all(end in self.obstacles for end in contact.between):
                yield Problem(("contacts", index, "between"), "two obstacles", "a tool or a body at one of the ends")

    def _beginning(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of what stands where: bodies that fall, shapes, pairs, and tools inside other things."""
        try:
            scene = self.scene(ports)
            contacts, _ = scene.contacts, scene.graspable
        except SceneError as error:
            yield Problem(("bodies", error.body) if error.body else ("bodies",), error.found, error.expected)
            return
        for pair, gap in zip(contacts.pairs, contacts.gaps(scene.points)[0].tolist(), strict=True):
            for name in {*pair.names} & {*self.tools} if gap < -TOUCH else ():
                (other,) = {*pair.names} - {name}
                found = f"a tool that begins {-1e3 * gap:.3g} mm inside {other!r}"
                yield Problem(("tools", name), found, f"a place outside, or a contact of stiffness 0 with {other!r}")

    def scene(self, ports: tuple[str, ...]) -> ContactScene:
        """The same as design has it, in a session with these ports.

        Raises:
            SceneError: gravity, a pair of shapes or the number of pairs makes no scene that could run.
            ValueError: the scene has one of the other problems that :meth:`problems` reports.
        """
        return ContactScene(
            ports,
            tools=tool_spheres(self.tools, ports),
            bodies=tuple(body.body(name) for name, body in self.bodies.items()),
            obstacles=tuple(thing.obstacle(name) for name, thing in self.obstacles.items()),
            links=tuple(SceneLink(link.between, link.stiffness, link.damping, link.rest) for link in self.links),
            surface=self.contact.surface,
            surfaces=tuple((pair.between, pair.surface) for pair in self.contacts),
            gravity=self.gravity,
            tank=self.tank,
            holds=tuple(hold.hold for hold in self.holds),
        )

    @property
    def buttons(self) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
        """Those that hold bodies."""
        for index, hold in enumerate(self.holds):
            yield ("holds", index, "button"), hold.tool, hold.button

    def for_design(self, ports: tuple[str, ...]) -> DeclaredScene:
        """The scene, at the level 0."""
        return DeclaredScene(self.scene(ports))

    def reported(self, ports: tuple[str, ...]) -> tuple[str, ...]:
        """x, y and z of each body."""
        return tuple(name for body in self.bodies for name in coordinates(body))

    def masses_and_springs(self, ports: tuple[str, ...]) -> tuple[dict[str, float], tuple[NetworkLink, ...]]:
        """The bodies, and the springs, one for each coordinate."""
        scene = self.scene(ports)
        moved = [
            (tool.name, axis, port) for tool in scene.tools for axis, port in zip(tool.axes, tool.ports, strict=True)
        ]
        at = {(name, AXES[axis]): ports[port] for name, axis, port in moved}
        at |= {
            (body.name, axis): name
            for body in scene.bodies
            for axis, name in zip(AXES, coordinates(body.name), strict=True)
        }
        at |= {(GROUND, axis): GROUND for axis in AXES}
        springs = (
            NetworkLink((at[link.ends[0], axis], at[link.ends[1], axis]), link.stiffness, link.damping)
            for link in scene.links
            for axis in AXES
            if all((end, axis) in at for end in link.ends)
        )
        return {name: body.mass for body in scene.bodies for name in coordinates(body.name)}, tuple(springs)

    def geometry(self, ports: tuple[str, ...]) -> ContactScene:
        """Tools, bodies and obstacles."""
        return self.scene(ports).geometry
