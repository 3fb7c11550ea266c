"""What a person sees of a replay and of an audit."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from manyhands.launch.audit.audit import Audit, AuditVerdict
from manyhands.launch.audit.findings import Check, CheckVerdict, UncheckedTicks, verdicts
from manyhands.launch.audit.replay import Replayed
from manyhands.launch.look.display import promise_lines, say, titled_table
from manyhands.launch.recordings.integrity import Damage
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.health import PROMISES, PromiseState, grouped, missed, parties
from manyhands.nodes.rows.promises import Promise


def print_damage(out: Console, name: str, damage: Sequence[Damage]) -> None:
    """Print where a file differs from what was written, a line for each damage."""
    for found in damage:
        say(out, f"{name}: damaged: bytes {found.begin} to {found.end - 1}: {found.what}")


def print_replayed(out: Console, name: str, found: Replayed) -> None:
    """Print whether a replayed session is identical, and where it is not."""
    for device in found.given:
        say(
            out,
            f"{device}: a person, or a driver of another package, moved it, so its motion is taken from the recording "
            "and its ledger is not compared",
        )
    for deviation in found.deviations:
        first = deviation.first
        say(
            out,
            f"{deviation.node}/{deviation.topic} differs first at tick {first.tick}, {first.column}: recorded "
            f"{first.recorded!r} {deviation.unit}, recomputed {first.recomputed!r} {deviation.unit}",
        )
    for topic, ticks in found.missing.items():
        say(out, f"{topic}: missing from the recording: {counted(ticks, 'tick')}")
    if found.ended:
        say(out, f"the replay ends before the recording does: {found.ended}")
    if found.identical:
        say(out, f"{name}: identical: {found.numbers} numbers of {counted(found.ticks, 'tick')}, bit for bit")
        return
    for incident in found.incidents:
        say(out, f"incident in the recording, which a replay does not repeat: {incident}")
    over = counted(found.ticks, "tick")
    say(out, f"{name}: not identical: {found.differing} of {found.numbers} numbers of {over} differ")


def print_audit(out: Console, name: str, audit: Audit) -> None:
    """Print a line for each party, then broken checks, broken assumptions, and the ticks that were not checked."""
    certificate, *checks = audit.checks
    title = f"{audit.session} ({audit.clock}), {counted(audit.ticks, 'tick')}"
    table = titled_table(title, ("party", "recomputed and compared"), ("numbers", "least ledger [J]", "differ"))
    for party in dict.fromkeys(check.party for check in checks):
        own = [check for check in checks if check.party == party]
        done = dict.fromkeys(check.name for check in own if check.verdict is not CheckVerdict.UNCHECKED)
        least = next((check.remark for check in own if check.name == "bound"), "")
        table.add_row(
            party,
            ", ".join(done),
            str(sum(check.numbers for check in own)),
            least.removeprefix("least ").removesuffix(" J"),
            str(sum(check.differing for check in own if check.verdict is CheckVerdict.BROKEN) or ""),
        )
    if checks:
        out.print(table)
    for line in dict.fromkeys(line for check in checks for line in _unchecked(check)):
        say(out, f"not checked: {line}")
    for check in checks:
        if check.name == "account" and check.verdict is CheckVerdict.HOLDS:
            say(out, f"{check.party}: {check.what}: {check.remark}")
    for press in audit.presses:
        say(out, press.sentence())
    for line, _ in promise_lines(audit.promises):
        say(out, line)
    for check in checks:
        if check.verdict is CheckVerdict.ASSUMPTION:
            say(out, f"assumption that did not hold: {check.party}: {check.what}: {check.remark}")
    for check in audit.broken:
        say(out, f"broken: {check.party}: {check.name}: {sentence(check)}")
    if certificate.holds:
        say(out, f"certificate {certificate.remark}: proved again, and this session's")
    for fault in audit.faults:
        say(out, f"the session failed: {fault}")
    say(out, f"{name}: {verdict_text(audit)}{_left_out(checks)}")


def verdict_text(audit: Audit) -> str:
    """What the audit has found, in one line: what it says holds is what the certificate needs."""
    count = verdicts(audit.checks)
    compared = len(audit.checks) - count[CheckVerdict.UNCHECKED]
    kept = f"{compared - count[CheckVerdict.BROKEN] - count[CheckVerdict.MISSING]} of {counted(compared, 'check')}"
    if count[CheckVerdict.ASSUMPTION]:
        missed_ones = count[CheckVerdict.ASSUMPTION]
        kept += f", {missed_ones} of them {'an assumption' if missed_ones == 1 else 'assumptions'} that did not hold"
    needed = [row for row in grouped(missed(audit.promises)) if PROMISES[Promise(row.promise)].needed]
    if audit.verdict is AuditVerdict.HOLDS:
        enforced = dict.fromkeys(row.promise for row in needed if row.state == PromiseState.ENFORCED)
        return f"holds ({kept})" + (f"; enforced: {', '.join(enforced)}" if enforced else "")
    lacks = [f"{row.promise} ({parties(row.who)})" for row in needed if row.state == PromiseState.UNCHECKED]
    if audit.verdict is AuditVerdict.UNCHECKED:
        return f"not checked: {'; '.join(lacks)}; what is there holds ({kept})"
    broken = [f"{row.promise} ({parties(row.who)})" for row in needed if row.state == PromiseState.BROKEN]
    broken = broken or [f"{check.name} of {check.party}" for check in audit.broken]
    unchecked = f"; not checked: {'; '.join(lacks)}" if lacks else ""
    return f"does not hold: broken: {'; '.join(broken)}{unchecked} ({kept})"


def _unchecked(check: Check) -> list[str]:
    """The ticks that a check does not cover, a line for each reason."""
    gaps: dict[str, list[UncheckedTicks]] = {}
    for gap in check.gaps:
        gaps.setdefault(gap.why, []).append(gap)
    out = []
    for why, own in gaps.items():
        ticks = sum(gap.end - gap.begin for gap in own)
        text = str(own[0]) if len(own) == 1 else f"{counted(ticks, 'tick')}, {own[0].begin} to {own[-1].end - 1}: {why}"
        out.append(f"{check.party}: {text}")
    return out


def _left_out(checks: Sequence[Check]) -> str:
    """The part of each party's ticks in which its ledger was not recomputed, for the last line; empty without any."""
    out = []
    for check in checks:
        left = sum(gap.end - gap.begin for gap in check.gaps)
        if check.name == "ledger" and left:
            share = left / (left + check.numbers)  # a ledger is one number a tick
            out.append(f"{'less than 1 %' if share < 0.01 else f'{share:.0%}'.replace('%', ' %')} of {check.party}'s")
    return f"; ticks without a check of the ledger: {', '.join(out)}" if out else ""


def sentence(check: Check) -> str:
    """The sentence about a broken check, with its first wrong number."""
    if check.first is None:
        return check.remark or check.what
    first, within = check.first, f" within {check.tolerance:.3g}" if check.tolerance else ""
    return (
        f"differs first at tick {first.tick}, {first.column}: recorded {first.recorded!r}, expected "
        f"{first.recomputed!r}{within} ({check.what}; {check.differing} of {check.numbers} differ)"
    )
