"""Rogues around a session and within it: every attack is refused and counted, and moves nothing.

Around it: strangers with no keys or with the keys of others, and crowds before its doors. Within it: members with their
real keys that send what they should not. Processes, sockets and keys are real. A run with rogues must have the values
of a run without them, to the last bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from manyhands.launch.audit.simulation import Simulation
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import RefusalCode

from ..support.rows import rows_of
from .rogues import acts, around, links, tries
from .rogues.runs import forced, infested, quiet, recording, require_same, surrounded
from .rogues.stage import FORCE_LIMIT, SUPERVISOR, TICKS, Played, play, prepared
from .rogues.strangers import Fate
from .rogues.strays import STRAYS


def told() -> around.AttackResults:
    seen = surrounded().told
    assert isinstance(seen, around.AttackResults)
    return seen


# --- nothing is moved -------------------------------------------------------------------------------------------------


def test_without_rogues_nothing_is_refused_and_the_values_are_the_simulations() -> None:
    played = quiet()
    require_same(recording(played), Simulation(prepared()).run(TICKS))
    assert "refused" not in played.outcome.report
    for node in played.nodes.values():
        assert node["ticks"] == TICKS
        assert not {"refused", "dropped"} & node.keys()


@pytest.mark.long
@pytest.mark.parametrize("run", [surrounded, infested], ids=["rogues around it", "rogues within it"])
def test_ticks_and_values_are_those_of_a_run_without_rogues(run: Callable[[], Played]) -> None:
    played = run()
    require_same(recording(played), recording(quiet()))
    assert {name: node["ticks"] for name, node in played.nodes.items()} == dict.fromkeys(quiet().nodes, TICKS)
    for name, node in played.nodes.items():
        for key in ("clipped", "saturated", "ledger"):
            assert node.get(key) == quiet().nodes[name].get(key), f"{name}: {key} differs"


def test_the_attack_fell_within_the_run() -> None:
    assert 100 < surrounded().during < TICKS - 100


# --- around the session -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("one", tries.TRIES, ids=str)
def test_a_key_where_it_is_not_wanted(one: tries.Try) -> None:
    assert told().fates[one] is one.fate


@pytest.mark.parametrize(("mechanism", "door"), tries.WITHOUT_KEYS, ids=[f"{m}, at {d}" for m, d in tries.WITHOUT_KEYS])
def test_no_key(mechanism: str, door: tries.Door) -> None:
    assert told().without[mechanism, door] is Fate.ENDED


def expected_around() -> Mapping[tuple[str, str], int]:
    """How many connections each process must have counted, by reason."""
    counts = Counter((one.door.of, one.reason) for one in tries.TRIES)
    counts.update((door.of, "no_key") for _, door in tries.WITHOUT_KEYS)
    for door in {*tries.CROWDED, *tries.HALFWAY}:
        counts[door.of, "unfinished"] += tries.crowded(door)
    return counts


def refused_by(played: Played, name: str) -> Mapping[str, int]:
    report = played.outcome.report if name == SUPERVISOR else played.nodes[name]
    found: Mapping[str, int] = report.get("refused", {})
    return found


@pytest.mark.parametrize(
    ("name", "reason"),
    sorted(expected_around()),
    ids=[f"{reason} at {name}" for name, reason in sorted(expected_around())],
)
def test_each_connection_is_counted_by_kind(name: str, reason: str) -> None:
    assert refused_by(surrounded(), name)[reason] == expected_around()[name, reason]


HAMPERED: Final = {"telemetry", "log", "old_tick"}
"""What is dropped where a flooded supervisor, or a busy machine, is slow: no frame of a stranger. A member that waits
for an answer sends its signal again."""


def test_no_other_connection_is_counted() -> None:
    """Only a temporarily shut door and members' messages out of turn come on top."""
    said = {"shut", "out_of_turn", "second_route", "not_a_frame"}
    found = {
        (name, reason)
        for name in (SUPERVISOR, *surrounded().nodes)
        for reason in refused_by(surrounded(), name)
        if reason not in said
    }
    assert found == expected_around().keys()
    dropped = {
        name: node["dropped"].keys() - HAMPERED for name, node in surrounded().nodes.items() if "dropped" in node
    }
    assert not any(dropped.values()), f"a stranger's frame reached a link: {dropped}"


def test_a_door_before_which_too_many_crowd_is_shut() -> None:
    assert refused_by(surrounded(), "cy")["shut"] >= 1


def test_a_second_connection_of_a_member_is_not_heard() -> None:
    assert told().refused["second_route"] == len(around.WRITES)
    assert told().refused["not_a_frame"] == 1


@pytest.mark.parametrize("code", around.LIES, ids=str)
def test_an_observer_that_lies_about_itself_is_refused(code: RefusalCode) -> None:
    assert told().lies[code] == code


def test_what_an_observer_writes_is_out_of_turn() -> None:
    assert told().refused["out_of_turn"] == len(around.LIES) + len(around.WRITES)


def test_an_observer_receives_what_it_may_read_and_nothing_else() -> None:
    assert {observation.node for observation in told().observations} == set(quiet().nodes)
    assert all(observation.figures and not observation.traces for observation in told().observations)


def test_a_flood_of_junk_is_read_within_the_allowance_and_counted() -> None:
    counted = refused_by(surrounded(), SUPERVISOR)["out_of_turn"] - told().refused["out_of_turn"]
    assert 0 < counted <= told().queued <= around.FLOOD


# --- within the session -----------------------------------------------------------------------------------------------

RECEIVERS: Final = {"cx": True, "dy": False, "environment": True, "cz": False}
"""Who hears a babbling node (dx, cy, cy and the environment), and whether it bounds what it admits."""


def expected_within() -> Mapping[tuple[str, str], int]:
    """How many frames each process must have dropped, by reason."""
    counts: Counter[tuple[str, str]] = Counter()
    for name, bounded in RECEIVERS.items():
        for stray in STRAYS.values():
            if bounded or not stray.bounded:
                counts[name, stray.reason] += len(links.MISBEHAVES)
        counts[name, "malformed"] += links.JUNK * len(links.MISBEHAVES) + MAX_STRAY_FRAMES
        counts[name, "old_tick"] += len(links.MISBEHAVES)  # each honest signal a second time
    # a repeated signal of an earlier tick is answered again, because the answer may have been lost: the rogues
    # themselves hear it twice, but that the environment does not answer those of long ago
    counts["dx", "old_tick"] = counts["cx", "old_tick"]
    counts["cy", "old_tick"] = counts["environment", "old_tick"] - len(links.MISBEHAVES)
    return counts


def described(reason: str) -> str:
    return ", ".join(what for what, stray in STRAYS.items() if stray.reason == reason)


@pytest.mark.parametrize(
    ("name", "reason"),
    sorted(expected_within()),
    ids=[f"{reason} at {name}: {described(reason)}" for name, reason in sorted(expected_within())],
)
def test_each_stray_frame_is_counted_by_kind(name: str, reason: str) -> None:
    assert infested().nodes[name]["dropped"][reason] == expected_within()[name, reason]


def test_no_other_frame_is_counted() -> None:
    found = {(name, reason) for name, node in infested().nodes.items() for reason in node.get("dropped", {})}
    assert found == expected_within().keys()


def test_messages_out_of_turn_are_counted() -> None:
    assert refused_by(infested(), SUPERVISOR) == {
        "out_of_turn": len(acts.OUT_OF_TURN),
        "telemetry_that_does_not_fit": len(acts.MISFITS),
    }


def test_an_excessive_force_is_clipped_at_the_device_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hand feels the limit while its coupling is dishonest, and the world moves as with that force."""
    simulation = Simulation(prepared())
    guard = simulation.devices["dy"].guard
    clip, ticks = guard.clip, iter(range(TICKS))

    def clip_what_is_sent(f: NDArray[np.float64]) -> NDArray[np.float64]:
        return clip(np.array([links.ABSURD]) if next(ticks) in links.MISBEHAVES else f)

    monkeypatch.setattr(guard, "clip", clip_what_is_sent)
    found = recording(forced())
    require_same(found, simulation.run(TICKS))
    assert found.f_v.tobytes() != recording(quiet()).f_v.tobytes()
    assert np.max(np.abs(found.f_v)) == FORCE_LIMIT
    assert {name: node["clipped"] for name, node in forced().nodes.items() if "clipped" in node} == {
        "dx": 0,
        "dy": len(links.MISBEHAVES),
        "dz": 0,
    }


def test_too_many_strays_in_one_wait_end_sessions_naming_the_sender() -> None:
    played = play(acts={"dx": "flooding device"})
    outcome = played.outcome
    assert outcome.code == 1
    assert outcome.faults[0].startswith(
        f"cx: dx sent {MAX_STRAY_FRAMES + 1} stray frames while its signal of tick {links.FLOOD} was awaited"
    )
    assert outcome.recording is not None
    whole = recording(quiet())
    for i, port in enumerate(whole.ports):
        x, f_v = rows_of(outcome.recording, port)
        assert links.FLOOD - 1 <= len(x) <= links.FLOOD  # one less where it had to end before its last force came
        assert x.tobytes() == whole.x[: len(x), i].tobytes()
        assert f_v.tobytes() == whole.f_v[: len(x), i].tobytes()
