"""A device of a session: its axes, its OSP level, its limits, and what moves it.

That is its ``driver``: a simulated mechanism in a simulated hand, the same in the hand of a person at a browser, or a
motion that was recorded, which needs neither.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from manyhands.launch.session.fields import (
    AXIS_NAME,
    DAMPING,
    DEVICE_AXES,
    MASS,
    OSP_ENTRY,
    OSP_LEVEL,
    Choice,
    Dof,
    Items,
    PerAxis,
    Problem,
    Rows,
    SessionModel,
    defaulted,
    matrix,
    optional,
    refusal,
    refuse,
    unsymmetric,
)
from manyhands.launch.session.hand import BROWSER_HAND, DEFAULT_HAND, Hand
from manyhands.launch.session.interval import BETWEEN, LevelInterval, ends, is_interval, ordered
from manyhands.launch.session.limits import MAX_DOF
from manyhands.launch.session.motion import Motion, motion_of
from manyhands.launch.session.port_limits import PortLimits

_ROUNDING: Final = 1e-12  # of the largest entry: what the eigenvalues of a difference may lose
_per_axis: Final = PerAxis(OSP_LEVEL)
_SIMULATED, _TRACE, _BROWSER = _DRIVERS = ("simulated", "trace", "browser")


def _osp(value: object, info: ValidationInfo) -> object:
    """Delta_D as a symmetric positive definite matrix, from a number, a list by axis, or the matrix itself.

    An interval is of numbers or of lists by axis: between two matrices there is no lower end to rely on.
    """
    dof: int = info.data.get("dof", 1)
    if isinstance(value, LevelInterval):
        value = _plain_level(value)
    if is_interval(value):
        low, high = ends(value, lambda end: _per_axis(end, info))
        if len(low) != len(high):  # possible where dof itself is wrong
            raise refuse("ends of different lengths", "one level, or one for each axis, at both ends", (BETWEEN,))
        for least, most in zip(low, high, strict=True):
            ordered(least, most)
        return _diagonal(low) if low == high else LevelInterval(_diagonal(low), _diagonal(high))
    if not isinstance(value, list | tuple) or not any(isinstance(row, list | tuple) for row in value):
        levels: Any = _per_axis(value, info)
        return _diagonal(levels)
    rows: Rows = matrix(OSP_ENTRY, value, dof, dof)
    if problem := unsymmetric(rows):
        raise refusal(problem)
    least = float(np.linalg.eigvalsh(np.array(rows))[0])
    if least <= _ROUNDING * np.abs(rows).max():
        raise refuse(f"a matrix with the eigenvalue {least:.3g}", "a positive definite matrix in N·s/m")
    return rows


def _diagonal(levels: tuple[float, ...]) -> Rows:
    return tuple(tuple(level if i == j else 0.0 for j in range(len(levels))) for i, level in enumerate(levels))


def _plain_level(osp: Rows | LevelInterval) -> object:
    """The level as a session file has it."""
    if isinstance(osp, LevelInterval):
        return {BETWEEN: [[row[i] for i, row in enumerate(end)] for end in (osp.low, osp.high)]}
    return osp


def _damping(value: object, info: ValidationInfo) -> object:
    """The damping by axis; by default what the OSP level needs: itself, or its row sums if it has cross terms.

    The default for an interval of levels is its middle, as for every quantity of which a run needs one value.
    """
    if value is None and info.data.get("driver") == _TRACE:
        return None
    if value is None:
        osp = info.data.get("osp", ())  # an osp that was refused leaves nothing to derive from
        if isinstance(osp, LevelInterval):
            return tuple((osp.low[i][i] + osp.high[i][i]) / 2.0 for i in range(len(osp.low)))
        return tuple(float(np.abs(row).sum()) for row in osp)
    return PerAxis(DAMPING)(value, info)


def _mass(value: object, info: ValidationInfo) -> object:
    return None if value is None else PerAxis(MASS)(value, info)


def _trace(value: object, info: ValidationInfo) -> object:
    return motion_of(value, info.data.get("dof", 1), info.context)


_axis_names: Final = Items("axis names", MAX_DOF, AXIS_NAME)


class Device(SessionModel):
    """A device and who holds it; every tuple has one entry for each axis.

    The simulated mechanism is ``mass dv/dt + damping v = force``, axis by axis; a device that a trace moves has none.
    """

    dof: Dof = Field(description="the number of degrees of freedom")
    axes: Annotated[tuple[str, ...] | None, BeforeValidator(optional(_axis_names))] = Field(
        default=None, description="names of the axes, for its ports"
    )
    osp: Annotated[Rows | LevelInterval, BeforeValidator(_osp), PlainSerializer(_plain_level)] = Field(
        description="the OSP level Delta_D in N·s/m: a number, one for each axis, a matrix, or an interval"
    )
    driver: Annotated[Literal["simulated", "trace", "browser"], BeforeValidator(Choice(_DRIVERS))] = Field(
        description="what moves it: simulated, trace or browser"
    )
    trace: Annotated[Motion | None, BeforeValidator(_trace)] = Field(
        default=None, description="with driver: trace, the recorded motion"
    )
    mass: Annotated[tuple[float, ...] | None, BeforeValidator(_mass)] = Field(
        default=None, description="the moving mass in kg, greater than 0: a number, or one for each axis"
    )
    damping: Annotated[tuple[float, ...] | None, BeforeValidator(_damping)] = defaulted(
        None, "the damping in N·s/m, at least the OSP level: a number, or one for each axis"
    )
    limits: PortLimits = defaulted({}, "the force, displacement and speed that it never goes beyond")
    hand: Hand | None = defaulted(None, "the simulated hand that holds it")

    @property
    def osp_low(self) -> Rows:
        """The level Delta_D that the device keeps whatever its true one is: the lower end of an interval."""
        return self.osp.low if isinstance(self.osp, LevelInterval) else self.osp

    def ports(self, name: str) -> tuple[str, ...]:
        """The ports of this device when it is called ``name``: ``dx``, or ``d.0``, ``d.1``, or ``d.x``, ``d.y``."""
        if self.axes is None and self.dof == 1:
            return (name,)
        return tuple(f"{name}.{axis}" for axis in self.axes or range(self.dof))

    @field_validator("axes", mode="after")
    @classmethod
    def _one_name_for_each_axis(cls, axes: tuple[str, ...] | None, info: ValidationInfo) -> tuple[str, ...] | None:
        dof = info.data.get("dof")
        if axes is None or dof is None:
            return axes
        if len(axes) != dof:
            raise refuse(f"{len(axes)} axis names", f"{dof}, one for each degree of freedom")
        if twice := [name for i, name in enumerate(axes) if name in axes[:i]]:
            raise refuse(f"the axis {twice[0]!r} twice", "each name once")
        return axes

    @field_validator("damping", mode="after")
    @classmethod
    def _is_osp_as_declared(cls, damping: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        declared = info.data.get("osp", ())
        rows = declared.low if isinstance(declared, LevelInterval) else declared
        if damping is None or not rows or len(damping) != len(rows):  # what was refused leaves nothing to compare with
            return damping
        osp = np.array(rows)
        least = float(np.linalg.eigvalsh(np.diag(damping) - osp)[0])
        if least < -_ROUNDING * np.abs(osp).max():
            against = f"{osp[0, 0]:g}" if osp.size == 1 else "the one given"
            raise refuse(
                f"the damping {', '.join(f'{value:g}' for value in damping)} for an OSP level of {against}, "
                "so the device would not be Delta_D-OSP at the declared level",
                "a damping in N·s/m with diag(damping) - osp positive semidefinite, or a smaller osp",
            )
        return damping

    @field_validator("limits", "hand", mode="wrap")
    @classmethod
    def _on_every_axis(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> object:
        """Tell limits and hand how many axes there are; without a valid ``dof`` nothing can be checked against it."""
        if "dof" not in info.data:
            return value
        if info.field_name == "hand":
            driver = info.data.get("driver")
            if value is None and driver == _TRACE:
                return None
            if driver == _BROWSER and (value is None or isinstance(value, Mapping)):
                value = {**BROWSER_HAND, **(value or {})}
        written = DEFAULT_HAND if value is None else value
        return handler({**written, DEVICE_AXES: info.data["dof"]} if isinstance(written, Mapping) else written)

    @model_validator(mode="after")
    def _is_moved_by_its_driver(self) -> Self:
        if problems := tuple(self._problems()):
            raise refusal(*problems)
        return self

    def _problems(self) -> Iterator[Problem]:
        """What the driver lacks, and what it has no use for."""
        here = f"with 'driver: {self.driver}'"
        if self.driver == _TRACE:
            if self.trace is None:
                yield Problem((), f"no key 'trace' {here}", "trace, the recorded motion, such as {file: run.mcap}")
            for key in ("mass", "damping", "hand"):
                if getattr(self, key) is not None:
                    expected = f"no {key}: a recorded motion moves the device whatever acts on it"
                    yield Problem((key,), f"{key} {here}", expected)
            return
        if self.trace is not None:
            yield Problem(("trace",), f"trace {here}", "'driver: trace', or no trace")
        if self.mass is None:
            yield Problem((), "no key 'mass'", f"mass, {type(self).model_fields['mass'].description}")
        if self.driver == _BROWSER and self.hand is not None:
            for key in ("force", "motion"):
                if any(intent != 0.0 for intent in getattr(self.hand, key)):
                    expected = f"no {key}: the person at the browser is who intends something"
                    yield Problem(("hand", key), f"{key} {here}", expected)
            if 0.0 in self.hand.stiffness:
                expected = "a stiffness in N/m greater than 0: it is what holds the device to the pointer"
                yield Problem(("hand", "stiffness"), f"0 {here}", expected)
