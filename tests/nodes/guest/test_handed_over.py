"""Bundle and key over standard input: read once, in files that nobody else can read, which are gone afterwards."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import tempfile
from pathlib import Path

import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import Listen, reach
from manyhands.launch.session import load_session
from manyhands.nodes.guest.handed_over import handed_over, taken_over
from manyhands.nodes.kernel.bundle import BundleError, DeviceBundle, load
from manyhands.nodes.link.process import EXIT_BAD_INPUT
from manyhands.protocol.keys import load_private

from ...support.commands import MANYHANDS

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
PATIENCE = 30.0  # s; a guest that nobody ends tries for a minute


class Input:
    """A standard input with this content."""

    def __init__(self, content: bytes) -> None:
        self.buffer = io.BytesIO(content)


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What a launch sends to dx, whose bundle was cut for a folder of this machine."""
    folder = tmp_path_factory.mktemp("run")
    prepared = prepare(load_session(SESSIONS / "example1.yaml"))
    ways = reach(prepared, "tcp", listen=Listen("127.0.0.1", 7400), hosts={"dx": "lab"})
    assert ways.keys is not None
    key = ways.keys.write("dx", folder)
    bundle = cut(prepared, RunPlan("simulated", folder, "", ways, {"dx": key}))["dx"]
    return handed_over(bundle, key.read_bytes())


def test_both_arrive_in_private_files_that_go_away(
    given: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert given.count(b"\n") == 1
    assert b"/run" not in given, "a path of the launching machine goes with it"
    monkeypatch.setattr("sys.stdin", Input(given))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with taken_over("dx") as path:
        assert load(path, DeviceBundle).common.name == "dx"
        assert load_private(path.with_suffix(".key"), "example-1", "dx")
        modes = {one.stat().st_mode & 0o777 for one in (path, path.with_suffix(".key"))}
        assert (modes, path.parent.stat().st_mode & 0o777) == ({0o600}, 0o700)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{}\n", b"[1]\n", b"{\n", b'{"bundle": {}}\n', b"\xff\n"])
def test_what_is_no_bundle_and_key_is_refused(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", Input(content))
    with pytest.raises(BundleError, match="standard input: found no bundle and key"), taken_over("dx"):
        raise AssertionError("it was entered")


def ended(name: str, given: bytes) -> tuple[int, str]:
    """The end of a node that nobody's session awaits, whose input ends after this."""
    words = ("node", name, "--bundle", "-", "--connect", "tcp://127.0.0.1:9")
    with subprocess.Popen(
        [*MANYHANDS, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        try:
            _, err = process.communicate(given, timeout=PATIENCE)
        finally:
            process.kill()
    return process.returncode, err.decode()


def test_the_end_of_its_input_ends_a_node(given: bytes) -> None:
    assert ended("dx", given) == (128 + signal.SIGTERM, "")


def test_a_bundle_for_a_different_node_is_refused(given: bytes) -> None:
    code, err = ended("dy", given)
    assert code == EXIT_BAD_INPUT
    assert err.startswith("error: ")
    assert "found the bundle of dx; expected that of dy" in err
    assert json.loads(given)["key"]["secret"] not in err
