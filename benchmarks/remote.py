"""A remote user over every kind of network: the wave link beside what others do, in simulated time.

    python -m benchmarks.remote [--seeds N] [--processes N] [--json FILE] [--resume]
                               [--plot FILE] [--markdown FILE]

Example 1, dx remote, with the product's cores for device, coupling, environment and faces. The runs are every
combination of a round trip, a loss, a jitter and outages, with a clock that is 100 millionths fast or slow. Its peers
(tests/deterministic/remote_peers.py) have the same network, device, coupling and environment. The
exit code is 1 if the wave link breaks what decision 33 proves or promises.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import multiprocessing
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.page import fill
from manyhands.nodes.wave_link import UserFace, WorldFace
from tests.deterministic.network import Channel
from tests.deterministic.network import Path as Way
from tests.deterministic.remote import EXAMPLE_1, Force, Remote, RemoteSession, T, waves
from tests.deterministic.remote_peers import classic, naive, pspm, tdpa

MARK = "remote"
V = (1110.2, 0.2598)  # N/m, N*s/m: the coupling of example1.yaml
E_0 = 0.02  # J
THETA = (0.4, 0.3)  # N*s/m; the certificate leaves 0.752 and 0.463
HEAVIEST = 0.5  # kg of felt mass
STRONGEST = 60.0  # N*s/m, the greatest b
JOINED = 2.2  # s until the hands begin
SECONDS = 10.0
HOLD = 60.0
SPEED = 0.1  # m/s
DEAD = ((3.0, 3.3), (4.0, 5.0))  # both directions, s
ONE_WAY = (5.5, 5.7)  # the way to the environment alone

ROUND_TRIPS = (0.002, 0.01, 0.04, 0.1, 0.2, 0.4)
LOSSES = (0.0, 0.01, 0.05, 0.1)
JITTERS = ("none", "uniform", "lumps")
OURS = "wave link"
PEERS = ("naive", "waves, last held", "waves, zeroing", "PSPM", "TDPA")


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        scheme: its name.
        R: round trip of the network without jitter, s.
        loss: part of the messages that are lost.
        kind: of the jitter; it is half of a way's delay, at least 2 ms and at most 50 ms.
        outages: whether the network is dead for a while, in both directions and in one.
        ppm: of the remote clock.
        hold: the constant force of the remote hand, N; 0 for Example 1's forces.
        seed: of the network.
    """

    scheme: str
    R: float
    loss: float
    kind: str
    outages: bool
    ppm: float
    hold: float
    seed: int

    @property
    def jitter(self) -> float:
        """What a message is late by at most, s."""
        return 0.0 if self.kind == "none" else min(0.05, max(0.002, 0.25 * self.R))

    @property
    def b(self) -> float:
        """The impedance that is felt as at most :data:`HEAVIEST`, with the play-out in the round trip."""
        return min(STRONGEST, 2.0 * HEAVIEST / (self.R + 3.0 * self.jitter + 0.006))

    def ways(self) -> tuple[Way, Way]:
        """Both directions of the network."""
        kind = "uniform" if self.kind == "none" else self.kind
        both = DEAD if self.outages else ()
        up = (*both, ONE_WAY) if self.outages else ()
        again = 0.05 if self.loss else 0.0
        common = {"delay": self.R / 2.0, "jitter": self.jitter, "kind": kind, "loss": self.loss, "again": again}
        return Way(**common, outages=up), Way(**common, outages=both)


@dataclass(frozen=True)
class Outcome:
    """What a run was.

    Attributes:
        diverged: when a device was faster than 10 m/s, s.
        ledger: least energy that had entered the two-port, with the harvest, J.
        gap: between both tools at the end, m; of a constant force, its deviation from 20 s on.
        step: the greatest change of the remote force within 10 ms, N.
        speed: of the fastest device at the end, m/s.
        noise: standard deviation of the remote force in the last 2 s, N.
        clipped: ticks in which a tank limited a wave, of both faces.
    """

    case: Case
    diverged: float | None
    ledger: float
    gap: float
    step: float
    speed: float
    noise: float
    clipped: int


def ends_of(case: Case) -> Callable[[float, np.ndarray], tuple[Any, Any]]:
    """Both ends of the case's scheme."""
    if case.scheme == OURS:
        harvest = {"user": {"theta": np.array([[THETA[0]]])}, "world": {"theta": np.array([[THETA[1]]])}}
        return waves(case.b, 2.0, E_0=E_0, **harvest)
    return {
        "naive": naive,
        "waves, last held": classic(case.b, zeroing=False),
        "waves, zeroing": classic(case.b, zeroing=True),
        "PSPM": pspm(*V, E_0),
        "TDPA": tdpa(*V),
    }[case.scheme]


def later(force: Force) -> Force:
    """The same force, once all have joined."""
    return lambda t: force(t - JOINED)


def run(case: Case) -> Outcome:
    """Run one case: join and measure the depth at rest, then push."""
    up, down = case.ways()
    theta = THETA if case.scheme == OURS else (0.0, 0.0)
    hands = [later(force) for force in EXAMPLE_1]
    if case.hold:
        hands[0] = later(lambda t: case.hold if t >= 0.0 else 0.0)
    session = RemoteSession(
        [Remote(up, down, ends_of(case), ppm=case.ppm, theta=theta), None, None], V, hands, case.seed
    )
    user = session.users[0]
    session.run(0.5 + case.R)
    faces = (user.user, user.world) if case.scheme == OURS else ()
    for face in faces:
        face.measure()
    session.run(1.8, keep=False)
    for face in faces:
        face.set_depth(face.measured)
    session.run(JOINED, keep=False)
    trace = user.trace
    since = len(trace.t)
    session.run(JOINED + HOLD if case.hold else SECONDS)
    f, gap = np.array(trace.f_c[since:]), np.array(trace.gap[since:])
    last = gap[-300:].mean() if len(gap) else math.nan
    if case.hold and len(gap) > 30000:
        last -= gap[20000:20300].mean()
    return Outcome(
        case,
        session.diverged,
        user.least,
        float(last),
        float(np.abs(f[10:] - f[:-10]).max()) if len(f) > 10 else math.nan,
        max(abs(one.device.v) for one in session.users),
        float(f[-2000:].std()) if len(f) else math.nan,
        sum(face.tank.clipped for face in faces),
    )


def felt(R: float) -> dict[str, float]:
    """K against a wall and M of a free end at a clean round trip, identified, beside 2b/R and bR/2."""
    b = min(STRONGEST, 2.0 * HEAVIEST / (R + 0.006))
    found = {"R": R, "b": b}
    for name, wall in (("K", True), ("M", False)):
        user = UserFace(np.array([[b]]), np.array([[1e-7]]), T, T, 2.0, E_0=10.0)
        world = WorldFace(np.array([[b]]), T, T, 2.0, E_0=10.0)
        up: Channel[Any] = Channel(Way(R / 2.0), 0)
        down: Channel[Any] = Channel(Way(R / 2.0), 1)
        stiffness = b / T if wall else 0.0
        rest = 3.0 * R + 0.3
        # from tick to tick: what is under way, rounded up to the next tick, and the play-out
        at, pieces = 0.37 * T, []
        for k in range(round((rest + 12.0 * R + 2.0) / T)):
            t = k * T
            for message in up.arrived(t):
                world.hear(*message)
            p = world.tool()[0]
            f = -stiffness * p / (1.0 + stiffness * float(world.D_V[0, 0]))
            world.step([f])
            if world.aligned:
                down.send(t + 1e-4, world.message())
            for message in down.arrived(t + at):
                user.hear(*message)
            moved = max(0.0, t - rest)
            x = 1e-3 * min(1.0, moved / 0.2) if wall else 0.05 * moved * moved
            force = user.step([x])[0]
            up.send(t + at + 1e-4, user.message())
            x_e = p + float(world.D_V[0, 0]) * f
            pieces.append((x - x_e, force))
        # the line is lossless, so the force swings about its mean with the period of two round trips
        whole = math.ceil((R / 2.0 + at + 1e-4) / T) + math.floor((R / 2.0 + 1e-4 - at) / T + 1.0)
        trip = whole * T + user.latency + world.latency
        period = 2 * round(trip / T)
        last = np.array(pieces[-2 * period :])
        gap, force = last.mean(axis=0)
        found["trip"] = trip
        found[name] = float(-force / gap if wall else -force / 0.1)
    found["K_law"], found["M_law"] = 2.0 * b / found["trip"], b * found["trip"] / 2.0
    return found


def drag(asked: tuple[str, float]) -> tuple[str, float, float]:
    """A scheme, R, and the force in free space at a steady :data:`SPEED`, N; there is nothing at the world's tool."""
    scheme, R = asked
    case = Case(scheme, R, 0.0, "none", False, 0.0, 0.0, 0)
    user, world = ends_of(case)(T, np.array([[1e-7]]))
    up: Channel[Any] = Channel(Way(R / 2.0), 0)
    down: Channel[Any] = Channel(Way(R / 2.0), 1)
    forces, x, rise = [], 0.0, 1.0 + 5.0 * R
    for k in range(round((2.0 + 2.0 * rise) / T)):
        t = k * T
        along = min(1.0, max(0.0, t - 0.5 - 2.0 * R) / rise)
        x += T * SPEED * math.sin(0.5 * math.pi * along) ** 2
        for message in up.arrived(t):
            world.hear(*message)
        world.tool()
        world.step([0.0])
        if getattr(world, "aligned", True):
            down.send(t + 1e-4, world.message())
        for message in down.arrived(t + 0.37 * T):
            user.hear(*message)
        forces.append(user.step([x])[0])
        up.send(t + 0.37 * T + 1e-4, user.message())
    return scheme, R, float(-np.mean(forces[-500:]))


def cases(seeds: int) -> Iterator[Case]:
    """Every run of the benchmark: the wave link in all combinations, its peers in a third of them."""
    grid = list(itertools.product(ROUND_TRIPS, LOSSES, JITTERS, (False, True)))
    for seed in range(seeds):
        for number, (R, loss, kind, outages) in enumerate(grid):
            if seed == 0 or kind != "none":
                yield Case(OURS, R, loss, kind, outages, 100.0 if (number + seed) % 2 else -100.0, 0.0, seed)
    for R, loss, kind in itertools.product(ROUND_TRIPS[1::2], (0.0, 0.1), ("uniform", "lumps")):
        yield Case(OURS, R, loss, kind, False, 100.0, 1.0, 0)
    for scheme in PEERS:
        for number, (R, loss, kind, outages) in enumerate(
            itertools.product(ROUND_TRIPS, (0.0, 0.05), JITTERS[:2], (False, True))
        ):
            yield Case(scheme, R, loss, kind, outages, 100.0 if number % 2 else -100.0, 0.0, 0)
        if scheme != "naive":
            for R, loss in itertools.product(ROUND_TRIPS[1::2], (0.0, 0.1)):
                yield Case(scheme, R, loss, "uniform", False, 100.0, 1.0, 0)


def violations(outcomes: Sequence[Outcome], lines: Sequence[Mapping[str, float]]) -> list[str]:
    """What the wave link was to keep and did not."""
    found = []
    for one in outcomes:
        if one.case.scheme != OURS:
            continue
        if one.ledger < -2.0 * E_0 - 1e-9:
            found.append(f"{one.case}: found a ledger of {one.ledger:.6f} J; expected {-2.0 * E_0} J or more")
        if one.diverged is not None:
            found.append(f"{one.case}: found 10 m/s at {one.diverged:.3f} s; expected none")
    for line in lines:
        for name in ("K", "M"):
            if abs(line[name] / line[f"{name}_law"] - 1.0) > 0.05:
                found.append(f"{line}: found {name} {line[name]:.4g}; expected {line[f'{name}_law']:.4g} within 5 %")
    return found


def table(
    outcomes: Sequence[Outcome],
    lines: Sequence[Mapping[str, float]],
    drags: Mapping[tuple[str, float], float],
) -> str:
    """The page's tables."""
    rows = [
        "| scheme | runs | diverged | least ledger, mJ | gap at rest, mm: median, 90 %, worst | "
        "creep at 1 N from 20 to 60 s, mm: median, worst | greatest step in 10 ms, N: median, worst | "
        "drag in free space at 0.1 m/s, N: R = 10, 40, 100 ms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scheme in dict.fromkeys(one.case.scheme for one in outcomes):
        of = [one for one in outcomes if one.case.scheme == scheme]
        whole = [one for one in of if one.diverged is None]
        rest = sorted(1e3 * abs(one.gap) for one in whole if not one.case.hold)
        creep = sorted(1e3 * abs(one.gap) for one in whole if one.case.hold)
        steps = sorted(one.step for one in whole if not one.case.hold)
        ledger = f"{1e3 * min(one.ledger for one in of):.2f}"
        gaps = f"{statistics.median(rest):.3f}, {rest[int(0.9 * len(rest))]:.3f}, {rest[-1]:.2f}" if rest else "–"
        crept = f"{statistics.median(creep):.3f}, {creep[-1]:.2f}" if creep else "–"
        stepped = f"{statistics.median(steps):.2f}, {steps[-1]:.2f}" if steps else "–"
        name = f"**{scheme}**" if scheme == OURS else scheme
        drawn = ", ".join(f"{abs(drags[scheme, R]):.2f}" for R in ROUND_TRIPS[1:4])
        rows.append(
            f"| {name} | {len(of)} | {len(of) - len(whole)} | {ledger} | {gaps} | {crept} | {stepped} | {drawn} |"
        )
    rows += [
        "",
        "| round trip of the network, ms | with play-out, ms | b, N·s/m | K felt, N/m | 2b/R | M felt, kg | bR/2 |",
        "|---|---|---|---|---|---|---|",
    ]
    for line in lines:
        rows.append(
            f"| {1e3 * line['R']:.0f} | {1e3 * line['trip']:.0f} | {line['b']:.3g} | {line['K']:.4g} | "
            f"{line['K_law']:.4g} | {line['M']:.3f} | {line['M_law']:.3f} |"
        )
    return "\n".join(rows)


def save(
    path: Path | None,
    outcomes: Sequence[Outcome],
    lines: Sequence[Mapping[str, float]],
    drags: Mapping[tuple[str, float], float],
) -> None:
    """Write all figures so far."""
    if path is not None:
        content = {
            "felt": lines,
            "drag": [[*key, force] for key, force in drags.items()],
            "runs": [asdict(one) for one in outcomes],
        }
        path.write_text(json.dumps(content, separators=(",", ":")) + "\n")


def plot(outcomes: Sequence[Outcome], lines: Sequence[Mapping[str, float]], path: Path) -> None:
    """Left, what distance costs; right, the gap that each scheme leaves at rest, run by run."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
    trips = [1e3 * line["trip"] for line in lines]
    left.loglog(trips, [line["K_law"] for line in lines], color="tab:blue", linewidth=1.0, label="K = 2b/R, N/m")
    left.loglog(trips, [line["K"] for line in lines], "o", color="tab:blue", label="identified")
    left.set(xlabel="round trip with play-out, ms", ylabel="felt stiffness, N/m", title="What distance costs")
    masses = left.twinx()
    masses.plot(trips, [line["M_law"] for line in lines], color="tab:red", linewidth=1.0, label="M = bR/2, kg")
    masses.plot(trips, [line["M"] for line in lines], "s", color="tab:red", label="identified")
    masses.set(ylabel="felt mass, kg", ylim=(0.0, 0.6))
    left.legend(loc="lower left", frameon=False)
    masses.legend(loc="upper right", frameon=False)
    schemes = list(dict.fromkeys(one.case.scheme for one in outcomes))
    for row, scheme in enumerate(schemes):
        of = [one for one in outcomes if one.case.scheme == scheme and not one.case.hold]
        gaps = [max(1e-4, 1e3 * abs(one.gap)) for one in of if one.diverged is None]
        spread = np.linspace(-0.25, 0.25, len(gaps)) if gaps else []
        right.semilogx(gaps, [row + by for by in spread], ".", markersize=3)
        lost = len(of) - len(gaps)
        if lost:
            right.text(1.3e-4, row, f"{lost} of {len(of)} diverge", va="center")
    right.set_yticks(range(len(schemes)), schemes)
    right.invert_yaxis()
    right.set(xlabel="gap between both tools at rest, mm", title="What is left at rest")
    figure.savefig(path, dpi=130)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all, write what was asked for, and report violations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2, help="networks for each combination, for the wave link")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, help="written as the runs go on")
    parser.add_argument("--resume", action="store_true", help="leave out the runs that --json has already")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--markdown", type=Path)
    options = parser.parse_args(arguments)
    outcomes: list[Outcome] = []
    if options.resume and options.json.exists():
        outcomes = [Outcome(Case(**one.pop("case")), **one) for one in json.loads(options.json.read_text())["runs"]]
    done = {one.case for one in outcomes}
    todo = [case for case in cases(options.seeds) if case not in done]
    with multiprocessing.Pool(options.processes) as pool:
        lines = pool.map(felt, ROUND_TRIPS)
        asked = itertools.product((OURS, *PEERS), ROUND_TRIPS)
        drags = {(scheme, R): force for scheme, R, force in pool.map(drag, asked)}
        for count, outcome in enumerate(pool.imap(run, todo), 1):
            outcomes.append(outcome)
            if count % 20 == 0:
                print(f"{count} of {len(todo)} runs", file=sys.stderr, flush=True)
                save(options.json, outcomes, lines, drags)
    save(options.json, outcomes, lines, drags)
    text = table(outcomes, lines, drags)
    print(text)
    found = violations(outcomes, lines)
    print("\n".join(found), file=sys.stderr)
    if options.plot:
        plot(outcomes, lines, options.plot)
    if options.markdown:
        fill(options.markdown, MARK, text)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
