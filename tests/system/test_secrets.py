"""Where a private key may be while a session runs, and where not: command lines, environments, logs, reports."""

from __future__ import annotations

import io
import json
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console
from zmq.utils import z85

from manyhands.design.certificate import save
from manyhands.launch.app.design_report import print_report
from manyhands.launch.look.live import LiveTable
from manyhands.launch.plan.keys import Keys, ephemeral, load_folder, make_keys
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import roster, topology
from manyhands.launch.run import directory as run_directories
from manyhands.launch.run.broadcast import describe
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"


def spellings(secret: str) -> Iterator[bytes]:
    """How a secret could be written down."""
    raw = z85.decode(secret.encode())
    yield from (secret.encode(), raw, raw.hex().encode(), json.dumps(secret)[1:-1].encode())


@pytest.mark.parametrize(
    "kept", [True, pytest.param(False, marks=pytest.mark.long)], ids=["keys from a folder", "keys of one run"]
)
def test_private_keys_are_in_files_of_their_owners_and_nowhere_else(kept: bool, tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1.yaml")
    prepared = prepare(session)
    graph = topology(session)
    if kept:
        make_keys(session, tmp_path / "keys")
    keys: Keys = load_folder(session, tmp_path / "keys") if kept else ephemeral(roster(session), session.name)
    secrets = [spelling for name in roster(session) for spelling in spellings(keys.pair(name).secret)]
    screen = Console(file=io.StringIO(), force_terminal=True, width=200)
    seen: dict[str, bytes] = {}
    modes: dict[str, int] = {}

    with LiveTable(screen, "secrets", describe(prepared, "simulated", "tcp", 3000)) as table:

        def look(progress: Progress) -> None:
            table(progress)
            if progress.phase is not SessionPhase.RUNNING or seen:
                return
            for name, pid in progress.pids.items():
                for kind in ("cmdline", "environ"):
                    seen[f"{kind} of {name}"] = Path(f"/proc/{pid}/{kind}").read_bytes()
            for kind in ("cmdline", "environ"):
                seen[f"{kind} of the supervisor"] = Path(f"/proc/self/{kind}").read_bytes()
            (directory,) = Path(run_directories.tempfile.gettempdir()).glob("manyhands-*")
            modes["directory"] = stat.S_IMODE(directory.stat().st_mode)
            for path in directory.iterdir():
                modes[path.name] = stat.S_IMODE(path.stat().st_mode)
                if path.suffix != ".key" and path.is_file():
                    seen[path.name] = path.read_bytes()

        ways = reach(Plan(session), "tcp", keys=keys)
        # the run lasts until all was looked at: it has some thousand ticks to do, and is shown at its first
        outcome = Supervisor(prepared, clock="simulated", reach=ways, ticks=3000, record=False, show=look).run()
    assert outcome.code == 0, outcome.faults
    print_report(screen, outcome.report)
    assert isinstance(screen.file, io.StringIO)
    seen["screen"] = screen.file.getvalue().encode()
    seen["report"] = json.dumps(outcome.report).encode()
    assert prepared.certificate is not None
    save(prepared.certificate, tmp_path / "certificate.json")
    seen["certificate"] = (tmp_path / "certificate.json").read_bytes()

    assert {f"{node}.log" for node in graph.nodes} | {f"{node}.bundle" for node in graph.nodes} <= seen.keys()
    assert {"about.json", "session.yaml", "certificate.json"} <= seen.keys()
    assert len(seen) == 4 * len(graph.nodes) + 2 + 6  # two of each process and its two files; the supervisor; the rest
    told = [place for place, content in seen.items() if any(secret in content for secret in secrets)]
    assert told == []
    assert modes["directory"] == 0o700
    assert all(modes[f"{node}.bundle"] == 0o600 for node in graph.nodes)
    own = {name for name in modes if name.endswith(".key")}
    assert own == (set() if kept else {f"{node}.key" for node in graph.nodes})
    assert all(modes[name] == 0o600 for name in own)
    if kept:
        private = tmp_path / "keys" / "private"
        assert stat.S_IMODE(private.stat().st_mode) == 0o700
        assert {stat.S_IMODE(path.stat().st_mode) for path in private.iterdir()} == {0o600}
        assert secrets[0] in (private / f"{next(iter(roster(session)))}.key").read_bytes()  # so that it can be found
