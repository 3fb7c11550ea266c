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

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course
from manyhands.launch.audit.findings import Check, CheckVerdict, UncheckedTicks, compare, first_of, gaps_of
from manyhands.launch.recordings.run import FiguresByTick, there
from manyhands.nodes.kernel.arithmetic import Floats, Saturation
from manyhands.nodes.kernel.bundle import Common, CouplingBundle, WaveEnd
from manyhands.nodes.rows.own_ticks import own_tick_before
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.nodes.wave_link.ends import user_face, world_face
from manyhands.protocol.channels import TANK_NAMES

Array = NDArray[np.float64]
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


@dataclass(eq=False)
class EndAgain:
    """One end, computed again.

    Attributes:
        rows: as recorded.
        tank: E_0, J.
        signal: f of a user's end, N, or p of a world's, m; ticks x ports.
        entered: the energy that entered the link at this end in each tick, by motion and force, J; NaN where unknown.
        level: L that follows, ticks x 1, J.
        tolerance: of the energies of each tick, J.
        room: what the wave of each tick could cost at most, and what it cost, ticks x 2, J.
        gaps: why some ticks could not be computed.
    """

    rows: EndRows
    tank: float
    signal: Array
    entered: Array
    level: Array
    tolerance: Array
    room: Array
    gaps: list[UncheckedTicks] = field(default_factory=list)


def user_end(common: Common, bundle: CouplingBundle, wave: WaveEnd, rows: EndRows, course: Course) -> EndAgain:
    """The user's end: f_c from p and c, and the tank.

    Args:
        common: of the coupling.
        bundle: the coupling's part of the session.
        wave: this end of its link.
        rows: of the coupling, and of its end.
        course: what happened between them.
    """
    out, whole = _nothing(rows, wave.tank), rows.whole
    face = user_face(common, wave, bundle.block.D)
    saturation = Saturation(bundle.limits.force)
    begun = {k for k, happened in course.before.items() if happened.began}
    before: Floats | None = None  # x_c of the tick before
    for k in np.flatnonzero(whole).tolist():
        p, f, c = rows.p[k].tolist(), rows.f[k].tolist(), rows.c[k].tolist()
        if k in begun:
            before = p  # the first p of a process is where the tool is
        elif k == 0 or not whole[k - 1]:
            before = None
        if before is None:
            out.gaps.append(UncheckedTicks(k, k + 1, _AFTER_GAP))
            applied, free = f, False
        else:
            moved = [to - at for to, at in zip(p, before, strict=True)]
            free = not any(f) and c == face.free_wave(moved)
            again = [0.0] * len(f) if free else face.force(c, moved)
            clipped = saturation.clip(again)
            out.signal[k] = clipped
            applied = f if clipped is again else again  # where it was clipped the face goes on with its own force
        after = face.position(p, applied)
        harvest = 0.0
        if before is not None:
            harvests = None if free else wave.theta
            harvest = _book(out, k, applied, before, after, harvests, common.period, user=True)
        _tank(out, k, k in begun, whole, (wave, common.period), applied, harvest, user=True)
        if free:  # the wave of a free end goes back as it came, and nobody pays for it
            out.room[k, 1] = 0.0
        before = after
    out.gaps += gaps_of(~whole & _within(whole), "it has no whole row there")
    return out


def world_end(common: Common, wave: WaveEnd, rows: EndRows, coupling: str, figures: FiguresByTick) -> EndAgain:
    """The world's end: p from f_v and c, and the tank.

    Args:
        common: of the environment.
        wave: this end of the link of ``coupling``.
        rows: of the environment, at the coupling's ports.
        coupling: its name.
        figures: of the environment, with its events.
    """
    out, whole = _nothing(rows, wave.tank), rows.whole
    face = world_face(common, wave)
    events = [event for _, values in figures for event in events_in(values)]
    aligned = {event.tick for event in events if event.kind is Kind.LINKED and event.peer == coupling}
    begun = {event.tick for event in events if event.kind is Kind.BEGAN}
    before: Floats | None = None
    for k in np.flatnonzero(whole).tolist():
        p, f, c = rows.p[k].tolist(), rows.f[k].tolist(), rows.c[k].tolist()
        if k in aligned:
            before = None
            out.gaps.append(UncheckedTicks(k, k + 1, _BEGINS))
        elif k in begun:
            before = [0.0] * len(p)
        elif k == 0 or not whole[k - 1]:
            before = None
            out.gaps.append(UncheckedTicks(k, k + 1, _AFTER_GAP))
        after, harvest = face.position(p, f), 0.0
        if before is not None:
            out.signal[k] = face.free_position(before, c)
            harvest = _book(out, k, f, before, after, wave.theta, common.period, user=False)
        elif k in aligned:
            # the place before follows from the wave, to rounding; no force acts until the clutch has moved
            start = [at - by for at, by in zip(p, face.free_position([0.0] * len(p), c), strict=True)]
            harvest = _book(out, k, f, start, after, wave.theta, common.period, user=False)
        _tank(out, k, k in begun, whole, (wave, common.period), f, harvest, user=False)
        before = after
    out.gaps += gaps_of(~whole & _within(whole), "it has no whole row there")
    return out


def _within(whole: Flags) -> Flags:
    """The ticks between the first and the last that are whole."""
    known = np.flatnonzero(whole)
    out = np.zeros(len(whole), dtype=np.bool_)
    if len(known):
        out[known[0] : known[-1]] = True
    return out


def _nothing(rows: EndRows, tank: float) -> EndAgain:
    ticks, ports = rows.p.shape
    one = np.full((ticks, 1), np.nan)
    pair = np.full((ticks, 2), np.nan)
    return EndAgain(rows, tank, np.full((ticks, ports), np.nan), one[:, 0].copy(), one, np.zeros((ticks, 1)), pair)


def _book(
    out: EndAgain, k: int, f: Floats, before: Floats, after: Floats, theta: Array | None, T: float, *, user: bool
) -> float:
    """Book what entered the link in tick k, J: -f_c^T (x(k) - x(k-1)) at a user's end, +f_e^T (...) at a world's.

    Returns:
        The harvest T w^T theta w, J, which is booked as well.
    """
    moved = np.array(after) - np.array(before)
    harvest = 0.0 if theta is None else float(moved @ theta @ moved) / T
    out.entered[k] = (-1.0 if user else 1.0) * float(np.array(f) @ moved) + harvest
    size = float(np.abs(f) @ (np.abs(before) + np.abs(after))) + harvest
    out.tolerance[k, 0] += ROUNDING * _EPSILON * size
    return harvest


def _tank(
    out: EndAgain,
    k: int,
    begun: bool,
    whole: Flags,
    of: tuple[WaveEnd, float],
    f: Floats,
    harvest: float,
    *,
    user: bool,
) -> None:
    """L(k) and the cost of the wave, from the tank before; G and H count anew in a new life."""
    wave, T = of
    level, shipped, heard = out.rows.tank[k].tolist()
    if begun:
        before = [wave.tank if k == 0 else 0.0, 0.0, 0.0]
    elif k == 0 or not whole[k - 1]:
        return
    else:
        before = out.rows.tank[k - 1].tolist()
    if shipped < before[1] or heard < before[2]:
        before[1] = before[2] = 0.0
    c = out.rows.c[k]
    roots = _roots(wave)
    a = c + (-2.0 if user else 2.0) * np.linalg.solve(roots, np.array(f))
    paid, earned = 0.5 * T * float(c @ c), 0.5 * T * float(a @ a)
    out.level[k] = before[0] + (heard - before[2]) - paid + earned + harvest - (shipped - before[1])
    sums = sum(map(abs, (*before, level, shipped, heard)))
    out.tolerance[k, 0] += ROUNDING * _EPSILON * (sums + paid + earned)
    out.room[k] = before[0] + (heard - before[2]), paid


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
    rows = again.rows
    what = "f_v follows from p and the wave c" if user else f"p of {of} follows from f_v and the wave c"
    kept, text = rows.tank[:, :1], f"the tank of {of}'s wave link follows from waves, energy heard and energy shipped"
    fell = np.hstack([rows.tank[:, :1], again.room[:, :1] - again.room[:, 1:]])
    return [
        compare("wave", party, what, ports, rows.f if user else rows.p, again.signal, gaps=again.gaps),
        compare("tank", party, text, TANK_NAMES[:1], kept, again.level, tolerance=again.tolerance, source=_SOURCE),
        _never_below_zero(party, f"at {of}'s wave link it paid for each wave, and shipped what it had", fell, again),
    ]


def _never_below_zero(party: str, what: str, values: Array, again: EndAgain) -> Check:
    wrong = values < -again.tolerance
    first = first_of(wrong, ("L", "L left by the wave"), values, np.zeros_like(values))
    numbers = int(np.isfinite(values).sum())
    verdict = CheckVerdict.BROKEN if first is not None else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
    least = f"least tank {1e3 * float(np.nanmin(values[:, 0])):.4g} mJ" if np.isfinite(values[:, 0]).any() else ""
    widest = float(again.tolerance.max(initial=0.0))
    return Check("rules", party, what, verdict, numbers, first, int(wrong.sum()), (), widest, _SOURCE, least)


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
    ticks = len(world.entered)
    at = np.array([own_tick_before(k, rate) for k in range(ticks)], dtype=np.intp)
    at = np.minimum(at, len(user.entered) - 1)
    of_user, slack_u, end_u = _so_far(user)
    of_world, slack_w, end_w = _so_far(world)
    total = of_user[at] + of_world
    # what an end has heard ahead of the other's row was shipped by then, in a row between the two
    ahead = np.maximum(0.0, world.rows.tank[:, 2] - user.rows.tank[at, 1])
    ahead += np.maximum(0.0, user.rows.tank[at, 2] - world.rows.tank[:, 1])
    known = (np.arange(ticks) < end_w) & (at < end_u)
    total = np.where(known, total + np.nan_to_num(ahead), np.nan)[:, None]
    bound, tolerance = -(user.tank + world.tank), (slack_u[at] + slack_w)[:, None]
    wrong = total < bound - tolerance
    first = first_of(wrong, ("E",), total, np.full_like(total, bound))
    numbers = int(known.sum())
    verdict = CheckVerdict.BROKEN if first is not None else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
    what = f"the energy that entered the wave link of {coupling} at both ends is never below -2 E_0 (Theorem 1)"
    remark = f"least {1e3 * min(0.0, float(np.nanmin(total))):.4g} mJ of {1e3 * bound:g} mJ" if numbers else ""
    last = int(known.argmin()) if not known.all() else ticks
    gaps = (UncheckedTicks(last, ticks, "an end has no whole row there, and the sum of its energy is not known"),)
    widest = float(np.max(tolerance, initial=0.0))
    return Check(
        "link", coupling, what, verdict, numbers, first, int(wrong.sum()), gaps if last < ticks else (), widest,
        _SOURCE, remark,
    )  # fmt: skip


def _so_far(end: EndAgain) -> tuple[Array, Array, int]:
    """The energy that has entered at an end, its tolerance, by tick, and the tick from which on it is not known.

    A tick without energy at the beginning, before the first whole row, adds nothing.
    """
    known = np.isfinite(end.entered)
    first = int(known.argmax()) if known.any() else 0
    after = np.flatnonzero(~known[first:])
    stop = first + int(after[0]) if len(after) else len(known)
    entered = np.cumsum(np.nan_to_num(end.entered))
    return entered, np.cumsum(end.tolerance[:, 0]), stop
