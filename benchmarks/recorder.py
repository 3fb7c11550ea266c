"""The cost of recording a session, and the ticks lost when the recorder is killed.

    python benchmarks/recorder.py [--session FILE] [--seconds S] [--json FILE]
    python benchmarks/recorder.py --kills N [--seed K] [--json FILE]

Without a loop, the telemetry of so many seconds is given to the recorder's core as fast as it takes it, and what it
makes of that is written and synced as a recorder does: its processor time for a second of the session. With the loop, a
session runs at its own pace and the recorder's process is watched. ``--kills`` runs as many sessions in real time, and
sends each one's recorder a SIGKILL at some time: lost are the ticks behind the last that is in the file, up to the last
that the supervisor had sent to the recorder.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import proc

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import topology
from manyhands.launch.recordings.mcap import messages
from manyhands.launch.recordings.tables import read_recording
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.recorder.mcap import RecordingFile
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, Observation, Role

SESSION = Path(__file__).parents[1] / "launch" / "sessions" / "example1.yaml"
TELEMETRY_S = 0.1
FIGURES = {f"figure_{k}": 1.1 * k for k in range(16)}  # a device's are as many
KILLED_AFTER = (1.0, 3.0)  # s since the first telemetry
GOES_ON = 0.2  # s, of the session after that


def recorded_of(prepared: Prepared) -> Recorded:
    """The description of the session that its recorder receives."""
    session, graph = prepared.session, topology(prepared.session)
    masses = session.environment.reported(session.ports)
    return Recorded(session.name, prepared.id, session.period, "realtime", graph.nodes, graph.ports, masses)


def telemetry(recorded: Recorded, seconds: float) -> Iterator[bytes]:
    """The frames of so many seconds: random walks, of which no digit is like another."""
    numbers, every = np.random.default_rng(0), max(1, round(TELEMETRY_S / recorded.period))
    for end in range(every, round(seconds / recorded.period) + 1, every):
        for node in recorded.roles:
            traces = {
                topic.trace: numbers.normal(scale=1e-3, size=(every, len(recorded.columns(node, topic)))).cumsum(axis=0)
                for topic in recorded.topics(node)
            }
            yield encode(Observation(node, end, Figures(FIGURES), traces))


def without_loop(prepared: Prepared, seconds: float, folder: Path) -> dict[str, float]:
    """Processor time a second of the session, bytes and messages likewise, of a recorder that receives all at once."""
    recorded = recorded_of(prepared)
    frames = [*telemetry(recorded, seconds)]
    path = folder / "without.mcap"
    core = RecorderCore(recorded)
    file = RecordingFile(path, core.cut())
    every = round(1.0 / recorded.period)
    due = every
    before = time.process_time()
    for frame in frames:
        core.take(frame, time.time_ns())
        if core.full or core.tick >= due:
            file.append(core.cut())
            due = core.tick + every
    file.append(core.cut())
    spent = time.process_time() - before
    file.append(core.end())
    file.close()
    return figures(path, seconds, spent / seconds)


def with_loop(prepared: Prepared, seconds: float, folder: Path) -> dict[str, float]:
    """The same of a recorder's process, while its session runs in real time."""
    path, looks = folder / "with.mcap", list[tuple[float, float]]()
    recorder = RecorderProcess(prepared, "realtime", path)

    def look(progress: Progress) -> None:
        if recorder.pid is not None and progress.telemetry:
            looks.append((time.monotonic(), proc.cpu_seconds([recorder.pid])))

    run(prepared, recorder, seconds, look)
    (began, before), (ended, after) = looks[0], looks[-1]
    return figures(path, seconds, (after - before) / (ended - began))


def run(prepared: Prepared, recorder: RecorderProcess, seconds: float, show: Any = None) -> None:
    """A session in real time, of so many seconds."""
    ticks = round(seconds / prepared.session.period)
    ways = reach(prepared, "ipc")
    outcome = Supervisor(
        prepared, clock="realtime", reach=ways, ticks=ticks, record=False, recorder=recorder, show=show
    ).run()
    if outcome.faults:
        raise SystemExit("\n".join(outcome.faults))


def figures(path: Path, seconds: float, share: float) -> dict[str, float]:
    """The figures of a recording of so many seconds."""
    count = sum(1 for _ in messages(path)) - 1  # the last is its end
    return {
        "processor_share": share,
        "messages_per_s": count / seconds,
        "bytes_per_s": path.stat().st_size / seconds,
        "us_per_message": 1e6 * share * seconds / count,
    }


class Doomed(RecorderProcess):
    """A recorder that is killed when its supervisor sends it a frame, some time after the first telemetry.

    Attributes:
        tick: the latest tick of any device that it had received before.
    """

    def __init__(self, prepared: Prepared, path: Path, after: float) -> None:
        """Kill it so many seconds ``after`` it receives the first telemetry."""
        super().__init__(prepared, "realtime", path)
        self._devices = {name for name, role in topology(prepared.session).nodes.items() if role is Role.DEVICE}
        self._after, self._first, self._killed = after, float("inf"), False
        self.tick = 0

    def take(self, frame: bytes | None) -> None:
        """Send it on, note its tick, and kill the recorder when it is time."""
        super().take(frame)
        if self._killed or frame is None:
            return
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation) and message.node in self._devices:
            self._first = min(self._first, time.monotonic())
            self.tick = max(self.tick, message.tick)
        if self.pid is not None and time.monotonic() - self._first >= self._after:
            os.kill(self.pid, signal.SIGKILL)
            self._killed = True


def kills(prepared: Prepared, number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Seconds of ticks that were lost with each of so many recorders that were killed."""
    chance, lost = random.Random(seed), list[float]()  # noqa: S311 -- when to kill is no secret
    for k in range(number):
        after = chance.uniform(*KILLED_AFTER)
        recorder = Doomed(prepared, folder / f"{k}.mcap", after)
        run(prepared, recorder, after + GOES_ON)
        found = read_recording(recorder.path)
        lost.append((recorder.tick - len(found.x)) * prepared.session.period)
        tell(f"killed after {after:.2f} s: told of {recorder.tick} ticks, {len(found.x)} in the file")
    return {"kills": number, "seed": seed, "min": min(lost), "median": statistics.median(lost), "max": max(lost)}


def tell(text: str) -> None:
    """Print the progress, apart from the result."""
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description="What a recording costs, and what is lost with a killed recorder.")
    parser.add_argument("--session", type=Path, default=SESSION)
    parser.add_argument("--seconds", type=float, default=20.0, help="of the session, for its cost")
    parser.add_argument("--kills", type=int, default=0, metavar="N", help="kill N recorders instead")
    parser.add_argument("--seed", type=int, default=0, help="of the times of the kills")
    parser.add_argument("--no-loop", action="store_true", help="leave the running session out")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
    chosen = parser.parse_args()
    prepared = prepare(load_session(chosen.session))
    found: dict[str, Any] = {"machine": proc.machine(), "session": prepared.session.name}
    with tempfile.TemporaryDirectory() as folder:
        if chosen.kills:
            found["lost_s"] = lost = kills(prepared, chosen.kills, chosen.seed, Path(folder))
            print(
                f"{lost['kills']} recorders killed: lost behind the last tick told, s: "
                f"min {lost['min']:.3f}, median {lost['median']:.3f}, max {lost['max']:.3f}"
            )
        else:
            ways = {"without_loop": without_loop} | ({} if chosen.no_loop else {"with_loop": with_loop})
            for name, measure in ways.items():
                found[name] = one = measure(prepared, chosen.seconds, Path(folder))
                print(
                    f"{name.replace('_', ' ')}: {one['messages_per_s']:.0f} messages/s, {one['processor_share']:.1%} "
                    f"of one processor ({one['us_per_message']:.2f} us a message), {one['bytes_per_s'] / 1e3:.0f} kB/s"
                )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
