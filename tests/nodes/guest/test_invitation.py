"""An invitation from elsewhere: it is whole and trustworthy, or one clear error that quotes no key."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.guest.invitation import MAX_CHARACTERS, Invitation, InvitationError, parsed, read_invitation
from manyhands.nodes.guest.seat import take_seat
from manyhands.protocol.keys import KeyFileError, new_pair
from manyhands.protocol.limits import MAX_NAME

HUB, PAIR = new_pair(), new_pair()
WHOLE = Invitation("192.0.2.7:7400", "ball", "right_seat", "right", HUB.public, PAIR)
names = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=MAX_NAME)


def file_of(text: str, tmp_path: Path) -> Path:
    path = tmp_path / "right_seat.invitation"
    path.touch(mode=0o600)
    path.write_text(text)
    return path


@given(names, names, names)
def test_a_line_says_what_it_was_made_of(session: str, seat: str, device: str) -> None:
    made = Invitation("[2001:db8::1]:7400", session, seat, device, HUB.public, PAIR)
    assert len(made.line) <= MAX_CHARACTERS
    assert made.line.isascii()
    assert not set(made.line) & set(" \"'`$&*?!()<>|;\\{}#\n\t")  # a shell takes it as one word
    if seat == device:
        with pytest.raises(InvitationError, match="one name for seat and device"):
            parsed(made.line, "here")
    else:
        again = parsed(f"  {made.line}\n", "here")
        assert again == made
        assert again.pair.secret == PAIR.secret
        assert again.ring.peers == {"supervisor": HUB.public}


def test_it_comes_back_as_it_was_saved(tmp_path: Path) -> None:
    path = file_of("", tmp_path)
    WHOLE.at("ball.example.org:7401").save(path)
    assert path.stat().st_mode & 0o777 == 0o600
    again = read_invitation(path)
    assert again == WHOLE.at("ball.example.org:7401")
    assert path.read_text() == f"{again.line}\n"


def changed(at: int, value: str) -> str:
    fields = WHOLE.line.split("/")
    fields[2 + at] = value
    return "/".join(fields)


KEY = WHOLE.line.split("/")[-1]
CHANGES: dict[str, tuple[str, str]] = {
    "nothing": ("", "found no invitation; expected a line that begins with manyhands://"),
    "another scheme": (WHOLE.line.replace("manyhands", "https"), "found no invitation"),
    "a field less": (WHOLE.line.rpartition("/")[0], "found no invitation"),
    "a field more": (WHOLE.line + "/more", "found no invitation"),
    "too long": (WHOLE.line + "A" * MAX_CHARACTERS, "found no invitation"),
    "an address that is none": (changed(0, "ball"), "found 'ball'; expected HOST:PORT"),
    "an address with a command": (changed(0, "x;\u001b[2J:7400"), "expected HOST:PORT"),
    "no session": (changed(1, ""), "found '' as a name"),
    "a name that is not encoded": (changed(1, "b all"), "found 'b all' as a name"),
    "a name in half a character": (changed(1, "%C3"), "found '%C3' as a name"),
    "a name with a terminal's command": (changed(1, "%1B%5B2J"), "found '%1B%5B2J' as a name"),
    "a name that is too long": (changed(2, "a" * (MAX_NAME + 1)), "as a name"),
    "one name": (changed(3, "right_seat"), "found one name for seat and device"),
    "a key that was cut": (changed(5, KEY[:-1]), "found a damaged key; expected the whole line"),
    "a key of other characters": (changed(5, KEY[:-1] + "?"), "found a damaged key"),
    "a key with a bit more": (changed(4, KEY[:-1] + "B"), "found a damaged key"),
    "one key twice": (changed(4, replace(WHOLE, hub=PAIR.public).line.split("/")[6]), "damaged key"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "words"), CHANGES.values(), ids=CHANGES)
def test_a_malformed_one_is_one_clear_error(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = file_of(text, tmp_path)
    with pytest.raises((InvitationError, KeyFileError)) as caught:
        read_invitation(path)
    assert (words if len(text) <= MAX_CHARACTERS else f"expected at most {MAX_CHARACTERS}") in str(caught.value)
    with pytest.raises(InvitationError, match="found"):
        parsed(text, "here")
    assert take_seat(path, None, yes=True) == 2
    said = capsys.readouterr().err
    assert said == f"error: {caught.value}\n"
    assert "\u001b" not in said
    assert KEY[:8] not in said


def test_a_file_that_others_can_read_or_that_is_a_link_or_absent_is_refused(tmp_path: Path) -> None:
    path = file_of(WHOLE.line, tmp_path)
    link = tmp_path / "link"
    link.symlink_to(path)
    with pytest.raises(KeyFileError, match="found a link; expected the file itself"):
        read_invitation(link)
    path.chmod(0o644)
    with pytest.raises(KeyFileError, match="found mode 0644, which lets others in"):
        read_invitation(path)
    with pytest.raises(KeyFileError, match="found no file; expected one as manyhands host writes it"):
        read_invitation(tmp_path / "absent")
    path.chmod(0o600)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(KeyFileError, match="found no text; expected a file as manyhands host writes it"):
        read_invitation(path)


@pytest.mark.parametrize("written", [str, lambda text: text.replace("://", ":/")])
def test_on_a_command_line_it_is_refused_and_not_repeated(
    written: Callable[[str], str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert take_seat(Path(written(WHOLE.line)), None, yes=True) == 2
    said = capsys.readouterr().err
    assert "found an invitation on the command line, where other users of this machine can read it" in said
    assert KEY not in said


def test_without_a_file_it_is_read_from_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{WHOLE.line}\nmore\n"))
    assert read_invitation(None) == WHOLE
    monkeypatch.setattr("sys.stdin", io.StringIO("x" * 10_000_000))
    with pytest.raises(InvitationError, match="standard input: found no invitation"):
        read_invitation(None)


def test_an_address_by_hand_has_the_same_form() -> None:
    with pytest.raises(InvitationError, match="--connect: found 'ball'; expected HOST:PORT"):
        WHOLE.at("ball")


def test_a_host_that_nobody_knows_is_reported_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = file_of(WHOLE.line, tmp_path)
    assert take_seat(path, "nobody.invalid:7400", yes=True) == 4
    assert "nobody.invalid: cannot be looked up" in capsys.readouterr().err
