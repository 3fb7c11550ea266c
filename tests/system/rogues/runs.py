"""The runs that several tests examine, each done once."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import numpy as np

from manyhands.launch.recordings.recording import Recording

from . import around
from .stage import Played, play


def once(run: Callable[[], Played]) -> Callable[[], Played]:
    """Do a run at its first use within a test; every later use gets the same result or the same error."""
    kept: list[Played | Exception] = []

    @wraps(run)
    def played() -> Played:
        if not kept:
            try:
                kept.append(run())
            except Exception as error:
                kept.append(error)
                raise
        if isinstance(kept[0], Exception):
            raise AssertionError(f"the run failed: {kept[0]!r}") from kept[0]
        return kept[0]

    return played


@once
def quiet() -> Played:
    """The run without rogues."""
    return play()


@once
def surrounded() -> Played:
    """The run with all rogues around it."""
    return play(attack=around.attack)


@once
def infested() -> Played:
    """The run with rogues within: a device, a coupling and the environment."""
    return play(
        acts={"dx": "babbling device", "cy": "babbling coupling", "environment": "babbling environment"},
    )


@once
def forced() -> Played:
    """The run with a coupling whose forces are absurd."""
    return play(acts={"cy": "forceful coupling"})


def recording(played: Played) -> Recording:
    assert played.outcome.faults == ()
    assert played.outcome.code == 0
    assert played.outcome.lost == {}
    assert played.outcome.recording is not None
    return played.outcome.recording


def require_same(found: Recording, expected: Recording) -> None:
    for signal in ("x", "f_v"):
        want, got = getattr(expected, signal), getattr(found, signal)
        assert np.max(np.abs(want)) > 0.0
        assert got.shape == want.shape
        assert got.tobytes() == want.tobytes(), f"{signal} differs"
