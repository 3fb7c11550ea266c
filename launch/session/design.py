"""The key ``design`` of a session file: the class of couplings, the objective, its weights, and given couplings.

A given coupling is K and B, each a number, a list or a matrix, or a state space for each block. The weights W1 and W2
belong to the transparency objectives,

    (23): || W1 (F(E, V) - E) W2 ||,   (24): || W1 E V W2 ||    ([Bianchini2010]_),

and are given by their coefficients or by the band that they emphasise. One scalar weight applies to all ports. It must
be stable and proper, and then backward Euler keeps it stable.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal, Self, TypeAlias

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from manyhands.design.series import MOST
from manyhands.launch.session.errors import listed, one_of, show
from manyhands.launch.session.fields import (
    Described,
    Items,
    NamedParts,
    Problem,
    Quantity,
    Rows,
    SessionModel,
    Whole,
    each,
    each_named,
    part_name,
    problems_of,
    refusal,
    refuse,
    unsymmetric,
)
from manyhands.launch.session.forms import either, list_of, where, without
from manyhands.launch.session.limits import (
    LONGEST_PERIOD,
    MAX_COUPLINGS,
    MAX_ITERATIONS,
    MAX_ORDER,
    MAX_POLES,
    MAX_PORT_ORDER,
    MAX_PORTS,
    MAX_RUNGS,
    MIN_POSITIVE,
)
from manyhands.launch.session.matrices import (
    COEFFICIENTS,
    D_OR_STATIC,
    STATIC_MEANING,
    Array,
    MatrixRows,
    OptionalRows,
    Rational,
    is_hurwitz,
    one_of_two,
    size_problems,
    trimmed,
)

OneOrMany: TypeAlias = float | tuple[float, ...] | Rows
"""A number for all ports, one for each port, or a matrix."""


def one_or_many(what: Quantity) -> Described:
    """The check of a value that is a number, a list or a matrix of ``what``."""
    numbers = Items("numbers, one for each port", MAX_PORTS, what)
    rows = Items(f"rows of {what.what}", MAX_PORTS, Items("entries of a row", MAX_PORTS, what))

    def check(value: object) -> object:
        if not isinstance(value, list | tuple):
            return what(value)
        return rows(value) if any(isinstance(row, list | tuple) for row in value) else numbers(value)

    form = either(what.json_schema, numbers.json_schema, rows.json_schema)
    return Described(check, form)


class BlockMatrices(SessionModel):
    """A given coupling block V in discrete time: xi+ = A xi + B f_v, tool displacement = C xi + D f_v.

    With n states and m ports, A is n x n, B is n x m, C is m x n and D is m x m, in m and N. A static block has
    no states: ``A: [], B: [], C: []``.
    """

    model_config = ConfigDict(json_schema_extra=D_OR_STATIC)

    A: MatrixRows = Field(description="the n x n matrix A, as rows")
    B: MatrixRows = Field(description="the n x m matrix B, as rows")
    C: MatrixRows = Field(description="the m x n matrix C, as rows")
    D: OptionalRows = Field(default=None, description="the m x m matrix D, as rows")
    static: OptionalRows = Field(default=None, description=STATIC_MEANING)

    def problems(self, ports: int) -> Iterator[Problem]:
        """A problem for each matrix whose size does not fit a block of ``ports`` ports."""
        return size_problems(self.A, self.B, self.C, self.D, self.static, ports, MAX_ORDER)

    @model_validator(mode="after")
    def _d_or_static(self) -> Self:
        one_of_two(self.D, self.static)
        return self


def given_problems(
    value: OneOrMany, ports: tuple[str, ...], block_of: Mapping[str, str], definite: bool
) -> Iterator[Problem]:
    """Problems of a given value for these ports and their couplings; a ``definite`` value must be positive definite."""
    m = len(ports)
    rows = value if isinstance(value, tuple) else (value,) * m
    if len(rows) != m or any(isinstance(row, tuple) and len(row) != m for row in rows):
        expected = f"a number, {m} numbers, or {m} rows of {m}, for the ports {listed(ports)}"
        yield Problem((), f"{len(rows)} {'rows' if isinstance(rows[0], tuple) else 'numbers'}", expected)
        return
    if isinstance(rows[0], tuple):
        matrix: Any = rows
        if problem := unsymmetric(matrix):
            yield problem
        array = np.array(matrix)
        for i, j in zip(*np.nonzero(np.triu((array != 0.0) | (array.T != 0.0), 1)), strict=True):
            a, b = ports[i], ports[j]
            if block_of[a] != block_of[b]:
                where = f"between {a!r} of coupling {block_of[a]!r} and {b!r} of coupling {block_of[b]!r}"
                expected = "0 between ports of different couplings, or one coupling with both ports"
                yield Problem((int(i), int(j)), f"{array[i, j] or array[j, i]:g} {where}", expected)
    least = float(np.linalg.eigvalsh(full_matrix(value, m))[0]) if isinstance(rows[0], tuple) else min(rows)
    if definite and least <= 0.0:
        yield Problem((), f"a stiffness with the eigenvalue {least:.3g}", "a positive definite stiffness in N/m")


def full_matrix(value: OneOrMany, ports: int) -> Array:
    """A number, a list or a matrix as a matrix, ``ports`` x ``ports``."""
    array = np.array(value, dtype=np.float64)
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, (ports,)))


_EDGE: Final = Quantity("an edge of the band", "Hz", least=0.0, smallest=MIN_POSITIVE)
_FORMS: Final = "{num: [...], den: [...]} in s, or {emphasise: [low, high]} in Hz"


def _band(value: object) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise refuse(show(value), "the two edges of a band, [low, high] in Hz")
    low, high = each(_EDGE, value)
    if low >= high:
        raise refuse(f"a band from {low:g} to {high:g} Hz", "[low, high] in Hz with low less than high")
    return low, high


_BAND: Final = Described(_band, list_of(_EDGE.json_schema, 2, 2))


class Weight(SessionModel):
    """A stable, proper, scalar weight, in continuous time.

    ``emphasise: [0, f]`` is the low-pass 1/(1 + s/w), w = 2 pi f; ``emphasise: [f1, f2]`` the band-pass

        (w2 - w1) s / (s^2 + (w2 - w1) s + w1 w2),    w1 = 2 pi f1, w2 = 2 pi f2,

    whose gain is 1 at sqrt(w1 w2) and 1/sqrt(2) at both edges.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [
                {"required": ["num", "den"], **without("emphasise")},
                {"required": ["emphasise"], **without("num", "den")},
            ]
        }
    )

    num: Annotated[tuple[float, ...] | None, COEFFICIENTS] = Field(
        default=None, description="coefficients of the numerator, the highest power of s first"
    )
    den: Annotated[tuple[float, ...] | None, COEFFICIENTS] = Field(
        default=None, description="coefficients of the denominator, the highest power of s first"
    )
    emphasise: Annotated[tuple[float, float] | None, _BAND] = Field(
        default=None, description="the band [low, high] in Hz, in place of num and den"
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        written = [name for name in ("num", "den") if getattr(self, name) is not None]
        if self.emphasise is not None:
            if written:
                raise refuse(f"emphasise besides {written[0]}", _FORMS, at=("emphasise",))
            return self
        if len(written) != 2:
            raise refuse(f"{written[0]} alone" if written else "nothing in it", _FORMS)
        return self

    @model_validator(mode="after")
    def _stable_and_proper(self) -> Self:
        if self.num is None or self.den is None:
            return self
        weight = self.rational
        if -1 in weight.degrees:
            name = "den" if weight.degrees[1] < 0 else "num"
            raise refuse("coefficients that are all 0", "a coefficient other than 0", at=(name,))
        if not weight.proper:
            num, den = weight.degrees
            found = f"an improper weight, of degree {num} over {den}"
            raise refuse(found, "a numerator of no higher degree than the denominator", at=("num",))
        if not is_hurwitz(self.den):
            with np.errstate(all="ignore"):
                rightmost = max(np.roots(trimmed(self.den)), key=lambda root: float(root.real))
            found = f"an unstable weight, with a pole at about {rightmost:.3g} rad/s"
            raise refuse(found, "every pole in the open left half plane", at=("den",))
        return self

    @property
    def rational(self) -> Rational:
        """The weight as a rational function of s."""
        if self.emphasise is None:
            return Rational(num=self.num or (), den=self.den or ())
        low, high = (2.0 * math.pi * edge for edge in self.emphasise)
        if low == 0.0:
            return Rational(num=(1.0,), den=(1.0 / high, 1.0))
        return Rational(num=(high - low, 0.0), den=(1.0, high - low, low * high))


_NEUTRAL: Final = Weight(num=(1.0,), den=(1.0,))


class Weights(SessionModel):
    """The two weights of an objective; an absent weight is 1."""

    W1: Weight = Field(default=_NEUTRAL, description="the weight W1, at the output")
    W2: Weight = Field(default=_NEUTRAL, description="the weight W2, at the input")


Blocks: TypeAlias = Mapping[str, tuple[str, ...]]
"""The ports of each coupling."""

_FREQUENCY: Final = Quantity("a natural frequency", "rad/s", above=0.0, smallest=MIN_POSITIVE)
_RATIO: Final = Quantity("a damping ratio", above=0.0, most=1.0, smallest=MIN_POSITIVE)
_DELAY: Final = Quantity("a delay inside the tick", "s", least=0.0, most=LONGEST_PERIOD)
_SPEED_BELOW: Final = Quantity("a speed", "m/s", above=0.0, smallest=MIN_POSITIVE)
_TOLERANCE: Final = Quantity("a part of the period", least=0.0, most=1.0)
_DELAYS: Final = Items("delays", MAX_RUNGS, _DELAY, least=0)
AUTO: Final = "auto"
"""The word in place of a value that the machine decides, such as a delay that is to be measured."""
_PART: Final = Quantity("a part", above=0.0, most=MOST)
_ORDER: Final = Whole("states for each port", 1, MAX_PORT_ORDER)
_ORDERS: Final = NamedParts(part_name("a coupling name"), MAX_COUPLINGS)
TRANSPARENCY: Final = ("loop-shaping", "closed-loop")
"""The objectives that need the environment's dynamics."""
_FOUND: Final = ("spring-damper", "linear")
"""The couplings that a design has to find."""
_OBJECTIVES_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "given": ("feasible", *TRANSPARENCY),  # the level of a given coupling may be asked for
    "none": ("feasible",),
}
"""The objectives of the couplings that are not found; all others have every one."""


def _delay(value: object) -> object:
    """A delay in s, or the word for one that is to be measured."""
    if value == AUTO:
        return value
    try:
        return _DELAY(value)
    except PydanticCustomError as error:
        either = [problem._replace(expected=f"{problem.expected}, or {AUTO}") for problem in problems_of(error)]
        raise refusal(*either) from None


def _series(value: object) -> object:
    """Whether compliance of the world is counted in series; or the greatest part of it that is counted."""
    if isinstance(value, bool):
        return value
    try:
        return _PART(value)
    except PydanticCustomError as error:
        either = [problem._replace(expected=f"{problem.expected}, or true or false") for problem in problems_of(error)]
        raise refusal(*either) from None


def _order(value: object) -> object:
    """One number for all blocks, or one for each."""
    if not isinstance(value, Mapping):
        return _ORDER(value)
    _ORDERS(value)
    return each_named(_ORDER, value)


_TAU_FORM: Final = either(_DELAY.json_schema, {"const": AUTO})
_SERIES_FORM: Final = either({"type": "boolean"}, _PART.json_schema)
_ORDER_FORM: Final = either(_ORDER.json_schema, {**_ORDERS.json_schema, "additionalProperties": _ORDER.json_schema})


_EVERY_KEY_IS_USED: Final[list[Any]] = [
    {"if": where("coupling", "linear"), "then": {"required": ["order"]}, "else": without("order", "poles")},
    {
        "if": where("coupling", "given"),
        "then": {
            "oneOf": [
                {"required": ["stiffness"], **without("matrices")},
                {"required": ["matrices"], **without("stiffness", "damping")},
            ]
        },
        "else": without("stiffness", "damping", "matrices"),
    },
    {"if": where("objective", *TRANSPARENCY), "else": without("weights")},
    {
        "if": where("algorithm", "complementarity"),
        "then": {"properties": {"objective": {"const": "feasible"}, "coupling": {"enum": [*_FOUND]}, "poles": False}},
        "else": without("iterations"),
    },
    {"if": where("coupling", *_FOUND), "else": {"properties": {"series": {"const": False}}}},
    *(
        {"if": where("coupling", coupling), "then": {"properties": {"objective": {"enum": [*objectives]}}}}
        for coupling, objectives in _OBJECTIVES_OF.items()
    ),
]
"""The form of what the validators of :class:`Design` ask for."""


class Pole(SessionModel):
    """A pair of fixed poles, s^2 + 2 damping frequency s + frequency^2 = 0; damping 1 makes a double real pole."""

    frequency: Annotated[float, _FREQUENCY] = Field(description="the natural frequency in rad/s")
    damping: Annotated[float, _RATIO] = Field(
        default=1.0, description="the damping ratio, greater than 0 and at most 1"
    )


class Design(SessionModel):
    """Which virtual coupling the session runs with, and the objective by which it is chosen."""

    model_config = ConfigDict(json_schema_extra={"allOf": _EVERY_KEY_IS_USED})

    coupling: Literal["spring-damper", "linear", "given", "none"] = Field(
        description="the class of the coupling: spring-damper, linear, given or none"
    )
    order: Annotated[int | dict[str, int] | None, Described(_order, _ORDER_FORM)] = Field(
        default=None, description="the states of a linear coupling for each of its ports: a number, or one by coupling"
    )
    poles: Annotated[tuple[Pole, ...] | None, Items("poles", MAX_POLES)] = Field(
        default=None, description="fixed pole pairs of a linear coupling, in place of a search"
    )
    algorithm: Literal["convex", "complementarity"] = Field(
        default="convex", description="how the coupling is found: convex or complementarity"
    )
    objective: Literal["feasible", "stiffest", "loop-shaping", "closed-loop"] = Field(
        default="feasible", description="what the design aims at: feasible, stiffest, loop-shaping or closed-loop"
    )
    weights: Weights | None = Field(default=None, description="the weights W1, W2 of loop-shaping or closed-loop")
    tau: Annotated[float | Literal["auto"] | None, Described(_delay, _TAU_FORM)] = Field(
        default=None, description="the delay inside the tick that the certificate is to allow, in s; auto to measure it"
    )
    period_tolerance: Annotated[float, _TOLERANCE] = Field(
        default=0.0,
        description="by which part of the period the time between two samples may be longer, as the certificate is to "
        "allow",
    )
    speed: Annotated[float | None, _SPEED_BELOW] = Field(
        default=None,
        description="a speed in m/s on every axis: the devices' dry friction counts as damping, and the certificate "
        "holds below it only",
    )
    series: Annotated[bool | float, Described(_series, _SERIES_FORM)] = Field(
        default=False,
        description="whether the spring by which a port meets the world is counted in series with its coupling; or the "
        "greatest part of it that is counted; of a world given by matrices or rational functions, the greatest springs "
        "that leave it passive",
    )
    ladder: Annotated[tuple[float, ...] | None, _DELAYS] = Field(
        default=None, description="longer delays, growing, for each of which a softer coupling is held ready, in s"
    )
    iterations: Annotated[int | None, Whole("iterations", 1, MAX_ITERATIONS)] = Field(
        default=None, description="the most iterations of complementarity"
    )
    stiffness: Annotated[OneOrMany | None, one_or_many(Quantity("a stiffness", "N/m"))] = Field(
        default=None, description="the given stiffness K in N/m: a number, one for each port, or a matrix"
    )
    damping: Annotated[OneOrMany | None, one_or_many(Quantity("a damping", "N·s/m"))] = Field(
        default=None, description="the given damping B in N·s/m: a number, one for each port, or a matrix"
    )
    matrices: Annotated[
        dict[str, BlockMatrices] | None,
        NamedParts(part_name("a coupling name"), MAX_COUPLINGS),
    ] = Field(default=None, description="the given matrices A, B, C, D of every coupling")

    @property
    def W1(self) -> Rational:
        """The weight W1 as a function of s; 1 where none is written."""
        return (self.weights or Weights()).W1.rational

    @property
    def W2(self) -> Rational:
        """The weight W2 as a function of s; 1 where none is written."""
        return (self.weights or Weights()).W2.rational

    @property
    def stated_tau(self) -> float | None:
        """The delay that the session states, s; ``None`` where it states none, or one to be measured."""
        return None if self.tau is None or isinstance(self.tau, str) else self.tau

    @property
    def counted(self) -> float | None:
        """The greatest part of the world's compliance that is counted in series; ``None`` where nothing is counted."""
        if isinstance(self.series, bool):
            return MOST if self.series else None
        return self.series

    @property
    def wanted(self) -> bool:
        """Whether the design has to find the coupling, rather than take a given one or none."""
        return self.coupling in _FOUND

    def order_of(self, block: str) -> int:
        """States for each port of this block of a linear coupling; 0 for other couplings."""
        return self.order[block] if isinstance(self.order, dict) else self.order or 0

    @model_validator(mode="after")
    def _given_fits_the_coupling(self) -> Self:
        given = [name for name in ("stiffness", "damping", "matrices") if getattr(self, name) is not None]
        if self.coupling != "given" and given:
            found = f"{given[0]} with 'coupling: {self.coupling}'"
            raise refuse(found, f"'coupling: given', or no {given[0]}", at=(given[0],))
        if self.coupling == "given" and self.matrices is None and self.stiffness is None:
            found = "damping without stiffness" if given else "'coupling: given' without anything given"
            raise refuse(found, "stiffness (and damping), or matrices")
        if self.matrices is not None and len(given) > 1:
            raise refuse(f"matrices besides {given[0]}", "either stiffness and damping, or matrices", at=("matrices",))
        return self

    @model_validator(mode="after")
    def _every_key_is_used(self) -> Self:
        if problems := [
            *self._search_problems(),
            *self._objective_problems(),
            *self._series_problems(),
            *self._ladder_problems(),
        ]:
            raise refusal(*problems)
        return self

    def _search_problems(self) -> Iterator[Problem]:
        """Keys about the search for a coupling that have no use here, or contradict each other."""
        here = f"with 'coupling: {self.coupling}'"
        if self.coupling == "linear" and self.order is None:
            yield Problem((), "'coupling: linear' without order", "order, the states for each port of a coupling")
        if self.coupling != "linear":
            for name in ("order", "poles"):
                if getattr(self, name) is not None:
                    yield Problem((name,), f"{name} {here}", f"'coupling: linear', or no {name}")
        elif self.poles is not None and self.algorithm == "complementarity":
            yield Problem(("poles",), "poles with 'algorithm: complementarity'", "'algorithm: convex', or no poles")
        elif self.poles is not None and self.order is not None:
            orders = self.order.values() if isinstance(self.order, dict) else (self.order,)
            if wrong := [order for order in orders if order != 2 * len(self.poles)]:
                found = f"{2 * len(self.poles)} poles, in pairs, for order {wrong[0]}"
                yield Problem(("poles",), found, f"as many poles as the order, or order: {2 * len(self.poles)}")
        if self.algorithm == "complementarity":
            if not self.wanted:
                yield Problem(("algorithm",), f"complementarity {here}", "'coupling: spring-damper' or 'linear'")
            elif self.objective != "feasible":
                found = f"complementarity with 'objective: {self.objective}'"
                yield Problem(("algorithm",), found, "'objective: feasible', or 'algorithm: convex'")
        elif self.iterations is not None:
            found = "iterations with 'algorithm: convex'"
            yield Problem(("iterations",), found, "'algorithm: complementarity', or no iterations")

    def _series_problems(self) -> Iterator[Problem]:
        """Counting in series without a coupling to be found, which contains what is counted."""
        if self.counted is not None and not self.wanted:
            found = f"{show(self.series)} with 'coupling: {self.coupling}'"
            yield Problem(("series",), found, "'coupling: spring-damper' or 'linear', or series: false")

    def _ladder_problems(self) -> Iterator[Problem]:
        """Delays that do not grow, or that belong to no coupling."""
        if self.ladder and self.coupling == "none":
            yield Problem(("ladder",), "a ladder with 'coupling: none'", "a coupling, or no ladder")
        before, name = self.stated_tau or 0.0, "tau"
        for index, delay in enumerate(self.ladder or ()):
            if not delay > before:
                yield Problem(("ladder", index), f"{show(delay)} after {name} {show(before)}", "delays that grow, in s")
                return
            before, name = delay, "the delay"

    def _objective_problems(self) -> Iterator[Problem]:
        """An objective that does not apply to the coupling, and weights that the objective does not use."""
        allowed = _OBJECTIVES_OF.get(self.coupling)
        if allowed is not None and self.objective not in allowed:
            found = f"{self.objective} with 'coupling: {self.coupling}'"
            yield Problem(("objective",), found, f"{one_of(allowed, None)}, or a coupling to be found")
        if self.weights is not None and self.objective not in TRANSPARENCY:
            found = f"weights with 'objective: {self.objective}'"
            yield Problem(("weights",), found, "'objective: loop-shaping' or 'closed-loop', or no weights")

    def problems(self, ports: tuple[str, ...], blocks: Blocks, period: float) -> Iterator[Problem]:
        """The problems in a session with these ports, these blocks (ports of each coupling) and this period (s)."""
        if (tau := self.stated_tau) is not None and tau > period:
            yield Problem(("tau",), f"{show(tau)} with a period of {period:g} s", "at most the period")
        if self.ladder and self.ladder[-1] > period:
            found = f"{show(self.ladder[-1])} with a period of {period:g} s"
            yield Problem(("ladder", len(self.ladder) - 1), found, "at most the period")
        for name in ("W1", "W2"):
            weight: Weight | None = getattr(self.weights, name, None)
            if weight is not None and weight.emphasise is not None and weight.emphasise[1] * period > 0.5:
                found = f"a band up to {weight.emphasise[1]:g} Hz with a period of {period:g} s"
                expected = f"a high edge of at most {0.5 / period:g} Hz, half the rate of ticks"
                yield Problem(("weights", name, "emphasise"), found, expected)
        yield from self._order_problems(blocks)
        block_of = {port: name for name, block in blocks.items() for port in block}
        for field in ("stiffness", "damping"):
            value: OneOrMany | None = getattr(self, field)
            if value is not None:
                for problem in given_problems(value, ports, block_of, definite=field == "stiffness"):
                    yield problem._replace(at=(field, *problem.at))
        if self.matrices is None:
            return
        for name in self.matrices:
            if name not in blocks:
                yield Problem(("matrices", name), f"the unknown coupling {name!r}", one_of(blocks, name))
        for name, block in blocks.items():
            if name not in self.matrices:
                yield Problem(("matrices",), f"no matrices for {name!r}", f"matrices for {listed(blocks)}")
                continue
            for problem in self.matrices[name].problems(len(block)):
                yield problem._replace(at=("matrices", name, *problem.at))

    def _order_problems(self, blocks: Blocks) -> Iterator[Problem]:
        if self.order is None:
            return
        by_name = isinstance(self.order, dict)
        if isinstance(self.order, dict):
            for name in self.order:
                if name not in blocks:
                    yield Problem(("order", name), f"the unknown coupling {name!r}", one_of(blocks, name))
            for name in blocks:
                if name not in self.order:
                    yield Problem(("order",), f"no order for {name!r}", f"an order for {listed(blocks)}")
                    return
        for name, block in blocks.items():
            states = self.order_of(name) * len(block)
            if states > MAX_ORDER:
                found = f"{states} states of the coupling {name!r} with {len(block)} ports"
                yield Problem(("order", name) if by_name else ("order",), found, f"at most {MAX_ORDER} states")
