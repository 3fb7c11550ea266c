"""Checks the two ends of a recorded wave link from their own rows, and Theorem 1 from the rows of both.

Each end records its incoming wave c, as it was paid for, and its tank: L, the energy shipped G, the energy heard H. The
rest follows (:mod:`manyhands.nodes.wave_link.faces`), by the faces' own arithmetic:

| end | from | follows, to the last bit |
|---|---|---|
| user's | p of the coupling, c | f_v, the force that the coupling handed on |
| world's | f_v behind the clutch, c | p, which the environment took for the tool |

With a = c -+ 2 h^-1 f the tank's energy follows to rounding: L(k) = L(k-1) + dH - T/2 |c|^2 + T/2 |a|^2 + T w^T theta w
- dG. The rules of the link are that a wave was paid for, T/2 |c|^2 <= L(k-1) + dH, that what was shipped was there,
0 <= dG and 0 <= L(k), and that every H was a G of the other end.

**Theorem 1** is checked from motion and force alone, as the two parties beside the link recorded them: the energy that
entered the link at both ends is never below -2 E_0. The clocks of two processes are not compared. Energy that an end
has heard before the other end's row of that time states it as shipped is under way between the two rows.

The play-out, which decides when a wave is played, is free policy, and is not computed again. A number of a wave that
was changed contradicts the force or the position of its own tick.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import Check, UncheckedTicks, compare, gaps_of, within
from manyhands.launch.audit.recompute import Array, FollowedParty, Recomputed, recompute
from manyhands.launch.recordings.run import FiguresByTick, there
from manyhands.nodes.kernel.arithmetic import Floats, Saturation
from manyhands.nodes.kernel.bundle import Common, CouplingBundle, WaveEnd
from manyhands.nodes.rows.own_ticks import own_tick_before
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.nodes.wave_link.ends import user_face, world_face
from manyhands.protocol.channels import TANK_NAMES

Flags = NDArray[np.bool_]

ROUNDING: Final = 64.0
"""Units in the last place of a tick's energies and of the sums in the tank, by which the order of sums may change L."""

_EPSILON: Final = float(np.finfo(np.float64).eps)
_SOURCE: Final = f"{ROUNDING:g} units in the last place of the tick's energies, since the order of the sums differs"
_BEGINS: Final = "a life of the wave link began: the tool took its place from the first wave"
_AFTER_GAP: Final = "the row before is missing, or the process before left no row of its end"


@dataclass(frozen=True, eq=False)
class EndRows:
    """The rows of one end of a wave link, ticks x ports of the coupling; NaN where there is none.

    Attributes:
        p: the free position of the tool, m.
        f: the force, N: as the coupling handed it on, or as it is behind the clutch.
        c: the incoming wave, W^(1/2).
        tank: L, G and H, ticks x 3, J.
    """

    p: Array
    f: Array
    c: Array
    tank: Array

    @property
    def whole(self) -> Flags:
        """The ticks of which every number is there."""
        return there(np.hstack([self.p, self.f, self.c, self.tank]))


class EndAgain(NamedTuple):
    """One end: its ``rows`` as recorded, E_0 of its ``tank``, J, and the fields of a :class:`FollowedEnd`."""

    rows: EndRows
    tank: float
    fields: Recomputed

    @property
    def tolerance(self) -> Array:
        """Of the energies of each tick, ticks x 1, J."""
        return np.nan_to_num(self.fields["tolerance"])


class FollowedEnd(FollowedParty):
    """An end of a wave link, from its own rows: each follows from the one before, as it was recorded.

    Its fields are ``signal``, f of a user's end, N, or p of a world's, m; ``entered``, the energy that entered the link
    at this end in the tick, by motion and force, J; ``level``, the L that follows, and its ``tolerance``, J; ``room``,
    what the wave of the tick could cost at most, and what it cost, J.
    """

    def __init__(self, common: Common, wave: WaveEnd, rows: EndRows, begun: Collection[int], sign: float) -> None:
        """Take what was recorded.

        Args:
            common: of the node.
            wave: this end of its link.
            rows: of the node, and of its end.
            begun: the ticks in which a process began.
            sign: of the energy f^T (x(k) - x(k-1)) that enters the link: -1 at a user's end, 1 at a world's.
        """
        self._wave, self._T, self._recorded, self._begun, self._sign = wave, common.period, rows, begun, sign
        self._whole, self._roots = rows.whole, _roots(wave)
        self._after: Floats = []  # where the tool was after the tick before
        self._notes: list[UncheckedTicks] = []
        self.ticks, ports = rows.p.shape
        self.rows = np.flatnonzero(self._whole).tolist()
        self.fields = {"signal": ports, "entered": 1, "level": 1, "tolerance": 1, "room": 2}

    def begin(self, joins: bool) -> None:
        """Nothing: the state of an end is in the row before."""

    def end(self) -> EndAgain:
        """The end, computed again."""
        again = recompute(self, Course({}, {}, self.ticks))
        again.gaps += [*self._notes, *gaps_of(~self._whole & _within(self._whole), "it has no whole row there")]
        return EndAgain(self._recorded, self._wave.tank, again)

    def _before(self, k: int) -> Floats | None:
        """Where the tool was before tick ``k``, m; None where the row before is missing, which is noted."""
        if k > 0 and self._whole[k - 1]:
            return self._after
        self._notes.append(UncheckedTicks(k, k + 1, _AFTER_GAP))
        return None

    def _booked(
        self, k: int, f: Floats, before: Floats | None, after: Floats, harvests: bool = True
    ) -> dict[str, Sequence[float]]:
        """What entered the link in tick k, its harvest T w^T theta w included, and the tank that follows, J.

        Args:
            k: the tick.
            f: the force on the link, N.
            before: where the tool was, m; None where that is not known.
            after: where it is, m.
            harvests: whether theta is earned.
        """
        out: dict[str, Sequence[float]] = {}
        self._after, harvest, tolerance, theta = after, 0.0, 0.0, self._wave.theta
        if before is not None:
            moved = np.array(after) - np.array(before)
            if theta is not None and harvests:
                harvest = float(moved @ theta @ moved) / self._T
            out["entered"] = [self._sign * float(np.array(f) @ moved) + harvest]
            size = float(np.abs(f) @ (np.abs(before) + np.abs(after))) + harvest
            tolerance = ROUNDING * _EPSILON * size
        tank, c, T = self._recorded.tank, self._recorded.c[k], self._T
        if k in self._begun:
            held = [self._wave.tank if k == 0 else 0.0, 0.0, 0.0]
        elif k > 0 and self._whole[k - 1]:
            held = tank[k - 1].tolist()
        else:
            return {**out, "tolerance": [tolerance]}
        level, shipped, heard = tank[k].tolist()
        if shipped < held[1] or heard < held[2]:  # G and H count anew in a new life
            held[1] = held[2] = 0.0
        a = c + self._sign * 2.0 * np.linalg.solve(self._roots, np.array(f))
        paid, earned, room = 0.5 * T * float(c @ c), 0.5 * T * float(a @ a), held[0] + (heard - held[2])
        out["level"] = [room - paid + earned + harvest - (shipped - held[1])]
        tolerance += ROUNDING * _EPSILON * (sum(map(abs, (*held, level, shipped, heard))) + paid + earned)
        return {**out, "tolerance": [tolerance], "room": [room, paid]}


class FollowedUserEnd(FollowedEnd):
    """The user's end: f_c from p and c, and the tank."""

    def __init__(self, common: Common, bundle: CouplingBundle, wave: WaveEnd, rows: EndRows, course: Course) -> None:
        """Take what was recorded.

        Args:
            common: of the coupling.
            bundle: the coupling's part of the session.
            wave: this end of its link.
            rows: of the coupling, and of its end.
            course: what happened between them.
        """
        super().__init__(common, wave, rows, {k for k, happened in course.before.items() if happened.began}, -1.0)
        self._face = user_face(common, wave, bundle.block.D)
        self._saturation = Saturation(bundle.limits.force)

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """f_c, what entered, and the tank."""
        rows, face = self._recorded, self._face
        p, f, c = rows.p[k].tolist(), rows.f[k].tolist(), rows.c[k].tolist()
        before = p if k in self._begun else self._before(k)  # the first p of a process is where the tool is
        if before is None:
            return self._booked(k, f, None, face.position(p, f))
        moved = [to - at for to, at in zip(p, before, strict=True)]
        free = not any(f) and c == face.free_wave(moved)
        again = [0.0] * len(f) if free else face.force(c, moved)
        clipped = self._saturation.clip(again)
        applied = f if clipped is again else again  # where it was clipped the face goes on with its own force
        out = {**self._booked(k, applied, before, face.position(p, applied), not free), "signal": clipped}
        if free and "room" in out:  # the wave of a free end goes back as it came, and nobody pays for it
            out["room"] = [out["room"][0], 0.0]
        return out


class FollowedWorldEnd(FollowedEnd):
    """The world's end: p from f_v and c, and the tank."""

    def __init__(self, common: Common, wave: WaveEnd, rows: EndRows, coupling: str, figures: FiguresByTick) -> None:
        """Take what was recorded.

        Args:
            common: of the environment.
            wave: this end of the link of ``coupling``.
            rows: of the environment, at the coupling's ports.
            coupling: its name.
            figures: of the environment, with its events.
        """
        events = [event for _, values in figures for event in events_in(values)]
        super().__init__(common, wave, rows, {event.tick for event in events if event.kind is Kind.BEGAN}, 1.0)
        self._aligned = {event.tick for event in events if event.kind is Kind.LINKED and event.peer == coupling}
        self._face = world_face(common, wave)

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """p, what entered, and the tank."""
        rows, face = self._recorded, self._face
        p, f, c = rows.p[k].tolist(), rows.f[k].tolist(), rows.c[k].tolist()
        after, rest = face.position(p, f), [0.0] * len(p)
        if k in self._aligned:
            self._notes.append(UncheckedTicks(k, k + 1, _BEGINS))
            # the place before follows from the wave, to rounding; no force acts until the clutch has moved
            start = [at - by for at, by in zip(p, face.free_position(rest, c), strict=True)]
            return self._booked(k, f, start, after)
        before = rest if k in self._begun else self._before(k)
        out = self._booked(k, f, before, after)
        return out if before is None else {**out, "signal": face.free_position(before, c)}


def _within(whole: Flags) -> Flags:
    """The ticks between the first and the last that are whole."""
    known = np.flatnonzero(whole)
    out = np.zeros(len(whole), dtype=np.bool_)
    if len(known):
        out[known[0] : known[-1]] = True
    return out


def _roots(wave: WaveEnd) -> Array:
    """The matrix h = (2 b)^(1/2)."""
    eigenvalues, Q = np.linalg.eigh(wave.b)
    out: Array = (Q * np.sqrt(2.0 * eigenvalues)) @ Q.T
    return out


def end_checks(party: str, of: str, ports: tuple[str, ...], again: EndAgain, *, user: bool) -> list[Check]:
    """The checks of one end.

    Args:
        party: the node of this end.
        of: the coupling whose link it is.
        ports: of the link.
        again: the end, computed again.
        user: whether it is the user's end.
    """
    rows, fields, room = again.rows, again.fields, again.fields["room"]
    what = "f_v follows from p and the wave c" if user else f"p of {of} follows from f_v and the wave c"
    kept, text = rows.tank[:, :1], f"the tank of {of}'s wave link follows from waves, energy heard and energy shipped"
    fell = np.hstack([rows.tank[:, :1], room[:, :1] - room[:, 1:]])
    return [
        compare("wave", party, what, ports, rows.f if user else rows.p, fields["signal"], gaps=fields.gaps),
        compare("tank", party, text, TANK_NAMES[:1], kept, fields["level"], tolerance=again.tolerance, source=_SOURCE),
        _never_below_zero(party, f"at {of}'s wave link it paid for each wave, and shipped what it had", fell, again),
    ]


def _never_below_zero(party: str, what: str, values: Array, again: EndAgain) -> Check:
    least = f"least tank {1e3 * float(np.nanmin(values[:, 0])):.4g} mJ" if np.isfinite(values[:, 0]).any() else ""
    columns, wrong = ("L", "L left by the wave"), values < -again.tolerance
    widest, zero = float(again.tolerance.max(initial=0.0)), np.zeros_like(values)
    return within("rules", party, what, columns, values, zero, wrong, tolerance=widest, source=_SOURCE, remark=least)


def heard_from(party: str, other: str, own: EndAgain, its: EndAgain) -> Check:
    """Every energy that ``party`` has heard is one that ``other`` states as shipped; missing rows excuse some."""
    H, G = own.rows.tank[:, 2], its.rows.tank[:, 1]
    known = np.isfinite(H) & (H != 0.0)
    sent = np.unique(G[np.isfinite(G)])
    at = np.searchsorted(sent, H)
    found = np.zeros(len(H), dtype=np.bool_)
    inside = at < len(sent)
    found[inside] = sent[at[inside]] == H[inside]
    unknown = known & ~found
    excused = bool((~its.rows.whole & _within(its.rows.whole)).any()) or not its.rows.whole.all()
    nearest = np.full((len(H), 1), np.nan)
    nearest[known & found, 0] = H[known & found]
    gaps = []
    if excused:
        gaps = gaps_of(unknown, f"{other} has no row of the tick in which it may have shipped it")
    elif len(sent):
        nearest[unknown, 0] = sent[np.maximum(at[unknown] - 1, 0)]
    what = f"the energy that it heard over the wave link is what {other} had shipped"
    return compare("heard", party, what, TANK_NAMES[2:], H[:, None], nearest, gaps=gaps, owed=known)


def ledger_of_both(coupling: str, user: EndAgain, world: EndAgain, rate: float) -> Check:
    """Theorem 1: the energy that entered the wave link at both ends is never below -2 E_0.

    Args:
        coupling: whose link it is.
        user: its user's end.
        world: its world's end.
        rate: ticks of the user's end in one of the world's.
    """
    ticks = len(world.rows.p)
    at = np.array([own_tick_before(k, rate) for k in range(ticks)], dtype=np.intp)
    at = np.minimum(at, len(user.rows.p) - 1)
    of_user, slack_u, end_u = _so_far(user)
    of_world, slack_w, end_w = _so_far(world)
    total = of_user[at] + of_world
    # what an end has heard ahead of the other's row was shipped by then, in a row between the two
    ahead = np.maximum(0.0, world.rows.tank[:, 2] - user.rows.tank[at, 1])
    ahead += np.maximum(0.0, user.rows.tank[at, 2] - world.rows.tank[:, 1])
    known = (np.arange(ticks) < end_w) & (at < end_u)
    total = np.where(known, total + np.nan_to_num(ahead), np.nan)[:, None]
    bound, tolerance = -(user.tank + world.tank), (slack_u[at] + slack_w)[:, None]
    what = f"the energy that entered the wave link of {coupling} at both ends is never below -2 E_0 (Theorem 1)"
    least = min(0.0, float(np.nanmin(total))) if known.any() else 0.0
    last = int(known.argmin()) if not known.all() else ticks
    gaps = (UncheckedTicks(last, ticks, "an end has no whole row there, and the sum of its energy is not known"),)
    return within(
        "link", coupling, what, ("E",), total, np.full_like(total, bound), total < bound - tolerance,
        gaps=gaps if last < ticks else (), tolerance=float(np.max(tolerance, initial=0.0)), source=_SOURCE,
        remark=f"least {1e3 * least:.4g} mJ of {1e3 * bound:g} mJ",
    )  # fmt: skip


def _so_far(end: EndAgain) -> tuple[Array, Array, int]:
    """The energy that has entered at an end, its tolerance, by tick, and the tick from which on it is not known.

    A tick without energy at the beginning, before the first whole row, adds nothing.
    """
    of_ticks = end.fields["entered"][:, 0]
    known = np.isfinite(of_ticks)
    first = int(known.argmax()) if known.any() else 0
    after = np.flatnonzero(~known[first:])
    stop = first + int(after[0]) if len(after) else len(known)
    entered = np.cumsum(np.nan_to_num(of_ticks))
    return entered, np.cumsum(end.tolerance[:, 0]), stop
