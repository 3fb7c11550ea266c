"""``make ssh``: nodes that `launch --on` starts through a real sshd, on this machine.

    python -m tests.deployed.ssh

The sshd has a configuration, a high port of the loopback and throw-away keys of its own, and is ended with the program.
ssh reads a configuration of its own as well, so that neither the user's keys nor known hosts are used or changed.
"""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.deployed.checks import Checks, done, must, require_programs, stopped_at_the_end
from tests.support.capture import free_ports
from tests.support.commands import MANYHANDS
from tests.system.test_machines import EXAMPLE, FAR, SET, TICKS, Home, assert_as_simulated

_PROGRAM: Final = f"{sys.executable} -P -m manyhands"
_PRIVILEGES: Final = Path("/run/sshd")  # where a sshd of root's goes to have none
_PATIENCE: Final = 60.0  # s

_SSHD: Final = """\
ListenAddress 127.0.0.1
Port {port}
HostKey {folder}/host
PidFile none
AuthorizedKeysFile {folder}/authorized
AllowUsers {user}
PermitRootLogin prohibit-password
PasswordAuthentication no
KbdInteractiveAuthentication no
UsePAM no
# the keys are below /tmp, where everybody may make files
StrictModes no
SetEnv TMPDIR={folder}/there MANYHANDS_TRIED_BY={mark}
"""

_HOST: Final = """\
Host {name}
    HostName 127.0.0.1
    HostKeyAlias {name}
    Port {port}
    User {user}
    IdentityFile {folder}/{key}
    IdentitiesOnly yes
    IdentityAgent none
    UserKnownHostsFile {folder}/known
    GlobalKnownHostsFile /dev/null
    StrictHostKeyChecking yes
"""


@dataclass(frozen=True)
class Lab:
    """A sshd that runs, and who may reach it.

    Attributes:
        folder: of its keys and configurations, and of the program ``ssh`` that reads these.
        process: the one that listens.
    """

    folder: Path
    process: subprocess.Popen[str]

    @property
    def machine(self) -> Path:
        """The folder of temporary files of the nodes that are started by it."""
        return self.folder / "there"

    @property
    def environment(self) -> dict[str, str]:
        """In which ``ssh`` is the one with the configuration of this folder."""
        return {**os.environ, "PATH": f"{self.folder / 'path'}{os.pathsep}{os.environ['PATH']}"}

    def cut(self) -> int:
        """Kill the processes of every connection; returns how many there were."""
        own = [pid for pid in _descendants(self.process.pid) if _name(pid).startswith("sshd")]
        for pid in own:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return len(own)


def _descendants(pid: int) -> list[int]:
    own = [int(word) for tasks in Path(f"/proc/{pid}/task").glob("*/children") for word in tasks.read_text().split()]
    return own + [further for child in own for further in _descendants(child)]


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text()
    except FileNotFoundError:
        return ""


@contextmanager
def lab(folder: Path) -> Iterator[Lab]:
    """A sshd, while it is entered, with these hosts for ssh: ``lab``; ``stranger``, whose user's key is unknown there;
    ``impostor``, of which ssh knows another key; and ``nobody``, where no sshd listens.
    """
    port, closed = free_ports(2)
    user, sshd = getpass.getuser(), shutil.which("sshd")
    for key in ("host", "other-host", "user", "other-user"):
        must(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / key])
    for name in ("there", "path"):
        (folder / name).mkdir()
    shutil.copy(folder / "user.pub", folder / "authorized")
    host, other = (" ".join((folder / f"{key}.pub").read_text().split()[:2]) for key in ("host", "other-host"))
    (folder / "known").write_text(
        "".join(f"{name} {key}\n" for name, key in (("lab", host), ("stranger", host), ("impostor", other)))
    )
    hosts = {
        "lab": ("user", port),
        "stranger": ("other-user", port),
        "impostor": ("user", port),
        "nobody": ("user", closed),
    }
    (folder / "ssh_config").write_text(
        "".join(_HOST.format(name=n, port=at, user=user, folder=folder, key=key) for n, (key, at) in hosts.items())
    )
    ssh = folder / "path" / "ssh"
    ssh.write_text(f'#!/bin/sh\nexec {shutil.which("ssh")} -F {folder}/ssh_config "$@"\n')
    ssh.chmod(0o700)
    config = folder / "sshd_config"
    config.write_text(_SSHD.format(port=port, folder=folder, user=user, mark=os.getpid()))
    made = os.geteuid() == 0 and not _PRIVILEGES.exists()
    if made:
        _PRIVILEGES.mkdir(mode=0o755)
    try:
        with stopped_at_the_end([sshd or "sshd", "-D", "-e", "-f", config], stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            end = time.monotonic() + _PATIENCE
            line = ""
            while "Server listening" not in line:
                if not select.select([process.stderr], [], [], max(end - time.monotonic(), 0.0))[0]:
                    raise SystemExit("error: sshd does not listen")
                line = process.stderr.readline()
                if not line:
                    raise SystemExit(f"error: sshd ended with {process.wait()}")
            yield Lab(folder, process)
    finally:
        if made:
            _PRIVILEGES.rmdir()


def main() -> int:
    """Launch through sshd in each way; returns the exit code."""
    require_programs({"sshd": "openssh-server", "ssh": "openssh-client"})
    checks = Checks()
    with tempfile.TemporaryDirectory(prefix="mh-ssh-") as name:
        with lab(Path(name)) as one:
            _in_simulated_time(checks, one)
            _in_real_time(checks, one)
            for host, words in (
                ("stranger", "Permission denied"),
                ("impostor", "Host key verification failed"),
                ("nobody", "Connection refused"),
            ):
                _refused(checks, one, host, words)
            _cut(checks, one)
            left = [path.name for path in one.machine.iterdir()]
            checks.that("no bundle, key or socket is left on the other machine", not left, ", ".join(left))
    return checks.end()


def _on(host: str) -> list[str]:
    listen = f"127.0.0.1:{free_ports(8)[0]}"
    return [*(word for node in FAR for word in ("--on", f"{node}={host}")), "--listen", listen, "--program", _PROGRAM]


def _in_simulated_time(checks: Checks, one: Lab) -> None:
    home = Home(one.folder)
    must([*MANYHANDS, "design", EXAMPLE, *SET, "-o", one.folder / "c.json"])
    began = time.monotonic()
    recording = one.folder / "run.npz"
    found = done(
        [*MANYHANDS, "launch", *home.session, *_on("lab"), "--duration", str(TICKS / 1000), "--record", recording],
        within=_PATIENCE,
        env=one.environment,
    )
    took = time.monotonic() - began
    checks.that(
        "launch --on lab ends with 0", found.returncode == 0, found.stderr if found.returncode else f"{took:.1f} s"
    )
    checks.that("it says who is started where", all(f"{node}: started on lab by ssh" in found.stderr for node in FAR))
    try:
        assert_as_simulated(recording, home)
        same = True
    except (AssertionError, OSError, ValueError):
        same = False
    checks.that("its recording is that of the session in one process, to the last bit", same)


def _in_real_time(checks: Checks, one: Lab) -> None:
    report = one.folder / "report.json"
    session = ["launch", EXAMPLE, *SET, "--certificate", one.folder / "c.json"]
    found = done(
        [*MANYHANDS, *session, *_on("lab"), "--duration", "3", "--report", report],
        within=_PATIENCE,
        env=one.environment,
    )
    nodes = json.loads(report.read_text())["nodes"] if report.exists() else {}
    ticks = nodes.get("dx", {}).get("ticks", 0)
    late = f"{ticks} ticks, delay p99 {nodes['dx']['tau_us']['p99']:.0f} us" if "tau_us" in nodes.get("dx", {}) else ""
    checks.that(
        "3 s in real time, the device's process started by sshd",
        found.returncode == 0 and ticks >= 2900,
        late or found.stderr,
    )


def _refused(checks: Checks, one: Lab, host: str, words: str) -> None:
    began = time.monotonic()
    command = [*MANYHANDS, "launch", *Home(one.folder).session, *_on(host), "--duration", "1"]
    found = done(command, within=_PATIENCE, env=one.environment)
    faults = [line for line in found.stderr.splitlines() if re.match(r"error: \w+ (?!wrote:)", line)]  # but for its log
    right = (
        found.returncode == 1
        and len(faults) == 1
        and f"ended on {host} (ssh: exit code 255: " in faults[0]
        and words in faults[0]
    )
    took = f"{' | '.join(faults) or found.stderr} (exit code {found.returncode}, {time.monotonic() - began:.1f} s)"
    checks.that(f"{host} is one error, with ssh's reason", right and "Traceback" not in found.stderr, took)


def _cut(checks: Checks, one: Lab) -> None:
    """The connection ends while the session runs."""
    command = [*MANYHANDS, "launch", EXAMPLE, *SET, "--certificate", one.folder / "c.json", *_on("lab")]
    with stopped_at_the_end(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL, env=one.environment
    ) as process:
        said: list[str] = []
        running = _until(process, said, ": running") and _until(process, said, "running: tick")
        cut = one.cut()
        lost = running and _until(process, said, "on lab")
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            said.append("it did not end on Ctrl-C")
        checks.that(
            "a connection that is cut is said, and the others go on until Ctrl-C",
            bool(cut and lost and process.returncode == 130),
            said[-1] if lost else f"exit code {process.returncode}, {cut} processes cut, {[*said[:12], *said[-3:]]}",
        )


def _until(process: subprocess.Popen[str], said: list[str], words: str) -> bool:
    assert process.stderr is not None
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        line = process.stderr.readline()
        if not line:
            return False
        said.append(line.strip())
        if words in line:
            return True
    return False


if __name__ == "__main__":
    raise SystemExit(main())
