"""The observing commands without a session, and completion at Tab."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.run.directory import run_directory

from ....support.commands import manyhands_command
from ....support.observed_frames import ABOUT

pytestmark = pytest.mark.usefixtures("own_interrupt")


def completed(*words: str) -> list[str]:
    """The completions that bash receives at Tab behind these words; the last word is not yet whole."""
    environment = {
        "_MANYHANDS_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(["manyhands", *words]),
        "COMP_CWORD": str(len(words)),
    }
    return CliRunner().invoke(app, [], env=environment, prog_name="manyhands").stdout.split()


@contextmanager
def running(*sessions: str) -> Iterator[None]:
    """Sessions under this process that describe themselves and send nothing."""
    if not sessions:
        yield
        return
    with run_directory() as directory, running(*sessions[1:]):
        replace(ABOUT, session=sessions[0], pid=os.getpid()).save(directory)
        yield


def test_nothing_runs() -> None:
    for arguments, out in ((("top", "--all"), ""), (("top", "--all", "--json"), "[]\n")):
        done = manyhands_command(*arguments)
        assert (done.exit_code, done.stdout) == (0, out)
        assert done.stderr == "no session is running; start one with: manyhands launch SESSION\n"
    for arguments in (("echo", "dx/sample"), ("hz", "dx/sample"), ("top",), ("graph", "--running", "s")):
        done = manyhands_command(*arguments)
        assert (done.exit_code, done.stdout) == (2, "")
        assert done.stderr.startswith("error: found no running session; start one with: manyhands launch SESSION")


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("echo", "d/smaple"), "found no topic 'd/smaple' in session 's'; did you mean d/sample?"),
        (("hz", "/other/d/sample"), "found no running session 'other'; expected one of s"),
        (("echo", "d/sample", "--running", "z"), "found no running session 'z'"),
        (("hz", "d/sample", "--duration", "0"), "--duration: found 0 s; expected more than 0"),
        (("hz", "d/sample", "--duration", "nan"), "--duration: found nan s"),
        (("graph",), "give either SESSION or --running NAME"),
        (("graph", "example1.yaml", "--running", "s"), "give either SESSION or --running NAME"),
        (("graph", "--running", "s", "--access"), "--access and --set need a session file"),
        (("graph", "--running", "s", "--set", "period=1"), "--access and --set need a session file"),
        (("graph", "example1.yaml", "--format", "png"), "--format: found 'png'; expected text or mermaid or svg"),
        (("graph", "example1.yaml", "--format", "svg", "--json"), "give either --format or --json"),
        (("graph", "example1.yaml", "--access", "--format", "svg"), "--access: found --format svg"),
        (("graph", "example1.yaml", "--access", "-o", "g.svg"), "--access: found g.svg; expected .txt or .json"),
        (("graph", "example1.yaml", "-o", "g.png"), "g.png: found the suffix '.png'; expected .svg"),
        (("graph", "example1.yaml", "-o", "none/g.svg"), "none/g.svg"),
    ],
)
def test_what_is_refused(arguments: tuple[str, ...], found: str) -> None:
    with running("s"):
        done = manyhands_command(*arguments)
    assert (done.exit_code, done.stdout) == (2, ""), done.stderr
    assert found in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_silent_session_is_listed_by_its_description() -> None:
    with running("mute"):
        done = manyhands_command("top", "--all", "--json")
    (said,) = json.loads(done.stdout)
    assert (said["session"], said["pid"], said["health"], said["phase"]) == ("mute", os.getpid(), "waiting", None)


def test_several_sessions_have_to_be_told_apart() -> None:
    with running("s", "t"):
        done = manyhands_command("top", "--once")
        assert done.exit_code == 2
        assert "found several running: " in done.stderr
        assert completed("top", "--running", "") == ["s", "t"]
        assert completed("echo", "d/") == []  # of which?
        topics = ("sample", "force", "ledger", "tau", "interface", "applied", "instants", "telemetry")
        assert completed("echo", "/t/d/") == [f"/t/d/{name}" for name in topics]
        assert completed("echo", "--running", "t", "d/t") == ["d/tau", "d/telemetry"]
    with running("s", "s"):
        assert completed("top", "--running", "") == [str(os.getpid())] * 2


def test_at_tab_topics_of_the_running_session() -> None:
    assert completed("echo", "") == []
    with running("s"):
        assert completed("hz", "cx/") == ["cx/tool", "cx/reaction", "cx/ledger", "cx/telemetry"]
        assert completed("echo", "sup") == ["supervisor/condition"]
        assert completed("echo", "/s/environment/ma") == ["/s/environment/masses"]
        assert completed("echo", "zzz") == []


def test_at_tab_session_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").touch()
    (tmp_path / "notes.txt").touch()
    (tmp_path / ".hidden.yaml").touch()
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "other.yml").touch()
    assert completed("design", "m") == ["mine.yaml", "more/", "mujoco.yaml"]
    assert completed("launch", "more/") == ["more/other.yml"]
    assert completed("graph", "example2-") == ["example2-closed-loop.yaml", "example2-linear.yaml"]
    assert completed("launch", "none/x") == []


def test_at_tab_nodes_of_the_session_file(tmp_path: Path) -> None:
    assert completed("invite", "example1.yaml", "d") == ["dx", "dy", "dz"]
    assert "environment" in completed("invite", "example1.yaml", "")
    (tmp_path / "broken.yaml").write_text("session: [")
    assert completed("invite", str(tmp_path / "broken.yaml"), "d") == []


def test_at_tab_the_forms_of_a_graph() -> None:
    assert completed("graph", "example1.yaml", "--format", "s") == ["svg"]


def test_a_directory_whose_description_is_damaged_is_no_session() -> None:
    with running("s"):
        for path in Path(tempfile.gettempdir()).glob("manyhands-*/about.json"):
            path.write_text("{")
        assert completed("top", "--running", "") == []
        assert manyhands_command("top", "--all", "--json").stdout == "[]\n"
