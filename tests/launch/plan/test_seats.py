"""Seats of a session, the files of a hosting, and that nobody's certificate knows who sits on them."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from manyhands.design.certificate import to_json
from manyhands.launch.files import TargetError, load_named
from manyhands.launch.plan.keys import Keys, ephemeral
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import ReachError
from manyhands.launch.plan.seats import (
    CERTIFICATE,
    keep_certificates,
    require_folder,
    seat_nodes,
    seats_of,
    write_invitations,
)
from manyhands.launch.plan.topology import roster
from manyhands.launch.session import Session
from manyhands.nodes.invitation import load_invitation

SESSION = Path(__file__).parents[3] / "launch" / "sessions" / "ball.yaml"
THIRD_DEVICE = "  third: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}\n"
THIRD_SEAT = "  third_seat: {devices: [third], wave_link: {b: 20, tau: 0.0003}}\n"
THIRD_LINK = "  links:\n    - {between: [third, ball], stiffness: 600, damping: 0.5}   # "


def ball(*overrides: str) -> Session:
    return load_named("ball", overrides)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(ball())


@pytest.fixture(scope="module")
def keys() -> Keys:
    return ephemeral(roster(ball()), "ball")


def test_each_coupling_with_a_wave_link_is_a_seat() -> None:
    assert seats_of(ball()) == {"left_seat": "left", "right_seat": "right"}
    assert seat_nodes(ball()) == {"left_seat", "left", "right_seat", "right"}
    in_tick = ball("couplings.left_seat={devices: [left]}")
    assert seats_of(in_tick) == {"right_seat": "right"}


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        ("example1", (), "example-1: found no wave link; expected a coupling with a wave_link"),
        ("ball", ("colocate=false",), "ball: found colocate: false with the seat 'left_seat'; expected colocate: true"),
    ],
)
def test_what_has_no_seats_is_refused(name: str, overrides: tuple[str, ...], words: str) -> None:
    with pytest.raises(ReachError, match=words):
        seats_of(load_named(name, overrides))


def test_an_invitation_holds_its_own_seat_and_nothing_of_the_others(
    prepared: Prepared, keys: Keys, tmp_path: Path
) -> None:
    written = write_invitations(prepared, keys, "ball.example.org:7400", tmp_path)
    assert written == {seat: tmp_path / f"{seat}.invitation" for seat in ("left_seat", "right_seat")}
    path = written["right_seat"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    invitation = load_invitation(path)
    assert (invitation.session, invitation.seat) == ("ball", "right_seat")
    assert invitation.address == "ball.example.org:7400"
    assert invitation.pairs == {name: keys.pair(name) for name in ("right", "right_seat")}
    text = path.read_text()
    assert "left" not in text
    for other in ("left", "left_seat", "environment", "supervisor"):
        assert keys.pair(other).secret not in text
    assert set(invitation.coupling.common.public) == {"right_seat", "environment", "supervisor"}


def test_a_second_hosting_writes_the_same_bytes(prepared: Prepared, keys: Keys, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        require_folder(folder)
        keep_certificates(prepared, folder)
        write_invitations(prepare(ball(), folder / CERTIFICATE), keys, "192.0.2.7:7400", folder)
    names = sorted(path.name for path in first.iterdir())
    assert names == [
        "certificate.json",
        "certificate.left_seat.json",
        "certificate.right_seat.json",
        "left_seat.invitation",
        "right_seat.invitation",
    ]
    assert all((first / name).read_bytes() == (second / name).read_bytes() for name in names)


def test_sites_are_certified_the_same_byte_for_byte_with_one_seat_more(prepared: Prepared, tmp_path: Path) -> None:
    """The world then has a port more, and a certificate of its own; nobody at a seat has to know of it."""
    source = SESSION.read_text().replace("couplings:", THIRD_DEVICE + "couplings:")
    source = source.replace("environment:", THIRD_SEAT + "environment:").replace("  links: ", THIRD_LINK, 1)
    (tmp_path / "ball.yaml").write_text(source)
    more = prepare(load_named(tmp_path / "ball.yaml"))
    assert more.parts.keys() == {"left_seat", "right_seat", "third_seat"}
    for seat in seats_of(ball()):
        assert to_json(more.parts[seat]) == to_json(prepared.parts[seat])


def test_the_folder_of_a_hosting(tmp_path: Path) -> None:
    require_folder(tmp_path / "ball")
    assert stat.S_IMODE((tmp_path / "ball").stat().st_mode) == 0o700
    require_folder(tmp_path / "ball")
    (tmp_path / "file").write_text("")
    with pytest.raises(TargetError, match="found a file; expected the name of a folder"):
        require_folder(tmp_path / "file")
    with pytest.raises(TargetError, match="found no folder"):
        require_folder(tmp_path / "absent" / "ball")
