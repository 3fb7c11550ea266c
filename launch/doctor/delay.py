"""The delay that a session is designed for: stated, kept from an earlier measurement, measured now, or none."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from manyhands.launch.doctor.colocation import Where, settle_colocation
from manyhands.launch.doctor.profile import (
    Allowance,
    Profile,
    Stated,
    ago,
    allowance,
    allowances_of_sites,
    drop_profile,
    keep_profile,
    kept_profile,
)
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import must_measure
from manyhands.launch.plan.topology import require_runnable
from manyhands.launch.session import Session
from manyhands.launch.session.design import AUTO
from manyhands.nodes.monitor.given import MEASURE

ANEW: Final = "the same command measures it anew"
"""What to do where a measurement refuses a session: :func:`outdated` has removed it."""


def settle_delay(
    session: Session,
    report: Callable[[str], None],
    warn: Callable[[str], object],
    *,
    realtime: bool,
    designed: bool = True,
    transport: str = "ipc",
    encrypted: bool = True,
) -> tuple[Session, Profile | None]:
    """The session with the delay that it is to be designed for, measured on this machine where it has to be.

    Args:
        session: the session.
        report: called with a sentence about what is measured.
        warn: called with a sentence if the measurement cannot be kept.
        realtime: as for :func:`must_measure`.
        designed: whether a coupling is to be designed; otherwise the session stays as it is.
        transport: "ipc" or "tcp".
        encrypted: whether links over "tcp" are encrypted.

    Returns:
        The session, and this machine's profile for it, kept or new; None where there is none, or none is of use.

    Raises:
        ProbeFailed, ProbeInterrupted: nothing could be measured.
        LinkTooWide: the session's links are too wide to run.
        NotCertified: the delay measured and the one that a device states are longer than a period together.
    """
    wanted = designed and must_measure(session, realtime=realtime)
    if designed and not wanted and session.design.tau == AUTO:
        session = session.with_delay(0.0)  # it has no coupling
    if not (realtime or wanted):
        return session, None
    # it runs sessions, and takes a while to import
    from manyhands.launch.doctor.probe import PROFILE_TIME, Way, measure_profile

    form, _ = settle_colocation(session, Where.HERE, transport, encrypted)  # launch has done so; design measures, too
    plan = Plan(form)
    way = Way.of_run(plan, transport, encrypted)

    def measured() -> Profile:
        require_runnable(plan.graph)
        report(f"{session.name}: measuring the delay of a tick on this machine for {PROFILE_TIME:g} s")
        profile = measure_profile(plan, way)
        try:
            keep_profile(profile)
        except OSError as error:
            warn(f"the measurement is not kept: {error.filename}: {error.strerror}")
        return profile

    profile = kept_profile(way.profile_key(plan), time.time())
    if not wanted:
        return session, profile
    profile = profile or measured()
    try:
        return _designed_for(session, profile), profile
    except NotCertified:
        if not outdated(profile, session, report):
            raise
    return settle_delay(  # nothing is kept now, so it measures; what is new refuses for good
        session, report, warn, realtime=realtime, designed=designed, transport=transport, encrypted=encrypted
    )


RECENT: Final = 300.0
"""The age in s up to which a measurement may refuse a session; an older one may be of a machine that was busy."""


def outdated(profile: Profile, session: Session, report: Callable[[str], None]) -> bool:
    """Whether what was measured is too old to refuse a session by it, so that it is to be measured anew.

    A measurement by which a session is refused is not kept: the next command measures anew, whatever its age.

    Args:
        profile: what was measured.
        session: the session that is refused.
        report: called with a sentence about it.
    """
    try:
        drop_profile(profile)
    except OSError as error:
        report(f"warning: {error.filename}: the measurement cannot be removed: {error.strerror}")
        return False
    age = profile.age(time.time())
    if age <= RECENT:
        return False
    report(f"{session.name}: is refused for a delay that was measured {ago(age)}, so the delay is measured anew")
    return True


def _designed_for(session: Session, profile: Profile) -> Session:
    """The session with the delay to design for, which was measured and stated.

    Raises:
        NotCertified: no certificate covers both.
    """
    chosen = allowance(profile, session.device_period, Stated.of(session))
    sites = allowances_of_sites(profile, session)
    for one in (chosen, *sites.values()):
        _require_covered(session, one, profile)
    taus = {name: one.tau for name, one in sites.items()}
    return session.with_delay(chosen.tau, chosen.period_tolerance, taus)


def _require_covered(session: Session, found: Allowance, profile: Profile) -> None:
    """Refuse what was measured where devices state so much beside it that no certificate covers both.

    Raises:
        NotCertified: they are longer than the period together.
    """
    if found.latency and found.tau > found.period:
        raise NotCertified(
            f"{session.name}: found a delay of {1e3 * found.measured:.3g} ms ({profile.told(time.time())}), and "
            f"{1e3 * found.latency:.3g} ms of sample_age and actuation_delay that a device states; "
            f"expected at most the period of {1e3 * found.period:.3g} ms together; {ANEW}; {MEASURE}"
        )
