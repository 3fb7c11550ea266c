"""The virtual environment of a session: masses and springs; a scene; a mesh; matrices; rational functions; or a model.

Every kind maps the displacements (m) of the session's ports to forces (N), one for each port. The key ``type`` names
the kind, and the kind determines the other keys. With ``enforce``, a passivity controller keeps the environment's level
at run time. :data:`KINDS`, at the end, has one line for each kind.

A session file only names a Python model. The environment's process alone imports it; reading, designing and proving a
session run none of its code.
"""

import hashlib
import json
import re
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self, TypeAlias, Union

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from manyhands.design.files import read_regular
from manyhands.design.models import environment as designed
from manyhands.design.models.contacts import GROUND, coordinates
from manyhands.design.models.declared import DeclaredEnvironment, ProxyEnvironment
from manyhands.design.models.distance_grid import MOST_BAND, grid_of_text
from manyhands.design.models.network import Network, NetworkLink, scales
from manyhands.design.models.scene import MOST_DRIVE, MOST_POINTS, ContactScene, Obstacle
from manyhands.launch.session.assets import ASSETS, model_assets, model_text, text_in
from manyhands.launch.session.design import OneOrMany, full_matrix, one_or_many
from manyhands.launch.session.device import ports_by_device
from manyhands.launch.session.errors import listed, one_of, show
from manyhands.launch.session.fields import (
    Completed,
    Described,
    Interval,
    Items,
    NamedParts,
    Problem,
    Quantity,
    SessionModel,
    UncertainDamping,
    UncertainInertia,
    UncertainMass,
    UncertainStiffness,
    Whole,
    defaulted,
    each_named,
    part_name,
    problems_in,
    refusal,
    refuse,
    require_spring_or_damper,
    unsymmetric,
)
from manyhands.launch.session.foreign import PARAMETERS, Factory
from manyhands.launch.session.forms import either, list_of, where, without
from manyhands.launch.session.kind import ENFORCE_MEANING, NO_HANDS, Enforce, EnvironmentKind
from manyhands.launch.session.limits import (
    MAX_BODIES,
    MAX_DELAY,
    MAX_DOF,
    MAX_ENVIRONMENT_ORDER,
    MAX_LINKS,
    MAX_MASSES,
    MAX_MODEL_BYTES,
    MAX_PORTS,
    MAX_STIFFNESS,
    MIN_POSITIVE,
)
from manyhands.launch.session.matrices import (
    D_OR_STATIC,
    STATIC_MEANING,
    Entry,
    MatrixRows,
    OptionalRows,
    Rational,
    one_of_two,
    size_problems,
    stated_system,
)
from manyhands.launch.session.scene import FRICTION, TOUCH, SceneEnvironment, SceneTool, tool_problems, tool_spheres
from manyhands.nodes.environment.mesh import Lookup
from manyhands.nodes.kernel.factory import ENGINES, MESH, MODELS, is_shipped
from manyhands.nodes.kernel.words import counted

_LEVEL: Final = Quantity("a level", "N·s/m")
_STIFFNESS: Final = Quantity("a stiffness", "N/m", magnitude=MAX_STIFFNESS)
_SPRING: Final = Quantity("a stiffness", "N/m", above=0.0, most=MAX_STIFFNESS)
_TANK: Final = Quantity("a tank", "J", least=0.0, most=MOST_DRIVE)
_STIFFNESS_MEANING: Final = (
    "the stiffness of the springs to the model's proxies in N/m: a number, one for each port, or a matrix"
)


class ModelEnvironment(EnvironmentKind):
    """An environment that a user's model computes tick by tick; the design uses its declared level alone."""

    type: str
    model: str
    stiffness: OneOrMany | None = None
    tank: Annotated[float, _TANK] = Field(
        default=0.0, description="the energy in J that a world with proxies may give out beyond what it has received"
    )
    level: Annotated[OneOrMany, one_or_many(_LEVEL)] = Field(
        default=0.0,
        description="the declared level Phi_E in N·s/m: a number, one for each port, or a matrix; 0 with a stiffness",
    )
    enforce: Enforce = Field(default=True, description=ENFORCE_MEANING)

    def hardest(self, ports: tuple[str, ...]) -> dict[str, float]:
        """The springs to the proxies, for what these rest on does not give way; none of a model of forces."""
        if self.stiffness is None:
            return {}
        return dict(zip(ports, np.diag(full_matrix(self.stiffness, len(ports))).tolist(), strict=True))

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of level and stiffness in a session with these ports."""
        level_problems = [*_size_problems("level", self.level, ports)]
        yield from level_problems
        if self.stiffness is None:
            if self.tank:
                yield Problem(
                    ("tank",), f"{self.tank:g}", "0 for a model that returns forces, or a stiffness of proxies"
                )
            return
        stiffness_problems = [*_size_problems("stiffness", self.stiffness, ports)]
        yield from stiffness_problems
        m = len(ports)
        if not stiffness_problems and not np.linalg.eigvalsh(full_matrix(self.stiffness, m))[0] > 0.0:
            yield Problem(("stiffness",), show(self.stiffness), "a positive definite matrix, or numbers above 0")
        if not level_problems and np.linalg.eigvalsh(full_matrix(self.level, m))[0] < 0.0:
            yield Problem(("level",), show(self.level), "no negative eigenvalue where the model proposes proxies")

    def for_design(self, ports: tuple[str, ...]) -> DeclaredEnvironment:
        """The declared level; with a stiffness, springs to the proxies that the model proposes."""
        level = full_matrix(self.level, len(ports))
        if self.stiffness is None:
            return DeclaredEnvironment(ports, level, self.enforce)
        K = full_matrix(self.stiffness, len(ports))
        return ProxyEnvironment(ports, level, K, self.content(ports), self.tank)

    @abstractmethod
    def code(
        self, ports: tuple[str, ...], turning: Collection[str] = (), hands: Mapping[str, float] = NO_HANDS
    ) -> tuple[str, dict[str, Any]]:
        """The factory that makes the model or the engine, and its parameters; arguments as of the kind's."""

    def content(self, ports: tuple[str, ...]) -> str | None:
        """SHA-256 of its data; None for a user's own code."""
        return None


class PythonEnvironment(ModelEnvironment):
    """A model in Python that is asked tick by tick.

    With a stiffness the model proposes proxies, and springs of that stiffness exert the forces. Without, the model
    computes forces, and declares the level.
    """

    model_config = ConfigDict(json_schema_extra=either({"required": ["stiffness"]}, {"required": ["level"]}))

    type: Literal["python"] = Field(description="the kind of environment: python")
    model: Annotated[str, Factory(MODELS)] = Field(description="the model's factory, package.module:factory")
    stiffness: Annotated[OneOrMany | None, one_or_many(_STIFFNESS)] = defaulted(None, _STIFFNESS_MEANING)
    parameters: Annotated[dict[str, Any], PARAMETERS] = Field(
        default={}, description="plain data, handed to the factory"
    )

    @model_validator(mode="after")
    def _level_or_stiffness(self) -> Self:
        if self.stiffness is None and "level" not in self.model_fields_set:
            expected = "level, the declared level in N·s/m, or stiffness, for a model that proposes proxies"
            raise refuse("neither level nor stiffness", expected)
        return self

    def code(
        self, ports: tuple[str, ...], turning: Collection[str] = (), hands: Mapping[str, float] = NO_HANDS
    ) -> tuple[str, dict[str, Any]]:
        """The model's factory and the session's parameters."""
        return self.model, self.parameters


def _grid_text(value: object, info: ValidationInfo) -> str:
    """The text of a distance grid, from a path relative to the session file; or the text itself, with line ends."""
    folder: Path = (info.context or {}).get("folder", Path())

    def read(name: str) -> bytes:
        try:
            return read_regular(folder / name, MAX_MODEL_BYTES)
        except (OSError, ValueError) as error:
            raise refuse(f"{name!r}, which cannot be read: {error}", "a text file beside the session file") from error

    text = text_in(value, "the path of a distance grid, as manyhands mesh writes it, or its text", read)
    try:
        grid_of_text(text)
    except ValueError as error:
        found, _, expected = str(error).partition("; expected ")
        raise refuse(found.removeprefix("found "), expected) from error
    return text


def _joints(value: object) -> tuple[str, ...]:
    names = value if isinstance(value, list | tuple) else (value,)
    if not 1 <= len(names) <= MAX_DOF or not all(
        isinstance(name, str) and _MODEL_NAME.fullmatch(name) for name in names
    ):
        raise refuse(show(value), "a name in the model for each axis of the device")
    return tuple(names)


def _tools(value: object) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, Mapping) or not value or not all(isinstance(key, str) for key in value):
        raise refuse(show(value), "a mapping from devices to names in the model")
    return {key: _joints(names) for key, names in value.items()}


def _bodies(value: object) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or len(value) > MAX_BODIES or len({*map(str, value)}) < len(value):
        raise refuse(show(value), f"a list of at most {MAX_BODIES} different bodies of the model")
    return _joints(value) if value else ()


def _avatars(value: object) -> dict[str, str]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise refuse(show(value), "a mapping from devices to names in the model")
    return {key: _joints(name)[0] for key, name in value.items()}


_AVATARS: Final = {"type": "object", "additionalProperties": {"type": "string"}}
_MODEL_NAME: Final = re.compile(r"[\w.-]{1,100}")
_NAMES: Final = either({"type": "string"}, list_of({"type": "string"}, MAX_DOF))


class EngineEnvironment(ModelEnvironment):
    """A physics engine with a model file: the tools are joined by springs to avatars, bodies of the engine."""

    type: Literal["engine"] = Field(description="the kind of environment: engine")
    model: Annotated[str, Completed(model_text, {"type": "string"})] = Field(
        description="the model's file, by its name in the session file's folder, or its text"
    )
    stiffness: Annotated[OneOrMany, one_or_many(_STIFFNESS)] = Field(description=_STIFFNESS_MEANING)
    engine: Annotated[str, Factory(ENGINES)] = Field(
        description="the engine: mujoco, a published short name, or package.module:factory"
    )
    tools: Annotated[
        dict[str, tuple[str, ...]],
        Described(_tools, {"type": "object", "additionalProperties": _NAMES}),
    ] = Field(
        description="by device, the name of each of its axes in the model; for mujoco, of a slide joint, or of a hinge "
        "joint where the axis turns"
    )
    bodies: Annotated[tuple[str, ...], Described(_bodies, list_of({"type": "string"}, MAX_BODIES, 0))] = Field(
        default=(), description="the bodies of the model whose positions are reported"
    )
    orientations: Annotated[tuple[str, ...], Described(_bodies, list_of({"type": "string"}, MAX_BODIES, 0))] = Field(
        default=(),
        description="those of the bodies whose orientations are reported, too, so that they are seen to turn",
    )
    avatars: Annotated[dict[str, str], Described(_avatars, _AVATARS)] = Field(
        default={},
        description="by device whose orientation is a port, what turns its tool in the model; for mujoco a ball joint",
    )
    assets: Annotated[dict[str, str], Completed(model_assets, ASSETS)] = Field(
        default={}, description="the files that the model names, by their names in the session file's folder"
    )

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of level, stiffness and tools in a session with these ports."""
        yield from super().problems(ports)
        devices = ports_by_device(ports)
        for device, names in self.tools.items():
            own = devices.get(device, [])
            if len(own) != len(names):
                expected = f"{counted(len(own), 'name')}, one for each of its axes" if own else "the name of a device"
                yield Problem(("tools", device), show(names) if own else show(device), expected)
        for name in self.orientations:
            if name not in self.bodies:
                yield Problem(
                    ("orientations",), show(name), f"some of the bodies: {listed(self.bodies) or 'here none'}"
                )
        missing = [port for device, own in devices.items() if device not in self.tools for port in own]
        if missing:
            yield Problem(("tools",), f"no name for {listed(missing)}", "one for each axis of every device")

    def code(
        self, ports: tuple[str, ...], turning: Collection[str] = (), hands: Mapping[str, float] = NO_HANDS
    ) -> tuple[str, dict[str, Any]]:
        """The engine's factory, with the model's text, the names of the ports in it, the bodies and the stiffness."""
        by_port = {
            port: name
            for device, own in ports_by_device(ports).items()
            for port, name in zip(own, self.tools[device], strict=True)
        }
        K = np.abs(full_matrix(self.stiffness, len(ports))).sum(axis=1)
        return self.engine, {
            "model": self.model,
            "assets": self.assets,
            "tools": [by_port[port] for port in ports],
            "turning": [port for port in ports if port in turning],
            "bodies": [*self.bodies],
            "orientations": [*self.orientations],
            "stiffness": K.tolist(),
            **(self._turned_by(hands) if hands else {}),
        }

    def _turned_by(self, hands: Mapping[str, float]) -> dict[str, Any]:
        return {"avatars": [self.avatars[hand] for hand in hands], "avatar_stiffness": [*hands.values()]}

    @property
    def turned(self) -> tuple[str, ...]:
        """Those that have an avatar."""
        return tuple(self.avatars)

    @property
    def tried_first(self) -> bool:
        """With an engine of this package."""
        return is_shipped(self.engine)

    @property
    def oriented(self) -> tuple[str, ...]:
        """Those that the session lists."""
        return self.orientations

    def reported(self, ports: tuple[str, ...]) -> tuple[str, ...]:
        """x, y and z of each body."""
        return tuple(name for body in self.bodies for name in coordinates(body))


class MeshEnvironment(ModelEnvironment):
    """A solid that stands still, by its signed distances on a grid, touched by tools with Coulomb friction.

    The tools are joined by springs to proxies on its surface.
    """

    turns: ClassVar[bool] = False

    type: Literal["mesh"] = Field(description="the kind of environment: mesh")
    model: Annotated[str, Completed(_grid_text, {"type": "string"})] = Field(
        description="the distance grid that manyhands mesh has made, relative to the session file, or its text"
    )
    stiffness: Annotated[float, _SPRING] = Field(description="the stiffness of the springs to the proxies in N/m")
    friction: Annotated[float, FRICTION] = Field(default=0.0, description="the coefficient of Coulomb friction")
    tools: Annotated[dict[str, SceneTool], NamedParts(part_name("a device's name"), MOST_POINTS)] = Field(
        description="the tool of each device, by the device's name"
    )

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of level and tools in a session with these ports."""
        yield from super().problems(ports)
        of_names = [*tool_problems(self.tools, ports)]
        yield from of_names
        grid = grid_of_text(self.model)
        distance = Lookup(grid)
        for name, tool in {} if of_names else self.tools.items():
            if tool.radius > grid.largest_radius:
                band = grid.band_for(tool.radius)
                wider = f"manyhands mesh --band {band}" if band <= MOST_BAND else "larger cells"
                expected = f"at most {grid.largest_radius:g}, or a grid of {wider}"
                yield Problem(("tools", name, "radius"), f"{tool.radius:g}", expected)
            elif (gap := distance(tool.at)[0] - tool.radius) < -TOUCH:
                yield Problem(
                    ("tools", name), f"a tool that begins {-1e3 * gap:.3g} mm inside the mesh", "a place outside"
                )

    def code(
        self, ports: tuple[str, ...], turning: Collection[str] = (), hands: Mapping[str, float] = NO_HANDS
    ) -> tuple[str, dict[str, Any]]:
        """The proxies of this package, with grid, friction and tools."""
        tools = [
            {
                "ports": [ports[port] for port in tool.ports],
                "axes": [*tool.axes],
                "at": [*tool.at],
                "radius": tool.radius,
            }
            for tool in tool_spheres(self.tools, ports)
        ]
        return MESH, {"grid": self.model, "friction": self.friction, "tools": tools}

    def content(self, ports: tuple[str, ...]) -> str:
        """SHA-256 over the grid's digest, friction and tools, as JSON with sorted keys."""
        _, parameters = self.code(ports)
        parameters["grid"] = grid_of_text(self.model).digest
        return hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()

    def geometry(self, ports: tuple[str, ...]) -> ContactScene:
        """The tools, and the mesh as an obstacle, for drawing."""
        surface = grid_of_text(self.model).surface
        x, y, z = surface.vertices.T.tolist()
        i, j, k = surface.triangles.T.tolist()
        mesh = Obstacle("mesh", "mesh", tuple(zip(x, y, z, strict=True)), triangles=tuple(zip(i, j, k, strict=True)))
        return ContactScene(ports, tools=tool_spheres(self.tools, ports), obstacles=(mesh,))


def _size_problems(key: str, value: OneOrMany, ports: tuple[str, ...]) -> Iterator[Problem]:
    """A problem where a value is no number, list or symmetric matrix for these ports."""
    m = len(ports)
    rows = value if isinstance(value, tuple) else (value,) * m
    if len(rows) != m or any(isinstance(row, tuple) and len(row) != m for row in rows):
        expected = f"a number, {counted(m, 'number')}, or {counted(m, 'row')} of {m}, for the ports {listed(ports)}"
        yield Problem((key,), show(value), expected)
    elif isinstance(rows[0], tuple):
        matrix: Any = rows
        if problem := unsymmetric(matrix):
            yield problem._replace(at=(key, *problem.at))


Delay: TypeAlias = Annotated[int, Whole("ticks", 0, MAX_DELAY)]


def _two_ends(value: object) -> tuple[str, str]:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(isinstance(end, str) for end in value):
        raise refuse(show(value), f"two ends [a, b], each a port, a mass or {GROUND}")
    if value[0] == value[1]:
        raise refuse(f"a link from {show(value[0])} to itself", "two different ends")
    return value[0], value[1]


_ARM: Final = Quantity("a lever arm", "m/rad", above=0.0, smallest=MIN_POSITIVE)
_LEVERS: Final = {"type": "object", "additionalProperties": _ARM.json_schema, "minProperties": 1, "maxProperties": 2}


def _levers(value: object) -> dict[str, float]:
    """Lever arms by end."""
    if not isinstance(value, Mapping) or not value:
        raise refuse(show(value), "{END: ARM} for each end that turns, in m/rad")
    return each_named(_ARM, value)


_TWO_ENDS: Final = Described(_two_ends, list_of({"type": "string"}, 2, 2))


class SessionLink(SessionModel):
    """A spring and a damper in parallel between two ends: ports, masses or the ground."""

    model_config = ConfigDict(json_schema_extra=either({"required": ["stiffness"]}, {"required": ["damping"]}))

    between: Annotated[tuple[str, str], _TWO_ENDS] = Field(
        description=f"the two ends [a, b], each a port, a mass or {GROUND}"
    )
    stiffness: UncertainStiffness = Field(
        default=0.0, description="the stiffness in N/m, or an interval; N·m/rad where ends turn without a lever"
    )
    damping: UncertainDamping = Field(
        default=0.0, description="the damping in N·s/m, or an interval; N·m·s/rad where ends turn without a lever"
    )
    lever: Annotated[dict[str, float] | None, Described(_levers, _LEVERS)] = Field(
        default=None, description="the lever arm of each end that turns, m/rad: the link is in N/m then"
    )

    @model_validator(mode="after")
    def _has_spring_or_damper(self) -> Self:
        require_spring_or_damper(self.stiffness, self.damping)
        return self

    @property
    def arms(self) -> tuple[float, float]:
        """By end, its lever arm, or 1."""
        a, b = (1.0 if self.lever is None else self.lever.get(end, 1.0) for end in self.between)
        return a, b

    def turning_problems(self, turning: Collection[str]) -> Iterator[Problem]:
        """What is wrong with its lever arms where these ports and masses turn."""
        ends = [end for end in self.between if end != GROUND]
        turn = [end for end in ends if end in turning]
        for end in self.lever or ():
            if end not in turn:
                found = "the ground" if end == GROUND else f"{show(end)}, which is no end of it or does not turn"
                yield Problem(("lever", end), found, f"an end that turns: {listed(turn) or 'here none does'}")
        lacking = [end for end in turn if end not in (self.lever or {})]
        if lacking and (self.lever or len(turn) < len(ends)):
            found = f"no lever arm of {show(lacking[0])}, which turns, beside an end with one or that translates"
            yield Problem((), found, f"lever: {{{lacking[0]}: m/rad}}: a torque is the arm times the force")


class NetworkEnvironment(EnvironmentKind):
    """Masses joined with ports and ground by springs and dampers, discretised by backward Euler."""

    in_series: ClassVar[bool] = True

    type: Literal["network"] = Field(description="the kind of environment: network")
    masses: Annotated[dict[str, UncertainMass], NamedParts(part_name("a mass name"), MAX_MASSES, least=0)] = Field(
        default={}, description="the masses in kg, or intervals, by name"
    )
    inertias: Annotated[
        dict[str, UncertainInertia], NamedParts(part_name("an inertia's name"), MAX_MASSES, least=0)
    ] = Field(default={}, description="the inertias of what turns in kg·m², or intervals, by name")
    links: Annotated[tuple[SessionLink, ...], Items("links", MAX_LINKS)] = Field(description="the springs and dampers")
    delay: Delay = Field(default=0, description="whole ticks by which its forces are late")
    enforce: Enforce = Field(default=False, description=ENFORCE_MEANING)

    @property
    def uncertain(self) -> bool:
        """Whether any mass, stiffness or damping is an interval."""
        parameters = [*self._bodies.values(), *(v for link in self.links for v in (link.stiffness, link.damping))]
        return any(isinstance(value, Interval) for value in parameters)

    @property
    def _bodies(self) -> dict[str, float | Interval]:
        """Masses, and then inertias."""
        return {**self.masses, **self.inertias}

    @property
    def turning(self) -> tuple[str, ...]:
        """The inertias."""
        return tuple(self.inertias)

    def turning_problems(self, ports: tuple[str, ...], turning: Collection[str]) -> Iterator[Problem]:
        """The problems of lever arms where these ports turn."""
        turn, found = {*turning, *self.inertias}, not any(link.lever for link in self.links)
        for index, link in enumerate(self.links):
            for problem in link.turning_problems(turn):
                found = True
                yield problem._replace(at=("links", index, *problem.at))
        if not found:  # otherwise nothing contradicts itself
            try:
                scales([NetworkLink(link.between, 1.0, 0.0, link.arms) for link in self.links])
            except ValueError as error:
                text = str(error).removeprefix("lever arms: found ").partition("; expected ")
                yield Problem(("links",), text[0], text[2])

    @model_validator(mode="after")
    def _late_or_uncertain(self) -> Self:
        if self.delay and self.uncertain:
            # the network's energy proves a whole box of parameters; a late force is not covered by that energy
            expected = "delay: 0 where a mass, stiffness or damping is an interval"
            raise refuse(f"a delay of {self.delay} with intervals", expected, at=("delay",))
        return self

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of masses and links in a session with these ports."""
        taken = frozenset(ports)
        for key, names in (("masses", self.masses), ("inertias", self.inertias)):
            for name in names:
                if name in taken or name == GROUND:
                    owner = "the ground" if name == GROUND else "a port"
                    expected = f"a name that no port has, other than {GROUND}"
                    yield Problem((key, name), f"the name {name!r} of {owner}", expected)
                elif key == "inertias" and name in self.masses:
                    yield Problem((key, name), f"the name {name!r} of a mass", "a name that no mass has")
        valid = (*ports, *self._bodies, GROUND)
        known = frozenset(valid)
        dangling = False
        attached = {end for link in self.links for end in link.between}
        for index, link in enumerate(self.links):
            for position, end in enumerate(link.between):
                if end not in known:
                    dangling = True
                    place = ("links", index, "between", position)
                    axes = [port for port in ports if port.startswith(f"{end}.")]
                    own = counted(len(axes), "axis", "axes")
                    each = f"{', '.join(axes)}: the device {end} has {own}, and a link for each"
                    yield Problem(place, f"the unknown end {show(end)}", each if axes else one_of(valid, end))
        for port in ports:
            if port not in attached and not dangling:
                yield Problem(("links",), f"no link to the port {port!r}", "at least one link to every port")
        for key, what, names in (("masses", "a mass", self.masses), ("inertias", "an inertia", self.inertias)):
            for name in names:
                if name not in attached and not dangling:
                    yield Problem(
                        (key, name), f"{what} without a link", f"at least one link to every {what.split()[1]}"
                    )

    def for_design(self, ports: tuple[str, ...]) -> Network | designed.DelayedNetwork | designed.NetworkBox:
        """The network, or with intervals every network between two."""
        low = self._at(ports, high=False)
        if self.uncertain:
            return designed.NetworkBox(low, self._at(ports, high=True))
        return designed.DelayedNetwork(low, self.delay) if self.delay else low

    def _at(self, ports: tuple[str, ...], *, high: bool) -> Network:
        """The network with every interval at one of its ends."""

        def end(value: float | Interval) -> float:
            interval = Interval.of(value)
            return interval.high if high else interval.low

        return Network(
            ports,
            tuple((name, end(mass)) for name, mass in self._bodies.items()),
            tuple(NetworkLink(link.between, end(link.stiffness), end(link.damping), link.arms) for link in self.links),
        )

    def reported(self, ports: tuple[str, ...]) -> tuple[str, ...]:
        """The masses, and then the inertias."""
        return tuple(self._bodies)

    def masses_and_springs(self, ports: tuple[str, ...]) -> tuple[dict[str, float], tuple[NetworkLink, ...]]:
        """Masses and links, an interval by its middle, which is what runs."""
        springs = (
            NetworkLink(link.between, Interval.of(link.stiffness).nominal, Interval.of(link.damping).nominal, link.arms)
            for link in self.links
        )
        return {name: Interval.of(mass).nominal for name, mass in self._bodies.items()}, tuple(springs)


def _method(value: object, info: ValidationInfo) -> object:
    """The discretisation of a continuous system; a discrete system has no method."""
    if info.data.get("time") == "discrete":
        if value is not None:
            raise refuse(f"{show(value)} with 'time: discrete'", "'time: continuous', or no method")
        return None
    return "backward-euler" if value is None else value


class StateSpaceEnvironment(EnvironmentKind):
    """An environment given by its matrices, x' = A x + B u, force = C x + D u, or x+ = ... in discrete time.

    With n states and m ports, A is n x n, B is n x m, C is m x n and D is m x m, in m, N and s.
    """

    in_series: ClassVar[bool] = True

    model_config = ConfigDict(
        json_schema_extra={**D_OR_STATIC, "if": where("time", "discrete"), "then": without("method")}
    )

    type: Literal["state-space"] = Field(description="the kind of environment: state-space")
    A: MatrixRows = Field(description="the n x n matrix A, as rows")
    B: MatrixRows = Field(description="the n x m matrix B, as rows")
    C: MatrixRows = Field(description="the m x n matrix C, as rows")
    D: OptionalRows = Field(default=None, description="the m x m matrix D, as rows")
    static: OptionalRows = Field(default=None, description=STATIC_MEANING)
    time: Literal["continuous", "discrete"] = Field(
        default="continuous", description="the time of the matrices: continuous or discrete"
    )
    method: Annotated[
        Literal["backward-euler", "tustin", "zoh"] | None,
        BeforeValidator(_method),
    ] = defaulted(None, "how it is discretised: backward-euler, tustin or zoh")
    delay: Delay = Field(default=0, description="whole ticks by which its forces are late")
    enforce: Enforce = Field(default=False, description=ENFORCE_MEANING)

    @model_validator(mode="after")
    def _d_or_static(self) -> Self:
        one_of_two(self.D, self.static)
        return self

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """A problem for each matrix whose size does not fit a session with these ports."""
        return size_problems(self.A, self.B, self.C, self.D, self.static, len(ports), MAX_ENVIRONMENT_ORDER)

    def for_design(self, ports: tuple[str, ...]) -> designed.StateSpaceEnvironment:
        """The matrices, with D as stated, or computed from the static gain."""
        system = stated_system(self, "the environment", continuous=self.time == "continuous")
        return designed.StateSpaceEnvironment(ports, system, self.method, self.delay)


_entry: Final = Entry("N/m")


def _defined(value: object) -> Rational:
    entry = _entry(value)
    if entry.degrees[1] < 0:
        raise refuse("a denominator that is 0", "a coefficient other than 0", at=("den",))
    return entry


_DEFINED: Final = Described(_defined, _entry.json_schema)
_ENTRIES: Final = Items("rows of entries", MAX_PORTS, Items("entries of a row", MAX_PORTS, _DEFINED))


class TransferFunctionEnvironment(EnvironmentKind):
    """An environment given by m x m rational functions of s, from displacement (m) to force (N)."""

    in_series: ClassVar[bool] = True

    type: Literal["transfer-function"] = Field(description="the kind of environment: transfer-function")
    entries: Annotated[tuple[tuple[Rational, ...], ...], _ENTRIES] = Field(
        description="the m x m entries in N/m, as rows: each a number or {num: [...], den: [...]}"
    )
    method: Literal["backward-euler", "tustin"] = Field(
        default="backward-euler", description="how it is discretised: backward-euler or tustin"
    )
    delay: Delay = Field(default=0, description="whole ticks by which its forces are late")
    enforce: Enforce = Field(default=False, description=ENFORCE_MEANING)

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        total = sum(max(0, *entry.degrees) for row in self.entries for entry in row)
        if total > MAX_ENVIRONMENT_ORDER:
            expected = f"degrees of all entries together of at most {MAX_ENVIRONMENT_ORDER}, or type: state-space"
            raise refuse(f"degrees of {total} together", expected, at=("entries",))
        return self

    @model_validator(mode="after")
    def _tustin_has_proper_entries(self) -> Self:
        for i, row in enumerate(self.entries):
            for j, entry in enumerate(row):
                if self.method == "tustin" and not entry.proper:
                    # Tustin maps infinite s to z = -1, so an improper entry would get a pole on the unit circle
                    degrees = " over ".join(str(degree) for degree in entry.degrees)
                    found = f"tustin with the improper entry in row {i + 1}, column {j + 1} (degree {degrees})"
                    raise refuse(found, "backward-euler, or proper entries only", at=("method",))
        return self

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """The problems of the entries' number in a session with these ports."""
        m = len(ports)
        if len(self.entries) != m:
            yield Problem(
                ("entries",),
                show(self.entries),
                f"{counted(m, 'row')} of {counted(m, 'entry', 'entries')}, one for each port",
            )
            return
        for i, row in enumerate(self.entries):
            if len(row) != m:
                yield Problem(
                    ("entries", i), f"a row of {len(row)}", f"{counted(m, 'entry', 'entries')}, one for each port"
                )

    def for_design(self, ports: tuple[str, ...]) -> designed.TransferEnvironment:
        """The rational functions."""
        entries = tuple(tuple((entry.num, entry.den) for entry in row) for row in self.entries)
        return designed.TransferEnvironment(ports, entries, self.method, self.delay)


KINDS: Final[Mapping[str, type[EnvironmentKind]]] = {
    "network": NetworkEnvironment,
    "scene": SceneEnvironment,
    "state-space": StateSpaceEnvironment,
    "transfer-function": TransferFunctionEnvironment,
    "python": PythonEnvironment,
    "engine": EngineEnvironment,
    "mesh": MeshEnvironment,
}
"""The kinds by the value of the key ``type``: one line a kind."""

if TYPE_CHECKING:
    Environment: TypeAlias = EnvironmentKind
else:
    Environment = Union[tuple(KINDS.values())]  # noqa: UP007  # for the schema
"""Any environment of a session."""


def environment_of_its_type(value: object, info: ValidationInfo) -> Environment:
    """The environment, validated as the kind that its ``type`` names; errors thus list the keys of that kind alone.

    Raises:
        PydanticCustomError: ``type`` is absent or unknown, or the keys of that kind are wrong.
    """
    if isinstance(value, EnvironmentKind):
        return value
    kinds = ", ".join(KINDS)
    if not isinstance(value, Mapping):
        raise refuse(show(value), f"a mapping with the key type, one of {kinds}, and the keys of that type")
    if "type" not in value:
        if misspelt := get_close_matches("type", [key for key in value if isinstance(key, str)], n=1):
            raise refuse(f"the unknown key {show(misspelt[0])}", "type", at=(misspelt[0],))
        raise refuse("no key 'type'", f"type, the kind of environment: one of {kinds}")
    name = value["type"]
    if not isinstance(name, str) or name not in KINDS:
        raise refuse(show(name), one_of(KINDS, name), at=("type",))
    kind = KINDS[name]
    try:
        return kind.model_validate(value, context=info.context)
    except ValidationError as error:
        raise refusal(*problems_in(error, kind)) from None
