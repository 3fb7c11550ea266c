"""Both ends of a wave link across a WAN, and how old the newest wave is at either; run by itself it prints a table.

python -m tests.support.path_ends SECONDS
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manyhands.protocol.keys import new_pair
from tests.support.wan import SIDES, Wan, Wire, open_wan

ROOT = Path(__file__).parents[2]


def run_ends(one: Wan, seconds: float, version: Literal[4, 6] = 4) -> dict[str, dict[str, Any]]:
    """Run both ends, with datagrams of this version of IP; what either says in the end, by its side."""
    pairs = {side: new_pair() for side in SIDES}
    keys = {side: {"public": pair.public, "secret": pair.secret} for side, pair in pairs.items()}
    hosts = {"link": one.address("near"), "datagrams": one.address("near", version)}
    first = json.dumps({**keys, **hosts}) + "\n"
    processes = {
        side: subprocess.Popen(
            [*one.within(side), sys.executable, "-m", "tests.support.path_end", side, str(seconds)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )
        for side in SIDES
    }  # fmt: skip
    near, far = processes["near"], processes["far"]
    try:
        assert near.stdin is not None
        assert near.stdout is not None
        near.stdin.write(first)
        near.stdin.flush()
        where = near.stdout.readline()
        said = {"far": far.communicate(first + where, timeout=60), "near": near.communicate(timeout=60)}
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()
    for side, (_, errors) in said.items():
        assert not errors, f"{side}: {errors}"
    return {side: json.loads(output.splitlines()[-1]) for side, (output, _) in said.items()}


def main() -> None:
    """Print the age of the newest wave, ms, for three rates of loss, with datagrams and where none passes."""
    seconds = float(sys.argv[1])
    sys.stdout.write("| loss | datagrams: age p50/p99/max, ms | ZeroMQ over TCP |\n|---|---|---|\n")
    for loss in (0.0, 0.01, 0.05):
        cells = []
        for udp in (True, False):
            with open_wan(Wire(delay=0.04, jitter=0.01, loss=loss, udp=udp)) as one:
                ends = run_ends(one, seconds)
            ages = np.concatenate([np.array(end["ages"][1500:]) for end in ends.values()]) / 1e6
            cells.append("/".join(f"{age:.0f}" for age in np.percentile(ages, (50, 99, 100))))
        sys.stdout.write(f"| {loss:.0%} | {cells[0]} | {cells[1]} |\n")


if __name__ == "__main__":
    main()
