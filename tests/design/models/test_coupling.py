"""Spring-damper couplings: (20), (21) mended, and (22)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import StateSpace


@given(st.data())
def test_the_realisation_is_the_spring_and_damper(problems, data: st.DataObject) -> None:
    loop = data.draw(problems.loops())
    coupling, T = data.draw(problems.couplings(loop)), loop.period
    V = coupling.realisation(T)
    for angle in (1e-3, 0.1, 1.0, 3.0, np.pi):
        z = np.exp(1j * angle)
        impedance = coupling.stiffness + coupling.damping * (z - 1.0) / (T * z)
        identity = V.response(z) @ impedance
        # near z = 1 the resolvent's conditioning, up to 1/|z - 1|, takes digits
        np.testing.assert_allclose(identity, np.eye(len(impedance)), atol=1e-9)
    static = V.response(1.0).real
    np.testing.assert_allclose(static, static.T, atol=1e-10 * np.abs(static).max())
    np.testing.assert_allclose(static, np.linalg.inv(coupling.stiffness), rtol=1e-9, atol=1e-9 * np.abs(static).max())


@given(st.data())
def test_22_undoes_21(problems, data: st.DataObject) -> None:
    loop = data.draw(problems.loops())
    coupling = data.draw(problems.couplings(loop))
    V = coupling.realisation(loop.period)
    np.testing.assert_array_equal(V.B, loop.period * V.A)
    np.testing.assert_array_equal(V.D, loop.period * V.C)
    back = SpringDamper.from_realisation(V.A, V.C, loop.period)
    for found, expected in ((back.stiffness, coupling.stiffness), (back.damping, coupling.damping)):
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_the_other_order_of_A_V_has_an_unsymmetric_compliance(problems) -> None:
    """Why A_V = B C_V and not C_V B: the static compliance would not be symmetric for noncommuting K, B."""
    K, B, T = np.array([[700.0, 200.0], [200.0, 900.0]]), np.diag([0.1, 0.4]), problems.T
    V = SpringDamper(K, B).realisation(T)
    other = StateSpace(V.C @ B, T * V.C @ B, V.C, V.D)
    assert np.abs(other.response(1.0).real - other.response(1.0).real.T).max() > 1e-5
    assert np.abs(V.response(1.0).real - V.response(1.0).real.T).max() < 1e-15


@given(st.data())
def test_blocks_are_those_of_the_partition(problems, data: st.DataObject) -> None:
    loop = data.draw(problems.loops())
    coupling = data.draw(problems.couplings(loop))
    joined = loop.partition.join([part.realisation(loop.period) for part in coupling.restrict(loop.partition)])
    whole = coupling.realisation(loop.period)
    z = np.exp(0.4j)
    np.testing.assert_allclose(joined.response(z), whole.response(z), rtol=1e-9, atol=1e-15)
    assert np.all(joined.D[~loop.partition.mask()] == 0.0)


@pytest.mark.parametrize("K", [np.zeros((1, 1)), np.diag([700.0, 0.0]), np.array([[1.0, 1.0], [1.0, 1.0]])])
def test_a_missing_direction_is_refused(K) -> None:
    with pytest.raises(ValueError, match="positive stiffness or damping in every direction"):
        SpringDamper(K, np.zeros_like(K)).realisation(1e-3)


def test_what_is_no_coupling_is_refused(problems) -> None:
    with pytest.raises(ValueError, match="symmetric"):
        SpringDamper(np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(2))
    with pytest.raises(ValueError, match="found 3 x 3; expected a 2 x 2 matrix"):
        SpringDamper(np.eye(2), np.eye(3))
    with pytest.raises(ValueError, match="different blocks"):
        problems.C27.restrict(problems.decentralised)
