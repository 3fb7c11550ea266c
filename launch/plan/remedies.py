"""What would help a session that cannot be certified: changes of its keys, each tried before it is offered.

A closed form of a limit is true only as long as nothing else decides: an environment that lacks passivity takes a part
of the devices' level, a proof needs room, and the gains that are tried are a few. So no figure is computed here. A
change is made to the session, as a user would make it, and the changed session is designed and proved. It is offered
only where that succeeds, with the values that were tried and with what they give.

A quantity with a limit is a :class:`Lever`. Its limit is searched with what a design begins with
(:func:`.synthesis.finds_levels`), and the design itself then decides a little inside of it.

Fifteen trials find a limit. In a session of many ports each takes seconds, so there the search has
:data:`MOST_SECONDS`, and names what it has not tried to the end.
"""

from __future__ import annotations

import json
import math
import shlex
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np

from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.world import CONDITION_A
from manyhands.launch.plan.feel import stiffness_range
from manyhands.launch.plan.loop import NotCertified, stated_delay
from manyhands.launch.plan.sites import IN_TICK, part, world
from manyhands.launch.session import ENVIRONMENT, Session, SessionError

FEW_PORTS: Final = 12
"""Ports of a session up to which all changes are tried, however long it takes: some seconds."""

FEW_STATES: Final = 48
"""States of its environment, likewise."""

MOST_SECONDS: Final = 60.0
"""For how long changes of a larger session are tried; a trial that has begun is finished."""

_MOST_TEXT = 300  # characters of what is to be set: more is no advice to type
_DIGITS = 5  # of a value that is tried
_CLOSE = 2e-4  # relative: how closely a limit is found
_TRIED = 0.999  # of what was found to help, closest to the limit: the value that is offered
_BELOW = (0.985, 0.96)  # of the same: what has to help as well, so that there is no gap right beside it
_WIDEST = 64.0  # by how much a quantity is changed at most
_RANGE = 1e6  # likewise, of a quantity that the session does not state
_REFUSED = (DesignError, NotCertified, SessionError, ValueError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Remedy:
    """A change with which a session, or its part, was designed and proved.

    Attributes:
        what: the change in words, with its limit where it has one.
        changes: the values that were tried, by path of keys, as ``--set`` and ``mh.load`` take them.
        gives: what they give.
    """

    what: str
    changes: Mapping[str, Any]
    gives: str

    def __str__(self) -> str:
        return f"{self.what}: {settings(self.changes)} is certified {self.gives}"


@dataclass(frozen=True)
class Lever:
    """A quantity of a session that can be turned down or up, all of its values by one factor.

    Attributes:
        what: the quantity.
        unit: in which it is stated.
        values: what the session has, by path of keys.
        own: the numbers that its limit is stated of, if they are one number; otherwise it is stated as a factor.
        up: whether more of it is meant to help.
        inverse: the paths of values that go the other way.
        scale: from the session's unit to the one in which it is stated.
        note: what follows the figure.
        widest: by how much it is changed at most.
    """

    what: str
    unit: str
    values: Mapping[str, Any]
    own: tuple[float, ...]
    up: bool = False
    inverse: frozenset[str] = field(default_factory=frozenset)
    scale: float = 1.0
    note: str = ""
    widest: float = _WIDEST

    def at(self, share: float) -> dict[str, Any]:
        """The values at ``share`` of the way that the session has: 1 leaves them, and less is meant to help more."""
        return {key: _scaled(value, share, self.up != (key in self.inverse)) for key, value in self.values.items()}

    def limit(self, share: float) -> str:
        """The quantity with its limit in words."""
        factor, side = (1.0 / share, "above") if self.up else (share, "below")
        if self.own and math.isclose(min(self.own), max(self.own), rel_tol=1e-9):
            return f"{self.what} {side} {self.scale * self.own[0] * factor:.4g} {self.unit}{self.note}"
        return f"{self.what} {side} {factor:.4g} times the session's{self.note}"


@dataclass(frozen=True)
class Cap:
    """A limit of given springs, and of their dampers where these count as well, in proportion to the devices' levels.

    Attributes:
        ports: of the session.
        stiffness: K by port, N/m.
        damping: B by port, N·s/m, which is lowered in proportion; 0 where it does not count.
        level: Delta_D by port, N·s/m, which the limits follow.
        period: T, s.
        units: of a stiffness, by port.
    """

    ports: tuple[str, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    level: tuple[float, ...]
    period: float
    units: tuple[str, ...]
    widest: ClassVar[float] = _WIDEST

    @property
    def what(self) -> str:
        """The quantity."""
        return "a stiffness plus 2/T times its damping" if any(self.damping) else "a stiffness"

    def _used(self) -> Iterator[tuple[float, float]]:
        """By port: K + 2/T B, and its limit where no port is beyond it, N/m."""
        used = [K + 2.0 / self.period * B for K, B in zip(self.stiffness, self.damping, strict=True)]
        over = max(one / level for one, level in zip(used, self.level, strict=True))
        return ((one, over * level) for one, level in zip(used, self.level, strict=True))

    def at(self, share: float) -> dict[str, Any]:
        """The values with limits of ``share`` of those within which all ports are: 1 leaves them."""
        kept = [min(1.0, share * top / used) for used, top in self._used()]
        out: dict[str, Any] = {}
        for key, own in (("design.stiffness", self.stiffness), ("design.damping", self.damping)):
            values = [_scaled(one, part, False) if part < 1.0 else one for one, part in zip(own, kept, strict=True)]
            out |= {key: values[0] if len({*values}) == 1 else values} if any(own) else {}
        return out

    def limit(self, share: float) -> str:
        """The quantity with the limits that it exceeds, in words."""
        limits = {
            port: f"{share * top:.4g} {unit}"
            for port, unit, (used, top) in zip(self.ports, self.units, self._used(), strict=True)
            if used > share * top
        }
        if len({*limits.values()}) == 1:
            return f"{self.what} below {next(iter(limits.values()))}"
        return f"{self.what} below {' and '.join(f'{limit} at {port}' for port, limit in limits.items())}"


@dataclass(frozen=True)
class Option:
    """A change without a limit.

    Attributes:
        what: the change in words.
        changes: by path of keys.
    """

    what: str
    changes: Mapping[str, Any]


Ways = tuple[Lever | Cap | Option, ...]
"""Ways to one end, of which the first that helps is offered."""


class OutOfTime(Exception):
    """The time of a kind of change is over."""


class TimeLeft:
    """The time of a search. Each kind of change has half of what is left, so that none takes it from all others."""

    def __init__(self, most: float, now: Callable[[], float]) -> None:
        """Begin; ``most`` is in s, infinite for no end, and ``now`` returns the present time, s."""
        self._now, self._end = now, now() + most
        self._due = self._end

    def begin(self) -> None:
        """Begin a kind of change."""
        now = self._now()
        self._due = now + max(0.0, self._end - now) / 2.0

    def check(self) -> None:
        """Called before each trial.

        Raises:
            OutOfTime: no other trial may begin.
        """
        if self._now() >= self._due:
            raise OutOfTime


def with_remedies(error: DesignError, session: Session, name: str = IN_TICK) -> DesignError:
    """The error that searches what helps when it is asked, :func:`remedies`; as it is where it is about no condition.

    Args:
        error: why the design of a part failed.
        session: the session.
        name: of the part.
    """
    if not isinstance(error, Infeasible):
        return error
    return error.searching(lambda: remedies(session, name, error.untried))


def remedies(
    session: Session, name: str = IN_TICK, untried: list[str] | None = None, now: Callable[[], float] = time.monotonic
) -> Iterator[Remedy]:
    """What would help a part of a session that cannot be certified, each as soon as it was tried.

    Args:
        session: the session.
        name: of the part.
        untried: receives what was not tried to the end for lack of time; None where nobody asks.
        now: returns the present time, s.
    """
    untried = [] if untried is None else untried
    untried.clear()
    few = len(session.ports) <= FEW_PORTS and _order(session) <= FEW_STATES
    left = TimeLeft(math.inf if few else MOST_SECONDS, now)
    plain = session.to_dict()
    for kind in _KINDS:
        left.begin()
        for way in kind(session, plain, name):
            try:
                found = _tried(session, name, way, left)
            except OutOfTime:
                untried.append(way.what)
                break
            if found is not None:
                yield found
                break


def _order(session: Session) -> int:
    try:
        return session.environment.for_design(session.ports).order
    except _REFUSED:
        return 0


def _tried(session: Session, name: str, way: Lever | Cap | Option, left: TimeLeft) -> Remedy | None:
    """The remedy that a way is, if the design accepts it.

    Raises:
        OutOfTime: the time left is over before that is known.
    """

    def designed(changes: Mapping[str, Any]) -> str | None:
        left.check()
        try:
            return _gives(session.replace(changes), name)
        except _REFUSED:
            return None

    if isinstance(way, Option):
        gives = designed(way.changes)
        return None if gives is None else Remedy(way.what, way.changes, gives)
    if len(settings(way.at(_TRIED))) > _MOST_TEXT:
        return None

    def levels(share: float) -> bool:
        left.check()
        try:
            return _finds_levels(session.replace(way.at(share)), name)
        except _REFUSED:
            return False

    def proved(share: float) -> bool:
        return designed(way.at(share)) is not None

    for helps in (levels, proved):
        if (share := _limit(helps, way.widest)) is None:
            return None
        changes = way.at(share * _TRIED)
        if (gives := designed(changes)) is not None:
            return Remedy(way.limit(share * (1.0 + _CLOSE / 2.0)), changes, gives)
    return None


def _finds_levels(session: Session, name: str) -> bool:
    """Whether a design of a part would go on to its proof."""
    from manyhands.design.synthesis import finds_levels  # the solver takes a second to import

    if name == ENVIRONMENT:
        return _gives(session, name) is not None
    own = part(session, name)
    return finds_levels(own.loop, own.request)


def _gives(session: Session, name: str) -> str:
    """What the design of a part gives, proved.

    Raises:
        DesignError: it is not certified.
    """
    if name == ENVIRONMENT:
        return f"with a margin of {world(session).margins[CONDITION_A]:.3g} {session.units()('N·s/m')}"
    found = stiffness_range(part(session, name).design().certificate)
    if found is None:
        return "without a static stiffness"
    least, most = (f"{value:.4g}" for value in found)
    unit = part(session, name).loop.units()("N/m")
    return f"at {least} {unit}" if least == most else f"at {least} to {most} {unit}"


def _limit(helps: Callable[[float], bool], widest: float = _WIDEST) -> float | None:
    """The greatest share of a quantity that helps, up to a relative 0.02 %; None if there is none.

    Beside an environment that lacks passivity a gain may certify a coupling only close below its limit, and not a
    softer one. Such a gap is no limit to state: what is a little less has to help as well. The search begins at the
    top, for a program that fails at one number far below would otherwise be taken for the limit.
    """
    high = 1.0
    while high > 1.0 / widest and not helps(low := high / 2.0):
        high = low
    if high <= 1.0 / widest:
        return None
    while high / low > 1.0 + _CLOSE:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if helps(middle) else (low, middle)
    return low if all(helps(low * below) for below in _BELOW) else None


# How a value is changed, and written


def _scaled(value: Any, share: float, up: bool) -> Any:
    """A number, or every number in a list or a mapping, times ``share`` or, upwards, divided by it, and rounded so."""
    if isinstance(value, Mapping):
        return {key: _scaled(inner, share, up) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(inner, share, up) for inner in value]
    if isinstance(value, bool) or not isinstance(value, int | float) or value == 0.0:
        return value
    exact = abs(value) / share if up else abs(value) * share
    unit = 10.0 ** (math.floor(math.log10(exact)) + 1 - _DIGITS)
    whole = math.ceil(exact / unit - 1e-9) if up else math.floor(exact / unit + 1e-9)
    return math.copysign(float(f"{whole * unit:.{_DIGITS}g}"), value)


def settings(changes: Mapping[str, Any]) -> str:
    """The options that make these changes: ``--set design.stiffness=2734``."""
    return " ".join(f"--set {shlex.quote(f'{key}={_flow(value)}')}" for key, value in changes.items())


def _flow(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, float):
        text = f"{value:.12g}"
        mantissa, e, exponent = text.partition("e")  # YAML 1.1 reads 1e-05 as a text
        return text if not e or "." in mantissa else f"{mantissa}.0e{exponent}"
    return json.dumps(value) if value is None or isinstance(value, bool | int) else str(value)


def _numbers(value: Any) -> tuple[float, ...]:
    """All numbers other than 0 in a value."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return tuple(number for inner in value for number in _numbers(inner))
    return () if isinstance(value, bool | str) or not value else (abs(float(value)),)


def _lever(
    session: Session, what: str, unit: str, values: Mapping[str, Any], own: tuple[float, ...] | None = None, **more: Any
) -> Ways:
    """The lever of these values, stated of all their numbers; no way where none is a number other than 0.

    Where they have two units, because some axes turn and others do not, no one number states their limit.
    """
    numbers, units = _numbers(values), session.units()
    if own is None:
        own = () if len({unit, units(unit)}) > 1 and len(units.kinds) > 1 else numbers
    return (Lever(what, units(unit), values, own, **more),) if numbers else ()


# What can be changed


def _softer(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A softer given coupling; where its damping counts as well, all of it."""
    design = plain["design"]
    if name == ENVIRONMENT or design["coupling"] != "given":
        return ()
    if "matrices" in design:
        compliance = {
            f"design.matrices.{coupling}.{key}": block[key]
            for coupling, block in design["matrices"].items()
            for key in ("C", "D", "static")
            if _numbers(block.get(key, 0.0))
        }
        return _lever(session, "a stiffness of the coupling", "", compliance, own=(), inverse=frozenset(compliance))
    stiffness, damping = session.given_stiffness, session.given_damping
    if stiffness is None or damping is None:
        raise AssertionError("a validated session gives stiffness and damping, or matrices")
    level = np.concatenate([np.diag(session.osp_level(device)) for device in session.devices])
    if np.count_nonzero(stiffness - np.diag(np.diag(stiffness))) or np.count_nonzero(
        damping - np.diag(np.diag(damping))
    ):
        values = {f"design.{key}": design[key] for key in ("stiffness", "damping") if key in design}
        return _lever(session, "a stiffness of the coupling", "", values, own=())
    K, B, by_port = (tuple(one.tolist()) for one in (np.diag(stiffness), np.diag(damping), level))
    units = tuple(session.units(port)("N/m") for port in session.ports)
    springs = Cap(session.ports, K, (0.0,) * len(K), by_port, session.period, units)
    return (springs, Cap(session.ports, K, B, by_port, session.period, units)) if any(B) else (springs,)


def _damped(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A given coupling with more damping, or less."""
    damping = plain["design"].get("damping")
    if name == ENVIRONMENT or not _numbers(damping):
        return ()
    values = {"design.damping": damping}
    return (
        *_lever(session, "a damping of the coupling", "N·s/m", values),
        *_lever(session, "a damping of the coupling", "N·s/m", values, up=True),
    )


def _designed(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """Springs and dampers that are found, in place of a coupling of another class."""
    design = plain["design"]
    kept = {key: design[key] for key in ("tau", "period_tolerance", "speed", "ladder") if design.get(key)}
    designed, springs = "a coupling that is designed", "springs and dampers"
    what = {"given": designed, "none": designed, "linear": springs}.get(design["coupling"])
    if name == ENVIRONMENT or what is None:
        return ()
    return (Option(what, {"design": {"coupling": "spring-damper", **kept}}),)


def _without_aim(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """An objective that needs no dynamics of the world."""
    design = plain["design"]
    if name == ENVIRONMENT or design.get("objective", "feasible") in ("feasible", "stiffest"):
        return ()
    kept = {key: value for key, value in design.items() if key not in ("objective", "weights")}
    return (Option("no aim but to be certified", {"design": kept}),)


def _devices(session: Session, name: str) -> tuple[str, ...]:
    """The devices of a part."""
    if name == ENVIRONMENT:
        return ()
    couplings = (name,) if name != IN_TICK else [c for c in session.couplings if c not in session.wave_links]
    return tuple(dict.fromkeys(device for coupling in couplings for device in session.devices_of(coupling)))


def _level(osp: Any) -> Any:
    """A level as a user would write it: a matrix that is a number, or a number for each axis, as that."""
    if not isinstance(osp, list) or not all(isinstance(row, list) for row in osp):
        return osp
    axes = [row[i] for i, row in enumerate(osp)]
    if any(entry for i, row in enumerate(osp) for j, entry in enumerate(row) if i != j):
        return osp
    return axes[0] if len({*axes}) == 1 else axes


def _stronger(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """Devices that damp more."""
    values = {f"devices.{device}.osp": _level(plain["devices"][device]["osp"]) for device in _devices(session, name)}
    return _lever(session, "devices with an osp", "N·s/m", values, up=True)


def _quicker(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A shorter period."""
    key = "period"
    if name in session.wave_links and session.wave_links[name].period is not None:
        key = f"couplings.{name}.wave_link.period"
    period = session.wave_links[name].period_in(session.period) if name in session.wave_links else session.period
    return _lever(session, "a period", "ms", {key: period}, scale=1e3)


def _sooner(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A shorter delay inside the tick, where one is stated."""
    if name == ENVIRONMENT:
        return ()
    own = session.wave_links[name].tau if name in session.wave_links else None
    if own is not None:
        values = {f"couplings.{name}.wave_link.tau": own}
    elif session.design.stated_tau is not None:
        values = {"design.tau": stated_delay(session)}
    else:
        stated = ("sample_age", "actuation_delay")
        values = {
            f"devices.{device}.{key}": plain["devices"][device][key]
            for device in _devices(session, name)
            for key in stated
            if key in plain["devices"][device]
        }
    return _lever(session, "a delay inside the tick", "ms", values, scale=1e3, note=", if every force comes so soon")


def _steadier(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """Periods that vary less."""
    if name == ENVIRONMENT:
        return ()
    values = {"design.period_tolerance": session.design.period_tolerance}
    return _lever(session, "a period_tolerance", "of the period", values, note=", if every period keeps to it")


def _less_harvest(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A site whose wave link takes less of its devices' damping."""
    if name not in session.wave_links:
        return ()
    harvest = plain["couplings"][name]["wave_link"].get("harvest", 0.0)
    return _lever(session, "a harvest", "N·s/m", {f"couplings.{name}.wave_link.harvest": harvest})


def _softer_world(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A world of softer springs, or that promises a smaller level."""
    world = plain["environment"]
    match world["type"]:
        case "network":
            springs = {
                f"environment.links.{i}.stiffness": link["stiffness"]
                for i, link in enumerate(world["links"])
                if _numbers(link.get("stiffness", 0.0))
            }
            return _lever(session, "springs of the world", "N/m", springs)
        case "transfer-function":
            forces = {
                f"environment.entries.{i}.{j}.num": entry["num"]
                for i, row in enumerate(world["entries"])
                for j, entry in enumerate(row)
                if _numbers(entry["num"])
            }
            return _lever(session, "forces of the world", "", forces, own=())
        case "state-space":
            forces = {f"environment.{key}": world[key] for key in ("C", "D", "static") if _numbers(world.get(key, 0.0))}
            return _lever(session, "forces of the world", "", forces, own=())
        case _:
            level = world.get("level", 0.0)
            return _lever(session, "a declared level", "N·s/m", {"environment.level": level})


def _damped_world(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A network whose dampers damp more."""
    world = plain["environment"]
    dampers = {
        f"environment.links.{i}.damping": link["damping"]
        for i, link in enumerate(world.get("links", ()))
        if isinstance(link, Mapping) and _numbers(link.get("damping", 0.0))
    }
    return _lever(session, "dampers of the world", "N·s/m", dampers, up=True)


def _prompt_world(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A world whose forces come sooner: fewer whole ticks, the most that help."""
    ticks = plain["environment"].get("delay", 0)
    words = ("a world without delay", "a world of 1 tick of delay")
    return tuple(
        Option(words[n] if n < len(words) else f"a world of {n} ticks of delay", {"environment.delay": n})
        for n in range(ticks - 1, -1, -1)
    )


def _other_world(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A world whose level is enforced, or that is discretised so that passivity stays."""
    world = plain["environment"]
    ways = []
    if world.get("enforce") is False:
        ways.append(Option("a level that is enforced", {"environment.enforce": True}))
    if world.get("method", "backward-euler") != "backward-euler":
        ways.append(Option("backward Euler", {"environment.method": "backward-euler"}))
    return tuple(ways)


def _of_mechanism(key: str, what: str, unit: str, up: bool = False) -> Callable[..., Ways]:
    """A lever of a key of each device of the part that has it."""

    def ways(session: Session, plain: dict[str, Any], name: str) -> Ways:
        values = {}
        for device in _devices(session, name):
            value: Any = plain["devices"][device]
            for step in key.split("."):
                value = value.get(step) if isinstance(value, Mapping) else None
            if value is not None:
                values[f"devices.{device}.{key}"] = value
        return _lever(session, what, unit, values, up=up)

    return ways


def _at_every_speed(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """No speed below which friction is to count."""
    design = plain["design"]
    if name == ENVIRONMENT or "speed" not in design:
        return ()
    return (Option("no design.speed", {"design": {key: value for key, value in design.items() if key != "speed"}}),)


def _below_a_speed(session: Session, plain: dict[str, Any], name: str) -> Ways:
    """A speed below which the dry friction of devices counts as damping."""
    devices = _devices(session, name)
    stated = [own.least for device in devices if (own := session.devices[device].friction) is not None]
    if name == ENVIRONMENT or session.wave_links or "speed" in plain["design"] or not stated:
        return ()
    friction = max(_numbers(stated), default=0.0)
    level = min(float(np.diag(session.osp_level(device)).min()) for device in devices)
    # there friction is worth 0.01 % of the damping, which is less than a limit is found by
    values = {"design.speed": 1e4 * friction / level}
    return _lever(session, "a design.speed", "m/s", values, widest=_RANGE, note=", beyond which nothing is proved")


def _held(kind: Callable[..., Ways]) -> Callable[..., Ways]:
    """A lever of devices whose motors hold torques alone: for others their limits decide nothing."""

    def ways(session: Session, plain: dict[str, Any], name: str) -> Ways:
        return kind(session, plain, name) if any(session.holds_torques(d) for d in _devices(session, name)) else ()

    return ways


_KINDS: Final[tuple[Callable[[Session, dict[str, Any], str], Ways], ...]] = (
    _softer,
    _damped,
    _designed,
    _stronger,
    _quicker,
    _sooner,
    _steadier,
    _held(_of_mechanism("limits.force", "a greatest force", "N")),
    _held(_of_mechanism("limits.speed", "a greatest speed", "m/s")),
    _held(_of_mechanism("orientation.osp", "an orientation with an osp", "N·m·s/rad", up=True)),
    _held(_of_mechanism("orientation.limits.torque", "a greatest torque", "N·m")),
    _of_mechanism("step", "a step of the encoder", "m"),
    _of_mechanism("friction.least", "a dry friction", "N", up=True),
    _below_a_speed,
    _at_every_speed,
    _without_aim,
    _less_harvest,
    _prompt_world,
    _softer_world,
    _damped_world,
    _other_world,
)
"""What can be changed, the usual first: one function and a line here a kind."""
