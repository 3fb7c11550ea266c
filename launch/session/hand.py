"""The simulated hand that holds a simulated device: a passive linear operator and an intention.

The hand answers the device's velocity v (m/s) with a force (N) against it,

    f = force(t) - (H(s) + mass s + damping + stiffness / s) (v - d motion(t)/dt),

and H is refused unless it is passive, since the certificate of a session rests on that (Assumption 1b of
[Bianchini2010]_). Recorded traces are read here, so that a device's process is handed numbers and opens no
file of the session's author.
"""

import functools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from manyhands.design.operators import PassivityFinding, RationalMatrix
from manyhands.launch.session.error import listed, show
from manyhands.launch.session.fields import (
    DAMPING,
    DEVICE_AXES,
    HAND_MASS,
    STIFFNESS,
    Dof,
    Items,
    PerAxis,
    Quantity,
    SessionModel,
    defaulted,
    each,
    matrix,
    refuse,
)
from manyhands.launch.session.limits import MAX_TRACE_ROWS, PROBE_COUNT, PROBE_SECONDS
from manyhands.launch.session.rational import Entry, Rational
from manyhands.launch.session.trace import TraceData, read_trace, trace_from_numbers
from manyhands.nodes.device.formula import ALLOWED, Formula, FormulaError

DEFAULT_HAND: Final[Mapping[str, object]] = {
    "operator": {"num": [0.02, 1.2, 20.0], "den": [1.0, 10.3, 100.0]},
    "force": "2*pulse(t, 0.1, 0.2)",
}
"""The hand of a device that names none: on every axis by itself the operator of Example 1,
0.02 (s^2 + 60 s + 1000)/(s^2 + 10.3 s + 100) in N·s/m, and a push of 2 N between 0.1 s and 0.2 s."""

BROWSER_HAND: Final[Mapping[str, object]] = {"stiffness": 200.0, "damping": 5.0}
"""What of the hand of a device with ``driver: browser`` is not said: 200 N/m and 5 N·s/m, axis by axis."""

_entry: Final = Entry("N·s/m")
_SAMPLES: Final = Items("samples", MAX_TRACE_ROWS, Quantity("a number"))
_PASSIVE: Final = "a passive operator: no eigenvalue of (H(jw) + H(jw)*)/2 below 0 at any frequency w"


def _operator(value: object, info: ValidationInfo) -> object:
    """H(s) as rows of entries; one entry alone stands for itself on every axis, without cross terms."""
    dof: int = info.data.get("dof", 1)
    if isinstance(value, list | tuple):
        return matrix(_entry, value, dof, dof)
    own, cross = _entry(value), Rational(num=(0.0,), den=(1.0,))
    return tuple(tuple(own if i == j else cross for j in range(dof)) for i in range(dof))


@functools.lru_cache(maxsize=256)  # many devices are held by the same hand
def _passivity(operator: RationalMatrix) -> PassivityFinding:
    # coefficients of extreme size may overflow on the way; the finding is then refused as not finite
    with np.errstate(all="ignore"):
        return operator.passivity()


def _intents(what: Quantity) -> Callable[[object, ValidationInfo], object]:
    """Check for an intended force or motion of every axis."""

    def check(value: object, info: ValidationInfo) -> object:
        folder = (info.context or {}).get("folder", Path())
        return PerAxis(lambda intent: _intent(what, intent, folder))(value, info)

    return check


def _intent(what: Quantity, value: object, folder: Path) -> float | str | TraceData:
    """One number, formula, or trace."""
    match value:
        case TraceData():
            return value
        case str():
            _probe(value)
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


@functools.lru_cache(maxsize=256)  # many hands intend the same
def _probe(text: str) -> None:
    """Refuse a formula that is not allowed, or that fails at a time at which most sessions would meet it."""
    try:
        formula = Formula(text)
        for k in range(PROBE_COUNT + 1):
            formula(PROBE_SECONDS * k / PROBE_COUNT)
    except FormulaError as error:
        if error.position is None:
            raise refuse(f"{error.problem} in the formula {show(text)}", "a finite value at every time") from None
        raise refuse(f"{error.problem} at position {error.position} in the formula {show(text)}", ALLOWED) from None


_MASS: Final = PerAxis(HAND_MASS)
_DAMPING: Final = PerAxis(DAMPING)
_STIFFNESS: Final = PerAxis(STIFFNESS)
_FORCE: Final = _intents(Quantity("an intended force", "N"))
_MOTION: Final = _intents(Quantity("an intended motion", "m"))
_AXES: Final = "one for all axes, or a list with one for each"


class Hand(SessionModel):
    """A simulated hand; every tuple has one entry for each axis of the device."""

    dof: Dof = Field(alias=DEVICE_AXES, exclude=True, repr=False)
    operator: Annotated[tuple[tuple[Rational, ...], ...], BeforeValidator(_operator)] = defaulted(
        0.0, "the passive operator H(s) in N·s/m, from velocity to force"
    )
    mass: Annotated[tuple[float, ...], BeforeValidator(_MASS)] = defaulted(0.0, f"an added mass in kg, {_AXES}")
    damping: Annotated[tuple[float, ...], BeforeValidator(_DAMPING)] = defaulted(
        0.0, f"an added damping in N·s/m, {_AXES}"
    )
    stiffness: Annotated[tuple[float, ...], BeforeValidator(_STIFFNESS)] = defaulted(
        0.0, f"a stiffness in N/m, {_AXES}"
    )
    force: Annotated[tuple[float | str | TraceData, ...], BeforeValidator(_FORCE)] = defaulted(
        0.0, f"the intended force in N, {_AXES}"
    )
    motion: Annotated[tuple[float | str | TraceData, ...], BeforeValidator(_MOTION)] = defaulted(
        0.0, f"the intended motion in m, {_AXES}"
    )

    @property
    def rational(self) -> RationalMatrix:
        """H(s) as ``design`` knows it."""
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
