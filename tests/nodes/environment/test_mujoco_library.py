"""Which MuJoCo is accepted: one, of a tested version; never two that have overwritten each other."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import pytest

from manyhands.extras import MissingExtra
from manyhands.nodes.environment import mujoco_library
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.environment.mujoco_library import WrongMujoco, import_mujoco, require_one, require_tested
from manyhands.nodes.kernel.factory import FactoryError


@pytest.mark.parametrize(
    "found", [{}, {"mujoco": "3.17.0"}, {"mujoco-core": "4.0.1"}, {"mujoco": "4.0.0", "mujoco-core": "4.0.0"}]
)
def test_one_version_is_accepted_under_either_name(found: dict[str, str]) -> None:
    require_one(found)


def test_two_versions_are_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    two = {"mujoco": "3.17.0", "mujoco-core": "4.0.1"}
    monkeypatch.setattr(mujoco_library, "installed", lambda: two)
    with pytest.raises(
        FactoryError, match=r"^found mujoco 3\.17\.0 and mujoco-core 4\.0\.1, which write the same files"
    ):
        MujocoEngine(("p",), 1e-3, {"model": "<mujoco/>", "tools": [], "bodies": [], "stiffness": []})


@pytest.mark.parametrize("number", ["3.2.7", "3.17.0", "4.0.1", "4.9"])
def test_tested_versions_are_taken(number: str) -> None:
    require_tested(number)


@pytest.mark.parametrize("number", ["2.3.7", "3.2.6", "5.0.0"])
def test_others_are_refused(number: str) -> None:
    with pytest.raises(WrongMujoco, match=f"^found MuJoCo {number}; expected one that was tested: pip install"):
        require_tested(number)


def test_none_is_a_missing_extra_and_half_of_one_is_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    half: Any = ModuleType("mujoco")  # what a removed mujoco-core leaves of a mujoco 3
    monkeypatch.setitem(sys.modules, "mujoco", half)
    monkeypatch.setattr(mujoco_library, "installed", lambda: {"mujoco": "3.17.0"})
    with pytest.raises(WrongMujoco, match=r"^found mujoco 3\.17\.0, of which files are missing"):
        import_mujoco()
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr(mujoco_library, "installed", dict)
    with pytest.raises(MissingExtra, match=r"^found no mujoco; expected the extra mujoco"):
        import_mujoco()
