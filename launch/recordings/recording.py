"""Every x and f_v of a run, tick by tick, and the files that hold them.

The file's suffix chooses the format (:mod:`manyhands.launch.recordings.formats`). ``.npz`` holds arrays ``x`` and
``f_v`` (ticks x ports), with the port names, the period, the session and the certificate's id; it is exact. The others
have one row a tick. :mod:`manyhands.launch.recordings.tables` reads ``.npz``, ``.csv`` and ``.mcap``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import replacing
from manyhands.design.models.axis import units_by_port
from manyhands.design.models.brief import brief_names
from manyhands.extras import require
from manyhands.launch.files import require_target
from manyhands.launch.recordings.curves import backward_difference
from manyhands.launch.recordings.formats import EXTRAS, STREAMED, SUFFIXES, TABLES, TableOfRun
from manyhands.nodes.kernel.bundle import MAX_TELEMETRY_TICKS, TELEMETRY_PERIOD
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party, spans_by_party

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]

MOST_MISSING_TICKS = 1_000_000  # of one device in all; more than that is no loss but ticks that make no sense


class RecordingError(Exception):
    """A recording cannot be written or read."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A run's signals.

    Attributes:
        session: the session's name.
        certificate: id of the certificate it ran under.
        period: T, s.
        ports: names of the m ports.
        x: ticks x m, m.
        f_v: ticks x m, N.
        missing: number of ticks that were not recorded, NaN in x and f_v, by device, for devices that miss some.
        cut: why the file it was read from is not whole, and up to which tick it is; None for a whole file.
        turning: the ports that turn: their x is in rad, and their f_v in N·m.
    """

    session: str
    certificate: str
    period: float
    ports: tuple[str, ...]
    x: Array
    f_v: Array
    missing: Mapping[str, int] = field(default_factory=dict)
    cut: str | None = None
    turning: tuple[str, ...] = ()

    @property
    def time(self) -> Array:
        """The instants kT, s."""
        return np.arange(self.x.shape[0], dtype=np.float64) * self.period

    @property
    def velocity(self) -> Array:
        """(x(k) - x(k-1))/T, m/s, ticks x m."""
        return backward_difference(self.x, self.period)

    def final_speed(self, ports: Sequence[str]) -> float:
        """The greatest speed that a device with these ports had in its last 0.1 s (at most 1000 ticks), m/s.

        So does a node state it in its report; the first sample has no speed.
        """
        own = [self.ports.index(port) for port in ports]
        last = min(MAX_TELEMETRY_TICKS, max(1, round(TELEMETRY_PERIOD / self.period)))
        speeds = np.linalg.norm(self.velocity[1:, own][-last:], axis=1)
        return float(np.max(speeds, initial=0.0))

    def columns(self) -> dict[str, NDArray[Any]]:
        """The recording as a table: ``tick``, ``time_s``, ``x[PORT]_m`` and ``f_v[PORT]_N``, by name.

        A port that turns has ``x[PORT]_rad`` and ``f_v[PORT]_N·m``.
        """
        units = units_by_port(self.ports, self.turning)
        ports = [f"{signal}[{p}]_{units[p](unit)}" for signal, unit in (("x", "m"), ("f_v", "N")) for p in self.ports]
        values = dict(zip(ports, np.hstack([self.x, self.f_v]).T, strict=True))
        return {"tick": np.arange(len(self.x)), "time_s": self.time, **values}

    def to_pandas(self) -> pandas.DataFrame:
        """The table as a data frame, with the time in s as its index.

        Raises:
            RecordingError: pandas is not installed.
        """
        return data_frame(self.columns(), "time_s")

    def __repr__(self) -> str:
        return f"Recording({self.session}: {len(self.x)} ticks of {self.period:g} s, ports {brief_names(self.ports)})"

    def save(self, path: Path | str) -> None:
        """Write the file whole or not at all, in the format of its suffix (:data:`.SUFFIXES`).

        Raises:
            RecordingError: the suffix is unknown, or the file cannot be written.
            MissingExtra: an extra is missing that writes such files.
        """
        path = Path(path)
        require_suffix(path)
        try:
            with replacing(path) as file:
                TABLES[path.suffix.removeprefix(".")](file, self._table(), lambda _part: None)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error

    def _table(self) -> TableOfRun:
        about = {"session": self.session, "certificate": self.certificate, "period": repr(self.period)}
        names = {"session": self.session, "certificate": self.certificate}
        arrays = {"x": self.x, "f_v": self.f_v, "ports": np.array(self.ports), "period": self.period} | names
        if self.turning:
            arrays["turning"] = np.array(self.turning)
        return TableOfRun(self.columns(), arrays, about)


def data_frame(columns: Mapping[str, NDArray[Any]], index: str | None = None) -> pandas.DataFrame:
    """A table as a data frame, with one of its columns as the index if that is wanted.

    Raises:
        MissingExtra: pandas is not installed; ``columns()`` has the same numbers without it.
    """
    require("pandas")
    import pandas

    frame = pandas.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def require_suffix(path: Path, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Refuse a file name that cannot be recorded to, before a run begins.

    Raises:
        RecordingError: the suffix is none of ``suffixes``.
        MissingExtra: an extra is missing that writes such files.
        TargetError: the file cannot be written there.
    """
    require_format(path, suffixes)
    require_target(path)


def require_format(path: Path, suffixes: tuple[str, ...]) -> None:
    """Refuse a file name whose suffix is none of ``suffixes``, or of a format whose library is missing.

    Raises:
        RecordingError: the suffix is another.
        MissingExtra: an extra is missing that reads and writes such files.
    """
    if path.suffix not in suffixes:
        raise RecordingError(f"{path}: found the suffix {path.suffix!r}; expected one of {', '.join(suffixes)}")
    if path.suffix in EXTRAS:
        require(EXTRAS[path.suffix])


def one_period(periods: Mapping[str, float], path: Path | None = None) -> float:
    """The period that all of these devices have, s: a table with a row a tick has one for all.

    Args:
        periods: T of each device, s.
        path: the file, for the message.

    Raises:
        RecordingError: two devices have different periods.
    """
    (first, period), *others = periods.items()
    for device, other in others:
        if other != period:
            raise RecordingError(
                f"{'' if path is None else f'{path}: '}found the period {period:g} s of {first} and {other:g} s of "
                f"{device}; expected devices of one period, since this file has one row a tick: record a {STREAMED}, "
                "which keeps the ticks of every node"
            )
    return period


class Collector:
    """Joins the traces of the devices' telemetry, for each device separately.

    Attributes:
        refused: number of messages whose traces fit no device, its ports, or its ticks so far.
    """

    def __init__(self, ports: Mapping[str, tuple[str, ...]], most_missing: int = MOST_MISSING_TICKS) -> None:
        """Begin without any tick.

        Args:
            ports: of each device.
            most_missing: the most ticks that one device may miss.
        """
        self._ports, self._most_missing = ports, most_missing
        self._chunks: dict[str, list[tuple[Array, Array]]] = {device: [] for device in ports}
        self._coverage = {device: Coverage() for device in ports}
        self.refused = 0

    def add(self, device: str, tick: int, x: Array, f_v: Array) -> None:
        """Add the rows that end before ``tick``; a gap is filled with NaN and counted.

        A message that does not fit is counted and changes nothing, since it comes from outside.
        """
        ports = self._ports.get(device)
        if ports is None or x.ndim != 2 or x.shape != f_v.shape or x.shape[1] != len(ports):
            self.refused += 1
            return
        coverage, first = self._coverage[device], tick - x.shape[0]
        gap = first - coverage.next
        if not 0 <= gap <= self._most_missing - coverage.missing_in(0, coverage.next):
            self.refused += 1
            return
        if gap:
            self._chunks[device].append((self._hole(device, gap),) * 2)
        self._chunks[device].append((x, f_v))
        coverage.take(first, tick)

    def _hole(self, device: str, ticks: int) -> Array:
        return np.full((ticks, len(self._ports[device])), np.nan)

    @property
    def tick(self) -> int:
        """Number of ticks of the device with the most."""
        return max(coverage.next for coverage in self._coverage.values())

    @property
    def missing(self) -> Mapping[str, int]:
        """Number of ticks of the run that a device did not report, by device, for devices that miss some.

        A realtime run may lose telemetry, so that no tick is disturbed. A device may also stop reporting, or never
        begin.
        """
        return missing_by_party(self._coverage, spans_by_party(self._coverage, lambda _device: 1.0, 0))

    def recording(self, session: str, certificate: str, period: float, turning: tuple[str, ...] = ()) -> Recording:
        """The whole run, of which these ports turn; ticks that a device did not report are NaN.

        It ends with the last tick of any device.
        """
        columns = [self._column(device, self.tick) for device in self._ports]
        return Recording(
            session,
            certificate,
            period,
            tuple(port for ports in self._ports.values() for port in ports),
            np.hstack([x for x, _ in columns]),
            np.hstack([f for _, f in columns]),
            self.missing,
            turning=turning,
        )

    def _column(self, device: str, ticks: int) -> tuple[Array, Array]:
        rest = self._hole(device, ticks - self._coverage[device].next)
        chunks = self._chunks[device]
        return np.vstack([*(x for x, _ in chunks), rest]), np.vstack([*(f_v for _, f_v in chunks), rest])
