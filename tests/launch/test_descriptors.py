"""Too low a limit of open files is found before anything is made; ZeroMQ would abort in the middle."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

ALONE = Path(__file__).parents[1] / "deterministic/alone.yaml"


def limited(soft: int, hard: int, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a process that may open so many files."""
    return subprocess.run(
        [sys.executable, "-P", *map(str, arguments)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard)),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.long
def test_a_session_that_would_need_more_is_refused(tmp_path: Path) -> None:
    most = 16
    launch = ("-m", "manyhands", "launch", ALONE, "--clock", "simulated", "--duration", "0.1")
    done = limited(most, most, *launch, "--directory", tmp_path / "run")
    assert done.returncode == 2
    assert done.stderr == (
        f"error: found that this process may open {most} files (ulimit -Hn); expected at least 72 for its sockets\n"
    )
    assert not (tmp_path / "run").exists()


def test_a_soft_limit_is_raised_where_the_hard_one_allows_it() -> None:
    ask = "from manyhands.protocol.transport import descriptors as d\nd.require_descriptors(100)\nimport resource\n"
    done = limited(16, 128, "-c", ask + "print(resource.getrlimit(resource.RLIMIT_NOFILE))")
    assert (done.stdout, done.stderr) == ("(128, 128)\n", "")


def test_a_transport_is_refused_before_its_first_socket(tmp_path: Path) -> None:
    ask = "import sys; from pathlib import Path; from manyhands.protocol.transport.zeromq import ZmqTransport\n"
    done = limited(10, 10, "-c", ask + f"ZmqTransport.ipc(Path({str(tmp_path)!r})).bind('a', 'b')")
    assert done.returncode == 1
    assert "TransportError: found that this process may open 10 files (ulimit -Hn)" in done.stderr
