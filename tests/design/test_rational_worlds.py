"""Worlds given as rational functions with slow poles: certified wherever an LMI of other code finds a level.

`MANYHANDS_WIDE=1 .venv/bin/pytest tests/design/test_rational_worlds.py` tries 500 of them.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from manyhands.design.certificate import Certificate, content, from_content, identity, to_json
from manyhands.design.errors import DesignError
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import TransferEnvironment
from manyhands.design.models.transfer import InDifferences
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.proof import prove
from manyhands.design.synthesis import design

from ..support.cases import searched
from ..support.rational_worlds import RationalWorld, T, Term, random_world

_CERTAINLY = 0.98  # of the devices' level: a world that needs less is certified; nearer to 1 there is no room to prove
_NEVER = 1.0 + 1e-6  # of it: the LMI's own tolerance is 1e-8


def slow(osp: float = 1.37) -> HapticLoop:
    """0.5 s^2 + 500 + 1000 s/(s + 0.5) on one port at 1 kHz."""
    world = TransferEnvironment(("p",), ((((0.5, 0.25, 1500.0, 250.0), (1.0, 0.5)),),))
    return HapticLoop(
        "slow", T, ("p",), (DeviceLevel("d", (0,), np.array([[osp]])),), Partition(("c",), ((0,),)), world
    )


def certified(loop: HapticLoop, wish: Wish | None = None) -> Certificate:
    found = design(loop, SpringDamperWanted(wish or Wish())).certificate
    assert from_content(json.loads(to_json(found))).id == found.id
    return found


def fails(data: dict) -> list[str]:
    """The conditions that the proof refuses, with a right id."""
    return [f.condition for f in prove(data | {"id": identity(data)}) if not f.holds]


def test_a_mass_and_a_slow_relaxation_are_certified() -> None:
    found = certified(slow())
    assert isinstance(found.levels.P_E, InDifferences)
    least = min(
        RationalWorld((Term((1,), (0.5, 0.25, 1500.0, 250.0), (1.0, 0.5), ()),), (1.37,), 0).dissipation(a)[0][0, 0]
        for a in np.geomspace(1e-7, np.pi, 2000)
    )
    assert found.levels.Phi_E[0, 0] == pytest.approx(-least, rel=1e-2)  # the figure: +1.457
    assert found.margins["(10)"] > 1.0


@pytest.mark.wide
def test_random_worlds_are_refused_only_where_an_lmi_refuses() -> None:
    refused, accepted, undecided = [], 0, 0
    for seed in range(searched(8, 40)):
        world = random_world(np.random.default_rng([2701, seed]))
        needed = world.needed()
        try:
            found = certified(world.loop())
        except DesignError as error:
            undecided += bool(np.isnan(needed))
            if needed < _CERTAINLY:
                refused.append(f"{seed}: needs {needed:.4g}, {error}")
            continue
        assert not needed >= _NEVER, f"{seed}: a false certificate"
        accepted += 1
        for angle in np.geomspace(1e-6, np.pi, 50):  # and by the terms themselves, frequency by frequency
            H, size = world.dissipation(angle)  # H is the small part of E_hat: coefficients are rounded to 1e-16 of it
            assert np.linalg.eigvalsh(H + found.levels.Phi_E)[0] > -1e-12 * size, seed
    assert not refused, "\n".join(refused)
    assert accepted > 0
    assert not undecided  # refused by the design, and the LMI of other code gave up: look at the world


def test_the_form_in_z_is_still_proved_and_differences_are_for_rational_functions_alone() -> None:
    """A fast world's certificate of an older file has its matrix in later and later values: P_z = S' P S."""
    world = TransferEnvironment(("p",), ((((50.0, 5000.0), (1.0, 200.0)),),))
    loop = HapticLoop("f", T, ("p",), (DeviceLevel("d", (0,), np.eye(1)),), Partition(("c",), ((0,),)), world)
    data = content(certified(loop))
    own = data["storage"]["E_hat"]
    older = data | {"storage": data["storage"] | {"E_hat": own["differences"]}}  # of order 1 both forms agree
    assert not fails(older)
    assert fails(data | {"storage": data["storage"] | {"E_hat": {"differences": [[-1.0]]}}})
    system = {"type": "state-space", "A": [[-200.0]], "B": [[1.0]], "C": [[-4950.0 * 1.0]], "D": [[50.0]]}
    other = data | {"environment": system | {"time": "continuous", "method": "backward-euler", "delay": 0}}
    assert any("ISP" in condition for condition in fails(other))


@pytest.mark.parametrize("order", [2, 3])
def test_both_forms_are_one_world(order: int) -> None:
    """P in differences and S' P S in the form in z prove the same, for S of binomial coefficients."""
    den = np.poly(-np.array([150.0, 400.0, 700.0])[:order])
    num = 800.0 * np.polyadd(den, np.polymul([0.4], np.poly(-np.array([150.0, 400.0, 700.0])[: order - 1]) * 100.0))
    world = TransferEnvironment(("p",), (((tuple(num), tuple(den)),),))
    loop = HapticLoop("f", T, ("p",), (DeviceLevel("d", (0,), np.eye(1)),), Partition(("c",), ((0,),)), world)
    data = content(certified(loop))
    P = np.array(data["storage"]["E_hat"]["differences"])
    S = np.array([[1.0, 0, 0], [-1.0, 1.0, 0], [1.0, -2.0, 1.0]])[:order, :order]
    in_z = S.T @ P @ S
    assert not fails(data | {"storage": data["storage"] | {"E_hat": ((in_z + in_z.T) / 2.0).tolist()}})
    assert fails(data | {"storage": data["storage"] | {"E_hat": P.tolist()}})  # the same numbers, read as in z


@pytest.mark.parametrize("objective", ["loop-shaping", "closed-loop"])
def test_its_transparency_is_claimed_in_differences(objective: str) -> None:
    p = float(np.exp(-0.05))
    aim = Transparency(objective, Filter((1.0 - p,), (1.0, -p)), Filter((1.0,), (1.0,)))  # type: ignore[arg-type]
    found = certified(slow(), Wish(objective, aim))  # type: ignore[arg-type]
    assert found.transparency is not None
    assert isinstance(found.transparency.P, InDifferences)
    data = content(found)
    assert fails(data | {"transparency": data["transparency"] | {"P": data["transparency"]["P"]["differences"]}})
