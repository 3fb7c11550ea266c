"""Files from elsewhere: pipes and devices, claims of size, bombs, secrets, and the names in them.

Nothing here is timed: a wait without end, or a full memory, shows itself.
"""

from __future__ import annotations

import io
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from rich.console import Console
from typer.testing import CliRunner

from manyhands.design.certificate import load as load_certificate
from manyhands.design.errors import CertificateError
from manyhands.design.files import open_regular, read_regular
from manyhands.launch.app.cli import app
from manyhands.launch.look.display import say
from manyhands.launch.look.page.security import ViewError, read_token
from manyhands.launch.recordings.info import read_info
from manyhands.launch.recordings.integrity import findings
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_saved
from manyhands.launch.session import SessionError, load_session
from manyhands.launch.session import yaml as session_source
from manyhands.nodes.kernel.bundle import BundleError, DeviceBundle
from manyhands.nodes.kernel.bundle import load as load_bundle
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.protocol.codec import encode
from manyhands.protocol.keys import KeyFileError, PublicKeys, load_private, new_pair, save_private
from manyhands.protocol.messages import Figures, Observation, Role

from ..support.small_recordings import ALONE, ATTACHED, RECORDED, STARTED, observation, recording

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"


def force_of(path: Path) -> object:
    return load_session(SESSIONS / "example1.yaml", [f"devices.dx.hand.force={{trace: {path}}}"])


def motion_of(path: Path) -> object:
    return load_session(
        SESSIONS / "example1.yaml", [f"devices.dx={{dof: 1, osp: 1.37, driver: trace, trace: {{file: {path}}}}}"]
    )


READERS: dict[str, tuple[str, Callable[[Path], Any], type[Exception]]] = {
    "session": ("s.yaml", load_session, SessionError),
    "certificate": ("c.json", load_certificate, CertificateError),
    "bundle": ("b.bundle", lambda path: load_bundle(path, DeviceBundle), BundleError),
    "force trace": ("t.csv", force_of, SessionError),
    "motion csv": ("m.csv", motion_of, SessionError),
    "motion npz": ("m.npz", motion_of, SessionError),
    "motion mcap": ("m.mcap", motion_of, SessionError),
    "recording": ("r.mcap", read_run, RecordingError),
    "info": ("r.mcap", read_info, RecordingError),
    "integrity": ("r.mcap", findings, RecordingError),
    "npz": ("r.npz", read_saved, RecordingError),
    "csv": ("r.csv", read_saved, RecordingError),
    "parquet": ("r.parquet", read_saved, RecordingError),
    "token": ("token", read_token, ViewError),
}


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused_without_waiting_for_it(reader: str, kind: str, tmp_path: Path) -> None:
    """A pipe without a writer made 0.5.0 wait for ever; /dev/zero took its memory."""
    name, read, error = READERS[reader]
    path = tmp_path / name
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case _:
            path.mkdir()
    with pytest.raises(error, match=f"(?i)is a {kind}, not a regular file") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_files_size_is_bounded_before_and_while_reading(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    for refused in (lambda: read_regular(path, 4), lambda: open_regular(path, 4)):
        with pytest.raises(OSError, match="Is longer than 4 bytes"):
            refused()
    with pytest.raises(OSError, match="Is longer than 10 bytes"):
        read_regular(Path("/proc/self/status"), 10)  # regular, with a stated size of 0 bytes, and has some


# --- what a refused file holds stays where it is


SECRET = "root:$6$do-not-show:19000:0:99999:7:::"


@pytest.mark.parametrize("reader", ["force trace", "motion csv", "motion npz", "motion mcap", "certificate", "bundle"])
@pytest.mark.parametrize("before", ["", "0,1\n0.001,2\n", "t,v\n", "time_s,x[dx]_m\n"])
def test_a_file_that_is_named_in_another_one_is_not_quoted(reader: str, before: str, tmp_path: Path) -> None:
    """``trace: /etc/shadow`` was answered with that file's first line."""
    name, read, error = READERS[reader]
    (tmp_path / name).write_text(f"{before}{SECRET}\n" * 2)
    with pytest.raises(error) as caught:
        read(tmp_path / name)
    told = "\n".join(map(str, (caught.value, caught.value.__cause__)))
    assert "do-not-show" not in told
    assert "19000" not in told


# --- claims of size


def npz_with(header: dict[str, Any], path: Path, content: bytes = b"") -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in {"t": [0.0], "ports": ["dx"], "period": 0.001, "session": "s", "certificate": "c"}.items():
            text = io.BytesIO()
            np.save(text, np.array(array))
            archive.writestr(f"{name}.npy", text.getvalue())
        for name in ("x", "f_v"):
            text = io.BytesIO()
            np.lib.format.write_array_header_1_0(text, {"descr": "<f8", "fortran_order": False, **header})
            archive.writestr(f"{name}.npy", text.getvalue() + content)


@pytest.mark.parametrize(
    ("header", "found"),
    [
        ({"shape": (10**11, 1)}, "an array of 800000000000 bytes by its header"),
        ({"shape": (10**30,)}, "bytes by its header"),
        ({"shape": (2, 1)}, "an array of 16 bytes by its header and"),
        ({"shape": (1, 1), "descr": "|O"}, "which holds Python's objects"),
    ],
)
def test_an_arrays_size_is_checked_against_its_file_before_allocation(
    header: dict[str, Any], found: str, tmp_path: Path
) -> None:
    npz_with(header, tmp_path / "r.npz", bytes(8))
    with pytest.raises(RecordingError, match=re.escape(found)):
        read_saved(tmp_path / "r.npz")
    with pytest.raises(SessionError, match=re.escape(found)):
        motion_of(tmp_path / "r.npz")


def test_a_large_session_is_read_by_libyaml_where_it_is_installed() -> None:
    """PyYAML's own scanner takes half a minute of a file as large as there may be."""
    assert yaml.__with_libyaml__, "PyYAML's wheels have it"
    assert yaml.cyaml.CParser in session_source._Loader.__mro__


# --- bombs


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor(level=19).compress(records)
    body = struct.pack("<QQQII", 0, 0, len(records), zlib.crc32(records), 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 0x06, len(body)) + body


def message(data: bytes) -> bytes:
    return struct.pack("<BQHIQQ", 0x05, 22 + len(data), 1, 0, 0, 0) + data


def beginning() -> bytes:
    """A recording up to and without its end, whose channel 1 is there."""
    whole = recording(5)
    return whole[: whole.index(struct.pack("<BQ", 0x0F, 4))]


@pytest.mark.parametrize(
    ("bomb", "what"),
    [
        (chunk(message(b"{}") * 100_000), "records in as many bytes"),
        (chunk(message(b" " * 2**23)) * 8, "expected at most 1000 times more"),
    ],
    ids=["many small messages", "much of nothing"],
)
def test_kilobytes_that_unpack_to_gigabytes_are_not_unpacked(bomb: bytes, what: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(beginning() + bomb)
    assert len(bomb) < 20_000
    run = read_run(path)
    assert run.cut is not None
    assert "is damaged" in run.cut
    assert run.ticks == 5  # what came before is read
    assert any(what in damage.what for damage in findings(path))
    assert read_info(path).cut is not None


def test_a_message_longer_than_its_topics_rows_is_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    rows = b'{"tick": 7, "time": 0.007, "x": [' + b"0," * 100_000 + b"0]}"
    path.write_bytes(beginning() + chunk(message(rows)))
    assert read_run(path).ticks == 5


def test_what_a_recorder_packs_best_is_no_bomb(tmp_path: Path) -> None:
    """Every port of a wide session at rest, the same row four thousand times."""
    ports = tuple(f"d.{i}" for i in range(512))
    core = RecorderCore(replace(RECORDED, roles={"d": Role.DEVICE}, ports={"d": ports}, masses=()))
    out = core.cut()
    rest = np.zeros((100, 512))
    for tick in range(100, 4_100, 100):
        core.take(encode(Observation("d", tick, Figures(), {"x": rest, "f_v": rest})), 10**18)
        if core.full:
            out += core.cut()
    path = tmp_path / "rest.mcap"
    path.write_bytes(out + core.cut() + core.end())
    info = read_info(path)
    assert (info.ticks, info.cut) == (4_000, None)


# --- names in files, on terminals and in tables


@pytest.mark.parametrize(
    "name", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "a\x1b[2J", "a\nb", "a,b", "", "a" * 201, "../a"]
)
def test_names_of_a_recording_are_names(name: str, tmp_path: Path) -> None:
    """Each becomes a heading of ``export --format csv``, where a spreadsheet computes what begins with =, +, - or @."""
    path = tmp_path / "r.mcap"
    for where in ("session", "node", "port", "mass"):
        recorded = {
            "session": replace(ALONE, session=name),
            "node": replace(ALONE, roles={name: Role.DEVICE}, ports={name: ("x",)}),
            "port": replace(ALONE, ports={"d": (name,)}),
            "mass": replace(ALONE, masses=(name,)),
        }[where]
        path.write_bytes(RecorderCore(recorded).cut())
        for read in (read_run, read_info):
            with pytest.raises(RecordingError, match="in the metadata; expected letters, digits") as caught:
                read(path)
            assert str(caught.value).isprintable()
    for strange in (replace(ALONE, certificate="\x1b]0;x\x07"), replace(ALONE, version="v" * 201)):
        path.write_bytes(RecorderCore(strange).cut())
        with pytest.raises(RecordingError, match="not printable"):
            read_run(path)


@pytest.mark.parametrize("name", ["=1+1", "+a", "@a", "a\x1b[2J", "A,B", "../a", "/etc/passwd", "a\n"])
def test_names_of_a_session_are_names(name: str, tmp_path: Path) -> None:
    """Where names in session files are checked: each by its pattern, before anything is made of it."""
    whole = yaml.safe_load((SESSIONS / "example1.yaml").read_text())
    for section in ("devices", "couplings"):
        spoilt = {**whole, section: {**whole[section], name: next(iter(whole[section].values()))}}
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(spoilt))
        with pytest.raises(SessionError, match="a lowercase letter, then at most 31") as caught:
            load_session(tmp_path / "s.yaml")
        assert str(caught.value).isprintable()
    for spoilt in (
        {**whole, "session": name},
        {**whole, "environment": {**whole["environment"], "masses": {name: 1.0}}},
        {**whole, "observers": {name: {"reads": ["telemetry"]}}},
    ):
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(spoilt))
        with pytest.raises(SessionError, match="a lowercase letter") as caught:
            load_session(tmp_path / "s.yaml")
        assert str(caught.value).isprintable()


def hostile_recording(path: Path) -> None:
    """Channels and attachments of names that a terminal obeys, or that lead out of a folder."""
    core = RecorderCore(ALONE, {"../../escaped": b"x", "/tmp/escaped": b"x", "\x1b]0;evil\x07": b"x", **ATTACHED})
    out = core.cut()
    for number, topic in enumerate(("\x1b[2Jevil", "no/slashes", "", "/s/\x9b31m/x"), 100):
        text = topic.encode()
        body = struct.pack("<HH", number, 0) + struct.pack("<I", len(text)) + text + struct.pack("<I", 4)
        body += b"json" + struct.pack("<I", 0)
        out += chunk(struct.pack("<BQ", 0x04, len(body)) + body)
    core.take(observation("d", 5, 5), STARTED)
    path.write_bytes(out + core.cut())


@pytest.mark.parametrize(
    "command", [["info"], ["export", "--format", "csv"], ["export", "--format", "npz"], ["audit"], ["replay"]]
)
def test_a_hostile_recording_writes_nothing_elsewhere_and_commands_no_terminal(
    command: list[str], tmp_path: Path
) -> None:
    inner = tmp_path / "one" / "two"
    inner.mkdir(parents=True)
    hostile_recording(inner / "r.mcap")
    result = CliRunner().invoke(app, [*command, str(inner / "r.mcap")])
    assert result.exit_code in (0, 1, 2)
    assert "Traceback" not in result.output
    assert not isinstance(result.exception, BaseException) or isinstance(result.exception, SystemExit)
    assert set("".join(result.output.split())) <= {c for c in result.output if c.isprintable()}
    made = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert made <= {"one", "one/two", "one/two/r.mcap", "one/two/r.csv", "one/two/r.npz"}
    assert not Path("/tmp/escaped").exists()
    if command == ["info"]:
        assert "evil" in result.output


def test_terminal_controls_are_not_printed() -> None:
    shown = io.StringIO()
    say(Console(file=shown, color_system=None, width=200), "a\x1b[2Jb\x07c\x9b31md\ne")
    assert shown.getvalue() == "a\ufffd[2Jb\ufffdc\ufffd31md\ne\n"


def test_no_key_is_read_through_a_link_or_pipe(tmp_path: Path) -> None:
    """A link in the folder of private keys, or in the place of that folder, is refused
    (tests/launch/plan/test_keys.py)."""
    pair = new_pair()
    save_private(pair, "s", "dx", tmp_path / "dx.key")
    (tmp_path / "link.key").symlink_to(tmp_path / "dx.key")
    os.mkfifo(tmp_path / "pipe.key", 0o600)
    (tmp_path / "zero.key").symlink_to("/dev/zero")
    for name, found in (("link", "found a link"), ("pipe", "other than a file"), ("zero", "found a link")):
        with pytest.raises(KeyFileError, match=found):
            load_private(tmp_path / f"{name}.key", "s", "dx")
    (tmp_path / "public.json").symlink_to("/dev/zero")
    with pytest.raises(KeyFileError, match="other than a file"):
        PublicKeys.load(tmp_path / "public.json")  # it may be a link, but only to a file
    (tmp_path / "new.key").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileExistsError):
        save_private(pair, "s", "dx", tmp_path / "new.key")
    assert not (tmp_path / "elsewhere").exists()
