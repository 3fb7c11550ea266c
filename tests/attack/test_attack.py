"""The seeded part of the attack, and the once false certificates: none of them is proved again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import ctx

from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.proof.ladder import prove_ladder
from tests.attack.arithmetic import BITS
from tests.attack.campaign import Tally, accepted, session
from tests.attack.forgeries import CHANGES, sealed
from tests.attack.loop import Hand, Repeating, Tick, growth
from tests.attack.oracle import CERTAIN, judge, judge_ladder
from tests.attack.parties import precise
from tests.attack.sessions import KINDS, designed

CERTIFICATES = Path(__file__).parent / "certificates"
FALSE = sorted(path.stem for path in CERTIFICATES.glob("*.json") if not path.stem.startswith("ladder"))
CLASSES = (*KINDS, "ladder", *(f"forged: {change}" for change in CHANGES), "forged: ladder")
MOST_SESSIONS = 200
FORGERIES = len(CHANGES)
SLOW = ("encoder steps", "dry friction")
"""Kinds whose design or proof takes seconds; the other classes of forgeries have claims of other kinds."""


def read(name: str) -> Any:
    return json.loads((CERTIFICATES / f"{name}.json").read_text(encoding="utf-8"))


def test_nothing_that_is_proved_is_contradicted() -> None:
    """Sessions and forgeries until there is a claim of every class; `make campaign` does the same at length."""
    kinds, tally, missing = [*KINDS, "ladder"], Tally(), set(CLASSES)
    for seed in range(MOST_SESSIONS):
        kind = kinds[seed % len(kinds)]
        classes = {"forged: mechanism"} if kind in SLOW else {name for name in CLASSES if name.startswith("forged")}
        if kind in missing or seed < len(kinds) or classes & missing:
            tally.join(session(seed, kinds, FORGERIES))
        missing = {name for name in CLASSES if not tally.rows[name].claims}
        if not missing:
            break
    assert [(kind, findings) for kind, findings, _ in tally.found] == []
    assert not missing
    assert sum(row.refused for kind, row in tally.rows.items() if kind.startswith("forged")) > tally.claims / 4


@pytest.mark.parametrize("name", FALSE)
def test_a_certificate_that_was_false_is_not_proved(name: str) -> None:
    data = read(name)
    assert judge(data, np.random.default_rng(1)).findings
    assert not accepted(data)
    assert not accepted(sealed(data))


def statics(D: list[list[float]]) -> Environment:
    return StateSpaceEnvironment(("a", "b", "c")[: len(D)], StateSpace.static(np.array(D)))


NEGATIVE: dict[str, tuple[Environment, float]] = {
    "mass on a negative spring": (TransferEnvironment(("a",), ((((100.0, 0.5, -0.9), (1.0,)),),)), 1e-5),
    "negative beside stiff": (
        TransferEnvironment(
            ("a", "b"), ((((-500.0,), (1.0,)), ((0.0,), (1.0,))), (((0.0,), (1.0,)), ((1.0e15,), (1.0,))))
        ),
        1e-3,
    ),
    "negative matrix": (statics([[-0.9, 0.0], [0.0, 1e12]]), 1e-3),
    "not reciprocal": (statics([[600.0, 500.0, 0.0], [-500.0, 600.0, 0.0], [0.0, 0.0, 1e15]]), 1e-3),
    "tiny and negative": (statics([[-1e-11, 0.0], [0.0, 100.0]]), 1e-3),
}


@pytest.mark.parametrize("objective", ["feasible", "stiffest"])
@pytest.mark.parametrize("name", NEGATIVE)
def test_a_session_with_statics_that_are_not_passive_is_refused(name: str, objective: Any) -> None:
    environment, T = NEGATIVE[name]
    m = len(environment.ports)
    devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[1.37]])) for i in range(m))
    partition = Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
    loop = HapticLoop("pinned", T, environment.ports, devices, partition, environment)
    assert designed(loop, SpringDamperWanted(Wish(objective))) is None


def test_rungs_whose_mixture_no_device_promises_are_not_independent() -> None:
    """Each rung's Delta_D is below the device's level; of the two together, one block from each, it is not."""
    rungs = read("ladder-split-device")
    light = Hand([[1e-6, 0.0], [0.0, 1e-6]], [[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    mixed = Repeating((light,), (Tick((0.0,), (1.0, 1.0), (0, 1)),))
    with ctx.workprec(BITS):
        readers = [precise(rung) for rung in rungs]
        assert growth(readers, mixed) > 0.79
        for rung in (0, 1):
            assert growth(readers, Repeating((light,), (Tick((0.0,), (1.0, 1.0), (rung, rung)),))) <= CERTAIN
    assert judge_ladder(rungs, 0, True, np.random.default_rng(1)).findings
    for common in (0, 1):
        assert not prove_ladder(rungs, common).independent.holds


def test_a_rung_changes_after_two_ticks_without_force() -> None:
    """After one, the step of the force to zero is of the first rung, and late as only the second allows."""
    rungs = read("ladder-one-tick")
    none = [[0.0, 0.0], [0.0, 0.0]]
    light = Hand([[1.4e-4, 0.0], [0.0, 9.2e-4]], none, none)
    coupled, still = Tick((0.0,), (1.0, 1.0), (0, 0)), Tick((0.0,), (0.0, 0.0), (0, 0))
    late = Tick((1.0,), (0.0, 0.0), (1, 1))
    proof = prove_ladder(rungs, 0)
    assert (proof.one_loop.holds, proof.together.holds) == (True, True)
    with ctx.workprec(BITS):
        readers = [precise(rung) for rung in rungs]
        assert growth(readers, Repeating((light,), (*[coupled] * 4, late, still))) > 0.06
        assert growth(readers, Repeating((light,), (*[coupled] * 4, still, late, still))) <= CERTAIN
