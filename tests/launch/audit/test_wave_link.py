"""An audit computes both ends of a wave link again, and finds a forged wave, tank, force or position."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.audit import Audit, audit
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.replay import replay
from manyhands.launch.audit.simulation import Silence
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import read_run
from manyhands.launch.session import load_session

from ...support.simulated_recordings import SESSIONS, attachments_of, forged, recorded_of, simulated, written

TICKS, AT = 330, 217
LINKED = tuple(
    f"couplings.{name}.wave_link={{b: 20, depth: 2, tank: 0.02, harvest: {harvest}}}"
    for name, harvest in (("cx", 0.1), ("cy", 0))
)
L, G, H = range(3)

Rows = dict[tuple[str, str], np.ndarray]
Change = Callable[[Rows], None]


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    """Example 1 with two users behind wave links, and the third in the tick."""
    return prepare(load_session(SESSIONS / "example1.yaml", [*LINKED, "design.ladder=[]"]))


@pytest.fixture(scope="module")
def recording(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    return written(path, recorded_of(prepared), attachments_of(prepared), simulated(prepared, TICKS))


def audited(path: Path) -> Audit:
    return audit(path, read_run(path), lambda text: None, lambda tick: None)


def broken(done: Audit) -> dict[tuple[str, str], int]:
    """By party and name of the checks that do not hold, the first tick that differs."""
    return {(check.party, check.name): -1 if check.first is None else check.first.tick for check in done.broken}


def test_an_honest_recording_holds_to_the_last_bit(recording: Path) -> None:
    done = audited(recording)
    assert broken(done) == {}
    of_link = [check for check in done.checks if check.name in ("wave", "tank", "rules", "heard", "link")]
    assert len(of_link) == 2 * 9
    for check in done.checks:
        assert check.verdict is CheckVerdict.HOLDS, check
        exact = check.name not in ("tank", "rules", "link", "work", "bound", "agreement")
        assert not exact or check.tolerance == 0.0, check
    for check in of_link:
        least = {"rules": 2 * TICKS, "heard": TICKS // 2}.get(check.name, TICKS - 2)
        assert check.numbers >= least, check
        assert check.tolerance < 1e-9, check


def test_the_environment_follows_from_the_faces_of_the_links(recording: Path) -> None:
    """Not from p of the couplings, which is that of another time."""
    done = audited(recording)
    for name in ("tools", "masses", "forces", "ledger"):
        (check,) = [check for check in done.checks if (check.party, check.name) == ("environment", name)]
        assert (check.verdict, check.tolerance, check.gaps) == (CheckVerdict.HOLDS, 0.0, ())
        assert check.numbers % TICKS == 0


def one(node: str, trace: str, by: float, column: int = 0) -> Change:
    def change(rows: Rows) -> None:
        rows[node, trace][AT, column] += by

    return change


def from_there_on(node: str, trace: str, by: float, column: int) -> Change:
    def change(rows: Rows) -> None:
        rows[node, trace][AT:, column] += by

    return change


def hidden_supply(rows: Rows) -> None:
    """The world gave 1 J more than it took, and states a tank that pays for it."""
    rows["environment", "tank"][AT:, L] += 1.0
    rows["environment", "tank"][AT:, H] += 1.0


FORGED: Mapping[str, tuple[Change, dict[tuple[str, str], int]]] = {
    "a wave at the user's end": (one("cx", "c", 1e-9), {("cx", "wave"): AT, ("cx", "tank"): AT}),
    "a wave at the world's end": (
        one("environment", "c", 1e-9, 1),
        {("environment", "wave"): AT, ("environment", "tank"): AT},
    ),
    "a user's tank in one tick": (one("cy", "tank", 1e-9, L), {("cy", "tank"): AT}),
    "a world's tank in one tick": (one("environment", "tank", 1e-9, 3 + L), {("environment", "tank"): AT}),
    "a user's tank for good": (from_there_on("cx", "tank", 1e-9, L), {("cx", "tank"): AT}),
    "an empty tank": (one("cx", "tank", -1.0, L), {("cx", "tank"): AT, ("cx", "rules"): AT}),
    "energy that was never shipped": (
        from_there_on("cx", "tank", 1e-7, H),
        {("cx", "tank"): AT, ("cx", "heard"): AT},
    ),
    "energy that was never shipped, with the tank that it makes": (hidden_supply, {("environment", "heard"): AT}),
    "energy that is shipped and never left": (
        from_there_on("environment", "tank", 1e-7, G),
        {("environment", "tank"): AT, ("cx", "heard"): AT + 1},
    ),
    "a position at the world's end": (
        one("environment", "p", 1e-12),
        {
            ("environment", "tools"): AT,
            ("environment", "wave"): AT,
        },
    ),
    "a force at the world's end": (
        one("environment", "f_v", 1e-9),
        {("environment", "forces"): AT, ("environment", "wave"): AT + 1},
    ),
    "the force that a linked user's coupling handed on": (
        one("cx", "f_v", 1e-9),
        {("cx", "agreement"): AT, ("cx", "wave"): AT, ("cx", "signal"): AT + 1},
    ),
}


@pytest.mark.parametrize("what", FORGED)
def test_a_changed_number_is_found_at_its_tick(what: str, recording: Path, tmp_path: Path) -> None:
    change, expected = FORGED[what]
    done = audited(forged(tmp_path / "forged.mcap", read_run(recording), change))
    found = broken(done)
    assert expected.items() <= found.items(), found
    assert min(found.values()) == AT if AT in expected.values() else True


def test_energy_out_of_nothing_breaks_theorem_1(recording: Path, tmp_path: Path) -> None:
    """The world's tool gives way before its own force, at 100 m/s."""

    def change(rows: Rows) -> None:
        p, f = rows["environment", "p"][AT:, 0], rows["environment", "f_v"][AT:, 0]
        p -= np.cumsum(0.1 * np.sign(f))

    done = audited(forged(tmp_path / "forged.mcap", read_run(recording), change))
    (link,) = [check for check in done.checks if (check.party, check.name) == ("cx", "link")]
    assert link.verdict is CheckVerdict.BROKEN
    assert link.first is not None
    assert link.first.tick >= AT
    (other,) = [check for check in done.checks if (check.party, check.name) == ("cy", "link")]
    assert other.verdict is CheckVerdict.HOLDS


def test_a_user_that_was_silent_and_came_back_begins_a_new_life(prepared: Prepared, tmp_path: Path) -> None:
    rows = simulated(prepared, TICKS, [Silence("cx", 100, 160)])
    heard = rows["environment", "tank"][:, H]
    assert heard[99] > 0.0
    assert heard[160] == 0.0
    done = audited(written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows))
    assert broken(done) == {}
    wave, _ = (check for check in done.checks if (check.party, check.name) == ("environment", "wave"))
    assert 160 in [gap.begin for gap in wave.gaps]


def test_it_is_replayed_to_the_last_bit(prepared: Prepared, recording: Path) -> None:
    again = replay(prepared, read_run(recording))
    assert again.identical
    assert again.numbers > 40 * TICKS


def test_the_documents_list_every_check_and_every_topic(recording: Path) -> None:
    docs = Path(__file__).parents[3] / "docs"
    checks, topics = (docs / "replay.md").read_text(), (docs / "files.md").read_text()
    for check in audited(recording).checks:
        assert f"`{check.name}`" in checks, check.name
    for _, topic in read_run(recording).traces:
        assert f"`{topic}`" in topics, topic
