"""Errors of a guest before its first connection: one line each, with the cause and without any secret."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.plan.bundles import invite
from manyhands.launch.plan.keys import Keys, ephemeral
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.topology import roster
from manyhands.launch.session import load_session
from manyhands.nodes.guest import remote
from manyhands.nodes.kernel.bundle import Bundle, BundleError, load
from manyhands.nodes.link.process import EXIT_BAD_INPUT
from manyhands.protocol.keys import save_private

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
ADDRESS = "tcp://127.0.0.1:7400"
NAMES = ("dx", "cx", "environment", "watch")


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", ["observers={watch: {reads: [telemetry]}}"]))


@pytest.fixture(scope="module")
def keys(prepared: Prepared) -> Keys:
    return ephemeral(roster(prepared.session), prepared.session.name)


@pytest.fixture(scope="module")
def invitations(prepared: Prepared, keys: Keys, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("invitations")
    for name in NAMES:
        invite(prepared, name, keys, "simulated", folder / f"{name}.bundle")
        save_private(keys.pair(name), prepared.session.name, name, folder / f"{name}.key")
    return folder


@pytest.fixture
def machine(invitations: Path, tmp_path: Path) -> Path:
    shutil.copytree(invitations, tmp_path / "machine")
    return tmp_path / "machine"


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """A guest takes over the signals that end it, as befits a process of its own."""
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    before = {which: signal.getsignal(which) for which in ends}
    yield
    for which, handler in before.items():
        signal.signal(which, handler)


def refusal(
    machine: Path,
    capsys: pytest.CaptureFixture[str],
    keys: Keys,
    name: str = "dx",
    bundle: str = "dx.bundle",
    key: str | None = None,
    address: str = ADDRESS,
) -> str:
    """The message of a guest that does not start."""
    code = remote.join(name, machine / bundle, None if key is None else machine / key, address, None)
    out, err = capsys.readouterr()
    assert code == EXIT_BAD_INPUT
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert len(err) < 1000
    assert not any(keys.pair(known).secret in err for known in NAMES)
    return err


@pytest.mark.parametrize(
    "address",
    ["", "127.0.0.1:7400", "tcp://", "tcp://nowhere", "tcp://:7400", "tcp://127.0.0.1:0", "tcp://127.0.0.1:65536",
     "tcp://127.0.0.1:0x1", "tcp://127.0.0.1:７４００", "udp://127.0.0.1:7400", "tcp://" + "h" * 1000],
)  # fmt: skip
def test_an_address_that_is_none(address: str, machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys) -> None:
    said = refusal(machine, capsys, keys, address=address)
    assert "--connect: found " in said
    assert "expected tcp://HOST:PORT" in said


def test_an_address_that_only_zeromq_finds_wanting(
    machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys
) -> None:
    for name in ("dx", "watch"):
        said = refusal(machine, capsys, keys, name, f"{name}.bundle", address="tcp://no host:7400")
        assert f"{name}: cannot connect to 'tcp://no host:7400'" in said


def test_keys_are_for_tcp(machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys) -> None:
    assert "for this bundle has keys" in refusal(machine, capsys, keys, address="ipc:///tmp/s/control")


def test_somebody_elses_bundle(machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys) -> None:
    said = refusal(machine, capsys, keys, name="dy")
    assert "dx.bundle: found the bundle of dx; expected that of dy" in said


def test_keys_that_are_missing_or_anothers(
    machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys, prepared: Prepared
) -> None:
    assert "cx.key: found the key of another process; expected that of 'dx'" in refusal(
        machine, capsys, keys, key="cx.key"
    )
    assert "none.key: found no file" in refusal(machine, capsys, keys, key="none.key")
    save_private(keys.pair("dx"), "another session", "dx", machine / "other.key")
    assert "found a key of another session" in refusal(machine, capsys, keys, key="other.key")
    new = ephemeral(["dx"], prepared.session.name)
    save_private(new.pair("dx"), prepared.session.name, "dx", machine / "new.key")
    said = refusal(machine, capsys, keys, key="new.key")
    assert "new.key: found a key that is not the one in the bundle of dx" in said
    assert new.pair("dx").secret not in said


def test_a_key_that_others_can_read(machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys) -> None:
    (machine / "dx.key").chmod(0o640)
    assert "found mode 0640, which lets others in; expected 0600" in refusal(machine, capsys, keys)


@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b"[]", b"3", b"null", b'{"common": {}}', b"[" * 100_000, b"\xff" * 1000, b'{"common": 1e999}'],
    ids=lambda content: repr(content[:12]),
)
def test_a_file_that_is_no_bundle(
    content: bytes, machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys
) -> None:
    (machine / "dx.bundle").write_bytes(content)
    assert "dx.bundle: not a bundle" in refusal(machine, capsys, keys)


def test_a_key_given_in_place_of_a_bundle_is_not_quoted(
    machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys
) -> None:
    assert "dx.key: not a bundle" in refusal(machine, capsys, keys, bundle="dx.key")


def test_no_bundle_at_all(machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys) -> None:
    assert "none.bundle: cannot be read: No such file" in refusal(machine, capsys, keys, bundle="none.bundle")
    assert "machine: cannot be read: Is a folder" in refusal(machine, capsys, keys, bundle="")


def places(data: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where something stands in a bundle; of long lists the first two."""
    if at:
        yield at
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*at, key))
    elif isinstance(data, list):
        for index, value in enumerate(data[:2]):
            yield from places(value, (*at, index))


def replaced(text: str, at: tuple[Any, ...], value: Any) -> str:
    data = json.loads(text)
    inner = data
    for key in at[:-1]:
        inner = inner[key]
    inner[at[-1]] = value
    return json.dumps(data)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_whatever_stands_in_a_bundle_it_is_read_or_refused(name: str, machine: Path) -> None:
    """Every value replaced by one of every other kind: BundleError or a node, and nothing else on the way to either."""
    path = machine / f"{name}.bundle"
    text = path.read_text()
    kind, make = remote.MAKERS.get(load_role(path), (remote.ObserverBundle, None))
    refused = 0
    for at in places(json.loads(text)):
        for value in (None, True, -1, 10**400, 0.5, float("inf"), "x", [], [None], {}, {"a": 1}):
            path.write_text(replaced(text, at, value))
            try:
                bundle: Bundle = load(path, kind)
                remote._placed(bundle.common, bundle.common.name, path, ADDRESS, None)
                if make is not None:
                    make(bundle)
            except (BundleError, ValueError, OverflowError):  # as join catches them
                refused += 1
    assert refused > 100


def load_role(path: Path) -> Any:
    return remote.role_of(path)


def test_a_guest_knows_only_its_peers_names_and_public_keys(machine: Path, keys: Keys) -> None:
    text = (machine / "dx.bundle").read_text()
    held = {name for name, key in keys.public.keys.items() if key in text}
    assert held == {"dx", "cx", "supervisor"}
    assert not any(keys.pair(name).secret in text for name in keys.public.keys)
    assert not any(f'"{other}"' in text for other in ("dy", "cy", "environment", "watch"))


def test_a_bundle_does_not_choose_where_its_guest_writes(
    machine: Path, capsys: pytest.CaptureFixture[str], keys: Keys, tmp_path: Path
) -> None:
    victim = tmp_path / "victim"
    (victim / "log").mkdir(parents=True)
    data = json.loads((machine / "dx.bundle").read_text())
    data["common"]["directory"] = str(victim)
    (machine / "dx.bundle").write_text(json.dumps(data))
    assert "cannot connect" in refusal(machine, capsys, keys, address="tcp://no host:7400")
    assert [path.name for path in victim.rglob("*")] == ["log"]
