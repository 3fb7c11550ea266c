"""Direct tests of a certificate's claims about each party: statics by rationals, levels, and Hermitian parts.

Every test returns the names of the claims that it contradicts. Frequencies are searched in floats, and a hit is a
suspect: :func:`confirmed` builds the Hermitian part again at that frequency, in balls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from flint import acb, fmpq, fmpq_mat

from tests.attack.arithmetic import Array, Floats, certainly_negative, decimal, rational, semidefinite
from tests.attack.parties import Data, NoSystem, Reader, precise, static_compliance, static_stiffness, uncertain

_ROUNDING = 1e-10  # of a Hermitian part's own size: floats tell no less
_ANGLES = np.concatenate([np.geomspace(1e-4, 0.3, 14), np.linspace(0.4, np.pi - 1e-3, 14)])
_OVERSTATED = 10**6  # a margin is stated for the reader, and may be too large by this part of itself
_DELAYS = (0, fmpq(1, 4), fmpq(1, 2), fmpq(3, 4), 1)


@dataclass(frozen=True)
class Suspect:
    """What floats contradict.

    Attributes:
        what: which promise.
        angle: of z on the unit circle, rad.
        ratios: of the clutches, block by block, where they matter.
    """

    what: str
    angle: float
    ratios: tuple[float, ...] = ()


# --- exactly


def statics(data: Data) -> list[str]:
    """E(1) = E(1)' >= 0, V(1) = V(1)', no negative part in a network; by the decimals of the file."""
    out, E = [], data["environment"]
    if E["type"] == "network":
        ends = [end for link in E["links"] for key in ("stiffness", "damping") for end in _ends(link[key])]
        if any(end < 0 for end in ends) or any(end <= 0 for mass in E["masses"].values() for end in _ends(mass)):
            out.append("a network's parts are positive")
        elif not _geared(E["links"]):
            out.append("gears can turn")
        elif not _counted(data):
            out.append("what is counted in series is the world's own")
    elif "series" in data and not _counted_springs(data):
        out.append("what is counted in series is the world's own")
    elif E["type"] != "declared":
        E1 = static_stiffness(data)
        if E1 is None:
            out.append("E has no pole at z = 1")
        elif any(E1[i][j] != E1[j][i] for i in range(len(E1)) for j in range(i)):
            out.append("E(1) is symmetric")
        elif not semidefinite(E1):
            out.append("E(1) >= 0")
    for name in data["structure"] if data["coupling"]["class"] == "linear" else ():
        V1 = static_compliance(data, name)
        if V1 is None or any(V1[i][j] != V1[j][i] for i in range(len(V1)) for j in range(i)):
            out.append("V(1) is symmetric")
    return out


def _geared(links: list[Data]) -> bool:
    """Whether all links keep their length in some motion of all ends, but for those to the ground: exactly."""
    held = [link for link in links if "ground" not in link["between"]]
    names = sorted({end for link in held for end in link["between"]})
    arms = [[decimal(arm) for arm in link.get("arms", (1, 1))] for link in held]
    if any(arm <= 0 for pair in arms for arm in pair):
        return False
    if not held:
        return True
    rows = [[fmpq(0)] * len(names) for _ in held]
    groups = {name: {name} for name in names}
    for row, link, (a, b) in zip(rows, held, arms, strict=True):
        one, other = link["between"]
        row[names.index(one)], row[names.index(other)] = a, -b
        for name in (together := groups[one] | groups[other]):
            groups[name] = together
    return fmpq_mat(rows).rank() == len(names) - len({id(group) for group in groups.values()})


def _counted(data: Data) -> bool:
    """Whether each part is between 0 and 1, and of a port that one spring joins to a mass or to the ground."""
    links, late = data["environment"]["links"], data["environment"]["delay"]
    for port, part in data.get("series", {}).items():
        own = [link for link in links if port in link["between"]]
        others = {end for link in own for end in link["between"] if end != port}
        stiff = any(_ends(link["stiffness"])[0] > 0 for link in own)
        if late or len(others) != 1 or others & set(data["ports"]) or not stiff or not 0 < decimal(part) < 1:
            return False
    return True


def _counted_springs(data: Data) -> bool:
    """Whether each compliance is above 0, of a world of matrices or rational functions that is not late."""
    known = data["environment"]["type"] in ("state-space", "transfer-function") and not data["environment"]["delay"]
    return known and all(decimal(entry["compliance"]) > 0 for entry in data["series"].values())


def _ends(span: Any) -> list[float]:
    return list(span) if isinstance(span, list) else [span]


def levels(data: Data) -> list[str]:
    """0 < Delta_D <= osp, 0 < Delta_V, condition (10), and the device's form at some delays; exactly."""
    claimed, at = data["levels"], {port: i for i, port in enumerate(data["ports"])}
    m, out = len(at), []

    def joined(parts: Any) -> list[list[fmpq]]:
        if isinstance(parts, list):
            return rational(parts)
        whole = [[fmpq(0)] * m for _ in range(m)]
        for ports, rows in parts.values():
            for i, row in zip(ports, rows, strict=True):
                for j, value in zip(ports, row, strict=True):
                    whole[at[i]][at[j]] = decimal(value)
        return whole

    def by_block(parts: Any) -> list[list[fmpq]]:
        return joined(parts if isinstance(parts, list) else {n: (data["structure"][n], parts[n]) for n in parts})

    osp = joined({name: (device["ports"], device["osp"]) for name, device in data["devices"].items()})
    D, V, Phi = (by_block(claimed[key]) for key in ("Delta_D", "Delta_V", "Phi_E"))
    kappa, share, c = (decimal(claimed[key]) for key in ("kappa", "share", "c"))
    t, stretch = decimal(data["tau"]) / decimal(data["period"]), 1 + decimal(data.get("period_tolerance", 0))
    if not semidefinite([[osp[i][j] - D[i][j] for j in range(m)] for i in range(m)]):
        out.append("Delta_D <= osp")
    if not semidefinite(D, strict=True):
        out.append("Delta_D > 0")
    if not semidefinite(V, strict=True):
        out.append("Delta_V > 0")
    ten = [[share * D[i][j] - Phi[i][j] for j in range(m)] + [-Phi[i][j] for j in range(m)] for i in range(m)]
    ten += [[-Phi[i][j] for j in range(m)] + [V[i][j] - Phi[i][j] for j in range(m)] for i in range(m)]
    if not semidefinite(ten, strict=True):
        out.append("condition (10)")
    if not (0 <= t <= 1 and decimal(data["period"]) > 0 and c >= 0 and kappa > 0 and share > 0):
        out.append("0 <= tau <= T, kappa > 0, share > 0, c >= 0")
    elif ("period_tolerance" in data) != (1 < stretch <= 2):
        out.append("0 < rho <= 1 where it is stated")
    elif not all(_device_keeps(kappa, share, c, t * part, stretch) for part in (_DELAYS if t > 0 else (fmpq(0),))):
        out.append("the device keeps its share")
    exact = {"(10)": ten, "Delta_D": D, "Delta_V": V}
    for name, stated in data["margins"].items():
        if name in exact:
            bound = decimal(stated) - abs(decimal(stated)) / _OVERSTATED
            rows = [[x - bound * (i == j) for j, x in enumerate(row)] for i, row in enumerate(exact[name])]
            if not semidefinite(rows):
                out.append(f"the margin {name} is not overstated")
    E = data["environment"]
    if E["type"] == "declared":
        level = rational(E["level"])
        if not semidefinite([[Phi[i][j] - level[i][j] for j in range(m)] for i in range(m)]):
            out.append("the declared level is at most Phi_E")
    return out


def _device_keeps(kappa: fmpq, share: fmpq, c: fmpq, t: fmpq, stretch: fmpq) -> bool:
    """A tick's energy, T = Delta_D = 1, is not negative, whatever alpha (moved under the old force) and beta (the new).

    With ``stretch`` the longest period, in units of T,

    alpha^2/t + beta^2/(stretch-t) + g (alpha + beta) + g- alpha + (kappa/2 - c) g^2 + c g-^2
        - share (alpha + beta + kappa g)^2
    """
    motions = [v for v, seconds in (((1, 0, 0, 0), t), ((0, 1, 0, 0), stretch - t)) if seconds != 0]
    basis = [*motions, (0, 0, 1, 0), (0, 0, 0, 1)]

    def form(x: tuple[int, ...], y: tuple[int, ...]) -> fmpq:
        half = fmpq(1, 2)
        out = half * (x[2] * (y[0] + y[1]) + y[2] * (x[0] + x[1])) + half * (x[3] * y[0] + y[3] * x[0])
        out += (kappa / 2 - c) * x[2] * y[2] + c * x[3] * y[3]
        if t != 0:
            out += x[0] * y[0] / t
        if t != stretch:
            out += x[1] * y[1] / (stretch - t)
        return out - share * (x[0] + x[1] + kappa * x[2]) * (y[0] + y[1] + kappa * y[2])

    return semidefinite([[form(x, y) for y in basis] for x in basis])


def mixture_levels(rungs: list[Data]) -> list[str]:
    """Every mixture of a ladder's Delta_D is promised: exactly, for all mixtures of the blocks of each device."""
    data = rungs[0]
    block_of = {port: name for name, ports in data["structure"].items() for port in ports}
    for device in data["devices"].values():
        names = sorted({block_of[port] for port in device["ports"]})
        for chosen in product(range(len(rungs)), repeat=len(names)):
            rung = dict(zip(names, chosen, strict=True))
            rest = rational(device["osp"])
            for i, p in enumerate(device["ports"]):
                for j, q in enumerate(device["ports"]):
                    name = block_of[p]
                    if name == block_of[q]:
                        ports = list(data["structure"][name])
                        level = rungs[rung[name]]["levels"]["Delta_D"][name]
                        rest[i][j] -= decimal(level[ports.index(p)][ports.index(q)])
            if not semidefinite(rest):
                return ["a mixture's Delta_D <= osp"]
    return []


# --- over frequency


def environment_part(reader: Reader, z: Any) -> Array:
    """He E_hat + Phi_E, which must not be negative anywhere."""
    hat = reader.environment_at(z) * (z * reader.T / (z - 1))
    return _hermitian(hat) + reader.joined(reader.data["levels"]["Phi_E"])


def coupling_part(reader: Reader, name: str, z: Any) -> Array:
    """He V_hat - V_hat* Delta_V V_hat over |1 - 1/z|^2, V_hat = (V - K)(z-1)/(Tz), of one block."""
    levels = reader.data["levels"]
    D, level = reader.matrix(levels["Delta_D"][name]), reader.matrix(levels["Delta_V"][name])
    K = reader.arithmetic.solve(D, reader.eye(len(D))) * (reader.arithmetic.number(levels["kappa"]) * reader.T)
    q = (z - 1) / (z * reader.T)
    moved = reader.block_at(name, z) - K
    size = 1 / (q * _conjugate(q))
    return _hermitian(moved * q) * size - _star(moved) @ level @ moved


def loop_part(reader: Reader, ratios: tuple[float, ...], z: Any) -> Array:
    """osp - T He(q F)/|q|^2, q = 1 - 1/z, F = (I + S E S V)^-1 S E S: what any passive hand needs, without delay.

    For one port it is the condition that is necessary and sufficient; it needs nothing but the physical data.
    """
    m, at = len(reader.ports), reader.ports.index
    E = reader.environment_at(z)
    V = 0 * E
    for (name, ports), ratio in zip(reader.data["structure"].items(), ratios, strict=True):
        i = [at(port) for port in ports]
        part = reader.block_at(name, z)
        for a, row in enumerate(i):
            for b, column in enumerate(i):
                V[..., row, column] = part[..., a, b]
        for row in i:
            E[..., row, :] = E[..., row, :] * reader.arithmetic.number(ratio)
            E[..., :, row] = E[..., :, row] * reader.arithmetic.number(ratio)
    F = reader.arithmetic.solve(reader.eye(m) + E @ V, E)
    q = 1 - 1 / z
    return reader.osp() - _hermitian(F * q) * (reader.T / (q * _conjugate(q)))


def transparency_part(reader: Reader, z: Any) -> Array:
    """gamma^2 - X* X of the weighted response X."""
    claim = reader.data["transparency"]
    weight = 1
    for key in ("W1", "W2"):
        num, den = (reader.polynomial(claim[key][part], z) for part in ("num", "den"))
        weight = weight * (num / den)
    E, m, at = reader.world.environment_at(z), len(reader.ports), reader.ports.index
    V = 0 * E
    for name, ports in reader.data["structure"].items():
        part, i = reader.block_at(name, z), [at(port) for port in ports]
        for a, row in enumerate(i):
            for b, column in enumerate(i):
                V[..., row, column] = part[..., a, b]
    for i, own in enumerate(reader.counted_at(z)):
        V[..., i, i] = V[..., i, i] - (own[..., 0, 0] if isinstance(own, np.ndarray) else own)
    X = E @ V if claim["objective"] == "loop-shaping" else reader.arithmetic.solve(reader.eye(m) + E @ V, E) - E
    X = X * weight
    return reader.eye(m) * reader.arithmetic.number(claim["gamma"]) ** 2 - _star(X) @ X


def _conjugate(x: Any) -> Any:
    return x.conjugate() if isinstance(x, acb) else np.conjugate(x)


def _star(M: Array) -> Array:
    if M.dtype == object:
        return np.array([[acb(value).conjugate() for value in column] for column in M.T], dtype=object)
    return np.conjugate(np.swapaxes(M, -1, -2))


def _hermitian(M: Array) -> Array:
    return (M + _star(M)) / 2


Part = Callable[[Reader, Any], Array]


def parts(data: Data, ratios: tuple[float, ...]) -> dict[str, Part]:
    """The matrices over frequency that a certificate claims never to be negative, by the name of the promise."""
    declared = data["environment"]["type"] == "declared"
    out: dict[str, Part] = {}
    for name in data["structure"]:
        out[f"V_hat of {name} is Delta_V-OSP"] = lambda reader, z, name=name: coupling_part(reader, name, z)
    if not declared:
        out["E_hat is (-Phi_E)-ISP"] = environment_part
        out["any passive hand"] = lambda reader, z: loop_part(reader, ratios, z)
    if data["transparency"] is not None and not declared:
        out["transparency"] = transparency_part
    return out


def suspects(data: Data, ratios: tuple[float, ...], high: int) -> list[Suspect]:
    """What the Hermitian parts contradict in floats, at the worst frequency of a grid and of two finer ones."""
    reader, out = Reader(data, Floats()).member(high), []
    for what, part in parts(data, ratios).items():
        if what == "transparency" and uncertain(data):
            continue  # of the network in the middle, which no member here is
        angles = _ANGLES
        for finer in range(3):
            try:
                values = _least(part(reader, reader.arithmetic.circle(angles)))
            except (ArithmeticError, NoSystem):
                break
            at = int(np.argmin(values))
            if values[at] < -_ROUNDING:
                out.append(Suspect(what, float(angles[at]), ratios))
                break
            if finer == 2:
                break
            low, above = angles[max(at - 1, 0)], angles[min(at + 1, len(angles) - 1)]
            angles = np.linspace(low, above, 9)
    return out


def _least(M: Array) -> Array:
    """Least eigenvalues of Hermitian matrices, with their diagonals brought to 1."""
    diagonal = np.real(np.einsum("...ii->...i", M))
    scale = np.sqrt(np.maximum(np.abs(diagonal), 1e-300))
    N = M / (scale[..., :, None] * scale[..., None, :])
    if not np.all(np.isfinite(N)):
        return np.zeros(len(M))  # floats cannot tell
    return np.asarray(np.linalg.eigvalsh(N)[..., 0])


def confirmed(data: Data, suspect: Suspect, high: int) -> bool:
    """Whether the same Hermitian part is negative in balls of long numbers."""
    reader = precise(data).member(high)
    part = parts(data, suspect.ratios)[suspect.what]
    try:
        return certainly_negative(part(reader, reader.arithmetic.circle(np.array([suspect.angle]))))
    except (ArithmeticError, NoSystem):
        return False


def poles(reader: Reader) -> dict[str, Array]:
    """Of the linear blocks and of the environment that is no network: matrices that must be stable."""
    out: dict[str, Array] = {}
    if reader.data["coupling"]["class"] == "linear":
        out["V is stable"] = reader.coupling[0]
    if reader.data["environment"]["type"] in ("state-space", "transfer-function"):
        out["E is stable"] = reader.environment[0]
    return out
