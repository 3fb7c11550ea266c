"""The bound on a proof's work: it is known before the proof begins, and honest files are within it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import read_plain
from manyhands.design.proof import ProofInputError, cost, prove
from manyhands.design.proof.claim import read
from manyhands.design.proof.work import MOST, parts_of

from ...attack.heavy import STYLES, Style, certificate, judged, random_file, rationals, state_space
from ...support.cases import cases

SHIPPED = sorted((Path(__file__).parents[1] / "data" / "certificates-0.6.0").iterdir())
SECONDS = 10.0


def bound(data: dict[str, Any]) -> float:
    return sum(part.operations for part in parts_of(read(data)))


def outcome(data: dict[str, Any]) -> str:
    """Why a certificate is refused before its proof begins; empty where it is proved, or not."""
    try:
        prove(data)
    except ProofInputError as error:
        return str(error)
    return ""


def style(name: str, seed: int = 1) -> Style:
    return Style(np.random.default_rng(seed), STYLES[name])


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_sessions_are_far_within_it(path: Path) -> None:
    assert bound(dict(read_plain(path))) < MOST / 10.0


def test_states_with_numbers_of_any_size_end_or_are_refused_at_once() -> None:
    """60 of them took 43 s, and 120 more than a minute: in 0.1 and 0.4 MB."""
    for n, words in ((60, ""), (120, "environment.A: found 120 states with numbers of up to ")):
        data = state_space(style("from 1e-300 to 1e300"), n, 1)
        assert len(json.dumps(data)) < 1_000_000
        begin = time.process_time()
        found = outcome(data)
        assert time.process_time() - begin < SECONDS
        assert found.startswith(words)
        assert ("the proof may take more than" in found) == (n == 120)


def test_many_ports_in_one_block_are_refused_at_once() -> None:
    """400 of them took 62 s; 300 are in 0.9 MB."""
    level = [[2 * (i == j) for j in range(300)] for i in range(300)]
    data = certificate(style("one digit"), 300, 300, {"type": "declared", "level": level}, "enforced")
    for key in ("Delta_D", "Delta_V"):
        data["levels"][key]["c0"] = [[5000 * (i == j) + 1 for j in range(300)] for i in range(300)]
    with pytest.raises(
        ProofInputError, match=r"found 300 ports with numbers of up to .* bits: the proof may take more"
    ):
        prove(data)


def test_a_singular_matrix_of_long_numbers_ends() -> None:
    """Forty ports of rational functions: exactly decided, their static stiffness took 42 s."""
    data = rationals(style("whole numbers of 1000 bits"), 24, 0)
    begin = time.process_time()
    outcome(data)
    assert time.process_time() - begin < SECONDS


def test_texts_that_nothing_is_proved_of_allow_nothing() -> None:
    data = state_space(style("from 1e-300 to 1e300"), 120, 1)
    data["method"] = {f"m{i}": "x" * 90_000 for i in range(40)}
    with pytest.raises(ProofInputError, match="expected at most 2e"):
        prove(data)


def test_it_grows_with_everything_that_counts() -> None:
    assert cost.charpoly(8, 1e4) > cost.charpoly(8, 1e3) > cost.charpoly(4, 1e3)
    assert cost.solution(60, 1, 2e3) > 10.0 * cost.solution(60, 1, 2e2)
    assert cost.in_balls(400) > cost.in_balls(300)
    assert cost.definiteness(64, 1e6) <= cost.MOST_EXACT + cost.in_balls(64)


def test_hostile_files_end_or_are_refused(tmp_path: Path) -> None:
    """At random from every shape; ``python -m tests.attack.heavy`` searches for more."""
    rng = np.random.default_rng(7)
    for _ in range(cases(10, 100)):
        found = judged(*random_file(rng), tmp_path)
        assert found.seconds < SECONDS, found
