"""Random sessions that cannot be certified, and what their refusals print (`make refusals`).

Each session is one that a user might write: a coupling that is too stiff, a world that is late or lacks passivity, held
torques, encoder steps beside dry friction, a far user, no coupling at all. Of each refusal every printed remedy is read
from its text, as a user would read it, and held against three claims:

- **accepted**: the session's file with the printed ``--set`` options is designed and proved;
- **improved**: where nothing was certified, that has the stiffness (or the margin) that the text states;
- **true**: where the text states a limit, design accepts a percent inside of it and refuses a percent beyond, and the
  place between where it begins to refuse is found by halvings.

Prints a table by kind of refusal, and what is not so; exits 1 if anything is not.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.world import World
from manyhands.launch.plan import sites
from manyhands.launch.plan.feel import stiffness_range
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.remedies import with_remedies
from manyhands.launch.session import ENVIRONMENT, Session, SessionError
from manyhands.launch.session.session import load_session

Generator = np.random.Generator
Plain = dict[str, Any]

WITHIN: Final = 0.01
"""Relative: how far a stated limit may be from where design begins to refuse."""

_HALVINGS: Final = 5  # between a percent inside of a limit and a percent beyond
_REFUSED: Final = (DesignError, NotCertified, SessionError, ValueError, np.linalg.LinAlgError)


# Sessions


def _rounded(value: float, digits: int = 3) -> float:
    return float(f"{value:.{digits}g}")


def _spread(rng: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return _rounded(float(np.exp(rng.uniform(np.log(low), np.log(high)))))


def _session(rng: Generator, devices: int | None = None) -> Plain:
    """One to three devices of one axis at a hub, with a design for springs and dampers."""
    count = devices or int(rng.integers(1, 4))
    names = ["dx", "dy", "dz"][:count]
    osp, same = _spread(rng, 0.2, 5.0), rng.random() < 0.6
    period = float(rng.choice([1e-3, 1e-3, 5e-4, 2e-3]))
    links = [
        {"between": [name, "hub" if rng.random() < 0.7 else "ground"], "stiffness": _spread(rng, 100, 8000),
         "damping": _rounded(rng.uniform(0.05, 0.5), 2)}
        for name in names
    ]  # fmt: skip
    return {
        "session": "refused",
        "period": period,
        "devices": {
            name: {"dof": 1, "osp": osp if same else _spread(rng, 0.2, 5.0), "driver": "simulated", "mass": 0.2}
            for name in names
        },
        "couplings": {f"c{name[1]}": {"devices": [name]} for name in names},
        "environment": {
            "type": "network",
            "masses": {"hub": 1.0},
            "links": [*links, {"between": ["hub", "ground"], "stiffness": 1000, "damping": 0.5}],
        },
        "design": {"coupling": "spring-damper"},
    }


def _late(rng: Generator, plain: Plain) -> Plain:
    """Perhaps with a delay inside the tick, and perhaps with a period tolerance."""
    if rng.random() < 0.5:
        plain["design"]["tau"] = _rounded(plain["period"] * rng.uniform(0.05, 0.9), 2)
    if rng.random() < 0.3:
        plain["design"]["period_tolerance"] = _rounded(rng.uniform(0.02, 0.5), 2)
    return plain


def _limits(plain: Plain) -> list[float]:
    """The closed form of the limit of each device's coupling in a passive world, N/m."""
    T, tau = plain["period"], plain["design"].get("tau", 0.0)
    longest = 0.5 * (1.0 + plain["design"].get("period_tolerance", 0.0)) * T + 1.5 * tau
    return [float(device["osp"]) / longest for device in plain["devices"].values()]


def too_stiff(rng: Generator) -> Plain:
    """Given springs, and perhaps dampers, around or beyond their limit."""
    plain = _late(rng, _session(rng))
    limits, over = _limits(plain), _spread(rng, 0.8, 6.0)
    if len({*limits}) == 1 and rng.random() < 0.7:
        stiffness: Any = _rounded(over * limits[0])
    else:
        stiffness = [_rounded(over * limit * rng.uniform(0.5, 1.2)) for limit in limits]
    plain["design"] |= {"coupling": "given", "stiffness": stiffness}
    if rng.random() < 0.5:
        plain["design"]["damping"] = _rounded(
            min(d["osp"] for d in plain["devices"].values()) * rng.uniform(0.01, 0.7), 2
        )
    return plain


def stiff_blocks(rng: Generator) -> Plain:
    """Given blocks of one spring and damper each, as matrices."""
    plain = _late(rng, _session(rng))
    T, matrices = plain["period"], {}
    for coupling, limit, device in zip(plain["couplings"], _limits(plain), plain["devices"].values(), strict=True):
        K, B = limit * rng.uniform(0.7, 4.0), device["osp"] * rng.uniform(0.02, 0.4)
        pole, gain = B / (B + K * T), T / (B + K * T)  # x+ = pole x + gain f, by backward Euler
        matrices[coupling] = {"A": [[pole]], "B": [[gain]], "C": [[pole]], "D": [[gain]]}
    plain["design"] |= {"coupling": "given", "matrices": matrices}
    return plain


def late_world(rng: Generator) -> Plain:
    """A world whose forces are whole ticks late, with a coupling to be found, or given."""
    plain = _late(rng, _session(rng))
    plain["environment"]["delay"] = int(rng.integers(1, 4))
    share = rng.uniform(0.02, 1.0)
    for link in plain["environment"]["links"]:
        link["stiffness"] = _rounded(link["stiffness"] * share)
    kind = rng.random()
    if kind < 0.4:
        plain["design"]["objective"] = "stiffest"
    elif kind < 0.55:
        plain["design"] |= {"coupling": "linear", "order": 2}
    elif kind < 0.8:
        plain["design"] |= {"coupling": "given", "stiffness": _rounded(min(_limits(plain)) * rng.uniform(0.1, 1.5))}
        plain["design"]["damping"] = _rounded(
            min(d["osp"] for d in plain["devices"].values()) * rng.uniform(0.01, 0.5), 2
        )
    return plain


def shaped(rng: Generator) -> Plain:
    """A late world, and a coupling shaped for it."""
    plain = late_world(rng)
    kept = {key: value for key, value in plain["design"].items() if key in ("tau", "period_tolerance")}
    plain["design"] = kept | {
        "coupling": "spring-damper",
        "objective": "loop-shaping",
        "weights": {"W1": {"num": [1], "den": [0.008, 1]}},
    }
    return plain


def rational_world(rng: Generator) -> Plain:
    """A world of one rational function that lacks passivity at some frequency."""
    plain = _late(rng, _session(rng, 1))
    k, w, zeta = _spread(rng, 100, 3000), _spread(rng, 20, 300), rng.uniform(0.05, 0.5)
    lead = rng.uniform(-0.3, 0.3) / w  # what is in phase with the velocity, lost or gained
    num = [_rounded(k / w**2, 4), _rounded(k * (2 * zeta / w + lead), 4), k]
    plain["environment"] = {
        "type": "transfer-function",
        "entries": [[{"num": num, "den": [_rounded(rng.uniform(0.2, 2.0) / w**2, 4), _rounded(2 * zeta / w, 4), 1]}]],
        "method": str(rng.choice(["backward-euler", "tustin"])),
    }
    return plain


def declared(rng: Generator) -> Plain:
    """A model in Python whose declared level is too much for the devices."""
    plain = _late(rng, _session(rng))
    level = min(device["osp"] for device in plain["devices"].values()) * rng.uniform(0.1, 1.5)
    plain["environment"] = {"type": "python", "model": "worlds:Room", "level": _rounded(level)}
    if rng.random() < 0.3:
        plain["design"] |= {"coupling": "given", "stiffness": _rounded(min(_limits(plain)) * rng.uniform(0.1, 1.2))}
    return plain


def not_enforced(rng: Generator) -> Plain:
    """A model in Python whose level nobody keeps."""
    plain = declared(rng)
    plain["environment"] |= {"level": 0.0, "enforce": False}
    return plain


def held(rng: Generator) -> Plain:
    """A device whose motors hold torques that may give out what it damps."""
    plain = _late(rng, _session(rng, 1))
    device = plain["devices"]["dx"]
    force, osp = _spread(rng, 2, 20), device["osp"]
    plain["devices"]["dx"] = device | {
        "held": "torque",
        "linkage": {"kappa": _rounded(osp / (force * plain["period"] / 2) * rng.uniform(0.3, 4.0))},
        "limits": {"force": force, "speed": _spread(rng, 0.3, 2.0)},
    }
    return plain


def below_speed(rng: Generator) -> Plain:
    """A device whose dry friction is to count below a speed, and whose encoder's steps take of it."""
    plain = _late(rng, _session(rng, 1))
    friction = _spread(rng, 0.005, 0.3)
    plain["devices"]["dx"] |= {"friction": {"least": friction}, "step": _spread(rng, 5e-6, 2e-4)}
    plain["design"]["speed"] = _spread(rng, 0.02, 0.5)
    if rng.random() < 0.5:
        plain["design"] |= {"coupling": "given", "stiffness": _rounded(_limits(plain)[0] * rng.uniform(0.5, 2.0))}
    return plain


def no_coupling(rng: Generator) -> Plain:
    """A device that is joined to the world by nothing."""
    plain = _session(rng)
    plain["design"] = {"coupling": "none"}
    return plain


def far(rng: Generator) -> Plain:
    """A far user: a site with too stiff a coupling, or a world that lacks what it owes."""
    plain = _late(rng, _session(rng, int(rng.integers(1, 3))))
    first = next(iter(plain["couplings"]))
    plain["couplings"][first]["wave_link"] = {"mass": 0.5, "round_trip": 0.02}
    if rng.random() < 0.5:
        plain["environment"]["delay"] = int(rng.integers(1, 3))
        return plain
    harvest = _rounded(plain["devices"]["dx"]["osp"] * rng.uniform(0.0, 0.6), 2)
    plain["couplings"][first]["wave_link"]["harvest"] = harvest
    plain["design"] |= {"coupling": "given", "stiffness": _rounded(max(_limits(plain)) * rng.uniform(0.5, 3.0))}
    return plain


KINDS: Final[Mapping[str, Callable[[Generator], Plain]]] = {
    "too stiff": too_stiff,
    "too stiff, matrices": stiff_blocks,
    "a late world": late_world,
    "a late world, shaped": shaped,
    "a rational world": rational_world,
    "a declared level": declared,
    "not enforced": not_enforced,
    "held torques": held,
    "below a speed": below_speed,
    "no coupling": no_coupling,
    "a far user": far,
}


# What is printed, and what is true of it


@dataclass(frozen=True)
class Refusal:
    """A session that was refused.

    Attributes:
        kind: which of :data:`KINDS`.
        plain: the session's data.
        part: that cannot be certified.
        printed: each remedy, as it was printed.
    """

    kind: str
    plain: Plain
    part: str
    printed: tuple[str, ...]


def refusal(kind: str, plain: Plain) -> Refusal | None:
    """Why and how a session is refused; None where it is certified, or where another thing is wrong with it."""
    session, name = Session.from_dict(plain), sites.IN_TICK
    try:
        for name in sites.part_names(session):
            _designed(session, name)
    except Infeasible as error:
        found = with_remedies(error, session, name)
        return Refusal(kind, plain, name, found.relax) if isinstance(found, Infeasible) else None
    except DesignError:
        return None
    return None


def _designed(session: Session, name: str) -> Any:
    """The certificate of a part, or the world; raises what design raises."""
    return sites.world(session) if name == ENVIRONMENT else sites.part(session, name).design().certificate


_SENTENCE: Final = re.compile(r"(?P<what>.*?): (?P<set>--set .*) is certified (?P<gives>.*)")
_LIMIT: Final = re.compile(
    r"(below|above) (?P<number>[\d.e+-]+) (?P<unit>times the session's|N·s/m|N/m|m/s|ms|N|m|of the period)"
)
_PER_UNIT: Final = {"ms": 1e-3}


@dataclass
class Checked:
    """What was found of one printed remedy.

    Attributes:
        what: the quantity, without its figure.
        faults: what is not so.
        off: how far the stated limit is from where design begins to refuse, relative; None where none is stated.
    """

    what: str
    faults: list[str] = field(default_factory=list)
    off: float | None = None


def check(refused: Refusal, printed: str) -> Checked:
    """Hold one printed remedy against what it claims, by its text alone."""
    sentence = _SENTENCE.fullmatch(printed)
    if sentence is None:
        return Checked("?", [f"cannot be read: {printed}"])
    limit = _LIMIT.search(sentence["what"])
    out = Checked(sentence["what"] if limit is None else sentence["what"][: limit.start()].strip())
    options = shlex.split(sentence["set"])
    overrides = options[1::2]
    if options[::2] != ["--set"] * len(overrides):
        out.faults.append(f"no options: {sentence['set']}")
        return out
    try:
        found = _designed(_loaded(refused.plain, overrides), refused.part)
    except _REFUSED as error:
        out.faults.append(f"not accepted: {error}")
        return out
    if (gives := _figure(found)) != sentence["gives"]:
        out.faults.append(f"gives {gives}, and not {sentence['gives']}")
    if limit is not None:
        _check_limit(refused, overrides, float(limit["number"]), limit["unit"], out)
    return out


def _loaded(plain: Plain, overrides: list[str]) -> Session:
    """The session of a file with options of ``--set``, as the commands load it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "refused.yaml"
        path.write_text(json.dumps(plain))
        return load_session(path, overrides)


def _figure(found: Any) -> str:
    if isinstance(found, World):
        return f"with a margin of {next(iter(found.margins.values())):.3g} N·s/m"
    least, most = (f"{value:.4g}" for value in stiffness_range(found) or (0.0, 0.0))
    return f"at {least} N/m" if least == most else f"at {least} to {most} N/m"


def _check_limit(refused: Refusal, overrides: list[str], number: float, unit: str, out: Checked) -> None:
    """Whether design accepts just inside of the stated limit and refuses just beyond; finds where it begins to."""
    tried = {key: json.loads(_as_json(value)) for key, _, value in (text.partition("=") for text in overrides)}
    own = {key: _at(refused.plain, key) for key in tried}
    # one number stands for all of a list
    tried = {
        k: [one] * len(own[k]) if isinstance(own[k], list) > isinstance(one, list) else one for k, one in tried.items()
    }
    key = min(tried, key=lambda k: k.startswith("design.damping"))  # the limit is that of the stiffness
    place, (now, before) = next((i, pair) for i, pair in enumerate(_pairs(tried[key], own[key])) if pair[0] != pair[1])
    if unit == "times the session's":
        # of a compliance, by which a coupling is softer
        inside = (1.0 / number if key.startswith("design.matrices") else number) / (now / before)
    else:
        at = now / _PER_UNIT.get(unit, 1.0)
        if out.what.startswith("a stiffness plus 2/T"):
            at += (
                2.0
                / refused.plain["period"]
                * [*_pairs(tried["design.damping"], tried["design.damping"])][
                    place if isinstance(tried["design.damping"], list) else 0
                ][0]
            )
        inside = number / at

    def accepted(factor: float) -> bool:
        options = [f"{k}={json.dumps(_times(tried[k], own[k], inside * factor))}" for k in tried]
        try:
            _designed(_loaded(refused.plain, options), refused.part)
        except _REFUSED:
            return False
        return True

    helps, refuses = (1.0 + WITHIN, 1.0 - WITHIN)[:: 1 if now > before else -1]
    if not accepted(helps):
        out.faults.append("not enough: design refuses a percent inside of the limit")
    if accepted(refuses):
        out.faults.append("more than is needed: design accepts a percent beyond the limit")
    if out.faults:
        return
    for _ in range(_HALVINGS):
        middle = (helps + refuses) / 2.0
        helps, refuses = (middle, refuses) if accepted(middle) else (helps, middle)
    out.off = abs((helps + refuses) / 2.0 - 1.0)


def _as_json(flow: str) -> str:
    """YAML on one line, as it is printed of numbers, as JSON."""
    return re.sub(r"([A-Za-z_]\w*):", r'"\1":', flow)


def _at(plain: Plain, dotted: str) -> Any:
    value: Any = plain
    for step in dotted.split("."):
        value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _pairs(tried: Any, own: Any) -> Iterator[tuple[float, float]]:
    """Every number that was tried, with the session's; one number of the session stands for all."""
    if isinstance(tried, Mapping):
        tried, own = list(tried.values()), [own[key] for key in tried]
    if not isinstance(tried, list):
        yield float(tried), float(own)
        return
    for one, other in zip(tried, own if isinstance(own, list) else [own] * len(tried), strict=True):
        yield from _pairs(one, other)


def _times(tried: Any, own: Any, factor: float) -> Any:
    """What was tried, times a factor wherever it is not the session's."""
    if isinstance(tried, Mapping):
        return {key: _times(one, own[key], factor) for key, one in tried.items()}
    if isinstance(tried, list):
        others = own if isinstance(own, list) else [own] * len(tried)
        return [_times(one, other, factor) for one, other in zip(tried, others, strict=True)]
    return tried if tried == own else tried * factor


def refusals(seed: int, kinds: Mapping[str, Callable[[Generator], Plain]] = KINDS) -> Iterator[Refusal]:
    """Refused sessions without end, of each kind in turn."""
    rng = np.random.default_rng(seed)
    while True:
        for kind, draw in kinds.items():
            if (found := refusal(kind, draw(rng))) is not None:
                yield found


def main() -> int:
    """Draw, check, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--refusals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=[*KINDS], help="this kind alone")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after so long, s")
    given = parser.parse_args()
    kinds = KINDS if given.kind is None else {given.kind: KINDS[given.kind]}
    began, wrong = time.monotonic(), 0
    count, helped, printed, limits = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    worst, ways = dict[str, float](), Counter[str]()
    for refused, _ in zip(refusals(given.seed, kinds), range(given.refusals), strict=False):
        if time.monotonic() - began > given.seconds:
            break
        kind = refused.kind
        count[kind] += 1
        helped[kind] += bool(refused.printed)
        for text in refused.printed:
            found = check(refused, text)
            printed[kind] += 1
            ways[found.what] += 1
            if found.off is not None:
                limits[kind] += 1
                worst[kind] = max(worst.get(kind, 0.0), found.off)
            sys.stderr.write(f"{sum(count.values())} {kind}: {text}\n")
            for fault in found.faults:
                wrong += 1
                sys.stdout.write(f"{kind}: {text}\n  {fault}\n  {json.dumps(refused.plain)}\n")
                sys.stdout.flush()
    sys.stdout.write(
        "| refused | sessions | with a remedy | remedies | limits | farthest off |\n|---|---:|---:|---:|---:|---:|\n"
    )
    for kind in count:
        off = f"{100 * worst[kind]:.2f} %" if kind in worst else ""
        sys.stdout.write(f"| {kind} | {count[kind]} | {helped[kind]} | {printed[kind]} | {limits[kind]} | {off} |\n")
    total = (sum(each.values()) for each in (count, helped, printed, limits))
    off = f"{100 * max(worst.values(), default=0.0):.2f} %"
    sys.stdout.write(f"| all | {' | '.join(map(str, total))} | {off} |\n\n")
    for way, number in ways.most_common():
        sys.stdout.write(f"{number:5d} {way}\n")
    sys.stdout.write(f"{wrong} wrong; {time.monotonic() - began:.0f} s\n")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
