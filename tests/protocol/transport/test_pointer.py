"""The channel from a person's pointer to a device: the latest message counts, and no side waits."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Grasp, Release, Stop
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.pointer import MAX_GRIP_BYTES, PointerInlet, PointerOutlet, pointer_path


def grasp(*position: float) -> Grasp:
    return Grasp(np.array(position))


@pytest.fixture
def inlet(tmp_path: Path) -> Iterator[PointerInlet]:
    with closing(PointerInlet(tmp_path, "dx")) as inlet:
        yield inlet


@pytest.fixture
def outlet(tmp_path: Path) -> Iterator[PointerOutlet]:
    with closing(PointerOutlet(tmp_path, "dx")) as outlet:
        yield outlet


def test_the_latest_word_counts(inlet: PointerInlet, outlet: PointerOutlet) -> None:
    assert inlet.latest() is None
    for word in (grasp(0.1), Release(), grasp(0.2, -0.3)):
        assert outlet.send(word)
    assert inlet.latest() == grasp(0.2, -0.3)
    assert inlet.latest() is None
    assert outlet.send(Release())
    assert inlet.latest() == Release()
    assert inlet.malformed == 0


def test_nobody_there(tmp_path: Path, outlet: PointerOutlet) -> None:
    assert outlet.send(Release()) is False
    inlet = PointerInlet(tmp_path, "dx")
    assert outlet.send(Release()) is True
    inlet.close()
    assert outlet.send(Release()) is False


def test_a_process_that_was_killed_leaves_a_file_and_nobody(tmp_path: Path, outlet: PointerOutlet) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as killed:
        killed.bind(str(pointer_path(tmp_path, "dx")))
    assert outlet.send(Release()) is False
    with closing(PointerInlet(tmp_path, "dx")) as inlet:  # the device's next process takes its place
        assert outlet.send(grasp(1.0)) is True
        assert inlet.latest() == grasp(1.0)


def test_a_new_inlet_replaces_an_old_one_which_leaves_it_alone(tmp_path: Path, outlet: PointerOutlet) -> None:
    old = PointerInlet(tmp_path, "dx")
    with closing(PointerInlet(tmp_path, "dx")) as new:
        old.close()
        old.close()
        assert outlet.send(grasp(1.0)) is True
        assert new.latest() == grasp(1.0)
    assert list(tmp_path.iterdir()) == []


def test_what_is_neither_grasp_nor_release_is_counted(
    tmp_path: Path, inlet: PointerInlet, outlet: PointerOutlet
) -> None:
    garbage = [b"", b"\xc1", b"\x00" * (MAX_GRIP_BYTES + 100), encode(Stop("no")), encode(grasp(1.0)) + b"x"]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        for frame in garbage:
            stranger.sendto(frame, str(pointer_path(tmp_path, "dx")))
    assert inlet.latest() is None
    assert inlet.malformed == len(garbage)
    assert outlet.send(grasp(0.5))
    assert inlet.latest() == grasp(0.5)


def test_one_look_is_bounded_and_a_full_inlet_holds_nobody_up(inlet: PointerInlet, outlet: PointerOutlet) -> None:
    said = 0
    while outlet.send(grasp(float(said))):
        said += 1
        assert said < 1_000_000
    looks = 0
    last = None
    while (heard := inlet.latest()) is not None:
        last, looks = heard, looks + 1
    assert last == grasp(float(said - 1))  # in the end the latest, however many there were
    assert looks >= said // 16
    assert outlet.send(Release())


def test_in_its_place_something_else(tmp_path: Path, outlet: PointerOutlet) -> None:
    path = pointer_path(tmp_path, "dx")
    path.write_text("no socket")
    assert outlet.send(Release()) is False
    path.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.bind(str(path))
        other.listen()
        assert outlet.send(Release()) is False
    path.unlink()
    path.mkdir()
    assert outlet.send(Release()) is False
    with pytest.raises(TransportError, match="cannot bind"):
        PointerInlet(tmp_path, "dx")


def test_a_closed_end_sends_nothing(tmp_path: Path, inlet: PointerInlet) -> None:
    outlet = PointerOutlet(tmp_path, "dx")
    outlet.close()
    outlet.close()
    assert outlet.send(Release()) is False


@pytest.mark.parametrize("end", [PointerInlet, PointerOutlet])
@pytest.mark.parametrize("name", ["", "a/b", "..", "é", "x" * 200])
def test_names_that_cannot_be(end: type[PointerInlet] | type[PointerOutlet], name: str, tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="found the name"):
        end(tmp_path, name)


@pytest.mark.parametrize("end", [PointerInlet, PointerOutlet])
def test_paths_too_long_and_directories_that_are_not_there(
    end: type[PointerInlet] | type[PointerOutlet], tmp_path: Path
) -> None:
    with pytest.raises(TransportError, match="found a socket path of"):
        end(tmp_path / ("long" * 40), "dx")
    with pytest.raises(TransportError, match="cannot bind"):
        PointerInlet(tmp_path / "none", "dx")
