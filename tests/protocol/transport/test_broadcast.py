"""The broadcast: one process sends, any number receive, and the sender waits for none of them."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from manyhands.protocol.clock import Duration, from_seconds
from manyhands.protocol.limits import LINK_QUEUE_FRAMES, MAX_CONTROL_BYTES
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.broadcast import BROADCAST, Broadcast, Visit, await_any

LONG = from_seconds(60.0)
NOT_AT_ALL = Duration(0)


@pytest.fixture
def broadcast(tmp_path: Path) -> Iterator[Broadcast]:
    with closing(Broadcast(tmp_path)) as broadcast:
        yield broadcast


@pytest.fixture
def visitor(tmp_path: Path, broadcast: Broadcast) -> Iterator[Visit]:
    with closing(enter(tmp_path, broadcast)) as visit:
        yield visit


def enter(directory: Path, broadcast: Broadcast) -> Visit:
    """Join so that every later frame arrives."""
    visit = Visit(directory)
    greet(broadcast, visit)
    return visit


def greet(broadcast: Broadcast, visit: Visit) -> None:
    """Broadcast a frame repeatedly until it is received, and then discard the remaining copies."""
    for _ in range(60_000):
        broadcast.show(b"hello")
        if visit.recv(from_seconds(0.001)) is not None:
            break
    else:
        pytest.fail("a visit did not come about in a minute")
    broadcast.show(b"that is all")
    while visit.recv(LONG) != b"that is all":
        pass


def assert_ended(stranger: socket.socket) -> None:
    """The other end closes the connection: it takes nobody for a peer of an old version, to which frames would go."""
    stranger.settimeout(60.0)
    try:
        while stranger.recv(4096):
            pass
    except ConnectionResetError:  # it was closed with bytes unread
        pass


def test_frames_keep_their_order_and_borders(broadcast: Broadcast, visitor: Visit) -> None:
    frames = [b"", b"a", b"ab", bytes(MAX_CONTROL_BYTES), b"\x00" * 3, *(b"%d" % n for n in range(50))]
    for frame in frames:
        broadcast.show(frame)
    assert [visitor.recv(LONG) for _ in frames] == frames
    assert visitor.recv(NOT_AT_ALL) is None


def test_too_long_is_an_error_where_it_is_made(broadcast: Broadcast, visitor: Visit) -> None:
    with pytest.raises(ValueError, match=f"expected at most {MAX_CONTROL_BYTES}"):
        broadcast.show(bytes(MAX_CONTROL_BYTES + 1))
    broadcast.show(b"next")
    assert visitor.recv(LONG) == b"next"


def test_who_comes_late_hears_what_follows(tmp_path: Path, broadcast: Broadcast, visitor: Visit) -> None:
    broadcast.show(b"before")
    with closing(enter(tmp_path, broadcast)) as late:
        broadcast.show(b"after")
        assert late.recv(LONG) == b"after"
    assert visitor.recv(LONG) == b"before"


def test_who_comes_before_the_broadcast_hears_it_when_it_is_there(tmp_path: Path) -> None:
    with closing(Visit(tmp_path)) as early:
        assert early.recv(NOT_AT_ALL) is None
        with closing(Broadcast(tmp_path)) as broadcast:
            greet(broadcast, early)


def test_who_leaves_is_not_missed(tmp_path: Path, broadcast: Broadcast, visitor: Visit) -> None:
    other = enter(tmp_path, broadcast)
    other.close()
    other.close()
    while visitor.recv(NOT_AT_ALL) is not None:
        pass
    broadcast.show(b"still here")
    heard = visitor.recv(LONG)
    while heard in (b"hello", b"that is all"):  # frames for the other receiver
        heard = visitor.recv(LONG)
    assert heard == b"still here"


def test_who_stalls_misses_frames_and_holds_nobody_up(tmp_path: Path, broadcast: Broadcast) -> None:
    """Far more than any queue holds is shown to one that does not read, and all of it to one that does."""
    with closing(enter(tmp_path, broadcast)) as stalled, closing(enter(tmp_path, broadcast)) as visitor:
        shown = 20 * LINK_QUEUE_FRAMES
        for number in range(shown):
            frame = b"%d" % number + bytes(10_000)
            broadcast.show(frame)  # returns, however full the other one's queue is
            assert visitor.recv(LONG) == frame
        heard = []
        while (frame_heard := stalled.recv(from_seconds(0.05))) is not None:
            heard.append(frame_heard)
        numbers = [int(frame.rstrip(b"\x00")) for frame in heard if frame not in (b"hello", b"that is all")]
        assert 0 < len(numbers) < shown
        assert numbers == sorted(numbers)


def test_nobody_there_is_no_error(broadcast: Broadcast) -> None:
    for _ in range(2 * LINK_QUEUE_FRAMES):
        broadcast.show(b"to nobody")


def test_any_of_several(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
    with closing(Broadcast(folders[0])) as first, closing(Broadcast(folders[1])) as second:
        with closing(enter(folders[0], first)) as a, closing(enter(folders[1], second)) as b:
            await_any([a, b], NOT_AT_ALL)
            second.show(b"of b")
            await_any([a, b], LONG)
            assert (a.recv(NOT_AT_ALL), b.recv(NOT_AT_ALL)) == (None, b"of b")


def test_closing_leaves_no_file_and_a_second_time_does_nothing(tmp_path: Path) -> None:
    broadcast, visit = Broadcast(tmp_path), Visit(tmp_path)
    assert (tmp_path / BROADCAST).is_socket()
    for _ in range(2):
        broadcast.close()
        visit.close()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(TransportError, match="cannot show at"):
        broadcast.show(b"after the end")
    with pytest.raises(TransportError, match="cannot look on"):
        visit.recv(NOT_AT_ALL)


@pytest.mark.parametrize("end", [Broadcast, Visit])
def test_a_path_that_no_socket_can_have(end: type[Broadcast] | type[Visit], tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="found a socket path of"):
        end(tmp_path / ("long" * 40))


def test_a_directory_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="cannot bind"):
        Broadcast(tmp_path / "none")


def test_a_stranger_at_the_socket_ends_nothing(tmp_path: Path, broadcast: Broadcast, visitor: Visit) -> None:
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.connect(str(tmp_path / BROADCAST))
        stranger.sendall(b"GET / HTTP/1.1\r\n\r\n" * 100)
        broadcast.show(b"undisturbed")
        assert visitor.recv(LONG) == b"undisturbed"
        assert_ended(stranger)
