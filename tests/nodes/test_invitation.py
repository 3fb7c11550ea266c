"""An invitation from elsewhere: it is whole and trustworthy, or one clear error that quotes no key."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.files import load_named
from manyhands.launch.plan.keys import ephemeral
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.seats import write_invitations
from manyhands.launch.plan.topology import roster
from manyhands.nodes import invitation as invitations
from manyhands.nodes.bundle import BundleError
from manyhands.nodes.invitation import load_invitation
from manyhands.nodes.seat import take_seat
from manyhands.protocol.keys import KeyFileError

Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The members of an invitation's file."""
    session = load_named("ball")
    folder = tmp_path_factory.mktemp("home")
    keys = ephemeral(roster(session), session.name)
    written = write_invitations(prepare(session), keys, "192.0.2.7:7400", folder)
    found: dict[str, Any] = json.loads(written["right_seat"].read_text())
    return found


def file_of(members: object, tmp_path: Path) -> Path:
    path = tmp_path / "right_seat.invitation"
    path.touch(mode=0o600)
    path.write_text(members if isinstance(members, str) else json.dumps(members))
    return path


def test_it_comes_back_as_it_was_saved(whole: dict[str, Any], tmp_path: Path) -> None:
    path = file_of(whole, tmp_path)
    before = load_invitation(path)
    before.at("ball.example.org:7401").save(path)
    after = load_invitation(path)
    assert after.address == "ball.example.org:7401"
    assert json.loads(path.read_text()) == {**whole, "address": after.address}
    assert after.ring(after.device.common).peers.keys() == {"supervisor"}
    assert after.ring(after.coupling.common).peers.keys() == {"supervisor", "environment"}


def swapped(data: dict[str, Any]) -> None:
    data["keys"]["right"], data["keys"]["right_seat"] = data["keys"]["right_seat"], data["keys"]["right"]


CHANGES: dict[str, tuple[Change, str]] = {
    "another format": (lambda d: d.update(format="manyhands private key"), "found no file of manyhands invitation"),
    "another version": (lambda d: d.update(version=2), "found another version"),
    "a member more": (lambda d: d.update(more=1), "found other members"),
    "a member less": (lambda d: d.pop("coupling"), "found other members"),
    "an address that is none": (lambda d: d.update(address="ball"), "expected HOST:PORT"),
    "an address with a command": (lambda d: d.update(address="x;\u001b[2J:7400"), "expected HOST:PORT"),
    "an address that is a number": (lambda d: d.update(address=7400), "expected HOST:PORT"),
    "a device that is none": (lambda d: d.update(device=[]), "not a bundle for a DeviceBundle"),
    "the coupling twice": (lambda d: d.update(device=d["coupling"]), "not a bundle for a DeviceBundle"),
    "two sessions": (lambda d: d["device"]["common"].update(session="other"), "found bundles of two sessions"),
    "two certificates": (lambda d: d["device"]["common"].update(certificate="0"), "found bundles of two sessions"),
    "one name": (lambda d: d["device"]["common"].update(name="right_seat"), "found one name for two nodes"),
    "other ports": (lambda d: d["device"]["common"].update(ports=["left"]), "found a coupling of other ports"),
    "a device with a peer": (
        lambda d: d["device"]["common"].update(peers=d["coupling"]["common"]["peers"]),
        "found other peers than the environment",
    ),
    "no wave link": (lambda d: d["coupling"].update(wave=None), "found a coupling without a wave link"),
    "the simulated clock": (lambda d: d["coupling"]["common"].update(clock="simulated"), "found a clock other than"),
    "no public keys": (lambda d: d["coupling"]["common"].update(public={}), "found a bundle without public keys"),
    "no keys": (lambda d: d.update(keys={}), "keys: found other members"),
    "keys in a list": (lambda d: d.update(keys=[]), "keys: found other members"),
    "a key that is none": (lambda d: d["keys"].update(right="x"), "keys: found no key pair of 'right'"),
    "half a pair": (lambda d: d["keys"]["right"].pop("public"), "keys: found no key pair of 'right'"),
    "the two keys swapped": (swapped, "that its bundle does not know"),
}


@pytest.mark.parametrize(("change", "words"), CHANGES.values(), ids=CHANGES)
def test_a_malformed_one_is_one_clear_error(
    change: Change, words: str, whole: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = json.loads(json.dumps(whole))
    secrets = [pair["secret"] for pair in whole["keys"].values()]
    change(data)
    path = file_of(data, tmp_path)
    with pytest.raises((BundleError, KeyFileError)) as caught:
        load_invitation(path)
    assert words in str(caught.value)
    assert take_seat(path, None, yes=True) == 2
    said = capsys.readouterr().err
    assert said == f"error: {caught.value}\n"
    assert not any(secret in said for secret in secrets)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": 1, "format": 2}', "[" * 10_000])
def test_what_is_no_json_object_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="found no file of manyhands invitation"):
        load_invitation(file_of(text, tmp_path))


def test_a_file_that_others_can_read_or_that_is_a_link_or_absent_is_refused(
    whole: dict[str, Any], tmp_path: Path
) -> None:
    path = file_of(whole, tmp_path)
    link = tmp_path / "link"
    link.symlink_to(path)
    with pytest.raises(KeyFileError, match="found a link; expected the file itself"):
        load_invitation(link)
    path.chmod(0o644)
    with pytest.raises(KeyFileError, match="found mode 0644, which lets others in"):
        load_invitation(path)
    with pytest.raises(KeyFileError, match="found no file; expected one as manyhands host writes it"):
        load_invitation(tmp_path / "absent")


def test_one_that_is_too_long_is_neither_read_nor_written(
    whole: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = file_of(whole, tmp_path)
    found = load_invitation(path)
    monkeypatch.setattr(invitations, "MAX_BYTES", 1000)
    with pytest.raises(KeyFileError, match="expected at most 1000"):
        load_invitation(path)
    with pytest.raises(BundleError, match="expected at most 1000"):
        found.save(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_address_by_hand_has_the_same_form(whole: dict[str, Any], tmp_path: Path) -> None:
    found = load_invitation(file_of(whole, tmp_path))
    with pytest.raises(BundleError, match="--address: found 'ball'; expected HOST:PORT"):
        found.at("ball")


def test_a_host_that_nobody_knows_is_reported_at_once(
    whole: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = file_of(whole, tmp_path)
    assert take_seat(path, "nobody.invalid:7400", yes=True) == 4
    assert "nobody.invalid: cannot be looked up" in capsys.readouterr().err
