"""A folder of keys: made once, kept from then on, closed to others, and never half-written."""

from __future__ import annotations

import fcntl
import io
import json
import os
import stat
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from manyhands.launch.app.keys import run_keys
from manyhands.launch.plan.keys import Keys, Made, ephemeral, load_folder, make_keys
from manyhands.launch.plan.topology import roster, topology
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from manyhands.protocol.keys import KeyFileError, KeyPair, PublicKeys, load_private, new_pair, save_private
from manyhands.protocol.messages import Role


def session_of(devices: Sequence[str], observers: Sequence[str] = (), name: str = "s") -> Session:
    """A session with these devices, a coupling each (``dx``: ``cdx``)."""
    return Session.model_validate(
        {
            "session": name,
            "period": 0.001,
            "devices": {d: {"dof": 1, "osp": 1.0, "driver": "simulated", "mass": 0.2} for d in devices},
            "couplings": {f"c{d}": {"devices": [d]} for d in devices},
            "environment": {
                "type": "network",
                "masses": {},
                "links": [{"between": [d, "ground"], "stiffness": 100.0, "damping": 0.1} for d in devices],
            },
            "design": {"coupling": "spring-damper"},
            "observers": {o: {"reads": ["telemetry"]} for o in observers},
        },
        context={"folder": Path()},
    )


ONE = session_of(["dx"], observers=["watch"])
TWO = session_of(["dx", "dy"], observers=["watch"])
NAMES = ("dx", "cdx", "environment", "supervisor", "watch")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "keys"


@pytest.fixture
def umask() -> Iterator[Callable[[int], int]]:
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


def key(folder: Path, name: str) -> Path:
    return folder / "private" / f"{name}.key"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def refusal(session: Session, folder: Path, renew: Sequence[str] = ()) -> str:
    """The sentence with which a run is refused; it leaves everything as it was."""
    before = contents(folder)
    with pytest.raises(KeyFileError) as caught:
        make_keys(session, folder, renew)
    assert contents(folder) == before
    text = str(caught.value)
    assert "\n" not in text
    assert "; expected " in text
    return text


# --- what is made


def test_everybody_gets_a_key() -> None:
    for name in ("example1", "example1-centralised", "example2"):
        shipped = load_named(name)
        assert set(roster(shipped)) == {*topology(shipped).nodes, "supervisor"}
    roles = roster(ONE)
    assert tuple(roles) == NAMES
    assert (roles["dx"], roles["supervisor"], roles["watch"]) == (Role.DEVICE, Role.SUPERVISOR, Role.OBSERVER)


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077])
def test_a_new_folder(folder: Path, umask: Callable[[int], int], mask: int) -> None:
    umask(mask)
    made = make_keys(ONE, folder / "of" / "s")
    folder = folder / "of" / "s"
    assert made == Made(new=NAMES, kept=(), renewed=(), elsewhere=(), stale=())
    assert set(contents(folder)) == {"public.json", *(f"private/{name}.key" for name in NAMES)}
    assert mode(folder) == 0o755 & ~mask
    assert mode(folder / "private") == 0o700
    assert mode(folder / "public.json") == 0o644
    public = PublicKeys.load(folder / "public.json")
    assert public.session == "s"
    for name in NAMES:
        assert mode(key(folder, name)) == 0o600
        assert load_private(key(folder, name), "s", name).public == public.keys[name]
    assert len(set(public.keys.values())) == len(NAMES)


def test_the_public_file_holds_no_secret(folder: Path) -> None:
    make_keys(ONE, folder)
    text = (folder / "public.json").read_text()
    for name in NAMES:
        pair = load_private(key(folder, name), "s", name)
        assert json.dumps(pair.public) in text
        assert json.dumps(pair.secret) not in text


def test_again_keeps_every_key(folder: Path) -> None:
    make_keys(ONE, folder)
    before = contents(folder)
    assert make_keys(ONE, folder) == Made(new=(), kept=NAMES, renewed=(), elsewhere=(), stale=())
    assert contents(folder) == before


def test_a_node_more_gets_a_key_and_nobody_else(folder: Path) -> None:
    make_keys(ONE, folder)
    before = contents(folder)
    made = make_keys(TWO, folder)
    assert made.new == ("dy", "cdy")
    assert set(made.kept) == set(NAMES)
    after = contents(folder)
    assert {file: after[file] for file in before if file != "public.json"} == {
        file: content for file, content in before.items() if file != "public.json"
    }
    old, new = (json.loads(c["public.json"])["keys"] for c in (before, after))
    assert {name: new[name] for name in old} == old


def test_a_removed_node_is_reported_and_left(folder: Path) -> None:
    make_keys(TWO, folder)
    before = contents(folder)
    (folder / "private" / "notes.txt").write_text("not a key")
    save_private(new_pair(), "s", "old", key(folder, "old"))  # was never in the public keys
    made = make_keys(ONE, folder)
    assert made.stale == ("cdy", "dy", "old")
    assert made.kept == NAMES
    assert contents(folder).items() >= before.items()
    assert make_keys(TWO, folder).kept == tuple(roster(TWO))  # and it is itself again when it comes back


def test_renewing_replaces_one(folder: Path) -> None:
    make_keys(ONE, folder)
    before, known = contents(folder), PublicKeys.load(folder / "public.json").keys
    made = make_keys(ONE, folder, ["dx", "dx"])
    assert (made.renewed, made.new) == (("dx",), ())
    changed = {file for file, content in contents(folder).items() if before[file] != content}
    assert changed == {"public.json", "private/dx.key"}
    now = PublicKeys.load(folder / "public.json").keys
    assert {name for name in NAMES if known[name] != now[name]} == {"dx"}
    assert mode(key(folder, "dx")) == 0o600
    assert load_folder(ONE, folder).pair("dx").public == now["dx"]


def test_renewing_what_was_never_there_makes_it_new(folder: Path) -> None:
    assert make_keys(ONE, folder, ["dx"]).new == NAMES


def test_renewing_mends_a_spoilt_key(folder: Path) -> None:
    make_keys(ONE, folder)
    key(folder, "dx").write_text("spoilt")
    assert "found no file of manyhands private key" in refusal(ONE, folder)
    assert make_keys(ONE, folder, ["dx"]).renewed == ("dx",)
    load_folder(ONE, folder).pair("dx")


def test_a_private_key_on_its_own_machine_is_known_still(folder: Path, tmp_path: Path) -> None:
    make_keys(ONE, folder)
    known = PublicKeys.load(folder / "public.json")
    key(folder, "dx").rename(tmp_path / "dx.key")
    made = make_keys(ONE, folder)
    assert made.elsewhere == ("dx",)
    assert made.new == ()
    assert PublicKeys.load(folder / "public.json") == known
    keys = load_folder(ONE, folder)
    assert keys.ring("cdx", ["dx"]).peers == {"dx": known.keys["dx"]}
    with pytest.raises(KeyFileError, match=r"dx\.key: found no file"):
        keys.pair("dx")
    assert make_keys(ONE, folder, ["dx"]).renewed == ("dx",)


# --- interrupted


def failing_replace(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    replace = os.replace

    def fail(source: Path, target: Path) -> None:
        if Path(target).name == name:
            raise OSError(5, "Input/output error", str(target))
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail)


@pytest.mark.parametrize("stop_at", ["public.json", "dx.key", "environment.key", "watch.key"])
def test_a_first_run_that_is_interrupted_can_be_repeated(
    folder: Path, monkeypatch: pytest.MonkeyPatch, stop_at: str
) -> None:
    with monkeypatch.context() as patch:
        failing_replace(patch, stop_at)
        with pytest.raises(OSError, match="Input/output"):
            make_keys(ONE, folder)
    begun = contents(folder)
    assert "public.json" not in begun
    assert not any(".part" in file for file in begun)
    made = make_keys(ONE, folder)
    assert set(made.kept) == {Path(file).stem for file in begun}
    assert {*made.kept, *made.new} == set(NAMES)
    assert contents(folder).items() >= begun.items()
    keys = load_folder(ONE, folder)
    assert {name: keys.pair(name).public for name in NAMES} == dict(keys.public.keys)


def test_an_interrupted_addition_keeps_the_public_keys_and_can_be_repeated(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_keys(ONE, folder)
    before = contents(folder)
    with monkeypatch.context() as patch:
        failing_replace(patch, "public.json")
        with pytest.raises(OSError, match="Input/output"):
            make_keys(TWO, folder)
    assert contents(folder).items() >= before.items()
    load_folder(ONE, folder)
    assert make_keys(TWO, folder).kept == tuple(roster(TWO))
    assert load_folder(TWO, folder).pair("dy") == load_private(key(folder, "dy"), "s", "dy")


def test_an_interrupted_renewal_is_reported_and_can_be_repeated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_keys(ONE, folder)
    with monkeypatch.context() as patch:
        failing_replace(patch, "public.json")
        with pytest.raises(OSError, match="Input/output"):
            make_keys(ONE, folder, ["dx"])
    said = refusal(ONE, folder)
    assert "does not match its public key in public.json" in said
    assert "--renew dx" in said
    assert make_keys(ONE, folder, ["dx"]).renewed == ("dx",)
    load_folder(ONE, folder).pair("dx")


def test_what_a_killed_run_left_is_cleared_away(folder: Path) -> None:
    make_keys(ONE, folder)
    key(folder, "dx").unlink()
    (folder / "public.json").unlink()
    (folder / "private" / ".dx.key.part").write_text("half a ke")
    (folder / ".public.json.part").write_text("half of th")
    assert make_keys(ONE, folder).new == ("dx",)
    assert set(contents(folder)) == {"public.json", *(f"private/{name}.key" for name in NAMES)}


# --- refused


def test_two_runs_at_once_are_refused(folder: Path) -> None:
    make_keys(ONE, folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        assert "another command that makes keys there" in refusal(TWO, folder)
    finally:
        os.close(descriptor)
    assert make_keys(TWO, folder).new == ("dy", "cdy")


def test_a_file_system_without_folder_locks_is_accepted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(_descriptor: int, _how: int) -> None:
        raise OSError(9, "Bad file descriptor")  # the error of NFS for an exclusive lock on a file open for reading

    monkeypatch.setattr(fcntl, "flock", no_locks)
    assert make_keys(ONE, folder).new == NAMES


def test_a_name_of_nobody_is_not_renewed(folder: Path) -> None:
    said = refusal(ONE, folder, ["dz"])
    assert said.startswith("--renew: found 'dz'; expected one of dx, cdx, environment, supervisor, watch")
    assert not folder.exists()


def test_a_folder_of_another_session_is_refused(folder: Path) -> None:
    make_keys(ONE, folder)
    other = session_of(["dx"], ["watch"], name="other")
    assert "found the keys of session 's'; expected those of 'other'" in refusal(other, folder)
    with pytest.raises(KeyFileError, match="found the keys of session 's'; expected those of 'other'"):
        load_folder(other, folder)
    (folder / "public.json").unlink()
    assert "found a key of another session; expected one of 'other'" in refusal(other, folder)


def test_a_private_key_that_is_a_link_is_refused(folder: Path, tmp_path: Path) -> None:
    make_keys(ONE, folder)
    elsewhere = tmp_path / "elsewhere"
    key(folder, "dx").rename(elsewhere)
    before = elsewhere.read_bytes()
    key(folder, "dx").symlink_to(elsewhere)
    assert "found a link; expected the file itself" in refusal(ONE, folder)
    assert "found something other than a file" in refusal(ONE, folder, ["dx"])
    with pytest.raises(KeyFileError, match="found a link"):
        load_folder(ONE, folder).pair("dx")
    elsewhere.unlink()
    assert "found a link" in refusal(ONE, folder)  # one that leads nowhere, where a new key would be written
    assert not elsewhere.exists()
    elsewhere.write_bytes(before)
    key(folder, "dx").unlink()
    (folder / "private" / ".dx.key.part").symlink_to(elsewhere)
    assert make_keys(ONE, folder, ["dx"]).renewed == ("dx",)
    assert elsewhere.read_bytes() == before


@pytest.mark.parametrize("target", ["nowhere", "keys"])
def test_a_folder_of_keys_that_is_a_link_to_nothing_is_refused_as_such(folder: Path, target: str) -> None:
    folder.symlink_to(target)  # "keys" is the link itself
    assert "found a link that leads to no folder" in refusal(ONE, folder)
    assert not (folder.parent / "nowhere").exists()


def test_a_link_or_file_as_private_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    make_keys(ONE, folder)
    (folder / "private").rename(tmp_path / "elsewhere")
    (folder / "private").symlink_to(tmp_path / "elsewhere")
    assert "found something other than a folder" in refusal(ONE, folder)
    with pytest.raises(KeyFileError, match="other than a folder"):
        load_folder(ONE, folder)
    (folder / "private").unlink()
    (folder / "private").write_text("")
    assert "found something other than a folder" in refusal(ONE, folder)


@pytest.mark.parametrize("bits", [0o750, 0o710, 0o701, 0o777])
def test_a_private_folder_that_others_can_enter_is_refused(folder: Path, bits: int) -> None:
    make_keys(ONE, folder)
    (folder / "private").chmod(bits)
    assert f"found mode {bits:04o}, which lets others in; expected 0700; do chmod 700" in refusal(ONE, folder)
    with pytest.raises(KeyFileError, match="lets others in"):
        load_folder(ONE, folder)


def test_a_folder_that_others_can_write_to_is_refused(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    assert "found mode 0777, which lets others replace keys" in refusal(ONE, folder)


def test_a_private_key_that_others_can_read_is_refused(folder: Path) -> None:
    make_keys(ONE, folder)
    key(folder, "cdx").chmod(0o640)
    assert "found mode 0640, which lets others in" in refusal(ONE, folder)


def test_a_public_key_that_does_not_belong_is_refused(folder: Path) -> None:
    make_keys(ONE, folder)
    public = PublicKeys.load(folder / "public.json")
    PublicKeys("s", {**public.keys, "dx": new_pair().public}).save(folder / "public.json")
    assert "found a private key of 'dx' that does not match its public key" in refusal(ONE, folder)
    with pytest.raises(KeyFileError, match="not match its public key"):
        load_folder(ONE, folder).pair("dx")


def test_swapped_private_keys_are_refused(folder: Path, tmp_path: Path) -> None:
    make_keys(ONE, folder)
    key(folder, "dx").rename(tmp_path / "t")
    key(folder, "cdx").rename(key(folder, "dx"))
    (tmp_path / "t").rename(key(folder, "cdx"))
    assert "found the key of another process; expected that of 'dx'" in refusal(ONE, folder)


def test_a_key_under_two_names_is_refused(folder: Path) -> None:
    make_keys(ONE, folder)
    pair = load_private(key(folder, "dx"), "s", "dx")
    save_private(pair, "s", "dy", key(folder, "dy"))
    assert "found the same public key for 'dx' and 'dy'" in refusal(TWO, folder)


def test_a_file_is_no_folder(folder: Path) -> None:
    folder.write_text("")
    for path in (folder, folder / "below"):
        with pytest.raises(KeyFileError, match="found a file; expected the name of a folder"):
            make_keys(ONE, path)


def test_too_many_keys_are_refused_before_any_is_made(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_keys(TWO, folder)
    monkeypatch.setattr("manyhands.launch.plan.keys.MAX_KEYS", 8)
    more = session_of(["dx", "dz"], ["watch"])
    assert "found 7 keys, 2 of them with names that the session does not have; expected at most 8" in refusal(
        more, folder
    )


def test_keys_that_are_missing_are_named(folder: Path) -> None:
    with pytest.raises(KeyFileError, match=r"public\.json: found no file"):
        load_folder(ONE, folder)
    make_keys(ONE, folder)
    with pytest.raises(KeyFileError, match="found no key of 'dy' and 1 more; expected one for every process"):
        load_folder(TWO, folder)


# --- used


def test_a_name_from_elsewhere_does_not_become_a_path(folder: Path, tmp_path: Path) -> None:
    make_keys(ONE, folder)
    pair = new_pair()
    save_private(pair, "s", "../../outside", tmp_path / "outside.key")
    known = PublicKeys.load(folder / "public.json").keys
    PublicKeys("s", {**known, "../../outside": pair.public}).save(folder / "public.json")
    with pytest.raises(KeyFileError, match=r"s: found no '\.\./\.\./outside'; expected one of dx"):
        load_folder(ONE, folder).pair("../../outside")


def test_rings_from_a_folder(folder: Path) -> None:
    make_keys(ONE, folder)
    keys = load_folder(ONE, folder)
    ring = keys.ring("dx", ["cdx", "supervisor"])
    assert (ring.name, ring.pair) == ("dx", load_private(key(folder, "dx"), "s", "dx"))
    assert ring.peers == {name: keys.public.keys[name] for name in ("cdx", "supervisor")}
    with pytest.raises(KeyFileError, match="found no public key of 'cdy', which 'dx' talks to"):
        keys.ring("dx", ["cdy"])


def test_keys_of_one_run(tmp_path: Path) -> None:
    keys = ephemeral(NAMES, "s")
    assert keys.public.session == "s"
    assert tuple(keys.public.keys) == NAMES
    assert ephemeral(NAMES, "s").pair("dx") != keys.pair("dx")
    path = keys.write("dx", tmp_path)
    assert (path, mode(path)) == (tmp_path / "dx.key", 0o600)
    assert load_private(path, "s", "dx").secret == keys.pair("dx").secret
    assert keys.ring("dx", ["cdx"]).peers == {"cdx": keys.pair("cdx").public}
    with pytest.raises(FileExistsError):
        keys.write("dx", tmp_path)
    with pytest.raises(KeyFileError, match="s: found no 'dy'"):
        keys.pair("dy")


def test_a_node_gets_its_kept_key_file_or_this_runs(folder: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir(mode=0o700)
    make_keys(ONE, folder)
    assert load_folder(ONE, folder).file("dx", run) == key(folder, "dx")
    assert not list(run.iterdir())  # a key is not copied without need
    key(folder, "dx").chmod(0o640)
    with pytest.raises(KeyFileError, match="lets others in"):
        load_folder(ONE, folder).file("dx", run)
    keys = ephemeral(NAMES, "s")
    assert keys.file("dx", run) == run / "dx.key"
    assert load_private(run / "dx.key", "s", "dx") == keys.pair("dx")


# --- reported


def command(session: Session, folder: Path, *renew: str, as_json: bool = False) -> tuple[int, str, str]:
    out, err = (Console(file=io.StringIO(), width=140) for _ in range(2))
    code = run_keys(session, folder, renew, out, err, as_json)
    return (code, *(console.file.getvalue() for console in (out, err)))  # type: ignore[attr-defined]


def test_the_command_prints_each_nodes_keys(folder: Path) -> None:
    folder = folder / "of [red] hands"  # what a terminal's markup would swallow
    code, out, err = command(TWO, folder)
    assert code == 0
    assert "s: keys" in out
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    assert rows == [[name, role.value, "new"] for name, role in roster(TWO).items()]
    assert f"to machines that launch the session: {folder}/public.json\n" in err
    assert f"{folder}/private/NAME.key" in err
    assert "the public keys have changed" in err
    key(folder, "cdx").unlink()
    _, out, err = command(ONE, folder, "dx")
    states = {row[1].strip(): row[3].strip() for row in (line.split("│") for line in out.splitlines()) if len(row) == 5}
    assert states == {"dx": "renewed", "cdx": "elsewhere", "environment": "kept", "supervisor": "kept", "watch": "kept"}
    assert "cdx: its private key is not in this folder: it is on its own machine, or lost" in err
    assert "no longer in s, and left in place: cdy, dy\n" in err
    key(folder, "cdx").unlink(missing_ok=True)
    assert "have changed" not in command(ONE, folder)[2]


def test_the_command_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_keys(TWO, folder)
    key(folder, "dx").unlink()
    code, out, _ = command(ONE, folder, "cdx", as_json=True)
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (code, out) == (0, "")
    assert said["session"] == "s"
    assert PublicKeys.load(Path(said["public"])).keys.keys() >= said["keys"].keys()
    assert said["stale"] == ["cdy", "dy"]
    assert said["keys"]["dx"] == {"role": "device", "key": "elsewhere", "private": None}
    assert said["keys"]["cdx"] == {"role": "coupling", "key": "renewed", "private": str(key(folder, "cdx"))}
    assert {name: entry["key"] for name, entry in said["keys"].items() if name not in ("dx", "cdx")} == {
        "environment": "kept", "supervisor": "kept", "watch": "kept"
    }  # fmt: skip


def test_a_name_that_a_terminal_would_obey_is_not_printed(folder: Path) -> None:
    make_keys(ONE, folder)
    (folder / "private" / "\x1b[2J.key").write_text("")
    assert make_keys(ONE, folder).stale == ()


# --- secrets


def spoilt(pair: KeyPair, folder: Path) -> Sequence[Callable[[], object]]:
    """Ways to spoil a folder such that something has the secret of dx in its hands when it fails."""
    path, public = key(folder, "dx"), folder / "public.json"

    def text(change: Callable[[str], str], file: Path = path) -> Callable[[], object]:
        return lambda: file.write_text(change(file.read_text()))

    return [
        text(lambda t: t[:-3]),
        text(lambda t: t + t),
        text(lambda t: t.replace('"dx"', json.dumps(pair.secret))),
        text(lambda t: t.replace(json.dumps(pair.public), json.dumps(pair.secret))),
        text(lambda t: t.replace(json.dumps(pair.public), json.dumps(new_pair().public))),
        text(lambda t: json.dumps(pair.secret)),
        text(lambda t: pair.secret),
        text(lambda t: t.replace(json.dumps(pair.public), json.dumps(pair.secret)), public),
        text(lambda t: t.replace('"s"', json.dumps([pair.secret])), public),
        text(lambda t: pair.secret, public),
        lambda: path.chmod(0o644),
        lambda: save_private(pair, "s", "dy", key(folder, "dy")),
    ]


@settings(max_examples=40)
@given(way=st.integers(0, 11), renew=st.lists(st.sampled_from(NAMES), max_size=2))
def test_no_error_and_nothing_printed_shows_a_secret(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str], way: int, renew: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(ONE, folder)
    pair = load_private(key(folder, "dx"), "s", "dx")
    ways = spoilt(pair, folder)
    assert len(ways) == 12
    ways[way]()
    attempts: list[Callable[[], object]] = [
        lambda: load_folder(TWO, folder),
        lambda: load_folder(ONE, folder).pair("dx"),
        lambda: load_folder(ONE, folder).ring("dx", ["cdx"]),
        lambda: command(TWO, folder, *renew),
        lambda: command(ONE, folder, as_json=True),
    ]
    shown: list[str] = []
    failed = 0
    for attempt in attempts:
        try:
            result = attempt()
            shown += [repr(result), str(result)]
            shown += [repr(vars(result))] if isinstance(result, Keys) else []
        except KeyFileError as error:
            failed += 1
            shown += traceback.format_exception(error)
            behind: BaseException | None = error
            while behind is not None:
                shown += [repr(behind.args), repr(vars(behind)), repr(getattr(behind, "doc", None))]
                behind = behind.__cause__ or behind.__context__
    shown += capsys.readouterr()
    assert failed  # or the folder was not spoilt at all
    assert all(form not in text for text in shown for form in (pair.secret, repr(pair.secret), json.dumps(pair.secret)))


def test_keys_in_memory_show_no_secret() -> None:
    keys = ephemeral(NAMES, "s")
    for text in (repr(keys), str(keys), repr(vars(keys)), repr(keys.ring("dx", ["cdx"]))):
        assert all(keys.pair(name).secret not in text for name in NAMES)
