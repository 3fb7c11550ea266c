"""The shipped mesh in closed loop: certified, proved, felt within the cone of friction, and with every account kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.design.certificate import content
from manyhands.design.models.distance_grid import grid_of_text
from manyhands.design.proof import prove
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import MeshEnvironment, load_session
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.mesh import CONE_TOLERANCE, Lookup

SHIPPED = Path(__file__).parents[3] / "launch" / "sessions"
TICKS = 2000
FROZEN = range(900, 1200)  # to_ben


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SHIPPED / "stroke.yaml"))


def test_stroke_is_proved(prepared: Prepared) -> None:
    certificate = prepared.certificate
    assert certificate is not None
    findings = prove(content(certificate) | {"id": certificate.id})
    assert all(finding.holds for finding in findings)
    level = next(finding for finding in findings if "(14)" in finding.condition)
    assert level.enforced
    assert level.argument == "kept by the proxy test at every tick, whatever positions are proposed"
    session = prepared.session
    assert {float(np.linalg.eigvalsh(session.osp_level(name))[0]) for name in session.devices} == {1.37}


def test_stroke_keeps_every_account_and_the_cone_of_friction(prepared: Prepared) -> None:
    """Also while one user is frozen on the relief and comes back; the controller has nothing to do."""
    simulation = Simulation(prepared)
    traces = simulation.traces(TICKS)
    simulation.run(TICKS, faults=[Silence("to_ben", FROZEN.start, FROZEN.stop)], traces=traces)
    rows = {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}
    core = simulation.environment
    assert isinstance(core, EnforcedCore)
    assert core.controller is not None
    assert core.controller.ticks == 0
    assert sum(core.held) <= 5
    assert min(ledger.minimum for ledger in simulation.ledgers.values()) >= 0.0
    assert rows["ben", "f_v"][FROZEN.start - 1].any()
    assert not rows["ben", "f_v"][FROZEN].any()
    world = prepared.session.environment
    assert isinstance(world, MeshEnvironment)
    lookup = Lookup(grid_of_text(world.model))
    for name, ports in (("anna", slice(0, 3)), ("ben", slice(3, 6))):
        forces = np.nan_to_num(rows[f"to_{name}", "f_v"])  # while it is silent it has no rows
        tools = rows["environment", "x_e"][:, ports]
        assert 1.0 < np.linalg.norm(forces, axis=1).max() < 8.0
        settled = [k for k in range(TICKS) if forces[k].any() and (name == "anna" or k not in range(900, 1500))]
        assert len(settled) > 1200
        for k in settled:
            x, y, z = (np.array(world.tools[name].at) + tools[k] + forces[k] / world.stiffness).tolist()
            distance, *slope = lookup((x, y, z))
            n = np.array(slope) / np.linalg.norm(slope)
            normal = float(forces[k] @ n)
            assert normal > 0.0
            # the coupling gives way along all axes alike up to 1e-4
            across = float(np.linalg.norm(forces[k] - normal * n))
            assert across <= (world.friction + CONE_TOLERANCE + 3e-4) * normal
            assert abs(distance - world.tools[name].radius) < 1e-6
