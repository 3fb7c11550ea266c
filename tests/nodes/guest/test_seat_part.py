"""What a guest fetches: pieces in any order and number, from a host that may send anything."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.plan.keys import ephemeral
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.seats import invitations, seat_parts
from manyhands.launch.plan.topology import roster
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.guest import seat_part
from manyhands.nodes.guest.invitation import Invitation
from manyhands.nodes.guest.seat import fetch
from manyhands.nodes.guest.seat_part import decoded_part
from manyhands.nodes.kernel.bundle import BundleError, foreign_code
from manyhands.nodes.kernel.factory import FactoryError, require_allowed
from manyhands.nodes.kernel.lifetime import Life, Stopped
from manyhands.nodes.link.supervisor_line import Refused
from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.keys import new_pair
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Echo, Fetch, Message, Piece
from manyhands.protocol.transport import Trouble

Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def sent() -> tuple[Invitation, dict[str, Any]]:
    """An invitation, and the members of what is sent to its guest."""
    session = load_named("ball")
    keys, prepared = ephemeral(roster(session), session.name), prepare(session)
    invitation = invitations(prepared, keys, "192.0.2.7:7400")["right_seat"]
    found: dict[str, Any] = json.loads(seat_parts(prepared, keys)["right"])
    return invitation, found


def test_it_is_what_was_sent_and_holds_nothing_of_the_others(sent: tuple[Invitation, dict[str, Any]]) -> None:
    invitation, members = sent
    part = decoded_part(json.dumps(members).encode(), invitation)
    assert json.loads(part.encoded()) == members
    assert part.ring(part.device.common).peers.keys() == {"supervisor"}
    assert part.ring(part.coupling.common).peers.keys() == {"supervisor", "environment"}
    assert "left" not in json.dumps(members)
    assert invitation.pair.secret not in json.dumps(members)


CHANGES: dict[str, tuple[Change, str]] = {
    "a period that no machine keeps": (
        lambda d: [d[one]["common"].update(period=1e-9) for one in ("device", "coupling")],
        "found a period of 1e-09 s",
    ),
    "a member more": (lambda d: d.update(more=1), "found other members"),
    "a member less": (lambda d: d.pop("coupling"), "found other members"),
    "a device that is none": (lambda d: d.update(device=[]), "not a bundle for a DeviceBundle"),
    "the coupling twice": (lambda d: d.update(device=d["coupling"]), "not a bundle for a DeviceBundle"),
    "two sessions": (lambda d: d["device"]["common"].update(session="other"), "found bundles of two sessions"),
    "two certificates": (lambda d: d["device"]["common"].update(certificate="0"), "found bundles of two sessions"),
    "another session": (
        lambda d: [d[one]["common"].update(session="other") for one in ("device", "coupling")],
        "or of another than the invitation's",
    ),
    "another device": (lambda d: d["device"]["common"].update(name="left"), "found 'left' and 'right_seat'"),
    "other ports": (lambda d: d["device"]["common"].update(ports=["left"]), "found a coupling of other ports"),
    "a device with a peer": (
        lambda d: d["device"]["common"].update(peers=d["coupling"]["common"]["peers"]),
        "found other peers than the environment",
    ),
    "no wave link": (lambda d: d["coupling"].update(wave=None), "found a coupling without a wave link"),
    "the simulated clock": (lambda d: d["coupling"]["common"].update(clock="simulated"), "found a clock other than"),
    "no public keys": (lambda d: d["coupling"]["common"].update(public={}), "found a bundle without public keys"),
    "another key of the device": (
        lambda d: d["device"]["common"]["public"].update(right=d["keys"]["public"]),
        "found a bundle of another key than the invitation's",
    ),
    "no keys": (lambda d: d.update(keys={}), "keys: found no key pair of 'right_seat'"),
    "keys in a list": (lambda d: d.update(keys=[]), "keys: found no key pair of 'right_seat'"),
    "half a pair": (lambda d: d["keys"].pop("public"), "keys: found no key pair of 'right_seat'"),
    "a key that the bundle does not know": (
        lambda d: d["coupling"]["common"]["public"].update(right_seat=d["coupling"]["common"]["public"]["environment"]),
        "that its bundle does not know",
    ),
}


@pytest.mark.parametrize(("change", "words"), CHANGES.values(), ids=CHANGES)
def test_a_malformed_one_is_one_clear_error(
    change: Change, words: str, sent: tuple[Invitation, dict[str, Any]]
) -> None:
    invitation, members = sent
    data = json.loads(json.dumps(members))
    change(data)
    with pytest.raises(BundleError) as caught:
        decoded_part(json.dumps(data).encode(), invitation)
    assert words in str(caught.value)
    assert members["keys"]["secret"] not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff", b"[" * 10_000])
def test_what_is_no_json_object_is_refused(content: bytes, sent: tuple[Invitation, dict[str, Any]]) -> None:
    with pytest.raises(BundleError, match="found other members"):
        decoded_part(content, sent[0])


def test_one_that_is_too_long_is_not_sent(
    sent: tuple[Invitation, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    part = decoded_part(json.dumps(sent[1]).encode(), sent[0])
    monkeypatch.setattr(seat_part, "MAX_PART_BYTES", 1000)
    with pytest.raises(BundleError, match="expected at most 1000"):
        part.encoded()


@pytest.mark.parametrize(
    ("allowed", "found"), [(None, "no permission for it"), ("os:kill", "a permission for os:kill")]
)
def test_the_code_that_it_names_runs_only_where_the_user_names_it_too(
    sent: tuple[Invitation, dict[str, Any]], allowed: str | None, found: str
) -> None:
    """Nothing of it is imported, and no folder of the host's is looked into."""
    invitation, members = sent
    data = json.loads(json.dumps(members))
    data["device"]["source"] = {
        "kind": "plugin", "driver": {"factory": "tests.not_there:run", "parameters": {}, "folder": "/somewhere"},
        "axes": len(data["device"]["common"]["ports"]), "axis_map": [], "scale": 1.0,
        "timing": {"sample_age": 0.0, "age_jitter": None, "actuation_delay": 0.0},
    }  # fmt: skip
    part = decoded_part(json.dumps(data).encode(), invitation)
    with pytest.raises(FactoryError, match=f"found the factory tests.not_there:run.*{found}"):
        require_allowed(foreign_code(part.device), allowed)
    assert "/somewhere" not in part.encoded().decode()


class Host:
    """A link to a host that answers each Fetch as it is told.

    Attributes:
        asked: the first bytes that were asked for.
    """

    def __init__(self, answers: Callable[[int], list[Message]], trouble: Trouble | None = None) -> None:
        self._answers, self._trouble = answers, trouble
        self._queue: list[bytes] = []
        self.asked: list[int] = []

    def send(self, frame: bytes) -> bool:
        asked = decode(frame, MAX_CONTROL_BYTES)
        assert isinstance(asked, Fetch)
        self.asked.append(asked.at)
        self._queue += [encode(answer) for answer in self._answers(asked.at)]
        return True

    def recv(self, timeout: Duration | None = None) -> bytes | None:
        return self._queue.pop(0) if self._queue else None

    def trouble(self) -> Trouble | None:
        return self._trouble

    def close(self) -> None:
        raise AssertionError("the caller closes it")


class Waits(Life):
    """A life without signals, which its user ends after so many looks."""

    def __init__(self, looks: int) -> None:
        self.stopping, self._left = False, looks

    def check(self) -> None:
        self._left -= 1
        self.stopping = self._left < 0


GUEST = Invitation("192.0.2.7:7400", "s", "seat", "device", new_pair().public, new_pair())


@given(st.binary(min_size=1, max_size=200), st.integers(1, 50), st.data())
def test_pieces_of_any_size_make_the_whole_whatever_else_comes(part: bytes, size: int, data: st.DataObject) -> None:
    def answers(at: int) -> list[Message]:
        right = Piece(at, len(part), part[at : at + size])
        others = [
            Piece(at + 1, len(part), b"later"),
            Echo(0, 0, 0),
            *([Piece(0, len(part), part[:size])] if at else []),
        ]
        return [*data.draw(st.lists(st.sampled_from(others), max_size=2)), right]

    assert fetch(Host(answers), GUEST, Waits(0)) == part


def test_a_fetch_that_is_not_answered_is_repeated_and_its_answer_taken_once() -> None:
    answers = iter([[], [], [Piece(0, 4, b"ab")] * 2, [Piece(2, 4, b"cd")]])
    host = Host(lambda at: next(answers))
    assert fetch(host, GUEST, Waits(100)) == b"abcd"
    assert host.asked == [0, 0, 0, 2]


def test_a_seat_that_somebody_has_is_said_once_and_waited_for(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Stopped):
        fetch(Host(lambda at: []), GUEST, Waits(200))
    assert capsys.readouterr().err.count("somebody may have taken the seat seat") == 1


def test_a_host_at_which_nobody_answers_is_said_once_and_given_up(capsys: pytest.CaptureFixture[str]) -> None:
    """The time passes with the waits: the first look at the clock is before them all."""
    with pytest.raises(Stopped):
        fetch(Host(lambda at: [], Trouble.NOBODY), GUEST, Waits(40), timeout=60.0)
    said = "s: nobody answers at 192.0.2.7:7400: the session may not run yet, or not any more"
    assert capsys.readouterr().err.count(said) == 1
    with pytest.raises(Refused, match="nobody listens there"):
        fetch(Host(lambda at: [], Trouble.NOBODY), GUEST, Waits(40), timeout=1e-9)


def test_a_host_that_sends_more_than_it_said_is_refused() -> None:
    with pytest.raises(BundleError, match="found 5 bytes; expected 4"):
        fetch(Host(lambda at: [Piece(0, 4, b"abcde")]), GUEST, Waits(0))


def test_a_length_that_changes_is_not_believed() -> None:
    answers = iter([[Piece(0, 4, b"ab"), Piece(2, 9, b"cdefghi")], [Piece(2, 4, b"cd")]])
    assert fetch(Host(lambda at: next(answers)), GUEST, Waits(9)) == b"abcd"


def test_a_key_that_is_not_known_any_more_ends_it_at_once() -> None:
    with pytest.raises(Refused, match=r"cannot join the supervisor at tcp://192\.0\.2\.7:7400"):
        fetch(Host(lambda at: [], Trouble.NOT_ADMITTED), GUEST, Waits(9))
