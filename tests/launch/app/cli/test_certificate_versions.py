"""Certificates of each format version on the command line: those of 0.5.0, and requirements on new ones.

The files of 0.5.0 (``tests/design/data/certificates-0.5.0``) are as ``manyhands design SESSION -o FILE`` of that
release wrote them, one for each shipped session that can be certified, and for the example with a model.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from manyhands.design.certificate import identity, load, to_json
from manyhands.design.proof import prove
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.directory import kept_files
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

from ....support.commands import manyhands_command
from ....support.simulated_recordings import recorded_of, simulated, written

ROOT = Path(__file__).parents[4]
OLD = ROOT / "tests" / "design" / "data" / "certificates-0.5.0"
SESSIONS = ROOT / "launch" / "sessions"
NOT_RECORDED = (
    "format version 2 does not record what was asked of the coupling (design.objective and the other keys of design), "
    "and its id does not cover the order of devices and couplings"
)
UNCOUPLED = "example1-uncoupled"  # cannot be certified
NEWER = {"ball", "carry", "mujoco", "peg", "rub", "stroke", "tray"}  # 0.5.0 did not have them
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
def test_a_0_5_0_certificate_is_proved_as_its_own_version(name: str) -> None:
    read, data = load(old(name))
    assert all(finding.holds for finding in prove(data))
    assert to_json(read) == old(name).read_text()  # nothing is added when it is written again
    assert data["version"] == read.version == 2
    done = manyhands_command("verify", old(name), "--session", session_of(name))
    assert done.exit_code == 0, done.stderr
    lines = done.stdout.splitlines()
    assert f"{old(name)}: {NOT_RECORDED}" in lines
    objective = load_named(session_of(name)).design.objective
    assert (
        f"{old(name)}: not compared with the session's design.objective={objective}: its own is not recorded" in lines
    )
    assert lines[-1].endswith(f"; certificate {data['id']}")


def test_without_a_session_no_comparison_is_reported() -> None:
    done = manyhands_command("verify", old("example1"))
    assert done.exit_code == 0
    assert f"{old('example1')}: {NOT_RECORDED}" in done.stdout.splitlines()
    assert "not compared" not in done.stdout
    said = json.loads(manyhands_command("verify", old("example1"), "--json").stdout)
    assert (said["version"], said["asked"], said["status"]) == (2, None, "certified")


def test_a_changed_certificate_of_0_5_0_is_found(tmp_path: Path) -> None:
    """By its id, and with a new one by the proof, as ever; what is added to it is refused."""
    data = json.loads(old("example1").read_text())
    data["coupling"]["blocks"]["cx"]["stiffness"] = [[3000.0]]
    path = tmp_path / "changed.json"
    for change, code, words in (
        ({}, 3, "not proved: the id is the SHA-256 of the content"),
        ({"id": identity(data)}, 3, "not proved: V_hat of cx is Delta_V-OSP"),
        ({"asked": {"objective": "stiffest"}}, 2, "found the keys ['asked']"),
        ({"version": 3}, 2, "key 'asked' is missing"),
    ):
        path.write_text(json.dumps(data | change))
        done = manyhands_command("verify", path)
        assert (done.exit_code, words in done.stderr) == (code, True), done.stderr


def test_what_was_asked_is_shown_and_called_no_claim(feasible: Path) -> None:
    line = "recorded as asked for, which is no claim and not proved: coupling spring-damper, objective feasible"
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


def test_a_0_5_0_certificate_gives_the_same_invitation_line(stiffest: Path, tmp_path: Path) -> None:
    """The request behind it is unknown: the program reports this, and goes on as 0.5.0 did."""
    bundle = tmp_path / "dx.bundle"
    done = manyhands_command("invite", stiffest, "dx", "--certificate", old("example1"), "--insecure", "-o", bundle)
    assert done.exit_code == 0, done.stderr
    assert f"{old('example1')}: {NOT_RECORDED}" in done.stderr.splitlines()
    assert bundle.exists()


def test_a_run_keeps_and_audits_its_0_5_0_certificate(tmp_path: Path) -> None:
    """The copy in the recording is the file itself, of version 2 and with its own id; its rungs are made now."""
    prepared = prepare(load_named("example1.yaml"), old("example1"))
    kept = kept_files(prepared)
    assert kept[CERTIFICATE_FILE] == old("example1").read_bytes()
    assert prepared.ladder is not None
    first, *softer = prepared.ladder.rungs
    assert (first.version, [rung.version for rung in softer]) == (2, [3, 3, 3])
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
    assert "found another order of keys, or other forms of numbers, than manyhands writes" in done.stderr
