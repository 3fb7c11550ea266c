"""Files that cost their reader as much as they can: every shape of hostile certificate and world, searched at random.

None of them needs to hold. For each, reading and proving has to end in time, or to be refused before it begins:

    python -m tests.attack.heavy --files 300 --seconds 10
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from manyhands.design.certificate import certificate_of, identity, read_plain
from manyhands.design.errors import CertificateError
from manyhands.design.proof import ProofInputError, prove, prove_world
from manyhands.design.proof.claim import read
from manyhands.design.proof.work import parts_of, parts_of_world
from manyhands.design.proof.world import condition_A, read_world
from manyhands.design.world import is_world

Data = dict[str, Any]
Generator = np.random.Generator
Rows = list[list[float]]
Numbers = Callable[[Generator], float]


def _by_powers(low: int, high: int) -> Numbers:
    return lambda rng: float(rng.choice([-1, 1])) * float(rng.uniform(1, 10)) * 10.0 ** int(rng.integers(low, high))


STYLES: dict[str, Numbers] = {
    "one digit": lambda rng: int(rng.integers(1, 10)),
    "seventeen digits": lambda rng: float(rng.normal()),
    "sparse": lambda rng: 0 if rng.random() < 0.9 else float(rng.normal()),
    "from 1e-300 to 1e300": _by_powers(-300, 300),
    "from 1e-72 to 1e60": _by_powers(-72, 60),
    "tiny": lambda rng: 5e-324,
    "one or tiny": lambda rng: 5e-324 if rng.random() < 0.5 else 1,
    "whole numbers of 1000 bits": lambda rng: int(rng.integers(1, 2**62)) << int(rng.integers(800, 940)) | 1,
    "one or a huge power": lambda rng: 2**1020 if rng.random() < 0.5 else 1,
}


class Style(NamedTuple):
    """How the numbers of a file look.

    Attributes:
        rng: the source of chance.
        number: one number.
    """

    rng: Generator
    number: Numbers

    def table(self, rows: int, columns: int) -> Rows:
        """A matrix of this style."""
        return [[self.number(self.rng) for _ in range(columns)] for _ in range(rows)]

    def level(self, n: int) -> Rows:
        """A symmetric matrix, mostly near singular or well inside the cone, so that every step of a proof is done."""
        kind = self.rng.random()
        if kind < 0.2:  # of rank one, exactly
            row = [self.number(self.rng) for _ in range(n)]
            if all(abs(x) < 1e100 for x in row):
                return [[a * b for b in row] for a in row]
        out = self.table(n, n)
        for i in range(n):
            for j in range(i):
                out[i][j] = out[j][i]
        if kind < 0.8 and max((abs(x) for row in out for x in row), default=0) < 1e6:
            for i in range(n):
                out[i][i] = sum(abs(x) for x in out[i]) + (1 if kind < 0.6 else 0)
        return out


def certificate(style: Style, m: int, block: int, environment: Data, E_hat: Any, **more: Any) -> Data:
    """A sealed certificate of m ports in blocks of ``block``, of one style."""
    ports = [f"p{i}" for i in range(m)]
    blocks = {f"c{i}": ports[i * block : (i + 1) * block] for i in range((m + block - 1) // block)}
    sizes = {name: len(own) for name, own in blocks.items()}
    data: Data = {
        "id": "",
        "format": "manyhands-certificate",
        "version": 3,
        "session": "heavy",
        "period": 0.001,
        "tau": 0.0,
        "ports": ports,
        "devices": {f"d{name}": {"ports": own, "osp": style.level(sizes[name])} for name, own in blocks.items()},
        "structure": blocks,
        "environment": environment,
        "asked": {"coupling": "spring-damper", "objective": "feasible"},
        "coupling": {
            "class": "spring-damper",
            "blocks": {name: {"stiffness": style.level(n), "damping": style.level(n)} for name, n in sizes.items()},
        },
        "levels": {
            "kappa": 0.5,
            "share": 1.0,
            "c": 0.0,
            "Delta_D": {name: [[0] * n for _ in range(n)] for name, n in sizes.items()},
            "Delta_V": {name: style.level(n) for name, n in sizes.items()},
            "Phi_E": {name: [[0] * n for _ in range(n)] for name, n in sizes.items()},
        },
        "storage": {"E_hat": E_hat, "V_hat": {}},
        "transparency": None,
        "margins": {"(10)": 1e-9, "Delta_D": 1e-9, "Delta_V": 1e-9},
        "method": {},
    }
    for name in blocks:  # so that the proof goes on behind them
        data["levels"]["Delta_D"][name] = data["devices"][f"d{name}"]["osp"]
    data |= more
    data["id"] = identity(data)
    return data


def _diagonal(n: int, value: float = 1.0) -> Rows:
    return [[value if i == j else 0 for j in range(n)] for i in range(n)]


def _plain_levels(data: Data, osp: float = 1.37) -> Data:
    """Levels, coupling and devices that hold by themselves: all the cost is the environment's."""
    for name, own in data["structure"].items():
        n = len(own)
        data["devices"][f"d{name}"]["osp"] = data["levels"]["Delta_D"][name] = _diagonal(n, osp)
        data["levels"]["Delta_V"][name] = _diagonal(n, 0.1)
        if data["coupling"]["class"] == "spring-damper":
            data["coupling"]["blocks"][name] = {"stiffness": _diagonal(n, 660.0), "damping": _diagonal(n, 0.16)}
    data["id"] = identity(data)
    return data


def state_space(style: Style, n: int, m: int) -> Data:
    """A certificate of n states, discrete or by any method, with D or the static gain."""
    rng = style.rng
    time_ = {"time": "discrete"}
    if rng.random() < 0.6:
        time_ = {"time": "continuous", "method": str(rng.choice(["backward-euler", "tustin", "zoh"]))}
    last = {str(rng.choice(["D", "static"])): style.level(m)}
    A, B, C = style.table(n, n), style.table(n, m), style.table(m, n)
    if rng.random() < 0.4:
        A = [[0.5 * (i == j) + 1e-3 * (i + 1 == j) for j in range(n)] for i in range(n)]
    delay = int(rng.integers(0, 3))
    environment = {"type": "state-space", "A": A, "B": B, "C": C, **last, **time_, "delay": delay}
    data = certificate(style, m, m, environment, style.level(n + m * delay))
    data = _plain_levels(data) if rng.random() < 0.7 else data
    if rng.random() < 0.3:
        data["version"] = 5
        data["series"] = {"p0": {"compliance": 1e-5}}
        data["id"] = identity(data)
    return data


def rationals(style: Style, m: int, degree: int) -> Data:
    """A certificate of rational functions, with equal entries across the diagonal."""
    rng = style.rng
    m = min(m, int((400 / degree) ** 0.5)) if degree else m
    entries: list[list[Any]] = [[None] * m for _ in range(m)]
    for i in range(m):
        for j in range(i + 1):
            entry = {key: [style.number(rng) or 1 for _ in range(degree + 1)] for key in ("num", "den")}
            entries[i][j] = entries[j][i] = entry
    method = str(rng.choice(["backward-euler", "tustin"]))
    environment = {"type": "transfer-function", "entries": entries, "method": method, "delay": 0}
    period = {"period": float(rng.choice([0.001, 5e-324, 1.2345678901234567e-300]))} if rng.random() < 0.2 else {}
    return _plain_levels(certificate(style, m, m, environment, style.level(m * m * degree), **period))


def network(style: Style, m: int, masses: int, links: int) -> Data:
    """A certificate of a random network, by energy or by a matrix, with part of it counted in series."""
    rng = style.rng
    ends = [*(f"p{i}" for i in range(m)), *(f"m{i}" for i in range(masses)), "ground"]

    def link(i: int) -> Data:
        a = ends[i % (m + masses)]
        b = ends[int(rng.integers(len(ends)))]
        while a == b:
            b = ends[int(rng.integers(len(ends)))]
        k, d = abs(style.number(rng)), abs(style.number(rng))
        return {"between": [a, b], "stiffness": [k, 2 * k] if rng.random() < 0.1 else k, "damping": d}

    delay = int(rng.random() < 0.2)
    environment = {
        "type": "network",
        "masses": {f"m{i}": abs(style.number(rng)) or 1 for i in range(masses)},
        "links": [link(i) for i in range(links)],
        "delay": delay,
    }
    block = int(rng.choice([1, 1, 2, 3]))
    storage: Any = "energy"
    if m + 2 * masses <= 250 and rng.random() < 0.4:
        storage = style.level(2 * masses + m * delay)
    data = _plain_levels(certificate(style, m, block, environment, storage))
    for name, own in data["structure"].items():
        n = len(own)
        data["levels"]["Phi_E"][name] = level = _diagonal(n, -0.001)
        for i in range(n):
            for j in range(i):
                level[i][j] = level[j][i] = 1e-4 * int(rng.integers(0, 2))
    if rng.random() < 0.3:
        data["version"] = 5
        data["series"] = {f"p{i}": float(rng.random()) for i in range(m)}
    data["id"] = identity(data)
    return data


def declared(style: Style, m: int, block: int) -> Data:
    """A certificate whose cost is in its levels and its spring-damper blocks."""
    kind = str(style.rng.choice(["declared", "proxy"]))
    environment: Data = {"type": kind, "level": [[0] * m for _ in range(m)]}
    if kind == "proxy":
        environment["stiffness"] = style.level(m)
    data = certificate(style, m, block, environment, "enforced")
    if style.rng.random() < 0.5:  # only the coupling is long
        for name, own in data["structure"].items():
            n = len(own)
            data["devices"][f"d{name}"]["osp"] = data["levels"]["Delta_D"][name] = _diagonal(n, 1e9)
            data["levels"]["Delta_V"][name] = _diagonal(n, 1e-3)
        data["id"] = identity(data)
    return data


def chained(style: Style, m: int) -> Data:
    """Blocks of two and devices of two, offset by one: all ports are joined."""
    nothing = {"type": "network", "masses": {}, "links": [], "delay": 0}
    data = _plain_levels(certificate(style, 2 * (m // 2), 2, nothing, "energy"))
    ports = data["ports"]
    data["devices"] = {"d0": {"ports": [ports[0]], "osp": [[3]]}, "dl": {"ports": [ports[-1]], "osp": [[3]]}}
    for i in range(1, len(ports) - 1, 2):
        data["devices"][f"d{i}"] = {"ports": ports[i : i + 2], "osp": [[3, 1], [1, 3]]}
    data["levels"]["Delta_D"] = {name: [[2, 0.5], [0.5, 2]] for name in data["structure"]}
    data["id"] = identity(data)
    return data


def linear(style: Style, m: int, block: int, n: int) -> Data:
    """A certificate of linear blocks of n states."""
    data = declared(style, m, block)
    data = _plain_levels(data)
    data["coupling"] = {"class": "linear", "blocks": {}}
    for name, own in data["structure"].items():
        k = len(own)
        last = {str(style.rng.choice(["D", "static"])): style.level(k)}
        tables = {"A": style.table(n, n), "B": style.table(n, k), "C": style.table(k, n)}
        data["coupling"]["blocks"][name] = {**tables, **last}
        data["storage"]["V_hat"][name] = style.level(n)
    data["id"] = identity(data)
    return data


def site(style: Style, m: int) -> Data:
    """A certificate of a wave link with a felt stiffness: three exact inverses."""
    from manyhands.design.proof.exact import StatedMatrix
    from manyhands.design.proof.wave_link import wave_link_id

    b = style.level(m)
    ports = [f"p{i}" for i in range(m)]
    name = wave_link_id("heavy", "c0", ports, StatedMatrix(m, m, b), 0.01)
    environment = {"type": "wave-link", "id": name, "b": b, "tank": 0.01, "harvest": [0] * m, "round_trip": 0.02}
    data = certificate(style, m, m, environment | {"mass": style.level(m)}, "enforced")
    levels = data if style.rng.random() < 0.3 else _plain_levels(data)
    levels["coupling"]["blocks"]["c0"]["stiffness"] = style.level(m)
    levels["margins"] |= {"felt stiffness": 1.0}
    levels["id"] = identity(levels)
    return levels


def transparent(style: Style, m: int, degree: int) -> Data:
    """A certificate with a claim on transparency, of a small network."""
    rng = style.rng
    links = [{"between": [f"p{i}", "ground"], "stiffness": 100, "damping": 1} for i in range(m)]
    environment = {"type": "network", "masses": {}, "links": links, "delay": 0}
    num, den = ([style.number(rng) for _ in range(degree + 1)] for _ in range(2))
    weight = {"num": num, "den": [1, *den[1:]]}
    objective = str(rng.choice(["loop-shaping", "closed-loop"]))
    order = 2 * m * degree + m + m * (2 if objective == "closed-loop" else 1)
    claim = {"objective": objective, "W1": weight, "W2": weight, "gamma": 10.0, "P": style.level(order)}
    return _plain_levels(certificate(style, m, int(rng.choice([1, m])), environment, "energy", transparency=claim))


def world(style: Style, m: int, block: int, n: int) -> Data:
    """A world of a state space, each coupling with a wave link or all in the tick."""
    environment: Data = {"type": "declared", "level": [[0] * m for _ in range(m)]}
    E_hat: Any = "enforced"
    if n:
        environment = {"type": "state-space", "A": style.table(n, n), "B": style.table(n, m), "C": style.table(m, n)}
        environment |= {"D": style.level(m), "time": "discrete", "delay": 0}
        E_hat = style.level(n)
    ports = [f"p{i}" for i in range(m)]
    blocks = {f"c{i}": ports[i * block : (i + 1) * block] for i in range((m + block - 1) // block)}
    data: Data = {
        "id": "",
        "format": "manyhands-world",
        "version": 1,
        "session": "heavy",
        "period": 0.001,
        "ports": ports,
        "structure": blocks,
        "environment": environment,
        "wave_links": {name: {"id": "x", "b": style.level(len(own)), "tank": 0.1} for name, own in blocks.items()},
        "in_tick": None,
        "levels": {"Phi_E": style.level(m)},
        "storage": {"E_hat": E_hat},
        "margins": {"(A)": 1e-9},
        "method": {},
    }
    if style.rng.random() < 0.5:
        data["wave_links"], data["in_tick"] = {}, {"id": "x", "ports": ports, "level": style.level(m)}
    data["id"] = identity(data)
    return data


def scene(style: Style, m: int) -> Data:
    """A scene of as many things as there may be."""
    rng = style.rng

    def number() -> float:
        return abs(style.number(rng))

    tool = {"axes": ["x"], "at": [0, 0, 0], "radius": number()}
    tools = {f"t{i}": {"ports": [f"p{i}"], **tool} for i in range(m)}
    bodies = {f"b{i}": {"mass": number(), "at": [0, 0, 0], "radius": number()} for i in range(100 - m // 2)}
    wall = {"shape": "wall", "points": [[0, 0, 0], [number() for _ in range(3)]], "radius": 0}
    walls = {f"w{i}": wall for i in range(100)}
    contact = {"stiffness": number(), "damping": number(), "friction": number()}
    links = [
        {"between": [f"b{int(rng.integers(100))}", "t0"], "stiffness": number(), "damping": 0, "rest": [0, 0, 0]}
        for _ in range(int(rng.integers(1, 6000)))
    ]
    environment = {"type": "scene", "gravity": [0, 0, number()], "tools": tools, "bodies": bodies, "obstacles": walls}
    environment |= {"links": links, "contact": contact, "contacts": []}
    data = certificate(style, len(tools), 1, environment, "enforced")
    return _plain_levels(data)


Size = Callable[[int, int], int]

SHAPES: dict[str, Callable[[Style, Size], Data]] = {
    "state space": lambda style, size: state_space(style, size(2, 400), size(1, 6)),
    "rational functions": lambda style, size: rationals(style, size(1, 60), int(style.rng.choice([0, 0, 1, 2, 8, 32]))),
    "network": lambda style, size: network(style, size(1, 400), size(1, 600), size(2, 4000)),
    "levels": lambda style, size: declared(style, k := size(2, 300), size(1, k)),
    "chain": lambda style, size: chained(style, size(4, 3000)),
    "linear blocks": lambda style, size: linear(style, k := size(1, 60), size(1, min(k, 12)), size(0, 120)),
    "wave link": lambda style, size: site(style, size(1, 90)),
    "transparency": lambda style, size: transparent(style, size(1, 20), size(0, 12)),
    "world": lambda style, size: world(style, k := size(1, 200), size(1, k), size(0, 60)),
    "scene": lambda style, size: scene(style, size(1, 100)),
}

MOST_BYTES = 1_000_000


def random_file(rng: Generator, shape: str | None = None) -> tuple[str, Data]:
    """A hostile file, and what it is: a shape, a style, and sizes towards the greatest that fit into 1 MB."""
    shape = shape or str(rng.choice(list(SHAPES)))
    while True:
        name = str(rng.choice(list(STYLES)))
        exponent = float(rng.uniform(0.2, 1.0))

        def size(low: int, high: int, exponent: float = exponent) -> int:
            most = max(low + 0.0, 1.0) * (max(high, 1) / max(low, 1)) ** (exponent * rng.uniform(0.6, 1.2))
            return int(min(max(most, low), high))

        data = SHAPES[shape](Style(rng, STYLES[name]), size)
        if len(json.dumps(data)) <= MOST_BYTES:
            return f"{shape}, {name}, {len(data['ports'])} ports", data


class Outcome(NamedTuple):
    """What became of a file.

    Attributes:
        what: it was.
        bound: operations that were computed beforehand.
        seconds: of the processor that reading and proving took.
        refused: whether the proof was refused beforehand, by its bound.
        said: how it ended.
    """

    what: str
    bound: float
    seconds: float
    refused: bool
    said: str


def judged(what: str, data: Data, folder: Path) -> Outcome:
    """Read and prove a file as ``verify`` does."""
    path = folder / "heavy.json"
    path.write_text(json.dumps(data))
    begin = time.process_time()
    refused, said = False, ""
    try:
        read_back = read_plain(path)
        if not is_world(read_back):
            certificate_of(read_back, path)
        found = prove_world(read_back) if is_world(read_back) else prove(read_back)
        failing = [finding for finding in found if not finding.holds]
        said = f"{failing[0].condition}: {failing[0].argument}" if failing else "proved"
    except (ProofInputError, CertificateError) as error:
        said = str(error)
        refused = "the proof may take" in said
    seconds = time.process_time() - begin
    try:
        claim = read_world(data) if is_world(data) else read(data)
        parts = parts_of_world(claim, condition_A(claim)) if is_world(data) else parts_of(claim)  # type: ignore[arg-type]
        bound = sum(part.operations for part in parts)
    except ProofInputError:
        bound = float("nan")
    return Outcome(what, bound, seconds, refused, said)


def main() -> int:
    """Search, and print the slowest files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0, help="that a file may take")
    parser.add_argument("--shape", choices=SHAPES, help="only this shape")
    parser.add_argument("--verbose", action="store_true", help="show every file")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    found: list[Outcome] = []
    with TemporaryDirectory() as folder:
        for _ in range(given.files):
            what, data = random_file(rng, given.shape)
            found.append(judged(what, data, Path(folder)))
            if given.verbose:
                print(found[-1], flush=True)  # noqa: T201 -- what a campaign is for
            if found[-1].seconds > given.seconds:
                print("TOO SLOW", found[-1], flush=True)  # noqa: T201 -- what a campaign is for
    found.sort(key=lambda one: -one.seconds)
    for one in found[:15]:
        print(f"{one.seconds:7.2f} s  {one.bound:8.2g}  {one.what}: {one.said[:100]}")  # noqa: T201 -- what a campaign is for
    slow = sum(one.seconds > given.seconds for one in found)
    refused = sum(one.refused for one in found)
    print(f"{len(found)} files, {refused} refused beforehand, {slow} slower than {given.seconds:g} s")  # noqa: T201 -- what a campaign is for
    return int(slow > 0)


if __name__ == "__main__":
    raise SystemExit(main())
