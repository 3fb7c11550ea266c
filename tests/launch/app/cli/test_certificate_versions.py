"""Certificates of each format version on the command line: those of older releases, and requirements on new ones.

The files of 0.6.0 (``tests/design/data/certificates-0.6.0``) are as ``manyhands design SESSION -o FILE`` of that
release wrote them, one for each shipped session that can be certified, and for the example with a model. That of 0.5.0
beside them is of format version 2.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import yaml

from manyhands.design.certificate import content, identity, load, to_json
from manyhands.design.proof import prove
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.recordings.run import read_run
from manyhands.launch.run.directory import kept_files
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

from ....support.commands import manyhands_command
from ....support.simulated_recordings import recorded_of, simulated, written

ROOT = Path(__file__).parents[4]
DATA = ROOT / "tests" / "design" / "data"
OLD = DATA / "certificates-0.6.0"
VERSION_2 = DATA / "certificate-0.5.0.json"
NO_MORE = "found a certificate of format version 2, which manyhands 0.6.0 is the last to read; design the session anew"
SESSIONS = ROOT / "launch" / "sessions"
UNCOUPLED = "example1-uncoupled"  # cannot be certified
NEWER = {  # 0.6.0 did not have them
    "ball", "carry", "gripper", "handover", "insert", "mujoco", "peg", "rub", "screw", "steering", "stretcher",
    "stroke", "tray",
}  # fmt: skip
NAMES = [*sorted({path.stem for path in SESSIONS.glob("*.yaml")} - {UNCOUPLED} - NEWER), "puck"]

pytestmark = pytest.mark.usefixtures("own_interrupt")


def old(name: str) -> Path:
    return OLD / f"{name}.cert.json"


def session_of(name: str) -> Path:
    return (ROOT / "examples" if name == "puck" else SESSIONS) / f"{name}.yaml"


@pytest.fixture(scope="module")
def stiffest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Example 1, asking for the stiffest coupling."""
    path = tmp_path_factory.mktemp("stiffest") / "session.yaml"
    session = load_named("example1.yaml", ["design.objective=stiffest"])
    path.write_text(yaml.safe_dump(session.as_plain(), sort_keys=False))
    return path


@pytest.fixture(scope="module")
def feasible(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate of now, for Example 1 as it is shipped."""
    path = tmp_path_factory.mktemp("feasible") / "c.json"
    assert manyhands_command("design", "example1.yaml", "-o", path).exit_code == 0
    return path


def test_there_is_one_for_every_session_that_can_be_certified() -> None:
    assert [path.name for path in sorted(OLD.iterdir())] == sorted(old(name).name for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_0_6_0_certificate_keeps_its_id_and_is_the_sessions(name: str) -> None:
    read, data = load(old(name))
    assert all(finding.holds for finding in prove(data))
    assert to_json(read) == old(name).read_text()  # nothing is added when it is written again
    assert data["version"] == read.version == 3
    assert identity(content(read)) == data["id"]
    done = manyhands_command("verify", old(name), "--session", session_of(name))
    assert done.exit_code == 0, done.stderr
    assert done.stdout.splitlines()[-1].endswith(f"; certificate {data['id']}")


def test_a_changed_certificate_of_0_6_0_is_found(tmp_path: Path) -> None:
    """By its id, and with a new one by the proof, as ever; what is added to it is refused."""
    data = json.loads(old("example1").read_text())
    data["coupling"]["blocks"]["cx"]["stiffness"] = [[3000.0]]
    path = tmp_path / "changed.json"
    for change, code, words in (
        ({}, 3, "not proved: the id is the SHA-256 of the content"),
        ({"id": identity(data)}, 3, "not proved: V_hat of cx is Delta_V-OSP"),
        ({"series": {"dx": 0.5}}, 2, "found the keys ['series']"),
        ({"version": 4}, 2, "key 'period_tolerance' is missing"),
        ({"version": 2}, 2, NO_MORE),
    ):
        path.write_text(json.dumps(data | change))
        done = manyhands_command("verify", path)
        assert (done.exit_code, words in done.stderr) == (code, True), done.stderr


def test_what_was_asked_is_shown_and_called_no_claim(feasible: Path) -> None:
    line = "requested (not part of the proof): coupling spring-damper, objective feasible"
    done = manyhands_command("verify", feasible, "--session", "example1.yaml")
    assert done.exit_code == 0, done.stderr
    assert f"{feasible}: {line}, algorithm convex" in done.stdout.splitlines()
    said = json.loads(manyhands_command("verify", feasible, "--json").stdout)
    asked = {"coupling": "spring-damper", "objective": "feasible", "algorithm": "convex"}
    assert (said["version"], said["asked"]) == (3, asked)
    assert json.loads(feasible.read_text())["asked"] == asked


def test_a_feasible_certificate_is_not_one_for_the_stiffest(feasible: Path, stiffest: Path, tmp_path: Path) -> None:
    """Neither when it is verified, nor when a run or an invitation is to be under it."""
    words = "design.objective differs: the certificate has feasible, the session asks for stiffest"
    bundle = tmp_path / "dx.bundle"
    run = ("--clock", "simulated", "--duration", "0.01")
    for arguments in (
        ("verify", feasible, "--session", stiffest),
        ("launch", stiffest, "--certificate", feasible, *run),
        ("simulate", stiffest, "--certificate", feasible, "--duration", "0.01"),
        ("invite", stiffest, "dx", "--certificate", feasible, "--insecure", "-o", bundle),
    ):
        done = manyhands_command(*arguments)
        assert done.exit_code == 3, arguments
        assert words in done.stderr
        assert "Traceback" not in done.stderr
    assert not bundle.exists()


def test_a_certificate_of_version_2_is_refused_in_one_sentence(tmp_path: Path) -> None:
    bundle = tmp_path / "dx.bundle"
    run = ("--certificate", VERSION_2)
    for arguments in (
        ("verify", VERSION_2),
        ("verify", VERSION_2, "--session", "example1.yaml"),
        ("launch", "example1.yaml", *run, "--clock", "simulated", "--duration", "0.01"),
        ("simulate", "example1.yaml", *run, "--duration", "0.01"),
        ("invite", "example1.yaml", "dx", *run, "--insecure", "-o", bundle),
    ):
        done = manyhands_command(*arguments)
        assert done.exit_code == 2, arguments
        assert f"{VERSION_2}: {NO_MORE}" in done.stderr
        assert "Traceback" not in done.stderr
    assert not bundle.exists()


def test_a_recording_with_a_certificate_of_version_2_is_read_and_names_who_audits_it(tmp_path: Path) -> None:
    prepared = prepare(load_named("example1.yaml"))
    data = json.loads(VERSION_2.read_text())
    kept = {**kept_files(prepared), CERTIFICATE_FILE: VERSION_2.read_bytes()}
    recorded = dataclasses.replace(recorded_of(prepared), certificate=data["id"], version="0.6.0")
    path = written(tmp_path / "run.mcap", recorded, kept, simulated(prepared, 50))

    run = read_run(path)
    assert (run.ticks, run.cut, run.attachments[CERTIFICATE_FILE]) == (50, None, VERSION_2.read_bytes())
    for arguments in (
        ("info", path),
        ("plot", path, "-o", tmp_path / "run.svg"),
        ("export", path, "--format", "csv", "-o", tmp_path / "run.csv"),
    ):
        done = manyhands_command(*arguments)
        assert done.exit_code == 0, done.stderr
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 51
    assert (tmp_path / "run.svg").stat().st_size > 0
    for command in ("audit", "replay"):
        done = manyhands_command(command, path)
        assert done.exit_code == 2
        words = "found a certificate of format version 2 in it; audit and replay it with manyhands 0.6.0"
        assert f"{path}: {words}, the last release that reads one" in done.stderr
        assert "Traceback" not in done.stderr


def test_a_run_keeps_and_audits_its_0_6_0_certificate(tmp_path: Path) -> None:
    """The copy in the recording is the file itself with its own id; its rungs are made now."""
    prepared = prepare(load_named("example1.yaml"), old("example1"))
    kept = kept_files(prepared)
    assert kept[CERTIFICATE_FILE] == old("example1").read_bytes()
    assert prepared.ladder is not None
    first, *softer = prepared.ladder.rungs
    assert len(softer) == 3
    assert all(rung.method["rung of"] == first.id for rung in softer)
    path = written(tmp_path / "run.mcap", recorded_of(prepared), kept, simulated(prepared, 50))
    assert manyhands_command("replay", path).exit_code == 0
    done = manyhands_command("audit", path)
    assert (done.exit_code, f"certificate {first.id}: proved again, and this session's" in done.stdout) == (0, True)


def test_a_certificate_file_that_would_change_its_id_is_refused(feasible: Path, tmp_path: Path) -> None:
    """Another order of keys, with the id of that order, is proved as it is, but a recording would write it anew."""
    data = dict(reversed(json.loads(feasible.read_text()).items()))
    data["id"] = identity(data)
    path = tmp_path / "turned.json"
    path.write_text(json.dumps(data))
    assert manyhands_command("verify", path).exit_code == 0
    done = manyhands_command("simulate", "example1.yaml", "--certificate", path, "--duration", "0.01")
    assert done.exit_code == 3
    assert "turned.json: the file was re-serialised: its content has the id" in done.stderr
