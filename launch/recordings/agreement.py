"""What several parties told of the same thing, and what each told against its bounds: no state is needed for these.

The force that a coupling handed on is the force that its devices exerted; a tool is where its coupling's end is; the
total in a node's figures is the last of its trace; a ledger never falls below where it began; nobody exceeds limits.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.findings import EXACT, Check, Gap, Verdict, compare, first_of
from manyhands.launch.recordings.rows import rows_of
from manyhands.launch.recordings.run import Run
from manyhands.launch.recordings.world import ROUNDING, Blocks
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import SIMULATED, DeviceBundle
from manyhands.nodes.device.account import PERIOD_TOLERANCE
from manyhands.nodes.environment.clutch import LET_GO

Array = NDArray[np.float64]

_EPSILON = float(np.finfo(np.float64).eps)

LEDGER_ROUNDING = 1e-12
"""Of all the work in a ledger's increments: by so much its total may be below its bound, which is rounding."""

_LIMITS = "no tolerance: it is what the node itself compares with"


def forces_agree(run: Run, blocks: Blocks, forces: Array) -> list[Check]:
    """For each coupling: what it handed on is what its devices exerted."""
    what = "the force that it handed on is the one that its devices exerted"
    ports = run.recorded.ports
    return [
        compare("agreement", name, what, ports[name], blocks.f[:, own], forces[:, own])
        for name, own in blocks.ports.items()
    ]


def tools_agree(blocks: Blocks, columns: tuple[str, ...], party: str, tools: Array, sign: tuple[int, str]) -> Check:
    """x_e = p + D_V f_v, as long as no clutch has moved."""
    ends, size = blocks.ends()
    begin, why = sign
    ends[begin:] = np.nan
    ends[blocks.clipped] = np.nan
    gaps = [Gap(begin, len(tools), f"{why}, and a clutch may have moved")] if begin < len(tools) else []
    tolerance = ROUNDING * _EPSILON * np.where(np.isnan(size), 0.0, size)
    source = f"{ROUNDING:g} units in the last place of |p| + |D_V| |f_v|, for the sums are in another order"
    what = "tools are at p + D_V f_v of what the couplings told"
    return compare("agreement", party, what, columns, tools, ends, gaps=gaps, tolerance=tolerance, source=source)


def figures_agree(run: Run, node: str) -> Check:
    """The ledger's total in the figures is the last of the trace before them.

    Those told before a gap, or at a run's end in real time, may be those of free periods that are in no row.
    """
    trace = rows_of(run, node, names.LEDGER)
    told = np.full_like(trace, np.nan)
    last = len(told) if run.recorded.clock == SIMULATED else len(told) - 1
    for tick, figures in run.figures.get(node, ()):
        if 0 < tick <= last and (tick == len(told) or np.isfinite(trace[tick, 0])):
            told[tick - 1] = figures.get(names.LEDGER, np.nan)
    return compare("figures", node, "the ledger's total in its figures is that of its trace", ("E",), trace, told)


def bounded(run: Run, node: str) -> Check:
    """A ledger of ``node`` is never below 0; what a hand intended, a person's at a browser too, is in it.

    Returns:
        The finding; nothing was checked where no ledger was kept.
    """
    trace = rows_of(run, node, names.LEDGER)
    total = trace[np.isfinite(trace)]
    work = float(np.abs(np.diff(total, prepend=0.0)).sum())
    tolerance = LEDGER_ROUNDING * work
    what = "its ledger never fell below 0: it kept its promise"
    source = f"{LEDGER_ROUNDING:g} of the sum of its increments' magnitudes: rounding"
    wrong = trace < -tolerance
    first = first_of(wrong, ("E",), trace, np.zeros_like(trace))
    verdict = Verdict.BROKEN if first is not None else Verdict.HOLDS if len(total) else Verdict.UNCHECKED
    told = f"least {min(0.0, float(total.min())):.6g} J" if len(total) else ""
    return Check(
        "bound", node, what, verdict, len(total), first, int(wrong.sum()), tolerance=tolerance, source=source, told=told
    )


def limits_kept(run: Run, node: str, bundle: DeviceBundle) -> list[Check]:
    """A device's force within its limit; displacement, and speed where ticks are no later than they should, likewise.

    Beyond one of the last two it has let go, and exerts no force.
    """
    x, f, ports = rows_of(run, node, names.DISPLACEMENT), rows_of(run, node, names.FORCE), run.recorded.ports[node]
    found = [
        ("displacement", np.abs(x), bundle.limits.displacement, "m"),
        ("force", np.abs(f), bundle.limits.force, "N"),
    ]
    if run.recorded.clock == SIMULATED:
        step = np.abs(np.diff(x, axis=0, prepend=x[:1]))
        found.append(("step", step, tuple(run.recorded.period * v for v in bundle.limits.speed), "m"))
    out = []
    exerted = np.any(f != 0.0, axis=1, keepdims=True)
    for name, values, limits, unit in found:
        most = np.broadcast_to(np.array(limits), values.shape)
        beyond = (values > most) & exerted
        first = first_of(beyond, ports, values, most)
        numbers = int(np.isfinite(values).sum())
        verdict = Verdict.BROKEN if first is not None else Verdict.HOLDS if numbers else Verdict.UNCHECKED
        told = f"greatest {float(np.nanmax(values)):.6g} {unit} of {max(limits):g}" if numbers else ""
        what = f"its {name} is within its limit" + ("" if name == "force" else ", or it exerts no force")
        out.append(Check("limits", node, what, verdict, numbers, first, int(beyond.sum()), (), 0.0, _LIMITS, told))
    return out


def delay_assumed(run: Run, node: str, tau: Mapping[int, float]) -> Check:
    """The certificate takes for granted that a force acts at most tau after its sample.

    Args:
        run: the recording.
        node: a device.
        tau: the delay that is covered, s, from which tick on.
    """
    trace = rows_of(run, node, names.TAU)
    covered = np.zeros_like(trace)
    for begin, most in sorted(tau.items()):
        covered[begin:] = most * 1e6
    late = trace > covered
    ticks, numbers = int(late.sum()), int(np.isfinite(trace).sum())
    told = f"longest {float(np.nanmax(trace)):.6g} us of {max(tau.values()) * 1e6:g}" if numbers else ""
    if ticks:
        told = f"later in {ticks} of {numbers} ticks; {told}"
    first = first_of(late, ("τ",), trace, covered)
    verdict = Verdict.ASSUMPTION if ticks else Verdict.HOLDS if numbers else Verdict.UNCHECKED
    what = "the force acts no later after its sample than the certificate assumes"
    return Check("tau", node, what, verdict, numbers, first, ticks, source=EXACT, told=told)


def period_assumed(run: Run, node: str) -> Check:
    """The certificate takes for granted that samples come every T; the device itself has counted where they did not."""
    figures = run.figures.get(node, ())
    counts = [told[names.PERIOD_BREACHES] for _, told in figures if names.PERIOD_BREACHES in told]
    what = f"samples come every T, give or take {PERIOD_TOLERANCE:g} T, as the device counted"
    if not counts:
        return Check("period", node, what, Verdict.UNCHECKED)
    most = max(counts)
    told = f"{most:.0f} ticks did not" if most else ""
    return Check("period", node, what, Verdict.ASSUMPTION if most else Verdict.HOLDS, len(counts), told=told)


def let_go_source(offsets: int) -> str:
    """Where the tolerance of the environment's increments comes from."""
    text = f"{ROUNDING:g} units in the last place of the tick's products, for the sums are in another order"
    if offsets:
        text += f"; and in {offsets} ticks LET_GO = {LET_GO:g} m times the force, by which a clutch may close"
    return text
