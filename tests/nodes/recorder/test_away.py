"""When nobody was behind a wave link: such ticks are not missing, and all others are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.recordings.info import read_info
from manyhands.nodes.recorder.away import NOTICED, SLACK, Away
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.coverage import Coverage, Gap, missing_by_party, without

from ...support.small_recordings import RECORDED, STARTED, observation

LINKED = replace(RECORDED, linked=("c",))
WIDER, BEFORE = (round(time / RECORDED.period) for time in (SLACK, NOTICED))
LATE = 2 * BEFORE


def away(*told: dict[str, float], rate: float = 1.0) -> list[Gap]:
    periods = {} if rate == 1.0 else {"dx": RECORDED.period / rate}
    one = Away(replace(LINKED, periods=periods))
    for figures in told:
        one.take(figures)
    return [*one.of({"dx": range(3 * BEFORE)})["dx"]]


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ([{"free:c@0": 1.0}, {"returned:c@1000": 1.0}], [Gap(0, 1000 + WIDER)]),
        ([{"free:c@0": 1.0}], [Gap(0, 3 * BEFORE)]),
        (
            [{"returned:c@1000": 1.0}, {f"frozen:c@{LATE}": 1.0, f"returned:c@{LATE + 9}": 1.0}],
            [Gap(LATE - BEFORE, LATE + 9 + WIDER)],
        ),
        ([{"returned:c@3": 1.0}, {f"began@{LATE}": 1.0}], [Gap(LATE - BEFORE, 3 * BEFORE)]),
        ([{"frozen:c@1000": 1.0}, {"began@2000": 1.0, "returned:c@2500": 1.0}], [Gap(0, 2500 + WIDER)]),
        ([{"frozen:other@1000": 1.0, "began@0": 1.0}], []),
    ],
)
def test_absences_are_those_that_the_environment_states(told: list[dict[str, float]], expected: list[Gap]) -> None:
    assert away(*told) == expected


def test_they_are_in_the_ticks_of_the_device() -> None:
    [gap] = away({f"frozen:c@{LATE}": 1.0, f"returned:c@{LATE + 9}": 1.0}, rate=2.0)
    assert gap == Gap(2 * (LATE - BEFORE), 2 * (LATE + 9 + WIDER))


def test_a_device_without_a_wave_link_is_never_away() -> None:
    one = Away(RECORDED)
    one.take({"frozen:c@10": 1.0})
    assert one.of({"dx": range(5000)}) == {}


RANGES = st.lists(st.tuples(st.integers(0, 60), st.integers(1, 9)), max_size=5).map(
    lambda found: [Gap(begin, begin + ticks) for begin, ticks in sorted(found)]
)


@given(st.sets(st.integers(0, 60), min_size=1), RANGES)
def test_what_is_missing_is_owed_and_not_there(there: set[int], absences: list[Gap]) -> None:
    ticks, out = Coverage(), {tick for gap in absences for tick in range(gap.begin, gap.end)}
    for tick in sorted(there):
        ticks.take(tick, tick + 1)
    owed = set(range(70)) - there - out
    left = without(ticks.gaps_in(0, 70), absences)
    assert {tick for gap in left for tick in range(gap.begin, gap.end)} == owed
    assert missing_by_party({"a": ticks}, {"a": range(70)}, {"a": absences}).get("a", 0) == len(owed)


def test_a_recorder_and_info_count_no_tick_of_an_empty_seat(tmp_path: Path) -> None:
    core = RecorderCore(LINKED)
    data = core.cut()
    for frame in (
        observation("environment", 1000, 1000, **{"free:c@0": 1.0}),
        observation("environment", 2000, 1000, **{"returned:c@1200": 1.0}),
        observation("dx", 1500, 300),
        observation("dx", 2000, 400),
    ):
        core.take(frame, STARTED)
        data += core.cut()
    assert core.missing_in_all == {"dx": 1600 - 1500}  # those of the empty seat are none
    path = tmp_path / "run.mcap"
    path.write_bytes(data + core.end())
    info = read_info(path)
    assert info.missing == {"dx": 1600 - 1500}
    assert info.gaps == {"dx": (Gap(1500, 1600),)}
