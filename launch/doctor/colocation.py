"""Whether the couplings of a run are in their devices' processes, where the session leaves that to the machine.

``colocate: auto``, the default, becomes true or false here, before a run is planned, and nowhere else. The rule, of
which the reasons are in docs/decisions/0020-colocation.md:

1. What a session states itself stays as it is.
2. Each coupling has a process of its own where nothing else is possible (a coupling of several devices, a node on
   another machine), and where nothing is gained: under the simulated clock, and on a machine that has a processor for
   each process.
3. The seats of a hosted session are one process each, since a guest runs a device and its coupling together.
4. Where processors are fewer than processes, the form with the shorter measured delay is taken, if ``doctor`` has
   measured both within a day. Otherwise couplings are in their devices' processes.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from manyhands.launch.doctor.profile import Profile, Stated, allowance, kept_profile
from manyhands.launch.plan.plan import Plan
from manyhands.launch.session import Session
from manyhands.launch.session.design import AUTO
from manyhands.nodes.kernel.words import counted


class Where(Enum):
    """How a session is to run, as far as the choice depends on it."""

    HERE = "here"
    """In real time, with all nodes on this machine."""

    SIMULATED = "simulated"
    """Under the simulated clock."""

    APART = "apart"
    """With nodes on other machines, each of which is one process."""

    HOSTED = "hosted"
    """With seats, whose guests run a device and its coupling in one process."""

    @classmethod
    def of(cls, *, realtime: bool, elsewhere: bool = False) -> Where:
        """Where a launched session runs: ``elsewhere`` tells whether nodes are on other machines."""
        return cls.APART if elsewhere else cls.HERE if realtime else cls.SIMULATED


@dataclass(frozen=True)
class Colocation:
    """What was chosen.

    Attributes:
        colocate: whether couplings run in their devices' processes.
        reason: what was chosen, why, and what the alternative would give; empty where there was no choice.
    """

    colocate: bool
    reason: str = ""


def choose(
    session: Session, where: Where, processors: int, measured: Mapping[bool, Profile] | None = None
) -> Colocation:
    """Whether the couplings of a session run in their devices' processes; the module has the rule.

    Args:
        session: the session.
        where: how it is to run.
        processors: number of those that this process may use.
        measured: this machine's profiles of the session with couplings co-located (True) and not (False).
    """
    if session.colocate != AUTO:
        return Colocation(session.colocated)
    if where in (Where.SIMULATED, Where.APART) or session.shared_couplings:
        return Colocation(False)
    if where is Where.HOSTED:
        return Colocation(True)
    apart, together = process_counts(session)
    found = measured or {}
    if apart <= processors or len(found) < 2:
        return _described(apart > processors, apart, together, processors, "")
    colocate = _cost(found[True], session) < _cost(found[False], session)
    own, other = (f"{found[form].tau.p995 * 1e-3:.3g} ms" for form in (colocate, not colocate))
    return _described(colocate, apart, together, processors, f", p99.5 of a tick {own} in place of {other}")


def process_counts(session: Session) -> tuple[int, int]:
    """The processes that tick, with couplings in processes of their own and in their devices'."""
    apart = len(session.roles)
    return apart, apart - len(session.couplings)


def _cost(profile: Profile, session: Session) -> tuple[float, float]:
    """What a design has to cover, s; where that is the same, the part of the ticks that were late."""
    return allowance(profile, session.device_period, Stated.of(session)).tau, profile.late


def _described(colocate: bool, apart: int, together: int, processors: int, measured: str) -> Colocation:
    if colocate:
        what, own, word, other = "in their devices' processes", together, "false", apart
    else:
        what, own, word, other = "in processes of their own", apart, "true", together
    run, here = counted(own, "process", "processes"), counted(processors, "processor")
    return Colocation(colocate, f"couplings run {what}: {run} on {here} (colocate: {word} has {other}){measured}")


def settle_colocation(
    session: Session, where: Where, transport: str = "ipc", encrypted: bool = True
) -> tuple[Session, str]:
    """The session as it is to run on this machine, and the reason (:attr:`Colocation.reason`).

    Nothing is measured for it: profiles that are kept are used.

    Args:
        session: the session; one that states its form is returned as it is.
        where: how it is to run.
        transport: "ipc" or "tcp".
        encrypted: whether links over "tcp" are encrypted.
    """
    processors = len(os.sched_getaffinity(0))
    choice = choose(session, where, processors)
    if choice.colocate and where is Where.HERE and session.colocate == AUTO:  # a measurement may speak against it
        choice = choose(session, where, processors, _kept(session, transport, encrypted))
    return (session if session.colocate != AUTO else session.with_colocation(choice.colocate)), choice.reason


def _kept(session: Session, transport: str, encrypted: bool) -> dict[bool, Profile]:
    """The profiles of both forms that are kept on this machine."""
    from manyhands.launch.doctor.probe import Way  # it runs sessions, and takes a while to import

    found: dict[bool, Profile] = {}
    for colocate in (False, True):
        plan = Plan(session.with_colocation(colocate))
        profile = kept_profile(Way.of_run(plan, transport, encrypted).profile_key(plan), time.time())
        if profile is not None:
            found[colocate] = profile
    return found
