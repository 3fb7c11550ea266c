"""Blocks of V that need data their processes may not read or write are neither designed nor launched."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from manyhands.design.certificate import identity, save
from manyhands.launch.app.cli import app
from manyhands.launch.plan.access import capability_violations
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session, SessionError, load_session

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
GIVEN = ["design.coupling=given", "design.stiffness=705", "design.damping=0.037"]


@settings(max_examples=60)
@given(data=st.data())
def test_every_port_outside_its_process_is_named(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    session = data.draw(drawn_sessions)
    names = list(session.couplings)
    structure: dict[str, list[str]] = {name: [] for name in names}
    for port in session.ports:
        structure[data.draw(st.sampled_from(names))].append(port)
    found = capability_violations(session, Plan(session).access, structure)
    wrong = [(b, p) for b, ports in structure.items() for p in ports if p not in session.blocks_by_name[b]]
    assert len(found) == len(wrong)
    for (block, port), sentence in zip(wrong, found, strict=True):
        (owner,) = [name for name, ports in session.blocks_by_name.items() if port in ports]
        assert f"the block {block!r} touches the port {port!r} of the coupling {owner!r}" in sentence


def test_blocks_and_ports_that_the_session_does_not_have() -> None:
    plan = Plan(load_session(SESSIONS / "example1.yaml"))
    assert capability_violations(plan.session, plan.access, {"cx": ["dx", "dw"], "cw": ["dy"]}) == [
        "the block 'cx' touches the port 'dw' of none of the couplings; the process 'cx' may read and write dx alone",
        "the block 'cw' has no process; expected one of cx, cy, cz",
    ]


def launch(session: str, overrides: list[str], certificate: Path) -> Result:
    settings = [argument for override in overrides for argument in ("--set", override)]
    return CliRunner().invoke(
        app,
        ["launch", session, "--duration", "1", "--clock", "simulated", "--certificate", str(certificate), *settings],
    )


@pytest.mark.usefixtures("own_interrupt")
def test_a_certificate_whose_block_leaves_its_process_is_refused_at_launch(tmp_path: Path) -> None:
    """It holds, for a coupling in which one process sees two hands; here that process may see one."""
    joined = load_session(
        SESSIONS / "example1.yaml", ["couplings={cx: {devices: [dx, dy]}, cz: {devices: [dz]}}", *GIVEN]
    )
    certificate = prepare(joined).certificate
    assert certificate is not None
    save(certificate, tmp_path / "joined.json")
    result = launch("example1", GIVEN, tmp_path / "joined.json")
    assert result.exit_code == 3
    sentence = "the block 'cx' touches the port 'dy' of the coupling 'cy'; the process 'cx' may read and write dx alone"
    assert sentence in result.stderr
    assert result.stdout == ""


@pytest.mark.usefixtures("own_interrupt")
def test_a_stolen_certificate_with_two_blocks_exchanged_is_refused_at_launch(tmp_path: Path) -> None:
    """A thief can also compute the file's id anew; the rights of the processes are not in the file."""
    certificate = prepare(load_session(SESSIONS / "example1.yaml", GIVEN)).certificate
    assert certificate is not None
    save(certificate, tmp_path / "honest.json")
    data = json.loads((tmp_path / "honest.json").read_text())
    data["structure"] |= {"cx": ["dy"], "cy": ["dx"]}
    data["levels"]["Phi_E"]["cx"], data["levels"]["Phi_E"]["cy"] = (data["levels"]["Phi_E"][n] for n in ("cy", "cx"))
    (tmp_path / "edited.json").write_text(json.dumps(data))
    result = launch("example1", GIVEN, tmp_path / "edited.json")
    assert (result.exit_code, "id" in result.stderr) == (3, True)
    data["id"] = identity(data)
    (tmp_path / "edited.json").write_text(json.dumps(data))
    result = launch("example1", GIVEN, tmp_path / "edited.json")
    assert result.exit_code == 3
    assert "the block 'cx' touches the port 'dy' of the coupling 'cy'" in result.stderr


@settings(max_examples=40)
@given(data=st.data())
def test_a_block_needing_data_its_process_may_not_read_is_refused(
    drawn_plain_sessions: st.SearchStrategy[dict[str, Any]], data: st.DataObject, tmp_path: Path
) -> None:
    plain = data.draw(drawn_plain_sessions)
    session = Session.model_validate(plain)
    assume(len(session.ports) > 1)
    i, j = sorted(data.draw(st.permutations(range(len(session.ports))))[:2])
    key = data.draw(st.sampled_from(["stiffness", "damping"]))
    matrix = (700.0 * np.eye(len(session.ports))).tolist()
    matrix[i][j] = matrix[j][i] = 1e-6
    plain["design"] = {"coupling": "given", "stiffness": 700.0, key: matrix}
    path = tmp_path / "session.yaml"
    path.write_text(json.dumps(plain))
    owner = {port: name for name, ports in session.blocks_by_name.items() for port in ports}
    a, b = session.ports[i], session.ports[j]
    if owner[a] == owner[b]:
        assert haptic_loop(load_session(path)).partition.mask()[i, j]
        return
    with pytest.raises(SessionError) as caught:
        load_session(path)
    assert caught.value.key == f"design.{key}.{i}.{j}"
    assert caught.value.found == f"1e-06 between {a!r} of coupling {owner[a]!r} and {b!r} of coupling {owner[b]!r}"
    assert caught.value.expected == "0 between ports of different couplings, or one coupling with both ports"
