"""The part of a session that states the consequences of a fault."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.session import SessionError, load_session
from manyhands.launch.session.limits import LONGEST_WINDOW, MAX_RESTARTS

EXAMPLE = Path(__file__).parents[3] / "launch" / "sessions" / "example1.yaml"


def test_what_holds_where_nothing_is_written() -> None:
    faults = load_session(EXAMPLE).faults
    assert (faults.restarts, faults.window, faults.breach) == (3, 60.0, "soften")


@pytest.mark.parametrize(
    ("override", "found"),
    [
        ("faults={restarts: 0, window: 5, breach: stop}", (0, 5.0, "stop")),
        ("faults.breach=warn", (3, 60.0, "warn")),
        ("faults={}", (3, 60.0, "soften")),
        (f"faults={{restarts: {MAX_RESTARTS}, window: {LONGEST_WINDOW}}}", (MAX_RESTARTS, LONGEST_WINDOW, "soften")),
    ],
)
def test_what_is_written_holds(override: str, found: tuple[int, float, str]) -> None:
    faults = load_session(EXAMPLE, [override]).faults
    assert (faults.restarts, faults.window, faults.breach) == found


@pytest.mark.parametrize(
    ("override", "error"),
    [
        ("faults.restarts=-1", "faults.restarts: found -1; expected a whole number of restarts from 0 to 100"),
        ("faults.restarts=101", "faults.restarts: found 101; expected a whole number of restarts from 0 to 100"),
        ("faults.restarts=1.5", "faults.restarts: found 1.5; expected a whole number of restarts from 0 to 100"),
        ("faults.restarts=true", "found true; expected a whole number of restarts"),
        ("faults.window=0", "faults.window: found 0; expected a window in s greater than 0 and at most 86400"),
        ("faults.window=1e9", "expected a window in s greater than 0 and at most 86400"),
        ("faults.window=.inf", "and finite"),
        ("faults.window=60 s", "faults.window: found '60 s'; expected a number in s, without the unit"),
        ("faults.breach=ignore", "faults.breach: found 'ignore'; expected one of warn, soften, stop"),
        ("faults.restart=1", "faults.restart: found the unknown key 'restart'; expected one of restarts"),
        ("faults=3", "faults: found 3; expected a mapping with the keys restarts, window, breach"),
        ("faults={breach: }", "faults.breach: found nothing; expected one of warn, soften, stop"),
    ],
)
def test_what_is_wrong_is_refused_by_name(override: str, error: str) -> None:
    with pytest.raises(SessionError) as caught:
        load_session(EXAMPLE, [override])
    assert error in str(caught.value)
