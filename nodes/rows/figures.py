"""The figures that nodes state in their telemetry and reports: each is declared here, once.

A declaration has the figure's name, its unit and what it says, and where people meet it: the key of the report, the
columns of tables, the plot, and the promise that it counts for. Report, `top`, page, health, exports, viewers and the
protocol's document are derived from :data:`FIGURES`. So a new figure is one line here, and the place that counts it.

A figure is a number; or it is a table, with a number for each coupling, percentile, cause or the like
(:class:`~manyhands.protocol.messages.Figures`). Traces, which have a row for each tick, are topics
(:data:`manyhands.protocol.channels.TOPICS`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import Final

from manyhands.nodes.kernel.passivity import Ledger, PassivityController
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.channels import (
    APPLIED,
    DISPLACEMENT,
    FORCE,
    FREE_POSITION,
    INSTANTS,
    INTERFACE,
    LEDGER,
    MASS_POSITION,
    ORIENTATION,
    TANK,
    TAU,
    TOOL_POSITION,
    WAVE,
)
from manyhands.protocol.messages import Role, Telemetry

__all__ = [
    "APPLIED",
    "DISPLACEMENT",
    "FORCE",
    "FREE_POSITION",
    "INSTANTS",
    "INTERFACE",
    "LEDGER",
    "MASS_POSITION",
    "ORIENTATION",
    "TANK",
    "TAU",
    "TOOL_POSITION",
    "WAVE",
]


class Unit(StrEnum):
    """The unit of a figure."""

    TICKS = "ticks"
    TICK = "tick"
    TIMES = "times"
    NUMBER = "1"
    STATE = "0 or 1"
    MICROSECONDS = "us"
    JOULES = "J"
    METRES = "m"
    NEWTONS = "N"
    SPEED = "m/s"
    IMPULSE = "N s"
    OWN = ""

    @property
    def whole(self) -> bool:
        """Whether a figure of this unit is a whole number."""
        return self in (Unit.TICKS, Unit.TIMES, Unit.NUMBER)


class OverLives(Enum):
    """What the figures of a node's processes make together, where a node came back after the end of one."""

    SUM = "their sum"
    GREATEST = "the greatest"
    LEAST = "the least"
    LATEST = "that of the latest process"


class Key(StrEnum):
    """What a table of figures has one number for."""

    COUPLING = "coupling"
    PAIR = "giver/receiver"
    PERCENTILE = "percentile"
    CAUSE = "cause"
    REASON = "reason"
    RIGHT = "right"
    BUTTON = "button"
    OWN = "own name"


@dataclass(frozen=True)
class Column:
    """A column of the tables of nodes.

    Attributes:
        title: its heading, with the unit.
        form: its format, as :func:`format` has it; empty for a share that is made of several figures.
        rank: in a narrow table the columns of the highest rank are left out first.
        key: of the number in the figure's table; empty for a figure that is a number.
    """

    title: str
    form: str
    rank: int
    key: str = ""


@dataclass(frozen=True)
class ReportKey:
    """Where a figure is in a node's part of the report.

    Attributes:
        path: its key, or the key of a group and its own in that.
        needed: whether the group is left out without it.
        positive: whether it is left out where it is 0.
        scale: what its numbers are multiplied by.
    """

    path: tuple[str, ...]
    needed: bool = False
    positive: bool = False
    scale: float = 1.0


@dataclass(frozen=True)
class Figure:
    """The declaration of a figure.

    Attributes:
        name: as telemetry, reports and recordings have it.
        unit: of its numbers.
        says: what it counts or measures, to follow its unit.
        key: what its table has one number for; None for a figure that is a number.
        report: where the report has it; None for nowhere, or where another part of the report is made of it.
        columns: the columns that show it.
        plot: the title of its plot in viewers, and the role of the nodes that are drawn.
        promise: what is not kept whenever a node's own figure grows; a figure in J is the cost of that.
        promise_of: likewise for a table of the environment, about the coupling.
        lives: what its numbers of several processes make together; None for what follows from the unit: counts and
            impulses are added, and of all else the latest counts.
        beside: the figure in J whose least it belongs to, and with which it is that of the same process; or empty.
    """

    name: str
    unit: Unit
    says: str
    key: Key | None = None
    report: ReportKey | None = None
    columns: tuple[Column, ...] = ()
    plot: tuple[str, Role] | None = None
    promise: Promise | None = None
    promise_of: Promise | None = None
    lives: OverLives | None = None
    beside: str = ""

    @property
    def over_lives(self) -> OverLives:
        """What its numbers of several processes of a node make together."""
        if self.lives is not None:
            return self.lives
        added = self.unit in (Unit.TICKS, Unit.TIMES, Unit.IMPULSE)
        return OverLives.SUM if added else OverLives.LATEST


_DECLARED: Final[dict[str, Figure]] = {}


def _figure(declared: Figure) -> str:
    _DECLARED[declared.name] = declared
    return declared.name


def _at(*path: str, needed: bool = False, positive: bool = False, scale: float = 1.0) -> ReportKey:
    return ReportKey(path, needed, positive, scale)


_SUM, _GREATEST, _LEAST = OverLives.SUM, OverLives.GREATEST, OverLives.LEAST

# fmt: off
# --- time

LATE: str = _figure(Figure(
    "late", Unit.TICKS, "whose force was applied after the next was due; of a world that its clock paces, those that "
    "had not ended then, or were never done", report=_at("late"), columns=(Column("late", ".0f", 1),)))
_figure(Figure(
    TAU, Unit.MICROSECONDS, "from a device's sample to its force", Key.PERCENTILE, report=_at("tau_us"),
    columns=(Column("τ p50 [µs]", ".0f", 4, "p50"), Column("τ p99 [µs]", ".0f", 2, "p99"))))
PERIOD: str = _figure(Figure(
    "period_us", Unit.MICROSECONDS, "between two samples of a device", Key.PERCENTILE, report=_at("period_us")))
LATE_CAUSE: str = _figure(Figure(
    "late_cause", Unit.TICKS, "that were late, by what took longest: the device itself (own), a processor that was not "
    "available (descheduled), or its couplings (partner)", Key.CAUSE, report=_at("late_causes")))
ELAPSED: str = _figure(Figure(
    "elapsed_us", Unit.MICROSECONDS, "from tick 0 until its latest tick, by the clock of its machine; a device and the "
    "environment tell it, under the realtime clock"))
TAU_WORST: str = _figure(Figure("tau_worst_us", Unit.MICROSECONDS, "the longest delay since the last telemetry"))
TAU_BREACHES: str = _figure(Figure(
    "tau_breaches", Unit.TICKS, "whose force came later after the sample than the certificate assumes",
    report=_at("tau_breaches"), promise=Promise.DELAY))
PERIOD_BREACHES: str = _figure(Figure(
    "period_breaches", Unit.TICKS, "that came later after the one before than the certificate covers after such a "
    "delay", report=_at("period_breaches"), promise=Promise.PERIOD))
STALE: str = _figure(Figure("stale", Unit.TIMES, "that STALE_TICKS periods had passed without a force"))
SUSPENDED: str = _figure(Figure(
    "suspended", Unit.TIMES, "that its process did not run for 50 ms and STALE_TICKS periods",
    report=_at("suspended", "times", needed=True, positive=True)))
SUSPENDED_TIME: str = _figure(Figure(
    "suspended_us", Unit.MICROSECONDS, "that its process did not run, in all",
    report=_at("suspended", "seconds", needed=True, scale=1e-6), lives=_SUM))
SUSPENDED_ENERGY: str = _figure(Figure(
    "suspended_energy", Unit.JOULES, "by which its interface account fell meanwhile",
    report=_at("suspended", "energy", needed=True), lives=_SUM))
REALTIME: str = _figure(Figure(
    "realtime", Unit.STATE, "whether the machine granted it", Key.RIGHT, report=_at("realtime")))

# --- what a hand was given

FORCE_ASKED: str = _figure(Figure(
    "force_asked", Unit.IMPULSE, "that a device's couplings asked for within its limits",
    report=_at("interface", "asked")))
FORCE_GIVEN: str = _figure(Figure("force_given", Unit.IMPULSE, "that it exerted", report=_at("interface", "given")))
FORCE_TIME: str = _figure(Figure(
    "force_time_us", Unit.MICROSECONDS, "in which a device could be given a force",
    columns=(Column("given [%]", "", 5),), lives=_SUM))
FORCE_AWAY: str = _figure(Figure(
    "force_away_us", Unit.MICROSECONDS, "of these in which it had no valid answer, or its force rose again after that",
    lives=_SUM))
FORCE_HELD_BACK: str = _figure(Figure(
    "force_held_back_us", Unit.MICROSECONDS, "in which the reserve for lateness lowered its force, or ended it early",
    lives=_SUM))
FORCE_CUT: str = _figure(Figure("force_cut_us", Unit.MICROSECONDS, "in which a limit cut its force", lives=_SUM))

# --- limits and presence

RUNG: str = _figure(Figure(
    "rung", Unit.NUMBER, "the present rung of the ladder", report=_at("rung"), columns=(Column("rung", ".0f", 6),),
    plot=("rungs", Role.COUPLING)))
CHANGING: str = _figure(Figure("changing", Unit.NUMBER, "couplings whose clutches open for a change of rung"))
CLIPPED: str = _figure(Figure(
    "clipped", Unit.TICKS, "whose force was clipped at the device: its coupling misbehaves", report=_at("clipped"),
    promise=Promise.FORCE))
SATURATED: str = _figure(Figure(
    "saturated", Unit.TICKS, "whose force was clipped at the coupling", report=_at("saturated"),
    promise=Promise.FORCE))
LET_GO: str = _figure(Figure(
    "let_go", Unit.TIMES, "that a device was beyond its displacement or speed, and let go", report=_at("let_go"),
    promise=Promise.MOTION))
FROZEN: str = _figure(Figure(
    "frozen", Unit.NUMBER, "couplings that are not active now", columns=(Column("frozen", ".0f", 3),),
    plot=("frozen couplings", Role.ENVIRONMENT)))
FROZEN_TICKS: str = _figure(Figure(
    "frozen_ticks", Unit.TICKS, "in which any coupling was not active",
    report=_at("incidents", "frozen", positive=True)))
RELEASED: str = _figure(Figure(
    "released", Unit.TICKS, "periods in which a device ran free, without force",
    report=_at("incidents", "released", positive=True)))
JUMPS: str = _figure(Figure(
    "jumps", Unit.TIMES, "that a force of a later tick said that the session had gone on without the node",
    report=_at("incidents", "jumps", positive=True)))
ABSENCES: str = _figure(Figure("absences", Unit.TIMES, "that any coupling was frozen or lost"))
SPEED: str = _figure(Figure(
    "speed", Unit.SPEED, "the greatest since the last telemetry", columns=(Column("speed [m/s]", ".2e", 9),)))
PEAK_SPEED: str = _figure(Figure(
    "peak_speed", Unit.SPEED, "the greatest of the run", report=_at("peak_speed"), lives=_GREATEST))
PEAK_FORCE: str = _figure(Figure(
    "peak_force", Unit.NEWTONS, "the greatest that an axis of a device exerted", report=_at("peak_force"),
    columns=(Column("peak [N]", ".2f", 12),), lives=_GREATEST))
BUTTON_PRESSES: str = _figure(Figure(
    "button_presses", Unit.TIMES, "of a device with buttons: how often one was pressed", report=_at("button_presses"),
    columns=(Column("buttons", ".0f", 13),)))
BUTTONS_DOWN: str = _figure(Figure(
    "buttons_down", Unit.STATE, "whether a button of a device is held down now", Key.BUTTON))
FINAL_SPEED: str = _figure(Figure(
    "final_speed", Unit.SPEED, "the greatest of the last rows of a run", report=_at("final_speed")))

# --- energy of a node

INTERFACE_LEAST: str = _figure(Figure(
    "interface_min", Unit.JOULES, "the least of a device's interface account, at most 0",
    report=_at("interface", "min", needed=True), lives=_LEAST))
INTERFACE_MARGIN: str = _figure(Figure(
    "interface_margin", Unit.JOULES, "the least distance of that account from its bound -(E_0 + P t)",
    report=_at("interface", "margin", needed=True), lives=_LEAST))
_figure(Figure(
    INTERFACE, Unit.JOULES, "the account of what lateness puts in", report=_at("interface", "final", needed=True),
    columns=(Column("account [J]", ".2e", 7),)))
ORIENTATION_LEAST: str = _figure(Figure(
    "orientation_min", Unit.JOULES, "the least of the account of a device's orientation",
    report=_at("orientation", "min", needed=True), lives=_LEAST))
ORIENTATION_MARGIN: str = _figure(Figure(
    "orientation_margin", Unit.JOULES, "the least distance of that account from its bound D - G",
    report=_at("orientation", "margin", needed=True), lives=_LEAST))
ORIENTATION_HELD: str = _figure(Figure(
    "orientation_held", Unit.TICKS, "in which less than the proposed turn of a proxy was taken",
    report=_at("orientation", "held_ticks", needed=True)))
ORIENTATION_LET_GO: str = _figure(Figure(
    "orientation_let_go", Unit.TICKS, "with an answer in which an orientation exerted no torque",
    report=_at("orientation", "let_go_ticks", needed=True)))
ORIENTATION_LATE: str = _figure(Figure(
    "orientation_late", Unit.JOULES, "that late ticks of an orientation may have given out at most",
    report=_at("orientation", "late", needed=True), lives=_SUM))
INTERFACE_TICKS: str = _figure(Figure(
    "interface_ticks", Unit.TICKS, "in which a device's interface changed a motion or a force",
    report=_at("interface", "changed_ticks", needed=True)))
INTERFACE_KEPT_BACK: str = _figure(Figure(
    "interface_kept_back", Unit.JOULES, "that the changed motions kept from being lost",
    report=_at("interface", "kept_back", needed=True), lives=_SUM))
INTERFACE_OFFSET: str = _figure(Figure(
    "interface_offset", Unit.METRES, "the greatest offset between a device and the motion sent",
    report=_at("interface", "offset"), lives=_GREATEST))
INTERFACE_BEHIND: str = _figure(Figure(
    "interface_behind", Unit.METRES, "of offset between a device and the motion sent now: so far its tool lags behind"))
QUICKER: str = _figure(Figure(
    "quicker", Unit.STATE, "whether a device moved further than the stated mass and hand allow", lives=_GREATEST))
BEYOND: str = _figure(Figure(
    "beyond", Unit.TIMES, "that an axis was faster, from one sample to the next, than the speed below which the "
    "certificate holds", report=_at("proved_speed", "beyond", needed=True), promise=Promise.SPEED))
FASTEST: str = _figure(Figure(
    "fastest", Unit.SPEED, "the greatest of an axis from one sample to the next, where the certificate holds below a "
    "speed", report=_at("proved_speed", "fastest", needed=True), lives=_GREATEST))
LEDGER_MIN: str = _figure(Figure(
    "ledger_min", Unit.JOULES, "the least total of the ledger", report=_at("ledger", "min", needed=True), lives=_LEAST))
_figure(Figure(
    LEDGER, Unit.JOULES, "the energy that a party has taken in above its promised level",
    report=_at("ledger", "final", needed=True), columns=(Column("ledger [J]", ".2e", 8),)))
LEDGER_MIN_TICK: str = _figure(Figure(
    "ledger_min_tick", Unit.TICK, "of the party's own ticks, from 1 on, in which the total was least; 0 where it never "
    "fell below its beginning", report=_at("ledger", "at"), beside=LEDGER_MIN))
LEDGER_MARGIN: str = _figure(Figure(
    "ledger_margin", Unit.JOULES, "by which the least total stayed above the bound", report=_at("ledger", "margin"),
    columns=(Column("margin [J]", ".2e", 10),), lives=_LEAST))
ENFORCED_TICKS: str = _figure(Figure(
    "enforced_ticks", Unit.TICKS, "in which a passivity controller kept a force back",
    report=_at("enforcement", "ticks", needed=True), promise=Promise.LEVEL))
ENFORCED_ENERGY: str = _figure(Figure(
    "enforced_energy", Unit.JOULES, "that it kept back", report=_at("enforcement", "energy", needed=True),
    promise=Promise.LEVEL, lives=_SUM))

# --- energy between users, by the environment

GIVEN: str = _figure(Figure(
    "given", Unit.JOULES, "that the others have received of the coupling's energy", Key.COUPLING,
    report=_at("energy", "given"), promise_of=Promise.BUDGET, lives=_SUM))
RECEIVED: str = _figure(Figure(
    "received", Unit.JOULES, "that the coupling has received of the others' energy", Key.COUPLING,
    report=_at("energy", "received"), lives=_SUM))
MOVED: str = _figure(Figure(
    "moved", Unit.JOULES, "that one coupling has given another", Key.PAIR, report=_at("energy", "moved"), lives=_SUM))
SCALED: str = _figure(Figure(
    "scaled", Unit.TICKS, "in which its ratio was below 1, for its energy budget", Key.COUPLING,
    report=_at("energy", "scaled"), promise_of=Promise.BUDGET))
STOPS: str = _figure(Figure(
    "stops", Unit.TIMES, "that its energy budget stopped it", Key.COUPLING, report=_at("energy", "stopped")))
SUPPLIED: str = _figure(Figure(
    "supplied", Unit.JOULES, "of its own that the coupling has put into the environment", Key.COUPLING, lives=_SUM))
UNOWNED: str = _figure(Figure(
    "unowned", Unit.JOULES, "that users received of the environment's own energy", report=_at("energy", "unowned"),
    lives=_SUM))

# --- the world

HELD: str = _figure(Figure(
    "held", Unit.TICKS, "in which the proxy test held its proxies", Key.COUPLING, report=_at("held")))
REVERSALS: str = _figure(Figure(
    "reversals", Unit.TICKS, "in which the force on its tools reversed", Key.COUPLING, report=_at("reversals")))
CHATTER: str = _figure(Figure(
    "chatter", Unit.TICKS, "of these, the most in a second", Key.COUPLING, report=_at("chatter"), lives=_GREATEST))
UNFINISHED: str = _figure(Figure(
    "unfinished", Unit.TICKS, "in which the iteration of a scene's contacts did not end",
    report=_at("scene", "unfinished", needed=True)))
HOLDING: str = _figure(Figure(
    "holding", Unit.NUMBER, "springs by which buttons hold bodies of a scene now", report=_at("scene", "holding")))
PAUSED: str = _figure(Figure(
    "paused", Unit.TICKS, "in which the tank of a scene held its driven bodies", report=_at("scene", "paused")))
DRIVE_TANK: str = _figure(Figure(
    "drive_tank", Unit.JOULES, "that the driven bodies of a scene may still give out", report=_at("scene", "tank")))

# --- who was waited for

WAITED_TICKS: str = _figure(Figure(
    "waited_ticks", Unit.TICKS, "in which the others waited for the coupling alone", Key.COUPLING))
WAITED_TIME: str = _figure(Figure(
    "waited_us", Unit.MICROSECONDS, "that the others waited in them", Key.COUPLING, lives=_SUM))
FROZEN_LATE: str = _figure(Figure(
    "frozen_late", Unit.TIMES, "that the coupling was frozen for being silent", Key.COUPLING))
OVERDUE: str = _figure(Figure(
    "overdue", Unit.TICKS, "in which the coupling was held, for its signal had not come", Key.COUPLING))
WAIVED: str = _figure(Figure(
    "waived", Unit.TIMES, "that it was late so often that nobody waited for it any more", Key.COUPLING))

# --- wave links: of a coupling's own end

WAVE_LEDGER: str = _figure(Figure("wave_ledger", Unit.JOULES, "that entered a wave link at this end"))
WAVE_TANK: str = _figure(Figure("wave_tank", Unit.JOULES, "in the tank of this end"))
WAVE_CLIPPED: str = _figure(Figure(
    "wave_clipped", Unit.TICKS, "in which the tank limited a wave", promise=Promise.LINK))
WAVE_HOLDING: str = _figure(Figure(
    "wave_holding", Unit.STATE, "whether no wave has come for so long that this end holds the tool"))
WAVE_SILENCES: str = _figure(Figure("wave_silences", Unit.TIMES, "that this began, after the first wave"))
WAVE_LAG: str = _figure(Figure(
    "wave_lag_us", Unit.MICROSECONDS, "whose sum over both ends is the round trip; that of one says nothing"))

# --- drivers and pointers

DRIVER: str = _figure(Figure("driver", Unit.OWN, "figures of a driver of another package, by its names", Key.OWN))
UNEXERTED: str = _figure(Figure("unexerted", Unit.TICKS, "in which a device exerted another force than it was given"))
UNEXERTED_MOST: str = _figure(Figure(
    "unexerted_most", Unit.NEWTONS, "the greatest difference of an axis", lives=_GREATEST))
MEASURED: str = _figure(Figure(
    "measured", Unit.TICKS, "in which a driver of another package measured the force that its device exerted"))
UNTRUE: str = _figure(Figure("untrue", Unit.TICKS, "of these in which there was a force that it had not been given"))
UNTRUE_MOST: str = _figure(Figure(
    "untrue_most", Unit.NEWTONS, "by which that was beyond them at most, on any of the driver's axes", lives=_GREATEST))
LIMP: str = _figure(Figure("limp", Unit.TICKS, "of these in which there was no force, though one had been given"))
LIMP_MOST: str = _figure(Figure("limp_most", Unit.NEWTONS, "the greatest that an axis lacked then", lives=_GREATEST))
GRASPED: str = _figure(Figure("grasped", Unit.STATE, "whether a person who feels no force holds the device"))
GRASPS: str = _figure(Figure(
    "grasps", Unit.TIMES, "positions of a pointer, or reports of a SpaceMouse or a gamepad, that the device took"))
GRASPS_CLIPPED: str = _figure(Figure(
    "grasps_clipped", Unit.TIMES, "of these, or ticks after them, that the goal would have left its reach"))
GRASPS_REFUSED: str = _figure(Figure(
    "grasps_refused", Unit.TIMES, "messages of the pointer that were no position of this device, or other reports"))
GRASPS_LAPSED: str = _figure(Figure("grasps_lapsed", Unit.TIMES, "that a pointer fell silent without letting go"))

# --- messages

NOT_ADMITTED: str = _figure(Figure(
    "not_admitted", Unit.NUMBER, "connections and frames that were not admitted, in one sum",
    columns=(Column("refused", ".0f", 11),), lives=_SUM))
REFUSED: str = _figure(Figure(
    "refused", Unit.NUMBER, "connections that the process did not admit", Key.REASON,
    report=_at("refused", positive=True), lives=_SUM))
DROPPED: str = _figure(Figure(
    "dropped", Unit.NUMBER, "frames of its links that were dropped, telemetry that the supervisor did not take fast "
    "enough, and lines that did not fit into its log", Key.REASON, report=_at("dropped", positive=True), lives=_SUM))
# fmt: on


def of(name: str) -> str:
    """The name of the environment's table, by coupling, of a figure that couplings state of themselves."""
    return f"{name}_of"


def _figure_of(name: str, promise_of: Promise | None = None) -> None:
    own = _DECLARED[name]
    says = f"{own.says}: what the environment states"
    _figure(Figure(of(name), own.unit, says, Key.COUPLING, promise_of=promise_of))


_figure_of(RUNG)
_figure_of(WAVE_LEDGER)
_figure_of(WAVE_TANK)
_figure_of(WAVE_CLIPPED, Promise.LINK)
_figure_of(WAVE_HOLDING)
_figure_of(WAVE_SILENCES, Promise.LINK)
_figure_of(WAVE_LAG)

WAITED_IN: Final = "waited"
"""The trace, for the supervisor alone, of the ticks in which the others waited for a coupling: ticks, and the place of
the coupling among the environment's."""

FIGURES: Final[Mapping[str, Figure]] = MappingProxyType(_DECLARED)
"""Every figure by its name, in the order in which people meet them."""


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


def enforcement_figures(controller: PassivityController | None) -> dict[str, float]:
    """How often a controller acted, and the energy that it kept back; empty where no level is enforced."""
    if controller is None:
        return {}
    return {ENFORCED_TICKS: float(controller.ticks), ENFORCED_ENERGY: controller.energy}


def shown(telemetry: Telemetry) -> Telemetry:
    """A telemetry as observers see it: without the trace of the ticks in which couplings were late."""
    if WAITED_IN not in telemetry.traces:
        return telemetry
    traces = {name: trace for name, trace in telemetry.traces.items() if name != WAITED_IN}
    return Telemetry(telemetry.tick, telemetry.figures, traces)
