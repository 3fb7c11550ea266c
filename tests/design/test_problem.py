"""The loop's data: Delta_D in the coupling's structure, the scaling, and data that are refused."""

import numpy as np
import pytest
from flint import fmpq, fmpq_mat
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import DeviceLevel, HapticLoop, Wish

FULL = np.array([[1.5, 0.3], [0.3, 1.2]])


def three_ports(partition: Partition) -> HapticLoop:
    """A two-axis device with a full level, and a one-axis one between its axes."""
    ports = ("a.0", "b.0", "a.1")
    network = Network(ports, (), tuple(NetworkLink((port, GROUND), 1000.0, 0.5) for port in ports))
    devices = (DeviceLevel("a", (0, 2), FULL), DeviceLevel("b", (1,), np.array([[0.7]])))
    return HapticLoop("test", 1e-3, ports, devices, partition, network)


def test_a_whole_device_keeps_its_level() -> None:
    loop = three_ports(Partition(("a", "b"), ((2, 0), (1,))))
    np.testing.assert_array_equal(loop.Delta_D, [[1.5, 0.0, 0.3], [0.0, 0.7, 0.0], [0.3, 0.0, 1.2]])


def test_a_split_device_promises_its_least_eigenvalue() -> None:
    loop = three_ports(Partition(("p", "q"), ((2, 1), (0,))))
    least = np.linalg.eigvalsh(FULL)[0]
    np.testing.assert_allclose(loop.Delta_D, np.diag([least, 0.7, least]), rtol=2e-12)
    # Delta-OSP implies Delta'-OSP for Delta' <= Delta only: what is counted on is below the promise, exactly
    S = loop.Delta_D[np.ix_((0, 2), (0, 2))]
    promised, counted = (fmpq_mat(2, 2, [fmpq(*x.as_integer_ratio()) for x in M.ravel().tolist()]) for M in (FULL, S))
    rest = promised - counted
    assert rest[0, 0] > 0
    assert rest.det() > 0


def test_delta_by_block_is_in_each_blocks_own_order() -> None:
    loop = three_ports(Partition(("a", "b"), ((2, 0), (1,))))
    first, second = loop.Delta_D_blocks
    np.testing.assert_array_equal(first, [[1.2, 0.3], [0.3, 1.5]])
    np.testing.assert_array_equal(second, [[0.7]])
    for kappa in (0.5, 1.25):  # K = kappa T Delta_D^-1, (8) for kappa = 1/2
        for K, Delta in zip(loop.loop_gain(kappa), loop.Delta_D_blocks, strict=True):
            np.testing.assert_allclose(K @ Delta, kappa * 1e-3 * np.eye(len(Delta)), atol=1e-18)


@given(st.data())
def test_the_scaling_has_the_structure_and_makes_delta_one(problems, data: st.DataObject) -> None:
    partition = data.draw(problems.partitions(3))
    loop = three_ports(partition)
    assert partition.admits(loop.scaling)
    np.testing.assert_allclose(loop.scaling @ loop.Delta_D @ loop.scaling, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(loop.K @ loop.Delta_D, 0.5e-3 * np.eye(3), atol=1e-15)


@pytest.mark.parametrize("level", [[[0.0]], [[-1.0]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.1], [0.0, 1.0]]])
def test_what_is_no_level_is_refused(level) -> None:
    with pytest.raises(ValueError, match="dev: expected a symmetric positive definite OSP level"):
        DeviceLevel("dev", tuple(range(len(level))), np.array(level))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"devices": ()}, "cover every port exactly once"),
        ({"period": 0.0}, "positive period"),
        ({"period": float("inf")}, "positive period"),
        ({"period": float("nan")}, "positive period"),
        ({"tau": -1e-9}, "found a delay of -1e-09 s; expected 0 to the period"),
        ({"tau": 1.1e-3}, "found a delay of 0.0011 s; expected 0 to the period"),
        ({"tau": float("nan")}, "found a delay of nan s; expected 0 to the period"),
        ({"partition": Partition(("a",), ((0, 1),))}, "partition and environment"),
        ({"environment": Network(("x", "y", "z"), (), ())}, "partition and environment"),
    ],
)
def test_what_is_no_loop_is_refused(problems, change, words: str) -> None:
    whole = problems.example_1()
    given_ = {key: getattr(whole, key) for key in ("session", "period", "ports", "devices", "partition", "environment")}
    with pytest.raises(ValueError, match=words):
        HapticLoop(**{**given_, **change})


@pytest.mark.parametrize(
    ("objective", "aim", "algorithm", "words"),
    [
        ("loop-shaping", None, "convex", "expected weights for a transparency problem"),
        ("feasible", Transparency("loop-shaping", Filter.one(), Filter.one()), "convex", "and only there"),
        ("closed-loop", Transparency("loop-shaping", Filter.one(), Filter.one()), "convex", "'closed-loop'"),
        ("stiffest", None, "complementarity", "expected objective 'feasible'"),
    ],
)
def test_what_is_no_wish_is_refused(objective, aim, algorithm, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Wish(objective, aim, algorithm)


def test_a_loop_without_ports_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one port"):
        HapticLoop("none", 1e-3, (), (), Partition((), ()), Network((), (), ()))
