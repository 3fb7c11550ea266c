"""`manyhands budget`: the stiffness that can be certified for each device, over delay inside the tick and period.

:mod:`manyhands.design.budget` computes the numbers; this module selects and shows them. Nothing is designed: a budget
shows before any design how much stiffness a faster transport or a shorter period would gain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from manyhands.design.budget import Felt, Stiffness, certified_limit, environment_share, felt_over, stiffest_below
from manyhands.design.levels.orientation import stiffest
from manyhands.design.models.axis import Units
from manyhands.design.models.brief import brief_names, brief_repr
from manyhands.design.models.statespace import Matrix
from manyhands.design.problem import HapticLoop
from manyhands.design.series import counted_parts
from manyhands.launch.app.own_device import OwnDevice
from manyhands.launch.look.display import titled_table
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.sites import site
from manyhands.launch.recordings.recording import data_frame
from manyhands.launch.session import Session
from manyhands.nodes.kernel.json_number import json_number
from manyhands.nodes.kernel.words import counted

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D

TICK_PARTS = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0)  # the delays shown, in periods, besides the session's own delay
PERIODS = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3)  # s: the periods shown, besides the session's own period

ROUND_TRIPS = (1e-3, 2e-3, 4e-3, 6e-3, 10e-3, 20e-3, 40e-3, 60e-3, 100e-3, 200e-3, 400e-3)
"""s: the round trips shown of a wave link, besides the session's own."""
SITE_PERIODS = (1e-3, 0.5e-3, 0.25e-3)
"""s: the periods shown of a user's site, besides its own."""

SPEEDS = (0.03, 0.1, 0.3, 1.0)
"""m/s: those below which a device's friction is told to damp, besides one that is asked for."""

_PLOTTED_PERIODS = (0.25, 0.5, 1.0, 2.0)  # multiples of the session's period
_PLOTTED_DELAYS = 101  # points of a curve
_PLOTTED_SPEEDS = 41  # likewise
_LEAST_SPEED, _MOST_SPEED = 0.01, 1.0  # m/s, of a curve, unless the session's own is near an end or beyond
_MOST_ROWS = 12  # different levels shown in a table, weakest first; --json has all
_MOST_PANELS = 4  # different levels shown in a plot


@dataclass(frozen=True, eq=False)
class DeviceBudget:
    """The stiffness that can be certified for one device.

    Attributes:
        name: the device.
        level: Delta_Di with the coupling's structure, m_i x m_i, N*s/m.
        against_delay: at the session's period, delays ascending, the session's own among them.
        against_period: periods ascending; for each period the delays 0, the session's own (unless it exceeds the
            period) and the whole period.
    """

    name: str
    level: Matrix
    against_delay: tuple[Stiffness, ...]
    against_period: tuple[Stiffness, ...]

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class DelayBudget:
    """The stiffness that can be certified for a session.

    Attributes:
        loop: the session's loop.
        periods: the periods examined, s, ascending.
        share_at: the share of the devices' levels that the environment takes at a period (s); 0 for a passive
            environment, infinite for one with which nothing can be certified.
        devices: one budget for each device.
        wave_links: what is felt at most over each wave link.
    """

    loop: HapticLoop
    periods: tuple[float, ...]
    share_at: Callable[[float], float]
    devices: tuple[DeviceBudget, ...]
    wave_links: tuple[WaveLinkBudget, ...] = ()

    def at(self, tau: float, T: float | None = None) -> dict[str, Stiffness]:
        """The stiffness that can be certified for each device, by name.

        Args:
            tau: the longest delay inside the tick, s, 0 ... T.
            T: period, s; by default the session's.

        Raises:
            ValueError: T is not positive and finite, or tau is outside 0 ... T.

        Example:
            >>> import manyhands as mh
            >>> budget = mh.budget(mh.load("example1"))
            >>> [round(budget.at(tau)["dx"].certified) for tau in (0.0, 0.0005, 0.001)]       # N/m
            [2740, 1096, 685]
        """
        period = self.loop.period if T is None else T
        if not 0.0 < period < np.inf:
            raise ValueError(f"T: found {period!r} s; expected a finite positive period")
        share = self.share_at(period)
        return {device.name: certified_limit(self.loop, device, period, tau, share) for device in self.loop.devices}

    def columns(self) -> dict[str, NDArray[Any]]:
        """The budget against the delay, at the session's period, as a table: a row for each device and delay.

        The columns are ``device``, ``T_s``, ``tau_s``, ``certified_N/m``, ``colgate_N/m`` and ``kappa``, which is NaN
        where nothing can be certified. Where axes turn, N·m/rad stands in place of N/m.
        """
        unit = self.loop.units()("N/m")
        rows = [(device.name, row) for device in self.devices for row in device.against_delay]
        return {
            "device": np.array([name for name, _ in rows]),
            "T_s": np.array([row.T for _, row in rows]),
            "tau_s": np.array([row.tau for _, row in rows]),
            f"certified_{unit}": np.array([row.certified for _, row in rows]),
            f"colgate_{unit}": np.array([row.colgate for _, row in rows]),
            "kappa": np.array([np.nan if row.kappa is None else row.kappa for _, row in rows]),
        }

    def to_pandas(self) -> pandas.DataFrame:
        """The table of :meth:`columns` as a data frame.

        Raises:
            RecordingError: pandas is not installed.
        """
        return data_frame(self.columns())

    def __repr__(self) -> str:
        units = {device.name: device.units("N/m") for device in self.loop.devices}
        limits = [f"{name} {row.certified:.4g} {units[name]}" for name, row in self.at(self.loop.tau).items()]
        T, tau = self.loop.period, self.loop.tau
        return f"DelayBudget({self.loop.session}: T = {T:g} s, tau = {tau:g} s, {brief_names(limits)})"


def session_budget(session: Session) -> DelayBudget:
    """The budget of every device of a session, and of its wave links.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    return replace(budget(haptic_loop(session)), wave_links=wave_link_budgets(session))


def budget(loop: HapticLoop, share_at: Callable[[float], float] | None = None) -> DelayBudget:
    """The budget of every device of a loop.

    Args:
        loop: the loop; its coupling does not matter.
        share_at: the share that the environment takes at a period (s); computed where the caller does not give it.
    """
    T, tau = loop.period, loop.tau
    share = cache(
        share_at
        or (lambda period: environment_share(loop.environment, loop.Delta_D_at(period, min(tau, period)), period))
    )
    periods = _periods(loop, PERIODS)
    delays = sorted({*(part * T for part in TICK_PARTS), tau})
    grid = [(period, delay) for period in periods for delay in sorted({0.0, min(tau, period), period})]
    whole = loop.Delta_D_at(T, tau)
    devices = [
        DeviceBudget(
            device.name,
            device.level if whole is None else whole[np.ix_(device.ports, device.ports)],
            tuple(certified_limit(loop, device, T, delay, share(T)) for delay in delays),
            tuple(certified_limit(loop, device, period, delay, share(period)) for period, delay in grid),
        )
        for device in loop.devices
    ]
    return DelayBudget(loop, periods, share, tuple(devices))


def _periods(loop: HapticLoop, wanted: Iterable[float]) -> tuple[float, ...]:
    """The periods to examine; an environment given in discrete time has only its own period."""
    if not loop.environment.at_any_period:
        return (loop.period,)
    return tuple(sorted({*wanted, loop.period}))


@dataclass(frozen=True, eq=False)
class WaveLinkBudget:
    """What is felt at most over one coupling's wave link.

    Attributes:
        name: of the coupling.
        period: of the site, s.
        tau: longest delay inside a tick of the site, s.
        round_trip: that the session states, s; None if it states none.
        units: of the coupling's ports.
        at: what is felt at a period of the site, s, and a round trip, s. The delay is ``tau``, or the whole period
            where that is less.
    """

    name: str
    period: float
    tau: float
    round_trip: float | None
    units: Units
    at: Callable[[float, float], Felt]

    __repr__ = brief_repr

    @property
    def round_trips(self) -> tuple[float, ...]:
        """The round trips to show, s, ascending."""
        return tuple(sorted({*ROUND_TRIPS, *(() if self.round_trip is None else (self.round_trip,))}))

    @property
    def periods(self) -> tuple[float, ...]:
        """The site's periods to show, s: its own, then shorter ones."""
        return (self.period, *(shorter for shorter in SITE_PERIODS if shorter < self.period))


def wave_link_budgets(session: Session) -> tuple[WaveLinkBudget, ...]:
    """The budget of each wave link of a session.

    Where the session allows a felt mass M, the impedance at a round trip R is 2 M/R; a given b stays as it is.
    """
    return tuple(_wave_link_budget(session, name) for name in session.wave_links)


def _wave_link_budget(session: Session, name: str) -> WaveLinkBudget:
    link, loop = session.wave_links[name], site(session, name).loop
    harvest = np.diag(link.harvest_of(len(loop.ports)))

    def at(T: float, round_trip: float) -> Felt:
        b = link.model_copy(update={"round_trip": round_trip}).impedance(len(loop.ports))
        tau = min(loop.tau, T)
        return felt_over(loop.Delta_D_at(T, tau), T, tau, b, round_trip, harvest, loop.period_tolerance)

    return WaveLinkBudget(name, loop.period, loop.tau, link.round_trip, loop.units(), cache(at))


@dataclass(frozen=True)
class SeriesStiffness:
    """The limit of the coupling at one port where the world's own spring is counted in series with it, at one delay.

    Attributes:
        port: name of the port.
        tau: longest delay inside the tick, s.
        contact: k of the world's spring there, N/m.
        part: of its compliance that is counted.
        without: limit of the coupling without it, N/m.
        certified: limit of the coupling itself with it, N/m: 1/(1/without - part/k).
    """

    port: str
    tau: float
    contact: float
    part: float
    without: float
    certified: float


def series_budget(found: DelayBudget) -> tuple[SeriesStiffness, ...]:
    """The limits in series at the session's period, by port and delay; empty where the session counts nothing."""
    loop = found.loop
    if not loop.series or loop.environment.counts != "part":
        return ()
    contacts, out = loop.environment.contacts(), []
    device_of = {port: device.name for device in loop.devices for port in device.ports}
    for device in found.devices:
        for row in device.against_delay:
            parts = counted_parts(replace(loop, tau=row.tau, series=()), max(loop.series))
            for i, part in enumerate(parts):
                if part and row.certified and device_of[i] == device.name:
                    contact = contacts[loop.ports[i]].stiffness
                    own = 1.0 / (1.0 / row.certified - part / contact)
                    out.append(SeriesStiffness(loop.ports[i], row.tau, contact, part, row.certified, own))
    return tuple(out)


def print_series(console: Console, found: Sequence[SeriesStiffness], loop: HapticLoop) -> None:
    """Print what counting the world's springs in series allows each coupling of a loop."""
    if not found:
        return
    unit, tau = loop.units()("N/m"), loop.tau
    columns = ("τ [ms]", f"its spring [{unit}]", "counted", f"without [{unit}]", f"certified below [{unit}]")
    table = titled_table("with the world's own springs in series", ["port"], columns)
    ports = list(dict.fromkeys(row.port for row in found))
    for port in ports[:_MOST_ROWS]:
        for i, row in enumerate(row for row in found if row.port == port):
            table.add_row(
                port if i == 0 else "", _ms(row.tau) + (" (session)" if row.tau == tau else ""), _figure(row.contact),
                f"{row.part:g}", _figure(row.without), _figure(row.certified),
            )  # fmt: skip
        table.add_section()
    console.print(table)
    if len(ports) > _MOST_ROWS:
        console.print(f"not shown: {counted(len(ports) - _MOST_ROWS, 'more port')}; --json has all", markup=False)


def budget_object(found: DelayBudget) -> dict[str, Any]:
    """The object that ``--json`` prints; T and tau in s, stiffness in N/m, "share" null where it is infinite."""
    loop, turned = found.loop, orientation_limits(found.loop)
    return {
        "session": loop.session,
        "period": loop.period,
        "tau": loop.tau,
        "period_tolerance": loop.period_tolerance,
        "environment": [
            {"T": period, "share": json_number(share)}
            for period, share in ((period, found.share_at(period)) for period in found.periods)
        ],
        "devices": {
            device.name: {
                "osp": device.level.tolist(),
                "against_tau": [_plain(row) for row in device.against_delay],
                "against_period": [_plain(row) for row in device.against_period],
            }
            for device in found.devices
        },
        **({"orientations": {name: _plain_orientation(most, own) for name, most, own in turned}} if turned else {}),
        **({"series": [asdict(row) for row in in_series]} if (in_series := series_budget(found)) else {}),
        **({"steps": [asdict(row) for row in of_steps]} if (of_steps := step_budget(found)) else {}),
    }


@dataclass(frozen=True)
class StepBudget:
    """What the step of an encoder adds to the force of a spring, on one axis.

    Attributes:
        port: the axis.
        stiffness: K, the greatest that can be certified for its device at the session's delay, N/m.
        force: K q/2 of a spring of that stiffness to a wall, N [AbbottOkamura2005]_; couplings with dampers and worlds
            that swing add more, which a design states.
        friction: the device's dry friction, N; 0 where none is stated.
    """

    port: str
    stiffness: float
    force: float
    friction: float


def step_budget(found: DelayBudget) -> tuple[StepBudget, ...]:
    """Of each axis with an encoder: what its step adds to the force of the stiffest spring."""
    limits, loop = found.at(found.loop.tau), found.loop
    out = []
    for device in loop.devices:
        K = limits[device.name].certified
        friction = device.friction or (0.0,) * len(device.ports)
        for port, q, c in zip(device.ports, device.step or (), friction, strict=False):
            if q > 0.0:
                out.append(StepBudget(loop.ports[port], K, K * q / 2.0, c))
    return tuple(out)


def print_steps(console: Console, found: DelayBudget) -> None:
    """Print a line for each axis with an encoder."""
    rows = step_budget(found)
    for row in rows[:_MOST_ROWS]:
        covers, units = "no dry friction is stated", found.loop.units(row.port)
        if row.friction:
            covers = f"the dry friction of {1e3 * row.friction:.3g} m{units('N')} " + (
                "covers it" if row.friction >= row.force else "does not cover it"
            )
        console.print(
            f"{row.port}: the encoder's step can add {1e3 * row.force:.3g} m{units('N')} to a spring of "
            f"{_figure(row.stiffness)} {units('N/m')}; {covers}",
            markup=False,
            soft_wrap=True,
        )
    if len(rows) > _MOST_ROWS:
        console.print(
            f"not shown: {counted(len(rows) - _MOST_ROWS, 'more axis', 'more axes')} with encoders; --json has all",
            markup=False,
        )


@dataclass(frozen=True, eq=False)
class SpeedBudget:
    """The stiffness that can be certified for devices with dry friction, below speeds at which it counts as damping.

    Attributes:
        names: of the devices, which have equal limits.
        speeds: v*, m/s, ascending.
        certified: below each of them, N/m; NaN where the friction does not pay for the steps of the encoders, or
            nothing bounds what they take of it.
        every: at every speed, where friction counts for nothing, N/m; 0 if no coupling can be certified.
        own: below the session's own speed, N/m; None if it states none.
    """

    names: tuple[str, ...]
    speeds: NDArray[Any]
    certified: NDArray[Any]
    every: float
    own: float | None

    __repr__ = brief_repr


def speed_budget(found: DelayBudget) -> tuple[SpeedBudget, ...]:
    """The limits below speeds at the session's period and delay, of each device that states friction; none without."""
    loop = found.loop
    if not any(device.friction for device in loop.devices):
        return ()
    middle = (_LEAST_SPEED, _MOST_SPEED) if loop.speed is None else (loop.speed / 2.0, 2.0 * loop.speed)
    speeds = np.geomspace(min(_LEAST_SPEED, *middle), max(_MOST_SPEED, *middle), _PLOTTED_SPEEDS)
    limits = np.array([[row.certified for row in stiffest_below(loop, float(speed))] for speed in speeds]).T
    own = None if loop.speed is None else [row.certified for row in stiffest_below(loop, loop.speed)]
    every, same = found.at(loop.tau), dict[tuple[float, ...], list[int]]()
    for i, device in enumerate(loop.devices):
        if device.friction:
            same.setdefault((every[device.name].certified, *limits[i].tolist()), []).append(i)
    return tuple(
        SpeedBudget(
            tuple(loop.devices[i].name for i in of),
            speeds,
            np.where(limits[of[0]] > 0.0, limits[of[0]], np.nan),
            every[loop.devices[of[0]].name].certified,
            None if own is None else own[of[0]],
        )
        for of in same.values()
    )


def wave_links_object(found: Sequence[WaveLinkBudget]) -> dict[str, Any]:
    """The part of the object about wave links; T, tau and round_trip in s, stiffness in N/m, mass in kg."""
    return {
        link.name: [asdict(link.at(T, round_trip)) for T in link.periods for round_trip in link.round_trips]
        for link in found
    }


def _plain(row: Stiffness) -> dict[str, float | None]:
    return {"T": row.T, "tau": row.tau, "certified": row.certified, "colgate": row.colgate, "kappa": row.kappa}


def print_budget(console: Console, found: DelayBudget, own_mark: str = " (session)", of_session: bool = True) -> None:
    """Print two tables, stiffness over delay and over period; devices with equal levels share their rows.

    Args:
        console: where to.
        found: the budget.
        own_mark: what stands beside the loop's own delay.
        of_session: whether it has an environment of which something can be said.
    """
    loop = found.loop
    groups = _groups(found.devices)
    shown = groups[:_MOST_ROWS]
    title = f"{loop.session}: stiffest coupling, T = {_ms(loop.period)} ms"
    unit = loop.units()("N/m")
    columns = ("τ [ms]", "τ/T", f"certified below [{unit}]", f"Colgate's limit [{unit}]", "κ")
    table = titled_table(title, ["devices"], columns)
    for names, device in shown:
        for i, row in enumerate(device.against_delay):
            mark = own_mark if row.tau == loop.tau else ""
            table.add_row(
                names if i == 0 else "", _ms(row.tau) + mark, f"{row.tau / row.T:.3g}", _figure(row.certified),
                _figure(row.colgate), "" if row.kappa is None else f"{row.kappa:.3f}",
            )  # fmt: skip
        table.add_section()
    console.print(table)
    own = [f"τ = {_ms(loop.tau)} ms"] if loop.tau > 0.0 else []
    of_periods = ("T [ms]", "τ = 0", *own, "τ = T", "Colgate, τ = 0", "Colgate, τ = T")
    table = titled_table("the same against the period", ["devices"], of_periods)
    for names, device in shown:
        for i, period in enumerate(found.periods):
            rows = {row.tau: row for row in device.against_period if period == row.T}
            at_own = [_figure(rows[loop.tau].certified) if loop.tau in rows else "longer than T"] if own else []
            table.add_row(
                names if i == 0 else "", _ms(period), _figure(rows[0.0].certified), *at_own,
                _figure(rows[period].certified), _figure(rows[0.0].colgate), _figure(rows[period].colgate),
            )  # fmt: skip
        table.add_section()
    console.print(table)
    if len(groups) > len(shown):
        left = len(groups) - len(shown)
        console.print(f"the {left} stronger levels are not shown; --json has every device", markup=False)
    if loop.period_tolerance:
        longest = f"{1.0 + loop.period_tolerance:g}"
        console.print(f"Periods may be up to {longest} T long, Colgate's as well as ours.", markup=False)
    for name, most, stated in orientation_limits(loop):
        k = f"{stated:.4g} N·m/rad"
        if most is None:
            limit = f"sensed, without a torque; any delay allows the session's {k} of its tool"
        else:
            limit = f"certified up to {most:.4g} N·m/rad at τ = {_ms(loop.tau)} ms; the session has {k}"
        console.print(f"The orientation of {name}: {limit}.", markup=False, soft_wrap=True)
    if of_session:
        console.print(_environment_text(found), markup=False, soft_wrap=True)


def _plain_orientation(most: float | None, own: float) -> dict[str, Any]:
    return {"sensed": True, "stiffness": own} if most is None else {"limit": most, "stiffness": own}


def orientation_limits(loop: HapticLoop) -> list[tuple[str, float | None, float]]:
    """By device whose orientation is a port: the stiffest spring that its osp allows, and its own, N·m/rad.

    One whose orientation is sensed has no such limit: None.
    """
    found: list[tuple[str, float | None, float]] = []
    for device in loop.devices:
        if (of := device.orientation) is not None:
            osp, times = of.osp, (loop.period, loop.tau, loop.period_tolerance)
            most = None if osp is None else stiffest(osp, *times, 0.0, of.taken(*times))
            found.append((device.name, most, of.stiffness))
    return found


def print_wave_links(console: Console, found: Sequence[WaveLinkBudget]) -> None:
    """Print a table for each wave link: what is felt over its round trip, beside what a loop through it could be."""
    for link in found[:_MOST_ROWS]:
        title = f"{link.name}: over a wave link, τ = {_ms(link.tau)} ms at the site"
        unit, gram = link.units("N/m"), link.units("g")
        felt_at = [f"felt, {1e-3 / T:.3g} kHz [{unit}]" for T in link.periods]
        columns = ("R [ms]", *felt_at, f"felt mass [{gram}]", f"least mass [{gram}]", f"loop through R [{unit}]")
        table = titled_table(title, (), columns)
        for round_trip in link.round_trips:
            rows = [link.at(T, round_trip) for T in link.periods]
            mark = " (session)" if round_trip == link.round_trip else ""
            masses = [_figure(1e3 * mass) for mass in (rows[0].mass, rows[0].least_mass)]
            felt = [_figure(row.felt) for row in rows]
            table.add_row(_ms(round_trip) + mark, *felt, *masses, _figure(rows[0].naive))
        console.print(table)
    if len(found) > _MOST_ROWS:
        console.print(f"{len(found) - _MOST_ROWS} more wave links are not shown; --json has all", markup=False)
    if found:
        console.print(
            "Distance costs mass, and never stability: no linear passive link over R is lighter than K R²/4 for the "
            "stiffness K that is felt. A loop through R is not certified here, and above its limit not passive.",
            markup=False,
            soft_wrap=True,
        )


def below_speeds(found: DelayBudget, speed: float | None) -> dict[str, list[tuple[float, float]]]:
    """By device with dry friction: speeds, m/s, and the stiffness that can be certified below each, N/m.

    Args:
        found: the budget.
        speed: of which it is told as well, m/s; None for no other than :data:`SPEEDS`.
    """
    loop = found.loop
    if not any(device.friction for device in loop.devices):
        return {}
    speeds = sorted({*SPEEDS, *(() if speed is None else (speed,))})
    limits = [[row.certified for row in stiffest_below(loop, one)] for one in speeds]
    return {
        device.name: [(one, row[i]) for one, row in zip(speeds, limits, strict=True)]
        for i, device in enumerate(loop.devices)
        if device.friction
    }


def own_device_object(own: OwnDevice, found: DelayBudget) -> dict[str, Any]:
    """What ``--json`` adds of a device with dry friction; speeds in m/s, stiffness in N/m."""
    below = _plain_speeds(below_speeds(found, own.speed))
    return {"below_speeds": below["device"]} if below else {}


def friction_object(found: DelayBudget) -> dict[str, Any]:
    """What ``--json`` adds of a session's devices with dry friction, by device; speeds in m/s, stiffness in N/m."""
    below = _plain_speeds(below_speeds(found, found.loop.speed))
    return {"below_speeds": below} if below else {}


def _plain_speeds(below: Mapping[str, list[tuple[float, float]]]) -> dict[str, list[dict[str, float]]]:
    return {name: [{"speed": v, "certified": K} for v, K in rows] for name, rows in below.items()}


def print_friction(console: Console, found: DelayBudget) -> None:
    """Print a line for the devices with dry friction: what it gives below which speed; the tables hold at every one."""
    loop, alike = found.loop, dict[tuple[tuple[float, float], ...], list[str]]()
    for name, rows in below_speeds(found, loop.speed).items():
        alike.setdefault(tuple(rows), []).append(name)
    for limits, of in list(alike.items())[:_MOST_ROWS]:
        ports = [loop.ports[port] for device in loop.devices if device.name in of for port in device.ports]
        unit = loop.units(*ports)
        told = ", ".join(
            f"{_figure(K)} {unit('N/m')} below {v:g} {unit('m/s')}{' (session)' if v == loop.speed else ''}"
            for v, K in limits
        )
        late = f"{_ms(loop.tau)} ms late" if loop.tau else "nothing late"
        console.print(
            f"{brief_names(of)}: the tables hold at every speed; with a design.speed dry friction damps, too, {late}: "
            f"{told}",
            markup=False,
            soft_wrap=True,
        )


def print_own_device(console: Console, own: OwnDevice, found: DelayBudget) -> None:
    """Print the answer in a sentence, and one for each speed below which friction counts."""
    T, unit = found.loop.period, found.loop.units()
    first, last = (found.at(tau)["device"].certified for tau in (0.0, T))
    console.print(
        f"A device that damps {own.osp:g} {unit('N·s/m')}, at {own.rate:g} Hz: {_coupling(first, unit)} if nothing is "
        f"late, and {_coupling(last, unit)} if forces may be a period late. A stiffer wall feels no stiffer.",
        markup=False,
        soft_wrap=True,
    )
    for speed, certified in below_speeds(found, own.speed).get("device", ()):
        late = f"{1e3 * found.loop.tau:g} ms late" if found.loop.tau else "nothing late"
        console.print(
            f"Below {speed:g} {unit('m/s')}, with {own.friction:g} {unit('N')} of dry friction and {late}: "
            f"{_figure(certified)} {unit('N/m')}",
            markup=False,
            soft_wrap=True,
        )


def _coupling(below: float, units: Units) -> str:
    return f"a coupling below {_figure(below)} {units('N/m')}" if below else "none"


def _environment_text(found: DelayBudget) -> str:
    share = found.share_at(found.loop.period)
    if share == 0.0:
        return "The environment is passive: the limits do not depend on it."
    if share >= 1.0:
        return "The environment takes all that the devices dissipate, or more: nothing can be certified with it."
    return f"The environment takes {share:.1%} of what the devices dissipate; the certified limits leave it that."


def plot_budget(found: DelayBudget, path: Path) -> None:
    """Plot the stiffness over the delay for several periods, certified and Colgate's, with a panel for each level.

    Where devices state dry friction, a panel below these has the stiffness against the speed below which it holds.

    With wave links the picture is about them instead: what is felt over the round trip, with a panel for each link.

    The path is one that :func:`manyhands.launch.look.figures.require_picture` accepts.
    """
    from manyhands.launch.look.figures import new_figure, save  # the plotter takes most of a second to import

    links, groups = found.wave_links[:_MOST_PANELS], _groups(found.devices)[:_MOST_PANELS]
    speeds = () if links else speed_budget(found)
    count = len(links or groups)
    whole = new_figure(8.0, 0.6 + 3.6 * (count + bool(speeds)))
    figure: Figure | SubFigure = whole
    if speeds:
        grid = whole.add_gridspec(2, 1, height_ratios=(0.6 + 3.6 * count, 3.6))
        figure = whole.add_subfigure(grid[0])
        draw_speeds(whole.add_subfigure(grid[1]).subplots(), speeds, found.loop)
    rows = figure.subplots(count, 1, squeeze=False, sharex=True)[:, 0]
    for axes, link in zip(rows, links, strict=False):
        draw_wave_link(axes, link)
    for axes, (names, device) in zip(rows, () if links else groups, strict=False):
        draw_budget(axes, found, device)
        axes.set_title(names, loc="left", fontsize="medium")
    for axes in rows[:-1]:
        axes.set_xlabel("")
    if not links:
        figure.legend(handles=budget_keys(found), loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    what = "what is felt over wave links" if links else "stiffest coupling"
    figure.suptitle(f"{found.loop.session}: {what}", x=0.01, ha="left", fontsize="medium")
    save(whole, path)


def draw_budget(axes: Axes, found: DelayBudget, device: DeviceBudget) -> None:
    """Draw the stiffness of one device over the delay, a colour for each period; solid certified, dashed Colgate's."""
    loop, periods = found.loop, _plotted_periods(found)
    [shown] = [own for own in loop.devices if own.name == device.name]
    for T, colour in zip(periods, _colours(len(periods)), strict=True):
        delays = np.linspace(0.0, T, _PLOTTED_DELAYS)
        curve = [certified_limit(loop, shown, T, float(min(tau, T)), found.share_at(T)) for tau in delays]
        certified = np.array([row.certified if row.certified > 0.0 else np.nan for row in curve])
        axes.plot(1e3 * delays, certified, color=colour, linewidth=1.8)
        axes.plot(1e3 * delays, [row.colgate for row in curve], color=colour, linewidth=1.2, linestyle="--")
    own = next(row for row in device.against_delay if row.tau == loop.tau)
    if own.certified > 0.0:
        axes.plot(1e3 * own.tau, own.certified, "o", color="black", markersize=6, clip_on=False, zorder=5)
    axes.set_yscale("log")
    _label_decades(axes.yaxis)
    axes.set_title(device.name, loc="left", fontsize="medium")
    axes.set_xlabel("delay τ inside the tick [ms]")
    axes.set_ylabel(f"stiffness [{shown.units('N/m')}]")
    axes.grid(alpha=0.3, which="both")
    axes.set_xlim(0.0, 1e3 * periods[-1])


def _label_decades(axis: Axis) -> None:
    """Label 1, 2 and 5 of each decade of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_speeds(axes: Axes, found: Sequence[SpeedBudget], loop: HapticLoop) -> None:
    """Draw the stiffness below each speed, a colour for devices with equal limits; dashed what holds at every speed.

    Args:
        axes: to draw into.
        found: the limits; only the first few are drawn.
        loop: of the session, whose own speed is marked if it states one.
    """
    shown, speed, units = found[:_MOST_PANELS], loop.speed, loop.units()
    for own, colour in zip(shown, _colours(len(shown)), strict=True):
        name, certified = _names(own.names), np.isfinite(own.certified)
        label = name if certified.any() else f"{name}: nothing below any speed, because of the encoders' steps"
        axes.loglog(own.speeds, own.certified, color=colour, linewidth=1.8, label=label)
        if own.every > 0.0:
            text = f"{name}: at every speed, without its friction"
            axes.axhline(own.every, color=colour, linewidth=1.2, linestyle="--", label=text)
        if speed is not None and own.own:
            text = f"this session: {_figure(own.own)} {units('N/m')} below {speed:g} {units('m/s')}"
            axes.plot(speed, own.own, "o", color=colour, markersize=6, label=text, zorder=5)
    for axis in (axes.xaxis, axes.yaxis):
        _label_decades(axis)
    axes.set_title("with dry friction as damping: holds below the speed v*", loc="left", fontsize="medium")
    axes.set_xlabel(f"speed v* [{units('m/s')}]")
    axes.set_ylabel(f"stiffness [{units('N/m')}]")
    axes.set_xlim(found[0].speeds[0], found[0].speeds[-1])
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small", frameon=False)


def budget_keys(found: DelayBudget) -> list[Line2D]:
    """What the lines of :func:`draw_budget` mean, for a legend."""
    from matplotlib.lines import Line2D

    periods = _plotted_periods(found)
    keys = [
        Line2D([], [], color=colour, label=f"T = {_ms(T)} ms")
        for T, colour in zip(periods, _colours(len(periods)), strict=True)
    ]
    return [
        *keys,
        Line2D([], [], color="0.3", linewidth=1.8, label="certified below"),
        Line2D([], [], color="0.3", linewidth=1.2, linestyle="--", label="Colgate's limit"),
        Line2D([], [], color="black", marker="o", linestyle="", label="this session"),
    ]


def _plotted_periods(found: DelayBudget) -> tuple[float, ...]:
    return _periods(found.loop, [part * found.loop.period for part in _PLOTTED_PERIODS])


def _colours(count: int) -> Any:
    """Dark to light, distinct in grey too."""
    from matplotlib import colormaps

    return colormaps["viridis"](np.linspace(0.0, 0.8, count))


def draw_wave_link(axes: Axes, link: WaveLinkBudget) -> None:
    """Draw the felt stiffness over the round trip, at each period of the site, beside the loop through the delay."""
    times = np.geomspace(ROUND_TRIPS[0], ROUND_TRIPS[-1], _PLOTTED_DELAYS)
    for T, colour in zip(link.periods, _colours(len(link.periods)), strict=True):
        curve = np.array([link.at(T, float(R)).felt for R in times])
        label = f"felt, site at {1e-3 / T:.3g} kHz"
        axes.loglog(1e3 * times, np.where(curve > 0.0, curve, np.nan), color=colour, linewidth=1.8, label=label)
    own = [link.at(link.period, float(R)) for R in times]
    style = {"color": "0.3", "linewidth": 1.2}
    axes.loglog(1e3 * times, [row.naive for row in own], linestyle="--", label="limit of a loop through R", **style)
    law = [4.0 * row.mass / row.round_trip**2 for row in own]
    axes.loglog(1e3 * times, law, linestyle=":", label="law: 4 M/R², M the felt mass", **style)
    if link.round_trip is not None:
        felt = link.at(link.period, link.round_trip).felt
        axes.plot(1e3 * link.round_trip, felt, "o", color="black", label="this session", zorder=5)
    axes.set_title(link.name, loc="left", fontsize="medium")
    axes.set_xlabel("round trip R [ms]")
    axes.set_ylabel(f"stiffness [{link.units('N/m')}]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small", frameon=False)


def _groups(devices: Sequence[DeviceBudget]) -> list[tuple[str, DeviceBudget]]:
    """Devices with equal limits under one heading, weakest first."""
    by_limit: dict[float, list[DeviceBudget]] = {}
    for device in devices:
        by_limit.setdefault(device.against_delay[0].colgate, []).append(device)
    return [(_names([d.name for d in same]), same[0]) for _, same in sorted(by_limit.items())]


def _names(names: Sequence[str]) -> str:
    most = 4
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _figure(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}" if value > 0.0 else "none"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.4g}"
