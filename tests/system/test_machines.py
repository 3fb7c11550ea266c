"""Nodes on other machines, by one command and by hand: two network namespaces, and a stand-in for ssh between them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.link.process import EXIT_FAILED, EXIT_OK

from ..support.commands import MANYHANDS, read_until, run
from ..support.wan import Side, Wan, Wire, wan

EXAMPLE = Path(__file__).parents[2] / "launch" / "sessions" / "example1.yaml"
OVERRIDES = ("couplings.cx.wave_link={b: 20, depth: 2}", "design.tau=0")
SET = tuple(word for override in OVERRIDES for word in ("--set", override))
FAR = ("dx", "cx")
TICKS = 200  # the hands push from 100 on
PORT = 7400
PATIENCE = 60.0  # s; far more than anything here takes
SSH = """#!/bin/sh
# stands in for ssh: runs the command on "lab", the other namespace, and fails as ssh does for any other host
printf '%s\\n' "$@" >> {seen}
while [ "$1" != "--" ]; do shift; done
[ "$2" = lab ] || {{ echo "ssh: Could not resolve hostname $2: Name or service not known" >&2; exit 255; }}
TMPDIR={machine} exec {there} sh -c "$3"
"""


@dataclass(frozen=True)
class Home:
    """The folder of the launching machine, with the certificate.

    Attributes:
        folder: of all files.
    """

    folder: Path

    @property
    def session(self) -> tuple[str, ...]:
        """The session as every command here takes it."""
        return (str(EXAMPLE), *SET, "--certificate", str(self.folder / "c.json"), "--clock", "simulated")

    def launch(self, one: Wan, recording: Path) -> tuple[str, ...]:
        """The launch, without what is on which machine."""
        listen = f"{one.address('near')}:{PORT}"
        return (
            *("launch", *self.session, "--listen", listen),
            *("--duration", str(TICKS / 1000), "--record", str(recording)),
        )


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Home:
    folder = tmp_path_factory.mktemp("home")
    run("design", EXAMPLE, *SET, "-o", folder / "c.json")
    return Home(folder)


@contextmanager
def started(
    one: Wan, side: Side, *arguments: str, path: Path | None = None, cwd: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A command in a namespace; ``path`` is searched before PATH. Killed if it has not ended."""
    environment = {**os.environ, "PATH": f"{path}:{os.environ['PATH']}"} if path else None
    with subprocess.Popen(
        [*one.within(side), *MANYHANDS, *arguments],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=cwd,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def end_of(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, err = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in err
    return process.returncode, err


def assert_as_simulated(recording: Path, home: Home) -> None:
    prepared = prepare(load_session(EXAMPLE, list(OVERRIDES)), home.folder / "c.json")
    expected = Simulation(prepared).run(TICKS)
    with np.load(recording) as found:
        assert np.max(np.abs(found["x"])) > 0.0
        assert found["x"].tobytes() == expected.x.tobytes()
        assert found["f_v"].tobytes() == expected.f_v.tobytes()


@dataclass(frozen=True)
class Stand:
    """A stand-in for ssh.

    Attributes:
        path: the folder that has it.
        seen: the file of the arguments with which it was called.
        machine: the folder of temporary files of the other machine.
    """

    path: Path
    seen: Path
    machine: Path


@pytest.fixture
def stand(tmp_path: Path) -> Stand:
    for name in ("path", "machine"):
        (tmp_path / name).mkdir()
    return Stand(tmp_path / "path", tmp_path / "seen", tmp_path / "machine")


def stand_in(stand: Stand, one: Wan) -> None:
    there = " ".join(word for word in one.within("far") if not word.startswith("--user="))  # the launch is in it
    ssh = stand.path / "ssh"
    ssh.write_text(SSH.format(seen=stand.seen, machine=stand.machine, there=there))
    ssh.chmod(0o700)


def on(host: str) -> tuple[str, ...]:
    words = (word for name in FAR for word in ("--on", f"{name}={host}"))
    return (*words, "--program", f"{sys.executable} -P -m manyhands")


@pytest.mark.long
def test_one_command_starts_nodes_on_another_machine(home: Home, stand: Stand, tmp_path: Path) -> None:
    with wan(Wire()) as one:
        stand_in(stand, one)
        with started(one, "near", *home.launch(one, tmp_path / "run.npz"), *on("lab"), path=stand.path) as launched:
            code, err = end_of(launched)
    assert code == EXIT_OK, err
    assert "dx: started on lab by ssh" in err
    assert_as_simulated(tmp_path / "run.npz", home)
    words = stand.seen.read_text()
    assert words.count("\nlab\n") == len(FAR)
    assert "secret" not in words
    assert f"node dx --bundle - --connect tcp://10.9.0.1:{PORT}\n" in words
    assert list(stand.machine.iterdir()) == [], "a bundle or a key is left on the other machine"


@pytest.mark.long
def test_the_same_by_hand(home: Home, tmp_path: Path) -> None:
    """The launch prints what is to be run on the other machine, which has bundles and keys and nothing else."""
    run("invite", EXAMPLE, *SET, "--keys", home.folder / "keys")
    for name in FAR:
        run("invite", *home.session, name, "--keys", home.folder / "keys", "-o", tmp_path / f"{name}.bundle")
        (home.folder / "keys" / "private" / f"{name}.key").rename(tmp_path / f"{name}.key")
    options = ("--transport", "tcp", "--keys", str(home.folder / "keys"), *(w for n in FAR for w in ("--remote", n)))
    with wan(Wire()) as one, started(one, "near", *home.launch(one, tmp_path / "run.npz"), *options) as launched:
        assert launched.stderr is not None
        said = [read_until(launched, f"{name} is awaited") for name in sorted(FAR)]
        with ExitStack() as stack:
            for line in said:
                words = line.partition(": manyhands ")[2].split()
                stack.enter_context(started(one, "far", *words, cwd=tmp_path))
            assert end_of(launched)[0] == EXIT_OK
    assert_as_simulated(tmp_path / "run.npz", home)


def test_a_broken_ssh_is_one_clear_line(home: Home, stand: Stand, tmp_path: Path) -> None:
    with wan(Wire()) as one:
        stand_in(stand, one)
        with started(one, "near", *home.launch(one, tmp_path / "run.npz"), *on("nowhere"), path=stand.path) as launched:
            code, err = end_of(launched)
    assert code == EXIT_FAILED
    faults = [line for line in err.splitlines() if line.startswith("error: ")]
    why = "(ssh: exit code 255: ssh: Could not resolve hostname nowhere: Name or service not known)"
    assert len(faults) == 1, err
    assert faults[0] in [f"error: {name} ended on nowhere {why} while starting" for name in FAR]
