"""The shipped mesh in closed loop: certified, proved, felt, and with every account kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from manyhands.design.certificate import content
from manyhands.design.proof import prove
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import MeshEnvironment, load_session
from manyhands.launch.simulation import Silence, Simulation
from manyhands.nodes.environment.enforced import EnforcedCore

SHIPPED = Path(__file__).parents[2] / "launch" / "sessions"


def test_stroke_is_proved_and_keeps_every_account_without_its_controller() -> None:
    """Also while one user is frozen on the relief and comes back. Ridges and dome are felt; nothing goes through."""
    session = load_session(SHIPPED / "stroke.yaml")
    prepared = prepare(session)
    certificate = prepared.certificate
    assert certificate is not None
    findings = prove(content(certificate) | {"id": certificate.id})
    assert all(finding.holds for finding in findings)
    level = next(finding for finding in findings if "(14)" in finding.condition)
    assert (level.enforced, level.argument) == (
        True,
        "kept by the proxy test at every tick, whatever positions are proposed",
    )
    assert {float(np.linalg.eigvalsh(session.osp_level(name))[0]) for name in session.devices} == {1.37}
    simulation = Simulation(prepared)
    recording = simulation.run(2000, faults=[Silence("to_ben", 900, 1200)])
    core = simulation.environment
    assert isinstance(core, EnforcedCore)
    assert core.controller is not None
    assert core.controller.ticks == 0
    assert sum(core.held) <= 5
    assert min(ledger.minimum for ledger in simulation.ledgers.values()) >= 0.0
    assert not recording.f_v[900:1200, 3:].any()
    for ports in (slice(0, 3), slice(3, 6)):
        felt = np.linalg.norm(recording.f_v[:, ports], axis=1)
        assert 1.0 < felt.max() < 8.0
        assert felt[1500:].max() > 0.5
    assert isinstance(session.environment, MeshEnvironment)
