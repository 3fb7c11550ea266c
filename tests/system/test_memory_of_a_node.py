"""A node's process holds nothing of the others: in its bundle, its memory, and the files that it opens.

Every number and name of the session is distinctive. The same search in the supervisor's process, which has them all,
shows that the search finds them.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.plan.bundles import invite
from manyhands.launch.plan.keys import load_folder
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import SIMULATED

from ..support import distinctive_session, party_secrets
from ..support.capture import free_ports
from ..support.commands import MANYHANDS, read_until, run, started
from ..support.opened_files import opened, watched
from ..support.patterns import Patterns
from ..support.process_memory import held, memory_contains

DEVICE, COUPLING, ENVIRONMENT = distinctive_session.DEVICES[0], "cx_heron74", distinctive_session.ENVIRONMENT
NODES = (*distinctive_session.DEVICES, *distinctive_session.COUPLINGS, ENVIRONMENT)
SUPERVISOR = "supervisor"
PEERS = {DEVICE: {COUPLING}, COUPLING: {DEVICE, ENVIRONMENT}, ENVIRONMENT: set(distinctive_session.COUPLINGS)}


@dataclass(frozen=True)
class Owner:
    """Everything that the owner of a session has.

    Attributes:
        folder: the session file, its certificate and its keys.
        session: the session file's content.
        bundles: each node's bundle, by name.
        secrets: the private keys, by owner.
        publics: the public keys, by owner.
    """

    folder: Path
    session: Mapping[str, Any]
    bundles: Mapping[str, Mapping[str, Any]]
    secrets: Mapping[str, str] = field(repr=False)  # a failing test shows its arguments
    publics: Mapping[str, str]

    def forbidden(self, node: str) -> dict[bytes, str]:
        """All data that ``node`` must not hold, in every form."""
        numbers = party_secrets.forbidden_numbers(node, self.session, self.bundles)
        secrets = {f"private key of {who}": key for who, key in self.secrets.items() if who != node}
        strangers = self.publics.keys() - {node, SUPERVISOR, *PEERS[node]}
        publics = {f"public key of {who}": self.publics[who] for who in strangers}
        return {
            **party_secrets.as_numbers(numbers),
            **party_secrets.as_texts(party_secrets.forbidden_texts(node, self.session)),
            **party_secrets.as_keys({**secrets, **publics}),
        }

    def raw(self, *nodes: str) -> dict[bytes, str]:
        """The numbers of these nodes in the session file, as a processor holds them."""
        parts = [self.session["environment"] if n == ENVIRONMENT else self.session["devices"][n] for n in nodes]
        return party_secrets.as_doubles(distinctive_session.number_lists(parts))


@pytest.fixture(scope="module")
def owner(tmp_path_factory: pytest.TempPathFactory) -> Owner:
    folder = tmp_path_factory.mktemp("owner")
    session = distinctive_session.session()
    (folder / "session.yaml").write_text(distinctive_session.as_file(session))
    run("design", folder / "session.yaml", "-o", folder / "certificate.json")
    run("invite", folder / "session.yaml", "--keys", folder / "keys")
    run(
        *("invite", folder / "session.yaml", DEVICE, "--keys", folder / "keys", "--clock", "simulated"),
        *("--certificate", folder / "certificate.json", "-o", folder / f"{DEVICE}.bundle"),
    )
    # the device's private key goes to the other machine, and is no longer where the session is launched
    shutil.copytree(folder / "keys", folder / "keys-here")
    (folder / "keys-here/private" / f"{DEVICE}.key").unlink()
    bundles = bundles_of(folder)
    secrets = {path.stem: json.loads(path.read_text())["secret"] for path in (folder / "keys/private").iterdir()}
    publics = json.loads((folder / "keys/public.json").read_text())["keys"]
    assert secrets.keys() == publics.keys() == {*NODES, SUPERVISOR}
    return Owner(folder, session, bundles, secrets, publics)


def bundles_of(folder: Path) -> dict[str, Mapping[str, Any]]:
    """The device's bundle as it was made for it; the others' as the same command would make them."""
    paths = {node: folder / f"{node}.bundle" for node in NODES}
    session = load_session(folder / "session.yaml")
    prepared, keys = prepare(session, folder / "certificate.json"), load_folder(session, folder / "keys")
    for node in NODES:
        if node != DEVICE:
            invite(prepared, node, keys, SIMULATED, paths[node])
    return {node: json.loads(path.read_text()) for node, path in paths.items()}


@pytest.fixture
def machine(owner: Owner, tmp_path: Path) -> Path:
    """The other machine: the device's bundle and key, and nothing else."""
    folder = tmp_path / "machine"
    folder.mkdir()
    shutil.copy(owner.folder / f"{DEVICE}.bundle", folder)
    shutil.copy(owner.folder / "keys/private" / f"{DEVICE}.key", folder)
    return folder


def launched(owner: Owner, *options: str | Path) -> AbstractContextManager[subprocess.Popen[str]]:
    """``manyhands launch`` under the simulated clock."""
    session, certificate = owner.folder / "session.yaml", owner.folder / "certificate.json"
    return started("launch", session, "--certificate", certificate, "--clock", "simulated", *options)


def remote(owner: Owner, port: int) -> tuple[str | Path, ...]:
    """The options of a session with a remote device."""
    keys = owner.folder / "keys-here"
    return ("--transport", "tcp", "--keys", keys, "--listen", f"127.0.0.1:{port}", "--remote", DEVICE)


def joining(port: int) -> tuple[str, ...]:
    """The command on the other machine, in the folder with the bundle and the key."""
    files = ("--bundle", f"{DEVICE}.bundle", "--key", f"{DEVICE}.key")
    return ("node", DEVICE, *files, "--connect", f"tcp://127.0.0.1:{port}")


def test_a_devices_bundle_has_nothing_of_the_others(owner: Owner) -> None:
    bundle = owner.bundles[DEVICE]
    content = (owner.folder / f"{DEVICE}.bundle").read_bytes()
    numbers = {abs(number) for numbers in distinctive_session.number_lists(bundle) for number in numbers}
    others = {abs(n) for ns in party_secrets.forbidden_numbers(DEVICE, owner.session, owner.bundles) for n in ns}
    assert len(others) > 100
    assert numbers & others == set()
    assert Patterns(owner.forbidden(DEVICE)).found_in([content]) == set()
    keys = party_secrets.as_texts([*owner.publics.values(), *owner.secrets.values()])
    known = {owner.publics[SUPERVISOR], owner.publics[COUPLING]}
    assert known <= Patterns(keys).found_in([content]) <= known | {owner.publics[DEVICE]}


@pytest.mark.long
def test_a_remote_device_never_holds_other_parties_data(owner: Owner, machine: Path) -> None:
    port = free_ports(16)[0]
    others = owner.raw(*distinctive_session.DEVICES[1:], ENVIRONMENT)
    key = party_secrets.as_keys({"the device's private key": owner.secrets[DEVICE]})
    with launched(owner, *remote(owner, port)) as session:
        with started(*joining(port), cwd=machine) as node:
            with held(node.pid) as holding:
                read_until(session, "running: tick")
                holding.hold()
                assert_it_holds_its_own_alone(owner, DEVICE, node.pid)
                holding.resume()  # before the supervisor gives the silent node up
                # the supervisor has what the device has not, and so it would be found; and not the device's key
                assert memory_contains(session.pid, Patterns({**others, **key})) == set(others.values())
                session.send_signal(signal.SIGINT)
                holding.hold_at_end()
                assert memory_contains(node.pid, Patterns(owner.forbidden(DEVICE))) == set()
                code = holding.let_end()
            _, err = node.communicate()
            assert code == 0, err
        _, err = session.communicate()
    assert session.returncode == 130, err
    assert {path.name for path in machine.iterdir()} == {f"{DEVICE}.bundle", f"{DEVICE}.key"}


def test_a_remote_device_opens_only_its_bundle_and_its_key(owner: Owner, machine: Path) -> None:
    port = free_ports(16)[0]
    log = owner.folder / "opened.log"
    command = watched([*MANYHANDS, *joining(port)], log)
    with launched(owner, *remote(owner, port), "--duration", "0.2") as session:
        node = subprocess.run(command, cwd=machine, capture_output=True, text=True, timeout=120)
        _, err = session.communicate()
    assert session.returncode == 0, err
    assert node.returncode == 0, node.stderr
    everything = (owner.folder.parent, Path(os.environ["TMPDIR"]))  # of this session, of its owner, of this test
    ours = {path for path in opened(log) if any(path.is_relative_to(folder) for folder in everything)}
    assert ours == {machine / f"{DEVICE}.bundle", machine / f"{DEVICE}.key"}


@pytest.mark.parametrize("transport", [pytest.param("ipc", marks=pytest.mark.long), "tcp"])
def test_no_process_of_a_session_holds_what_is_the_others(transport: str, owner: Owner) -> None:
    options = ("--keys", owner.folder / "keys") if transport == "tcp" else ()
    with launched(owner, "--transport", transport, *options) as session:
        read_until(session, "running: tick")
        pids = local_nodes(session.pid)
        assert pids.keys() == set(NODES)
        for node in (DEVICE, COUPLING, ENVIRONMENT):
            with held(pids[node]) as holding:
                holding.hold()
                assert_it_holds_its_own_alone(owner, node, pids[node], keyed=transport == "tcp")
        with held(pids[DEVICE]) as holding:
            session.send_signal(signal.SIGINT)
            holding.hold_at_end()
            session.send_signal(signal.SIGSTOP)  # it kills what takes too long to end
            try:
                assert memory_contains(pids[DEVICE], Patterns(owner.forbidden(DEVICE))) == set()
                assert holding.let_end() == 0
            finally:
                session.send_signal(signal.SIGCONT)
        _, err = session.communicate()
    assert session.returncode == 130, err


def assert_it_holds_its_own_alone(owner: Owner, node: str, pid: int, keyed: bool = True) -> None:
    """A process that is held has nothing of the others, and the same search finds its own numbers and its key."""
    forbidden = owner.forbidden(node)
    numbers = party_secrets.as_doubles(party_secrets.own_numbers(node, owner.session, owner.bundles[node]))
    key = party_secrets.as_keys({f"private key of {node}": owner.secrets[node]}) if keyed else {}
    found = memory_contains(pid, Patterns({**forbidden, **numbers, **key}))
    assert found & set(forbidden.values()) == set(), f"{node} holds this"
    assert len(found & set(numbers.values())) >= {DEVICE: 12, COUPLING: 4, ENVIRONMENT: 12}[node]
    assert set(key.values()) <= found


def local_nodes(supervisor: int) -> dict[str, int]:
    """Process ids of the nodes that a supervisor has started, by the name of the bundle that each was given."""
    children = Path(f"/proc/{supervisor}/task/{supervisor}/children").read_text().split()
    out: dict[str, int] = {}
    for pid in children:
        arguments = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        out |= {Path(argument).stem: int(pid) for argument in arguments if argument.endswith(".bundle")}
    return out
