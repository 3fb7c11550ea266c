"""A party follows its recording: it is lost where the recording does not say what happened, and found again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import UncheckedTicks
from manyhands.launch.audit.recompute import FollowedParty, Lost, recompute

TICKS = 12


class Counter(FollowedParty):
    """A party that counts the rows of its process, and the rungs that it was told of."""

    def __init__(self, lost: Mapping[int, str], rows: Sequence[int] = range(TICKS)) -> None:
        self.rows, self.ticks, self.fields, self._lost = rows, TICKS, {"count": 1, "rung": 2}, lost
        self.calls: list[tuple[str, int]] = []

    def begin(self, joins: bool) -> None:
        self._count, self._rung = 0, 0
        self.calls.append(("begin", joins))

    def change(self, rung: int) -> None:
        self._rung = rung
        self.calls.append(("change", rung))

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        if k in self._lost:
            raise Lost(self._lost[k])
        self._count += 1
        return {"count": [self._count]} if k % 2 else {"count": [self._count], "rung": [self._rung, rung or 0]}


def course(before: Mapping[int, Happening], rungs: Mapping[int, int] | None = None) -> Course:
    return Course(before, rungs or {}, TICKS)


def test_every_field_of_a_row_is_kept_and_a_field_that_does_not_follow_stays_unknown() -> None:
    again = recompute(Counter({}, [0, 1, 4]), course({}, {4: 2}))
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(again["count"][:, 0])), [0, 1, 4])
    assert again["rung"][[0, 4]].tolist() == [[0.0, 0.0], [0.0, 2.0]]
    assert np.isnan(again["rung"][1]).all()
    assert again.gaps == []


def test_a_party_is_lost_until_a_new_process_begins() -> None:
    party = Counter({})
    again = recompute(
        party, course({3: Happening(unknown="it went"), 5: Happening(unknown="more"), 8: Happening(began=True)})
    )
    assert again["count"][:, 0].tolist()[:3] == [1.0, 2.0, 3.0]
    assert np.isnan(again["count"][3:8]).all()
    assert again["count"][8:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert again.gaps == [UncheckedTicks(3, 8, "it went: from there on it is not checked")]
    assert party.calls == [("begin", False), ("begin", True)]


def test_a_process_that_begins_where_it_is_not_known_is_lost_at_once() -> None:
    again = recompute(Counter({4: "no"}), course({8: Happening(began=True, unknown="its first rows are missing")}))
    words = "its first rows are missing: from there on it is not checked"
    assert again.gaps == [UncheckedTicks(4, 8, "no"), UncheckedTicks(8, TICKS, words)]
    assert np.isnan(again["count"][4:]).all()


def test_what_is_over_is_no_gap() -> None:
    again = recompute(Counter({9: ""}), course({}))
    assert again.gaps == []
    assert np.isnan(again["count"][9:]).all()


def test_a_rung_between_rows_is_taken_before_the_row() -> None:
    again = recompute(Counter({}), course({4: Happening(rung=3)}))
    assert again["rung"][[2, 4], 0].tolist() == [0.0, 3.0]
