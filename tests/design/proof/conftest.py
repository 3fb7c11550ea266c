"""Certificates built by hand from closed forms, and an independent judgement of their claims.

Nothing here uses the package under test, or the rest of design: storage matrices come from energies or from Riccati
equations of scipy, and :meth:`Certificates.refuted` judges by frequency responses and eigenvalues.
"""

from __future__ import annotations

import copy
import hashlib
import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm, solve_discrete_are, solve_discrete_lyapunov

Matrix = NDArray[np.float64]
Data = dict[str, Any]
System = tuple[Matrix, Matrix, Matrix, Matrix]

T = 1e-3
_LESS = 1.0 - 1e-9  # what a level is lowered by, so that rounding it does not make it false
FREQUENCIES = np.concatenate([np.geomspace(1e-4, np.pi, 400), [np.pi]])  # rad/tick


class Certificates:
    """Builders of plain data, and the opinion."""

    T = T
    K26, B26 = np.diag([704.9058, 704.9336, 704.8754]), np.diag([0.0372] * 3)
    K27 = np.array([[660.4367, -0.2614, -0.3282], [-0.2614, 660.4181, -0.3429], [-0.3282, -0.3429, 660.4602]])
    B27 = np.array([[0.1674, -0.0003, -0.0005], [-0.0003, 0.1685, -0.0006], [-0.0005, -0.0006, 0.1675]])
    K28, B28 = np.diag([2735.5, 2734.6, 2735.5]), -1e-3 * np.diag([0.2648, 0.2798, 0.2838])
    hub_links = (
        {"between": ["p0", "hub"], "stiffness": 3800.0, "damping": 0.1},
        {"between": ["p1", "hub"], "stiffness": 3500.0, "damping": 0.2},
        {"between": ["p2", "hub"], "stiffness": 3300.0, "damping": 0.3},
        {"between": ["hub", "ground"], "stiffness": 2600.0, "damping": 0.5},
    )

    # --- parts

    @staticmethod
    def seal(data: Data) -> Data:
        """With the id of its own content, as a careful forger would have it."""
        content = {key: value for key, value in data.items() if key != "id"}
        text = json.dumps(content, sort_keys=data["version"] == 2, separators=(",", ":"), allow_nan=False)
        return {**data, "id": hashlib.sha256(text.encode()).hexdigest()}

    @staticmethod
    def hub(delay: int = 0) -> Data:
        return {
            "type": "network",
            "masses": {"hub": 3.0},
            "links": copy.deepcopy(list(Certificates.hub_links)),
            "delay": delay,
        }

    @staticmethod
    def greatest_level(K: Matrix, B: Matrix, Lambda: Matrix) -> Matrix:
        """Lambda J^-1 (J + B) J^-1 Lambda - Lambda."""
        J = Lambda - K * T / 2.0
        X = np.linalg.solve(J, Lambda)
        out = X.T @ (J + B) @ X - Lambda
        return (out + out.T) / 2.0

    def certificate(
        self,
        environment: Data,
        coupling: tuple[Matrix, Matrix],
        Phi_E: Matrix,
        storage: Any = "energy",
        blocks: list[list[int]] | None = None,
        gains: tuple[float, float, float] = (0.5, 1.0, 0.0),
        tau: float = 0.0,
        osp: float = 1.37,
        transparency: Data | None = None,
    ) -> Data:
        """A certificate for a spring-damper coupling (K, B), with the greatest Delta_V less 1e-9 of it."""
        K, B = coupling
        m = len(K)
        blocks = [list(range(m))] if blocks is None else blocks
        kappa, share, c = gains
        Delta_D = osp * np.eye(m)
        levels: Data = {"kappa": kappa, "share": share, "c": c, "Phi_E": Phi_E.tolist(), "Delta_D": {}, "Delta_V": {}}
        parts: Data = {}
        full = np.zeros((m, m))
        for i, block in enumerate(blocks):
            at = np.ix_(block, block)
            level = self.greatest_level(K[at], B[at], Delta_D[at] / (2.0 * kappa)) * _LESS
            full[at] = level
            levels["Delta_D"][f"c{i}"], levels["Delta_V"][f"c{i}"] = Delta_D[at].tolist(), level.tolist()
            parts[f"c{i}"] = {"stiffness": K[at].tolist(), "damping": B[at].tolist()}
        return self.seal(
            {
                "id": "",
                "format": "manyhands-certificate",
                "version": 3,
                "session": "test",
                "period": T,
                "tau": tau,
                "ports": [f"p{i}" for i in range(m)],
                "devices": {f"d{i}": {"ports": [f"p{i}"], "osp": [[osp]]} for i in range(m)},
                "structure": {f"c{i}": [f"p{p}" for p in block] for i, block in enumerate(blocks)},
                "environment": environment,
                "asked": {"coupling": "spring-damper", "objective": "feasible", "algorithm": "convex"},
                "coupling": {"class": "spring-damper", "blocks": parts},
                "levels": levels,
                "storage": {"E_hat": storage, "V_hat": {}},
                "transparency": transparency,
                "margins": {"(10)": self.margin(share * Delta_D, full, Phi_E)},
                "method": {"algorithm": "by hand", "iterations": 0},
            }
        )

    @staticmethod
    def margin(Delta_G: Matrix, Delta_V: Matrix, Phi_E: Matrix) -> float:
        """The least eigenvalue of (10)."""
        return float(np.linalg.eigvalsh(np.block([[Delta_G - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]]))[0])

    def as_linear(self, data: Data) -> Data:
        """The same coupling as linear blocks, (21) with the storage P = K^-1/(2T) + J^-1/2; Delta_V a little lower."""
        out = copy.deepcopy(data)
        kappa = out["levels"]["kappa"]
        for name, block in data["coupling"]["blocks"].items():
            K, B = np.array(block["stiffness"]), np.array(block["damping"])
            J = np.array(out["levels"]["Delta_D"][name]) / (2.0 * kappa) - K * T / 2.0
            C = np.linalg.inv(T * K + B)
            A = B @ C
            gain = np.linalg.inv(K)  # V(1), stated: D = T C in floats would make it symmetric only nearly
            matrices = {"A": A, "B": T * A, "C": C, "static": (gain + gain.T) / 2.0}
            out["coupling"]["blocks"][name] = {key: M.tolist() for key, M in matrices.items()}
            P = np.linalg.inv(K) / (2.0 * T) + np.linalg.inv(J) / 2.0
            out["storage"]["V_hat"][name] = P.tolist()
            level = np.array(out["levels"]["Delta_V"][name]) * (1.0 - 1e-6)  # M_V < 0 needs room
            out["levels"]["Delta_V"][name] = level.tolist()
        out["coupling"]["class"] = "linear"
        out["margins"] = {}
        return self.seal(out)

    @staticmethod
    def linear_system(block: Data) -> System:
        """(A, B, C, D) of a linear block, D from the static gain where that is stated."""
        last = np.array(block["static" if "static" in block else "D"], dtype=float)
        n = len(block["A"])
        shapes = ((n, n), (n, len(last)), (len(last), n))
        A, B, C = (np.array(block[k], dtype=float).reshape(s) for k, s in zip("ABC", shapes, strict=True))
        return A, B, C, last - C @ np.linalg.solve(np.eye(n) - A, B) if "static" in block else last

    # --- environments and their responses

    @staticmethod
    def network_matrices(environment: Data, ports: list[str], end: int = 0) -> tuple[Matrix, Matrix, Matrix]:
        """K, B over (ports, masses) and M, at the lower (0) or upper (-1) ends of intervals."""
        names = [*ports, *environment["masses"]]

        def pick(x: Any) -> float:
            return float(x[end] if isinstance(x, list) else x)

        K, B = np.zeros((2, len(names), len(names)))
        for link in environment["links"]:
            direction = np.zeros(len(names))
            for name, sign in zip(link["between"], (1.0, -1.0), strict=True):
                if name != "ground":
                    direction[names.index(name)] = sign
            K += pick(link["stiffness"]) * np.outer(direction, direction)
            B += pick(link["damping"]) * np.outer(direction, direction)
        return K, B, np.diag([pick(mass) for mass in environment["masses"].values()])

    def physical_level(self, environment: Data, ports: list[str], end: int = 0) -> Matrix:
        """S, the Schur complement of B + TK/2 onto the ports."""
        K, B, _ = self.network_matrices(environment, ports, end)
        Z, m = B + T * K / 2.0, len(ports)
        S = Z[:m, :m] - Z[:m, m:] @ np.linalg.solve(Z[m:, m:], Z[m:, :m]) if len(Z) > m else Z
        return (S + S.T) / 2.0

    def system(self, environment: Data, ports: list[str], end: int = 0, T: float = T) -> System:
        """E without its delay, discrete, in any realisation: networks in (q, v, u-)."""
        if environment["type"] == "network":
            K, B, M = self.network_matrices(environment, ports, end)
            m, n = len(ports), len(M)
            q, v, old, u = np.split(np.eye(2 * n + 2 * m), [n, 2 * n, 2 * n + m])
            inertia = M / T**2 + K[m:, m:] + B[m:, m:] / T
            load = (M / T**2 + B[m:, m:] / T) @ q + M / T @ v - K[m:, :m] @ u - B[m:, :m] / T @ (u - old)
            q_next = np.linalg.solve(inertia, load) if n else load
            force = K[:m, :m] @ u + K[:m, m:] @ q_next + B[:m, :m] / T @ (u - old) + B[:m, m:] / T @ (q_next - q)
            state = np.vstack([q_next, (q_next - q) / T, u])
            order = 2 * n + m
            return state[:, :order], state[:, order:], force[:, :order], force[:, order:]
        if "static" in environment:  # here stated for discrete ones alone
            return self.linear_system(environment)
        matrices = [np.array(environment[key], dtype=float) for key in "ABCD"]
        A, B, C, D = matrices
        n, m = len(A), len(ports)
        if environment["time"] == "discrete" or n == 0:
            return A, B, C, D
        if environment["method"] == "zoh":
            whole = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * T)
            return whole[:n, :n], whole[:n, n:], C, D
        step = T if environment["method"] == "backward-euler" else T / 2.0
        R = np.linalg.inv(np.eye(n) - step * A)
        A_d = R if step == T else R @ (np.eye(n) + step * A)
        return A_d, T * R @ B, C @ R, D + step * C @ R @ B

    def response(
        self, environment: Data, ports: list[str], z: NDArray[np.complex128], end: int = 0, T: float = T
    ) -> Any:
        """E at points z, points x m x m, with its delay."""
        if environment["type"] == "transfer-function":
            s = (z - 1) / (T * z) if environment["method"] == "backward-euler" else 2 * (z - 1) / (T * (z + 1))
            value = np.array(
                [[np.polyval(e["num"], s) / np.polyval(e["den"], s) for e in row] for row in environment["entries"]]
            ).transpose(2, 0, 1)
        else:
            value = respond(self.system(environment, ports, end, T), z)
        return value * z[:, None, None] ** -environment["delay"]

    def rest(self, system: System, delay: int = 0) -> tuple[Matrix, System]:
        """E1 and Rest, delayed, of a discrete system."""
        A, B, C, D = system
        n, m = len(A), len(D)
        steady = np.linalg.solve(np.eye(n) - A, B)
        E1 = C @ steady + D
        rest = (A, -T * A @ steady, C, T * D)
        for _ in range(delay):  # tick by tick: Rest becomes z^-1 Rest - T E1 z^-1, its input's delay a state in front
            A, B, C, D = rest
            rest = (
                np.block([[A, B], [np.zeros((m, len(A) + m))]]),
                np.vstack([np.zeros((len(A), m)), np.eye(m)]),
                np.hstack([C, D - T * E1]),
                np.zeros((m, m)),
            )
        return E1, rest

    # --- storages

    @staticmethod
    def storage(E1: Matrix, rest: System, Phi_E: Matrix, room: float = 1e-6) -> Matrix:
        """P of M_E < 0, from one Riccati equation with ``room`` (relative, in energy) on the states' side."""
        A, B, C, D = rest
        R = (D + D.T) / 2.0 + Phi_E - T / 2.0 * E1
        # the first time in coordinates in which white velocity gives white states, then in those in which P is I
        W = solve_discrete_lyapunov(A, B @ B.T)
        scale = np.linalg.cholesky(W + 1e-9 * np.trace(W) * np.eye(len(A)))
        for _ in range(2):
            X = np.linalg.inv(scale)
            P = solve_discrete_are(X @ A @ scale, X @ B, room * np.eye(len(A)), -R, s=-(C @ scale).T / 2.0)
            P = X.T @ (P + P.T) @ X / 2.0
            scale = np.linalg.inv(np.linalg.cholesky(P)).T
        return P

    @staticmethod
    def bounded_real(system: System, gamma: float, room: float = 1e-6) -> Matrix:
        """P of the bounded real lemma, from its Riccati equation where white noise gives white states."""
        A, B, C, D = system[0], system[1], system[2] / gamma, system[3] / gamma
        W = solve_discrete_lyapunov(A, B @ B.T)
        d = np.sqrt(np.diag(W))
        scale = d[:, None] * np.linalg.cholesky(W / d / d[:, None] + 1e-9 * np.eye(len(A)))
        X = np.linalg.inv(scale)
        A, B, C = X @ A @ scale, X @ B, C @ scale
        P = solve_discrete_are(A, B, C.T @ C + room * np.eye(len(A)), D.T @ D - np.eye(B.shape[1]), s=C.T @ D)
        return gamma**2 * X.T @ (P + P.T) @ X / 2.0

    # --- the opinion

    def refuted(self, data: Data) -> list[str]:
        """The clearly false parts of the claim, by numpy: beyond 1e-7 relative; an empty result proves nothing."""
        T = data["period"]
        if not (T > 0.0 and 0.0 <= data["tau"] <= T):
            return ["period"]
        ports, levels = data["ports"], data["levels"]
        m = len(ports)
        blocks = {name: [ports.index(p) for p in block] for name, block in data["structure"].items()}
        D, V, osp = np.zeros((3, m, m))
        for name, block in blocks.items():
            D[np.ix_(block, block)] = levels["Delta_D"][name]
            V[np.ix_(block, block)] = levels["Delta_V"][name]
        for device in data["devices"].values():
            at = [ports.index(p) for p in device["ports"]]
            osp[np.ix_(at, at)] = device["osp"]
        Phi, kappa, share, c = np.array(levels["Phi_E"]), levels["kappa"], levels["share"], levels["c"]
        out = [] if _least(osp - D) > -1e-7 and _least(D) > 0.0 and _least(V) > 0.0 else ["Delta"]
        for t in np.linspace(0.0, data["tau"] / T, 9):
            cross = 0.5 - share * kappa
            F = [
                [1.0 - share, cross, t / 2.0],
                [cross, kappa / 2.0 - c - share * kappa**2, 0.0],
                [t / 2.0, 0.0, c - t * (1.0 - t) / 4.0],
            ]
            out += ["device"] if _least(np.array(F)) < -1e-7 or min(share, kappa) <= 0.0 else []
        if _least(np.block([[share * D - Phi, -Phi], [-Phi, V - Phi]])) < -1e-7:
            out.append("(10)")
        if out:
            return out  # K = kappa T Delta_D^-1 may not exist
        z = np.exp(1j * FREQUENCIES)
        for name, block in blocks.items():
            at = np.ix_(block, block)
            out += self._block_refuted(data["coupling"]["blocks"][name], z, T, kappa * T * np.linalg.inv(D[at]), V[at])
        environment = data["environment"]
        if environment["type"] == "network":
            spans = [*environment["masses"].values()]
            spans += [link[key] for link in environment["links"] for key in ("stiffness", "damping")]
            if min(np.min(span) for span in spans) < 0.0:
                return [*out, "negative parameter"]
        for end in (0, -1):
            E = self.response(environment, ports, z, end, T)
            E_hat = E * (T * z / (z - 1.0))[:, None, None]
            size = np.abs(E_hat).max(axis=(1, 2)) + np.abs(Phi).max()
            if np.any(_least(_hermitian(E_hat) + Phi) < -1e-7 * size):
                out.append("E_hat")
        for name, stated in data["margins"].items():
            true = {"(10)": self.margin(share * D, V, Phi), "Delta_V": _least(V), "Delta_D": _least(D)}[name]
            out += ["margin"] if stated > true + 3e-6 * abs(stated) + 1e-9 else []
        if data["transparency"] is not None:
            norm = float(np.max(np.linalg.svd(self.weighted(data, z), compute_uv=False)))
            out += ["gamma"] if norm > data["transparency"]["gamma"] * (1.0 + 1e-7) else []
        return out

    def _block_refuted(self, block: Data, z: NDArray[np.complex128], T: float, K: Matrix, level: Matrix) -> list[str]:
        if "A" in block:
            system = self.linear_system(block)
            radius = max(abs(np.linalg.eigvals(system[0])), default=0.0)
            V = respond(system, z)
        else:
            k, b = np.array(block["stiffness"]), np.array(block["damping"])
            radius = float(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(T * k + b, b)))))
            V = np.linalg.inv(k + b * ((z - 1.0) / (T * z))[:, None, None])
        if radius > 1.0 + 1e-9:
            return ["V unstable"]
        V_hat = (V - K) * ((z - 1.0) / (T * z))[:, None, None]
        form = _hermitian(V_hat) - np.conj(V_hat.transpose(0, 2, 1)) @ level @ V_hat
        size = np.abs(V_hat).max(axis=(1, 2)) + np.abs(level).max() * np.abs(V_hat).max(axis=(1, 2)) ** 2
        return ["V_hat"] if np.any(_least(form) < -1e-7 * size) else []

    def weighted(self, data: Data, z: NDArray[np.complex128]) -> Any:
        """W1 E V W2 or W1 (F - E) W2 at points z, points x m x m."""
        ports, claim, T = data["ports"], data["transparency"], data["period"]
        m = len(ports)
        V = np.zeros((len(z), m, m), dtype=complex)
        for name, names in data["structure"].items():
            at = [ports.index(p) for p in names]
            block = data["coupling"]["blocks"][name]
            if "A" in block:
                V[:, np.array(at)[:, None], at] = respond(self.linear_system(block), z)
            else:
                k, b = np.array(block["stiffness"]), np.array(block["damping"])
                V[:, np.array(at)[:, None], at] = np.linalg.inv(k + b * ((z - 1.0) / (T * z))[:, None, None])
        E = self.response(data["environment"], ports, z, 0, T)
        core = E @ V if claim["objective"] == "loop-shaping" else np.linalg.solve(np.eye(m) + E @ V, E) - E
        w = [np.polyval(claim[i]["num"], z) / np.polyval(claim[i]["den"], z) for i in ("W1", "W2")]
        return core * (w[0] * w[1])[:, None, None]


def respond(system: System, z: NDArray[np.complex128]) -> Any:
    """C (zI - A)^-1 B + D at points z."""
    A, B, C, D = system
    resolvent = np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape)))
    return C @ resolvent + D


def blocks_of(parts: list[System]) -> System:
    """The decoupled system of several."""
    A, B, C, D = (block_diag(*(part[i] for part in parts)) for i in range(4))
    return A, B, C, D


def _hermitian(M: Any) -> Any:
    return (M + np.conj(M.transpose(0, 2, 1))) / 2.0


def _least(M: Any) -> Any:
    return np.linalg.eigvalsh(M)[..., 0]


@pytest.fixture(scope="session")
def certificates() -> Certificates:
    return Certificates()
