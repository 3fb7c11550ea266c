"""The names and figures of telemetry and reports, the same for all nodes.

Lengths of time are in microseconds, energies in joules, speeds in m/s; traces are in m and N.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.passivity import Ledger, PassivityController
from manyhands.protocol.channels import (
    APPLIED,
    DISPLACEMENT,
    FORCE,
    FREE_POSITION,
    INSTANTS,
    INTERFACE,
    LEDGER,
    MASS_POSITION,
    TANK,
    TAU,
    TOOL_POSITION,
    WAVE,
)
from manyhands.protocol.messages import Telemetry

__all__ = [
    "APPLIED",
    "DISPLACEMENT",
    "FORCE",
    "FREE_POSITION",
    "INSTANTS",
    "INTERFACE",
    "LEDGER",
    "MASS_POSITION",
    "TANK",
    "TAU",
    "TOOL_POSITION",
    "WAVE",
]


LEDGER_MIN = "ledger_min"
SPEED = "speed"
PEAK_SPEED = "peak_speed"
FINAL_SPEED = "final_speed"
LATE = "late"
STALE = "stale"
PERIOD = "period_us"
TAU_BREACHES = "tau_breaches"
CLIPPED = "clipped"  # ticks whose force a device clipped: a coupling misbehaves
LET_GO = "let_go"  # times that a device was beyond its displacement or speed, and let go
SATURATED = "saturated"  # ticks whose force a coupling clipped, which the certificate does not cover
REFUSED = "refused_"  # and the reason: connections that the process did not admit
NOT_ADMITTED = "not_admitted"  # connections and frames that were not admitted, in one sum
FROZEN = "frozen"  # couplings that are not active now
FROZEN_TICKS = "frozen_ticks"  # ticks in which any coupling was not active
ABSENCES = "absences"  # times that a coupling was frozen or lost
JUMPS = "jumps"  # times that a node went on at a later tick than its own
RELEASED = "released"  # periods in which a device exerted no force, for none came
RUNG = "rung"  # the present rung of the ladder
CHANGING = "changing"  # couplings whose clutches open because they are to change their rung; absent for none
TAU_WORST = "tau_worst_us"  # since the last telemetry
WAITED_IN = "waited:"  # and the coupling: a trace of the telemetry's ticks in which the others waited for it
WAITED_TICKS = "waited_ticks_"  # and the coupling: ticks in which the others waited for it alone
WAITED_TIME = "waited_us_"  # and the coupling: how long the others waited in them
FROZEN_LATE = "frozen_late_"  # and the coupling: times that it was frozen for being silent
WAIVED = "waived_"  # and the coupling: times that it was late so often that nobody waited for it any more
OVERDUE = "overdue_"  # and the coupling: ticks in which it was held, for its signal had not come
PERIOD_BREACHES = "period_breaches"  # ticks later after the one before than the certificate assumes
DROPPED_TELEMETRY = "dropped_telemetry"
DROPPED_LOG = "dropped_log"
LATE_CAUSE = "late_"  # and the cause: late ticks
REALTIME = "realtime_"  # and the wish: 1 where the machine granted it
LEDGER_MIN_TICK = "ledger_min_tick"  # of the party's own ticks, from 1 on; 0 where it never fell below its beginning
LEDGER_MARGIN = "ledger_margin"  # by how much the least total stayed above the bound, J
GRASPED = "grasped"  # 1 while a person's browser holds the device, else 0
GRASPS = "grasps"  # positions that the pointer sent and the device took
GRASPS_CLIPPED = "grasps_clipped"  # those of them that were beyond the pointer's reach
GRASPS_REFUSED = "grasps_refused"  # messages of the pointer that were no position of this device
GRASPS_LAPSED = "grasps_lapsed"  # times that a pointer fell silent without letting go
GIVEN = "given_"  # and the coupling: J that the others have received of its energy
SUPPLIED = "supplied_"  # and the coupling: J of its own that it has put into the environment
RECEIVED = "received_"  # and the coupling: J that it has received of the others' energy
MOVED = "moved_"  # supplier, "/" and receiver: J
SCALED = "scaled_"  # and the coupling: ticks in which its ratio was below 1, for its energy budget
STOPS = "stops_"  # and the coupling: times that its energy budget stopped it
UNOWNED = "unowned"  # J that users received of the environment's own energy
SUSPENDED = "suspended"  # times that a device's process did not run for 50 ms or more
SUSPENDED_TIME = "suspended_us"  # how long in all
SUSPENDED_ENERGY = "suspended_energy"  # J by which its interface account fell meanwhile
INTERFACE_LEAST = "interface_min"  # J, the least of a device's interface account, at most 0
INTERFACE_MARGIN = "interface_margin"  # J, the least distance of that account from its bound -(E_0 + P t)
QUICKER = "quicker"  # 1 where a device moved further than the stated mass and hand allow, otherwise 0
FORCE_ASKED = "force_asked"  # N*s, the impulse of the forces that a device's couplings asked for within its limits
FORCE_GIVEN = "force_given"  # N*s, of those that it exerted
FORCE_TIME = "force_time_us"  # the time in which a device could be given a force (nodes/device/given.py)
FORCE_AWAY = "force_away_us"  # those of it in which it had no valid answer, or its force rose again after that
FORCE_HELD_BACK = "force_held_back_us"  # those in which the reserve for lateness lowered its force, or ended it early
FORCE_CUT = "force_cut_us"  # those in which a limit cut its force
INTERFACE_TICKS = "interface_ticks"  # ticks in which a device's interface changed a motion or a force
INTERFACE_KEPT_BACK = "interface_kept_back"  # J that the changed motions kept from being lost
INTERFACE_OFFSET = "interface_offset"  # m, the greatest offset between a device and the motion sent
WAVE_LEDGER = (
    "wave_ledger"  # J that entered a wave link at this end; with a coupling's name in the environment's figures
)
WAVE_TANK = "wave_tank"  # J in the tank of this end
WAVE_CLIPPED = "wave_clipped"  # ticks in which the tank limited a wave
WAVE_DEAF = "wave_deaf"  # 1 while no wave has come for so long that this end holds the tool
WAVE_SILENCES = "wave_silences"  # times that this began, after the first wave
WAVE_LAG = "wave_lag_us"  # the sum over both ends is the round trip; one alone says nothing
DRIVER = "driver_"  # and the name that a driver of another package gave it: a figure of its own
UNEXERTED = "unexerted"  # ticks in which a device exerted another force than it was given
UNEXERTED_MOST = "unexerted_most"  # N, the greatest difference of an axis
MEASURED = "measured"  # ticks in which a driver of another package measured the force that its device exerted
UNTRUE = "untrue"  # those of them in which the force was none that it had been given
UNTRUE_MOST = "untrue_most"  # N, by how much it was none of them at most, on any of the driver's axes
ENFORCED_TICKS = "enforced_ticks"  # ticks in which a passivity controller kept a force back
ENFORCED_ENERGY = "enforced_energy"  # J that it kept back
HELD = "held_"  # and the coupling: ticks in which the proxy test held its proxies
REVERSALS = "reversals_"  # and the coupling: ticks in which the force on its tools reversed
CHATTER = "chatter_"  # and the coupling: the most of them in a second
UNFINISHED = "unfinished"  # ticks in which the iteration of a scene's contacts did not end
PAUSED = "paused"  # ticks in which the tank of a scene held its driven bodies
DRIVE_TANK = "drive_tank"  # J that the driven bodies of a scene may still give out


def ledger_figures(ledger: Ledger | None) -> dict[str, float]:
    """The ledger's total, its minimum and the tick of that, and its margin; empty where no level is promised."""
    if ledger is None:
        return {}
    return {
        LEDGER: ledger.total,
        LEDGER_MIN: ledger.minimum,
        LEDGER_MIN_TICK: float(ledger.at),
        LEDGER_MARGIN: ledger.margin,
    }


def ledger_trace(ledger: Ledger | None, totals: Sequence[float]) -> dict[str, NDArray[np.float64]]:
    """The ledger's ``totals`` by tick, J, as a trace of one column; empty where no level is promised."""
    return {} if ledger is None else {LEDGER: np.array(totals)[:, None]}


def enforcement_figures(controller: PassivityController | None) -> dict[str, float]:
    """How often a controller acted, and the energy that it kept back; empty where no level is enforced."""
    if controller is None:
        return {}
    return {ENFORCED_TICKS: float(controller.ticks), ENFORCED_ENERGY: controller.energy}


@dataclass(frozen=True)
class CouplingLateness:
    """How long the others waited for one coupling.

    Attributes:
        ticks: the ticks in which it came after the others, or not at all.
        time: how long the others waited in them, us.
        frozen: how often it was frozen for being silent.
        held: the ticks in which it was held.
        waived: how often it was late so often that nobody waited for it any more.
    """

    ticks: int
    time: float
    frozen: int
    held: int = 0
    waived: int = 0

    def as_plain(self) -> dict[str, float]:
        """As a JSON object for the report; the time in s."""
        counts = {count: getattr(self, count) for count in _LATENESS_COUNTS}
        return {"ticks": self.ticks, "seconds": self.time / 1e6} | counts

    def sentence(self, name: str) -> str:
        """The figures as a sentence; ``name`` is that of the coupling."""
        return (
            f"the others waited for {name} in {self.ticks} ticks, {self.time / 1e6:.3g} s in all, and then no more; "
            f"its tool rested for {self.held} ticks, and it was frozen {self.frozen} times"
        )


_LATENESS_COUNTS: Final = {"ticks": WAITED_TICKS, "frozen": FROZEN_LATE, "held": OVERDUE, "waived": WAIVED}
"""The figures of the counts of a :class:`CouplingLateness`, by field."""


def lateness_counts(lateness: Mapping[str, CouplingLateness]) -> dict[str, int]:
    """The counts of each coupling's lateness."""
    return {
        f"{of}{name}": getattr(one, count) for count, of in _LATENESS_COUNTS.items() for name, one in lateness.items()
    }


def lateness_times(lateness: Mapping[str, CouplingLateness]) -> dict[str, float]:
    """How long the others waited for each coupling, us."""
    return {f"{WAITED_TIME}{name}": one.time for name, one in lateness.items()}


def lateness_of(name: str, counts: Mapping[str, float], figures: Mapping[str, float]) -> CouplingLateness | None:
    """The environment's figures of the coupling ``name``; None where they are missing or out of range."""
    time, ticks = figures.get(WAITED_TIME + name, math.nan), counts.get(WAITED_TICKS + name, math.nan)
    found = {count: counts.get(of + name, 0.0) for count, of in _LATENESS_COUNTS.items()} | {"ticks": ticks}
    if not all(0.0 <= value < math.inf for value in (time, *found.values())) or not found["ticks"] + found["held"]:
        return None
    return CouplingLateness(time=time, **{count: int(value) for count, value in found.items()})


def lateness_by_coupling(counts: Mapping[str, float], figures: Mapping[str, float]) -> dict[str, CouplingLateness]:
    """The environment's figures of every coupling that made the others wait, by its name."""
    by_coupling = {
        key.removeprefix(WAITED_TICKS): lateness_of(key.removeprefix(WAITED_TICKS), counts, figures)
        for key in counts
        if key.startswith(WAITED_TICKS)
    }
    return {name: lateness for name, lateness in by_coupling.items() if lateness is not None}


def shown(telemetry: Telemetry) -> Telemetry:
    """A telemetry as observers see it: without the traces of the ticks in which couplings were late."""
    if not any(name.startswith(WAITED_IN) for name in telemetry.traces):
        return telemetry
    traces = {name: trace for name, trace in telemetry.traces.items() if not name.startswith(WAITED_IN)}
    return Telemetry(telemetry.tick, telemetry.figures, traces)
