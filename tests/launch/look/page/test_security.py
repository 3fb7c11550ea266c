"""Access to the page: names of the host, origins, tokens, and the files that hold tokens."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from manyhands.launch.look.page.security import (
    HEADERS,
    LEAST_TOKEN,
    Doorstep,
    Token,
    ViewError,
    is_loopback,
    new_token,
    read_token,
)

LOOPBACK = Doorstep("127.0.0.1", 8000)
OUTSIDE = Doorstep("0.0.0.0", 8000)


def host(text: str) -> list[tuple[bytes, bytes]]:
    return [(b"host", text.encode())]


@pytest.mark.parametrize("text", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000", "127.3.2.1:8000"])
def test_loopback_is_ours(text: str) -> None:
    assert LOOPBACK.host_is_ours(host(text))
    assert OUTSIDE.host_is_ours(host(text))


@pytest.mark.parametrize(
    "text",
    [
        "evil.example:8000",  # a name that was made to lead here
        "127.0.0.1.evil.example:8000",
        "localhost.evil.example:8000",
        "127.0.0.1",  # another port
        "127.0.0.1:8001",
        "evil@127.0.0.1:8000",
        "127.0.0.1:8000/evil",
        "127.0.0.1:port",
        "[::1:8000",
        "",
    ],
)
def test_other_names_are_not(text: str) -> None:
    assert not LOOPBACK.host_is_ours(host(text))
    assert not OUTSIDE.host_is_ours(host(text))


def test_outside_any_address_and_the_own_name_are_ours() -> None:
    assert OUTSIDE.host_is_ours(host("192.0.2.7:8000"))
    assert OUTSIDE.host_is_ours(host(f"{socket.gethostname()}:8000"))
    assert not LOOPBACK.host_is_ours(host("192.0.2.7:8000"))


def test_a_missing_or_repeated_host_is_refused() -> None:
    assert not LOOPBACK.host_is_ours([])
    assert not LOOPBACK.host_is_ours(host("localhost:8000") * 2)


def test_a_socket_is_opened_by_this_page_alone() -> None:
    named = host("localhost:8000")
    assert LOOPBACK.origin_is_ours([*named, (b"origin", b"http://localhost:8000")])
    for other in (b"http://evil.example", b"https://localhost:8000", b"http://127.0.0.1:8000", b"null"):
        assert not LOOPBACK.origin_is_ours([*named, (b"origin", other)])
    assert not LOOPBACK.origin_is_ours(named)


def test_what_is_loopback() -> None:
    assert all(map(is_loopback, ("127.0.0.1", "127.9.9.9", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.0.2.7", "localhost.example", "")))


def test_a_token_fits_itself_alone_and_is_not_shown() -> None:
    token = new_token()
    assert token.fits(token.reveal())
    assert not any(map(token.fits, (token.reveal() + "x", "", None, 7, "é", "\ud800", [token.reveal()])))
    assert token.reveal() not in repr(token)
    assert new_token().reveal() != token.reveal()


def token_file(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "token"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_token_is_read_from_a_file(tmp_path: Path) -> None:
    token = read_token(token_file(tmp_path, "0123456789abcdef\n"))
    assert isinstance(token, Token)
    assert token.reveal() == "0123456789abcdef"


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o620])
def test_a_file_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(ViewError, match=r"found mode 06.*expected a file that you own"):
        read_token(token_file(tmp_path, "0123456789abcdef", mode))


@pytest.mark.parametrize("text", ["", "a" * (LEAST_TOKEN - 1), "a" * 300, "0123456789 abcdef", "0123456789abcdé"])
def test_a_file_without_a_token_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ViewError, match="expected a token"):
        read_token(token_file(tmp_path, text))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ViewError, match=r"No such file.*expected a file with a token"):
        read_token(tmp_path / "token")


def test_the_policy_allows_no_script_but_the_pages_own() -> None:
    policy = dict(HEADERS)[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
