"""A wall and stones rendered by scenes, proxies and an engine of ours, beside what others do, in simulated time.

    python -m benchmarks.world_peers [--processes N] [--json FILE] [--plot FILE] [--markdown FILE] [--rest]

``--rest`` is the table of hands that rest on the wall, and that alone.

The device, its encoder and its hands are those of tests/deterministic/touch.py, and the others' ways those of
tests/deterministic/touch_peers.py. All numbers follow from the code alone: two runs are equal. The exit code is 1 if a
scene, a proxy or an engine of ours gives energy to a hand.

A peer that needs a gain has three rows: the one that its documentation states, and the best of a sweep, in damped
hands alone and in all. The best is the stiffest that gives none of them more than 1 uJ, for what the encoder's steps
do; where there is none, the one that gives least.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.page import add_outputs, fill, make_folders
from tests.deterministic.touch import (
    ENCODER,
    FIRM,
    HOSTILE,
    LIGHT,
    RESTING,
    Certified,
    Grip,
    Renderer,
    T,
    engine,
    proxies,
    scene,
    touch,
)
from tests.deterministic.touch_peers import IMPEDANCE, STATED, WELD, GodObject, MocapWeld, Penalty

MARK, REST_MARK = "peers", "rest"
SECONDS = 5.0
REST_SECONDS = 20.0  # of which the last one counts
STIFFNESS = {"wall": 50e3, "stones": 2000.0}  # N/m, of the worlds of ours
SPRINGS = (500.0, 2000.0)  # N/m, between tool and avatar
SWEEP = (200.0, 300.0, 400.0, 450.0, 500.0, 550.0, 600.0, 700.0, 800.0, 1000.0, 1400.0, 2000.0, 2400.0, 3500.0, 50e3)
WELDS = tuple((time, *d) for time in (0.004, 0.01, 0.02, 0.05, 0.1) for d in (IMPEDANCE, (0.5, 0.5)))
LOOSE = Grip(100.0, 0.0)
GRIPS = {"firm": FIRM, "light": LIGHT, "hostile": HOSTILE, "undamped": LOOSE}
DAMPED = ("firm", "light", "hostile")
NOTHING = 1e-6  # J
OURS: Final = ("scene", "proxies", "MuJoCo under the proxy test")


@dataclass(frozen=True)
class Case:
    """A way to render a world: one of :data:`OURS`, or a peer with its gain."""

    world: str
    scheme: str
    gain: tuple[float, ...] = ()

    def renderer(self) -> Renderer:
        """A new one, at rest."""
        made: dict[str, Callable[[], Renderer]] = {
            "scene": lambda: Certified(scene(self.world, STIFFNESS[self.world])),
            "proxies": lambda: Certified(proxies(self.world, STIFFNESS[self.world])),
            "MuJoCo under the proxy test": lambda: Certified(engine(self.world, *self.gain)),
            "penalty": lambda: Penalty(self.world, *self.gain),
            "god-object": lambda: GodObject(self.world, *self.gain),
            "mocap and weld": lambda: MocapWeld(self.world, self.gain[0], (self.gain[1], self.gain[2])),
        }
        return made[self.scheme]()


@dataclass(frozen=True)
class Outcome:
    """What one case did, by hand.

    Attributes:
        stiffness: the force over the depth while the hand rests, N/m.
        deepest: the greatest depth of the device, m.
        received: the least energy that the world had received from the device, J.
        account: the least energy that the hand had put in, J.
        noise: RMS of the force above 100 Hz, N.
        reversals: of the force, in a second.
        lasted: when the device was beyond 1 m, s; the run's length where it never was.
        held: the ticks in which the proxy test shortened a step.
    """

    case: Case
    stiffness: dict[str, float]
    deepest: dict[str, float]
    received: dict[str, float]
    account: dict[str, float]
    noise: dict[str, float]
    reversals: dict[str, float]
    lasted: dict[str, float]
    held: dict[str, int]

    def least(self, hands: Iterable[str]) -> float:
        """The least account in any of these hands, J."""
        return min(self.account[hand] for hand in hands)

    def away(self, hand: str) -> bool:
        """Whether the device ran away in this hand."""
        return self.lasted[hand] < SECONDS - T / 2.0

    @property
    def felt(self) -> float:
        """The stiffness in the firm hand, N/m."""
        return self.stiffness["firm"]


def run(case: Case) -> Outcome:
    """One case in all hands."""
    found: dict[str, dict[str, Any]] = {name: {} for name in list(Outcome.__dataclass_fields__)[1:]}
    for name, grip in GRIPS.items():
        renderer = case.renderer()
        trace = touch(case.world, grip, renderer, SECONDS)
        row = {
            "stiffness": trace.stiffness(case.world),
            "deepest": trace.deepest,
            "received": min(0.0, float(trace.received.min())),
            "account": min(0.0, float(trace.account.min())),
            "noise": trace.noise,
            "reversals": trace.reversals,
            "lasted": T * len(trace.x),
            "held": sum(renderer.environment.held) if isinstance(renderer, Certified) else 0,
        }
        for key, value in row.items():
            found[key][name] = value
    return Outcome(case, **found)


def cases() -> list[Case]:
    """Every case."""
    found = []
    for world in STIFFNESS:
        found += [Case(world, scheme) for scheme in OURS[:2]]
        found += [Case(world, OURS[2], (K,)) for K in SPRINGS]
        found += [Case(world, scheme, (K,)) for scheme in ("penalty", "god-object") for K in SWEEP]
        found += [Case(world, "mocap and weld", weld) for weld in WELDS]
    return found


def best(outcomes: Sequence[Outcome], hands: Iterable[str]) -> Outcome:
    """The stiffest that gives none of these hands energy; where there is none, the one that gives least."""
    passive = [outcome for outcome in outcomes if outcome.least(hands) >= -NOTHING]
    return max(passive, key=lambda o: o.felt) if passive else max(outcomes, key=lambda o: o.least(hands))


def rows(outcomes: Sequence[Outcome], world: str) -> list[tuple[str, Outcome]]:
    """The rows of a world's table."""
    here = [outcome for outcome in outcomes if outcome.case.world == world]
    found = []
    for scheme, stated in (
        ("penalty", (STATED,)),
        ("god-object", (STATED,)),
        ("mocap and weld", (WELD, *IMPEDANCE)),
    ):
        swept = [outcome for outcome in here if outcome.case.scheme == scheme]
        (documented,) = [outcome for outcome in swept if outcome.case.gain == stated]
        for what, outcome in (
            ("as documented", documented),
            ("best in damped hands", best(swept, DAMPED)),
            ("best in all hands", best(swept, GRIPS)),
        ):
            gain = outcome.case.gain
            unit = f"{gain[0]:g} N/m" if len(gain) == 1 else f"{gain[0] * 1e3:g} ms, d = {gain[1]:g} to {gain[2]:g}"
            found.append((f"{scheme}, {what}: {unit}", outcome))
    for outcome in here:
        if outcome.case.scheme in OURS:
            spring = "".join(f", {K:g} N/m" for K in outcome.case.gain)
            found.append((f"**{outcome.case.scheme}{spring}**", outcome))
    return found


def table(outcomes: Sequence[Outcome]) -> str:
    """A table in Markdown for each world."""

    def energy(values: dict[str, float]) -> str:
        least = min(values.values())
        if least > -5e-10:
            return "0"
        return f"{least * 1e3:.3g} mJ" if least > -1.0 else f"{least:.3g} J"

    text = []
    for world, stiffness in STIFFNESS.items():
        name = f"A wall of {stiffness / 1e3:g} kN/m" if world == "wall" else f"Three stones of {stiffness / 1e3:g} kN/m"
        head = f"| {name} | felt, N/m | deepest, mm | least E | least account | noise, N | reversals in a second |"
        text += [head, "|" + "---|" * 7]
        for label, outcome in rows(outcomes, world):
            gone = outcome.away("firm")
            felt = f"{outcome.felt:.0f}" if not gone and outcome.felt > 0.0 else "—"
            firm = "—" if gone else f"{outcome.deepest['firm'] * 1e3:.1f}"
            cells = [
                f"{label}{' (away)' if any(map(outcome.away, GRIPS)) else ''}",
                felt,
                firm,
                energy(outcome.received),
                energy(outcome.account),
                *(
                    " / ".join(f"{by[grip]:{form}}" for grip in ("firm", "light"))
                    for by, form in ((outcome.noise, ".2g"), (outcome.reversals, ".0f"))
                ),
            ]
            text.append(f"| {' | '.join(cells)} |")
        text.append("")
    return "\n".join(text).rstrip()


def plot(outcomes: Sequence[Outcome], file: Path) -> None:
    """The least account against what is felt, for every gain."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10.0, 4.2), sharey=True, layout="constrained")
    peers = {"penalty": "o-", "god-object": "x--", "mocap and weld": "s"}
    marks = {"scene": "D", "proxies": "*", "MuJoCo under the proxy test": "P"}
    for panel, world in zip(axes, STIFFNESS, strict=True):
        for scheme, style in {**peers, **marks}.items():
            here = [o for o in outcomes if o.case.world == world and o.case.scheme == scheme and o.felt > 0.0]
            here = [o for o in here if not o.away("firm") and o.felt < 5000.0]
            here.sort(key=lambda o: o.felt)
            size = 11 if scheme in marks else 5
            felt, least = [o.felt for o in here], [o.least(GRIPS) * 1e3 for o in here]
            panel.plot(felt, least, style, label=scheme, markersize=size, zorder=3 if scheme in marks else 2)
        panel.axhline(0.0, color="0.6", linewidth=0.8)
        panel.set_yscale("symlog", linthresh=1e-3)
        panel.set_xscale("log")
        panel.set_title("a wall" if world == "wall" else "three stones that overlap")
        panel.set_xlabel("stiffness that a firm hand feels, N/m")
    axes[0].set_ylabel("least account at the hand, mJ")
    axes[0].legend(fontsize=8)
    figure.savefig(file, dpi=110)
    pyplot.close(figure)


def resting() -> str:
    """A table of the device's motion while a hand rests on the wall, against its encoder's step, in Markdown."""
    grips = {"undamped": LOOSE, "light": LIGHT, "firm": FIRM}
    worlds = {
        "scene": scene("wall", STIFFNESS["wall"]),
        "proxies": proxies("wall", STIFFNESS["wall"]),
        "MuJoCo under the proxy test": engine("wall", SPRINGS[1]),
    }
    made: list[tuple[str, str, Callable[[], Renderer]]] = [
        (name, objective, lambda world=world, objective=objective: Certified(world, objective))
        for objective in ("feasible", "stiffest")
        for name, world in worlds.items()
    ]
    made += [(f"penalty of {K:g} N/m", "", lambda K=K: Penalty("wall", K)) for K in (500.0, STATED)]
    text = [
        f"| rendered by | coupling | {' | '.join(f'a hand that is {name}' for name in grips)} |",
        "|" + "---|" * (2 + len(grips)),
    ]
    for name, objective, make in made:
        cells = []
        for grip in grips.values():
            renderer = make()
            amplitude, line = touch("wall", grip, renderer, REST_SECONDS, motion=RESTING).unrest(ENCODER)
            cells.append(", ".join(_steps(value) for value in (amplitude, line)))
        coupling = f"{objective}, {renderer.stiffness:.0f} N/m" if isinstance(renderer, Certified) else "none"
        text.append(f"| {name} | {coupling} | {' | '.join(cells)} |")
    return "\n".join(text)


def _steps(value: float) -> str:
    if value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.2g}" if value > 1e-3 else "0"


def _plain(value: Any) -> Any:
    """``value`` as JSON knows it: four digits, and null in place of what is not a number."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else None
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all cases; 1 if one of ours gave a hand energy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=1, help="processes to share the work (1)")
    add_outputs(parser)
    parser.add_argument("--rest", action="store_true", help="hands that rest on the wall alone")
    asked = parser.parse_args(arguments)
    if asked.rest:
        said = resting()
        sys.stdout.write(said + "\n")
        if asked.markdown:
            fill(asked.markdown, REST_MARK, said)
        return 0
    make_folders(asked.json, asked.plot)
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        outcomes = pool.map(run, cases(), chunksize=1)
    if asked.json:
        asked.json.write_text(
            json.dumps([_plain(asdict(outcome)) for outcome in outcomes], separators=(",", ":")) + "\n"
        )
    if asked.plot:
        plot(outcomes, asked.plot)
    said = table(outcomes)
    sys.stdout.write(said + "\n")
    if asked.markdown:
        fill(asked.markdown, MARK, said)
    return int(any(outcome.least(GRIPS) < -NOTHING for outcome in outcomes if outcome.case.scheme in OURS))


if __name__ == "__main__":
    sys.exit(main())
