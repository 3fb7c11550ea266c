"""The checks of a recording's rows that need no state of a party.

The force that a coupling handed on is the force that its devices exerted. A tool is where its coupling's end is. The
total in a node's figures is the last of its trace. A ledger never falls below where it began, nor an account below its
tank. No device exceeds its limits. Instants are in the order of time, and delays and periods are as the certificate
assumes.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.environment import ROUNDING, Blocks
from manyhands.launch.audit.events import Course
from manyhands.launch.audit.findings import Check, CheckVerdict, UncheckedTicks, compare, within
from manyhands.launch.recordings.run import RecordedRun, rows_of, there
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import NOTHING, SIMULATED, WALL, DeviceBundle
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import INSTANT_NAMES

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_EPSILON = float(np.finfo(np.float64).eps)

LEDGER_ROUNDING = 1e-12
"""A ledger may be below its bound by this part of all the work in its increments, which is rounding."""

_LIMITS = "no tolerance: the node itself compares with this limit"


def forces_agree(run: RecordedRun, blocks: Blocks, forces: Array, owed: Mapping[str, Flags]) -> list[Check]:
    """For each coupling: the force that it handed on is the force that its devices exerted, in the ticks it owed."""
    what = "the force that it handed on is the one that its devices exerted"
    ports = run.recorded.ports
    return [
        compare("agreement", name, what, ports[name], blocks.f[:, own], forces[:, own], owed=owed[name])
        for name, own in blocks.ports.items()
    ]


def tools_agree(
    blocks: Blocks, columns: tuple[str, ...], party: str, tools: Array, sign: tuple[int, str], owed: Flags
) -> Check:
    """Tools are at x_e = p + D_V f_v, as long as no clutch has moved, in the ticks that the environment owed."""
    ends, size = blocks.ends()
    begin, why = sign
    ends[begin:] = np.nan
    ends[blocks.clipped] = np.nan
    gaps = [UncheckedTicks(begin, len(tools), f"{why}, and a clutch may have moved")] if begin < len(tools) else []
    tolerance = ROUNDING * _EPSILON * np.where(np.isnan(size), 0.0, size)
    source = f"{ROUNDING:g} units in the last place of |p| + |D_V| |f_v|, since the order of the sums differs"
    what = "tools are at p + D_V f_v, as the couplings recorded them"
    return compare(
        "agreement", party, what, columns, tools, ends, gaps=gaps, tolerance=tolerance, source=source, owed=owed
    )


def figures_agree(run: RecordedRun, node: str) -> Check:
    """The ledger's total in the figures is the last of the trace before them.

    Figures before a gap, or at a run's end in real time, are not compared: they may count free periods that have no
    row.
    """
    trace = rows_of(run, node, names.LEDGER)
    reported = np.full_like(trace, np.nan)
    compared = np.zeros(len(trace), dtype=np.bool_)
    last = len(reported) if run.recorded.clock == SIMULATED else len(reported) - 1
    for tick, figures in run.figures.get(node, ()):
        if 0 < tick <= last and (tick == len(reported) or np.isfinite(trace[tick, 0])):
            reported[tick - 1] = figures.get(names.LEDGER, np.nan)
            compared[tick - 1] = names.LEDGER in figures
    what = "the ledger's total in its figures is that of its trace"
    return compare("figures", node, what, ("E",), trace, reported, owed=compared)


def bounded(run: RecordedRun, node: str, allowed: LatenessAllowance = NOTHING, promised: bool = True) -> Check:
    """A ledger of ``node`` is never below 0. It includes the work of every hand, a person's at a browser as well.

    Args:
        run: the recording.
        node: its name.
        allowed: how far the ledger may fall below 0: of a device in wall time, by what lateness may put in.
        promised: whether the node promised that bound. A device in wall time without a tank did not, if an assumption
            of the certificate did not hold: then lateness may have put in what is missing.

    Returns:
        The check; nothing was checked where no ledger was kept.
    """
    trace = rows_of(run, node, names.LEDGER)
    bound = f"-{allowed}, its tank" if allowed != NOTHING else "0"
    what = f"its ledger never fell below {bound}: it kept its promise"
    if not promised:
        what = "its ledger is never below 0, as within the certificate; what lateness puts in is not enforced"
    most = np.full_like(trace, allowed.energy)
    if allowed.power:
        most = _allowed_by(allowed, rows_of(run, node, names.INSTANTS)[:, 1])  # the power is booked at a_k
    otherwise = CheckVerdict.BROKEN if promised else CheckVerdict.ASSUMPTION
    remark = f"least {float(np.nanmin(trace, initial=0.0)):.6g} J"
    return _never_below("bound", node, what, ("E",), trace, 0.0 - most, otherwise, remark)


def _never_below(
    name: str, node: str, what: str, column: tuple[str], account: Array, least: Array, otherwise: CheckVerdict,
    remark: str,
) -> Check:  # fmt: skip
    """An account, J, is never below ``least``, but for the rounding of its increments."""
    known = account[np.isfinite(account)]
    tolerance = LEDGER_ROUNDING * float(np.abs(np.diff(known, prepend=0.0)).sum())
    source = f"{LEDGER_ROUNDING:g} of the sum of its increments' magnitudes: rounding"
    return within(
        name, node, what, column, account, least, account < least - tolerance, otherwise=otherwise,
        tolerance=tolerance, source=source, remark=remark,
    )  # fmt: skip


def _allowed_by(allowance: LatenessAllowance, at: Array) -> Array:
    """E_0 + P t, ticks x 1, J, at these instants since tick 0, ns."""
    return np.array([[allowance.by(t)] for t in np.nan_to_num(at) * 1e-9])


def account_bounded(node: str, account: Array, at: Array, allowance: LatenessAllowance | None) -> Check:
    """The account e_k of a device in wall time is never below -(E_0 + P t); counted alone, 0 is an assumption.

    Args:
        node: the device.
        account: recorded, ticks x 1, J.
        at: the instants a_k, ns since tick 0.
        allowance: E_0 and P; None where nothing bounds the account.
    """
    least = 0.0 - (np.zeros_like(account) if allowance is None else _allowed_by(allowance, at))
    what, otherwise = f"lateness put in no more than its tank of {allowance}", CheckVerdict.BROKEN
    if allowance is None:
        what = "its account is never below 0, as within the certificate; nothing bounds it in this session"
        otherwise = CheckVerdict.ASSUMPTION
    remark = f"least account {1e3 * float(np.nanmin(account, initial=0.0)):.4g} mJ"
    return _never_below("account", node, what, ("e",), account, least, otherwise, remark)


def ordered(run: RecordedRun, node: str, instants: Array, course: Course, owed: Flags, latency: int = 0) -> Check:
    """The instants of a device in wall time are in order: a_(k-1) <= s_k <= a_k, and the force before ended by a_k.

    The delay tau that was recorded is a_k - s_k, and the latency that the device has beside its loop. After free
    periods it counts from their last sample instead.

    Args:
        run: the recording.
        node: a device.
        instants: s_k, a_k, and when the force before had ended, ticks x 3, ns since tick 0.
        course: what happened between the rows.
        owed: the ticks that are to be checked.
        latency: of the device itself, ns.
    """
    sampled, applied, ended = instants.T
    rows = np.flatnonzero(there(instants))
    expected = instants.copy()
    free = np.zeros(len(instants), dtype=np.bool_)
    free[[k for k, happened in course.before.items() if happened.released or happened.unknown]] = True
    tau = np.rint(1e3 * rows_of(run, node, names.TAU)[:, 0])
    expected[:, 1] = np.where(free | np.isnan(tau), np.maximum(applied, sampled), sampled + tau - latency)
    expected[:, 2] = np.minimum(ended, applied)
    begun = {k for k, happened in course.before.items() if happened.began}
    for last, k in pairwise(rows.tolist()):
        if k not in begun:
            expected[k, 0] = max(sampled[k], applied[last])
    what = "samples and forces are in the order of time, and tau is the time between them"
    return compare("instants", node, what, INSTANT_NAMES, instants, expected, owed=owed)


def limits_kept(run: RecordedRun, node: str, bundle: DeviceBundle, course: Course) -> list[Check]:
    """A device's force is within its limit, and so is its displacement.

    Its speed is checked under the simulated clock alone, where no tick is late. Beyond one of the last two limits the
    device has let go, and exerts no force. In wall time a row after free periods has the displacement before them, and
    the force after them; there the displacement is not judged.
    """
    x, f, ports = rows_of(run, node, names.DISPLACEMENT), rows_of(run, node, names.FORCE), run.recorded.ports[node]
    judged = np.ones(len(x), dtype=np.bool_)
    if bundle.time == WALL:
        judged[[k for k, happened in course.before.items() if happened.released]] = False
    found = [
        ("displacement", np.where(judged[:, None], np.abs(x), np.nan), bundle.limits.displacement, "m"),
        ("force", np.abs(f), bundle.limits.force, "N"),
    ]
    if run.recorded.clock == SIMULATED:
        step = np.abs(np.diff(x, axis=0, prepend=x[:1]))
        found.append(("step", step, tuple(bundle.common.period * v for v in bundle.limits.speed), "m"))
    out = []
    exerted = np.any(f != 0.0, axis=1, keepdims=True)
    for name, values, limits, unit in found:
        most = np.broadcast_to(np.array(limits), values.shape)
        remark = f"greatest {float(np.nanmax(values, initial=0.0)):.6g} {unit} of {max(limits):g}"
        what = f"its {name} is within its limit" + ("" if name == "force" else ", or it exerts no force")
        beyond = (values > most) & exerted
        out.append(within("limits", node, what, ports, values, most, beyond, source=_LIMITS, remark=remark))
    return out


def delay_assumed(
    run: RecordedRun, node: str, tau: Mapping[int, float], enforced: bool = False, late_by_itself: bool = False
) -> Check:
    """The certificate assumes that a force acts at most tau after its sample, and before the next sample is taken.

    A force may act after the next sample only where a device is late by itself. The instants of its samples show it.

    Args:
        run: the recording.
        node: a device.
        tau: the delay that is covered, s, by the tick from which it holds.
        enforced: whether the device's interface bounds what a longer delay may cost.
        late_by_itself: whether it is in wall time, with a latency of its own.
    """
    trace = rows_of(run, node, names.TAU)
    covered = np.zeros_like(trace)
    for begin, most in sorted(tau.items()):
        covered[begin:] = most * 1e6
    if late_by_itself:
        sampled = rows_of(run, node, names.INSTANTS)[:, 0]
        following = np.append(sampled[1:] - sampled[:-1], np.nan) / 1e3
        covered[:, 0] = np.fmin(covered[:, 0], following)
    late = trace > covered
    ticks, numbers = int(late.sum()), int(np.isfinite(trace).sum())
    remark = f"longest {float(np.nanmax(trace, initial=0.0)):.6g} us of {max(tau.values()) * 1e6:g}"
    if ticks:
        remark = f"later in {ticks} of {counted(numbers, 'tick')}; {remark}"
    what = "the force acts no later after its sample than the certificate assumes"
    missed = CheckVerdict.ENFORCED if enforced else CheckVerdict.ASSUMPTION
    return within("tau", node, what, ("τ",), trace, covered, late, otherwise=missed, remark=remark)


def period_assumed(run: RecordedRun, node: str, period_tolerance: float, enforced: bool = False) -> Check:
    """The certificate assumes that samples come every T, or earlier; the device itself has counted the later ones.

    Args:
        run: the recording.
        node: a device.
        period_tolerance: rho of the certificate, which covers periods up to (1 + rho) T.
        enforced: whether the device's interface bounds what a longer period may cost.
    """
    figures = run.figures.get(node, ())
    counts = [one[names.PERIOD_BREACHES] for _, one in figures if names.PERIOD_BREACHES in one]
    most = f"{1.0 + period_tolerance:g} T"
    what = f"samples are at most {most} apart, or more after an early force, as the device counted"
    if not counts:
        return Check("period", node, what, CheckVerdict.UNCHECKED)
    breaches = max(counts)
    remark = f"not in {counted(breaches, 'tick')}" if breaches else ""
    missed = CheckVerdict.ENFORCED if enforced else CheckVerdict.ASSUMPTION
    verdict = missed if breaches else CheckVerdict.HOLDS
    return Check("period", node, what, verdict, len(counts), differing=int(breaches), remark=remark)
