"""What a device does by itself: from its driver into report, recording, summary and audit."""

from __future__ import annotations

import json
from pathlib import Path

from ..support.commands import run

DRIVER = """
from dataclasses import replace

from tests.support.plugin_drivers import Counterpart


class Heavy(Counterpart):
    def specification(self):
        deeds = ("compensates gravity by a force of its own", "passes 30 % of each force through a filter")
        return replace(super().specification(), by_itself=deeds)
"""

SENTENCE = (
    "d does by itself, outside the certificate: rests on a spring; compensates gravity by a force of its own; "
    "passes 30 % of each force through a filter"
)

SESSION = """
session: heavy
period: 0.001
devices:
  d:
    dof: 1
    osp: 1.37
    driver: "heavy:Heavy"
    by_itself: [rests on a spring]
    limits: {force: 8, displacement: 0.2, speed: 2}
  other: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}
couplings:
  c: {devices: [d]}
  co: {devices: [other]}
environment:
  type: network
  links:
    - {between: [d, ground], stiffness: 400, damping: 0.5}
    - {between: [other, ground], stiffness: 400, damping: 0.5}
design: {coupling: spring-damper}
"""


def test_what_a_device_does_by_itself_stands_beside_the_certificate(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    (tmp_path / "heavy.py").write_text(f"import sys\nsys.path.append({str(root)!r})\n{DRIVER}")
    (tmp_path / "heavy.yaml").write_text(SESSION)
    designed = " ".join(run("design", tmp_path / "heavy.yaml").split())
    assert "d does by itself, outside the certificate: rests on a spring" in designed  # what its session states of it
    recording, report = tmp_path / "heavy.mcap", tmp_path / "heavy.json"
    files = ("--record", recording, "--report", report)
    run("launch", tmp_path / "heavy.yaml", "--clock", "simulated", "--duration", "0.3", *files)
    plain = json.loads(report.read_text())
    assert plain["by_itself"] == {"d": SENTENCE.partition(": ")[2].split("; ")}
    assert [row["who"] for row in plain["promises"] if SENTENCE in row["remark"]] == [["d"]]
    assert json.loads(run("info", recording, "--json"))["by_itself"] == plain["by_itself"]
    assert SENTENCE in " ".join(run("info", recording).split())
    assert SENTENCE in " ".join(run("audit", recording).split())
