"""Runs of a session with rogues in it or around it, and their results.

The session is Example 1 with limits and an observer, over keyed TCP under the simulated clock: real processes, sockets
and keys, and values that are the same to the last bit whenever nothing has moved them.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.keys import Keys, ephemeral
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import roster
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.outcome import Outcome, Progress
from manyhands.launch.run.states import Instruction, SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import Bundle
from manyhands.protocol.codec import Received
from manyhands.protocol.messages import NodeHello

from .acts import LEAVE
from .links import DEADLINE_MS

HERE: Final = Path(__file__).parent
SESSION: Final = HERE.parents[2] / "launch" / "sessions" / "example1.yaml"
SUPERVISOR: Final = "supervisor"
OBSERVER: Final = "watch"
HELD: Final = "dx"
FORCE_LIMIT: Final = 5.0  # N; the environment's own force stays below 4
OVERRIDES: Final = (
    f"observers={{{OBSERVER}: {{reads: [telemetry]}}}}",
    *(f"devices.{name}.limits={{force: {FORCE_LIMIT}, displacement: 0.2, speed: 2}}" for name in ("dx", "dy", "dz")),
)
TICKS: Final = 800  # the hands push from 100 to 350
ATTENTIVE: Final = 10  # ticks between two telemetry messages, when a process also attends to its door
DEADLINE: Final = DEADLINE_MS / 1000  # s
STANDSTILL: Final = 2 * DEADLINE  # an attack may wait for once a deadline while the session waits for it

Forge = Callable[[dict[str, Bundle]], dict[str, Bundle]]


@cache
def prepared() -> Prepared:
    """The session, designed once."""
    return prepare(load_session(SESSION, list(OVERRIDES)))


class Ended(Exception):
    """The session ended before the attack."""


@dataclass
class RogueSession:
    """An attack's knowledge of a session, and its means to let the session go on.

    Attributes:
        keys: all keys: an attack can play any part with the real one.
        hub: endpoint of the supervisor's hub.
        links: endpoint of each link, by its binding and its connecting end.
        observer: endpoint of the observer's broadcast.
        ticks: the number of ticks done with the attack's leave.
    """

    keys: Keys
    hub: str = ""
    links: dict[tuple[str, str], str] = field(default_factory=dict)
    observer: str = ""
    ticks: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)
    _progress: Progress | None = None
    _over: bool = False
    _seen: tuple[int, float] = field(
        default_factory=lambda: (-1, time.monotonic())
    )  # ticks of all nodes, and since when
    leaves: int = -1
    done: int = -1

    def go_on(self, leaves: int = 1) -> None:
        """Let the session do some ticks, and wait until it has."""
        for _ in range(leaves):
            os.write(self.leaves, b".")
            ready, _, _ = select.select([self.done], [], [], DEADLINE)
            if not ready or not os.read(self.done, 1):
                raise Ended(f"the session did not go on after {self.ticks} ticks")
            self.ticks += LEAVE

    def wait_for(self, what: Callable[[Progress], bool]) -> Progress:
        """Wait until the supervisor reports a progress that meets a condition."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._over or (self._progress is not None and what(self._progress)), DEADLINE
            )
            if self._progress is None or not what(self._progress):
                raise Ended(f"it never came to what was waited for, but to {self._progress}")
            return self._progress

    def show(self, progress: Progress) -> None:
        """Take the supervisor's progress; interrupt a session that stands still, since its test would hang, too."""
        done = sum(telemetry.tick for telemetry in progress.telemetry.values())
        if done != self._seen[0]:
            self._seen = done, time.monotonic()
        elif progress.phase is SessionPhase.RUNNING and time.monotonic() > self._seen[1] + STANDSTILL:
            os.kill(os.getpid(), signal.SIGINT)
        with self._changed:
            self._progress = progress
            self._changed.notify_all()

    def end(self) -> None:
        """Mark the session as over."""
        with self._changed:
            self._over = True
            self._changed.notify_all()


Attack = Callable[[RogueSession], Any]


@dataclass(frozen=True)
class Played:
    """A run and the attack on it.

    Attributes:
        outcome: the run's.
        told: the result of the attack; None without one.
        during: ticks done by the end of the attack.
    """

    outcome: Outcome
    told: Any
    during: int

    @property
    def nodes(self) -> Mapping[str, Any]:
        """Each node's part of the report."""
        nodes: Mapping[str, Any] = self.outcome.report["nodes"]
        return nodes


def play(
    ticks: int = TICKS,
    acts: Mapping[str, str] | None = None,
    forge: Forge | None = None,
    attack: Attack | None = None,
) -> Played:
    """Run the session, and leave nothing behind.

    Args:
        ticks: how many.
        acts: the dishonest nodes, and the act of each (:mod:`.acts`).
        forge: changes the bundles after they were cut.
        attack: runs in a thread of its own. While it lasts, the session goes on only with its leave.
    """
    session = prepared().session
    stage = RogueSession(ephemeral(roster(session), session.name))
    acts = {**(acts or {}), **({HELD: "held"} if attack else {})}
    supervisor = Supervisor(
        prepared(),
        clock="simulated",
        reach=reach(Plan(session), "tcp", keys=stage.keys),
        ticks=ticks,
        record=True,
        show=stage.show,
    )
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        given: tuple[int, ...] = ()
        if attack:
            leaves, stage.leaves = os.pipe()
            stage.done, done = os.pipe()
            given = (leaves, done)
            stack.callback(os.close, stage.done)
        _cast(patch, acts, given)
        _overhear(patch, stage, forge or (lambda bundles: bundles))
        if attack is None:
            return Played(supervisor.run(), None, 0)
        with ThreadPoolExecutor(1) as pool:
            told = pool.submit(_carry_out, attack, stage)
            try:
                outcome = supervisor.run()
            finally:
                stage.end()
                for descriptor in given:  # an attack that still waits for the session learns that it is over
                    os.close(descriptor)
            return Played(outcome, told.result(), stage.ticks)


def _carry_out(attack: Attack, stage: RogueSession) -> Any:
    try:
        stage.wait_for(lambda progress: progress.phase is SessionPhase.RUNNING)
        return attack(stage)
    finally:
        os.close(stage.leaves)  # the rest of the ticks need no leave


def _cast(patch: pytest.MonkeyPatch, acts: Mapping[str, str], given: tuple[int, ...]) -> None:
    """Have the supervisor start other programs for some nodes."""
    popen = subprocess.Popen

    def start(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        bundle, pid = command[-2:]
        act = acts.get(Path(bundle).stem)
        if act is None:
            return popen(command, **options)
        path = [str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        options["env"] = {**options["env"], "PYTHONPATH": os.pathsep.join(path)}
        descriptors = given if act == "held" else ()
        script = [sys.executable, "-P", "-m", "rogues.acts", act, bundle, pid, *map(str, descriptors)]
        return popen(script, pass_fds=descriptors, **options)

    patch.setattr(subprocess, "Popen", start)


def _overhear(patch: pytest.MonkeyPatch, stage: RogueSession, forge: Forge) -> None:
    """Give the stage all endpoints, as an eavesdropper would know them."""

    def cut_and_forge(prepared: Prepared, run: RunPlan) -> dict[str, Bundle]:
        stage.hub = run.control
        bundles = {
            name: replace(bundle, common=replace(bundle.common, telemetry_ticks=ATTENTIVE, telemetry_first=ATTENTIVE))
            for name, bundle in cut(prepared, run).items()
        }
        return forge(bundles)

    hear = Conductor.receive

    def overhear(self: Conductor, sender: str, received: Received, now: int) -> list[Instruction]:
        if isinstance(received, NodeHello):
            stage.links.update({(sender, peer): endpoint for peer, endpoint in received.endpoints.items()})
            stage.observer = self.observers[OBSERVER]
        return hear(self, sender, received, now)

    patch.setattr(supervisor_module, "cut", cut_and_forge)
    patch.setattr(Conductor, "receive", overhear)
