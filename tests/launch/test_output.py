"""Output without a reader: the display is dropped, a session goes on, a command that only prints ends."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest

ALONE = Path(__file__).parents[1] / "deterministic/alone.yaml"
PREAMBLE = "import sys, os\nfrom manyhands.launch import output\noutput.install()\n"


@contextmanager
def broken(how: str) -> Iterator[IO[bytes]]:
    """A stream that takes nothing: the disk behind it is full, or its reader has left."""
    if how == "full":
        with open("/dev/full", "wb") as stream:
            yield stream
        return
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as stream:
        yield stream


def python(
    *arguments: str, out: IO[bytes] | None = None, err: IO[bytes] | None = None, env: Mapping[str, str] | None = None
) -> tuple[int, str, str]:
    """Run Python; returns its exit code and what it wrote to those streams that are not given."""
    done = subprocess.run(
        [sys.executable, "-P", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=out or subprocess.PIPE,
        stderr=err or subprocess.PIPE,
        env={**os.environ, **(env or {})},
        timeout=120,
        check=False,
    )
    return done.returncode, (done.stdout or b"").decode("latin-1"), (done.stderr or b"").decode("latin-1")


def test_a_session_goes_on_without_its_display_and_reports_it(tmp_path: Path) -> None:
    """Here its reader has left; tests/system/test_surroundings.py has a full disk behind it."""
    launch = ("-m", "manyhands", "launch", str(ALONE), "--clock", "simulated", "--duration", "0.3")
    with broken("closed") as err:
        code, _, _ = python(*launch, "--report", str(tmp_path / "run.json"), err=err)
    assert code == 0
    report = json.loads((tmp_path / "run.json").read_text())
    assert report["nodes"]["d"]["ticks"] == 300
    assert report["incidents"] == ["the display was lost (standard error: Broken pipe); the session goes on without it"]


@pytest.mark.parametrize("how", ["closed", "full"])
def test_whatever_is_written_to_a_broken_standard_error_is_dropped(how: str) -> None:
    script = PREAMBLE + "for _ in range(9): print('x' * 9999, file=sys.stderr)\nprint(output.lost_at(sys.stderr))"
    with broken(how) as err:
        code, out, _ = python("-c", script, err=err)
    assert code == 0
    assert out.startswith("standard error: ")


def test_a_command_with_other_work_outlives_its_reader() -> None:
    with broken("closed") as out:
        found = python(
            "-c", PREAMBLE + "print('x', flush=True)\nprint('went on', file=sys.stderr)\nsys.exit(3)", out=out
        )
    assert found == (3, "", "went on\n")


def test_a_command_that_only_prints_ends_quietly_with_its_reader() -> None:
    script = PREAMBLE + "with output.pipe_may_close():\n    while True: print('x' * 99)"
    with broken("closed") as out:
        assert python("-c", script, out=out) == (0, "", "")


def test_results_that_find_no_room_are_an_error_that_names_where() -> None:
    with broken("full") as out:
        code, _, err = python("-m", "manyhands", "--version", out=out)
        assert (code, err) == (1, "error: standard output: No space left on device\n")


def test_a_file_never_gets_the_number_of_a_missing_stream() -> None:
    command = f'exec {sys.executable} -P -c "$0" 0<&- 2>&-'
    script = PREAMBLE + "file = open(os.devnull); print(file.fileno() > 2); print('x', file=sys.stderr)"
    done = subprocess.run(
        ["/bin/sh", "-c", command, script], stdout=subprocess.PIPE, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (0, "True\n")


def test_characters_that_an_encoding_lacks_are_escaped() -> None:
    env = {"PYTHONIOENCODING": "latin-1"}
    assert python("-c", PREAMBLE + "print('\\u03c4 ü')", env=env) == (0, "\\u03c4 ü\n", "")


def test_a_stalled_terminal_is_noticed_before_it_is_waited_for() -> None:
    read, write = os.pipe()
    script = PREAMBLE + "free = output.has_room(sys.stderr)\nprint(free, flush=True)"
    with os.fdopen(read, "rb"), os.fdopen(write, "wb") as err:
        assert python("-c", script, err=err)[1] == "True\n"
        while select.select([], [write], [], 0)[1]:
            os.write(write, bytes(4096))
        assert python("-c", script, err=err)[1] == "False\n"


INTERRUPTED = """
import os, signal, sys, threading, time
from manyhands.launch import output

class Stopped(Exception): pass

def stop(*_): raise Stopped

reader, writer = os.pipe()
os.dup2(writer, 1)
output.install()
signal.signal(signal.SIGUSR1, stop)
lines = []

def interrupt():
    with open(reader) as source:
        for line in source:
            lines.append(line)
            signal.pthread_kill(main, signal.SIGUSR1)

main = threading.get_ident()
thread = threading.Thread(target=interrupt)
thread.start()
for number in range(200):
    try:
        print(number, flush=True)
        while True:  # until the signal comes, which pause() would miss if it came just before
            time.sleep(0.001)
    except Stopped:
        pass
sys.stdout.flush()
signal.signal(signal.SIGUSR1, signal.SIG_IGN)
os.close(writer)
os.close(1)
thread.join()
sys.exit(lines != [f"{number}\\n" for number in range(200)])
"""


def test_a_signal_that_ends_a_command_repeats_no_line() -> None:
    """The handler raises as soon as the line has been read, which may be before the print has returned."""
    subprocess.run([sys.executable, "-P", "-c", INTERRUPTED], check=True, timeout=120)
