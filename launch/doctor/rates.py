"""What a machine gives a session: the measured delay, the tau that is designed for, and the stiffness that remains.

`manyhands doctor` measures a session at 1, 2 and 4 kHz, separate and co-located, and keeps the profiles. `manyhands
budget` shows the profiles that are kept. `manyhands launch` prints one line about the certificate of its run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from manyhands.design.budget import needed_share
from manyhands.design.certificate import Certificate
from manyhands.design.models.axis import Units
from manyhands.design.wave_link import FELT_STIFFNESS
from manyhands.launch.doctor.advice import Advice, Worth
from manyhands.launch.doctor.probe import Form, Way, forms_of
from manyhands.launch.doctor.profile import QUANTILE, Allowance, Profile, allowance, kept_profile
from manyhands.launch.plan.feel import stiffness_range
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.remedies import settings
from manyhands.launch.session import Session, SessionError
from manyhands.launch.session.errors import listed
from manyhands.nodes.monitor.given import MEASURE


@dataclass(frozen=True)
class FormFigures:
    """One form of a session on this machine.

    Attributes:
        form: the rate, and whether couplings are co-located.
        profile: what was measured; None where nothing was.
        missing: why nothing was measured; empty where something was.
        chosen: what a design has to cover; None where nothing was measured.
        certified: supremum of the certified stiffness of the weakest device at the tau to design for, N/m; 0 where
            no coupling covers the measured delay, None where the environment has no such period, or nothing was
            measured.
        at_worst: the same if the coupling covered the longest delay that was measured, too.
        no_delay: the same without any delay, N/m; None where the environment has no such period.
    """

    form: Form
    profile: Profile | None
    missing: str
    chosen: Allowance | None
    certified: float | None
    at_worst: float | None
    no_delay: float | None


NOT_MEASURED = "not measured yet; manyhands doctor SESSION measures the delay, and what it leaves is then shown here"


def kept_forms(session: Session, now: float) -> dict[Form, Profile | str]:
    """The profiles of each form that are kept on this machine, at ``now`` in s since the epoch."""
    plans = {form: form.plan(session) for form in forms_of(session)}
    return {form: kept_profile(Way.of_run(plan).profile_key(plan), now) or NOT_MEASURED for form, plan in plans.items()}


def form_figures(worth: Worth, found: Mapping[Form, Profile | str]) -> Iterator[FormFigures]:
    """The figures of each form.

    Args:
        worth: the session's loop, with what the session states of its delays.
        found: the profile of each form, or why there is none.
    """
    for form, profile in found.items():
        at = worth.at(form.period)
        no_delay = None if at is None else at.no_delay
        if isinstance(profile, str):
            yield FormFigures(form, None, profile, None, None, None, no_delay)
            continue
        chosen = allowance(profile, form.period, worth.stated)
        certified = at_worst = None if at is None else 0.0
        if at is not None and chosen.covered:
            certified = at.weakest(chosen.tau, chosen.period_tolerance)
        if at is not None and (worst := max(chosen.tau, chosen.latency + profile.tau.max * 1e-6)) <= form.period:
            at_worst = at.weakest(worst, chosen.period_tolerance)
        yield FormFigures(form, profile, "", chosen, certified, at_worst, no_delay)


_BETTER = 1.01  # of its own stiffness: what two measurements of one form may differ by


def form_advice(session: Session, figures: Sequence[FormFigures]) -> tuple[Advice, ...]:
    """The form with which most can be certified, by what was measured of it; none where that is the session's own.

    Args:
        session: the session, as it would run.
        figures: of every form that was measured, its own among them.
    """
    own = next(one for one in figures if one.form == Form(session.period, session.colocated))
    best = max(figures, key=lambda one: one.certified or 0.0)
    if not (best.certified or 0.0) > _BETTER * (own.certified or 0.0):
        return ()
    changes: dict[str, Any] = {} if best.form.period == session.period else {"period": best.form.period}
    changes |= {} if best.form.colocated == session.colocated else {"colocate": best.form.colocated}
    try:
        session.replace(changes)
    except SessionError:  # its weights, or a delay that it states, need its own period
        return ()
    unit = session.units()("N/m")
    gives = f"{_newtons(own.certified or 0.0)} -> {_newtons(best.certified)} {unit}, with the delays measured of either"
    return (Advice(f"run it with {settings(changes)}", gives, tried=True),)


def rates_object(figures: list[FormFigures]) -> list[dict[str, Any]]:
    """The list that ``--json`` prints; periods and tau in s, measured delays in us, stiffness in N/m."""
    out = []
    for one in figures:
        entry: dict[str, Any] = {
            "period": one.form.period,
            "colocate": one.form.colocated,
            "no_delay": one.no_delay,
            "certified": one.certified,
            "at_worst": one.at_worst,
        }
        if one.profile is not None and (chosen := one.chosen) is not None:
            tau = one.profile.tau
            entry |= {
                "tau": chosen.tau,
                "latency": chosen.latency,
                "period_tolerance": chosen.period_tolerance,
                "covered": chosen.covered,
                "tau_us": {"p50": tau.p50, "p995": tau.p995, "p999": tau.p999, "max": tau.max},
                "period_us": one.profile.period,
                "late": one.profile.late,
                "seconds": one.profile.seconds,
                "measured": one.profile.measured,
            }
        out.append(entry)
    return out


def print_rates(console: Console, session: str, units: Units, figures: list[FormFigures]) -> None:
    """Print a table of the forms that were measured, and a line about the others: why, and what measures them."""
    table = Table(title=f"{session} on this machine", title_justify="left")
    table.add_column("rate")
    table.add_column("processes")
    columns = ("τ p50 [µs]", "p99.5", "worst", "late", "designed for τ [ms]", "period [ms]",
               f"certified below [{units('N/m')}]", "at the worst", "no delay")  # fmt: skip
    for column in columns:
        table.add_column(column, justify="right")
    for one in figures:
        form, profile, chosen = one.form, one.profile, one.chosen
        name = f"{1e-3 / form.period:g} kHz", "co-located" if form.colocated else "separate"
        if profile is None or chosen is None:
            continue
        table.add_row(
            *name, f"{profile.tau.p50:.0f}", f"{profile.tau.p995:.0f}", f"{profile.tau.max:.0f}", f"{profile.late:.1%}",
            f"{chosen.tau * 1e3:.4g}" if chosen.covered else "longer than a tick",
            f"{(1.0 + chosen.period_tolerance) * form.period * 1e3:.4g}", _newtons(one.certified),
            _newtons(one.at_worst), _newtons(one.no_delay),
        )  # fmt: skip
    if table.row_count:
        console.print(table)
    if latency := max((one.chosen.latency for one in figures if one.chosen is not None), default=0.0):
        console.print(
            f"{session}: τ contains the {_ms(latency)} of sample_age and actuation_delay that a device states",
            markup=False, soft_wrap=True,
        )  # fmt: skip
    for text in dict.fromkeys(one.missing for one in figures if one.missing):
        rows = [one.form for one in figures if one.missing == text]
        where = ", ".join(f"{1e-3 / form.period:g} kHz{' co-located' if form.colocated else ''}" for form in rows)
        console.print(f"{session} on this machine: {where}: {text}", markup=False, soft_wrap=True)


def _newtons(stiffness: float | None) -> str:
    return "" if stiffness is None else f"{stiffness:.0f}" if stiffness > 0.0 else "none"


def certified_lines(prepared: Prepared, session: Session, profile: Profile | None, now: float) -> Iterator[str]:
    """What a run is certified for, in one line; and a second where the machine is too slow for the period.

    With wave links there is one for each part of the session; parts with the same figures share a line.

    Args:
        prepared: the certified run.
        session: the session with its delay.
        profile: this machine's for the session; None where there is none.
        now: s since the epoch.
    """
    alike: dict[tuple[str, ...], list[str]] = {}
    for part, certificate in prepared.parts.items():
        alike.setdefault(tuple(_certified(certificate, session, profile, now)), []).append(part)
    for lines, parts in alike.items():
        who = session.name if prepared.world is None else f"{session.name}, {listed(parts)}"
        for line in lines:
            yield f"{who}: {line}"


def _certified(certificate: Certificate, session: Session, profile: Profile | None, now: float) -> Iterator[str]:
    """The lines about one certificate, without the session's name.

    Args:
        certificate: the certificate of the run.
        session: the session with its delay.
        profile: this machine's for the session; None where there is none.
        now: s since the epoch.
    """
    loop, T, unit = certificate.loop, certificate.loop.period, certificate.loop.units()("N/m")
    tau = certificate.tau
    if profile is None:
        measured = "not measured here"
    else:
        found, latency = profile.tau.p995 * 1e-6, session.latency
        longer = ", which is longer" if found + latency > tau else ""
        own = f" beside {_ms(latency)} that a driver states" if latency else ""
        measured = f"{profile.told(now)}{own}{longer}"
    share = needed_share(loop.Delta_D, certificate.levels.Phi_E)
    worth = Worth(loop, share)
    given = stiffness_range(certificate)
    text = "" if given is None else f"; stiffness {_between(*given, unit)}"
    if (felt := certificate.margins.get(FELT_STIFFNESS)) is not None:
        text += f", felt as {felt:.4g} {unit} through the wave link"
    periods = f" and periods up to {_ms((1.0 + loop.period_tolerance) * T)}" if loop.period_tolerance else ""
    here = "" if loop.punctual else f"{worth.weakest(tau):.4g} {unit} for these and "
    yield (
        f"certified for delays up to {_ms(tau)}{periods} ({measured}){text}; the limit is {here}"
        f"{worth.no_delay:.4g} {unit} without delay"
    )
    if profile is not None and profile.tau.p995 * 1e-6 > T and tau >= T:
        found, ticks = profile.tau.p995 * 1e-6, round(1.0 / (1.0 - QUANTILE))
        yield (
            f"one tick in {ticks} takes longer than {_ms(found)} here, and no certificate covers more than the "
            f"period of {_ms(T)}; {MEASURE}"
        )


def _between(least: float, greatest: float, unit: str) -> str:
    low, high = f"{least:.4g}", f"{greatest:.4g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"
