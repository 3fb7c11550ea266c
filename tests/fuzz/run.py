"""Runs all harnesses under atheris for a given time and reports the results.

    python tests/fuzz/run.py SECONDS [--only HARNESS ...] [--jobs N] [--merge] [--work FOLDER]

SECONDS is the time that the whole takes; the harnesses share it, two at a time. What a run finds worth keeping stays in
the working folder, where the next run goes on from it; ``--merge`` takes as little of it into the corpus as covers
the same. Ends with 1 if a harness failed; the input that made it fail is named.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import seeds

FOLDER: Final = Path(__file__).resolve().parent
CORPUS: Final = FOLDER / "corpus"
LONGEST: Final = {"codec": 8192, "handshake": 1024, "gate": 1024, "path": 1024, "conductor": 1024, "board": 1024}
"""The longest input of each harness, bytes."""

MOST_FILES, MOST_BYTES = 20, 40 * 1024
"""How much a merge takes into the corpus of one harness."""

KEPT: Final = "found-"
"""How the names begin of what once made a harness fail: a merge leaves them."""

FOUND: Final = ("crash-", "oom-", "timeout-")
_STATUS: Final = re.compile(r"^#(\d+)\s+\w+\s+cov: (\d+) ft: (\d+) corp: (\d+)", re.MULTILINE)
_PEAK: Final = re.compile(r"^stat::peak_rss_mb:\s+(\d+)", re.MULTILINE)


@dataclass(frozen=True)
class Ran:
    """What came of one harness.

    Attributes:
        harness: its name.
        executions: how many inputs were tried.
        seconds: how long it took, s.
        edges: branches of the watched code that were reached.
        features: the same, told apart by how often.
        kept: inputs in its corpus at the end.
        new: those of them that were not there before.
        peak: most memory held, MiB.
        findings: the inputs that made it fail.
    """

    harness: str
    executions: int
    seconds: int
    edges: int
    features: int
    kept: int
    new: int
    peak: int
    findings: tuple[Path, ...]


def run(harness: str, seconds: int, work: Path) -> Ran:
    """Fuzz with one harness."""
    kept, found, by_hand = (work / harness / name for name in ("corpus", "found", "seeds"))
    seeds.write(harness, by_hand)
    for folder in (kept, found, CORPUS / harness):
        folder.mkdir(parents=True, exist_ok=True)
    before = set(kept.iterdir())
    log = work / harness / "log"
    began = time.monotonic()
    code = _atheris(
        harness, log, str(kept), str(CORPUS / harness), str(by_hand), f"-max_total_time={seconds}",
        f"-max_len={LONGEST[harness]}", f"-artifact_prefix={found}/", "-timeout=20", "-rss_limit_mb=1024",
        "-print_final_stats=1",
    )  # fmt: skip
    told = log.read_text(encoding="utf-8", errors="replace")
    executions, edges, features, corpus = map(int, (_STATUS.findall(told) or [(0, 0, 0, 0)])[-1])
    findings = tuple(sorted(path for path in found.iterdir() if path.name.startswith(FOUND)))
    if code and not findings:
        raise SystemExit(f"{harness}: found exit code {code} and no input that made it fail; see {log}")
    return Ran(harness, executions, round(time.monotonic() - began), edges, features, corpus,
               len(set(kept.iterdir()) - before), int((_PEAK.findall(told) or [0])[-1]), findings)  # fmt: skip


def merge(harness: str, work: Path) -> int:
    """Take into the corpus what covers more than the hand-made seeds do; returns how many files those are.

    What an earlier run took is reconsidered, so that the corpus does not grow from run to run.
    """
    home, kept = CORPUS / harness, work / harness / "corpus"
    home.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        base, pool = Path(folder) / "base", Path(folder) / "pool"
        pool.mkdir()
        seeds.write(harness, base)
        for path in (*home.iterdir(), *kept.iterdir()):
            shutil.copy(path, base if path.name.startswith(KEPT) else pool)
        stay = {path.name for path in base.iterdir()}
        if code := _atheris(
            harness, work / harness / "log-merge", "-merge=1", "-set_cover_merge=1", str(base), str(pool)
        ):
            raise SystemExit(f"{harness}: found exit code {code} of the merge; see {work / harness / 'log-merge'}")
        taken = sorted((path for path in base.iterdir() if path.name not in stay), key=lambda path: path.stat().st_size)
        for path in home.iterdir():
            if not path.name.startswith(KEPT):
                path.unlink()
        count = size = 0
        for path in taken[:MOST_FILES]:
            data = path.read_bytes()
            size += len(data)
            if size > MOST_BYTES:
                break
            (home / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
            count += 1
    return count


def _atheris(harness: str, log: Path, *arguments: str) -> int:
    """One process of the fuzzer; its exit code."""
    command = [sys.executable, str(FOLDER / "under_atheris.py"), harness, *arguments]
    with log.open("wb") as output:
        return subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=False).returncode


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seconds", type=int, help="time for all harnesses together, s")
    parser.add_argument("--only", nargs="+", choices=LONGEST, default=list(LONGEST), metavar="HARNESS")
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=2, help="harnesses that run at the same time")
    parser.add_argument("--merge", action="store_true", help="take into the corpus what was found worth keeping")
    parser.add_argument("--work", type=Path, default=FOLDER.parents[1] / "out" / "fuzz", help="working folder")
    asked = parser.parse_args()
    each = max(1, asked.seconds * min(asked.jobs, len(asked.only)) // len(asked.only))
    with ThreadPoolExecutor(asked.jobs) as pool:
        ran = list(pool.map(lambda harness: run(harness, each, asked.work), asked.only))
    say = sys.stdout.write
    heads = ("harness", "executions", "s", "edges", "features", "corpus", "new", "peak MiB")
    rows = [
        (one.harness, one.executions, one.seconds, one.edges, one.features, one.kept, one.new, one.peak) for one in ran
    ]
    for first, *rest in (heads, *rows):
        say(f"{first:12}{''.join(f'{cell:>12}' for cell in rest)}\n")
    findings = [path for one in ran for path in one.findings]
    for path in findings:
        say(f"FAILED on {path}: {path.read_bytes()[:200].hex()}; see {path.parents[1] / 'log'}\n")
    if asked.merge and not findings:
        for harness in asked.only:
            say(f"{harness}: {merge(harness, asked.work)} files taken into the corpus\n")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
