"""The session of the page, and the figures that it says are the fake's."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import pytest
import yaml

from manyhands.devices.force_dimension import ForceDimension
from manyhands.devices.force_dimension.survey import bending
from manyhands.launch.session import load_session
from manyhands.nodes.device.specification import AxisMap, promises_too_much

from ...fakes.dhd import LINKAGE, MIDDLE, OwnTime, fake_devices

PAGE = Path(__file__).parents[3] / "docs" / "devices" / "force-dimension.md"


def blocks() -> list[str]:
    return re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_session_promises_no_more_than_the_driver_states_of_the_fake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "desk.yaml"
    path.write_text(blocks()[0], encoding="utf-8")
    session = load_session(path)
    plain = yaml.safe_load(blocks()[0])["devices"]["omega"]
    device = session.devices["omega"]
    with fake_devices() as devices:
        given = {**plain["parameters"], "library": devices.path}
        with closing(ForceDimension(("x", "y", "z"), session.period, given, OwnTime(devices))) as driver:
            stated = driver.specification()
            monkeypatch.setattr("manyhands.devices.force_dimension.survey.FINE", 3)  # its corners have the greatest
            assert bending(driver.kinematics, 0.03) <= plain["linkage"]["kappa"]
    limits = ((3.0,) * 3, (0.03,) * 3, (1.0,) * 3)
    own = AxisMap((0, 1, 2), (1.0,) * 3)
    assert list(promises_too_much(stated, own, limits, device.timing, None, (plain["step"],) * 3)) == []


def test_the_kinematics_are_the_fakes() -> None:
    linkage = yaml.safe_load(blocks()[1])["linkage"]
    box = {"low": [-0.03, -0.03, MIDDLE - 0.03], "high": [0.03, 0.03, MIDDLE + 0.03]}
    assert {key: linkage[key] for key in LINKAGE} == LINKAGE
    for end, place in box.items():
        assert linkage[end] == pytest.approx(place)
