"""True certificates are proved, whatever kind of environment, coupling and delay they have."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.proof import prove

Data = dict[str, Any]
T = 1e-3
APART = [[0], [1], [2]]


def failing(data: Data) -> list[str]:
    return [f"{f.condition}: {f.argument}" for f in prove(data) if not f.holds]


def example_1(certificates, which: str, blocks: list[list[int]] | None = None, **change: Any) -> Data:
    hub = certificates.hub()
    K, B = getattr(certificates, f"K{which}"), getattr(certificates, f"B{which}")
    S = certificates.physical_level(hub, ["p0", "p1", "p2"])
    return certificates.certificate(hub, (K, B), -S * (1.0 - 1e-9), blocks=blocks, **change)


@pytest.mark.parametrize(
    ("which", "blocks", "margin"), [("26", APART, 0.7979), ("27", None, 0.9455), ("28", APART, 1.8329)]
)
def test_example_1(certificates, which: str, blocks: list[list[int]] | None, margin: float) -> None:
    data = example_1(certificates, which, blocks)
    assert failing(data) == []
    found = {f.key: f for f in prove(data) if f.key}
    # the physical Phi_E is not the best one over all: its margin is within 1 % of theory's
    assert found["(10)"].value == pytest.approx(margin, rel=0.01)
    assert found["(10)"].value <= margin + 1e-3


def test_a_stiffness_beyond_the_limit_is_not_proved(certificates) -> None:
    data = example_1(certificates, "26", APART)
    data["coupling"]["blocks"]["c1"] = {"stiffness": [[3000.0]], "damping": [[0.0]]}
    assert any("J = Delta_D" in text for text in failing(certificates.seal(data)))


def test_blocks_of_levels_and_zero_phi(certificates) -> None:
    data = example_1(certificates, "26", APART)
    data["levels"]["Phi_E"] = {f"c{i}": [[0.0]] for i in range(3)}
    data["margins"] = {"(10)": 0.0, "Delta_V": 0.54, "Delta_D": 1.37, "J": 1.0}
    assert failing(certificates.seal(data)) == []


def test_linear_blocks_with_the_storage_of_a_spring_damper(certificates) -> None:
    for which, blocks in (("26", APART), ("27", None), ("27", [[0, 2], [1]])):
        K = getattr(certificates, f"K{which}")
        if blocks is not None:
            K = K * np.array([[any({i, j} <= set(b) for b in blocks) for j in range(3)] for i in range(3)])
        data = certificates.as_linear(example_1(certificates, which, blocks))
        assert failing(data) == [], which


def test_a_static_linear_block_at_its_limit(certificates) -> None:
    """V = D, one port: V_hat is OSP up to T/(2 (D - K)), and exactly there with numbers that are exact."""
    K = T / (2.0 * 1.37)
    D = 2.0**-9
    data = example_1(certificates, "26", APART)
    data["coupling"] = {"class": "linear", "blocks": {}}
    data["storage"]["V_hat"] = {f"c{i}": [] for i in range(3)}
    for i in range(3):
        data["coupling"]["blocks"][f"c{i}"] = {"A": [], "B": [], "C": [[]], "D": [[D]]}
        data["levels"]["Delta_V"][f"c{i}"] = [[T / (2.0 * (D - K)) * (1.0 - 1e-12)]]
    data["margins"] = {}
    assert failing(certificates.seal(data)) == []
    data["levels"]["Delta_V"]["c0"] = [[T / (2.0 * (D - K)) * (1.0 + 1e-12)]]
    assert any("M_V" in text for text in failing(certificates.seal(data)))


def test_delay_inside_the_tick(certificates) -> None:
    """With share s, t = tau/T and v = 2 kappa - 1 - 3t: s <= v/(v^2 + (1+4t) v + 4t^2), c between its bounds."""
    t, kappa = 0.3, 1.25
    v = 2.0 * kappa - 1.0 - 3.0 * t
    share = v / (v**2 + (1.0 + 4.0 * t) * v + 4.0 * t**2) * (1.0 - 1e-4)
    a, p, q = 0.5 - share * kappa, t / 2.0, t * (1.0 - t) / 4.0
    c = q + (kappa * a - q) * p / (a + p)
    hub = certificates.hub()
    S = certificates.physical_level(hub, ["p0", "p1", "p2"])
    coupling = (200.0 * np.eye(3), 0.05 * np.eye(3))
    data = certificates.certificate(hub, coupling, -S * (1.0 - 1e-9), gains=(kappa, share, c), tau=t * T)
    assert failing(data) == []
    assert certificates.refuted(data) == []
    for key, value in (("share", share * (1.0 + 1e-3)), ("c", c * 1.3), ("c", c * 0.5), ("kappa", kappa * 0.9)):
        worse = copy.deepcopy(data)
        worse["levels"][key] = value
        assert any("F_t" in text for text in failing(certificates.seal(worse))), key
    worse = copy.deepcopy(data)
    worse["tau"] = 1.02 * t * T
    assert any("F_t" in text for text in failing(certificates.seal(worse)))
    alone = example_1(certificates, "26", APART)
    alone["tau"] = 1e-9  # share 1 leaves nothing to a delay
    assert any("F_t" in text for text in failing(certificates.seal(alone)))


def test_a_box_of_networks(certificates) -> None:
    ports = ["p0", "p1", "p2"]
    hub = certificates.hub()
    hub["masses"]["hub"] = [1.0, 5.0]
    for link in hub["links"]:
        link["stiffness"] = [0.9 * link["stiffness"], 1.1 * link["stiffness"]]
    low = certificates.physical_level(hub, ports, 0)
    coupling = (certificates.K26, certificates.B26)
    data = certificates.certificate(hub, coupling, -low * (1.0 - 1e-9))
    assert failing(data) == []
    high = certificates.physical_level(hub, ports, -1)  # what the stiffest network would allow is not allowed
    assert any(
        "(-Phi_E)-ISP" in text for text in failing(certificates.certificate(hub, coupling, -high * (1.0 - 1e-6)))
    )


@pytest.mark.parametrize(("delay", "storage"), [(1, [1e-7]), (2, [0.5, 5e-8])])
def test_one_port_some_ticks_late(certificates, delay: int, storage: list[float]) -> None:
    """E = k z^-d has E_hat = k T z^(1-d)/(z-1), which needs the level k T (d - 1/2); P in units of k T."""
    k = 500.0
    environment = {
        "type": "network",
        "masses": {},
        "links": [{"between": ["p0", "ground"], "stiffness": k, "damping": 0.0}],
        "delay": delay,
    }
    coupling = (np.array([[400.0]]), np.array([[5.0]]))
    level = k * T * (delay - 0.5)
    P = (k * T * np.diag(storage)).tolist()
    data = certificates.certificate(environment, coupling, np.array([[level * (1.0 + 1e-6)]]), P, osp=20.0)
    assert failing(data) == []
    below = certificates.certificate(environment, coupling, np.array([[level * (1.0 - 1e-9)]]), P, osp=20.0)
    assert any("(-Phi_E)-ISP" in text for text in failing(below))
    energy = certificates.certificate(environment, coupling, np.array([[level * 1.01]]), osp=20.0)
    assert any("without delay" in text for text in failing(energy))


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_network_with_a_storage_matrix(certificates, delay: int) -> None:
    """One mass between port and ground: states (e, v), e = q - k_1/(k_1 + k_0) u, then the chain."""
    k_1, k_0, b_1, b_0, mass = 300.0, 200.0, 0.3, 0.2, 0.5
    environment = {
        "type": "network",
        "masses": {"m": mass},
        "links": [
            {"between": ["p0", "m"], "stiffness": k_1, "damping": b_1},
            {"between": ["m", "ground"], "stiffness": k_0, "damping": b_0},
        ],
        "delay": delay,
    }
    K_qq, B_qq = k_1 + k_0, b_1 + b_0
    lead = 1.0 / (mass / T + B_qq + T * K_qq)
    v = lead * np.array([-K_qq, mass / T, b_1 + T * k_1])  # over (e, v, w)
    e = np.array([1.0, 0.0, 0.0]) + T * (v - np.array([0.0, 0.0, k_1 / K_qq]))
    f = -k_1 * np.array([1.0, 0.0, 0.0]) - (b_1 + T * k_1) * v + np.array([0.0, 0.0, b_1 + T * k_1])
    E1 = np.array([[k_1 - k_1**2 / K_qq]])
    A, B = np.array([e[:2], v[:2]]), np.array([e[2:], v[2:]])
    rest = (A, B, f[None, :2], f[None, 2:])
    for _ in range(delay):  # the newest velocity comes first in the chain
        A, B, C, D = rest
        late = D - T * E1 if len(A) == 2 else np.zeros((1, 1))
        rest = chained(A, B, C, late, E1)
    # the frequency domain gives the level needed
    z = np.exp(1j * np.linspace(1e-3, np.pi, 4000))
    response = certificates.response(environment, ["p0"], z)[:, 0, 0]
    level = -np.min((response * T * z / (z - 1.0)).real)
    Phi = np.array([[level + 0.02]])
    P = certificates.storage(E1, rest, Phi)
    data = certificates.certificate(environment, (np.array([[300.0]]), np.array([[5.0]])), Phi, P.tolist(), osp=20.0)
    assert certificates.refuted(data) == []
    assert failing(data) == []
    worse = certificates.certificate(
        environment, (np.array([[300.0]]), np.array([[5.0]])), np.array([[level - 1e-3]]), P.tolist(), osp=20.0
    )
    assert failing(worse) != []


def test_masses_that_float(certificates) -> None:
    """Two masses on a spring, dragged by a damper: one deflection, that of the first mass, and two velocities."""
    k, b, b_0, masses = 400.0, 0.8, 0.3, np.diag([0.5, 0.2])
    environment = {
        "type": "network",
        "masses": {"m0": 0.5, "m1": 0.2},
        "links": [
            {"between": ["p0", "m0"], "stiffness": 0.0, "damping": b},
            {"between": ["m0", "m1"], "stiffness": k, "damping": 0.0},
            {"between": ["m1", "ground"], "stiffness": 0.0, "damping": b_0},
        ],
        "delay": 0,
    }
    spring = np.array([1.0, -1.0])  # K_qq = k spring spring', e = spring'q
    lead = np.linalg.inv(masses / T + np.diag([b, b_0]) + T * k * np.outer(spring, spring))
    v = lead @ np.column_stack([-k * spring, masses / T, [b, 0.0]])  # over (e, v, w)
    e = np.eye(4)[:1] + T * spring[None, :] @ v
    f = -b * v[:1] + b * np.eye(4)[3:]
    state = np.vstack([e, v])
    rest = (state[:, :3], state[:, 3:], f[:, :3], f[:, 3:])
    Phi, E1 = np.array([[0.01]]), np.zeros((1, 1))
    P = certificates.storage(E1, rest, Phi)
    data = certificates.certificate(environment, (np.array([[300.0]]), np.array([[5.0]])), Phi, P.tolist(), osp=20.0)
    assert certificates.refuted(data) == []
    assert failing(data) == []


def chained(A, B, C, D, E1):
    """One more tick: input -> w_{k-1} in front of the chain, states (x, w_{k-1}, ..., w_{k-d})."""
    n, m = len(B), 1
    if n == 2:
        A_next = np.block([[A, B], [np.zeros((m, n + m))]])
        return A_next, np.vstack([np.zeros((n, m)), np.eye(m)]), np.hstack([C, D]), np.zeros((m, m))
    A_next = np.zeros((n + 1, n + 1))
    A_next[:2, :2], A_next[:2, n] = A[:2, :2], A[:2, n - 1]
    A_next[3:, 2:n] = np.eye(n - 2)
    C_next = np.zeros((1, n + 1))
    C_next[:, :2], C_next[:, n] = C[:, :2], C[:, n - 1]
    C_next[:, 2:n] = -T * E1
    B_next = np.zeros((n + 1, 1))
    B_next[2] = 1.0
    return A_next, B_next, C_next, np.zeros((1, 1))


@pytest.mark.parametrize("method", ["backward-euler", "tustin", "zoh", None])
@pytest.mark.parametrize("delay", [0, 1])
def test_state_space(certificates, method: str | None, delay: int) -> None:
    """Two ports on a mass that is held: a lightly damped mode, seen twice."""
    k, mass, b = np.array([300.0, 200.0]), 0.4, 0.5
    A = np.array([[0.0, 1.0], [-(k.sum() + 100.0) / mass, -b / mass]])
    B = np.vstack([np.zeros(2), k / mass])
    C = np.column_stack([-k, np.zeros(2)])
    environment: Data = {"type": "state-space", "time": "continuous", "method": method or "zoh", "delay": 0}
    environment |= {"A": A.tolist(), "B": B.tolist(), "C": C.tolist(), "D": np.diag(k).tolist()}
    ports = ["p0", "p1"]
    if method is None:
        matrices = certificates.system(environment, ports)
        environment = {"type": "state-space", "time": "discrete", "delay": 0}
        environment |= {key: M.tolist() for key, M in zip("ABC", matrices, strict=False)}
        environment["static"] = (np.diag(k) - np.outer(k, k) / (k.sum() + 100.0)).tolist()  # a zero-order hold keeps it
    environment["delay"] = delay
    E1, rest = certificates.rest(certificates.system(environment, ports), delay)
    z = np.exp(1j * np.linspace(1e-4, np.pi, 4000))
    E_hat = certificates.response(environment, ports, z) * (T * z / (z - 1.0))[:, None, None]
    need = -np.linalg.eigvalsh((E_hat + np.conj(E_hat.transpose(0, 2, 1))) / 2.0).min()
    Phi = (need + 0.05) * np.eye(2)
    P = certificates.storage((E1 + E1.T) / 2.0, rest, Phi)
    coupling = (np.diag([300.0, 250.0]), 8.0 * np.eye(2))
    data = certificates.certificate(environment, coupling, Phi, P.tolist(), osp=20.0)
    assert certificates.refuted(data) == []
    assert failing(data) == []
    assert failing(certificates.certificate(environment, coupling, Phi - 0.06 * np.eye(2), P.tolist(), osp=20.0))


@pytest.mark.parametrize("method", ["backward-euler", "tustin"])
def test_transfer_functions(certificates, method: str) -> None:
    """Entries of several degrees, one improper for backward Euler: P is for their companion forms, side by side."""
    spring_mass = {"num": [0, 120.0, 150.0, 3e4], "den": [0.4, 0.5, 400.0]}
    wall = {"num": [0.002, 0.8, 400.0] if method == "backward-euler" else [400.0], "den": [1.0]}
    zero = {"num": [0.0], "den": [2.0]}
    environment = {
        "type": "transfer-function",
        "method": method,
        "delay": 0,
        "entries": [[spring_mass, zero], [zero, wall]],
    }
    parts = []
    for entry in (spring_mass, wall):
        num, den = np.trim_zeros(entry["num"], "f"), entry["den"]
        degree = max(len(num), len(den)) - 1
        s_num, s_den = ([1.0, -1.0], [T, 0.0]) if method == "backward-euler" else ([2.0, -2.0], [T, T])

        def substituted(p, degree=degree, s_num=s_num, s_den=s_den):
            total = np.zeros(degree + 1)
            for power, c in enumerate(reversed(list(p))):
                term = np.array([c])
                for factor in [s_num] * power + [s_den] * (degree - power):
                    term = np.convolve(term, factor)
                total = total + term
            return total

        b, a = substituted(num), substituted(den)
        b, a = b / a[0], a / a[0]
        A = np.eye(degree, k=1)
        if degree:
            A[-1] = -a[1:][::-1]
        parts.append((A, np.eye(degree, 1, k=1 - degree), (b[1:] - a[1:] * b[0])[::-1][None, :], np.array([[b[0]]])))
    system = tuple(_direct_sum([part[i] for part in parts]) for i in range(4))
    ports = ["p0", "p1"]
    z = np.exp(1j * np.linspace(1e-4, np.pi - 1e-4, 4000))
    E_hat = certificates.response(environment, ports, z) * (T * z / (z - 1.0))[:, None, None]
    np.testing.assert_allclose(_respond(system, z) * (T * z / (z - 1.0))[:, None, None], E_hat, rtol=1e-6, atol=1e-9)
    need = -np.linalg.eigvalsh((E_hat + np.conj(E_hat.transpose(0, 2, 1))) / 2.0).min()
    Phi = (need + 0.05) * np.eye(2)
    E1, rest = certificates.rest(system)
    P = certificates.storage((E1 + E1.T) / 2.0, rest, Phi)
    coupling = (np.diag([300.0, 250.0]), 8.0 * np.eye(2))
    data = certificates.certificate(environment, coupling, Phi, P.tolist(), osp=20.0)
    assert failing(data) == []
    assert failing(certificates.certificate(environment, coupling, Phi - 0.06 * np.eye(2), P.tolist(), osp=20.0))


def _direct_sum(parts):
    out = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    i = j = 0
    for part in parts:
        out[i : i + part.shape[0], j : j + part.shape[1]] = part
        i, j = i + part.shape[0], j + part.shape[1]
    return out


def _respond(system, z):
    A, B, C, D = system
    return np.array([C @ np.linalg.solve(x * np.eye(len(A)) - A, B) + D for x in z])


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_random_networks_with_their_energy(certificates, seed: int) -> None:
    """Any network, any partition: the physical Phi_E and the closed-form Delta_V are proved."""
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(1, 5)), int(rng.integers(0, 4))
    ports, masses = [f"p{i}" for i in range(m)], [f"m{i}" for i in range(n)]
    ends = [*ports, *masses, "ground"]
    links = []
    for i in range(m + n):  # every end is damped to something, so that S exists
        other = ends[int(rng.choice([j for j in range(len(ends)) if j != i]))]
        links.append(
            {
                "between": [ends[i], other],
                "stiffness": float(rng.uniform(0, 4e3)),
                "damping": float(rng.uniform(0.01, 2)),
            }
        )
    links += [{"between": [name, "ground"], "stiffness": 0.0, "damping": 0.01} for name in masses]
    environment = {
        "type": "network",
        "masses": {name: float(rng.uniform(0.01, 5)) for name in masses},
        "links": links,
        "delay": 0,
    }
    labels = rng.integers(0, m, m)
    blocks = [np.flatnonzero(labels == label).tolist() for label in np.unique(labels)]
    K, B = np.zeros((2, m, m))
    for block in blocks:
        at = np.ix_(block, block)
        Q, _ = np.linalg.qr(rng.normal(size=(len(block), len(block))))
        K[at] = Q @ np.diag(rng.uniform(100, 1500, len(block))) @ Q.T
        R, _ = np.linalg.qr(rng.normal(size=(len(block), len(block))))
        B[at] = R @ np.diag(rng.uniform(0.05, 0.55, len(block))) @ R.T
    K, B = (K + K.T) / 2, (B + B.T) / 2
    S = certificates.physical_level(environment, ports)
    data = certificates.certificate(environment, (K, B), -S + 1e-9 * np.eye(m), blocks=blocks)
    levels = [np.linalg.eigvalsh(level)[0] for level in data["levels"]["Delta_V"].values()]
    if min(levels) <= 0.0:
        assert any("Delta_V > 0" in text for text in failing(data))
    else:
        assert failing(data) == []
        too_much = certificates.certificate(environment, (K, B), -S - 1e-6 * np.eye(m), blocks=blocks)
        assert any("(-Phi_E)-ISP" in text for text in failing(too_much))


def test_progress_and_order(certificates) -> None:
    told: list[str] = []
    findings = prove(example_1(certificates, "26", APART), told.append)
    assert told[0] == "reading the certificate"
    assert len(told) == len(set(told)) >= 5
    assert findings[0].condition.startswith("the id")
