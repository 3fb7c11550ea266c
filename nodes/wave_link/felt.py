"""What a user feels of a wave link, and how the link fares, from the figures that its two ends report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from manyhands.design.models.axis import TRANSLATING, AxisKind, Units
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures
from manyhands.protocol.plain import Added, written


@dataclass(frozen=True)
class FeltLink:
    """One wave link, as it is now.

    Attributes:
        round_trip: R, s: the network, the waits for ticks, and the play-out of both ends.
        stiffness: K = 2 b/R, N/m, of the spring in series with the coupling that is felt while the tool is held; of
            several ports, that of the softest direction.
        mass: M = b R/2, kg, that is felt while the tool moves freely; of several ports, that of the heaviest direction.
        tanks: the energy in the tanks of the user's and the world's end, J.
        limited: ticks in which a tank limited a wave, at both ends.
        silences: how often an end heard nothing for so long that it held the tool, at both ends.
        holding: whether an end does so now.
        kinds: what its ports do; stiffness and mass are in the units of these.
    """

    round_trip: float
    stiffness: float
    mass: float
    tanks: tuple[float, float]
    limited: int
    silences: int
    holding: bool
    kinds: Added[tuple[AxisKind, ...]] = ()

    def figures(self) -> str:
        """Round trip, felt stiffness and felt mass, with their units."""
        unit = Units.of(self.kinds)
        felt = f"K = {self.stiffness:.4g} {unit('N/m')}, M = {kilograms(self.mass, unit)}"
        return f"R = {1e3 * self.round_trip:.3g} ms, {felt}"

    def sentence(self, coupling: str, over: bool = False) -> str:
        """The figures as a sentence about the link of ``coupling``.

        Where the run is ``over``, it is no news that an end hears nothing: sites end one after the other.
        """
        tanks, unit = " and ".join(f"{1e3 * tank:.3g}" for tank in self.tanks), Units.of(self.kinds)
        text = (
            f"wave link of {coupling}: a round trip of {1e3 * self.round_trip:.3g} ms is felt as {self.stiffness:.4g} "
            f"{unit('N/m')} in series with the coupling, and as {kilograms(self.mass, unit)}; {tanks} mJ in its tanks"
        )
        if self.limited:
            text += f"; waves limited by a tank in {counted(self.limited, 'tick')}"
        if self.silences:
            text += f"; silent {counted(self.silences, 'time')}"
        return text + ("; an end hears nothing now, and holds the tool" if self.holding and not over else "")

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        plain: dict[str, Any] = written(self)
        return plain


def kilograms(mass: float, units: Units = TRANSLATING) -> str:
    """A mass, kg, for a sentence: in kg, or in g below 1 kg; of ports that turn an inertia."""
    return f"{mass:.3g} {units('kg')}" if mass >= 1.0 else f"{1e3 * mass:.3g} {units('g')}"


def stiffness_and_mass(impedance: tuple[float, float], R: float) -> tuple[float, float]:
    """K = 2 b/R, N/m, in the softest direction, and M = b R/2, kg, in the heaviest.

    Args:
        impedance: the least and the greatest eigenvalue of b, N*s/m.
        R: the round trip, s.
    """
    softest, heaviest = impedance
    return 2.0 * softest / R, 0.5 * heaviest * R


def round_trip(coupling: str, user: Figures, world: Figures) -> float:
    """R, s, of the wave link of ``coupling``, by the figures of its two ends; not a number where one has none.

    Args:
        coupling: its name.
        user: the figures of the coupling.
        world: the figures of the environment.
    """
    ends = user.get(names.WAVE_LAG, math.nan), world.table(names.of(names.WAVE_LAG)).get(coupling, math.nan)
    return 1e-6 * sum(ends)


def felt_link(
    coupling: str,
    impedance: tuple[float, float],
    user: Figures,
    world: Figures,
    kinds: tuple[AxisKind, ...] = (),
) -> FeltLink | None:
    """The wave link of ``coupling``; None where an end has not reported, or figures make no sense.

    Args:
        coupling: its name.
        impedance: the least and the greatest eigenvalue of b, N*s/m.
        user: the figures of the coupling.
        world: the figures of the environment.
        kinds: what the ports of the coupling do.
    """
    R = round_trip(coupling, user, world)
    figures = (names.WAVE_TANK, names.WAVE_CLIPPED, names.WAVE_SILENCES, names.WAVE_HOLDING)
    found = [(user.get(one, math.nan), world.table(names.of(one)).get(coupling, math.nan)) for one in figures]
    if not all(0.0 <= value < math.inf for pair in found for value in pair) or not 0.0 < R < math.inf:
        return None
    tanks, limited, silences, holding = found
    felt = stiffness_and_mass(impedance, R)
    return FeltLink(R, *felt, tanks, int(sum(limited)), int(sum(silences)), any(holding), kinds)
