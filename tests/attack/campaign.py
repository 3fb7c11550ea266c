"""The attack as a program: `python -m tests.attack.campaign --claims 100000`. One table; exit 1 if there is a finding.

A claim is a certificate, or a ladder, that `prove` accepts: as designed, or forged. The oracle holds each against its
own mathematics; what it contradicts in floats is a suspect, and a finding when long numbers or rationals agree.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")  # matrices of ten rows: threads only wait for each other

import numpy as np  # noqa: E402

from manyhands.design.errors import CertificateError  # noqa: E402
from manyhands.design.proof import ProofInputError, prove  # noqa: E402
from manyhands.design.proof.ladder import prove_ladder  # noqa: E402
from tests.attack.forgeries import CHANGES, applies, forged, forged_rung  # noqa: E402
from tests.attack.oracle import Judgement, judge, judge_ladder  # noqa: E402
from tests.attack.sessions import KINDS, ladder  # noqa: E402

Data = dict[str, Any]
FORGERIES = 150  # of each designed certificate: designing takes as long as forging, proving and judging ten
LADDERS = 40


@dataclass
class Count:
    """A row of the table."""

    refused: int = 0
    claims: int = 0
    loops: int = 0
    suspects: int = 0
    findings: int = 0
    growth: float = 0.0
    seconds: float = 0.0


@dataclass
class Tally:
    """What a part of the campaign has seen.

    Attributes:
        rows: by class.
        found: every finding: its class, what is contradicted, and the certificates.
    """

    rows: dict[str, Count] = field(default_factory=lambda: defaultdict(Count))
    found: list[tuple[str, list[str], list[Data]]] = field(default_factory=list)

    @property
    def claims(self) -> int:
        """Of all classes."""
        return sum(row.claims for row in self.rows.values())

    def add(self, kind: str, began: float, judgement: Judgement | None, data: list[Data]) -> None:
        """One certificate, refused where there is no judgement."""
        row = self.rows[kind]
        row.seconds += time.process_time() - began
        if judgement is None:
            row.refused += 1
            return
        row.claims += 1
        row.loops += judgement.loops
        row.suspects += bool(judgement.suspects)
        row.findings += bool(judgement.findings)
        row.growth = max(row.growth, judgement.growth)
        if judgement.findings:
            self.found.append((kind, judgement.findings, data))

    def join(self, other: Tally) -> None:
        """Add what another part has seen."""
        for kind, row in other.rows.items():
            own = self.rows[kind]
            for key, value in vars(row).items():
                setattr(own, key, max(own.growth, value) if key == "growth" else getattr(own, key) + value)
        self.found += other.found


def accepted(data: Data) -> bool:
    """Whether every finding of the proof holds."""
    try:
        return all(finding.holds for finding in prove(data))
    except (ProofInputError, CertificateError):
        return False


def session(seed: int, kinds: list[str], forgeries: int = FORGERIES) -> Tally:
    """One designed certificate and its forgeries, or one ladder and its."""
    rng, out = np.random.default_rng(seed), Tally()
    kind = kinds[seed % len(kinds)]
    if kind == "ladder":
        return ladders(rng, out, max(forgeries * LADDERS // FORGERIES, 4))
    began = time.process_time()
    data = KINDS[kind](rng)
    if data is None:
        out.add(kind, began, None, [])
        return out
    out.add(kind, began, judge(data, rng, 6, 20), [data])
    changes = [change for change in CHANGES if applies(change, data)]
    for number in range(forgeries):
        began, change = time.process_time(), changes[number % len(changes)]
        other = forged(rng, data, change)
        if other is None or not accepted(other):
            out.add(f"forged: {change}", began, None, [])
            continue
        judgement = judge(other, rng, 2, 8 if rng.random() < 0.1 else 0)
        out.add(f"forged: {change}", began, judgement, [other])
    return out


def ladders(rng: np.random.Generator, out: Tally, forgeries: int) -> Tally:
    """A ladder and forged ones, each proved rung by rung and together."""
    began = time.process_time()
    rungs = ladder(rng)
    if rungs is None:
        out.add("ladder", began, None, [])
        return out
    for number in range(1 + forgeries):
        began = time.process_time()
        here, kind = rungs, "forged: ladder" if number else "ladder"
        if number:
            here = [forged_rung(rng, rung) for rung in rungs]
        if not all(accepted(rung) for rung in here):
            out.add(kind, began, None, [])
            continue
        common = int(rng.integers(len(here)))
        proof = prove_ladder(here, common)
        if not (proof.one_loop.holds and proof.together.holds):
            out.add(kind, began, None, [])
            continue
        out.add(kind, began, judge_ladder(here, common, proof.independent.holds, rng), here)
    return out


def attack(
    claims: int,
    seed: int,
    processes: int,
    seconds: float,
    kinds: list[str],
    progress: Callable[[Tally, float], None],
) -> Tally:
    """Sessions one after the other until so many claims are counted, or the time is over."""
    whole, began = Tally(), time.monotonic()
    for part in _parts(seed, processes, kinds):
        whole.join(part)
        took = time.monotonic() - began
        progress(whole, took)
        if whole.claims >= claims or took > seconds:
            break
    return whole


def _parts(seed: int, processes: int, kinds: list[str]) -> Iterator[Tally]:
    seeds = (seed * 10_000_000 + number for number in range(10_000_000))
    if processes == 1:
        yield from (session(one, kinds) for one in seeds)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        while True:
            batch = [(next(seeds), kinds) for _ in range(8 * processes)]
            yield from pool.starmap(session, batch, chunksize=4)


def table(tally: Tally, took: float) -> str:
    """The campaign's table; the last row is the sum."""
    head = f"{'class':28}{'refused':>9}{'claims':>9}{'loops':>10}{'suspects':>10}{'findings':>10}"
    head += f"{'growth':>11}{'CPU s':>9}"
    total, lines = Count(), [head, "-" * len(head)]
    for kind, row in sorted(tally.rows.items(), key=lambda item: (item[0].startswith("forged"), item[0])):
        lines.append(_line(kind, row))
        for key, value in vars(row).items():
            setattr(total, key, max(total.growth, value) if key == "growth" else getattr(total, key) + value)
    return "\n".join([*lines, "-" * len(head), _line("all", total), f"{took:.0f} s"])


def _line(kind: str, row: Count) -> str:
    counts = f"{row.refused:9}{row.claims:9}{row.loops:10}{row.suspects:10}{row.findings:10}"
    return f"{kind:28}{counts}{row.growth:11.3g}{row.seconds:9.0f}"


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--claims", type=int, default=100_000, help="after which it ends")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which it ends, however many claims")
    parser.add_argument("--kind", choices=[*KINDS, "ladder"], action="append", help="only sessions of this kind")
    parser.add_argument("--findings", type=Path, help="write the certificates of all findings here, a JSON line each")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    kinds, shown, written = given.kind or [*KINDS, "ladder"], 0.0, 0
    file = None if given.findings is None else given.findings.open("w", encoding="utf-8")

    def progress(tally: Tally, took: float) -> None:
        nonlocal shown, written
        for kind, findings, certificates in tally.found[written:] if file is not None else ():
            file.write(json.dumps({"class": kind, "findings": findings, "certificates": certificates}) + "\n")
            file.flush()
        written = len(tally.found)
        if took - shown >= 10.0:
            shown = took
            print(  # noqa: T201 -- what a campaign is for
                f"{took:6.0f} s: {tally.claims} claims, {len(tally.found)} findings", file=sys.stderr, flush=True
            )

    began = time.monotonic()
    tally = attack(given.claims, given.seed, given.processes, given.seconds, kinds, progress)
    print(table(tally, time.monotonic() - began))  # noqa: T201
    summary: dict[tuple[str, str], int] = defaultdict(int)
    for kind, findings, _ in tally.found:
        for what in {finding.split(", ")[0] for finding in findings}:
            summary[kind, what] += 1
    for (kind, what), count in sorted(summary.items(), key=lambda item: -item[1]):
        print(f"found {count} times: {kind}: {what}")  # noqa: T201
    if file is not None:
        file.close()
    return 1 if tally.found else 0


if __name__ == "__main__":
    sys.exit(main())
