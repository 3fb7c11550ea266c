"""The key ``wave_link`` of a coupling: the user reaches the world through a wave link, and not inside the tick.

A wave link is a passive two-port between the coupling and the environment, with a matrix b, its wave impedance. Over a
round trip of R seconds it is felt as a mass M = b R/2 while the tool moves freely, and as a spring 2 b/R in series with
the coupling while the tool is held. So a session states the felt mass that it allows, or b itself. The user's site may
have a period and a delay of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Annotated, Final, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from manyhands.launch.session.design import OneOrMany, full_matrix, given_problems, one_or_many
from manyhands.launch.session.errors import show
from manyhands.launch.session.fields import PERIOD, Problem, Quantity, SessionModel, Whole, refuse
from manyhands.launch.session.forms import one_key_of
from manyhands.launch.session.limits import (
    DEFAULT_WAVE_TANK,
    LARGEST_TANK,
    LONGEST_INTERVAL,
    LONGEST_PERIOD,
    LONGEST_ROUND_TRIP,
    MAX_DEPTH_TICKS,
    MIN_POSITIVE,
)
from manyhands.launch.session.matrices import Array
from manyhands.nodes.kernel.simulated_way import SimulatedWay

_MASS: Final = Quantity("a felt mass", "kg", above=0.0, smallest=MIN_POSITIVE)
_IMPEDANCE: Final = Quantity("an entry of the wave impedance", "N·s/m")
_ROUND_TRIP: Final = Quantity("a round trip", "s", above=0.0, most=LONGEST_ROUND_TRIP, smallest=MIN_POSITIVE)
_INTERVAL: Final = Quantity("a time between waves", "s", above=0.0, most=LONGEST_INTERVAL, smallest=MIN_POSITIVE)
_TANK: Final = Quantity("a tank", "J", least=0.0, most=LARGEST_TANK)
_DELAY: Final = Quantity("a delay inside the tick", "s", least=0.0, most=LONGEST_PERIOD)
_WAY: Final = Quantity("a time under way", "s", least=0.0, most=LONGEST_ROUND_TRIP)
_LOSS: Final = Quantity("a part of the waves", "", least=0.0, most=0.9)
_HARVEST: Final = Quantity("a harvest", "N·s/m", least=0.0)


class SimulatedNetwork(SessionModel):
    """A network for runs under the simulated clock, the same both ways."""

    delay: Annotated[float, _WAY] = Field(default=0.0, description="the least time of a wave under way in s, one way")
    jitter: Annotated[float, _WAY] = Field(
        default=0.0, description="by how much the time under way exceeds it at most in s, each wave by itself"
    )
    loss: Annotated[float, _LOSS] = Field(default=0.0, description="the part of the waves that are lost, at random")
    seed: Annotated[int, Whole("a seed", 0, 2**31 - 1)] = Field(default=1, description="of the chances")


class WaveLink(SessionModel):
    """The wave link between one coupling and the environment."""

    model_config = ConfigDict(json_schema_extra={**one_key_of("mass", "b"), "dependencies": {"mass": ["round_trip"]}})

    mass: Annotated[OneOrMany | None, one_or_many(_MASS)] = Field(
        default=None, description="the felt mass allowed, in kg: a number, or one for each port of the coupling"
    )
    b: Annotated[OneOrMany | None, one_or_many(_IMPEDANCE)] = Field(
        default=None,
        description="in place of mass, the wave impedance in N·s/m: a number, one for each port, or a matrix",
    )
    round_trip: Annotated[float | None, _ROUND_TRIP] = Field(
        default=None, description="the round trip R to design for, play-out included, in s"
    )
    tank: Annotated[float, _TANK] = Field(
        default=DEFAULT_WAVE_TANK, description="the energy E_0 that each end may lend to the waves, in J"
    )
    depth: Annotated[int | None, Whole("ticks", 0, MAX_DEPTH_TICKS)] = Field(
        default=None, description="the depth of the play-out in ticks; measured while joining if it is not given"
    )
    interval: Annotated[float | None, _INTERVAL] = Field(
        default=None,
        description="the time from one wave to the next in s, in whole ticks of each end; it lengthens the round trip. "
        "A wave in every tick if it is not given",
    )
    period: Annotated[float | None, PERIOD] = Field(
        default=None, description="the length of a tick at the user's site in s"
    )
    tau: Annotated[float | None, _DELAY] = Field(
        default=None, description="the delay inside a tick of the user's site that its certificate is to allow, in s"
    )
    harvest: Annotated[OneOrMany, one_or_many(_HARVEST)] = Field(
        default=0.0,
        description="the damping of the user's site that refills its tank, in N·s/m: a number, or one for each port",
    )

    network: SimulatedNetwork | None = Field(
        default=None,
        description="the network of a run under the simulated clock; a wave arrives in its tick if not given",
    )

    @model_validator(mode="after")
    def _mass_or_b(self) -> Self:
        if (self.mass is None) == (self.b is None):
            found = "neither mass nor b" if self.b is None else "both mass and b"
            raise refuse(found, "one of the two: mass, the felt mass allowed, or b, the wave impedance")
        if self.mass is not None and self.round_trip is None:
            raise refuse("mass without round_trip", "round_trip, in s: the wave impedance is 2 mass/round_trip")
        return self

    def problems(self, ports: tuple[str, ...], period: float, tau: float) -> Iterator[Problem]:
        """The problems at a coupling with these ports, in a session with this period (s) and stated delay (s)."""
        for name in ("mass", "b", "harvest"):
            value: OneOrMany | None = getattr(self, name)
            if value is None:
                continue
            wrong = list(given_problems(value, ports, dict.fromkeys(ports, ""), definite=False))
            if name != "b" and isinstance(value, tuple) and any(isinstance(row, tuple) for row in value):
                wrong = [Problem((), "a matrix", "a number, or one for each port")]
            for problem in wrong:
                yield problem._replace(at=(name, *problem.at))
            if (
                name == "b"
                and not wrong
                and (least := float(np.linalg.eigvalsh(full_matrix(value, len(ports)))[0])) <= 0.0
            ):
                found = f"a wave impedance with the eigenvalue {least:.3g}"
                yield Problem((name,), found, "a positive definite wave impedance in N·s/m")
        own, delay = self.period_in(period), tau if self.tau is None else self.tau
        if delay > own:
            place: tuple[str, ...] = ("tau",) if self.tau is not None else ("period",)
            found = f"a delay of {show(delay)} with a period of {own:g} s at the user's site"
            yield Problem(place, found, "a tau of this wave link that is at most the period of its site")

    def period_in(self, session: float) -> float:
        """T of the user's site in a session with this period, s."""
        return session if self.period is None else self.period

    def every(self, period: float) -> int:
        """An end with this period (s) sends a wave in one of so many of its ticks."""
        return 1 if self.interval is None else max(1, round(self.interval / period))

    def way(self, number: int) -> SimulatedWay | None:
        """One direction of :attr:`network`, of so many, each with chances of its own; None where there is none."""
        one = self.network
        return None if one is None else SimulatedWay(one.delay, one.jitter, one.loss, (one.seed << 12) + number)

    def mass_matrix(self, ports: int) -> Array | None:
        """The felt mass allowed, ``ports`` x ``ports`` and diagonal, kg; None if b is given instead."""
        return None if self.mass is None else full_matrix(self.mass, ports)

    def harvest_of(self, ports: int) -> tuple[float, ...]:
        """The harvest theta at each port, N·s/m."""
        return tuple(float(theta) for theta in np.diag(full_matrix(self.harvest, ports)))

    def impedance(self, ports: int) -> Array:
        """b, ``ports`` x ``ports``, N·s/m: as given, or 2 M/R, the greatest whose felt mass is at most M."""
        if self.b is not None:
            return full_matrix(self.b, ports)
        if self.mass is None or self.round_trip is None:
            raise AssertionError("a validated wave link states b, or mass and round_trip")
        R = self.round_trip
        return np.diag([_greatest_impedance(float(M), R) for M in np.diag(full_matrix(self.mass, ports))])


def _greatest_impedance(mass: float, round_trip: float) -> float:
    """2 M/R rounded down, so that b R/2 <= M holds exactly for the decimals of the three numbers."""
    b, M, R = 2.0 * mass / round_trip, Fraction(repr(mass)), Fraction(repr(round_trip))
    while Fraction(repr(b)) * R > 2 * M:
        b = math.nextafter(b, 0.0)
    return b
