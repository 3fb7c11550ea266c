"""The commands `manyhands design`, `verify` and `budget`: from a loaded session or file to output and files.

Certificates and reports are printed as tables for people, or as objects for other programs (``--json``).
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from manyhands.design.certificate import Certificate, asked_text, load
from manyhands.design.errors import CertificateError
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.levels.orientation import OrientationLevel
from manyhands.design.models.axis import Units
from manyhands.design.models.brief import brief_names
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import Matrix
from manyhands.design.problem import MECHANISM, DeviceLevel, HapticLoop
from manyhands.design.quantisation import not_covered, steps
from manyhands.design.wave_link import FELT_STIFFNESS
from manyhands.launch.app.own_device import OwnDevice, session_of
from manyhands.launch.files import EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED, EXIT_OK
from manyhands.launch.look.display import figure_table, printable, promise_lines, say, status, world_lines
from manyhands.launch.output import print_json
from manyhands.launch.run.outcome import (
    given_sentences,
    last_line,
    lateness_sentence,
    rows_of,
    units_in,
    wave_link_sentences,
)
from manyhands.launch.session import Session
from manyhands.nodes.monitor.given import shares_cell
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures

if TYPE_CHECKING:
    from manyhands.design.proof import Finding


CERTIFIED, INFEASIBLE = "certified", "infeasible"
CONDITION_10 = "(10)"
_MOST_FINDINGS = 60  # lines of a proof that are shown; every block has several
_LARGEST_SHOWN = 8  # ports; of a larger matrix only the range of the diagonal is shown


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
        "series": series_rows(certificate) or None,
        "encoder": None if certificate.encoder is None else certificate.encoder.describe(),
        "mechanism": mechanism(loop),
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
        "speed": loop.speed,
        "period_tolerance": certificate.period_tolerance,
        "structure": _structure(loop),
        "enforced": list(loop.enforced),
    }


def infeasible_object(loop: HapticLoop, reason: str) -> dict[str, Any]:
    """The object that ``--json`` prints when nothing could be certified."""
    left = loop.Delta_D_at(loop.period, loop.tau)
    return {
        "status": INFEASIBLE,
        "id": None,
        "version": None,
        "asked": None,
        "margin": None,
        "gamma": None,
        "coupling": None,
        "series": None,
        "encoder": None,
        "mechanism": mechanism(loop),
        "levels": {"Delta_D": None if left is None else left.tolist(), "Delta_V": None, "Phi_E": None},
        "margins": {},
        "period": loop.period,
        "tau": None,
        "speed": loop.speed,
        "period_tolerance": None,
        "structure": _structure(loop),
        "enforced": list(loop.enforced),
        "reason": reason,
    }


def held_text(loop: HapticLoop, device: DeviceLevel, held: HeldTorque) -> str:
    """What the held torques of a device take of its level, in words."""
    d, u = held.damping(loop.period, loop.tau, loop.period_tolerance), device.units
    least = float(np.linalg.eigvalsh(device.level)[0])
    proved = "believed" if held.linkage is None else "proved of its kinematics"
    if held.length is not None:
        proved = f"of all six directions {proved}, where a turn counts by {held.length:.4g} m/rad"
    return (
        f"{device.name}: {d:.4g} of {least:.4g} {u('N·s/m')}, up to {held.force:.4g} {u('N')} and "
        f"{held.speed:.4g} {u('m/s')}, curvature {held.kappa:.4g}/m {proved}"
    )


def orientation_text(loop: HapticLoop, name: str, of: OrientationLevel) -> str:
    """What is proved of an orientation, in words."""
    if of.osp is None:
        return (
            f"{name}: sensed; its tool follows it at k = {of.stiffness:.4g} N·m/rad, no torque acts on the hand, and "
            "nothing is needed"
        )
    times = loop.period, loop.tau, loop.period_tolerance
    needed, taken = float(of.needed(*times)), of.taken(*times)
    leave = f", of which torques of its joints take {taken:.4g}" if taken else ""
    return (
        f"{name}: k = {of.stiffness:.4g} N·m/rad at the hand, on all of SO(3); its torque needs {needed:.4g} of "
        f"{of.osp:.4g} N·m·s/rad{leave}"
    )


def print_certificate(console: Console, certificate: Certificate) -> None:
    """Print a certificate's id, structure, coupling and margins."""
    loop, units = certificate.loop, certificate.loop.units()
    if loop.speed is not None:
        console.print(f"{loop.session}: holds{below_speed(loop)}")
    console.print(f"certificate {certificate.id}")  # outside the table, which could cut it
    table = Table(title=f"{loop.session}: certified", title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row("asked for", _escaped(asked_text(certificate.asked)))
    table.add_row("found by", ", ".join(f"{key} {value}" for key, value in certificate.method.items()))
    table.add_row("blocks of V", "; ".join(f"{name}: {', '.join(ports)}" for name, ports in _blocks(loop)))
    tolerance = f", periods up to {1.0 + loop.period_tolerance:g} T" if loop.period_tolerance else ""
    table.add_row("assumes", f"T = {loop.period:g} s, tau = {certificate.tau:g} s{tolerance}")
    levels = certificate.levels
    for device in loop.devices:
        if device.held is not None:
            table.add_row("held torques", held_text(loop, device, device.held))
        if device.orientation is not None:
            table.add_row("orientation", orientation_text(loop, device.name, device.orientation))
    if not loop.punctual:
        table.add_row("left of Δ_D", f"{levels.device.share:.4f}, with the gain κ = {levels.device.kappa:.4f}")
    if certificate.spring_damper is not None:
        _coupling_rows(table, certificate.spring_damper, units, of_run=bool(loop.series))
    else:
        orders = ", ".join(
            f"{name} {b.order}" for name, b in zip(loop.partition.names, certificate.blocks, strict=True)
        )
        table.add_row("states of V" + (", run" if loop.series else ""), orders)
    _series_rows(table, certificate)
    if certificate.encoder is not None:
        table.add_row("encoder steps", "\n".join(encoder_lines(certificate)))
    claim = certificate.transparency
    if claim is not None:
        norm = "‖W1 E V W2‖" if claim.aim.objective == "loop-shaping" else "‖W1 (F(E,V) − E) W2‖"
        table.add_row(
            norm, f"< {claim.gamma:.4f}" + ("" if claim.aim.objective == "loop-shaping" else f" {units('N/m')}")
        )
    kept = loop.environment.rows(certificate.margins, units)
    for what, value in kept.items():
        table.add_row(what, value if isinstance(value, str) else _matrix_text(value, "z.4f"))
    if not kept:
        energy = isinstance(levels.P_E, str)
        by = "its mechanical energy" if energy else f"a storage matrix of order {len(levels.P_E)}"
        table.add_row("environment proved by", by)
    table.add_row("margin of (10)", f"{certificate.margins[CONDITION_10]:.4f} {units('N·s/m')}")
    for key, margin in certificate.margins.items():
        if key not in (CONDITION_10, FELT_STIFFNESS):
            table.add_row(f"  {key}", f"{margin:.3e}")
    console.print(table)


def print_findings(console: Console, findings: tuple[Finding, ...]) -> None:
    """Print every condition and its result."""
    table = Table(show_header=True)
    table.add_column("condition")
    table.add_column("found", justify="right")
    table.add_column("")
    table.add_column("by")
    for finding in _shortened(findings):
        mark = "[green]proved[/green]" if finding.holds else "[bold red]not proved[/bold red]"
        if finding.enforced or finding.assumed:
            mark = "[yellow]enforced[/yellow]" if finding.enforced else "[yellow]assumed[/yellow]"
        table.add_row(_escaped(finding.condition), f"{finding.value:.4g}", mark, _escaped(finding.argument))
    console.print(table)


_PERIOD: Final = "period [µs]\np50/p99/p99.9/max"
_LEDGER: Final = "ledger\nmin [J]"
_GIVEN: Final = "given [%]\nforce/time"
_REPORTED: Final = (
    *("node", "ticks", "late", "τ [µs]\np50/p99/p99.9/max", _PERIOD, _GIVEN, _LEDGER),
    "account\nmin/left [J]",
)
_REPORT_RANKS: Final = {_PERIOD: 3, _GIVEN: 2, _LEDGER: 1}


def print_report(console: Console, report: Mapping[str, Any], faults: Sequence[str] = ()) -> None:
    """Print ticks, lateness, percentiles, ledgers and speeds of every node, and what was refused or clipped.

    The last line says what was worst, or that all promises were kept.

    Args:
        console: where it goes.
        report: the whole report of a run.
        faults: what made the run fail, which is worse than any promise. Of a run that had no tick nothing else is
            said: no promise was tried.
    """
    if faults and not report["duration"]:
        say(console, f"{report['session']}: failed before its first tick: {faults[0].splitlines()[0]}")
        return
    title = f"{report['session']}: {report['duration']:g} s, {report['clock']} clock"
    rows = []
    for name, node in report["nodes"].items():
        speeds = f"{node['peak_speed']:.3g}" if "peak_speed" in node else ""
        if "final_speed" in node:  # a process that has sent no report has none
            speeds += f" → {node['final_speed']:.1e}"
        ledger = f"{node['ledger']['min']:.1e}" if "ledger" in node else ""
        percentiles = ["/".join(f"{v:.0f}" for v in node.get(q, {}).values()) for q in ("tau_us", "period_us")]
        late = str(node.get("late", ""))
        shares = node.get("given", {})
        given = shares_cell(shares.get("force"), shares.get("time"))
        rows.append([name, str(node["ticks"]), late, *percentiles, given, ledger, _account(node), speeds])
    rows += [[name, "no report", *[""] * (len(_REPORTED) - 1)] for name in report.get("unreported", ())]
    titles = (*_REPORTED, f"speed [{units_in(report)('m/s')}]\npeak → final")
    table, left_out = figure_table(title, titles, rows, _REPORT_RANKS, console.width)
    console.print(table)
    if left_out:
        short = ", ".join(column.split("\n")[0] for column in left_out)
        say(console, f"no room for {short}: a wider terminal shows it, and --report has it")
    promises = rows_of(report)
    for line, _ in promise_lines(promises, {row.remark for row in promises}):  # what they say is among the notices
        say(console, line)
    for felt in wave_link_sentences(report):
        say(console, felt)
    if sentence := lateness_sentence(report):
        say(console, sentence)
    last = last_line(report, faults)
    for lack in given_sentences(report):
        if lack not in last:
            say(console, lack)
    for node in report["nodes"].values():
        entry = node.get("energy", {})
        tables = {
            names.MOVED: entry.get("moved", {}),
            names.SCALED: entry.get("scaled", {}),
            names.HELD: node.get("held", {}),
            names.CHATTER: node.get("chatter", {}),
        }
        for line in world_lines(Figures({}, tables)):
            say(console, line)
    for name, node in report["nodes"].items():
        counts = {**node.get("refused", {}), **node.get("dropped", {})}
        counts |= {kind: node[kind] for kind in ("clipped", "saturated") if node.get(kind)}
        if counts:
            listed = ", ".join(f"{kind} {count}" for kind, count in counts.items())
            say(console, f"{name}: refused or clipped: {listed}")
    if last:
        say(console, last)


def _account(node: Mapping[str, Any]) -> str:
    """The least account of a node's interface, and what was left above its bound, which falls by the tank's power."""
    return f"{node['interface']['min']:.1e}/{node['interface']['margin']:.1e}" if "interface" in node else ""


def _coupling_rows(table: Table, coupling: SpringDamper, units: Units, of_run: bool) -> None:
    run = ", run" if of_run else ""
    table.add_row(f"K{run} [{units('N/m')}]", _matrix_text(coupling.stiffness, "z.4f"))
    table.add_row(f"B{run} [{units('N·s/m')}]", _matrix_text(coupling.damping, "z.4f"))


def series_rows(certificate: Certificate) -> dict[str, dict[str, float]]:
    """Of each port where compliance of the world is counted in series: whose stiffness the hand feels at rest, N/m.

    ``part`` of the compliance of a network's spring is counted; ``coupling`` is the coupling itself, ``contact`` the
    world's spring, and ``together`` both in series, all other ports free of force. Of a world without springs of its
    own it is ``compliance`` (m/N) that is counted, and ``coupling`` is the coupling itself.
    """
    loop = certificate.loop
    environment = loop.environment.nominal
    if not loop.series:
        return {}
    compliance = np.diag(np.linalg.inv(certificate.stiffness))
    if environment.counts != "part":
        found = zip(loop.ports, loop.series, compliance, strict=True)
        return {port: {"compliance": c, "coupling": float(1.0 / own)} for port, c, own in found if c}
    contacts, out = environment.contacts(), {}
    for port, part, own in zip(loop.ports, loop.series, compliance, strict=True):
        if part:
            k = contacts[port].stiffness
            together = float(1.0 / (own + 1.0 / k))
            out[port] = {"part": part, "coupling": float(1.0 / own), "contact": k, "together": together}
    return out


def _series_rows(table: Table, certificate: Certificate) -> None:
    """What is counted in series, and whose stiffness the hand feels at rest."""
    rows, at = series_rows(certificate), certificate.loop.units
    if not rows:
        return
    few = list(rows.items())[:_LARGEST_SHOWN]
    more = [f"and {len(rows) - len(few)} more"] if len(rows) > len(few) else []
    if any("compliance" in row for row in rows.values()):
        springs = [f"{port} {1e3 * row['compliance']:g} {at(port)('mm/N')} of the world" for port, row in few]
        table.add_row("counted in series", "\n".join([*springs, *more]))
        table.add_row(
            "coupling at rest", "\n".join([*(f"{p} {row['coupling']:.0f} {at(p)('N/m')}" for p, row in few), *more])
        )
        return
    counted = [f"{port} {row['part']:g} of {row['contact']:.6g} {at(port)('N/m')}" for port, row in few]
    felt = [
        f"{port} {row['coupling']:.0f}, {row['contact']:.0f}, {row['together']:.0f} {at(port)('N/m')}"
        for port, row in few
    ]
    table.add_row("counted in series", "\n".join([*counted, *more]))
    table.add_row("coupling, contact,\nboth, at rest", "\n".join([*felt, *more]))


def below_speed(loop: HapticLoop) -> str:
    """The speed below which a claim about this loop holds, to be added to a verdict; empty for every speed."""
    return "" if loop.speed is None else f" below {loop.speed:g} {loop.units()('m/s')} on every axis, and not beyond"


def encoder_lines(certificate: Certificate) -> list[str]:
    """What the steps of encoders add to the forces, by port, and whether dry friction covers it; empty without steps.

    Beside the force stands what it is in steps of the port's encoder, at the coupling's stiffness.
    """
    loop, claim = certificate.loop, certificate.encoder
    if claim is None:
        return []
    if claim.force is None:
        return [f"not covered: {not_covered(loop) or 'no bound on what they add is proved'}"]
    one_step = steps(loop) * np.diag(certificate.stiffness)
    rows = []
    for port, w, own in zip(loop.ports, claim.force, one_step.tolist(), strict=True):
        if w > 0.0:
            rows.append(
                f"{port} at most {1e3 * w:.3g} m{loop.units(port)('N')}"
                + (f", {w / own:.3g} steps" if own > 0.0 else "")
            )
    more = [f"and {len(rows) - _LARGEST_SHOWN} more"] if len(rows) > _LARGEST_SHOWN else []
    covered = "covered by dry friction" if claim.covered else "not covered: no dry friction of that force is stated"
    return [*rows[:_LARGEST_SHOWN], *more, covered]


def mechanism(loop: HapticLoop) -> dict[str, list[str]]:
    """By what may be stated of a mechanism, the devices of which it is; empty where a claim is about none such."""
    return {key: [own.name for own in loop.devices if getattr(own, key) is not None] for key in MECHANISM}


def about_text(certificate: Certificate) -> str:
    """What mechanisms a certificate is about, in words: how forces are held, how samples are taken, what friction is.

    Of what is not stated of any device it says that the claim is about devices without it.
    """
    loop, claim = certificate.loop, certificate.encoder
    held, step, friction = (brief_names(names) for names in mechanism(loop).values())
    others = "" if all(device.held for device in loop.devices) else ", and as forces by the others"
    covered = claim is not None and claim.covered
    counts = "not counted" if not covered else "for encoder steps alone"
    if loop.speed is not None:
        counts = f"as damping below {loop.speed:g} {loop.units()('m/s')}"
    of_steps = f"samples in encoder steps of {step} ({'covered by dry friction' if covered else 'not covered'})"
    return (
        f"format {certificate.version}, about "
        + (f"forces held as torques by {held}{others}; " if held else "forces held as forces, ")
        + (of_steps if step else "exact samples (no encoder steps)")
        + (f" and dry friction of {friction} ({counts})" if friction else " and no dry friction")
    )


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
    """All findings that fail, and the first :data:`_MOST_FINDINGS` that hold."""
    failing = [finding for finding in findings if not finding.holds]
    return failing + [finding for finding in findings if finding.holds][:_MOST_FINDINGS]


def _escaped(text: str) -> str:
    return printable(text).replace("[", "\\[")


Progress = Callable[[str], None]


def run_verify(file: Path, session: Session | None, out: Console, err: Console, as_json: bool) -> int:
    """Prove a certificate again, and compare it with the session where one is given.

    Returns:
        The exit code.

    Raises:
        CertificateError: the file is not a certificate.
    """
    from manyhands.design.proof import ProofInputError
    from manyhands.launch.plan.proofs import prove_loop

    certificate, data = load(file)
    try:
        with progress_on(err, "proving") as progress:
            proof = prove_loop(certificate, data, session, progress)
    except ProofInputError as error:
        raise CertificateError(f"{file}: {error}") from error
    failing = proof.failing
    if as_json:
        object_ = certificate_object(certificate, proved=not failing)
        print_json(object_ | {"failing": [finding.condition for finding in failing]})
    else:
        if certificate.loop.speed is not None:
            say(out, f"{certificate.loop.session}: claimed{below_speed(certificate.loop)}")
        print_findings(out, proof.findings)
        print_about(out, file, certificate)
    say_failing(err, [(str(file), finding) for finding in failing])
    if failing:
        return EXIT_NOT_CERTIFIED
    if not as_json:
        proved = certificate.loop.environment.verdict(certificate.loop.partition.names[0])
        exactly = (
            "" if certificate.encoder is None or certificate.encoder.covered else ", of devices that measure exactly"
        )
        proved += below_speed(certificate.loop)
        say(out, f"{certificate.loop.session}: {proved}{exactly}; certificate {certificate.id}")
    return EXIT_OK


def say_failing(err: Console, failing: Sequence[tuple[str, Finding]]) -> None:
    """Say which conditions are not proved, each with the file that it is of."""
    for name, finding in failing:
        because = f" ({finding.argument})" if finding.argument else ""
        say(err, f"{name}: not proved: {finding.condition}: found {finding.value:.6g}{because}")


def print_about(out: Console, file: Path, certificate: Certificate) -> None:
    """Print what mechanisms the certificate is about, and what it records of the request, which is not proved."""
    say(out, f"{file}: {about_text(certificate)}")
    say(out, f"{file}: requested (not part of the proof): {asked_text(certificate.asked)}")


def run_budget(session: Session, out: Console, err: Console, picture: Path | None, as_json: bool) -> int:
    """Show the stiffness that can be certified for the session's devices, over delay and period, and over wave links.

    Returns:
        The exit code.
    """
    from manyhands.launch.app.budget import (
        budget_object,
        friction_object,
        plot_budget,
        print_budget,
        print_friction,
        print_series,
        print_steps,
        print_wave_links,
        series_budget,
        session_budget,
        wave_links_object,
    )
    from manyhands.launch.doctor.advice import Worth
    from manyhands.launch.doctor.profile import Stated
    from manyhands.launch.doctor.rates import form_figures, kept_forms, print_rates, rates_object

    found = session_budget(session)
    loop, links = found.loop, found.wave_links
    worth = Worth(loop, found.share_at(loop.period), Stated.of(session))
    rates = list(form_figures(worth, kept_forms(session, time.time())))
    if as_json:
        own = {"wave_links": wave_links_object(links)} if links else {}
        print_json(budget_object(found) | friction_object(found) | {"rates": rates_object(rates)} | own)
    else:
        linked = len(session.wave_links) == len(session.couplings)  # then the sites have delays of their own
        print_budget(out, found, "" if linked else " (session)")
        print_friction(out, found)
        print_series(out, series_budget(found), loop)
        print_steps(out, found)
        print_wave_links(out, links)
        print_rates(out, session.name, session.units(), rates)
    if picture is not None:
        plot_budget(found, picture)
        say(err, f"picture: {picture}")
    return EXIT_OK


def run_own_budget(own: OwnDevice, out: Console, err: Console, picture: Path | None, as_json: bool) -> int:
    """Show the stiffness that can be certified for a device of which no session is written yet.

    Returns:
        The exit code.

    Raises:
        SessionError: a number is out of its range.
    """
    from manyhands.launch.app.budget import (
        budget_object,
        own_device_object,
        plot_budget,
        print_budget,
        print_own_device,
        print_steps,
        session_budget,
    )

    found = session_budget(session_of(own))
    if as_json:
        print_json(budget_object(found) | own_device_object(own, found))
    else:
        print_own_device(out, own, found)
        print_budget(out, found, "" if own.delay is None else " (stated)", of_session=False)
        print_steps(out, found)
    if picture is not None:
        plot_budget(found, picture)
        say(err, f"picture: {picture}")
    return EXIT_OK


@contextmanager
def progress_on(err: Console, what: str) -> Iterator[Progress]:
    """Show a status line on a terminal; yields a function that takes the present step as a text."""
    with status(err, what) as update:
        yield lambda text: update(f"{what}: {text}")


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """While entered, the first Ctrl-C raises KeyboardInterrupt; a search may catch it and return its best result.

    Yields:
        The signals that came, so that a request is known even where other code has caught the exception.

    Raises:
        KeyboardInterrupt: a signal came and no search caught it, or other code turned the exception into its own.
    """
    asked: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        if len(asked) > 1:
            raise SystemExit(EXIT_INTERRUPTED)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, note)
    try:
        yield asked
    except Exception:
        if asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, before)
