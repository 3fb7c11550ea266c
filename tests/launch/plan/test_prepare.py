"""A run needs a certificate: designed, read and proved again, or refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from manyhands.design.certificate import from_content, identity, save, to_json
from manyhands.design.errors import CertificateError
from manyhands.launch.plan.certificates import read_certificate
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import certificate_files, prepare
from manyhands.launch.plan.sites import IN_TICK
from manyhands.launch.session import load_session
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
GIVEN = ["design.coupling=given", "design.stiffness=705", "design.damping=0.037"]


def test_a_certificate_from_a_file_is_proved_again_and_used(tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1.yaml", GIVEN)
    designed = prepare(session)
    assert designed.certificate is not None
    save(designed.certificate, tmp_path / "c.json")
    read = prepare(session, tmp_path / "c.json")
    assert read.id == designed.id
    assert [b.D.tolist() for b in read.blocks] == [b.D.tolist() for b in designed.blocks]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("environment.links.0.stiffness=3801", "the environment differs"),
        ("devices.dx.osp=1.3", "the level or order of devices differs"),
        ("period=0.0011", "the period differs"),
        ("session=other", "the session's name differs"),
        ("design.stiffness=706", "the coupling is not the one"),
        ("design.tau=0.0001", "the delay inside the tick differs"),
        ("design.period_tolerance=0.1", "the period tolerance differs"),
        ("environment.delay=1", "the environment differs"),
    ],
)
def test_another_sessions_certificate_is_refused(override: str, words: str, tmp_path: Path) -> None:
    certificate = prepare(load_session(SESSIONS / "example1.yaml", GIVEN)).certificate
    assert certificate is not None
    save(certificate, tmp_path / "c.json")
    with pytest.raises(NotCertified, match=words):
        prepare(load_session(SESSIONS / "example1.yaml", [*GIVEN, override]), tmp_path / "c.json")


def test_a_forged_certificate_is_refused(tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1.yaml", GIVEN)
    certificate = prepare(session).certificate
    assert certificate is not None
    save(certificate, tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text())
    data["levels"]["Delta_V"]["cx"][0][0] *= 1.5
    (tmp_path / "forged.json").write_text(json.dumps(data))
    with pytest.raises(NotCertified, match="id"):
        prepare(session, tmp_path / "forged.json")
    data["id"] = identity(data)
    (tmp_path / "resealed.json").write_text(json.dumps(data))
    assert from_content(data).id != certificate.id
    with pytest.raises(NotCertified, match="not proved"):
        prepare(session, tmp_path / "resealed.json")
    with pytest.raises(CertificateError, match="absent"):
        prepare(session, tmp_path / "absent.json")


def test_a_file_that_only_the_proof_refuses_is_no_certificate(tmp_path: Path) -> None:
    """The two readers differ in what they look at; either's refusal is bad input, with the file's name."""
    certificate = prepare(load_session(SESSIONS / "example1.yaml", GIVEN)).certificate
    assert certificate is not None
    save(certificate, tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text())
    data["margins"]["(10)"] = True
    data["id"] = identity(data)
    (tmp_path / "odd.json").write_text(json.dumps(data))
    with pytest.raises(CertificateError, match=r"odd\.json: margins\.\(10\): found True"):
        read_certificate(tmp_path / "odd.json")


def test_a_session_without_wave_links_is_the_one_part_in_the_tick() -> None:
    prepared = prepare(load_session(SESSIONS / "example1.yaml", GIVEN))
    assert prepared.parts.keys() == {IN_TICK}
    assert prepared.world is None
    assert prepared.certificate is prepared.parts[IN_TICK] is prepared.certificate_of("dx")
    assert prepared.id == prepared.parts[IN_TICK].id
    assert certificate_files(prepared) == {CERTIFICATE_FILE: to_json(prepared.parts[IN_TICK]).encode()}


def test_a_run_may_be_designed_with_a_delay() -> None:
    session = load_session(SESSIONS / "example1.yaml", [*GIVEN, "design.tau=0.0002"])
    prepared = prepare(session)
    assert prepared.certificate is not None
    assert prepared.certificate.tau == prepared.loop.tau == 0.0002
    assert prepared.certificate.levels.device.share < 1.0


def test_uncertified_runs_the_coupling_that_the_session_states() -> None:
    stiff = load_session(SESSIONS / "example1.yaml", ["design.coupling=given", "design.stiffness=3000"])
    with pytest.raises(NotCertified, match="2740"):
        prepare(stiff)
    prepared = prepare(stiff, uncertified=True)
    assert prepared.certificate is None
    assert (prepared.certified, dict(prepared.parts), certificate_files(prepared)) == (False, {}, {})
    assert prepared.id.startswith("uncertified-")
    assert prepared.blocks[0].response(1.0).real[0, 0] == pytest.approx(1 / 3000, rel=1e-9)
    uncoupled = prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True)
    assert uncoupled.blocks[0].D.tolist() == [[0.0]]
