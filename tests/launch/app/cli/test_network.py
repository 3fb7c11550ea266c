"""The commands for keys and guests: their refusals, messages, and files."""

from __future__ import annotations

import json
import re
import socket
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from typer.testing import Result

from manyhands.launch.plan.keys import make_keys
from manyhands.launch.session import load_session
from manyhands.nodes.kernel import bundle as bundle_files
from manyhands.nodes.kernel.bundle import CouplingBundle, DeviceBundle, ObserverBundle
from manyhands.protocol.messages import Role

from ....support.commands import manyhands_command

SESSIONS = Path(__file__).parents[4] / "launch" / "sessions"
WATCH = "observers={watch: {reads: [telemetry]}}"

pytestmark = pytest.mark.usefixtures("own_interrupt")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session's keys and certificate."""
    made = tmp_path_factory.mktemp("network")
    make_keys(load_session(SESSIONS / "example1.yaml", [WATCH]), made / "keys")
    done = manyhands_command("design", "example1.yaml", "-o", made / "c.json")
    assert done.exit_code == 0, done.stderr
    return made


def invited(folder: Path, node: str, *more: object) -> Result:
    return manyhands_command(
        "invite", "example1.yaml", node, "--set", WATCH, "--keys", folder / "keys",
        "--certificate", folder / "c.json", "-o", folder / f"{node}.bundle", *more,
    )  # fmt: skip


@pytest.mark.parametrize("command", ["graph", "invite", "node", "launch"])
def test_help_ends_with_an_example(command: str) -> None:
    done = manyhands_command(command, "--help")
    assert done.exit_code == 0
    lines = " ".join(done.stdout.split())
    assert re.search(rf"Example: manyhands {command} \S+", lines)


def test_an_invitation_is_one_nodes_part_and_its_owners_alone(folder: Path) -> None:
    done = invited(folder, "dx")
    assert done.exit_code == 0, done.stderr
    path = folder / "dx.bundle"
    assert f"{path}: the bundle of dx, under the certificate " in done.stderr
    assert "on its machine: manyhands node dx --bundle dx.bundle --key dx.key --connect tcp://HOST:PORT" in done.stderr
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    bundle = bundle_files.load(path, DeviceBundle)
    assert bundle.common.role is Role.DEVICE
    assert bundle.common.public.keys() == {"dx", "cx", "supervisor"}
    assert (bundle.common.private, bundle.common.directory, bundle.common.control) == ("", "", "")


def test_a_second_invitation_takes_the_place_of_the_first(folder: Path) -> None:
    for clock in ("simulated", "realtime"):
        assert invited(folder, "cy", "--clock", clock).exit_code == 0
        assert bundle_files.load(folder / "cy.bundle", CouplingBundle).common.clock == clock


def test_an_observers_invitation_holds_nothing_of_the_session(folder: Path) -> None:
    assert invited(folder, "watch").exit_code == 0
    data = json.loads((folder / "watch.bundle").read_text())
    assert data.keys() == {"common"}
    common = bundle_files.load(folder / "watch.bundle", ObserverBundle).common
    assert (common.role, common.ports, common.peers) == (Role.OBSERVER, (), ())
    assert common.public.keys() == {"watch", "supervisor"}


def test_invitations_that_cannot_be(folder: Path) -> None:
    stranger = invited(folder, "dw")
    assert (stranger.exit_code, stranger.stdout) == (2, "")
    assert "found no node or observer 'dw'; expected one of dx, dy, dz" in stranger.stderr
    base = ("invite", "example1.yaml", "dx", "-o", folder / "x.bundle")
    for arguments, found in (
        (("--certificate", folder / "c.json"), "give either --keys DIR"),
        (("--certificate", folder / "c.json", "--keys", folder / "keys", "--insecure"), "give either --keys DIR"),
        (("--keys", folder / "keys"), "give --certificate FILE"),
        (("--insecure", "--certificate", folder / "c.json", "--clock", "sundial"), "--clock: found 'sundial'"),
    ):
        done = manyhands_command(*base, *arguments)
        assert done.exit_code == 2, done.stderr
        assert found in done.stderr
        assert done.stderr.count("\n") == 1
        assert not (folder / "x.bundle").exists()


def test_several_bundles_come_from_one_call_which_makes_the_keys_that_are_absent(folder: Path, tmp_path: Path) -> None:
    arguments = ("invite", "example1.yaml", "dx", "cx", "--keys", tmp_path / "keys", "--certificate", folder / "c.json")
    refused = manyhands_command(*arguments, "-o", tmp_path / "none")
    assert refused.exit_code == 2
    assert "expected a folder that exists, for 2 bundles" in refused.stderr
    twice = manyhands_command(*arguments, "cx", "-o", tmp_path)
    assert (twice.exit_code, twice.stderr.count("twice")) == (2, 1)
    assert list(tmp_path.iterdir()) == []
    done = manyhands_command(*arguments, "-o", tmp_path)
    assert done.exit_code == 0, done.stderr
    assert done.stderr.count("on its machine: manyhands node ") == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cx.bundle", "dx.bundle", "keys"]
    first = (tmp_path / "dx.bundle").read_bytes()
    assert manyhands_command(*arguments, "-o", tmp_path).exit_code == 0
    assert (tmp_path / "dx.bundle").read_bytes() == first, "keys that exist are kept"
    assert manyhands_command(*arguments, "-o", tmp_path, "--renew", "dx").exit_code == 0
    assert (tmp_path / "dx.bundle").read_bytes() != first


def test_the_keys_alone(tmp_path: Path) -> None:
    done = manyhands_command("invite", "example1.yaml", "--keys", tmp_path / "keys", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["keys"]["dx"]["key"] == "new"
    for more, found in (
        (("-o", tmp_path / "x"), "-o needs a NODE"),
        (("--certificate", tmp_path / "x"), "--certificate needs a NODE"),
        (("--insecure",), "give either --keys DIR"),
    ):
        refused = manyhands_command("invite", "example1.yaml", "--keys", tmp_path / "keys", *more)
        assert (refused.exit_code, found in refused.stderr) == (2, True), refused.stderr
    assert manyhands_command("invite", "example1.yaml", "--insecure").exit_code == 2


def test_an_invitation_needs_a_folder_that_exists(folder: Path) -> None:
    done = manyhands_command(
        "invite", "example1.yaml", "dx", "--insecure", "--certificate", folder / "c.json", "-o", folder / "no" / "x"
    )
    assert done.exit_code == 2
    assert "found no folder" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("--listen", "127.0.0.1:7400"), "--transport: found ipc; expected tcp"),
        (("--insecure",), "--transport: found ipc; expected tcp"),
        (("--transport", "tcp", "--listen", "0.0.0.0:7400"), "found 0.0.0.0; expected the one address"),
        (("--transport", "tcp", "--remote", "dx"), "--remote needs --listen"),
        (("--on", "dx=-x", "--listen", "127.0.0.1:7400"), "--on: found 'dx=-x'; expected NODE=HOST"),
        (("--on", "dw=lab", "--listen", "127.0.0.1:7400"), "--on: found 'dw'; expected one of"),
        (("--on", "dx=lab", "--on", "dx=lab"), "--on: found dx twice"),
        (("--on", "dx=lab"), "--on needs --listen"),
        (("--on", "dx=lab", "--transport", "ipc", "--listen", "127.0.0.1:7400"), "--on: found --transport ipc"),
        (("--transport", "tcp", "--remote", "dx", "--listen", "127.0.0.1:7400"), "--remote needs --keys"),
        (("--transport", "udp"), "--transport: found 'udp'; expected ipc or tcp"),
    ],
)
def test_launches_that_cannot_be(arguments: tuple[str, ...], found: str) -> None:
    done = manyhands_command("launch", "example1.yaml", "--duration", "1", *arguments)
    assert done.exit_code == 2
    assert found in done.stderr
    assert (done.stderr.count("\n"), done.stdout) == (1, "")


def test_keys_of_another_session_are_refused(folder: Path) -> None:
    done = manyhands_command("launch", "example2.yaml", "--transport", "tcp", "--keys", folder / "keys")
    assert done.exit_code == 2
    assert "found the keys of session 'example-1'; expected those of 'example-2'" in done.stderr


def test_plain_tcp_is_announced(folder: Path) -> None:
    done = manyhands_command(
        "launch", "example1.yaml", "--certificate", folder / "c.json", "--duration", "0.01", "--clock", "simulated",
        "--transport", "tcp", "--insecure",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert "warning: --insecure: nothing is encrypted and nobody proves who they are" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("dy", "--bundle", "{}/dx.bundle", "--connect", "tcp://127.0.0.1:1"), "found the bundle of dx; expected"),
        (("dx", "--bundle", "{}/none.bundle", "--connect", "tcp://127.0.0.1:1"), "none.bundle"),
        (("dx", "--bundle", "{}/c.json", "--connect", "tcp://127.0.0.1:1"), "c.json: not a bundle"),
        (("dx", "--bundle", "{}/dx.bundle", "--connect", "localhost"), "--connect: found 'localhost'; expected tcp://HOST:PORT"),
        (("dx", "--bundle", "{}/dx.bundle", "--connect", "ipc:///x"), "for this bundle has keys"),
        (("dx", "--bundle", "{}/dx.bundle", "--connect", "tcp://127.0.0.1:1"), "dx.key"),
        (
            ("dx", "--bundle", "{}/dx.bundle", "--key", "{}/keys/private/dy.key", "--connect", "tcp://127.0.0.1:1"),
            "dy.key",
        ),
    ],
)  # fmt: skip
def test_nodes_that_cannot_join(arguments: tuple[str, ...], found: str, folder: Path) -> None:
    """In a process of its own, for a node takes over the signals."""
    invited(folder, "dx")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "manyhands", "node", *(a.format(folder) for a in arguments)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert found in done.stderr
    assert (done.stderr.count("\n"), done.stdout) == (1, "")


def test_an_address_in_use_or_of_another_machine_is_reported(folder: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        for address, found in (
            (f"127.0.0.1:{port}", "Address already in use"),
            ("203.0.113.9:7400", "Cannot assign requested address"),  # of a network for examples
        ):
            done = manyhands_command(
                "launch", "example1.yaml", "--set", WATCH, "--certificate", folder / "c.json", "--duration", "1",
                "--transport", "tcp", "--listen", address,
            )  # fmt: skip
            assert done.exit_code == 2, done.stderr
            assert f"error: cannot bind tcp://{address}: {found}" in done.stderr
            assert "Traceback" not in done.stderr


HOST = ("--listen", "127.0.0.1:7400", "-o", "{}", "--duration", "0.1")


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (("example1", *HOST), "example-1: found no wave link; expected a coupling with a wave_link"),
        (("ball", *HOST, "--set", "colocate=false"), "ball: found colocate: false with the seat 'left_seat'"),
        (("ball", "--listen", "ball.example.org:7400", "-o", "{}"), "--listen: found the host 'ball.example.org'"),
        (("ball", "--listen", "0.0.0.0:7400", "-o", "{}"), "--listen: found 0.0.0.0; expected the one address"),
        (("ball", *HOST, "--address", "ball.example.org:x"), "--address: found 'ball.example.org:x:7400'"),
        (("ball", *HOST, "--address", "my ball:7400"), "--address: found 'my ball:7400'; expected HOST"),
        (("ball", *HOST, "--record", "run.npz"), "run.npz"),
        (("ball", *HOST, "--duration", "-1"), "--duration: found -1 s"),
        (("ball", *HOST, "-o", "{}/none/here"), "found no folder"),
        (
            ("ball", *HOST, "--set", "design.tau=auto", "--set", "couplings.left_seat.wave_link={{b: 10}}"),
            "found design.tau: auto, which measures this machine alone, with the seat 'left_seat'; "
            "expected couplings.left_seat.wave_link.tau",
        ),
    ],
)
def test_sessions_that_cannot_be_hosted(arguments: tuple[str, ...], found: str, tmp_path: Path) -> None:
    done = manyhands_command("host", *(argument.format(tmp_path) for argument in arguments))
    assert done.exit_code == 2, done.stderr
    assert found in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_nobody_is_invited_to_a_port_that_is_taken(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = f"127.0.0.1:{other.getsockname()[1]}"
        hosted = ("host", "ball", "--listen", taken, "-o", tmp_path / "ball", "--duration", "0.1")
        done = manyhands_command(*hosted, "--set", "design.tau=0.0005")
    assert done.exit_code == 2, done.stderr
    assert f"--listen: found {taken}, which cannot be bound (Address already in use)" in done.stderr
    assert "waiting for" not in done.stderr
    assert not list((tmp_path / "ball").glob("*.invitation"))


@pytest.mark.parametrize("free", [True, False])
def test_a_taken_port_of_datagrams_is_told_with_what_it_costs(free: bool, tmp_path: Path) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        for port in range(28111, 28911, 4):  # one whose TCP ports nobody has
            with suppress(OSError):
                other.bind(("127.0.0.1", port + 1 + 2 * free))
                break
        hosted = ("host", "ball", "--listen", f"127.0.0.1:{port}", "-o", tmp_path / "ball", "--duration", "0.1")
        done = manyhands_command(*hosted, "--set", "design.tau=0.0005")
    said = f"! the UDP port {port + 1} cannot be bound (Address already in use): the waves of guests go by TCP"
    assert "waiting for left_seat" in done.stderr
    assert (said in done.stderr) is not free, done.stderr


@pytest.mark.parametrize("content", [None, "", "{}", "manyhands://192.0.2.7:7400/ball/right_seat/right"])
def test_an_invitation_that_is_none_is_one_clear_error(content: str | None, tmp_path: Path) -> None:
    path = tmp_path / "right_seat.invitation"
    if content is not None:
        path.touch(mode=0o600)
        path.write_text(content)
    done = manyhands_command("join", path)
    assert (done.exit_code, done.stdout) == (2, "")
