"""The searches that other tests rely on find exactly what is there, and every opened file is seen."""

from __future__ import annotations

import random
import signal
import struct
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ..support.opened_files import opened, watched
from ..support.patterns import Patterns
from ..support.process_memory import held, memory_contains

LETTERS = st.sampled_from(b"\0ab")  # few, so that patterns overlap, begin alike, and occur


def some_bytes(least: int, most: int) -> st.SearchStrategy[bytes]:
    return st.lists(LETTERS, min_size=least, max_size=most).map(bytes)


@given(
    wanted=st.sets(some_bytes(8, 12).filter(any), min_size=1, max_size=6),
    others=some_bytes(0, 60),
    cuts=st.lists(st.integers(0, 120), max_size=5),
    data=st.data(),
)
def test_patterns_are_found_where_they_occur(
    wanted: set[bytes], others: bytes, cuts: list[int], data: st.DataObject
) -> None:
    text = others
    for pattern in data.draw(st.lists(st.sampled_from(sorted(wanted)), max_size=3)):
        at, length = data.draw(st.integers(0, len(text))), data.draw(st.sampled_from([len(pattern), len(pattern) - 1]))
        text = text[:at] + pattern[:length] + text[at:]  # all of it, or nearly
    borders = sorted({0, len(text), *(cut for cut in cuts if cut < len(text))})
    pieces = [text[begin:end] for begin, end in pairwise(borders)]
    found = Patterns({pattern: repr(pattern) for pattern in wanted}).found_in(pieces)
    assert found == {repr(pattern) for pattern in wanted if pattern in text}


@pytest.mark.parametrize("pattern", [b"abcdefg", bytes(20)])
def test_patterns_that_would_turn_up_by_accident_are_refused(pattern: bytes) -> None:
    with pytest.raises(ValueError, match=r"it: found the pattern .*; expected 8 bytes or more, not all zero"):
        Patterns({pattern: "it"})


CHILD = """
import random, sys
numbers = random.Random(11)
early = [numbers.uniform(1.0, 2.0) for _ in range(50)]
print("early", flush=True)
sys.stdin.readline()
late = [numbers.uniform(1.0, 2.0) for _ in range(50)]
sys.exit(7)
"""


def test_a_process_is_searched_while_it_runs_and_when_it_ends() -> None:
    numbers = random.Random(11)
    values = [numbers.uniform(1.0, 2.0) for _ in range(200)]
    patterns = Patterns({struct.pack("<d", value): repr(value) for value in values})
    early, late = set(map(repr, values[:50])), set(map(repr, values[50:100]))
    with (
        subprocess.Popen([sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child,
        held(child.pid) as holding,
    ):
        assert child.stdin is not None
        assert child.stdout is not None
        assert child.stdout.readline() == b"early\n"
        holding.hold()
        assert memory_contains(child.pid, patterns) == early
        holding.resume()
        child.stdin.write(b"\n")
        child.stdin.flush()
        holding.hold_at_end()
        assert memory_contains(child.pid, patterns) == early | late
        assert holding.let_end() == 7


def test_a_held_process_is_let_go_and_hears_its_signals() -> None:
    with subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.readline()"], stdin=subprocess.PIPE) as child:
        with held(child.pid) as holding:
            holding.hold()
            child.send_signal(signal.SIGTERM)
            holding.resume()
            holding.hold_at_end()
        assert child.wait() == -signal.SIGTERM


READER = """
import sys, threading
readers = [threading.Thread(target=open(path).close) for path in sys.argv[1:]]
for reader in readers:
    reader.start()
for reader in readers:
    reader.join()
"""


def test_opened_files_are_reported_by_their_own_name(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("own", "linked to", "not opened")]
    for file in files:
        file.touch()
    link = tmp_path / "link"
    link.symlink_to(files[1])
    log = tmp_path / "log"
    subprocess.run(watched([sys.executable, "-c", READER, str(files[0]), str(link)], log), check=True, timeout=60)
    assert {path for path in opened(log) if path.is_relative_to(tmp_path)} == set(files[:2])
