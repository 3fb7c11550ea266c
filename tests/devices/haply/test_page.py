"""docs/devices/haply-inverse3.md is true: its session is one, and its table has the driver's parameters."""

from __future__ import annotations

import re
from pathlib import Path

from manyhands.devices.haply.driver import PARAMETERS, HaplyInverse3
from manyhands.launch.session.session import load_session
from manyhands.nodes.kernel.factory import DRIVERS, SHIPPED

PAGE = (Path(__file__).parents[3] / "docs" / "devices" / "haply-inverse3.md").read_text()


def test_the_session_of_the_page_is_one(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "inverse3.yaml").write_text(block)
    device = load_session(tmp_path / "inverse3.yaml").devices["hand"]
    assert device.driver == SHIPPED[DRIVERS]["haply-inverse3"] == f"manyhands.devices.haply:{HaplyInverse3.__name__}"
    assert device.parameters is not None
    assert device.parameters is not None
    assert device.parameters.keys() <= PARAMETERS.keys()
    assert device.timing.latency <= 0.001


def test_the_table_has_every_parameter() -> None:
    table = PAGE.partition("| parameter |")[2].partition("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", "".join(row.split("|")[1] for row in table.splitlines()[2:]))) == set(PARAMETERS)
