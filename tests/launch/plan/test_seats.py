"""Seats of a session, the files of a hosting, and that nobody's certificate knows who sits on them."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from manyhands.design.certificate import to_json
from manyhands.design.errors import CertificateError
from manyhands.launch.doctor.colocation import Where, settle_colocation
from manyhands.launch.files import TargetError
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.keys import Keys, ephemeral
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import Prepared, prepare, prepare_again
from manyhands.launch.plan.reach import ReachError, reach
from manyhands.launch.plan.seats import (
    invitations,
    keep_certificates,
    require_folder,
    seat_nodes,
    seat_parts,
    seats_of,
)
from manyhands.launch.plan.topology import roster
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.guest.seat_part import decoded_part
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

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


def test_a_host_carries_the_couplings_of_seats_unless_one_is_of_several_devices() -> None:
    data = ball().to_dict()
    del data["colocate"]
    hosted, reason = settle_colocation(Session.from_dict(data), Where.HOSTED)
    assert (seats_of(hosted), reason) == (seats_of(ball()), "")
    data["devices"]["third"] = data["devices"]["right"]
    data["couplings"] = {"left_seat": data["couplings"]["left_seat"], "both": {"devices": ["right", "third"]}}
    data["environment"]["links"].append({"between": ["third", "ball"], "stiffness": 600, "damping": 0.5})
    shared, _ = settle_colocation(Session.from_dict(data), Where.HOSTED)
    words = (
        "ball: found the coupling 'both' of the devices right, third, with the seat 'left_seat'; expected couplings of"
    )
    with pytest.raises(ReachError, match=words):
        seats_of(shared)


def test_an_invitation_and_what_its_guest_fetches_hold_its_own_seat_and_nothing_of_the_others(
    prepared: Prepared, keys: Keys
) -> None:
    found = invitations(prepared, keys, "ball.example.org:7400")
    assert found.keys() == seats_of(ball()).keys()
    invitation = found["right_seat"]
    assert (invitation.session, invitation.seat, invitation.device) == ("ball", "right_seat", "right")
    assert invitation.address == "ball.example.org:7400"
    assert (invitation.hub, invitation.pair) == (keys.pair("supervisor").public, keys.pair("right"))
    sent = seat_parts(prepared, keys)
    assert sent.keys() == {"left", "right"}
    text = sent["right"].decode()
    assert "left" not in text
    for other in ("left", "left_seat", "environment", "supervisor", "right"):
        assert keys.pair(other).secret not in text
    part = decoded_part(sent["right"], invitation)
    assert part.pairs == {name: keys.pair(name) for name in ("right", "right_seat")}
    assert set(part.coupling.common.public) == {"right_seat", "environment", "supervisor"}


def test_a_second_hosting_writes_the_same_bytes(prepared: Prepared, keys: Keys, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    sent = []
    for folder in (first, second):
        require_folder(folder)
        keep_certificates(prepared, folder)
        again = prepare(ball(), folder / CERTIFICATE_FILE)
        sent.append((invitations(again, keys, "192.0.2.7:7400"), seat_parts(again, keys)))
    assert sent[0] == sent[1]
    names = sorted(path.name for path in first.iterdir())
    assert names == ["certificate.json", "certificate.left_seat.json", "certificate.right_seat.json"]
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


def ids(session: Session, keys: Keys | None = None, prepared: Prepared | None = None) -> dict[str, str]:
    """By node, the id of the certificate that it shares with its peers."""
    planned = prepare(session) if prepared is None else prepared
    ways = reach(planned, "tcp", keys=keys)
    bundles = cut(planned, RunPlan(REALTIME, None, "", reach=ways))
    for peer in bundles["environment"].common.peers:
        assert peer.certificate == bundles[peer.name].common.certificate
    return {name: bundle.common.certificate for name, bundle in bundles.items()}


def test_a_seat_shares_an_id_with_its_own_device_alone(prepared: Prepared, keys: Keys) -> None:
    found = ids(ball(), keys, prepared)
    assert found["left"] == found["left_seat"]
    assert found["right"] == found["right_seat"]
    assert len(set(found.values())) == 3
    assert found["environment"] == prepared.id
    assert ids(ball(), None, prepared) == found  # keys, and where others are, are no part of it


@pytest.mark.parametrize(
    ("override", "changed"),
    [
        ("environment.masses.ball=0.8", set()),
        ("devices.left.hand.force=0", {"left_seat"}),
        ("devices.left.limits.force=5", {"left_seat"}),
        ("couplings.right_seat.wave_link.b=12", {"right_seat"}),
        ("couplings.right_seat.wave_link.interval=0.002", {"right_seat"}),
        ("devices.right.osp=1.5", {"right_seat"}),
    ],
)
def test_a_change_gives_a_new_id_to_the_seats_that_it_concerns(
    prepared: Prepared, override: str, changed: set[str]
) -> None:
    before, after = ids(ball(), None, prepared), ids(ball(override))
    assert {seat for seat in seats_of(ball()) if before[seat] != after[seat]} == changed


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("environment.masses.ball=0.5", ()),
        ("environment.masses.ball=0.8", ("environment",)),
        ("devices.right.limits.force=5", ()),
        ("devices.right.osp=1.5", ("right_seat",)),
        ("couplings.right_seat.wave_link.b=12", ("right_seat", "environment")),
    ],
)
def test_only_what_has_changed_is_designed_anew(
    prepared: Prepared, tmp_path: Path, override: str, expected: tuple[str, ...]
) -> None:
    keep_certificates(prepared, tmp_path)
    again, renewed = prepare_again(ball(override), tmp_path / CERTIFICATE_FILE)
    assert renewed == expected
    kept = {seat for seat in seats_of(ball()) if again.parts[seat].id == prepared.parts[seat].id}
    assert kept == seats_of(ball()).keys() - set(expected)
    whole = prepare(ball(override))
    assert again.id == whole.id


def test_a_certificate_that_was_tampered_with_is_not_replaced_silently(prepared: Prepared, tmp_path: Path) -> None:
    keep_certificates(prepared, tmp_path)
    file = tmp_path / "certificate.left_seat.json"
    data = json.loads(file.read_text())
    data["levels"]["Delta_V"] = [[[1000.0]]]
    file.write_text(json.dumps(data))
    with pytest.raises((NotCertified, CertificateError)):
        prepare_again(ball(), tmp_path / CERTIFICATE_FILE)


def test_the_folder_of_a_hosting(tmp_path: Path) -> None:
    require_folder(tmp_path / "ball")
    assert stat.S_IMODE((tmp_path / "ball").stat().st_mode) == 0o700
    require_folder(tmp_path / "ball")
    (tmp_path / "file").write_text("")
    with pytest.raises(TargetError, match="found a file; expected the name of a folder"):
        require_folder(tmp_path / "file")
    with pytest.raises(TargetError, match="found no folder"):
        require_folder(tmp_path / "absent" / "ball")
