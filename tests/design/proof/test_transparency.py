"""Transparency levels are proved down to the norm that frequency responses show, and not below."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from manyhands.design.proof import prove

Data = dict[str, Any]
T = 1e-3
PORTS = ["p0", "p1", "p2"]
# 1/(1 + s/125) by backward Euler, s = (z-1)/(Tz)
LOW_PASS = {"num": [T * 125.0 / (1.0 + T * 125.0), 0.0], "den": [1.0, -1.0 / (1.0 + T * 125.0)]}
# a band-pass of two states, with a gain that is divided out
BAND = {"num": [2.0, -2.0, 0.0], "den": [20.0, -38.0, 18.05]}
ONE = {"num": [1.0], "den": [1.0]}


def series(*systems):
    """The systems one after the other, the first at the input."""
    A, B, C, D = systems[0]
    for A_2, B_2, C_2, D_2 in systems[1:]:
        A, B, C, D = (
            np.block([[A, np.zeros((len(A), len(A_2)))], [B_2 @ C, A_2]]),
            np.vstack([B, B_2 @ D]),
            np.hstack([D_2 @ C, C_2]),
            D_2 @ D,
        )
    return A, B, C, D


def weight(w: Data, m: int):
    a, n = np.array(w["den"]) / w["den"][0], len(w["den"]) - 1
    b = np.concatenate([np.zeros(n + 1 - len(w["num"])), w["num"]]) / w["den"][0]
    A = np.eye(n, k=-1)
    if n:
        A[0] = -a[1:]
    eye = np.eye(m)
    return np.kron(A, eye), np.kron(np.eye(n, 1), eye), np.kron((b[1:] - a[1:] * b[0])[None, :], eye), b[0] * eye


def coupling(certificates, data: Data, m: int):
    """V, the states by block, the ports where they belong."""
    parts, order = [], []
    for name, ports in data["structure"].items():
        block = data["coupling"]["blocks"][name]
        order += [data["ports"].index(p) for p in ports]
        if "A" in block:
            parts.append(certificates.linear_system(block))
        else:
            K, B = np.array(block["stiffness"]), np.array(block["damping"])
            C = np.linalg.inv(T * K + B)
            parts.append((B @ C, T * B @ C, C, T * C))
    whole = []
    for k in range(4):
        rows, columns = sum(p[k].shape[0] for p in parts), sum(p[k].shape[1] for p in parts)
        M, i, j = np.zeros((rows, columns)), 0, 0
        for part in parts:
            M[i : i + part[k].shape[0], j : j + part[k].shape[1]] = part[k]
            i, j = i + part[k].shape[0], j + part[k].shape[1]
        whole.append(M)
    A, B, C, D = whole
    S = np.eye(m)[:, order]
    return A, B @ S.T, S @ C, S @ D @ S.T


def environment(certificates, data: Data):
    """E in the state (eta, u-), from Rest of the network in the states (e, v)."""
    K, B, M = certificates.network_matrices(data["environment"], data["ports"])
    m, n = len(data["ports"]), len(M)
    e, v, w = np.split(np.eye(2 * n + m), [n, 2 * n])
    lead = np.linalg.inv(M / T + B[m:, m:] + T * K[m:, m:])
    v_next = lead @ (M @ v / T - K[m:, m:] @ e - (B[m:, :m] + T * K[m:, :m]) @ w)
    e_next = e + T * (v_next + np.linalg.solve(K[m:, m:], K[m:, :m]) @ w)
    f = K[:m, m:] @ e + (B[:m, m:] + T * K[:m, m:]) @ v_next + (B[:m, :m] + T * K[:m, :m]) @ w
    E1 = K[:m, :m] - K[:m, m:] @ np.linalg.solve(K[m:, m:], K[m:, :m])
    state = np.vstack([e_next, v_next])
    A_r, B_r, C_r, D_r = state[:, : 2 * n], state[:, 2 * n :], f[:, : 2 * n], f[:, 2 * n :]
    return (
        np.block([[A_r, -B_r / T], [np.zeros((m, 2 * n + m))]]),
        np.vstack([B_r / T, np.eye(m)]),
        np.hstack([C_r, E1 - D_r / T]),
        D_r / T,
    )


def realisation(certificates, data: Data):
    """The system that P is for, in floats, by the documented order of states."""
    claim, m = data["transparency"], len(data["ports"])
    W1, W2 = weight(claim["W1"], m), weight(claim["W2"], m)
    V, E = coupling(certificates, data, m), environment(certificates, data)
    if claim["objective"] == "loop-shaping":
        return series(W2, V, E, W1)
    (A_V, B_V, C_V, D_V), (A_E, B_E, C_E, D_E) = V, E
    N = np.linalg.inv(np.eye(m) + D_E @ D_V)
    S = np.hstack([-N @ D_E @ C_V, -N @ C_E])
    entering = np.vstack([B_V, B_E @ D_V])
    free = np.block([[A_V, np.zeros((len(A_V), len(A_E)))], [B_E @ C_V, A_E]])
    loop = free + entering @ S, entering @ N, S, N - np.eye(m)
    return series(W2, E, loop, W1)


def example(certificates, which: str, blocks, objective: str, W1: Data, W2: Data, linear: bool = False) -> Data:
    hub = certificates.hub()
    S = certificates.physical_level(hub, PORTS)
    K, B = getattr(certificates, f"K{which}"), getattr(certificates, f"B{which}")
    data = certificates.certificate(hub, (K, B), -S * (1.0 - 1e-9), blocks=blocks)
    data = certificates.as_linear(data) if linear else data
    data["transparency"] = {"objective": objective, "W1": W1, "W2": W2, "gamma": 1.0, "P": []}
    return data


def norm(certificates, data: Data) -> float:
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 20_000))
    return float(np.max(np.linalg.svd(certificates.weighted(data, z), compute_uv=False)))


@pytest.mark.parametrize(
    ("which", "blocks", "objective", "W1", "W2", "linear", "known"),
    [
        ("28", [[0], [1], [2]], "loop-shaping", LOW_PASS, ONE, False, 12.636),
        ("26", [[0], [1], [2]], "loop-shaping", LOW_PASS, ONE, False, 49.02),
        ("27", [[2, 0, 1]], "loop-shaping", ONE, BAND, True, None),
        ("26", [[2], [0], [1]], "closed-loop", LOW_PASS, ONE, False, None),
        ("27", None, "closed-loop", LOW_PASS, BAND, True, None),
    ],
)
def test_down_to_the_norm(certificates, which, blocks, objective, W1, W2, linear, known) -> None:
    data = example(certificates, which, blocks, objective, W1, W2, linear)
    true = norm(certificates, data)
    if known is not None:
        assert true == pytest.approx(known, rel=1e-3)
    system = realisation(certificates, data)
    z = np.exp(1j * np.array([0.01, 0.07, 1.0]))
    resolvent = np.linalg.solve(z[:, None, None] * np.eye(len(system[0])) - system[0], system[1][None])
    np.testing.assert_allclose(system[2] @ resolvent + system[3], certificates.weighted(data, z), rtol=1e-6, atol=1e-9)
    gamma = true * 1.001
    P = certificates.bounded_real(system, gamma)
    for level, holds in ((gamma * 1.0001, True), (true * 0.999, False), (-gamma * 1.0001, False)):
        data["transparency"] |= {"gamma": level, "P": P.tolist()}
        findings = prove(certificates.seal(data))
        failed = [f.condition for f in findings if not f.holds]
        assert (not failed) is holds, failed
        if not holds:
            assert all(text.startswith("transparency") for text in failed)


def test_a_storage_of_another_size_or_sign(certificates) -> None:
    data = example(certificates, "26", None, "loop-shaping", LOW_PASS, ONE)
    for P, gamma in ([[1.0]], 50.0), ((-np.eye(11)).tolist(), 50.0), (np.eye(11).tolist(), -50.0):
        data["transparency"] |= {"gamma": gamma, "P": P}
        assert next(f.condition for f in prove(certificates.seal(data)) if not f.holds).startswith("transparency")
