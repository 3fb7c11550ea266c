"""Bundles round-trip exactly, are readable by their owner alone, and other files are refused clearly."""

from __future__ import annotations

import dataclasses
import json
import stat
from pathlib import Path

import numpy as np
import pytest

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import (
    BundleError,
    CouplingBundle,
    DeviceBundle,
    DeviceRung,
    EnvironmentBundle,
    decoded,
    encoded,
    load,
    save,
)

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    """Example 1 with a coupling of its own for each hand, so that no number belongs to two."""
    overrides = ["design.coupling=given", "design.stiffness=[704.9058, 704.9336, 704.8754]", "design.damping=0.0372"]
    return prepare(load_session(SESSIONS / "example1.yaml", overrides))


def test_round_trip_is_exact(prepared: Prepared, tmp_path: Path) -> None:
    bundles = cut(prepared, RunPlan("simulated", tmp_path, "ipc:///nowhere"))
    for name, kind in (("dx", DeviceBundle), ("cy", CouplingBundle), ("environment", EnvironmentBundle)):
        path = tmp_path / f"{name}.bundle"
        save(bundles[name], path)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        read, written = load(path, kind), bundles[name]
        assert read.common == written.common
        again = tmp_path / f"{name}.again"
        save(read, again)
        assert again.read_bytes() == path.read_bytes()


def test_a_devices_bundle_of_an_older_recording_has_a_tank_and_neither_inertia_nor_torques(
    prepared: Prepared, tmp_path: Path
) -> None:
    data = json.loads(encoded(cut(prepared, RunPlan("realtime", tmp_path, "ipc:///nowhere"))["dx"]))
    del data["allowance"], data["inertia"], data["held"]
    for tank, allowance in ((2e-3, LatenessAllowance(2e-3)), (None, None)):
        older = decoded({**data, "tank": tank}, DeviceBundle, tmp_path)
        assert (older.allowance, older.inertia, older.held) == (allowance, None, None)


def test_held_torques_leave_a_part_of_the_level_to_each_rungs_promise(prepared: Prepared, tmp_path: Path) -> None:
    device = cut(prepared, RunPlan("realtime", tmp_path, "ipc:///nowhere"))["dx"]
    assert isinstance(device, DeviceBundle)
    assert [level is device.osp for level in device.levels] == [True] * len(device.rungs)
    longer = dataclasses.replace(device.rungs[0], tau=2e-3)
    held = HeldTorque(18.0, 12.0, 1.0)
    holds = dataclasses.replace(device, held=held, rungs=(device.rungs[0], longer))
    for rung, level, promise in zip(holds.rungs, holds.levels, holds.promises, strict=True):
        left = held.left(device.osp, device.common.period, rung.tau, rung.period_tolerance)
        assert left is not None
        assert level.tolist() == left.tolist()
        assert promise.level.tolist() == (rung.share.share * left).tolist()
        K = rung.share.kappa * device.common.period * np.linalg.inv(left)
        assert pytest.approx(K, rel=1e-14) == promise.K
    assert holds.levels[1][0, 0] < holds.levels[0][0, 0] < device.osp[0, 0]
    again = decoded(json.loads(encoded(holds)), DeviceBundle, tmp_path)
    assert (again.held, again.levels[1].tolist()) == (held, holds.levels[1].tolist())
    with pytest.raises(ValueError, match=r"held: found an osp of 1\.37 N·s/m; expected more than the .* N·s/m that"):
        dataclasses.replace(holds, held=HeldTorque(18.0, 400.0, 1.0))


def test_a_node_is_given_its_own_part_and_nothing_else(prepared: Prepared, tmp_path: Path) -> None:
    """No number of another user's block, and no name but those of its own peers, is in a bundle's file.

    Of the blocks the environment has D_V alone, for the rungs at which they stay as they are.
    """
    bundles = cut(prepared, RunPlan("simulated", tmp_path, "ipc:///nowhere"))
    texts = {}
    for name, bundle in bundles.items():
        save(bundle, tmp_path / name)
        texts[name] = (tmp_path / name).read_text()
    assert prepared.certificate is not None
    blocks = dict(zip(("cx", "cy", "cz"), prepared.blocks, strict=True))
    for name, text in texts.items():
        for owner, block in blocks.items():
            assert (repr(float(block.A[0, 0])) in text) == (name == owner), (name, owner)
            assert (repr(float(block.D[0, 0])) in text) == (name in (owner, "environment")), (name, owner)
    assert '"dy"' not in texts["dx"]
    assert '"cy"' not in texts["dx"]
    assert '"dy"' not in texts["cx"]
    assert "3800" not in texts["dx"]  # the environment's stiffness
    assert not any(device in texts["environment"] for device in ('"name": "dx"', '"role": "device"'))


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"common": 3}', "\x00"])
def test_what_is_no_bundle_is_refused_by_name(text: str, tmp_path: Path) -> None:
    path = tmp_path / "dx.bundle"
    path.write_text(text)
    with pytest.raises(BundleError, match=r"dx\.bundle"):
        load(path, DeviceBundle)
    with pytest.raises(BundleError, match=r"absent"):
        load(tmp_path / "absent", CouplingBundle)


def test_an_uncertified_run_promises_nothing(tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1-uncoupled.yaml")
    bundles = cut(prepare(session, uncertified=True), RunPlan("simulated", tmp_path, ""))
    coupling, environment, device = bundles["cx"], bundles["environment"], bundles["dx"]
    assert isinstance(coupling, CouplingBundle)
    assert isinstance(device, DeviceBundle)
    assert device.rungs == (DeviceRung(0.0, 0.0, DeviceShare(0.5, 1.0, 0.0)),)
    assert isinstance(environment, EnvironmentBundle)
    assert coupling.level is None
    assert environment.Phi_E is None
    assert np.all(coupling.block.D == 0.0)
