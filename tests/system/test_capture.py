"""What an eavesdropper on the network can read: nothing of a session with keys, everything without keys."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ..support import distinctive_session
from ..support.capture import Capture, IncompleteCapture, Segment, free_ports, reassembled
from ..support.commands import run
from ..support.patterns import Patterns, is_distinctive

SECONDS = "0.4"
PORTS = 24  # one for the hub, one for each link, and some to spare
GREETING_MECHANISM = slice(12, 32)  # of the first bytes of each side of a ZMTP 3 connection


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session file, its certificate, and its keys."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "session.yaml").write_text(distinctive_session.as_file(distinctive_session.session()))
    run("design", folder / "session.yaml", "-o", folder / "certificate.json")
    run("invite", folder / "session.yaml", "--keys", folder / "keys")
    return folder


@dataclass(frozen=True)
class Captured:
    """A session and its captured traffic.

    Attributes:
        directions: all that was sent, by connection and direction.
        signals: every x and f_v that the session's own recording has.
        certificate: the id of its certificate.
    """

    directions: list[bytes]
    signals: np.ndarray
    certificate: str

    def contains(self, patterns: Patterns) -> set[str]:
        return set().union(*(patterns.found_in([data]) for data in self.directions))

    @property
    def mechanisms(self) -> set[bytes]:
        return {data[GREETING_MECHANISM].rstrip(b"\0") for data in self.directions}


def captured(folder: Path, *options: str | Path) -> Captured:
    ports, record = free_ports(PORTS), folder / "run.npz"
    with Capture(ports) as capture:
        run(
            *("launch", folder / "session.yaml", "--certificate", folder / "certificate.json"),
            *("--transport", "tcp", "--listen", f"127.0.0.1:{ports[0]}", "--clock", "simulated"),
            *("--duration", SECONDS, "--record", record, *options),
        )
        directions = [data for data in capture.finish().values() if data]
    with np.load(record) as recording:
        signals = np.concatenate([recording["x"].ravel(), recording["f_v"].ravel()])
        certificate = str(recording["certificate"])
    record.unlink()
    return Captured(directions, signals, certificate)


def values(signals: np.ndarray, form: str) -> dict[bytes, str]:
    """The values that hardly occur by accident, as they are sent."""
    return {struct.pack(form, value): f"{value!r} ({form})" for value in signals.tolist() if is_distinctive(value)}


@pytest.mark.long
@pytest.mark.alone
def test_a_capture_shows_insecure_sessions_whole_and_keyed_ones_not(folder: Path) -> None:
    keyed = captured(folder, "--keys", folder / "keys")
    plain = captured(folder, "--insecure")

    np.testing.assert_array_equal(keyed.signals, plain.signals)  # what is looked for in both
    sent = values(plain.signals, "<d")
    assert len(sent) > 2000
    node_names = (*distinctive_session.DEVICES, *distinctive_session.COUPLINGS, distinctive_session.ENVIRONMENT)
    said = {text.encode(): text for text in (distinctive_session.NAME, *node_names, plain.certificate)}

    assert plain.mechanisms == {b"NULL"}
    assert plain.contains(Patterns({**sent, **said})) == {*sent.values(), *said.values()}

    links, nodes = 6, 7
    assert len(keyed.directions) >= 2 * (links + nodes)
    assert sum(map(len, keyed.directions)) > sum(map(len, plain.directions))
    assert keyed.mechanisms == {b"CURVE"}
    assert keyed.contains(Patterns({**sent, **values(keyed.signals, ">d"), **said})) == set()


SYN, ACK, FIN = 0x02, 0x10, 0x01


def test_sent_bytes_are_found_however_cut_and_in_any_order() -> None:
    value = struct.pack("<d", 0.12345678901234567)
    segments = [
        Segment(3, 5000, ACK, 6, value[4:] + b"-end"),
        Segment(3, 5000, SYN, 0, b""),
        Segment(3, 5000, ACK, 1, b"-" + value[:4]),
        Segment(3, 6000, SYN | ACK, 0, b""),
        Segment(3, 5000, ACK, 4, value[2:] + b"-"),  # a part once more
        Segment(3, 5000, FIN | ACK, 14, b""),
        Segment(3, 6000, ACK, 1, b"answer"),
    ]
    directions = reassembled(segments)
    assert directions == {(3, 5000): b"-" + value + b"-end", (3, 6000): b"answer"}
    assert Patterns({value: "it"}).found_in(directions.values()) == {"it"}


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_capture_with_a_hole_proves_nothing(lost: int) -> None:
    segments = [
        Segment(0, 5000, SYN, 0, b""),
        Segment(0, 5000, ACK, 1, b"abcd"),
        Segment(0, 5000, ACK, 5, b"efgh"),
        Segment(0, 5000, FIN | ACK, 9, b""),
    ]
    with pytest.raises(IncompleteCapture):
        reassembled(segments[:lost] + segments[lost + 1 :])
