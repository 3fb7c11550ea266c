"""A machine's profile for one kind of session: its measured delays, the tau that they ask for, and the file kept of it.

A certificate covers delays from sample to force up to tau, and tau costs stiffness. No tau covers every tick of a
machine with other work. So a design takes a quantile of the delays that were measured, and a little more:

    tau = T/20 min(20, ceil(q / (T/20)) + 1),    q = the p99.5 of the slowest device's delays,

and for the period tolerance rho, up to which a period may be too long, likewise

    rho = 1/20 min(20, ceil(20 (p/T - 1)) + 1),    p = the p99 of the slowest device's periods.

Devices of another period, behind wave links, have a tau of their own from their own delays (:attr:`Profile.others`).

The quantile, the grid and the reserve are choices; docs/decisions/0031-designed-for-the-machine.md has the figures.

A profile is kept in the user's cache for a day, so that not every launch has to measure. Its key holds what a delay
depends on: the machine and its rights, the versions, the transport, the period, and the session's processes, links and
processors. Names are left out, so sessions of the same form share a profile. Other programs that run on the machine
are no part of a key, and this is why a profile ages.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import signal
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import zmq
from pydantic import TypeAdapter

from manyhands import __version__
from manyhands.design.files import open_regular, replacing
from manyhands.launch.doctor.machine import has_compiled_tick
from manyhands.launch.plan.plan import Plan
from manyhands.launch.session import Session
from manyhands.nodes.kernel.realtime import may_raise

QUANTILE: Final = 0.995
"""The part of a device's ticks whose delay a design covers."""

STEPS: Final = 20
"""Steps of the grid of tau in one period."""

RESERVE: Final = 1
"""Steps that are added to a measured quantile: the next seconds are not those that were measured. So tau is T/10 at
least, and a period may be T/20 too long at least."""

MOST_AGE: Final = 86_400.0
"""Seconds for which a profile is used."""

LEAST_KEPT: Final = 1.0
"""Seconds of measuring without which a profile is not kept: the p99.5 of less is one burst more or less."""

LEAST_TICKS: Final = 1000
"""Ticks without which a run says nothing of a profile that was too careful."""

_FORMAT: Final = 3  # of the file
_MOST_BYTES: Final = 2**20  # a session of a thousand nodes has a key of some 100 kB


class ProbeFailed(Exception):
    """The probe failed; the message names the process and the reason."""


class ProbeInterrupted(Exception):
    """The user interrupted the probe.

    Attributes:
        signal: the signal that came.
    """

    def __init__(self, which: signal.Signals) -> None:
        super().__init__(which)
        self.signal = which


@dataclass(frozen=True)
class Lateness:
    """Percentiles of a duration of the slowest device, us; each a measured value.

    Attributes:
        p50: the median.
        p995: the quantile that a design covers, :data:`QUANTILE`.
        p999: the 99.9th percentile.
        max: the longest.

    Raises:
        ValueError: they do not grow from above 0, or are not finite.
    """

    p50: float
    p995: float
    p999: float
    max: float

    def __post_init__(self) -> None:
        if not 0.0 < self.p50 <= self.p995 <= self.p999 <= self.max < math.inf:
            raise ValueError(f"found {self}; expected percentiles that grow from above 0")

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Self:
        """The percentiles of at least one duration, given in ns."""
        durations = np.array(nanoseconds, dtype=np.float64) / 1e3
        return cls(*map(float, np.quantile(durations, (0.5, QUANTILE, 0.999, 1.0), method="higher")))

    @classmethod
    def slowest(cls, delays: Iterable[Sequence[int]]) -> Self:
        """Of the delays of at least one device, ns, those of the device with the longest quantile."""
        return max(map(cls.of, delays), key=lambda found: found.p995)


@dataclass(frozen=True)
class Profile:
    """The measured delays of one kind of session on this machine.

    Attributes:
        key: what it was measured for, :func:`profile_key`.
        tau: from sample to force, of the slowest device whose period is :attr:`Session.device_period`.
        period: the p99 of the time between two samples, us, of the device where it is the longest part of its period;
            as it would be with :attr:`Session.device_period`.
        late: the part of all ticks that ended after the next one was due.
        seconds: how long was measured, s.
        measured: when, in s since the epoch.
        others: as tau, of the devices of each other period, by that period, s.

    Raises:
        ValueError: a number is negative, or not finite.
    """

    key: Mapping[str, Any]
    tau: Lateness
    period: float
    late: float
    seconds: float
    measured: float
    others: Mapping[float, Lateness] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not all(0.0 <= number < math.inf for number in (self.period, self.late, self.seconds, self.measured)):
            raise ValueError(f"found {self}; expected numbers of at least 0")

    def age(self, now: float) -> float:
        """Seconds since the measurement at ``now``, in s since the epoch."""
        return now - self.measured

    def told(self, now: float) -> str:
        """When and where it was measured, and the quantile of the delay, for people."""
        return f"measured here, {ago(self.age(now))}: p99.5 is {1e-3 * self.tau.p995:.3g} ms"


@dataclass(frozen=True)
class Stated:
    """What a session states of its delays, which no measurement of ticks at rest contains.

    Attributes:
        latency: the greatest sample_age and actuation_delay of a device together, s.
        tolerance: rho that the design asks for.
        varies: the greatest part of its period by which the age of a device's samples varies.
        period: T for which ``varies`` is, s.
    """

    latency: float = 0.0
    tolerance: float = 0.0
    varies: float = 0.0
    period: float = 1.0

    @classmethod
    def of(cls, session: Session) -> Self:
        """What a session states."""
        return cls(session.latency, session.design.period_tolerance, session.greatest_jitter, session.device_period)

    def tolerance_at(self, period: float) -> float:
        """Rho beside the periods that are measured, at another period, s."""
        varies = self.varies if period == self.period else self.varies * self.period / period
        return max(self.tolerance, min(1.0, varies))


NOTHING: Final = Stated()
"""What a session states whose devices have no delay beside their loop."""


@dataclass(frozen=True)
class Allowance:
    """What a design has to cover on a machine.

    Attributes:
        measured: the delay of a tick to cover, with the reserve, s; at most the period.
        latency: what devices add to it, s (:attr:`Stated.latency`).
        period_tolerance: rho; periods of up to (1 + rho) T are covered.
        found: the measured quantile of the delay, s; it may be longer than the period.
        period: T, s.
    """

    measured: float
    latency: float
    period_tolerance: float
    found: float
    period: float

    @property
    def tau(self) -> float:
        """The delay inside the tick to certify, s; with a latency it may be longer than the period."""
        return round(self.measured + self.latency, 12)

    @property
    def covered(self) -> bool:
        """Whether a certificate can cover all of it: none covers more than a whole period."""
        return self.found <= self.period and self.tau <= self.period


def allowance(profile: Profile, period: float, stated: Stated = Stated()) -> Allowance:
    """The delay and the period tolerance to design for: what was measured, by the formulas of this module, and what is
    stated. Doctor, budget, design and launch have their delay from here.

    Args:
        profile: what was measured.
        period: T, s.
        stated: what the session states beside it; nothing by default.
    """
    longer = _part(max(profile.period * 1e-6 / period - 1.0, 0.0))
    if stated.latency:
        longer = min(1.0, longer + stated.tolerance_at(period))
    tolerance = max(longer, stated.tolerance)
    return Allowance(_allowed(profile.tau, period), stated.latency, tolerance, profile.tau.p995 * 1e-6, period)


def allowances_of_sites(profile: Profile, session: Session) -> dict[str, Allowance]:
    """What to cover at each site of another period than :attr:`Session.device_period`, by its coupling."""
    out = {}
    for name, link in session.wave_links.items():
        period = link.period_in(session.period)
        if (delays := profile.others.get(period)) is not None:
            latency = max(session.latencies[device] for device in session.devices_of(name))
            out[name] = Allowance(_allowed(delays, period), latency, 0.0, delays.p995 * 1e-6, period)
    return out


def _allowed(delays: Lateness, period: float) -> float:
    """Tau for such delays in such a period, s."""
    return round(period * _part(delays.p995 * 1e-6 / period), 12)


def _part(measured: float) -> float:
    """A measured part of a period, rounded up to the grid, with the reserve; at most 1."""
    return min(math.ceil(measured * STEPS - 1e-9) + RESERVE, STEPS) / STEPS


def outlived(profile: Profile, session: Session, nodes: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether a run contradicts the profile, so that the next launch should measure anew.

    It does where the p99 of a device's delays is longer than what was designed for, or where all of them were much
    quicker: p99.9 of at least :data:`LEAST_TICKS` ticks is below the profile's p99.5.

    Args:
        profile: what was measured before the run.
        session: the session that ran. A profile has no part of the delays that its devices' drivers state.
        nodes: of the report of the run, by name (docs/files.md).
    """
    slower, quicker = False, []
    for name in nodes.keys() & session.devices.keys():
        node, own, period = nodes[name], 1e6 * session.latencies[name], session.period_of(name)
        if "tau_us" not in node:
            continue
        measured = profile.others.get(period, profile.tau)
        slower |= node["tau_us"]["p99"] - own > max(1e6 * _allowed(measured, period), measured.p995)
        quicker.append(node["ticks"] >= LEAST_TICKS and node["tau_us"]["p999"] - own < measured.p995)
    return slower or (bool(quicker) and all(quicker))


def profile_key(plan: Plan, transport: str, encrypted: bool, places: Mapping[str, int]) -> dict[str, Any]:
    """What the delays of a session depend on, as plain data.

    Args:
        plan: the session, of which the period and the graph are used.
        transport: "ipc" or "tcp".
        encrypted: whether the links are encrypted.
        places: the processor of each node that is pinned to one.
    """
    graph, system = plan.graph, platform.uname()
    number = {name: index for index, name in enumerate(graph.nodes)}
    return {
        "format": _FORMAT,
        "version": __version__,
        "host": system.node,
        "kernel": f"{system.system} {system.release} {system.version}",
        "processors": sorted(os.sched_getaffinity(0)),
        "fifo": may_raise(),
        "python": platform.python_version(),
        "compiled": has_compiled_tick(),
        "zeromq": zmq.zmq_version(),
        "transport": transport,
        "encrypted": encrypted,
        "period": plan.session.period,
        "sites": [[number[name], plan.session.period_of(name)] for name in plan.session.wave_links],
        "nodes": [[role.value, len(graph.ports[name])] for name, role in graph.nodes.items()],
        "links": [[number[link.binder], number[link.connector], len(link.ports)] for link in graph.links],
        "places": [[number[name], processor] for name, processor in places.items()],
    }


def ago(seconds: float) -> str:
    """How long ago, in words; the age of a kept profile is at most a day."""
    if seconds < 60.0:
        return "just now"
    return f"{seconds / 60.0:.0f} min ago" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h ago"


def cache_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """The folder of kept profiles: below XDG_CACHE_HOME, or ~/.cache where that is not an absolute path."""
    base = Path(environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():
        base = Path(environ.get("HOME") or Path.home()) / ".cache"
    return base / "manyhands" / "profiles"


def kept_profile(key: Mapping[str, Any], now: float, folder: Path | None = None) -> Profile | None:
    """The profile that is kept under a key.

    Args:
        key: what it must have been measured for.
        now: s since the epoch.
        folder: where profiles are kept; by default :func:`cache_folder`.

    Returns:
        None where there is none: no file, one that is too old or of the future, one that others may write to, or one
        that does not hold what a profile holds. A new measurement replaces it.
    """
    path = _path(key, folder)
    try:
        with open_regular(path, _MOST_BYTES) as file:
            status = os.fstat(file.fileno())
            if status.st_uid != os.geteuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return None
            profile = _FILE.validate_json(file.read(_MOST_BYTES), strict=True)
    except (OSError, ValueError):
        return None
    return profile if profile.key == dict(key) and 0.0 <= profile.age(now) <= MOST_AGE else None


def keep_profile(profile: Profile, folder: Path | None = None) -> bool:
    """Keep a profile under its key, for this user alone; an older one is replaced.

    Returns:
        Whether it was kept: less than :data:`LEAST_KEPT` of measuring is not.

    Raises:
        OSError: the folder or the file cannot be made.
    """
    if profile.seconds < LEAST_KEPT:
        return False
    path = _path(profile.key, folder)
    path.parent.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with replacing(path, mode=0o600) as file:
        file.write(_FILE.dump_json(profile, indent=1) + b"\n")
    return True


def drop_profile(profile: Profile, folder: Path | None = None) -> None:
    """Keep this profile no longer: a run has shown that it does not hold.

    Raises:
        OSError: the file is there and cannot be removed.
    """
    with contextlib.suppress(FileNotFoundError):
        _path(profile.key, folder).unlink()


def _path(key: Mapping[str, Any], folder: Path | None) -> Path:
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return (cache_folder() if folder is None else folder) / f"{digest[:32]}.json"


_FILE: Final = TypeAdapter(Profile)
