"""A few refusals of random loops: what they state is where design begins to refuse, within 1 %."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import DeviceLevel, HapticLoop

from ..attack.limits import Case, faults, random_case
from ..support.cases import cases


def test_a_delay_does_not_lower_a_stated_limit_too_far() -> None:
    """The limit is Delta_D/(T/2 + 3 tau/2); the share is greatest at 5 tau/2, where the message took it from."""
    network = Network(("p0",), (), (NetworkLink(("p0", GROUND), 500.0, 0.0),))
    loop = HapticLoop(
        session="late",
        period=1e-3,
        ports=("p0",),
        devices=(DeviceLevel("d0", (0,), np.array([[0.05]])),),
        partition=Partition(("c0",), ((0,),)),
        environment=network,
        tau=3e-4,
    )
    case = Case(loop, (60.0,), (0.0,), linear=False)
    error = case.refusal()
    assert "a stiffness below 52." in str(error)  # 0.05/(0.95 T) = 52.6 N/m, and not 0.05/(1.25 T) = 40
    assert faults(case, error) == []
    assert case._replace(stiffness=(52.0,)).refusal() is None


def test_each_stated_limit_is_where_design_begins_to_refuse() -> None:
    rng = np.random.default_rng(5)
    refused = 0
    while refused < cases(1, 5):
        case = random_case(rng)
        error = case.refusal()
        if error is not None and "below" in str(error):
            refused += 1
            assert faults(case, error) == [], (case, error)


@pytest.mark.parametrize("words", ["a stiffness below", "devices with an osp above"])
def test_several_blocks_each_have_their_limit(words: str) -> None:
    """What is named of one block alone would not help: the other one is too stiff as well."""
    network = Network(("p0", "p1"), (), tuple(NetworkLink((p, GROUND), 500.0, 0.0) for p in ("p0", "p1")))
    loop = HapticLoop(
        session="two",
        period=1e-3,
        ports=network.ports,
        devices=tuple(DeviceLevel(f"d{i}", (i,), np.array([[osp]])) for i, osp in enumerate((1.37, 0.5))),
        partition=Partition(("c0", "c1"), ((0,), (1,))),
        environment=network,
    )
    case = Case(loop, (3000.0, 1200.0), (0.0, 0.0), linear=False)
    error = case.refusal()
    assert any(way.startswith(words) for way in error.relax)
    assert "a stiffness below 2740 N/m at c0 and 1000 N/m at c1" in error.relax
    assert faults(case, error) == []


def test_where_a_block_has_a_damping_the_stated_limit_counts_it() -> None:
    """A softer spring beside the same damper would not help; of a given state space the whole block is softened."""
    network = Network(("p0",), (), (NetworkLink(("p0", GROUND), 500.0, 0.0),))
    loop = HapticLoop(
        session="given",
        period=5e-4,
        ports=("p0",),
        devices=(DeviceLevel("d0", (0,), np.array([[4.19]])),),
        partition=Partition(("c0",), ((0,),)),
        environment=network,
    )
    for linear in (False, True):
        case = Case(loop, (20_000.0,), (1.5,), linear=linear)
        error = case.refusal()
        way = error.relax[0]
        assert way.startswith("a stiffness plus 2/T times its damping below 1.67")
        assert way.endswith(", the rest of its block in proportion") == linear
        assert faults(case, error) == []
        assert case._replace(stiffness=(0.99 * float(way.split()[8]),)).refusal() is not None
