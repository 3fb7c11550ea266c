"""The energy that a hand gets from a tool that it turns: our law, a god-object, a midpoint body (`make orientation`).

    python -m benchmarks.orientation_peers [--hands N] [--seeds N] [--markdown FILE]

The peers are those of tests/support/turning_peers.py, whose docstring has what is documented of them and what we had to
choose. All get the same hands, the same device, which burns :data:`B` and samples each :data:`T`, and the same spring.
The stiffness is a multiple of what decision 54 certifies at that delay. What a hand got is the most by which it had put
in less than nothing at the end of a quarter of a tick, before any world had anything to give: all begin at rest.

*late ticks* are certified for torques that act at once. Every tenth tick lasts up to three periods, and its torque acts
late. Our device counts that and lets go, as it does in a session that allows nothing to lateness. It knows the damping
of the certified stiffness in every column.

All numbers follow from the code and the seeds alone. The exit code is 1 if our law, at the certified stiffness,
gives out more than its device has counted as late, which is nothing where no tick is.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.page import fill
from manyhands.design.levels.contract import DeviceShare
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import DeviceRung, OrientationPart
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, Vector3
from manyhands.protocol.clock import Instant, from_seconds
from tests.support.turning import SUBSTEPS, Array, Motions, bound, least_energy, torques
from tests.support.turning_peers import FASTEST, god_object, hands, in_a_hole, midpoint

MARK: Final = "orientation-peers"
B: Final = 1e-3
"""N*m*s/rad, what the device burns."""
T: Final = 1e-3
"""s."""
MULTIPLES: Final = (0.5, 1.0, 2.0, 4.0)
"""Of the certified stiffness."""
DAMPER: Final = 0.25
"""k T, of the coupling of a midpoint body that has one."""
TICKS: Final = 80
ROUNDING: Final = 1e-12  # k rad^2
LATE: Final = "late ticks"
TIMINGS: Final = {"at once": 0, "after T": SUBSTEPS, LATE: 0}
"""When torques act, with the substeps of the certified delay."""


class Led:
    """What is turned along a given way."""

    def __init__(self) -> None:
        """Stand upright."""
        self.R = UPRIGHT

    def to(self, at: Instant) -> Quaternion:
        """Where it has been led to."""
        return self.R

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """Nothing is turned by a torque."""


def ours(motions: Motions, proxies: Array) -> Array:
    """The torques of our spring, by the proxies that a world proposes, motions x ticks x 4."""
    proposed = proxies.tolist()
    return torques(motions, lambda i, k, R, Q: Quaternion(*proposed[i][k]))[0]


def ours_late(motions: Motions, proxies: Array) -> tuple[Array, Array]:
    """The same by the device itself, and what it has counted as late; with k = 1 N*m/rad, so that both are in k."""
    found, counted = np.empty((*motions.samples.shape[:2], 3)), np.zeros(len(motions.turns))
    ways = motions.samples.tolist()
    ends = np.cumsum(motions.lasts, axis=2)
    starts = np.concatenate([np.zeros_like(ends[:, :, :1]), ends], axis=2)
    delays = np.take_along_axis(starts, motions.acts[:, :, None], axis=2)[:, :, 0]
    begun = np.concatenate([np.zeros((len(ways), 1)), np.cumsum(ends[:, :-1, -1], axis=1)], axis=1)
    part = OrientationPart(bound(0.0) * T, 1.0, 1e3, FASTEST / T, None)
    rung = DeviceRung(0.0, 0.0, DeviceShare())
    for i, way in enumerate(ways):
        led = Led()
        device = DeviceOrientation(part, T, rung, LatenessAllowance(0.0), from_seconds(10 * T), led)
        for k, orientation in enumerate(way):
            led.R = Quaternion(*orientation)
            at = from_seconds(float(begun[i, k]) * T)
            device.sample(k, Instant(at))
            came = [*proxies[i, k].tolist(), device.spring.deposited, device.life]
            found[i, k] = device.exert(came, Instant(at + from_seconds(float(delays[i, k]) * T)))
        counted[i] = device.spring.late
    return found, counted


@dataclass(frozen=True)
class Row:
    """What one law gives out in one world and timing: by multiple, the worst and the median hand, J, by seed."""

    timing: str
    world: str
    law: str
    worst: dict[float, list[float]]
    median: dict[float, list[float]]
    beyond: list[float]
    """By seed, the most by which a hand got more at the certified stiffness than its device counted as late, J."""


def exerted(motions: Motions, late: bool) -> dict[tuple[str, str], tuple[Array, Array]]:
    """By world and law the torques, motions x ticks x 3, k rad, and what was counted as late, k rad^2."""
    samples, nothing = motions.samples, np.zeros(len(motions.turns))

    def law(proxies: Array) -> tuple[Array, Array]:
        return ours_late(motions, proxies) if late else (ours(motions, proxies), nothing)

    nearest = np.array([[in_a_hole(Quaternion(*q)) for q in way] for way in samples.tolist()])
    found = {
        ("a hole", "god-object"): (god_object(samples), nothing),
        ("a hole", "ours, the god-object's proxies"): law(nearest),
    }
    for world, hole in (("nothing", False), ("a hole", True)):
        at_midpoint, _, bodies = midpoint(samples, hole=hole)
        at_sample = midpoint(samples, DAMPER, hole)[1]
        found[world, "midpoint body"] = at_midpoint, nothing
        found[world, "midpoint body, damper, torque of the sample"] = at_sample, nothing
        found[world, "ours, the midpoint body as proxy"] = law(bodies)
    return found


def measure(count: int, seeds: Sequence[int]) -> list[Row]:
    """All rows, with so many hands for each seed."""
    rows: dict[tuple[str, str, str], Row] = {}
    for timing, delay in TIMINGS.items():
        certified = bound(delay / SUBSTEPS)
        for seed in seeds:
            motions = hands(np.random.default_rng([seed, delay, 33]), count, TICKS, delay, timing == LATE)
            for (world, law), (torque, counted) in exerted(motions, timing == LATE).items():
                row = rows.setdefault((timing, world, law), Row(timing, world, law, {}, {}, []))
                for multiple in MULTIPLES:
                    k = multiple * B / (certified * T)
                    given = -k * least_energy(motions, torque, certified / multiple)
                    row.worst.setdefault(multiple, []).append(float(given.max()))
                    row.median.setdefault(multiple, []).append(float(np.median(given)))
                    if multiple == 1.0:
                        row.beyond.append(float((given - k * counted).max()))
    return list(rows.values())


def holds(rows: Sequence[Row]) -> bool:
    """Whether our law gives out what it says at the certified stiffness: what it counts as late, and else nothing."""
    return all(max(row.beyond) <= ROUNDING for row in rows if row.law.startswith("ours"))


def table(rows: Sequence[Row]) -> str:
    """The rows in Markdown, mJ: the worst hand of each seed, from the least to the greatest, and the median hand."""
    heads = [f"{multiple:g} k" for multiple in MULTIPLES]
    lines = [f"| torques act | in | law | {' | '.join(heads)} |", "|---" * (3 + len(heads)) + "|"]
    for row in sorted(rows, key=lambda row: (list(TIMINGS).index(row.timing), row.world != "nothing", row.law)):
        cells = [_cell(row.worst[multiple], row.median[multiple]) for multiple in MULTIPLES]
        lines.append(f"| {row.timing} | {row.world} | {row.law} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(worst: Sequence[float], median: Sequence[float]) -> str:
    if max(worst) <= ROUNDING:
        return "0"
    middle = float(np.median(median))
    return f"{_mJ(min(worst))} to {_mJ(max(worst))}; {_mJ(middle)}"


def _mJ(energy: float) -> str:
    return f"{float(f'{1e3 * energy:.2g}') if energy > ROUNDING else 0.0:g}"


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hands", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    began = time.perf_counter()
    rows = measure(given.hands, range(1, given.seeds + 1))
    found = table(rows)
    print(found)
    if given.markdown is not None:
        fill(given.markdown, MARK, found)
    right = holds(rows)
    print(f"{time.perf_counter() - began:.0f} s; {'all holds' if right else 'SOMETHING DOES NOT HOLD'}")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
