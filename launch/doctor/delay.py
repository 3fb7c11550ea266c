"""The delay that a session is designed for: stated, kept from an earlier measurement, measured now, or none."""

from __future__ import annotations

import time
from collections.abc import Callable

from manyhands.launch.doctor.colocation import Where, settle_colocation
from manyhands.launch.doctor.profile import Profile, allowance, allowances_of_sites, keep_profile, kept_profile
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import must_measure
from manyhands.launch.plan.topology import require_runnable
from manyhands.launch.session import Session
from manyhands.launch.session.design import AUTO
from manyhands.nodes.monitor.given import MEASURE


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
    profile = kept_profile(way.profile_key(plan), time.time())
    if not wanted:
        return session, profile
    if profile is None:
        require_runnable(plan.graph)
        report(f"{session.name}: measuring the delay of a tick on this machine for {PROFILE_TIME:g} s")
        profile = measure_profile(plan, way)
        try:
            keep_profile(profile)
        except OSError as error:
            warn(f"the measurement is not kept: {error.filename}: {error.strerror}")
    chosen, latency = allowance(profile, session.device_period), session.latency
    tau = _with_latency(session, chosen.tau, latency, session.device_period)
    sites = {
        name: _with_latency(
            session,
            measured,
            max(session.latencies[device] for device in session.devices_of(name)),
            session.period_of(name),
        )
        for name, measured in allowances_of_sites(profile, session).items()
    }
    tolerance = min(1.0, chosen.period_tolerance + session.period_tolerance)
    return session.with_delay(tau, tolerance if latency else chosen.period_tolerance, sites), profile


def _with_latency(session: Session, measured: float, latency: float, period: float) -> float:
    """The delay to certify where so much was measured and devices state so much, s.

    Raises:
        NotCertified: it is longer than the period.
    """
    tau = round(measured + latency, 12)
    if latency and tau > period:
        raise NotCertified(
            f"{session.name}: found a delay of {1e3 * measured:.3g} ms measured here, and {1e3 * latency:.3g} ms of "
            f"sample_age and actuation_delay that a device states; expected at most the period of "
            f"{1e3 * period:.3g} ms together; {MEASURE}"
        )
    return tau
