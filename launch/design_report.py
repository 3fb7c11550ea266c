"""Certificates and reports as a person reads them, and as other programs do (``--json``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from manyhands.design.certificate import Certificate
from manyhands.design.coupling import SpringDamper
from manyhands.design.differences import asked_text
from manyhands.design.problem import HapticLoop
from manyhands.design.statespace import Matrix
from manyhands.launch.columns import energy_line
from manyhands.launch.display import printable
from manyhands.nodes import telemetry as names

if TYPE_CHECKING:
    from manyhands.design.proof import Finding  # exact arithmetic is loaded where something is proved

CERTIFIED, INFEASIBLE = "certified", "infeasible"
CONDITION_10 = "(10)"
_MOST_FINDINGS = 60  # lines of a proof that are shown; every block has some
_LARGEST_SHOWN = 8  # ports, above which a matrix is told by its diagonal's range


def certificate_object(certificate: Certificate, proved: bool = True) -> dict[str, Any]:
    """The object that ``--json`` prints for a certificate."""
    loop, levels = certificate.loop, certificate.levels
    coupling: dict[str, Any]
    springs = certificate.spring_damper
    if springs is not None:
        coupling = {"stiffness": springs.stiffness.tolist(), "damping": springs.damping.tolist()}
    else:
        V = loop.partition.join(certificate.blocks)
        coupling = {name: getattr(V, name).tolist() for name in "ABCD"}
    return {
        "status": CERTIFIED if proved else INFEASIBLE,
        "id": certificate.id,
        "version": certificate.version,
        "asked": certificate.asked,
        "margin": certificate.margins.get(CONDITION_10),
        "gamma": None if certificate.transparency is None else certificate.transparency.gamma,
        "coupling": coupling,
        "levels": {
            "Delta_D": loop.partition.embed(levels.Delta_D).tolist(),
            "Delta_V": loop.partition.embed(levels.Delta_V).tolist(),
            "Phi_E": levels.Phi_E.tolist(),
            "share": levels.device.share,
            "kappa": levels.device.kappa,
        },
        "margins": dict(certificate.margins),
        "period": loop.period,
        "tau": certificate.tau,
        "structure": _structure(loop),
        "enforced": list(loop.enforced),
    }


def infeasible_object(loop: HapticLoop, reason: str, relax: tuple[str, ...]) -> dict[str, Any]:
    """The object that ``--json`` prints when nothing could be certified."""
    return {
        "status": INFEASIBLE,
        "id": None,
        "version": None,
        "asked": None,
        "margin": None,
        "gamma": None,
        "coupling": None,
        "levels": {"Delta_D": loop.Delta_D.tolist(), "Delta_V": None, "Phi_E": None},
        "margins": {},
        "period": loop.period,
        "tau": None,
        "structure": _structure(loop),
        "enforced": list(loop.enforced),
        "reason": reason,
        "relax": list(relax),
    }


def print_certificate(console: Console, certificate: Certificate) -> None:
    """Its id, structure, coupling and margins."""
    loop = certificate.loop
    console.print(f"certificate {certificate.id}")  # never cut to the width of a table
    table = Table(title=f"{loop.session}: certified", title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    if certificate.asked is not None:
        table.add_row("asked for", _escaped(asked_text(certificate.asked)))
    table.add_row("found by", ", ".join(f"{key} {value}" for key, value in certificate.method.items()))
    table.add_row("blocks of V", "; ".join(f"{name}: {', '.join(ports)}" for name, ports in _blocks(loop)))
    table.add_row("assumes", f"T = {loop.period:g} s, tau = {certificate.tau:g} s")
    levels = certificate.levels
    if loop.tau:
        table.add_row("left of Δ_D", f"{levels.device.share:.4f}, with K = {levels.device.kappa:.4f} T/Δ_D")
    if certificate.spring_damper is not None:
        _coupling_rows(table, certificate.spring_damper)
    else:
        orders = ", ".join(
            f"{name} {b.order}" for name, b in zip(loop.partition.names, certificate.blocks, strict=True)
        )
        table.add_row("states of V", orders)
    claim = certificate.transparency
    if claim is not None:
        norm = "‖W1 E V W2‖" if claim.aim.objective == "loop-shaping" else "‖W1 (F(E,V) − E) W2‖"
        table.add_row(norm, f"< {claim.gamma:.4f}" + ("" if claim.aim.objective == "loop-shaping" else " N/m"))
    if loop.enforced:
        table.add_row("environment", "enforced: not proved, its declared level is kept at run time by a controller")
    else:
        energy = isinstance(levels.P_E, str)
        by = "its mechanical energy" if energy else f"a storage matrix of order {len(levels.P_E)}"
        table.add_row("environment proved by", by)
    table.add_row("margin of (10)", f"{certificate.margins[CONDITION_10]:.4f} N·s/m")
    for key, margin in certificate.margins.items():
        if key != CONDITION_10:
            table.add_row(f"  {key}", f"{margin:.3e}")
    console.print(table)


def print_findings(console: Console, findings: tuple[Finding, ...]) -> None:
    """Every condition and how it came out."""
    table = Table(show_header=True)
    table.add_column("condition")
    table.add_column("found", justify="right")
    table.add_column("")
    table.add_column("by")
    for finding in _shortened(findings):
        mark = "[green]proved[/green]" if finding.holds else "[bold red]not proved[/bold red]"
        if finding.enforced:
            mark = "[yellow]enforced[/yellow]"
        table.add_row(_escaped(finding.condition), f"{finding.value:.4g}", mark, _escaped(finding.argument))
    console.print(table)


def print_report(console: Console, report: Mapping[str, Any]) -> None:
    """Ticks, lateness, percentiles, ledgers and speeds of every node."""
    title = f"{report['session']}: {report['duration']:g} s, {report['clock']} clock"
    table = Table(title=title, title_justify="left")
    for column in ("node", "ticks", "late", "τ p50/p99/p99.9/max [µs]", "period p50/p99/p99.9/max [µs]",
                   "ledger min [J]", "peak → final [m/s]"):  # fmt: skip
        table.add_column(column, justify="left" if column == "node" else "right")
    for name, node in report["nodes"].items():
        speeds = f"{node['peak_speed']:.3g} → {node['final_speed']:.1e}" if "peak_speed" in node else ""
        ledger = f"{node['ledger']['min']:.1e}" if "ledger" in node else ""
        percentiles = ["/".join(f"{v:.0f}" for v in node.get(q, {}).values()) for q in ("tau_us", "period_us")]
        table.add_row(name, str(node["ticks"]), str(node.get("late", "")), *percentiles, ledger, speeds)
    console.print(table)
    for node in report["nodes"].values():
        if "energy" in node:
            entry = node["energy"]
            figures = {f"{names.MOVED}{pair}": joules for pair, joules in entry.get("moved", {}).items()}
            figures |= {f"{names.SCALED}{party}": ticks for party, ticks in entry.get("scaled", {}).items()}
            console.print(energy_line(figures), markup=False, soft_wrap=True)
    for name, node in report["nodes"].items():
        counts = {**node.get("refused", {}), **node.get("dropped", {})}
        counts |= {kind: node[kind] for kind in ("clipped", "saturated") if node.get(kind)}
        if counts:
            told = ", ".join(f"{kind} {count}" for kind, count in counts.items())
            console.print(f"{name}: not admitted, or not as it came: {told}", markup=False, soft_wrap=True)


def _coupling_rows(table: Table, coupling: SpringDamper) -> None:
    table.add_row("K [N/m]", _matrix_text(coupling.stiffness, ".4f"))
    table.add_row("B [N·s/m]", _matrix_text(coupling.damping, ".4f"))


def _matrix_text(M: Matrix, form: str) -> str:
    if M.shape[0] > _LARGEST_SHOWN:
        diagonal = np.diag(M)
        return f"{M.shape[0]} x {M.shape[0]}, diagonal {diagonal.min():{form}} ... {diagonal.max():{form}}"
    return "\n".join("  ".join(f"{value:{form}}".rjust(10) for value in row) for row in M)


def _blocks(loop: HapticLoop) -> list[tuple[str, list[str]]]:
    return [
        (name, [loop.ports[p] for p in block])
        for name, block in zip(loop.partition.names, loop.partition.blocks, strict=True)
    ]


def _structure(loop: HapticLoop) -> list[list[str]]:
    return [ports for _, ports in _blocks(loop)]


def _shortened(findings: tuple[Finding, ...]) -> list[Finding]:
    """All that fail, and the first few that hold."""
    failing = [finding for finding in findings if not finding.holds]
    return failing + [finding for finding in findings if finding.holds][:_MOST_FINDINGS]


def _escaped(text: str) -> str:
    return printable(text).replace("[", "\\[")
