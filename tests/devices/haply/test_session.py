"""A session with the fake's Inverse3 and VerseGrip: the grip turns a tool in MuJoCo in real time, and feels nothing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.audit import AuditVerdict, audit
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.recordings.run import read_run, rows_of
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import Session
from manyhands.protocol.channels import ORIENTATION, TOLD

from ...fakes.haply import fake_haply
from ...support.slot import told

TIMES = {"sample_age": 9e-4, "actuation_delay": 9e-4}


@pytest.mark.alone
def test_a_grip_turns_its_tool(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    turned = [math.cos(0.1), math.sin(0.1), 0.0, 0.0]  # about the stick's own axis, about which it turns freely
    with fake_haply(turned=turned) as one:
        data = told({"sensed": True, "stiffness": 0.1}, driver="haply-inverse3")
        data["devices"]["pen"] |= {
            "osp": 20.0,
            "parameters": {"port": one.port, "events": one.events, "silence": 0.9, **TIMES},
            **TIMES,
            "held": "torque",
            "linkage": {"kappa": 0.01},
            "limits": {"force": 4, "displacement": 0.15, "speed": 1},
        }
        del data["devices"]["pen"]["mass"]
        data |= {"period": 0.002, "design": {"coupling": "spring-damper", "tau": 0.002}}
        prepared, path = prepare(Session.from_dict(data)), tmp_path / "run.mcap"
        recorder, ways = RecorderProcess(prepared, "realtime", path), reach(prepared, "ipc")
        outcome = Supervisor(
            prepared, clock="realtime", reach=ways, ticks=400, record=False, recorder=recorder
        ).run()  # fmt: skip
    assert (outcome.code, outcome.faults) == (0, ())
    run = read_run(path)
    R, tool = rows_of(run, "pen", ORIENTATION), rows_of(run, "environment", TOLD)
    known = np.isfinite(R).all(axis=1)
    assert known.sum() > 200
    assert R[known] == pytest.approx(np.tile(turned, (int(known.sum()), 1)))
    assert tool[np.isfinite(tool).all(axis=1)][-1, :4] == pytest.approx(turned, abs=1e-3)
    assert audit(path, run, lambda text: None, lambda tick: None).verdict is not AuditVerdict.BROKEN
