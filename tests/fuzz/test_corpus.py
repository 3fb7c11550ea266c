"""The fuzzer's harnesses without the fuzzer: every seed, every file of the corpus, and what hypothesis makes up."""

from __future__ import annotations

import functools
import gc
import tracemalloc

import pytest
import seeds
from draws import Dictation, Draws, Misdictated
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.cases import cases

FILES = sorted(seeds.CORPUS.glob("*/*"))
MOST_FILES, MOST_BYTES = 120, 240 * 1024


@functools.cache
def corpus(harness: str) -> dict[str, bytes]:
    """What a harness is replayed with: the files that runs of the fuzzer found, and the seeds made by hand."""
    return {path.name: path.read_bytes() for path in FILES if path.parent.name == harness} | seeds.seeds(harness)


@pytest.mark.parametrize("harness", seeds.CHECKS)
def test_the_corpus_is_replayed(harness: str) -> None:
    for name, data in corpus(harness).items():
        try:
            seeds.CHECKS[harness](data)
        except (AssertionError, ValueError) as error:
            raise AssertionError(f"{name}: {error}") from error


@pytest.mark.parametrize("harness", seeds.CHECKS)
@given(data=st.data())
@settings(max_examples=cases(50, 150))
def test_inputs_that_hypothesis_makes_up(harness: str, data: st.DataObject) -> None:
    seeds.CHECKS[harness](data.draw(st.binary(max_size=300)))


@pytest.mark.parametrize("harness", seeds.CHECKS)
@given(data=st.data())
@settings(max_examples=cases(50, 150))
def test_files_of_the_corpus_changed_and_joined(harness: str, data: st.DataObject) -> None:
    files = st.sampled_from([*corpus(harness).values()])
    first, second = data.draw(files), data.draw(files)
    cut, start = data.draw(st.integers(0, len(first))), data.draw(st.integers(0, len(second)))
    seeds.CHECKS[harness](first[:cut] + data.draw(st.binary(max_size=6)) + second[start:])


def test_the_corpus_stays_small() -> None:
    assert len(FILES) <= MOST_FILES
    assert sum(path.stat().st_size for path in FILES) <= MOST_BYTES


@pytest.mark.long
@pytest.mark.parametrize("harness", seeds.CHECKS)
def test_replaying_the_corpus_holds_on_to_nothing(harness: str) -> None:
    """What a frame leaves behind would add up: the second time costs no memory that the first did not."""
    inputs = list(corpus(harness).values())

    def replay() -> None:
        for data in inputs:
            seeds.CHECKS[harness](data)
        gc.collect()  # whenever it came by itself would decide what is counted

    replay()
    tracemalloc.start()
    try:
        replay()
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(3):
            replay()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 64 * 1024


decisions = st.lists(
    st.tuples(st.just("integer"), st.integers(-300, 300), st.integers(0, 2**64)).flatmap(
        lambda d: st.integers(d[1], d[1] + d[2]).map(lambda value: ("integer", (d[1], d[1] + d[2]), value))
    )
    | st.integers(0, 299).map(lambda i: ("choice", (range(300),), i))
    | st.binary(max_size=50).map(lambda data: ("blob", (50,), data)),
    max_size=20,
)


@given(decisions)
def test_what_was_dictated_is_drawn(made: list[tuple[str, tuple[object, ...], object]]) -> None:
    dictation = Dictation(*(value for _, _, value in made))
    assert [getattr(dictation, kind)(*rest) for kind, rest, _ in made] == [value for _, _, value in made]
    draws = Draws(dictation.bytes)
    assert [getattr(draws, kind)(*rest) for kind, rest, _ in made] == [value for _, _, value in made]
    assert not draws.more


def test_a_decision_that_cannot_be_made_is_refused() -> None:
    with pytest.raises(Misdictated, match="found 3; expected a number of 0 to 2"):
        Dictation(3).integer(0, 2)
    with pytest.raises(Misdictated, match="found 'c'; expected one of"):
        Dictation("c").choice("ab")
    with pytest.raises(Misdictated, match="expected at most 1 bytes"):
        Dictation(b"ab").blob(1)
