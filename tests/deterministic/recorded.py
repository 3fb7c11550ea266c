"""Sessions in virtual time whose telemetry is kept, and recorded and audited as a launch would."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from manyhands.launch.audit.audit import Audit, audit
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.run import read_run
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.rows import figures as names
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation, Telemetry
from tests.support.simulated_recordings import START, attachments_of, recorded_of

from .process import SimulatedProcess
from .world import SimulatedSession

Told = Mapping[str, Sequence[Telemetry]]
"""The telemetry of each node, in order."""


class WatchedSession(SimulatedSession):
    """A session in real time that ran to its end.

    Attributes:
        told: the telemetry of each node.
        ran: the latest process of each node that leads one.
    """

    def __init__(
        self, prepared: Prepared, faults: Callable[[SimulatedSession], None], ticks: int = 650, seed: int = 7
    ) -> None:
        """Run it to its end.

        Args:
            prepared: the session, designed.
            faults: plans what happens, before it starts.
            ticks: its length.
            seed: of all that happens.
        """
        self.told: dict[str, list[Telemetry]] = defaultdict(list)
        self.ran: dict[str, SimulatedProcess] = {}
        super().__init__(prepared, "realtime", seed, ticks=ticks)
        faults(self)
        self.scheduler.watch = lambda: self.conductor.phase is SessionPhase.OVER and not self.processes
        self.scheduler.run()
        self.scheduler.join()

    def _start(self, name: str) -> None:
        super()._start(name)
        self.ran[name] = self.processes[name]

    def _hear(self, sender: str, frame: bytes) -> None:
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Telemetry):
            self.told[sender].append(message)
        super()._hear(sender, frame)


def audited(path: Path, prepared: Prepared, told: Told) -> Audit:
    """Record what the nodes told, and audit the file at ``path``."""
    core = RecorderCore(recorded_of(prepared, "realtime"), attachments_of(prepared), START)
    for node, messages in told.items():
        for message in map(names.shown, messages):
            core.take(encode(Observation(node, message.tick, message.figures, message.traces)), START)
    assert core.refused == 0, f"the recorder refused {core.refused} observations"
    path.write_bytes(core.cut() + core.end())
    return audit(path, read_run(path), lambda text: None, lambda tick: None)
