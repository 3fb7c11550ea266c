"""A device of a session: its axes, its OSP level, its limits, and its driver with the simulated hand.

The ``driver`` is what moves the device. ``simulated`` is a simulated mechanism in a simulated hand. ``browser`` is the
same mechanism, whose hand follows the pointer of a person at a browser; with ``spacemouse`` and ``gamepad`` the hand
follows a goal that such a device moves. ``trace`` is a recorded motion, which needs neither mechanism nor hand. Every
other driver is the code of another package, named by its factory. A session file only names it. The device's process
alone imports it (:mod:`manyhands.nodes.device.plugin`).

A simulated hand is a passive linear operator H(s) and an intention. It responds to the device's velocity v (m/s) with
the force (N)

    f = force(t) - (H(s) + mass s + damping + stiffness / s) (v - d motion(t)/dt).

An H that is not passive is refused, because the certificate of a session relies on passive hands (Assumption 1b of
[Bianchini2010]_). Recorded traces are read here: a device's process receives numbers, and opens no file that the
session's author named.
"""

import functools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.axis import AxisKind, Units
from manyhands.design.models.linkage import LENGTHS, LinkageError, greatest_bending, linkage_of
from manyhands.design.passivity.operators import PassivityFinding, RationalMatrix
from manyhands.launch.session.errors import listed, one_of, show
from manyhands.launch.session.fields import (
    AXIS_NAME,
    BETWEEN,
    DAMPING,
    DEVICE_AXES,
    HAND_MASS,
    MASS,
    OSP_ENTRY,
    OSP_LEVEL,
    STIFFNESS,
    Axes,
    Completed,
    Described,
    Dof,
    FieldCheck,
    Items,
    LevelInterval,
    Name,
    NamedParts,
    OnAxes,
    PerAxis,
    PortLimits,
    Problem,
    Quantity,
    Rows,
    SessionModel,
    ValueCheck,
    axis_kinds,
    axis_units,
    between,
    defaulted,
    each,
    each_named,
    ends,
    is_interval,
    kinds_of_axes,
    matrix,
    ordered,
    problems_of,
    refusal,
    refuse,
    unsymmetric,
)
from manyhands.launch.session.foreign import PARAMETERS, Factory
from manyhands.launch.session.forms import JsonSchema, either, list_of, mapping_of, where, without
from manyhands.launch.session.friction import SIMULATED_ALONE, Friction
from manyhands.launch.session.limits import (
    LONGEST_PERIOD,
    MAX_DOF,
    MAX_TRACE_ROWS,
    MIN_POSITIVE,
    MOST_BUTTONS,
    MOST_SPANS,
)
from manyhands.launch.session.matrices import Entry, Rational
from manyhands.launch.session.motion import (
    MOTION_FORM,
    Motion,
    TraceData,
    motion_of,
    read_trace,
    require_formula,
    trace_from_numbers,
)
from manyhands.launch.session.orientation import Orientation
from manyhands.launch.session.rate import rate_motion
from manyhands.nodes.device.motion_sources import MOTION_SOURCES
from manyhands.nodes.kernel.bundle import WALL, RateMotion
from manyhands.nodes.kernel.buttons import Script
from manyhands.nodes.kernel.driver_statement import FELT, JOINED, SENSED, DeviceTiming, DriverWord
from manyhands.nodes.kernel.factory import DRIVERS
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.nodes.kernel.words import counted
from manyhands.protocol.limits import MAX_BY_ITSELF, MAX_SENTENCE

DEFAULT_HAND: Final[Mapping[str, object]] = {
    "operator": {"num": [0.02, 1.2, 20.0], "den": [1.0, 10.3, 100.0]},
    "force": "2*pulse(t, 0.1, 0.2)",
}
"""The hand of a device that names none: on every axis by itself the operator of Example 1,
0.02 (s^2 + 60 s + 1000)/(s^2 + 10.3 s + 100) in N·s/m, and a push of 2 N between 0.1 s and 0.2 s."""

BROWSER_HAND: Final[Mapping[str, object]] = {"stiffness": 200.0, "damping": 5.0}
"""The default stiffness and damping of a person's hand, as at a browser: 200 N/m and 5 N·s/m on each axis."""

_entry: Final = Entry("N·s/m")
_SAMPLES: Final = Items("samples", MAX_TRACE_ROWS, Quantity("a number"))
_PASSIVE: Final = "a passive operator: no eigenvalue of (H(jw) + H(jw)*)/2 below 0 at any frequency w"


_OPERATOR_FORM: Final = either(_entry.json_schema, list_of(list_of(_entry.json_schema, MAX_DOF), MAX_DOF))


def _operator(value: object, info: ValidationInfo) -> object:
    """H(s) as rows of entries; a single entry applies to every axis, without cross terms."""
    dof = len(axis_kinds(info) or (None,))
    if isinstance(value, list | tuple):
        return matrix(_entry, value, dof, dof)
    own, cross = _entry(value), Rational(num=(0.0,), den=(1.0,))
    return tuple(tuple(own if i == j else cross for j in range(dof)) for i in range(dof))


@functools.lru_cache(maxsize=256)  # many devices have the same hand
def _passivity(operator: RationalMatrix) -> PassivityFinding:
    # extreme coefficients may overflow in between; such an operator is then refused as not finite
    with np.errstate(all="ignore"):
        return operator.passivity()


@dataclass(frozen=True, slots=True)
class Intents(FieldCheck):
    """The check of an intended force or motion for every axis."""

    what: Quantity

    @property
    def json_schema(self) -> JsonSchema:
        """By axis a number, a formula or a trace."""
        return PerAxis(Intent(self.what, Path())).json_schema

    def in_part(self, value: object, info: ValidationInfo) -> Any:
        """The intention of each axis; the files of traces are in the folder of the session file."""
        return PerAxis(Intent(self.what, (info.context or {}).get("folder", Path()))).in_part(value, info)


@dataclass(frozen=True, slots=True)
class Intent(ValueCheck):
    """The check of an intended force or motion of one axis.

    Attributes:
        what: the quantity.
        folder: of the files of traces.
    """

    what: Quantity
    folder: Path

    @property
    def json_schema(self) -> JsonSchema:
        """A number, a formula or a trace."""
        numbers = dict.fromkeys(("times", "values"), _SAMPLES.json_schema)
        traces = (mapping_of({"trace": {"type": "string", "minLength": 1}}), mapping_of(numbers))
        return either(self.what.json_schema, {"type": "string"}, *traces)

    def at(self, units: Units) -> Self:
        """The same on axes with these units."""
        return replace(self, what=self.what.at(units))

    def __call__(self, value: object) -> float | str | TraceData:
        """The intention."""
        return _intent(self.what, value, self.folder)


def _intent(what: Quantity, value: object, folder: Path) -> float | str | TraceData:
    """The checked intention of one axis: a number, a formula, or a trace."""
    match value:
        case TraceData():
            return value
        case str():
            require_formula(value)
            return value
        case Mapping() if set(value) == {"trace"}:
            return read_trace(value["trace"], folder)
        case Mapping() if set(value) == {"times", "values"}:
            times, values = each(_SAMPLES, (value["times"], value["values"]))
            return trace_from_numbers(times, values, "the trace")
        case Mapping():
            raise refuse(f"a mapping with {listed(value)}", "{trace: FILE.csv} or {times: [...], values: [...]}")
        case list() | tuple() | None | bool():
            raise refuse(show(value), f"{what.what}: a number in {what.unit}, a formula in t, or a trace")
        case _:
            return what(value)


_HAND_MASS: Final = PerAxis(HAND_MASS)
_DAMPING: Final = PerAxis(DAMPING)
_STIFFNESS: Final = PerAxis(STIFFNESS)
_FORCE: Final = Intents(Quantity("an intended force", "N"))
_MOTION: Final = Intents(Quantity("an intended motion", "m"))
_AXES: Final = "one for all axes, or a list with one for each"


class Hand(OnAxes):
    """A simulated hand; every tuple has one entry for each axis of the device.

    Raises:
        PydanticCustomError: the operator is not passive, or another value is wrong.
    """

    operator: Annotated[tuple[tuple[Rational, ...], ...], Completed(_operator, _OPERATOR_FORM)] = defaulted(
        0.0, "the passive operator H(s) in N·s/m, from velocity to force"
    )
    mass: Annotated[tuple[float, ...], _HAND_MASS] = defaulted(0.0, f"an added mass in kg, {_AXES}")
    damping: Annotated[tuple[float, ...], _DAMPING] = defaulted(0.0, f"an added damping in N·s/m, {_AXES}")
    stiffness: Annotated[tuple[float, ...], _STIFFNESS] = defaulted(0.0, f"a stiffness in N/m, {_AXES}")
    force: Annotated[tuple[float | str | TraceData, ...], _FORCE] = defaulted(0.0, f"the intended force in N, {_AXES}")
    motion: Annotated[tuple[float | str | TraceData, ...], _MOTION] = defaulted(
        0.0, f"the intended motion in m, {_AXES}"
    )

    @property
    def rational(self) -> RationalMatrix:
        """H(s) in the form that ``design`` uses, dof x dof, N·s/m."""
        return RationalMatrix(tuple(tuple((entry.num, entry.den) for entry in row) for row in self.operator))

    @field_validator("operator", mode="after")
    @classmethod
    def _is_passive(cls, operator: tuple[tuple[Rational, ...], ...]) -> tuple[tuple[Rational, ...], ...]:
        try:
            finding = _passivity(
                RationalMatrix(tuple(tuple((entry.num, entry.den) for entry in row) for row in operator))
            )
        except (np.linalg.LinAlgError, OverflowError):
            raise refuse("an operator whose response is not finite", _PASSIVE) from None
        except ValueError as error:
            raise refuse(str(error), "proper rational functions in N·s/m, with a denominator that is not 0") from None
        if finding.passive and not math.isfinite(finding.smallest):
            raise refuse("an operator whose response is not finite", _PASSIVE)
        if not finding.passive:
            raise refuse(f"an {finding.reason}", _PASSIVE)
        return operator


ORIENTED_DOF: Final = 3
"""The axes of a device whose orientation is a port: where its tool is in space."""

_TORQUE: Final = "torque"
_ROUNDING: Final = 1e-12  # rounding error of the eigenvalues of a difference, relative to the largest entry
_per_axis: Final = PerAxis(OSP_LEVEL)
_SIMULATED, _TRACE = "simulated", "trace"
TURNING: Final = (_SIMULATED, "browser")
"""The drivers that turn in space."""

PERSONS: Final = ("browser", *MOTION_SOURCES)
"""Drivers by which a person moves a simulated device without feeling it."""

SCRIPTED: Final = (_SIMULATED, _TRACE)
"""Drivers of devices whose buttons the session file presses."""

_DRIVERS: Final = (*SCRIPTED, *PERSONS)
_ELSEWHERE: Final = ("mass", "damping", "hand")
"""Keys of a simulated mechanism; a recorded motion has none of them."""

_NOT_OF_A_PLUGIN: Final = ("damping", "hand")
"""Those that a driver of another package has itself. Of its mass a session may state the least."""

OF_A_PLUGIN: Final = ("parameters", "sample_age", "age_jitter", "actuation_delay", "axis_map", "scale", "by_itself")
"""Keys of a driver of another package; no other device has them, but for those in :data:`_OF_A_MOTION_SOURCE`."""

_OF_A_MOTION_SOURCE: Final = ("parameters", "axis_map")
"""Those that a SpaceMouse and a gamepad have as well."""

_ALWAYS_OF_A_PLUGIN: Final = tuple(key for key in OF_A_PLUGIN if key not in _OF_A_MOTION_SOURCE)

_DEEDS: Final = Items(
    "sentences",
    MAX_BY_ITSELF,
    Name(
        "what it does by itself",
        rf"[^\x00-\x1f\x7f]{{1,{MAX_SENTENCE}}}",
        f"a line of at most {MAX_SENTENCE} characters",
    ),
)
_AGE: Final = Quantity("a time", "s", least=0.0, most=LONGEST_PERIOD)
_SCALE: Final = Quantity("a scale", above=0.0, smallest=MIN_POSITIVE)
_AXIS: Final = Name("an axis of the driver", "-?[a-z0-9][a-z0-9_]{0,31}", "its name, after a minus to turn it round")


def _is_simulated(driver: object) -> bool:
    """Whether a driver has a simulated mechanism; so has one that was refused, for the other messages."""
    return driver in (_SIMULATED, *PERSONS, None)


_OSP_FORM: Final = either(
    _per_axis.json_schema, list_of(list_of(OSP_ENTRY.json_schema, MAX_DOF), MAX_DOF), between(_per_axis.json_schema)
)


def _osp(value: object, info: ValidationInfo) -> object:
    """Delta_D as a symmetric positive definite matrix, from a number, a list by axis, or the matrix itself.

    The ends of an interval are numbers or lists by axis: two matrices have no lower end that a proof could use.
    """
    dof: int = info.data.get("dof", 1)
    units = axis_units(info)
    if isinstance(value, LevelInterval):
        value = _plain_level(value)
    if is_interval(value):
        low, high = ends(value, lambda end: _per_axis.in_part(end, info))
        if len(low) != len(high):  # possible only where dof is wrong
            raise refuse("ends of different lengths", "one level, or one for each axis, at both ends", (BETWEEN,))
        for least, most in zip(low, high, strict=True):
            ordered(least, most)
        return _diagonal(low) if low == high else LevelInterval(_diagonal(low), _diagonal(high))
    if not isinstance(value, list | tuple) or not any(isinstance(row, list | tuple) for row in value):
        return _diagonal(_per_axis.in_part(value, info))
    rows: Rows = matrix(OSP_ENTRY.at(units), value, dof, dof)
    if problem := unsymmetric(rows):
        raise refusal(problem)
    least = float(np.linalg.eigvalsh(np.array(rows))[0])
    if least <= _ROUNDING * np.abs(rows).max():
        raise refuse(f"a matrix with the eigenvalue {least:.3g}", f"a positive definite matrix in {units('N·s/m')}")
    return rows


def _diagonal(levels: tuple[float, ...]) -> Rows:
    return tuple(tuple(level if i == j else 0.0 for j in range(len(levels))) for i, level in enumerate(levels))


def _plain_level(osp: Rows | LevelInterval) -> object:
    """The level in the notation of a session file."""
    if isinstance(osp, LevelInterval):
        return {BETWEEN: [[row[i] for i, row in enumerate(end)] for end in (osp.low, osp.high)]}
    return osp


def _damping(value: object, info: ValidationInfo) -> object:
    """The damping by axis, in N·s/m; by default the OSP level, or its absolute row sums if it has cross terms.

    The default for an interval of levels is its middle, as for every quantity of which a run needs one value.
    """
    if value is None and not _is_simulated(info.data.get("driver")):
        return None
    if value is None:
        osp = info.data.get("osp", ())  # absent if it was refused
        if isinstance(osp, LevelInterval):
            return tuple((osp.low[i][i] + osp.high[i][i]) / 2.0 for i in range(len(osp.low)))
        return tuple(float(np.abs(row).sum()) for row in osp)
    return _DAMPING.in_part(value, info)


_MASS: Final = PerAxis(MASS)
_STEP: Final = PerAxis(Quantity("a step", "m", least=0.0))
_NOT_MEASURED: Final = ("step", "friction")
"""Keys of an encoder and its mechanism; a recorded motion and the goal of a person have neither."""


def _trace(value: object, info: ValidationInfo) -> object:
    return motion_of(value, info.data.get("dof", 1), info.context)


_KAPPA: Final = Quantity("kappa", "1/m", above=0.0, smallest=MIN_POSITIVE)
_JOINT_FRICTION: Final = PerAxis(Quantity("a friction", "N·m", above=0.0, smallest=MIN_POSITIVE))
_NUMBERS: Final = list_of({"type": "number"}, 3)
_POSES: Final = {"low": _NUMBERS, "high": _NUMBERS}
_LENGTH: Final = Quantity("a length", "m/rad", above=0.0, smallest=MIN_POSITIVE, most=1e3)
_LINKAGE_FORM: Final = either(
    mapping_of({"kappa": _KAPPA.json_schema}, {"length": _LENGTH.json_schema}),
    *(
        mapping_of(
            {"kind": {"enum": [kind]}, **parts, **_POSES},
            {"kappa": _KAPPA.json_schema, "friction": _JOINT_FRICTION.json_schema},
        )
        for kind, parts in (
            ("chain", {"turns": list_of({"enum": ["x", "y", "z"]}, 3), "links": list_of(_NUMBERS, 3)}),
            *((kind, {length: {"type": "number"} for length in lengths}) for kind, lengths in LENGTHS.items()),
        )
    ),
)
_UP: Final = 1.0 + 1e-12  # of a root of a sum of squares, which is rounded
_SEARCHED: Final = 1.05
"""What a kappa is stated above the one that a search finds, so that a proof decides it."""


def _linkage(value: object, info: ValidationInfo) -> dict[str, Any]:
    """The linkage of a device that holds torques: its kinematics, or kappa alone, 1/m."""
    if not isinstance(value, Mapping):
        raise refuse(show(value), "{kappa: 18.8}, in 1/m, or kinematics such as {kind: chain, …}")
    out = dict(value)
    if "kappa" in out:
        out["kappa"] = _KAPPA(out["kappa"])
    if "kind" not in out and "length" in out:
        out["length"] = _LENGTH(out["length"])
    kinematics = _kinematics(out)
    if kinematics is None and not {"kappa"} <= set(out) <= {"kappa", "length"}:
        raise refuse(f"a mapping with {listed(value)}", "{kappa: 18.8}, in 1/m, or a kind of kinematics as well")
    if kinematics is not None:
        try:
            linkage_of(kinematics)
        except LinkageError as error:
            raise refuse(str(error), "kinematics of a chain, five-bar or delta") from None
    if "friction" in out:
        out["friction"] = list(_JOINT_FRICTION.in_part(out["friction"], info))
    return out


_BESIDE_KINEMATICS: Final = ("kappa", "friction")
"""Keys of a linkage that no proof of its bending needs."""


def _kinematics(linkage: Mapping[str, Any]) -> dict[str, Any] | None:
    """The kinematics of a linkage, without its kappa and the friction of its joints; None where it has none."""
    own = {key: value for key, value in linkage.items() if key not in _BESIDE_KINEMATICS}
    return own if "kind" in own else None


@functools.lru_cache(maxsize=64)
def _kappa_of(kinematics: str) -> float:
    """The kappa to be proved of kinematics, as JSON: a search takes a second."""
    return _SEARCHED * greatest_bending(linkage_of(json.loads(kinematics)))


_TIME: Final = Quantity("a time", "s", least=0.0, most=1e6)
BUTTON: Final = Name("a button", "[a-z0-9][a-z0-9_]{0,31}", "lower-case letters, digits and _, at most 32 of them")
_BUTTON_NAMES: Final = Items("buttons", MOST_BUTTONS, BUTTON)
_SPANS: Final = list_of(list_of(_TIME.json_schema, 2, 2), MOST_SPANS)
_BUTTONS_FORM: Final = either(
    _BUTTON_NAMES.json_schema, {**NamedParts(BUTTON, MOST_BUTTONS).json_schema, "additionalProperties": _SPANS}
)


def _buttons(value: object) -> dict[str, Script]:
    """Of each button when it is held down, s; a list names buttons that nobody but a person presses."""
    if not isinstance(value, Mapping):
        names: tuple[str, ...] = _BUTTON_NAMES(value)
        if twice := [name for i, name in enumerate(names) if name in names[:i]]:
            raise refuse(f"the button {twice[0]!r} twice", "each name once")
        return dict.fromkeys(names, ())
    NamedParts(BUTTON, MOST_BUTTONS)(value)
    return each_named(_spans, value)


def _spans(value: object) -> Script:
    """When a button is held down: [[from, until], ...], s, one after the other."""
    if not isinstance(value, list | tuple) or len(value) > MOST_SPANS:
        raise refuse(show(value), f"at most {MOST_SPANS} times [from, until] in s")
    spans: list[tuple[float, float]] = []
    for span in value:
        if not isinstance(span, list | tuple) or len(span) != 2:
            raise refuse(show(span), "[from, until] in s")
        begin, end = each(_TIME, span)
        if not (spans[-1][1] if spans else -1.0) < begin < end:
            raise refuse(show([begin, end]), "[from, until] in s, each after the one before")
        spans.append((begin, end))
    return tuple(spans)


def _plain_buttons(buttons: Mapping[str, Script] | None) -> object:
    """The buttons in the notation of a session file."""
    if buttons is None or not any(buttons.values()):
        return None if buttons is None else list(buttons)
    return {name: [list(span) for span in spans] for name, spans in buttons.items()}


_NAMES: Final = Items("axis names", MAX_DOF, AXIS_NAME)
_BY_NAME: Final = NamedParts(AXIS_NAME, MAX_DOF)
_KINDS: Final = tuple(kind.value for kind in AxisKind)
_AXES_FORM: Final = either(
    _NAMES.json_schema, {**_BY_NAME.json_schema, "additionalProperties": {"enum": [*_KINDS]}}, {"enum": [*_KINDS]}
)


def _axes(value: object) -> Axes:
    """The names of the axes, by name what each of them does, or what all of them do."""
    if not isinstance(value, Mapping | str):
        return _NAMES(value)

    def kind(word: object) -> AxisKind:
        if word not in _KINDS:
            raise refuse(show(word), one_of(_KINDS, word))
        return AxisKind(str(word))

    if isinstance(value, str):
        return kind(value)
    _BY_NAME(value)
    return each_named(kind, value)


def _plain_axes(axes: Axes | None) -> object:
    """The axes in the notation of a session file."""
    if isinstance(axes, AxisKind):
        return axes.value
    return {name: kind.value for name, kind in axes.items()} if isinstance(axes, Mapping) else axes


def ports_by_device(ports: tuple[str, ...]) -> dict[str, list[str]]:
    """The ports of each device by its name, of a session's ports: see :meth:`Device.ports`."""
    found: dict[str, list[str]] = {}
    for port in ports:
        found.setdefault(port.partition(".")[0], []).append(port)
    return found


class Device(SessionModel):
    """A device and the hand that holds it; every tuple has one entry for each axis.

    The simulated mechanism is ``mass dv/dt + damping v = force``, axis by axis. A trace has no mechanism, and the
    driver of another package has its own.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                {
                    "if": where("driver", _SIMULATED, *PERSONS),
                    "then": {"required": ["mass"], **without("trace", *_ALWAYS_OF_A_PLUGIN)},
                },
                {"if": where("driver", _SIMULATED, _TRACE, "browser"), "then": without(*_OF_A_MOTION_SOURCE)},
                {"if": where("driver", *PERSONS), "then": without(*_NOT_MEASURED)},
                {
                    "if": where("driver", _TRACE),
                    "then": {"required": ["trace"], **without(*_ELSEWHERE, *_ALWAYS_OF_A_PLUGIN, *_NOT_MEASURED)},
                },
                {
                    "if": {"properties": {"driver": {"not": {"enum": [*_DRIVERS]}}}, "required": ["driver"]},
                    "then": {"allOf": [without("trace", *_NOT_OF_A_PLUGIN), {"properties": {"time": {"const": WALL}}}]},
                },
            ]
        }
    )

    dof: Dof = Field(description="the number of degrees of freedom")
    axes: Annotated[Axes | None, Described(_axes, _AXES_FORM), PlainSerializer(_plain_axes)] = Field(
        default=None, description="names of the axes, for its ports; {NAME: rotation} or rotation, for N·m and rad"
    )
    osp: Annotated[Rows | LevelInterval, Completed(_osp, _OSP_FORM), PlainSerializer(_plain_level)] = Field(
        description="the OSP level Delta_D in N·s/m: a number, one for each axis, a matrix, or an interval"
    )
    driver: Annotated[str, Factory(DRIVERS, _DRIVERS)] = Field(
        description=f"what moves it: {', '.join(_DRIVERS)}, or a driver's factory, package.module:factory"
    )
    parameters: Annotated[dict[str, Any] | None, PARAMETERS] = Field(
        default=None,
        description="with a driver's factory, plain data for it; its settings with a SpaceMouse or a gamepad",
    )
    sample_age: Annotated[float | None, _AGE] = Field(
        default=None, description="with a driver's factory, the greatest age of its samples in s; a part of tau"
    )
    age_jitter: Annotated[float | None, _AGE] = Field(
        default=None, description="by how much that age varies in s; all of it unless given"
    )
    actuation_delay: Annotated[float | None, _AGE] = Field(
        default=None, description="with a driver's factory, the greatest delay of its forces in s; a part of tau"
    )
    axis_map: Annotated[tuple[str, ...] | None, Items("axes", MAX_DOF, _AXIS)] = Field(
        default=None,
        description="but for simulated, trace, browser: the driver's axis at each port, after a minus to turn it round",
    )
    scale: Annotated[float | None, _SCALE] = Field(
        default=None, description="with a driver's factory, by how much motions grow from the device to the session"
    )
    by_itself: Annotated[tuple[str, ...] | None, _DEEDS] = Field(
        default=None, description="with a driver's factory, what it does by itself, outside the certificate: sentences"
    )
    step: Annotated[tuple[float, ...] | None, _STEP] = Field(
        default=None, description="the step of its encoder in m: a number, or one for each axis"
    )
    friction: Friction | None = Field(
        default=None, description="{least: c}, the dry friction in N that it has at least, in every pose and direction"
    )
    time: Literal["wall", "own"] = Field(
        default="wall",
        description="under the realtime clock, wall: it goes on by the wall clock; own: by one period a tick",
    )
    trace: Annotated[Motion | None, Completed(_trace, MOTION_FORM)] = Field(
        default=None, description="with driver: trace, the recorded motion"
    )
    mass: Annotated[tuple[float, ...] | None, _MASS] = Field(
        default=None, description="the least moving mass in kg, greater than 0: a number, or one for each axis"
    )
    damping: Annotated[tuple[float, ...] | None, Completed(_damping, _DAMPING.json_schema)] = defaulted(
        None, "the damping in N·s/m, at least the OSP level: a number, or one for each axis"
    )
    limits: PortLimits = defaulted({}, "the force, displacement and speed that it never goes beyond")
    held: Literal["force", "torque"] = Field(
        default="force", description="what its motors hold from tick to tick: the force at the tip, or joint torques"
    )
    linkage: Annotated[dict[str, Any] | None, Completed(_linkage, _LINKAGE_FORM)] = Field(
        default=None, description="with held: torque, the linkage from its motors to its tip"
    )
    buttons: Annotated[
        dict[str, Script] | None, Described(_buttons, _BUTTONS_FORM), PlainSerializer(_plain_buttons)
    ] = Field(
        default=None,
        description="names of its buttons; {NAME: [[from, until]]}, in s, presses those of a simulated one",
    )
    orientation: Orientation | None = Field(
        default=None,
        description="with driver: simulated, browser or one of another package, and three axes that translate, its "
        "orientation as a port",
    )
    hand: Hand | None = defaulted(None, "the simulated hand that holds it")

    @property
    def kinds(self) -> tuple[AxisKind, ...]:
        """What each of its axes does."""
        return kinds_of_axes(self.axes, self.dof)

    @property
    def units(self) -> Units:
        """The units of its axes together."""
        return Units.of(self.kinds)

    @property
    def factory(self) -> str | None:
        """The factory of the driver of another package; None for the drivers of this one."""
        return None if self.driver in _DRIVERS else self.driver

    @property
    def rate(self) -> RateMotion | None:
        """What moves the goal of a person's hand by its deflection; None where nothing of the kind does."""
        if self.driver not in MOTION_SOURCES:
            return None
        return rate_motion(self.driver, self.parameters or {}, self.axis_map, self.dof)

    @property
    def timing(self) -> DeviceTiming:
        """The age of its samples and the delay of its forces."""
        return DeviceTiming(self.sample_age or 0.0, self.age_jitter, self.actuation_delay or 0.0)

    @property
    def inertia(self) -> Inertia | None:
        """What is stated of its mass and its hand; None where nothing is.

        A recorded motion has no mass. A person's goal may jump, so nothing bounds the force of a hand that follows it.
        """
        if self.mass is None or self.driver in PERSONS:
            return None
        return Inertia(self.mass, self.limits.hand, self.step or (0.0,) * self.dof)

    @property
    def held_torque(self) -> HeldTorque | None:
        """How its motors hold a force where they hold torques: with the most force and speed of its limits together."""
        if self.linkage is None:
            return None
        force, speed = (math.nextafter(math.hypot(*own), math.inf) for own in (self.limits.force, self.limits.speed))
        if self.twists and self.orientation is not None and self.orientation.limits is not None:
            length, turning = self.linkage["length"], self.orientation.limits
            wrench, twist = math.hypot(force, turning.torque / length), math.hypot(speed, turning.speed * length)
            return HeldTorque(self.linkage["kappa"], _UP * wrench, _UP * twist, None, length)
        kinematics = self.kinematics
        kappa = self.linkage.get("kappa") or _kappa_of(json.dumps(kinematics))
        return HeldTorque(kappa, force, speed, kinematics)

    @property
    def holds_torques(self) -> bool:
        """Whether its motors hold joint torques from tick to tick, in place of the force."""
        return self.linkage is not None

    @property
    def twists(self) -> bool:
        """Whether they hold the torque of its orientation as well, so that a turn counts by a length."""
        return "length" in (self.linkage or {})

    @property
    def tells_work(self) -> bool:
        """Whether its account rests on the work of its motors, which it reports in wall time."""
        return self.holds_torques and not self.twists

    @property
    def kinematics(self) -> dict[str, Any] | None:
        """Those of its linkage as plain data; None where none are stated."""
        return None if self.linkage is None else _kinematics(self.linkage)

    @property
    def joint_friction(self) -> tuple[float, ...] | None:
        """What the joints of its linkage have in a simulation, N·m; None where nothing is stated."""
        stated = (self.linkage or {}).get("friction")
        return None if stated is None else tuple(stated)

    @property
    def word(self) -> DriverWord | None:
        """What rests on the word of a driver of another package; None where this package moves the device.

        Only in the latter case is the work of the hand known, and a part of the device's ledger.
        """
        if self.factory is None:
            return None
        timing, least = self.timing, None if self.friction is None else self.friction.least
        return DriverWord(
            self.factory, timing.sample_age, timing.actuation_delay, self.step, least, self.holds_torques,
            self.by_itself or (), self._turns,
        )  # fmt: skip

    @property
    def _turns(self) -> str:
        """What the driver's word says of its orientation."""
        if self.orientation is None:
            return ""
        return SENSED if self.orientation.sensed else JOINED if self.twists else FELT

    @property
    def osp_low(self) -> Rows:
        """Delta_D, m_i x m_i in N·s/m; of an interval the lower end, which the device keeps at any true level."""
        return self.osp.low if isinstance(self.osp, LevelInterval) else self.osp

    def ports(self, name: str) -> tuple[str, ...]:
        """The ports of this device under the name ``name``: ``dx``, or ``d.0``, ``d.1``, or ``d.x``, ``d.y``."""
        named = () if isinstance(self.axes, AxisKind) else self.axes or ()
        if not named and self.dof == 1:
            return (name,)
        return tuple(f"{name}.{axis}" for axis in named or range(self.dof))

    def buttons_of(self, name: str) -> tuple[str, ...]:
        """The buttons of this device under the name ``name``: ``d.grip``."""
        return tuple(f"{name}.{button}" for button in self.buttons or ())

    def turning(self, name: str) -> tuple[str, ...]:
        """Those of its ports that turn."""
        return tuple(port for port, kind in zip(self.ports(name), self.kinds, strict=True) if kind is AxisKind.ROTATION)

    @field_validator("axes", mode="after")
    @classmethod
    def _one_name_for_each_axis(cls, axes: Axes | None, info: ValidationInfo) -> Axes | None:
        dof = info.data.get("dof")
        if axes is None or dof is None or isinstance(axes, AxisKind):
            return axes
        names = tuple(axes)
        if len(names) != dof:
            raise refuse(f"{len(names)} axis names", f"{dof}, one for each degree of freedom")
        if twice := [name for i, name in enumerate(names) if name in names[:i]]:
            raise refuse(f"the axis {twice[0]!r} twice", "each name once")
        return axes

    @field_validator("damping", mode="after")
    @classmethod
    def _is_osp_as_declared(cls, damping: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        declared = info.data.get("osp", ())
        rows = declared.low if isinstance(declared, LevelInterval) else declared
        if damping is None or not rows or len(damping) != len(rows):  # another error has been reported
            return damping
        osp = np.array(rows)
        least = float(np.linalg.eigvalsh(np.diag(damping) - osp)[0])
        if least < -_ROUNDING * np.abs(osp).max():
            against = f"{osp[0, 0]:g}" if osp.size == 1 else "the one given"
            unit = axis_units(info)("N·s/m")
            raise refuse(
                f"the damping {', '.join(f'{value:g}' for value in damping)} for an OSP level of {against}, "
                "so the device would not be Delta_D-OSP at the declared level",
                f"a damping in {unit} with diag(damping) - osp positive semidefinite, or a smaller osp",
            )
        return damping

    @field_validator("limits", "hand", "friction", mode="wrap")
    @classmethod
    def _on_every_axis(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> object:
        """Pass what the axes do to a part with values by axis; without a valid ``dof`` it cannot be checked."""
        if "dof" not in info.data:
            return value
        if info.field_name == "hand":
            driver = info.data.get("driver")
            if value is None and not _is_simulated(driver):
                return None
            if driver in PERSONS and (value is None or isinstance(value, Mapping)):
                value = {**BROWSER_HAND, **(value or {})}
        if info.field_name == "friction" and not isinstance(value, Mapping | Friction):
            unit = axis_units(info)("N")
            raise refuse(
                show(value), f"{{least: c}}, with the least dry friction in {unit}: a number, or one for each axis"
            )
        written = DEFAULT_HAND if value is None else value
        return handler({**written, DEVICE_AXES: axis_kinds(info)} if isinstance(written, Mapping) else written)

    @model_validator(mode="after")
    def _fits_its_driver(self) -> Self:
        if problems := tuple(self._problems()):
            raise refusal(*problems)
        return self

    def _problems(self) -> Iterator[Problem]:
        """A problem for each key that the driver needs and lacks, and for each key that it does not use."""
        here = f"with 'driver: {self.driver}'"
        if (self.held == _TORQUE) != (self.linkage is not None):
            expected = "its linkage as well, such as {kappa: 18.8}" if self.held == _TORQUE else "held: torque as well"
            yield Problem((), f"{'held: torque' if self.held == _TORQUE else 'a linkage'} alone", expected)
        if self.held == _TORQUE and self.driver == _TRACE:
            yield Problem(("held",), f"held: torque {here}", "held: force, for a recorded motion has no motors")
        if self.kinematics is not None:
            yield from self._linkage_problems(self.kinematics)
        if self.twists and (self.orientation is None or self.orientation.sensed):
            expected = "no length, or an orientation with a torque: only then do joints hold one"
            yield Problem(("linkage", "length"), "a length of turns", expected)
        if self.twists and self.friction is not None:
            expected = "no friction: what it burns is counted nowhere beside torques of six axes"
            yield Problem(("friction",), "friction beside a linkage with a length", expected)
        yield from self._friction_problems(here)
        yield from self._orientation_problems(here)
        if self.driver == "browser" and self.buttons is not None:
            yield Problem(("buttons",), f"buttons {here}", "no buttons: a page presses none yet")
        if self.driver not in SCRIPTED and any((self.buttons or {}).values()):
            yield Problem(("buttons",), f"times of buttons {here}", "their names alone: its user presses them")
        if self.factory is not None:
            yield from self._plugin_problems(here)
            return
        for key in OF_A_PLUGIN if self.driver not in MOTION_SOURCES else _ALWAYS_OF_A_PLUGIN:
            if getattr(self, key) is not None:
                yield Problem((key,), f"{key} {here}", f"a driver's factory, package.module:factory, or no {key}")
        for key in _NOT_MEASURED:
            if self.driver != _SIMULATED and getattr(self, key) is not None:
                expected = f"driver: simulated, a driver's factory, package.module:factory, or no {key}"
                yield Problem((key,), f"{key} {here}", expected)
        if self.driver == _TRACE:
            if self.trace is None:
                yield Problem((), f"no key 'trace' {here}", "trace, the recorded motion, such as {file: run.mcap}")
            for key in _ELSEWHERE:
                if getattr(self, key) is not None:
                    expected = f"no {key}: a recorded motion moves the device whatever forces act on it"
                    yield Problem((key,), f"{key} {here}", expected)
            return
        if self.trace is not None:
            yield Problem(("trace",), f"trace {here}", "'driver: trace', or no trace")
        if self.mass is None:
            yield Problem((), "no key 'mass'", f"mass, {type(self).model_fields['mass'].description}")
        if self.driver in MOTION_SOURCES:
            try:
                _ = self.rate
            except PydanticCustomError as error:
                yield from problems_of(error)
        if self.driver in PERSONS and self.hand is not None:
            for key in ("force", "motion"):
                if any(intent != 0.0 for intent in getattr(self.hand, key)):
                    expected = f"no {key}: the intention comes from the person"
                    yield Problem(("hand", key), f"{key} {here}", expected)
            if 0.0 in self.hand.stiffness:
                unit = self.units("N/m")
                expected = f"a stiffness in {unit} greater than 0: it ties the device to the goal, a pointer's for one"
                yield Problem(("hand", "stiffness"), f"0 {here}", expected)

    def _orientation_problems(self, here: str) -> Iterator[Problem]:
        """A problem for each reason why the orientation can be no port."""
        if self.orientation is None:
            return
        at = ("orientation",)
        if self.driver not in TURNING and self.factory is None:
            expected = f"driver: {', '.join(TURNING)}, or a driver of another package: nothing else turns in space"
            yield Problem(at, f"an orientation {here}", expected)
        else:
            for problem in self.orientation.problems_with(self.driver in TURNING, here):
                yield problem._replace(at=(*at, *problem.at))
        if self.driver in PERSONS and any(intent != 0.0 for intent in self.orientation.torque or ()):
            yield Problem((*at, "torque"), f"torque {here}", "no torque: the intention comes from the person")
        if self.dof != ORIENTED_DOF or self.turning("d"):
            found = f"an orientation beside {counted(self.dof, 'axis', 'axes')}" + (
                " that turn" * bool(self.turning("d"))
            )
            yield Problem(at, found, f"{ORIENTED_DOF} axes that translate")
        if self.held == _TORQUE and not self.orientation.sensed and self.linkage is not None and not self.twists:
            expected = (
                "linkage: {kappa: K, length: L} of all six directions, where a turn counts by L in m/rad, sensed: "
                "true, or held: force"
            )
            yield Problem(at, "an orientation with held: torque, whose linkage has no length", expected)

    def _friction_problems(self, here: str) -> Iterator[Problem]:
        """A problem for each key of the friction that says what is burned where nothing burns it so."""
        for key in SIMULATED_ALONE if self.friction is not None else ():
            if getattr(self.friction, key) is None:
                continue
            if self.factory is not None:
                yield Problem(("friction", key), f"{key} {here}", "least alone: the driver's device has its own")
            elif self.kinematics is not None:
                yield Problem(("friction", key), f"{key} behind the kinematics of a linkage", "least alone")

    def _linkage_problems(self, kinematics: Mapping[str, Any]) -> Iterator[Problem]:
        """The problems of kinematics beside the rest of the device."""
        axes = linkage_of(kinematics).axes
        if axes != self.dof:
            yield Problem(
                ("linkage",), f"a tip of {counted(axes, 'axis', 'axes')}", f"as many as the device has, {self.dof}"
            )
        if (self.scale or 1.0) != 1.0:
            expected = "kappa alone, in the session's metres, or no scale"
            yield Problem(("linkage",), f"kinematics with a scale of {self.scale:g}", expected)
        if self.joint_friction is not None and self.driver != _SIMULATED:
            expected = "driver: simulated, or no friction: of any other device no claim rests on that of its joints"
            yield Problem(("linkage", "friction"), f"friction of joints with 'driver: {self.driver}'", expected)
        if self.driver in PERSONS:
            yield Problem(("linkage",), f"kinematics with 'driver: {self.driver}'", "kappa alone, or driver: simulated")
        try:
            _ = self.held_torque
        except LinkageError as error:
            yield Problem(("linkage",), str(error), "a box without singular poses, within reach")

    def _plugin_problems(self, here: str) -> Iterator[Problem]:
        """The problems of a device that a driver of another package moves."""
        if self.trace is not None:
            yield Problem(("trace",), f"trace {here}", "'driver: trace', or no trace")
        for key in _NOT_OF_A_PLUGIN:
            if getattr(self, key) is not None:
                yield Problem((key,), f"{key} {here}", f"no {key}: the driver's device and its user have their own")
        if self.time != WALL:
            yield Problem(("time",), f"time: {self.time} {here}", f"time: {WALL}, for a driver follows the clock")
        if self.age_jitter is not None and self.age_jitter > (self.sample_age or 0.0):
            yield Problem(("age_jitter",), f"{show(self.age_jitter)}", "at most the sample_age")
        if self.axis_map is not None:
            axes = [axis.removeprefix("-") for axis in self.axis_map]
            if len(axes) != self.dof or len(set(axes)) != len(axes):
                expected = (
                    f"{counted(self.dof, 'axis', 'axes')} of the driver, each once, one for each degree of freedom"
                )
                yield Problem(("axis_map",), show(self.axis_map), expected)
