"""Named and random problems: Example 1 with the paper's couplings, networks, couplings and closed loops.

Reference values are built here from the equations, by other methods than the code under test.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import strategies as st

from manyhands.design.levels.contract import Levels
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.passivity.operators import RationalMatrix
from manyhands.design.problem import DeviceLevel, HapticLoop

DECENTRALISED = Partition(("cx", "cy", "cz"), ((0,), (1,), (2,)))
CENTRALISED = Partition(("c",), ((0, 1, 2),))


class Problems:
    """Builders and strategies, handed to the tests as one fixture."""

    T = 1e-3
    osp = 1.37
    network = Network(
        ("dx", "dy", "dz"),
        (("hub", 3.0),),
        (
            NetworkLink(("dx", "hub"), 3800.0, 0.1),
            NetworkLink(("dy", "hub"), 3500.0, 0.2),
            NetworkLink(("dz", "hub"), 3300.0, 0.3),
            NetworkLink(("hub", GROUND), 2600.0, 0.5),
        ),
    )
    decentralised = DECENTRALISED
    centralised = CENTRALISED
    C26 = SpringDamper(np.diag([704.9058, 704.9336, 704.8754]), np.diag([0.0372] * 3))
    C27 = SpringDamper(
        np.array([[660.4367, -0.2614, -0.3282], [-0.2614, 660.4181, -0.3429], [-0.3282, -0.3429, 660.4602]]),
        np.array([[0.1674, -0.0003, -0.0005], [-0.0003, 0.1685, -0.0006], [-0.0005, -0.0006, 0.1675]]),
    )
    C28 = SpringDamper(np.diag([2735.5, 2734.6, 2735.5]), -1e-3 * np.diag([0.2648, 0.2798, 0.2838]))
    h = ((0.02, 1.2, 20.0), (1.0, 10.3, 100.0))  # the diagonal of Example 1's H(s)

    def operator(self, off: float) -> RationalMatrix:
        """Example 1's H(s), with ``off`` off the diagonal; the paper prints 0.1."""
        gain = ((off,), (1.0,))
        return RationalMatrix(tuple(tuple(self.h if i == j else gain for j in range(3)) for i in range(3)))

    def example_1(self, partition: Partition = DECENTRALISED, osp: float = osp, T: float = T) -> HapticLoop:
        return self.loop(self.network, partition, [osp] * 3, T)

    def loop(self, network: Network, partition: Partition, osp: Sequence[float], T: float) -> HapticLoop:
        """A loop of one-axis devices."""
        devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[level]])) for i, level in enumerate(osp))
        return HapticLoop("test", T, network.ports, devices, partition, network)

    def uniform(self, stiffness: float, damping: float, m: int = 3) -> SpringDamper:
        return SpringDamper(stiffness * np.eye(m), damping * np.eye(m))

    def blocks(self, loop: HapticLoop, coupling: SpringDamper) -> tuple[StateSpace, ...]:
        """The blocks as linear ones; several ports state V(1) = K^-1, which D in floats makes symmetric only nearly."""
        out = []
        for part in coupling.restrict(loop.partition):
            V = part.realisation(loop.period)
            if V.inputs > 1:
                gain = np.linalg.inv(part.stiffness)
                V = StateSpace.with_static_gain(V.A, V.B, V.C, (gain + gain.T) / 2.0)
            out.append(V)
        return tuple(out)

    def greatest_level(self, Delta_D: Matrix, coupling: SpringDamper, T: float) -> tuple[Matrix, Matrix, Matrix]:
        """J, J - B and Delta_V* = Delta_D J^-1 (J + B) J^-1 Delta_D - Delta_D, in closed form."""
        J = Delta_D - coupling.stiffness * T / 2.0
        X = np.linalg.solve(J, Delta_D)
        return J, J - coupling.damping, X.T @ (J + coupling.damping) @ X - Delta_D

    def margin(self, loop: HapticLoop, levels: Levels) -> float:
        """The least eigenvalue of (10)."""
        Delta_V, Phi_E = loop.partition.embed(levels.Delta_V), levels.Phi_E
        return float(
            np.linalg.eigvalsh(
                np.block([[levels.device.share * loop.Delta_D - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]])
            )[0]
        )

    def dissipation(self, loop: HapticLoop, Phi_E: Matrix, environment: Environment | None = None) -> float:
        """The least eigenvalue of He E_hat + Phi_E over frequency, relative to the size of E_hat there."""
        E = (environment or loop.environment).environment(loop.period)
        out = np.inf
        for angle in np.concatenate([np.geomspace(1e-4, np.pi, 300), [np.pi]]):
            z = np.exp(1j * angle)
            E_hat = E.response(z) * loop.period * z / (z - 1.0)
            H = (E_hat + E_hat.conj().T) / 2.0 + Phi_E
            size = max(np.abs(E_hat).max(), np.abs(Phi_E).max(), 1e-300)
            out = min(out, float(np.linalg.eigvalsh(H)[0]) / size)
        return out

    def impedance(self, network: Network, s: complex) -> Matrix:
        """The continuous network's impedance from port displacement to force, at one s, link by link."""
        names = [*network.ports, *(name for name, _ in network.masses)]
        total = np.zeros((len(names), len(names)), dtype=complex)
        for link in network.links:
            direction = np.zeros(len(names))
            for end, sign in zip(link.ends, (1.0, -1.0), strict=True):
                if end != GROUND:
                    direction[names.index(end)] = sign
            total += (link.stiffness + link.damping * s) * np.outer(direction, direction)
        m = len(network.ports)
        if not network.masses:
            return total
        inner = total[m:, m:] + s**2 * np.diag([mass for _, mass in network.masses])
        return total[:m, :m] - total[:m, m:] @ np.linalg.solve(inner, total[m:, :m])

    def closed_loop(self, G: StateSpace, V: StateSpace, E: StateSpace) -> Matrix:
        """The state matrix of f = -(I + D_E D_V)^-1 (C_E eta + D_E (C_G x + C_V xi)), states (x, xi, eta)."""
        n_G, n_V, n_E = G.order, V.order, E.order
        R = np.linalg.inv(np.eye(E.outputs) + E.D @ V.D)
        f = -R @ np.hstack([E.D @ G.C, E.D @ V.C, E.C])
        x_e = np.hstack([G.C, V.C, np.zeros((E.inputs, n_E))]) + V.D @ f
        return np.vstack(
            [
                np.hstack([G.A, np.zeros((n_G, n_V + n_E))]) + G.B @ f,
                np.hstack([np.zeros((n_V, n_G)), V.A, np.zeros((n_V, n_E))]) + V.B @ f,
                np.hstack([np.zeros((n_E, n_G + n_V)), E.A]) + E.B @ x_e,
            ]
        )

    # --- random problems

    @staticmethod
    @st.composite
    def networks(draw: st.DrawFn, tied: bool = False) -> Network:
        """1 ... 4 ports, 0 ... 4 masses, any links; with ``tied`` every port and mass has a link that is not empty."""
        m, n = draw(st.integers(1, 4)), draw(st.integers(0, 4))
        ports = tuple(f"p{i}" for i in range(m))
        masses = tuple((f"m{i}", draw(st.floats(0.01, 10.0))) for i in range(n))
        ends = [*ports, *(name for name, _ in masses), GROUND]
        pairs = draw(
            st.lists(st.tuples(st.integers(0, m + n), st.integers(0, m + n)).filter(lambda p: p[0] != p[1]), max_size=6)
        )
        springs = st.one_of(st.just(0.0), st.floats(1.0, 1e4))
        dampers = st.one_of(st.just(0.0), st.floats(0.01, 10.0))
        links = [NetworkLink((ends[a], ends[b]), draw(springs), draw(dampers)) for a, b in pairs]
        if tied:
            for i in range(m + n):
                other = draw(st.sampled_from([end for end in ends if end != ends[i]]))
                links.append(NetworkLink((ends[i], other), draw(st.floats(1.0, 1e4)), draw(st.floats(0.01, 10.0))))
        return Network(ports, masses, tuple(links))

    @staticmethod
    @st.composite
    def partitions(draw: st.DrawFn, m: int) -> Partition:
        """Any partition of m ports, in any order."""
        labels = draw(st.lists(st.integers(0, m - 1), min_size=m, max_size=m))
        order = draw(st.permutations(range(m)))
        blocks = [tuple(p for p in order if labels[p] == label) for label in dict.fromkeys(labels)]
        return Partition(tuple(f"c{i}" for i in range(len(blocks))), tuple(blocks))

    @staticmethod
    @st.composite
    def couplings(draw: st.DrawFn, loop: HapticLoop, least_damping: float = 0.0, most: float = 0.95) -> SpringDamper:
        """Noncommuting symmetric K > 0 and B with the loop's structure, as parts of what Delta_D allows.

        K T/2 is up to ``most`` of Delta_D, B between ``least_damping`` and ``most`` of what K leaves; above 1 is
        beyond the limit.
        """
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        K, B = [], []
        for level in loop.partition.restrict(loop.Delta_D):
            values, vectors = np.linalg.eigh(level)
            root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
            part = draw(st.floats(0.05, most))
            share = draw(st.floats(least_damping, most))
            k = part * _between(rng, len(level), 0.2, 1.0)
            b = share * max(1.0 - part, 0.05) * _between(rng, len(level), 0.1, 1.0)
            K.append(_symmetric(root @ k @ root) * 2.0 / loop.period)
            B.append(_symmetric(root @ b @ root))
        return SpringDamper(loop.partition.embed(K), loop.partition.embed(B))

    @staticmethod
    @st.composite
    def loops(draw: st.DrawFn, tied: bool = False) -> HapticLoop:
        """Random one-axis devices, network, partition, and period."""
        network = draw(Problems.networks(tied))
        m = len(network.ports)
        osp = draw(st.lists(st.floats(0.05, 20.0), min_size=m, max_size=m))
        T = draw(st.sampled_from([2.5e-4, 1e-3, 4e-3]))
        return Problems().loop(network, draw(Problems.partitions(m)), osp, T)

    @staticmethod
    @st.composite
    def passive_entries(draw: st.DrawFn) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """A passive H(s): a damper, in parallel with a damper in series with a mass that has a spring and a damper."""
        b, b_0, mass, k = (draw(st.floats(*span)) for span in ((0.0, 2.0), (0.01, 2.0), (0.05, 2.0), (1.0, 500.0)))
        b_1 = draw(st.floats(0.01, 2.0))
        inner = (mass, b_1, k)  # inner impedance mass s + b_1 + k / s, times s
        den = (mass, b_1 + b_0, k)
        return tuple(b * d + b_0 * i for d, i in zip(den, inner, strict=True)), den


def _between(rng: np.random.Generator, m: int, low: float, high: float) -> Matrix:
    """A random symmetric matrix with eigenvalues between ``low`` and ``high``."""
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    return Q @ np.diag(rng.uniform(low, high, m)) @ Q.T


def _symmetric(M: Matrix) -> Matrix:
    return (M + M.T) / 2.0


@pytest.fixture(scope="session")
def problems() -> Problems:
    return Problems()
