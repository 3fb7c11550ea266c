"""What a session asks of the design: the class of couplings, the objective, and couplings that are given."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Final, Literal, Self, TypeAlias

from pydantic import BeforeValidator, Field, model_validator

from manyhands.launch.session.error import listed, one_of, show
from manyhands.launch.session.fields import (
    Choice,
    Items,
    NamedParts,
    Problem,
    Quantity,
    SessionModel,
    Whole,
    each_named,
    optional,
    part_name,
    refusal,
    refuse,
)
from manyhands.launch.session.given import BlockMatrices, OneOrMany, given_problems, one_or_many
from manyhands.launch.session.limits import (
    LONGEST_PERIOD,
    MAX_COUPLINGS,
    MAX_ITERATIONS,
    MAX_ORDER,
    MAX_POLES,
    MAX_PORT_ORDER,
    MAX_RUNGS,
    MIN_POSITIVE,
)
from manyhands.launch.session.rational import Rational
from manyhands.launch.session.weights import Weight, Weights

Blocks: TypeAlias = Mapping[str, tuple[str, ...]]
"""The ports of each coupling."""

_FREQUENCY: Final = Quantity("a natural frequency", "rad/s", above=0.0, smallest=MIN_POSITIVE)
_RATIO: Final = Quantity("a damping ratio", above=0.0, most=1.0, smallest=MIN_POSITIVE)
_DELAY: Final = Quantity("a delay inside the tick", "s", least=0.0, most=LONGEST_PERIOD)
_DELAYS: Final = Items("delays", MAX_RUNGS, _DELAY, least=0)
_ORDER: Final = Whole("states for each port", 1, MAX_PORT_ORDER)
_ORDERS: Final = NamedParts(part_name("a coupling name"), MAX_COUPLINGS)
_COUPLINGS: Final = ("spring-damper", "linear", "given", "none")
_OBJECTIVES: Final = ("feasible", "stiffest", "loop-shaping", "closed-loop")
_TRANSPARENCY: Final = ("loop-shaping", "closed-loop")


def _order(value: object) -> object:
    """One number for all blocks, or one for each."""
    if not isinstance(value, Mapping):
        return _ORDER(value)
    _ORDERS(value)
    return each_named(_ORDER, value)


class Pole(SessionModel):
    """A pair of fixed poles, s^2 + 2 damping frequency s + frequency^2 = 0; a double real one with damping 1."""

    frequency: Annotated[float, BeforeValidator(_FREQUENCY)] = Field(description="the natural frequency in rad/s")
    damping: Annotated[float, BeforeValidator(_RATIO)] = Field(
        default=1.0, description="the damping ratio, greater than 0 and at most 1"
    )


class Design(SessionModel):
    """Which virtual coupling the session runs with, and by which aim it is chosen."""

    coupling: Annotated[Literal["spring-damper", "linear", "given", "none"], BeforeValidator(Choice(_COUPLINGS))] = (
        Field(description="the class of the coupling: spring-damper, linear, given or none")
    )
    order: Annotated[int | dict[str, int] | None, BeforeValidator(optional(_order))] = Field(
        default=None, description="the states of a linear coupling for each of its ports: a number, or one by coupling"
    )
    poles: Annotated[tuple[Pole, ...] | None, BeforeValidator(optional(Items("poles", MAX_POLES)))] = Field(
        default=None, description="fixed pole pairs of a linear coupling, in place of a search"
    )
    algorithm: Annotated[
        Literal["convex", "complementarity"], BeforeValidator(Choice(("convex", "complementarity")))
    ] = Field(default="convex", description="how the coupling is found: convex or complementarity")
    objective: Annotated[
        Literal["feasible", "stiffest", "loop-shaping", "closed-loop"], BeforeValidator(Choice(_OBJECTIVES))
    ] = Field(
        default="feasible", description="what the design aims at: feasible, stiffest, loop-shaping or closed-loop"
    )
    weights: Weights | None = Field(default=None, description="the weights W1, W2 of loop-shaping or closed-loop")
    tau: Annotated[float, BeforeValidator(_DELAY)] = Field(
        default=0.0, description="the delay inside the tick that the certificate is to allow, in s"
    )
    ladder: Annotated[tuple[float, ...] | None, BeforeValidator(optional(_DELAYS))] = Field(
        default=None, description="longer delays, growing, for each of which a softer coupling is held ready, in s"
    )
    iterations: Annotated[int | None, BeforeValidator(optional(Whole("iterations", 1, MAX_ITERATIONS)))] = Field(
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
        BeforeValidator(optional(NamedParts(part_name("a coupling name"), MAX_COUPLINGS))),
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
    def wanted(self) -> bool:
        """Whether the coupling is to be found."""
        return self.coupling in ("spring-damper", "linear")

    def order_of(self, block: str) -> int:
        """States for each port of a block of a linear coupling."""
        return self.order[block] if isinstance(self.order, dict) else self.order or 0

    @model_validator(mode="after")
    def _given_where_it_belongs(self) -> Self:
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
    def _every_key_has_its_use(self) -> Self:
        if problems := [*self._search_problems(), *self._objective_problems(), *self._ladder_problems()]:
            raise refusal(*problems)
        return self

    def _search_problems(self) -> Iterator[Problem]:
        """Keys that say how a coupling is found, where they say nothing or contradict each other."""
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

    def _ladder_problems(self) -> Iterator[Problem]:
        """Delays that do not grow, or that nothing is held ready for."""
        if self.ladder and self.coupling == "none":
            yield Problem(("ladder",), "a ladder with 'coupling: none'", "a coupling, or no ladder")
        before, name = self.tau, "tau"
        for index, delay in enumerate(self.ladder or ()):
            if not delay > before:
                yield Problem(("ladder", index), f"{show(delay)} after {name} {show(before)}", "delays that grow, in s")
                return
            before, name = delay, "the delay"

    def _objective_problems(self) -> Iterator[Problem]:
        """An objective that the coupling leaves nothing to do for, and weights that the objective does not use."""
        allowed: tuple[str, ...] = _OBJECTIVES
        if self.coupling == "given":
            allowed = ("feasible", *_TRANSPARENCY)  # the level of a given coupling may be asked for
        elif self.coupling == "none":
            allowed = ("feasible",)
        if self.objective not in allowed:
            found = f"{self.objective} with 'coupling: {self.coupling}'"
            yield Problem(("objective",), found, f"{one_of(allowed, None)}, or a coupling to be found")
        if self.weights is not None and self.objective not in _TRANSPARENCY:
            found = f"weights with 'objective: {self.objective}'"
            yield Problem(("weights",), found, "'objective: loop-shaping' or 'closed-loop', or no weights")

    def problems(self, ports: tuple[str, ...], blocks: Blocks, period: float) -> Iterator[Problem]:
        """What does not fit a session with these ports, these ports of each coupling, and this period (s)."""
        if self.tau > period:
            yield Problem(("tau",), f"{show(self.tau)} with a period of {period:g} s", "at most the period")
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
