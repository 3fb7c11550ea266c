"""Forged certificates by class: numbers of one kind are changed, and the id is made that of the result.

A forgery may leave the claim true, which then counts like any other; a proof has to distinguish the two by the
mathematics alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from manyhands.design.certificate import identity

Data = dict[str, Any]
Generator = np.random.Generator


def sealed(data: Data) -> Data:
    """The same data with the id of their content."""
    data["id"] = identity(data)
    return data


def factor(rng: Generator) -> float:
    """A little more or less, down to the last digits; by powers; nothing; or the other sign."""
    style = rng.random()
    if style < 0.4:
        return 1.0 + float(rng.choice([-1.0, 1.0])) * float(10.0 ** rng.uniform(-15.0, -0.5))
    if style < 0.85:
        return float(10.0 ** rng.normal(0.0, 0.6))
    if style < 0.95:
        return float(10.0 ** rng.uniform(-15.0, 15.0))
    return float(rng.choice([0.0, -1.0, -(10.0 ** rng.uniform(-15.0, 0.0))]))


def scaled(rows: Any, by: float) -> Any:
    """A number, a matrix or an interval times a factor."""
    if isinstance(rows, dict):
        return {name: scaled(part, by) for name, part in rows.items()}
    return [scaled(part, by) for part in rows] if isinstance(rows, list) else rows * by


def touched(rng: Generator, rows: list[list[float]], keep_symmetric: bool) -> list[list[float]]:
    """One entry changed, by a factor or by a number of any scale; or all of them."""
    if not rows or not rows[0]:
        return rows
    if rng.random() < 0.4:
        return list(scaled(rows, factor(rng)))
    out = [list(row) for row in rows]
    i, j = int(rng.integers(len(rows))), int(rng.integers(len(rows[0])))
    size = max(abs(x) for row in rows for x in row) or 1.0
    value = out[i][j] * factor(rng) if rng.random() < 0.6 else out[i][j] + size * (factor(rng) - 1.0)
    out[i][j] = value
    if keep_symmetric:
        out[j][i] = value
    return out


def _block(rng: Generator, parts: Data) -> str:
    return str(rng.choice(list(parts)))


def _coupling(key: str) -> Callable[[Generator, Data], None]:
    def change(rng: Generator, data: Data) -> None:
        block = data["coupling"]["blocks"][_block(rng, data["structure"])]
        if data["coupling"]["class"] == "spring-damper":
            block[key] = touched(rng, block[key], rng.random() < 0.95)
            return
        part = str(rng.choice(["C", _static(block)] if key == "stiffness" else ["A", "B"]))
        block[part] = touched(rng, block[part], False)

    return change


def _static(part: Data) -> str:
    """The key of what a state space answers at once: D, or the static gain in its place."""
    return "static" if "static" in part else "D"


def _level(key: str) -> Callable[[Generator, Data], None]:
    def change(rng: Generator, data: Data) -> None:
        parts = data["levels"][key]
        if isinstance(parts, list):
            data["levels"][key] = touched(rng, parts, True)
        else:
            name = _block(rng, parts)
            parts[name] = touched(rng, parts[name], True)

    return change


def _joined_level(rng: Generator, data: Data) -> None:
    """Phi_E as one matrix that joins blocks: greater by g g' than before, and so as true of E."""
    at, stated = {port: i for i, port in enumerate(data["ports"])}, data["levels"]["Phi_E"]
    Phi = np.array(stated) if isinstance(stated, list) else np.zeros((len(at), len(at)))
    for name, rows in {} if isinstance(stated, list) else stated.items():
        ports = [at[port] for port in data["structure"][name]]
        Phi[np.ix_(ports, ports)] = rows
    g = rng.normal(size=len(at)) * np.sqrt(float(np.abs(Phi).max()) * 10.0 ** rng.uniform(-4.0, 0.5))
    Phi = Phi + np.outer(g, g)
    data["levels"]["Phi_E"] = ((Phi + Phi.T) / 2.0).tolist()


def _osp(rng: Generator, data: Data) -> None:
    device = data["devices"][_block(rng, data["devices"])]
    device["osp"] = touched(rng, device["osp"], True)


def _version(rng: Generator, data: Data, with_key: int, often: float = 0.95) -> int:
    """The version that has a key; that of the file now and then, or where its version has all keys."""
    own: int = data["version"]
    return with_key if own < 6 and rng.random() < often else own


def _held(rng: Generator, data: Data) -> None:
    """How a device holds its force: other numbers, another arm, or nothing of it."""
    device = data["devices"][_block(rng, data["devices"])]
    if rng.random() < 0.05:
        del device["held"]
        data["version"] = 4 if "period_tolerance" in data else 3
    elif rng.random() < 0.7 or "linkage" not in device["held"]:
        held = device["held"]
        key = str(rng.choice([key for key in held if key != "linkage"]))
        held[key] = held[key] * factor(rng)
    else:
        linkage = device["held"]["linkage"]
        linkage["links"] = touched(rng, linkage["links"], False)


def _orientation(rng: Generator, data: Data) -> None:
    """What an orientation burns, its stiffness, that it is sensed, or a length by which turns count."""
    device = data["devices"][_block(rng, data["devices"])]
    own, held = device["orientation"], device.get("held", {})
    what = str(rng.choice(["osp", "stiffness", "sensed", "length", "none"]))
    if what in own:
        own[what] = own[what] * factor(rng)
    elif what == "sensed" and "osp" in own:
        device["orientation"] = {"sensed": True, "stiffness": own["stiffness"]}
    elif what == "length" and "length" in held and rng.random() < 0.7:
        held["length"] *= factor(rng)
    elif what == "length":
        held.pop("length", None)
    elif what == "none" and held:
        del device["orientation"]


def _mechanism(rng: Generator, data: Data) -> None:
    """Encoder steps, dry friction, what is claimed of both, or the speed below which it is."""
    device = data["devices"][_block(rng, data["devices"])]
    what = str(rng.choice(["step", "friction", "force", "covered", "speed", "none"]))
    if what in ("step", "friction") and what in device:
        device[what] = [abs(value) * factor(rng) for value in device[what]]
    elif what == "force" and data.get("encoder", {}).get("force"):
        data["encoder"]["force"] = [value * factor(rng) for value in data["encoder"]["force"]]
    elif what == "covered" and "encoder" in data:
        data["encoder"]["covered"] = not data["encoder"]["covered"]
    elif what == "speed":
        data["speed"] = data.get("speed", 0.1) * factor(rng)
    elif what == "none" and "encoder" in data:
        data["encoder"]["force"] = None


def _storage(rng: Generator, data: Data) -> None:
    stored = data["storage"]
    names = list(stored["V_hat"])
    if names and rng.random() < 0.5:
        name = str(rng.choice(names))
        stored["V_hat"][name] = touched(rng, stored["V_hat"][name], True)
    elif isinstance(stored["E_hat"], dict) and rng.random() < 0.9:
        rows = stored["E_hat"]["differences"]  # now and then read as in the form in z
        stored["E_hat"] = rows if rng.random() < 0.1 else {"differences": touched(rng, rows, True)}
    elif isinstance(stored["E_hat"], list):
        stored["E_hat"] = touched(rng, stored["E_hat"], True)
    else:
        stored["E_hat"] = str(rng.choice(["energy", "enforced"]))


def _tau(rng: Generator, data: Data) -> None:
    data["tau"] = float(rng.choice([0.0, data["period"], data["period"] * rng.random(), data["tau"] * factor(rng)]))


def _period_tolerance(rng: Generator, data: Data) -> None:
    """Longer periods are claimed, of the version that has the key; or they are none, or the key is in the wrong one."""
    before = data.get("period_tolerance", 0.0)
    rho = float(rng.choice([1.0, 10.0 ** rng.uniform(-9.0, 0.0), before * factor(rng), -0.1, 0.0]))
    data["period_tolerance"] = rho
    if "series" not in data:
        data["version"] = _version(rng, data, 4)


def _series(rng: Generator, data: Data) -> None:
    """Another part or compliance, one that is none, another port; or the key in a version without it."""
    parts = data.setdefault("series", {})
    port = str(rng.choice(data["ports"]))
    if data["environment"]["type"] in ("state-space", "transfer-function"):
        stated = parts.get(port, {}).get("compliance", data["period"])
        found = [stated * factor(rng), stated * (1.0 + 1e-3 * rng.random()), 10.0 * stated, 0.0, -stated]
        parts[port] = {"compliance": float(rng.choice(found))}
        data["version"] = _version(rng, data, 5, 1.0)
        return
    parts[port] = float(rng.choice([rng.random(), parts.get(port, 0.5) * factor(rng), 1.0, 0.0, 1.5, -0.5]))
    if rng.random() < 0.2:
        parts.pop(_block(rng, parts))
    data["version"] = _version(rng, data, 5)


def _period(rng: Generator, data: Data) -> None:
    by = factor(rng)
    data["period"] *= by
    if rng.random() < 0.5:
        data["tau"] *= by


def _gain(rng: Generator, data: Data) -> None:
    key = str(rng.choice(["kappa", "share", "c"]))
    data["levels"][key] = data["levels"][key] * factor(rng) if data["levels"][key] else factor(rng)


def _delay(rng: Generator, data: Data) -> None:
    if "delay" in data["environment"]:
        data["environment"]["delay"] = int(rng.integers(0, 4))


def _world(rng: Generator, data: Data) -> None:
    """A number of the environment's dynamics: a mass, a link, an entry, a coefficient, a declared level."""
    E = data["environment"]
    if E["type"] == "network":
        links = E["links"]
        if E["masses"] and rng.random() < 0.3:
            name = _block(rng, E["masses"])
            E["masses"][name] = scaled(E["masses"][name], factor(rng))
        else:
            link = links[int(rng.integers(len(links)))]
            key = str(rng.choice(["stiffness", "damping"]))
            link[key] = scaled(link[key], factor(rng))
    elif E["type"] == "declared":
        E["level"] = touched(rng, E["level"], True)
    elif E["type"] == "state-space":
        key = str(rng.choice(["A", "B", "C", _static(E), _static(E)]))
        E[key] = touched(rng, E[key], rng.random() < 0.5 and key == _static(E))
    else:
        m = len(E["entries"])
        i, j = (int(x) for x in rng.integers(m, size=2))
        key = str(rng.choice(["num", "num", "den"]))
        E["entries"][i][j][key] = touched(rng, [E["entries"][i][j][key]], False)[0]


def _intervals(rng: Generator, data: Data) -> None:
    """Ends of intervals, or an interval where there was none."""
    E = data["environment"]
    if E["type"] != "network":
        return
    places = [(E["masses"], name) for name in E["masses"]]
    places += [(link, key) for link in E["links"] for key in ("stiffness", "damping")]
    part, key = places[int(rng.integers(len(places)))]
    low, high = part[key] if isinstance(part[key], list) else (part[key], part[key])
    part[key] = sorted([low * factor(rng), high]) if rng.random() < 0.5 else sorted([low, high * factor(rng)])


def _arms(rng: Generator, data: Data) -> None:
    """Lever arms of a link: one or both by a factor, exchanged, left out, or the same scale for an end of all links."""
    links = data["environment"]["links"]
    if rng.random() < 0.3:
        end, by = str(rng.choice(data["ports"])), abs(factor(rng)) or 1.0
        for link in links:
            if end in link["between"]:
                arms, at = list(link.get("arms", [1.0, 1.0])), link["between"].index(end)
                arms[at] *= by
                link["arms"] = arms
        return
    link = links[int(rng.integers(len(links)))]
    a, b = link.get("arms", [1.0, 1.0])
    x, y = factor(rng), factor(rng)
    changed = ([a * x, b], [a, b * x], [a * x, b * x], [a * x, b * y], [b, a])
    link["arms"] = changed[int(rng.integers(len(changed)))]
    if rng.random() < 0.1:
        del link["arms"]


def _magnified(rng: Generator, data: Data) -> None:
    """The environment with its level and its storage times one factor: its promise stays true."""
    E, by = data["environment"], abs(factor(rng))
    if E["type"] == "network":
        E["masses"] = scaled(E["masses"], by)
        for link in E["links"]:
            link["stiffness"], link["damping"] = scaled(link["stiffness"], by), scaled(link["damping"], by)
    elif E["type"] == "state-space":
        for key in ("C", _static(E)):
            E[key] = scaled(E[key], by)
    elif E["type"] == "transfer-function":
        for row in E["entries"]:
            for entry in row:
                entry["num"] = scaled(entry["num"], by)
    else:
        E["level"] = scaled(E["level"], by)
    data["levels"]["Phi_E"] = scaled(data["levels"]["Phi_E"], by)
    if isinstance(data["storage"]["E_hat"], list):
        data["storage"]["E_hat"] = scaled(data["storage"]["E_hat"], by)
    elif isinstance(data["storage"]["E_hat"], dict):
        data["storage"]["E_hat"] = {"differences": scaled(data["storage"]["E_hat"]["differences"], by)}


def _margins(rng: Generator, data: Data) -> None:
    name = str(rng.choice(["(10)", "Delta_D", "Delta_V", "J"]))
    data["margins"][name] = data["margins"].get(name, 1.0) * factor(rng)


def _gamma(rng: Generator, data: Data) -> None:
    claim = data["transparency"]
    if claim is None:
        return
    if rng.random() < 0.6:
        claim["gamma"] *= factor(rng)
    else:
        key, part = str(rng.choice(["W1", "W2"])), str(rng.choice(["num", "den"]))
        claim[key][part] = touched(rng, [claim[key][part]], False)[0]


def _structure(rng: Generator, data: Data) -> None:
    """Ports of a block or of a device in another order, or exchanged between two."""
    parts = data["structure"]
    if rng.random() < 0.5:
        device = data["devices"][_block(rng, data["devices"])]
        device["ports"] = [str(port) for port in rng.permutation(device["ports"])]
        return
    names = list(parts)
    a, b = (names[int(i)] for i in rng.integers(len(names), size=2))
    i, j = int(rng.integers(len(parts[a]))), int(rng.integers(len(parts[b])))
    parts[a][i], parts[b][j] = parts[b][j], parts[a][i]


CHANGES: dict[str, Callable[[Generator, Data], None]] = {
    "stiffness": _coupling("stiffness"),
    "damping": _coupling("damping"),
    "Delta_D": _level("Delta_D"),
    "Delta_V": _level("Delta_V"),
    "Phi_E": _level("Phi_E"),
    "joined Phi_E": _joined_level,
    "osp": _osp,
    "held": _held,
    "orientation": _orientation,
    "mechanism": _mechanism,
    "storage": _storage,
    "tau": _tau,
    "period_tolerance": _period_tolerance,
    "series": _series,
    "period": _period,
    "kappa, share, c": _gain,
    "delay": _delay,
    "environment": _world,
    "intervals": _intervals,
    "arms": _arms,
    "magnified": _magnified,
    "margins": _margins,
    "gamma": _gamma,
    "structure": _structure,
}


def applies(change: str, data: Data) -> bool:
    """Whether a change of this class changes anything in this certificate."""
    E = data["environment"]["type"]
    needs = {
        "mechanism": any({"step", "friction"} & device.keys() for device in data["devices"].values()),
        "orientation": any("orientation" in device for device in data["devices"].values()),
        "held": any("held" in device for device in data["devices"].values()),
        "gamma": data["transparency"] is not None,
        "delay": E != "declared",
        "series": "series" in data or (E in ("network", "state-space", "transfer-function") and data["version"] == 3),
        "arms": E == "network",
        "intervals": E == "network" and data["environment"]["delay"] == 0,
    }
    return needs.get(change, True)


def forged(rng: Generator, data: Data, change: str) -> Data | None:
    """A changed certificate with a matching id; None where a number leaves the range of floats."""
    out: Data = json.loads(json.dumps(data))
    if change != "margins" and rng.random() < 0.8:
        out["margins"] = {}  # or nearly every change would be found by them
    CHANGES[change](rng, out)
    if rng.random() < 0.15:
        CHANGES[str(rng.choice([name for name in CHANGES if applies(name, data)]))](rng, out)
    try:
        return sealed(out)
    except ValueError:
        return None


def forged_rung(rng: Generator, data: Data) -> Data:
    """A rung whose levels are changed; or whose blocks are, each with its Delta_D and Delta_V, by a factor of its own.

    The second leaves all true but Delta_D <= osp, which a rung has to keep by itself and in every mixture.
    """
    out: Data = json.loads(json.dumps(data))
    out["margins"] = {}
    levels = out["levels"]
    if rng.random() < 0.3:
        _joined_level(rng, out)
    if rng.random() < 0.4:
        for _ in range(int(rng.integers(0, 3))):
            _level(str(rng.choice(["Delta_D", "Delta_V", "Phi_E"])))(rng, out)
        return sealed(out)
    for name, block in out["coupling"]["blocks"].items():
        by = float(10.0 ** rng.normal(0.0, 0.2))
        levels["Delta_D"][name] = scaled(levels["Delta_D"][name], by)
        levels["Delta_V"][name] = scaled(levels["Delta_V"][name], 0.999 * by)
        for key in block:
            block[key] = scaled(block[key], by)
    return sealed(out)
