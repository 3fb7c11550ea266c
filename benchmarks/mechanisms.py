"""What held torques, encoder steps and dry friction do to a certified stiffness (`make mechanisms`).

    python -m benchmarks.mechanisms [--images FOLDER] [--markdown FILE]

The tables and pictures of docs/mechanisms.md. Its session is the file ``arm.yaml`` of that page, with other values as
``--set`` gives them, so that each stiffness is what `manyhands design` prints. Nothing is random and nothing is timed:
two runs are equal.
"""

from __future__ import annotations

import argparse
import functools
import re
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

import manyhands as mh
from benchmarks.page import fill, tell
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.linkage import Linkage, greatest_bending, linkage_of
from manyhands.design.quantisation import closed
from manyhands.protocol.clock import Instant, from_seconds
from tests.deterministic.touch import DELAY, ENCODER, LIGHT, T, device, measured, session_tree

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
Changes = Mapping[str, float]

PAGE: Final = Path(__file__).resolve().parents[1] / "docs" / "mechanisms.md"
SPEED: Final = 0.1
"""v*, m/s, below which friction is counted in the tables of examples."""


# --- designs of the page's session


@dataclass(frozen=True)
class Found:
    """What a design found: the stiffness of its coupling, N/m, and the force w of the encoder's steps, N."""

    stiffness: float
    steps: float


def arm_yaml(force_held: bool = False) -> str:
    """The page's session; without the lines that say that its motors hold torques if it is to hold forces."""
    (text,) = re.findall(r"<!-- file: arm.yaml -->\n```yaml\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    return re.sub(r"^    (held|linkage):.*\n", "", text, flags=re.MULTILINE) if force_held else str(text)


def designed(changes: Changes, force_held: bool = False) -> Found | None:
    """The stiffest coupling of the page's session with other values; None where there is none."""
    return _designed(tuple(changes.items()), force_held)


@functools.cache
def _designed(changes: tuple[tuple[str, float], ...], force_held: bool) -> Found | None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(arm_yaml(force_held))
        try:
            certificate = mh.certify(mh.load(file, dict(changes)))
        except mh.Infeasible:
            return None
    claim = certificate.encoder
    steps = max(claim.force) if claim is not None and claim.force is not None else 0.0
    return Found(float(certificate.stiffness[0, 0]), steps)


@dataclass(frozen=True)
class Example:
    """Numbers of the size that such devices have; assumptions, and no product's data.

    Attributes:
        force: the greatest, both axes together, N.
        kappa: 1/m.
        osp: N*s/m.
        step: of the encoder at the tip, m.
        friction: the least, N.
    """

    name: str
    force: float
    kappa: float
    osp: float
    step: float
    friction: float

    @property
    def changes(self) -> dict[str, float]:
        """Its values, as ``--set`` takes them; of the force each axis has its part."""
        return {
            "devices.arm.limits.force": np.floor(self.force / np.sqrt(2.0) * 1e3) / 1e3,
            "devices.arm.linkage.kappa": self.kappa,
            "devices.arm.osp": self.osp,
            "devices.arm.step": self.step,
            "devices.arm.friction.least": self.friction,
        }


EXAMPLES: Final = (
    Example("Touch-like", 3.3, 12.7, 0.05, 55e-6, 0.1),
    Example("Inverse3-like", 10.0, 8.2, 0.1, 10e-6, 0.05),
    Example("omega-like", 12.0, 10.9, 0.1, 10e-6, 0.05),
)
TIMES: Final = ((1e-3, 0.2e-3), (0.25e-3, 0.1e-3))
"""s; period and delay."""


def devices() -> str:
    """What is assumed of each device, in Markdown."""
    text = [
        "| like | greatest force, N | κ, 1/m | Δ_D, N·s/m | step, µm | friction, N |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for of in EXAMPLES:
        text.append(f"| {of.name} | {of.force:g} | {of.kappa:g} | {of.osp:g} | {1e6 * of.step:g} | {of.friction:g} |")
    return "\n".join(text)


def timing(period: float, tau: float) -> dict[str, float]:
    """A period and a delay as ``--set`` takes them."""
    return {"period": period, "design.tau": tau}


def examples(of: Iterable[Example] = EXAMPLES) -> str:
    """The certified stiffness of each device, in Markdown."""
    text = [
        "| like | rate, delay | force held | torques held | torques held, below 0.1 m/s "
        "| w at every speed | w below 0.1 m/s |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for one in of:
        for period, tau in TIMES:
            at = one.changes | timing(period, tau)
            force = designed({key: value for key, value in at.items() if "linkage" not in key}, force_held=True)
            torque, slow = designed(at), designed(at | {"design.speed": SPEED})
            found = [_newtons(force), _newtons(torque), _newtons(slow), _steps(torque), _steps(slow)]
            text.append(f"| {one.name} | {1e-3 / period:g} kHz, {1e3 * tau:g} ms | {' | '.join(found)} |")
    return "\n".join(text)


def options() -> str:
    """The options of `manyhands design arm.yaml` that give each figure, in Markdown."""
    rows = [(one.name, one.changes) for one in EXAMPLES]
    rows += [(f"{1e-3 / period:g} kHz, {1e3 * tau:g} ms", timing(period, tau)) for period, tau in TIMES]
    rows.append((f"below {SPEED:g} m/s", {"design.speed": SPEED}))
    text = ["| figure | options |", "|---|---|"]
    return "\n".join(text + [f"| {name} | `{command(changes)}` |" for name, changes in rows])


def command(changes: Changes) -> str:
    """Values as options of a command."""
    return " ".join(f"--set {key}={np.format_float_positional(value, trim='-')}" for key, value in changes.items())


HELPS: Final[tuple[tuple[str, dict[str, float]], ...]] = (
    ("as it is", {}),
    ("half the delay", {"design.tau": 0.1e-3}),
    ("4 kHz", {"period": 0.25e-3}),
    ("4 kHz and half the delay", timing(0.25e-3, 0.1e-3)),
    ("half the greatest force", {"devices.arm.limits.force": 3.535}),
    ("half of κ", {"devices.arm.linkage.kappa": 4.1}),
    ("half the greatest speed", {"devices.arm.limits.speed": 0.3535}),
    ("half the step", {"devices.arm.step": 5e-6}),
    ("twice the dry friction", {"devices.arm.friction.least": 0.1}),
    ("twice the osp", {"devices.arm.osp": 0.2}),
)
STEPS: Final[tuple[tuple[str, dict[str, float]], ...]] = (
    ("Touch-like, 4 kHz, 0.1 ms", {}),
    ("half the step", {"devices.arm.step": 27.5e-6}),
)
"""Of the coarsest encoder, beside which friction is small."""


def helps() -> str:
    """What each change of the page's session does, in Markdown."""
    text = [
        "| change | options | every speed, N/m | below 0.1 m/s, N/m | w below 0.1 m/s, mN |",
        "|---|---|---:|---:|---:|",
    ]
    coarse = EXAMPLES[0].changes | timing(*TIMES[1])
    for base, rows in (({}, HELPS), (coarse, STEPS)):
        for name, changes in rows:
            at = base | changes
            every, slow = designed(at), designed(at | {"design.speed": SPEED})
            given = f"`{command(changes)}`" if changes else ""
            text.append(f"| {name} | {given} | {_newtons(every)} | {_newtons(slow)} | {_steps(slow)} |")
    return "\n".join(text)


def _newtons(found: Found | None) -> str:
    return "none" if found is None else f"{found.stiffness:.0f}"


def _steps(found: Found | None) -> str:
    return "none" if found is None else f"{1e3 * found.steps:.2g}"


# --- (a) held torques

ARM: Final[dict[str, Any]] = {
    "kind": "chain", "turns": ["z", "z"], "links": [[0.12, 0.0, 0.0], [0.14, 0.0, 0.0]],
    "low": [0.0, 1.1], "high": [0.6, 2.68],
}  # fmt: skip
FORCE, BURNS, FAST = 12.0, 0.1, 1.0  # N, N*s/m, m/s
SWINGS, REACH, SECONDS = 5.0, 0.016, 20.0  # Hz, m, s
ELBOWS: Final = {"folded": 2.58, "at a right angle": np.pi / 2.0}  # rad


@dataclass(frozen=True)
class Swing:
    """What a hand gets that swings the arm while the motors hold the torques of a constant force.

    Attributes:
        at: the ends of the ticks, s.
        counted: f dx so far, J.
        done: tau^T dq so far, J.
        path: the integral of v^2 so far, m^2/s.
    """

    at: Array
    counted: Array
    done: Array
    path: Array


def bends_most(arm: Linkage, pose: Array) -> tuple[Array, Array]:
    """The direction in which the tip's path bends most at a pose, and its bending, 1/m."""
    ways = np.stack([[np.cos(way), np.sin(way)] for way in np.linspace(0.0, np.pi, 721)])
    bendings = np.einsum("aij,ni,nj->na", arm.bending(pose), ways, ways)
    most = int(np.argmax(np.linalg.norm(bendings, axis=1)))
    return ways[most], bendings[most]


def swing(elbow: float) -> Swing:
    """A hand swings the tip around a pose, in the direction that bends most, against a force of FORCE."""
    arm, pose = linkage_of(ARM), np.array([0.3, elbow])
    along, bending = bends_most(arm, pose)
    force = -FORCE * bending / np.linalg.norm(bending)
    ticks = round(1.0 / (SWINGS * T))
    way = REACH * np.sin(2.0 * np.pi * np.arange(ticks + 1) / ticks)
    poses = [pose]
    for x in way[1:]:
        poses.append(arm.pose_at(arm.tip(pose) + x * along, poses[-1]))
    moved, turned = np.diff(way)[:, None] * along, np.diff(np.array(poses), axis=0)
    torques = [arm.jacobian(read).T @ force for read in poses[:-1]]
    times = round(SWINGS * SECONDS)
    counted, done, path = (
        np.cumsum(np.tile(each, times))
        for each in (moved @ force, np.sum(torques * turned, axis=1), np.sum(moved**2, axis=1) / T)
    )
    return Swing(T * np.arange(1, len(done) + 1, dtype=np.float64), counted, done, path)


def held() -> HeldTorque:
    """How the arm holds a force, with the kappa of its box."""
    return HeldTorque(greatest_bending(linkage_of(ARM)), FORCE, FAST)


def held_table() -> str:
    """Who got how much energy, in Markdown."""
    swings = [swing(elbow) for elbow in ELBOWS.values()]
    d = held().damping(T, 0.0, 0.0)
    rows = [
        ("counted at the ports, f·Δx", [of.counted for of in swings]),
        ("done by the motors, τᵀΔq", [of.done for of in swings]),
        (f"burned by {BURNS:g} N·s/m", [BURNS * of.path for of in swings]),
        ("given to the hand", [of.done - BURNS * of.path for of in swings]),
        (f"what the certificate sets aside: {d:.3f} N·s/m", [d * of.path for of in swings]),
    ]
    text = [f"| in {SECONDS:g} s, mJ | {' | '.join(f'elbow {name}' for name in ELBOWS)} |", "|---|---:|---:|"]
    for name, values in rows:
        text.append(f"| {name} | {' | '.join(f'{round(1e3 * value[-1])}' for value in values)} |")
    return "\n".join(text)


BOXES: Final = ((1.4, 1.8), (1.1, 2.1), (0.8, 2.4), (0.6, 2.68))
"""rad; ranges of the elbow, each wider than the one before."""


def boxes() -> str:
    """What the box of poses does to kappa, and to what is set aside for the page's session, in Markdown."""
    text = ["| elbow, rad | κ, 1/m | set aside at 10 N, N·s/m |", "|---|---:|---:|"]
    period, tau = TIMES[0]
    for low, high in BOXES:
        kappa = greatest_bending(linkage_of(ARM | {"low": [0.0, low], "high": [0.6, high]}))
        d = HeldTorque(kappa, 10.0, FAST).damping(period, tau, 0.0)
        text.append(f"| {low:g} to {high:g} | {kappa:.1f} | {d:.3f} |")
    return "\n".join(text)


def plot_held(file: Path) -> None:
    """The books of the swing, and what a certificate sets aside against the period."""
    figure, (left, right) = _panels()
    of, whole = swing(ELBOWS["folded"]), round(1.0 / (SWINGS * T))
    at, done, burned, counted = (
        series[whole - 1 :: whole] for series in (of.at, 1e3 * of.done, 1e3 * BURNS * of.path, 1e3 * of.counted)
    )
    left.plot(at, done, label="done by the motors, τᵀΔq")
    left.plot(at, burned, "--", label=f"burned by the device, {BURNS:g} N·s/m")
    left.plot(at, done - burned, label="given to the hand")
    left.plot(at, counted, color="0.5", label="counted at the ports, f·Δx")
    left.set(
        xlabel="time, s",
        ylabel="energy after whole swings, mJ",
        title=f"±{1e3 * REACH:g} mm at {SWINGS:g} Hz, T = 1 ms",
    )
    periods = np.geomspace(0.05e-3, 2e-3, 200)
    for tau, style in ((0.0, "-"), (0.2e-3, "--")):
        there = periods[periods >= tau]
        taken = [held().damping(period, tau, 0.0) for period in there]
        right.plot(1e3 * there, taken, style, label=f"set aside, delay {1e3 * tau:g} ms")
    right.axhline(BURNS, color="0.5", label=f"what the device burns, {BURNS:g} N·s/m")
    right.set(
        xlabel="period, ms", ylabel="d, N·s/m", title=f"what a certificate sets aside at {FORCE:g} N", ylim=(0, 0.3)
    )
    _save(figure, (left, right), file)


# --- (b) encoder steps

WALL: Final = 50e3  # N/m
RUNS, SHOWN = 4.0, 0.4  # s; of the run, and of its end that is shown
PRESSES: Final = ("0", "-0.0065*(1 - cos(pi*min(1, t/1.5)))")  # m


@dataclass(frozen=True)
class Rounded:
    """A hand that rests on a wall through an encoder with steps.

    Attributes:
        stiffness: of the coupling, N/m.
        damping: likewise, N*s/m.
        bound: w, N.
        added: what the steps add to the force in each tick, N.
    """

    stiffness: float
    damping: float
    bound: float
    added: Array


@functools.cache
def rounded(objective: str) -> Rounded:
    """Let a light hand press on the wall and rest; its device measures in steps of ENCODER."""
    links = [{"between": [f"pen.{axis}", "ground"], "stiffness": WALL} for axis in "xy"]
    tree = session_tree({"type": "network", "links": links}, objective)
    tree["devices"]["pen"]["step"] = ENCODER
    certificate = mh.certify(tree)
    claim, coupling = certificate.encoder, certificate.spring_damper
    assert claim is not None  # noqa: S101
    assert claim.force is not None  # noqa: S101
    assert coupling is not None  # noqa: S101
    loop = certificate.loop
    Y = closed(loop.partition.join(certificate.blocks), loop.environment.environment(T))
    driver, state, wrong = device(LIGHT, PRESSES), np.zeros(Y.order), []
    period, late = from_seconds(T), from_seconds(DELAY)
    for k in range(round(RUNS / T)):
        x = np.array(driver.sample(k, Instant(k * period)))
        seen = np.array(measured(x.tolist(), ENCODER))
        force, state = Y.C @ state + Y.D @ seen, Y.A @ state + Y.B @ seen
        driver.apply((-force).tolist(), Instant(k * period + late))
        wrong.append(seen - x)
    added = -Y.simulate(np.array(wrong))[:, 1]
    return Rounded(coupling.stiffness[1, 1], coupling.damping[1, 1], claim.force[1], added)


def steps_table() -> str:
    """Bound and measurement, in Markdown."""
    text = ["| coupling | K, N/m | B, N·s/m | w, mN | the most that was added, mN |", "|---|---:|---:|---:|---:|"]
    for objective in ("feasible", "stiffest"):
        of = rounded(objective)
        most = float(np.abs(of.added).max())
        text.append(
            f"| {objective} | {of.stiffness:.0f} | {of.damping:.3f} | {1e3 * of.bound:.1f} | {1e3 * most:.1f} |"
        )
    return "\n".join(text)


def plot_steps(file: Path) -> None:
    """What the steps add while a light hand rests, within its bound."""
    figure, panels = _panels(sharey=True)
    for panel, objective in zip(panels, ("feasible", "stiffest"), strict=True):
        of = rounded(objective)
        shown = round(SHOWN / T)
        panel.axhspan(-1e3 * of.bound, 1e3 * of.bound, color="C0", alpha=0.15, label="±w of the certificate")
        panel.step(1e3 * T * np.arange(shown), 1e3 * of.added[-shown:], where="post", linewidth=1.0, label="added")
        panel.set(xlabel="time, ms", title=f"{objective}, {of.stiffness:.0f} N/m")
    panels[0].set_ylabel("force that the steps add, mN")
    _save(figure, panels, file)


# --- (c) dry friction

FRICTIONS: Final = (0.025, 0.05, 0.1)  # N
SPEEDS: Final = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # m/s


def below(friction: float, speed: float) -> Found | None:
    """The page's session with another friction, below another speed."""
    return designed({"devices.arm.friction.least": friction, "design.speed": speed})


def friction_table() -> str:
    """K by c and v*, in Markdown."""
    text = [
        f"| K, N/m, below v* | {' | '.join(f'{speed:g} m/s' for speed in SPEEDS)} | every speed |",
        "|---|" + "---:|" * (len(SPEEDS) + 1),
    ]
    for c in FRICTIONS:
        found = [_newtons(below(c, speed)) for speed in SPEEDS]
        text.append(f"| c = {c:g} N | {' | '.join(found)} | {_newtons(designed({}))} |")
    return "\n".join(text)


def plot_friction(file: Path) -> None:
    """K against v*."""
    figure, (panel,) = _panels(1)
    for c in FRICTIONS:
        found = [below(c, speed) for speed in SPEEDS]
        panel.loglog(SPEEDS, [np.nan if one is None else one.stiffness for one in found], "o-", label=f"c = {c:g} N")
    every = designed({})
    if every is not None:
        panel.axhline(every.stiffness, color="0.5", label="at every speed")
    panel.set_xticks(SPEEDS, [f"{speed:g}" for speed in SPEEDS])
    panel.minorticks_off()
    panel.set_yticks([50, 100, 200, 500, 1000, 2000, 5000], ["50", "100", "200", "500", "1000", "2000", "5000"])
    panel.set(xlabel="v*, m/s", ylabel="certified K, N/m", title="1 kHz, delay 0.2 ms, 0.1 N·s/m, torques held")
    _save(figure, (panel,), file)


# --- pictures and the page


def _panels(number: int = 2, sharey: bool = False) -> tuple[Any, Sequence[Axes]]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        1, number, figsize=(5.0 * number + 1.0 * (number == 1), 4.0), sharey=sharey, layout="constrained", squeeze=False
    )
    return figure, list(axes[0])


def _save(figure: Any, panels: Sequence[Axes], file: Path) -> None:
    from matplotlib import pyplot

    for panel in panels:
        panel.grid(color="0.9")
        panel.legend(fontsize=8)
    figure.savefig(file, dpi=110)
    pyplot.close(figure)


TABLES: Final = {
    "held": held_table,
    "boxes": boxes,
    "steps": steps_table,
    "friction": friction_table,
    "devices": devices,
    "examples": examples,
    "options": options,
    "helps": helps,
}
PICTURES: Final = {"held-torques": plot_held, "encoder-steps": plot_steps, "dry-friction": plot_friction}


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the tables and pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, metavar="FOLDER")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="a page with marks: docs/mechanisms.md")
    asked = parser.parse_args(arguments)
    for mark, table in TABLES.items():
        tell(f"table {mark}")
        said = table()
        sys.stdout.write(said + "\n\n")
        if asked.markdown:
            fill(asked.markdown, mark, said)
    if asked.images:
        asked.images.mkdir(parents=True, exist_ok=True)
        for name, plot in PICTURES.items():
            tell(f"picture {name}")
            plot(asked.images / f"{name}.png")


if __name__ == "__main__":
    main()
