"""Designs of design() with changed data and a recomputed id: every claim that numpy refutes is rejected."""

from __future__ import annotations

import copy
import dataclasses
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manyhands.design.certificate import content
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import DelayedNetwork, NetworkBox
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import CouplingRequest, DeviceLevel, HapticLoop, LinearGiven, SpringDamperGiven
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.synthesis import design

Data = dict[str, Any]
Matrix = NDArray[np.float64]
Path = tuple[Any, ...]
SECTIONS = (
    "period", "tau", "devices", "environment", "coupling", "levels", "storage", "transparency", "margins",
)  # fmt: skip
CLEARLY = 1e-7  # relative: what is false by less is left to the proof alone


# --- what design() makes


def certified(loop: HapticLoop, wanted: CouplingRequest) -> Data:
    certificate = design(loop, wanted).certificate
    return content(certificate) | {"id": certificate.id}


def hundred() -> HapticLoop:
    """A hundred hands, a mass each, five of them in a chain: proved by its energy."""
    ports = tuple(f"p{i}" for i in range(100))
    links = [NetworkLink((port, f"m{i}"), 2000.0 + i, 0.3) for i, port in enumerate(ports)]
    links += [NetworkLink((f"m{i}", f"m{i + 1}" if i % 5 < 4 else GROUND), 500.0, 0.2) for i in range(100)]
    network = Network(ports, tuple((f"m{i}", 0.5) for i in range(100)), tuple(links))
    devices = tuple(DeviceLevel(port, (i,), np.array([[1.0 + i / 100.0]])) for i, port in enumerate(ports))
    return HapticLoop("hundred", 1e-3, ports, devices, Partition(ports, tuple((i,) for i in range(100))), box(network))


def box(network: Network) -> NetworkBox:
    links = tuple(NetworkLink(link.ends, 1.5 * link.stiffness, 2.0 * link.damping) for link in network.links)
    return NetworkBox(network, Network(network.ports, tuple((n, 3.0 * mass) for n, mass in network.masses), links))


def cases(problems) -> dict[str, tuple[HapticLoop, CouplingRequest]]:
    apart, joined, T = problems.example_1(), problems.example_1(problems.centralised), problems.T
    shaping = Transparency("loop-shaping", Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), T), Filter.one())
    closed = dataclasses.replace(shaping, objective="closed-loop")
    soft = Network(("x",), (("m", 0.5),), (NetworkLink(("x", "m"), 300.0, 0.4), NetworkLink(("m", GROUND), 200.0, 0.5)))
    late = dataclasses.replace(
        problems.loop(soft, Partition(("c",), ((0,),)), [2.0], T), environment=DelayedNetwork(soft, 2), tau=1e-4
    )
    many = hundred()
    return {
        "26": (apart, SpringDamperGiven(problems.C26)),
        "27": (joined, SpringDamperGiven(problems.C27)),
        "28 shaped": (apart, SpringDamperGiven(problems.C28, shaping)),
        "linear": (joined, LinearGiven(problems.blocks(joined, problems.C27), closed)),
        "late": (late, SpringDamperGiven(problems.uniform(900.0, 0.3, 1))),
        "intervals": (dataclasses.replace(apart, environment=box(problems.network)), SpringDamperGiven(problems.C26)),
        "hundred": (many, SpringDamperGiven(SpringDamper(700.0 * np.eye(100), 0.1 * np.eye(100)))),
    }


# --- one entry changed


def leaves(value: Any, path: Path = ()) -> Iterator[Path]:
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*path, key))
    elif isinstance(value, int | float):
        yield path


def at(data: Any, path: Path) -> Any:
    for key in path:
        data = data[key]
    return data


def mutant(data: Data, choose: random.Random, spots: list[list[Path]]) -> tuple[Data, Path]:
    """One number changed, by a factor from next to nothing to ten or by its sign; a symmetric matrix stays one."""
    path = choose.choice(choose.choice(spots))
    old = at(data, path)
    out = copy.deepcopy(data)
    if isinstance(old, int):
        new: float = old + choose.choice((-1, 1))
    elif choose.random() < 0.2:
        new = choose.choice((-old, 0.0, old + 1.0))
    else:
        new = old * (1.0 + choose.choice((-1.0, 1.0)) * 10.0 ** choose.uniform(-5.0, 1.0))
    at(out, path[:-1])[path[-1]] = new
    if len(path) > 2 and isinstance(path[-1], int) and isinstance(path[-2], int):
        mirror = (*path[:-2], path[-1], path[-2])
        try:
            if at(data, mirror) == old:
                at(out, mirror[:-1])[mirror[-1]] = new
        except IndexError:
            pass  # a row of B or C: no square matrix
    return out, path


def proved(data: Data) -> bool:
    try:
        return all(finding.holds for finding in prove(data))
    except ProofInputError:
        return False


# --- the opinion on storages: P is offered as the proof, so its own inequality must hold


def least(M: Matrix, scale: Matrix | None = None) -> float:
    """Least eigenvalue of M in units in which ``scale`` (or M's own diagonal) is 1."""
    if not M.size:
        return 0.0
    d = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(M) if scale is None else scale), 1e-300))
    return float(np.linalg.eigvalsh(d[:, None] * (M + M.T) / 2.0 * d)[0])


def rest_of(certificates, data: Data) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    """E1 and Rest of a network whose masses are all held by springs, the chain of its delay behind (e, v)."""
    T, environment, m = data["period"], data["environment"], len(data["ports"])
    K, B, M = certificates.network_matrices(environment, data["ports"])
    n = len(M)
    e, v, w = np.split(np.eye(2 * n + m), [n, 2 * n])
    coupled, sag = B[m:, :m] + T * K[m:, :m], np.linalg.solve(K[m:, m:], K[m:, :m])
    v_next = np.linalg.solve(M / T + B[m:, m:] + T * K[m:, m:], M @ v / T - K[m:, m:] @ e - coupled @ w)
    f = K[:m, m:] @ e + coupled.T @ v_next + (B[:m, :m] + T * K[:m, :m]) @ w
    whole, E1 = np.vstack([e + T * (v_next + sag @ w), v_next, f]), K[:m, :m] - K[:m, m:] @ sag
    A, rhs, C, D = whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n :], whole[2 * n :, : 2 * n], whole[2 * n :, 2 * n :]
    d = environment["delay"]
    if d == 0:
        return E1, A, rhs, C, D
    order = 2 * n + m * d
    A_d, B_d, C_d = np.zeros((order, order)), np.zeros((order, m)), np.zeros((m, order))
    A_d[: 2 * n, : 2 * n], A_d[: 2 * n, order - m :] = A, rhs
    A_d[2 * n + m :, 2 * n : order - m] = np.eye(m * (d - 1))
    B_d[2 * n : 2 * n + m] = np.eye(m)
    C_d[:, : 2 * n], C_d[:, 2 * n :] = C, np.hstack([-T * E1] * d)
    C_d[:, order - m :] += D
    return E1, A_d, B_d, C_d, np.zeros((m, m))


def phi(data: Data) -> Matrix:
    stated, ports = data["levels"]["Phi_E"], data["ports"]
    if isinstance(stated, list):
        return np.array(stated)
    out = np.zeros((len(ports), len(ports)))
    for name, block in data["structure"].items():
        rows = [ports.index(port) for port in block]
        out[np.ix_(rows, rows)] = stated[name]
    return out


def environment_refuted(certificates, data: Data) -> bool:
    T, Phi, P = data["period"], phi(data), data["storage"]["E_hat"]
    m = len(Phi)
    if P == "energy":
        K, B, _ = certificates.network_matrices(data["environment"], data["ports"])
        Z = B + T * K / 2.0
        own = np.diag(Z).copy()
        own[:m] += np.abs(np.diag(Phi))
        Z[:m, :m] += Phi
        return least(Z, own) < -CLEARLY
    E1, A, B, C, D = rest_of(certificates, data)
    P = np.array(P, dtype=float).reshape(len(A), len(A))
    if least(P) < -CLEARLY or np.any(np.diag(P) <= 0.0):
        return True
    G = np.hstack([A, B])
    level = (D + D.T) / 2.0 + Phi - T / 2.0 * E1
    M = np.block([[P, C.T / 2.0], [C / 2.0, level]]) - G.T @ P @ G
    return (
        least(M, np.concatenate([np.diag(P), np.abs(np.diag(D)) + np.abs(np.diag(Phi)) + T * np.diag(E1)])) < -CLEARLY
    )


def block_refuted(certificates, data: Data, name: str) -> bool:
    """Pi > 0 and M_V <= 0 of a linear block."""
    T, block = data["period"], data["coupling"]["blocks"][name]
    A, B, C, D = certificates.linear_system(block)
    P, level = np.array(data["storage"]["V_hat"][name]), np.array(data["levels"]["Delta_V"][name])
    n, m = B.shape
    K = data["levels"]["kappa"] * T * np.linalg.inv(data["levels"]["Delta_D"][name])
    V_1 = D + C @ np.linalg.solve(np.eye(n) - A, B)
    if np.abs(V_1 - V_1.T).max() > 1e-6 * np.abs(V_1).max():
        return True
    off = np.linalg.solve((A - np.eye(n)).T, C.T) / 2.0
    Pi = np.block([[P, off], [off.T, ((V_1 + V_1.T) / 2.0 - K) / (2.0 * T)]])
    if np.any(np.diag(Pi) <= 0.0) or least(Pi) < -CLEARLY:
        return True
    following = np.block([[A, B / T], [np.zeros((m, n)), np.eye(m)]])
    y, picked = np.hstack([C, (D - K) / T]), np.hstack([np.zeros((m, n)), np.eye(m)])
    stored = np.zeros((n + m, n + m))
    stored[:n, :n] = P
    M = following.T @ Pi @ following - stored - picked.T @ y + y.T @ level @ y
    return least(-M, np.diag(Pi)) < -CLEARLY


def series(*systems: tuple[Matrix, ...]) -> tuple[Matrix, ...]:
    out = systems[0]
    for A, B, C, D in systems[1:]:
        A_1, B_1, C_1, D_1 = out
        corner = np.zeros((len(A_1), len(A)))
        out = (np.block([[A_1, corner], [B @ C_1, A]]), np.vstack([B_1, B @ D_1]), np.hstack([D @ C_1, C]), D @ D_1)
    return out


def weighted(certificates, data: Data) -> tuple[Matrix, ...]:
    """W1 E V W2, or W1 (F - E) W2, in the states that the claim's P is about."""
    T, m, claim = data["period"], len(data["ports"]), data["transparency"]
    E1, A, B, C, D = rest_of(certificates, data)
    n = len(A)
    E = (
        np.block([[A, -B / T], [np.zeros((m, n + m))]]),
        np.vstack([B / T, np.eye(m)]),
        np.hstack([C, E1 - D / T]),
        D / T,
    )
    parts = []
    for block in data["coupling"]["blocks"].values():
        if "A" in block:
            parts.append(certificates.linear_system(block))
        else:
            C_V = np.linalg.inv(T * np.array(block["stiffness"]) + np.array(block["damping"]))
            A_V = np.array(block["damping"]) @ C_V
            parts.append([A_V, T * A_V, C_V, T * C_V])
    ports = [data["ports"].index(port) for block in data["structure"].values() for port in block]
    assert ports == list(range(m))  # blocks in the ports' order: stacked, they are V
    V = tuple(np.array(_diagonal([part[i] for part in parts])) for i in range(4))
    W = []
    for name in ("W2", "W1"):
        num, den = (np.array(claim[name][key], dtype=float) for key in ("num", "den"))
        num, den = np.concatenate([np.zeros(len(den) - len(num)), num]) / den[0], den / den[0]
        k = len(den) - 1
        A_W = np.eye(k, k=-1)
        A_W[:1] = -den[1:]
        rows = (A_W, np.eye(k, 1), (num[1:] - den[1:] * num[0])[None, :], num[:1, None])
        W.append(tuple(np.kron(M, np.eye(m)) for M in rows))
    if claim["objective"] == "loop-shaping":
        return series(W[0], V, E, W[1])
    N = np.linalg.inv(np.eye(m) + E[3] @ V[3])
    S = np.hstack([-N @ E[3] @ V[2], -N @ E[2]])
    entering = np.vstack([V[1], E[1] @ V[3]])
    free = np.block([[V[0], np.zeros((len(V[0]), n + m))], [E[1] @ V[2], E[0]]])
    return series(W[0], E, (free + entering @ S, entering @ N, S, N - np.eye(m)), W[1])


def _diagonal(parts: list[Matrix]) -> Matrix:
    out = np.zeros(tuple(sum(part.shape[i] for part in parts) for i in (0, 1)))
    row = column = 0
    for part in parts:
        out[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return out


def transparency_refuted(certificates, data: Data) -> bool:
    """P > 0 and the bounded real lemma's inequality."""
    claim = data["transparency"]
    A, B, C, D = weighted(certificates, data)
    P, gamma = np.array(claim["P"]), claim["gamma"]
    if gamma <= 0.0 or np.any(np.diag(P) <= 0.0) or least(P) < -CLEARLY:
        return True
    G, y = np.hstack([A, B]), np.hstack([C, D])
    kept = np.zeros((len(A) + len(D), len(A) + len(D)))
    kept[: len(A), : len(A)], kept[len(A) :, len(A) :] = P, gamma**2 * np.eye(len(D))
    return least(kept - G.T @ P @ G - y.T @ y, np.diag(kept)) < -CLEARLY


def many_refuted(data: Data) -> bool:
    """For one-port blocks of springs and dampers, without a loop over the frequencies of the environment."""
    T, levels = data["period"], data["levels"]
    kappa, share, c = (levels[name] for name in ("kappa", "share", "c"))
    if not (T > 0.0 and 0.0 <= data["tau"] <= T and kappa > 0.0 and share > 0.0):
        return True
    Delta_D, Delta_V, Phi = (
        np.array([levels[name][block][0][0] for block in data["structure"]]) for name in ("Delta_D", "Delta_V", "Phi_E")
    )
    osp = np.array([device["osp"][0][0] for device in data["devices"].values()])
    k, b = (
        np.array([part[name][0][0] for part in data["coupling"]["blocks"].values()])
        for name in ("stiffness", "damping")
    )
    cross = 0.5 - share * kappa
    form = np.array([[1.0 - share, cross], [cross, kappa / 2.0 - c - share * kappa**2]])
    if np.linalg.eigvalsh(form)[0] < -CLEARLY or c < -CLEARLY:
        return True
    if np.any(osp < Delta_D * (1.0 - CLEARLY)) or np.any(Delta_D <= 0.0) or np.any(Delta_V <= 0.0):
        return True
    pairs = np.array([[share * Delta_D - Phi, -Phi], [-Phi, Delta_V - Phi]]).transpose(2, 0, 1)
    margin = float(np.linalg.eigvalsh(pairs)[:, 0].min())
    if margin < -CLEARLY or data["margins"].get("(10)", -np.inf) > margin + 3e-6 * abs(margin) + 1e-9:
        return True
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 100))
    step = (z - 1.0) / (T * z)
    with np.errstate(all="ignore"):
        V_hat = (1.0 / (k[:, None] + b[:, None] * step) - kappa * T / Delta_D[:, None]) * step
    dissipated = V_hat.real - Delta_V[:, None] * np.abs(V_hat) ** 2
    size = np.abs(V_hat) + Delta_V[:, None] * np.abs(V_hat) ** 2
    unstable = np.abs(b) > np.abs(T * k + b) * (1.0 + 1e-9)
    values = [*data["environment"]["masses"].values()]
    values += [link[key] for link in data["environment"]["links"] for key in ("stiffness", "damping")]
    return bool(
        np.any(unstable) or np.any(dissipated < -CLEARLY * size) or min(np.min(value) for value in values) < 0.0
    )


def refuted(certificates, data: Data) -> bool:
    """Whether the claim is clearly false, or what it offers as a proof clearly is none."""
    if len(data["ports"]) > 10:
        return many_refuted(data) or environment_refuted(certificates, data)
    if data["environment"]["delay"] < 0:
        return True
    # the opinion on frequencies reads Phi_E as one matrix
    whole = {**data, "levels": {**data["levels"], "Phi_E": phi(data).tolist()}}
    if certificates.refuted(whole) or environment_refuted(certificates, data):
        return True
    linear = data["coupling"]["class"] == "linear"
    if linear and any(block_refuted(certificates, data, name) for name in data["structure"]):
        return True
    return data["transparency"] is not None and transparency_refuted(certificates, data)


NAMES = ("26", "27", "28 shaped", "linear", "late", "intervals")


@pytest.mark.parametrize("name", [*NAMES, pytest.param("hundred", marks=pytest.mark.long)])
def test_what_is_made_false_is_not_proved(problems, certificates, name: str) -> None:
    """A hundred false claims each, from changes of every size in every section of the file."""
    data = certified(*cases(problems)[name])
    assert proved(data)
    assert not refuted(certificates, data)
    choose = random.Random(f"mutations of {name}")
    spots = [found for section in SECTIONS if (found := list(leaves(data[section], (section,))))]
    false: dict[str, int] = {}
    for _ in range(2000):
        changed, path = mutant(data, choose, spots)
        if path[0] != "margins":
            changed["margins"] = {}  # whatever is false must be found by itself, not by the margin that it spoils
        try:
            if not refuted(certificates, changed):
                continue
        except (np.linalg.LinAlgError, ZeroDivisionError):
            continue  # no opinion
        false[path[0]] = false.get(path[0], 0) + 1
        assert not proved(certificates.seal(changed)), (path, at(data, path), at(changed, path))
        if sum(false.values()) == 100:
            break
    assert sum(false.values()) == 100, false
    assert len(false) >= 5, false  # not all of them of one kind
