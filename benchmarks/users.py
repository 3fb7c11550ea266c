"""The number of users that one environment's process serves at 1 kHz, and the use of its time.

    python benchmarks/users.py [--users 1 2 4 ...] [--seconds S] [--json FILE] [--plot FILE] [--markdown FILE]
    python benchmarks/users.py --profile         # and py-spy at the largest number that holds

The environment is the real process with its real bundle; one other process plays all the couplings, with real
handshakes and real frames. A tick is late when the last reaction has not come before the next is due; a number of users
holds while at most 1 % are. Each number is tried a few times, and the median counts; two in a row that do not hold
end the curve.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import proc
from loop_middleware import PEERS_VENV
from page import add_outputs, fill, make_folders, tell
from users_curve import HOLDS, curve, headline, verdict
from users_load import Point, measure

NUMBERS = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64)
TARGET = 32
PROFILE_RATE = 500  # samples a second
SHOWN = 14  # functions of a profile
MARK, PROFILE_MARK = "users", "profile"


class NoProfile(Exception):
    """There is no profile; the text gives the reason."""


def described(point: Point) -> str:
    """What a number of users gave, as progress."""
    return (
        f": late {point.late:.2%}, round trip {point.round_trip_us['p50']:.0f} us, "
        f"environment {point.environment_cpu:.2f}, generator {point.generator_cpu:.2f} processors"
    )


def profile(users: int, seconds: float, attempts: int = 3) -> dict[str, Any]:
    """Self time by function of the environment, in shares of the time it was busy.

    py-spy now and then finds a process in the middle of something, and gives up: then it is tried again.

    Raises:
        NoProfile: py-spy is not there, or may not look.
    """
    program = shutil.which("py-spy") or shutil.which("py-spy", path=str(PEERS_VENV / "bin"))
    if program is None:
        raise NoProfile(f"found no py-spy; expected it on the path or in {PEERS_VENV}; install it there with pip")
    with tempfile.TemporaryDirectory() as temporary:
        stacks = Path(temporary) / "stacks"
        started: list[subprocess.Popen[str]] = []

        def look(pid: int) -> None:
            command = [program, "record", "--pid", str(pid), "--format", "raw", "--output", str(stacks),
                       "--rate", str(PROFILE_RATE), "--duration", str(max(1, int(seconds))), "--nolineno"]  # fmt: skip
            started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True))  # noqa: S603

        point = measure(users, seconds + 1.0, look)
        (spy,) = started
        said, _ = spy.communicate()
        if spy.returncode and attempts > 1:
            return profile(users, seconds, attempts - 1)
        if spy.returncode or not stacks.exists():
            raise NoProfile(f"py-spy ended with {spy.returncode}: {said.strip()[:300]}")
        own: dict[str, int] = {}
        for line in stacks.read_text().splitlines():
            stack, _, count = line.rpartition(" ")
            if "loop (" in stack:  # not its start and its end
                leaf = stack.rsplit(";", 1)[-1]
                own[leaf] = own.get(leaf, 0) + int(count)
    total = sum(own.values())
    if total == 0:
        raise NoProfile(f"py-spy saw nothing of the loop: {said.strip()[:300]}")
    ordered = sorted(own.items(), key=lambda item: -item[1])
    return {
        "users": users,
        "late": point.late,
        "samples": total,
        "command": f"py-spy record --format raw --nolineno --rate {PROFILE_RATE} --duration {seconds:g}",
        "self": {name: count / total for name, count in ordered},
    }


def table(content: Mapping[str, Any]) -> str:
    """The curve."""
    lines = [
        headline(content),
        "",
        "| users | late | round trip, us: median | p99 | p99.9 | environment, processors | generator | memory, MiB |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for point in (Point(**one) for one in content["points"]):
        trip = point.round_trip_us
        lines.append(
            f"| {point.users} | {point.late:.2%} | {trip['p50']:.0f} | {trip['p99']:.0f} | {trip['p999']:.0f} "
            f"| {point.environment_cpu:.2f} | {point.generator_cpu:.2f} | {point.resident:.0f} |"
        )
    lines += ["", verdict(_most(content["points"]), TARGET).capitalize()]
    return "\n".join(lines)


def profile_table(found: Mapping[str, Any]) -> str:
    """Where the time goes."""
    lines = [
        f"{found['users']} users, {found['late']:.1%} late while it was looked at, {found['samples']} samples of the "
        f"busy loop; `{found['command']}`.",
        "",
        "| function | self time |",
        "|---|---:|",
    ]
    shown = list(found["self"].items())
    lines += [f"| `{name}` | {share:.1%} |" for name, share in shown[:SHOWN]]
    if rest := sum(share for _, share in shown[SHOWN:]):
        lines.append(f"| {len(shown) - SHOWN} others | {rest:.1%} |")
    return "\n".join(lines)


def _most(points: Sequence[Mapping[str, Any]]) -> int:
    """The greatest number of users that holds; 0 if none does."""
    return max((point["users"] for point in points if point["late"] <= HOLDS), default=0)


def plot(content: Mapping[str, Any], path: Path) -> None:
    """Round trips and processors used against the number of users."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    points = [Point(**one) for one in content["points"]]
    users = [point.users for point in points]
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7.0, 5.6), layout="constrained")
    styles = {"p50": ("#0072B2", "o", "median"), "p99": ("#E69F00", "s", "p99"), "p999": ("#D55E00", "^", "p99.9")}
    for name, (colour, marker, label) in styles.items():
        above.plot(users, [p.round_trip_us[name] for p in points], color=colour, marker=marker, label=label)
    above.axhline(1000.0, color="0.3", linestyle="--", linewidth=1.0, label="the period")
    above.set(yscale="log", ylabel="round trip, us")
    below.plot(users, [p.environment_cpu for p in points], color="#0072B2", marker="o", label="environment")
    below.plot(users, [p.generator_cpu for p in points], color="0.5", marker="s", label="generator")
    below.set(xscale="log", xlabel="users", ylabel="processors used", ylim=(0.0, None))
    below.set_xticks(users, [str(one) for one in users])
    below.minorticks_off()
    for axes in (above, below):
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> None:
    """Measure, print tables, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--users", type=int, nargs="+", default=list(NUMBERS))
    parser.add_argument("--seconds", type=float, default=10.0, help="of each run (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--profile", action="store_true", help="with py-spy, at the largest number that holds")
    add_outputs(parser)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what it has started is ended, too
    if min(arguments.users) < 1 or arguments.seconds <= 0.0 or arguments.repeats < 1:
        parser.error("expected at least one user and one repeat, and more than 0 seconds")
    make_folders(arguments.json, arguments.plot)
    content: dict[str, Any] = {
        "machine": proc.machine(),
        "seconds": arguments.seconds,
        "repeats": arguments.repeats,
        "points": [
            asdict(point)
            for point in curve(
                sorted(arguments.users),
                arguments.repeats,
                lambda users: measure(users, arguments.seconds),
                described,
            )
        ],
    }
    text = table(content)
    print(text)
    if arguments.markdown is not None:
        fill(arguments.markdown, MARK, text)
    if arguments.profile:
        try:
            content["profile"] = profile(_most(content["points"]) or min(arguments.users), arguments.seconds)
        except NoProfile as error:
            tell(f"no profile: {error}")
        else:
            print("\n" + profile_table(content["profile"]))
            if arguments.markdown is not None:
                fill(arguments.markdown, PROFILE_MARK, profile_table(content["profile"]))
    if arguments.plot is not None and content["points"]:
        plot(content, arguments.plot)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
