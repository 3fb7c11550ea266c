"""Keys: which secrets must not leak, which files are trusted, and which text is a key."""

from __future__ import annotations

import copy
import dataclasses
import json
import logging
import os
import pickle
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st
from zmq.utils import z85

from manyhands.protocol.keys import (
    KEY_LENGTH,
    MAX_KEYS,
    MAX_PRIVATE_BYTES,
    KeyFileError,
    KeyPair,
    KeyRing,
    PublicKeys,
    is_key,
    load_private,
    new_pair,
    problem_of_file,
    problem_of_folder,
    ring_of,
    save_private,
)
from manyhands.protocol.limits import MAX_NAME

from ..support.cases import cases

NAMES = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=MAX_NAME)


@pytest.fixture
def pair() -> KeyPair:
    return new_pair()


@pytest.fixture
def path(tmp_path: Path, pair: KeyPair) -> Path:
    """The private key of dx in session s."""
    file = tmp_path / "dx.key"
    save_private(pair, "s", "dx", file)
    return file


@pytest.fixture
def umask() -> Iterator[Callable[[int], int]]:
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o7777


def forms(secret: str) -> tuple[str, ...]:
    """A secret as it might appear in a text: as it is, as JSON or repr would write it, and its bytes in three ways."""
    raw = z85.decode(secret)
    return (secret, json.dumps(secret)[1:-1], repr(secret)[1:-1], raw.hex(), repr(raw)[2:-1], str(list(raw))[1:-1])


def told(error: BaseException) -> str:
    """Everything that an exception and its causes carry: text, arguments, attributes."""
    texts = traceback.format_exception(error)
    seen: BaseException | None = error
    while seen is not None:
        texts += [repr(seen), str(seen), repr(seen.args), repr(vars(seen))]
        # what the errors of JSON and of decoding carry is in slots of their own
        texts += [repr(getattr(seen, name, None)) for name in ("doc", "object", "obj", "value", "filename")]
        seen = seen.__cause__ or seen.__context__
    return "\n".join(texts)


# --- a pair


def test_a_pair_is_libzmqs(pair: KeyPair) -> None:
    assert zmq.curve_public(pair.secret.encode()).decode() == pair.public
    assert is_key(pair.public)
    assert is_key(pair.secret)
    assert new_pair() != pair


def test_what_is_no_pair_is_refused(pair: KeyPair) -> None:
    other = new_pair()
    for public, secret in ((other.public, pair.secret), (pair.secret, pair.public), (pair.public, pair.public)):
        with pytest.raises(ValueError, match="does not belong to the secret"):
            KeyPair(public, secret)
    for public, secret in ((pair.public[:-1], pair.secret), (pair.public, pair.secret + "0"), (pair.public, "")):
        with pytest.raises(ValueError, match="40 characters of Z85") as caught:
            KeyPair(public, secret)
        assert pair.secret not in told(caught.value)


def test_the_secret_is_not_shown_pickled_or_copied(pair: KeyPair, caplog: pytest.LogCaptureFixture) -> None:
    ring = KeyRing("dx", pair, {"cx": new_pair().public})
    logging.getLogger("keys").warning("%s %r %s", pair, ring, [pair])
    shown = [caplog.text]
    for value in (pair, ring, [pair], {"a": pair}, (ring,)):
        shown += [repr(value), str(value), f"{value}", f"{value!r:>80}", format(value), ascii(value)]
    assert all(form not in text for text in shown for form in forms(pair.secret))
    assert pair.public in repr(pair)  # so that the absence above means something
    refused: list[Callable[[], object]] = [
        *(lambda v=v, p=p: pickle.dumps(v, p) for v in (pair, ring) for p in range(pickle.HIGHEST_PROTOCOL + 1)),
        *(lambda v=v: copy.deepcopy(v) for v in (pair, ring)),
        lambda: copy.copy(pair),
        lambda: dataclasses.asdict(ring),
        lambda: pair.__getstate__(),
        lambda: pair.__reduce_ex__(4),
        lambda: dataclasses.asdict(pair),  # type: ignore[call-overload]  # what a caller without types might try
        lambda: json.dumps(pair),
        lambda: vars(pair),
    ]
    for attempt in refused:
        with pytest.raises(TypeError) as caught:
            attempt()
        assert all(form not in told(caught.value) for form in forms(pair.secret))


def test_a_pair_is_equal_by_its_public_key(pair: KeyPair) -> None:
    again = KeyPair(pair.public, pair.secret)
    assert again == pair
    assert hash(again) == hash(pair)
    assert pair != new_pair()
    assert pair != pair.public
    with pytest.raises(AttributeError):
        pair.secret = "x"  # type: ignore[misc]


def test_without_curve_one_clear_error(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    monkeypatch.setattr(zmq, "has", lambda _feature: False)
    for attempt in (new_pair, lambda: load_private(path, "s", "dx")):
        with pytest.raises(KeyFileError, match=r"found one without CURVE; expected one with it; install"):
            attempt()


# --- what is a key


@given(st.binary(min_size=32, max_size=32))
def test_every_32_bytes_are_a_key(raw: bytes) -> None:
    assert is_key(z85.encode(raw).decode())


@settings(max_examples=cases(100, 300))
@given(st.text(max_size=50) | st.text(z85.Z85CHARS.decode(), min_size=38, max_size=42))
def test_a_key_is_what_decodes_to_32_bytes(text: str) -> None:
    """Against libzmq's own rule, written out: 40 digits of base 85, five to a number below 2**32."""
    digits = [z85.Z85CHARS.decode().find(c) for c in text]
    numbers = [sum(d * 85 ** (4 - i) for i, d in enumerate(digits[at : at + 5])) for at in range(0, len(digits), 5)]
    assert is_key(text) == (len(text) == 40 and min(digits) >= 0 and max(numbers) < 2**32)


@pytest.mark.parametrize("value", [None, 40, b"0" * 40, ["0"] * 40, "é" * 40, "#" * 40, "0" * 39 + "\n", "0" * 41])
def test_what_is_no_key(value: object) -> None:
    assert not is_key(value)


# --- private files


@settings(max_examples=30)
@given(session=NAMES, name=NAMES)
def test_a_private_key_reads_back(tmp_path: Path, session: str, name: str) -> None:
    pair, file = new_pair(), tmp_path / "a.key"
    save_private(pair, session, name, file)
    assert file.stat().st_size <= MAX_PRIVATE_BYTES
    assert load_private(file, session, name).secret == pair.secret
    file.unlink()


def test_the_longest_names_fit(tmp_path: Path, pair: KeyPair) -> None:
    longest = "\U0001f44b" * MAX_NAME  # twelve bytes each in JSON
    save_private(pair, longest, longest, tmp_path / "a.key")
    assert load_private(tmp_path / "a.key", longest, longest) == pair


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o277, 0o777])
def test_modes_do_not_depend_on_the_umask(
    tmp_path: Path, umask: Callable[[int], int], pair: KeyPair, mask: int
) -> None:
    umask(mask)
    save_private(pair, "s", "dx", tmp_path / "dx.key")
    PublicKeys("s", {"dx": pair.public}).save(tmp_path / "public.json")
    assert mode(tmp_path / "dx.key") == 0o600
    assert mode(tmp_path / "public.json") == 0o644


def test_a_private_key_is_never_wider_than_its_mode(
    tmp_path: Path, umask: Callable[[int], int], monkeypatch: pytest.MonkeyPatch, pair: KeyPair
) -> None:
    """Looked at when it is made, and before anything is written: a mode narrowed afterwards would come too late."""
    umask(0o000)
    seen: list[tuple[int, int]] = []
    fchmod = os.fchmod

    def look(descriptor: int, wanted: int) -> None:
        status = os.fstat(descriptor)
        seen.append((status.st_mode & 0o7777, status.st_size))
        fchmod(descriptor, wanted)

    monkeypatch.setattr(os, "fchmod", look)
    save_private(pair, "s", "dx", tmp_path / "dx.key")
    assert seen == [(0o600, 0)]


def test_nothing_is_overwritten_and_no_link_followed(tmp_path: Path, path: Path, pair: KeyPair) -> None:
    target = tmp_path / "elsewhere"
    links = [tmp_path / "dangling.key", tmp_path / "pointing.key"]
    links[0].symlink_to(tmp_path / "nowhere")
    links[1].symlink_to(target)
    target.write_text("mine")
    before = path.read_bytes()
    for taken in (path, *links):
        with pytest.raises(FileExistsError):
            save_private(new_pair(), "s", "dx", taken)
    assert path.read_bytes() == before
    assert target.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


def test_a_private_key_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pair: KeyPair
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        save_private(pair, "s", "dx", tmp_path / "dx.key")
    assert not list(tmp_path.iterdir())


def test_improper_names_are_not_written(tmp_path: Path, pair: KeyPair) -> None:
    for session, name in (("", "dx"), ("s", ""), ("s", "d\n"), ("s" * (MAX_NAME + 1), "dx")):
        with pytest.raises(ValueError, match="no proper name"):
            save_private(pair, session, name, tmp_path / "a.key")
    assert not list(tmp_path.iterdir())


def refusal(path: Path, session: str = "s", name: str = "dx", secret: str = "") -> str:
    """The one sentence with which a private key is refused, which names the file and does not quote it."""
    with pytest.raises(KeyFileError) as caught:
        load_private(path, session, name)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    if secret:
        assert all(form not in told(caught.value) for form in forms(secret))
    return text


@pytest.mark.parametrize("bits", [0o640, 0o604, 0o620, 0o602, 0o610, 0o601, 0o644, 0o660, 0o777])
def test_a_file_that_others_can_open_is_refused(path: Path, pair: KeyPair, bits: int) -> None:
    path.chmod(bits)
    assert f"found mode {bits:04o}, which lets others in; expected 0600; do chmod 600" in refusal(
        path, secret=pair.secret
    )
    path.chmod(0o400)
    assert load_private(path, "s", "dx") == pair


def test_what_is_not_a_file_is_refused(tmp_path: Path, path: Path, pair: KeyPair) -> None:
    link = tmp_path / "link.key"
    link.symlink_to(path)
    assert "found a link; expected the file itself" in refusal(link, secret=pair.secret)
    assert "found no file" in refusal(tmp_path / "absent.key")
    assert "other than a file" in refusal(tmp_path)
    pipe = tmp_path / "pipe.key"
    os.mkfifo(pipe, 0o600)  # opened as a file is, it would wait for a writer for ever
    assert "other than a file" in refusal(pipe)
    assert "cannot be read: Not a directory" in refusal(path / "dx.key")


def test_a_file_of_another_user_is_refused(monkeypatch: pytest.MonkeyPatch, path: Path, pair: KeyPair) -> None:
    owner = path.stat().st_uid
    if owner == 0:
        os.chown(path, 4711, -1)
        owner = 4711
    else:
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    assert f"found a file of user {owner}; expected one of user" in refusal(path, secret=pair.secret)


@pytest.mark.parametrize(
    ("user", "owner", "private", "bits", "refused"),
    [
        (1000, 1000, True, 0o100600, False),
        (1000, 0, True, 0o100600, False),  # put there by the administrator
        (1000, 1001, True, 0o100600, True),
        (0, 1000, True, 0o100600, True),  # its owner could have put a different key in it
        (1000, 1000, True, 0o100640, True),
        (1000, 1000, True, 0o100601, True),
        (1000, 1000, True, 0o120600, True),
        (1000, 1001, False, 0o100644, False),
        (1000, 1000, False, 0o100664, True),
        (1000, 1000, False, 0o100646, True),
        (1000, 1000, False, 0o010644, True),
    ],
)
def test_which_files_are_trusted(user: int, owner: int, private: bool, bits: int, refused: bool) -> None:
    status = os.stat_result((bits, 1, 1, 1, owner, owner, 0, 0, 0, 0))
    assert (problem_of_file(status, user, private=private) is not None) == refused


@pytest.mark.parametrize(
    ("owner", "private", "bits", "refused"),
    [
        (1000, True, 0o040700, False),
        (0, True, 0o040700, False),
        (1001, True, 0o040700, True),
        (1000, True, 0o040710, True),
        (1000, True, 0o040701, True),
        (1000, True, 0o120700, True),
        (1000, False, 0o040755, False),
        (1000, False, 0o040775, True),
        (1000, False, 0o041777, True),
        (1001, False, 0o040755, True),
    ],
)
def test_which_folders_are_trusted(owner: int, private: bool, bits: int, refused: bool) -> None:
    status = os.stat_result((bits, 1, 1, 1, owner, owner, 0, 0, 0, 0))
    assert (problem_of_folder(status, 1000, private=private) is not None) == refused


def test_another_session_or_process_is_refused_without_quoting(path: Path, pair: KeyPair) -> None:
    assert "found a key of another session; expected one of 'other'" in refusal(
        path, session="other", secret=pair.secret
    )
    assert "found the key of another process; expected that of 'dy'" in refusal(path, name="dy", secret=pair.secret)


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(public=new_pair().public), "does not belong to the secret"),
        (lambda d: d.update(secret=new_pair().secret), "does not belong to the secret"),
        (lambda d: d.update(public=d["secret"], secret=d["public"]), "does not belong to the secret"),
        (lambda d: d.update(secret=d["secret"][:-1]), "40 characters of Z85"),
        (lambda d: d.update(secret=[d["secret"]]), "40 characters of Z85"),
        (lambda d: d.update(public=None), "40 characters of Z85"),
        (lambda d: d.pop("secret"), "other members"),
        (lambda d: d.update({d["secret"]: 1}), "other members"),
        (lambda d: d.update(session=d["secret"]), "another session"),
        (lambda d: d.update(name=d["secret"]), "another process"),
        (lambda d: d.update(format=d["secret"]), "no file of manyhands private key"),
        (lambda d: d.pop("format"), "no file of manyhands private key"),
        (lambda d: d.update(version=2), "another version"),
        (lambda d: d.update(version=True), "another version"),
        (lambda d: d.update(version=d["secret"]), "another version"),
    ],
)
def test_a_changed_file_is_refused_without_quoting(
    path: Path, pair: KeyPair, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    rewritten(path, change)
    assert said in refusal(path, secret=pair.secret)


def test_every_truncation_is_refused_without_quoting(path: Path, pair: KeyPair) -> None:
    content = path.read_bytes()
    for length in range(len(content) - 1):  # without the line's end it is whole
        path.write_bytes(content[:length])
        assert "found no file of manyhands private key" in refusal(path, secret=pair.secret)


@settings(max_examples=cases(50, 200))
@given(data=st.data())
def test_no_damage_shows_the_secret(path: Path, pair: KeyPair, data: st.DataObject) -> None:
    """Whatever becomes of single bytes: it is read as the same key, or refused without a trace of it."""
    content = path.read_bytes()
    at = data.draw(st.integers(0, len(content) - 1))
    byte = data.draw(st.binary(max_size=3))
    path.write_bytes(content[:at] + byte + content[at + data.draw(st.integers(0, 2)) :])
    said = ""
    try:
        found = load_private(path, "s", "dx").public
    except KeyFileError as error:
        found, said = pair.public, told(error)
    path.write_bytes(content)
    assert found == pair.public
    assert all(form not in said for form in forms(pair.secret))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00" * 100,
        b"\xff\xfe\x00",
        b"[" * MAX_PRIVATE_BYTES,
        b'{"a":' * 800,
        b"[]",
        b"null",
        b"1" * MAX_PRIVATE_BYTES,
        b"NaN",
        b"-----BEGIN OPENSSH PRIVATE KEY-----",
    ],
)
def test_garbage_is_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert "found no file of manyhands private key" in refusal(path)


def test_a_member_given_twice_is_refused(path: Path, pair: KeyPair) -> None:
    path.write_text(path.read_text().replace('"name"', '"name": "dy", "name"'))
    assert "found no file of manyhands private key" in refusal(path, secret=pair.secret)


def test_a_file_too_long_is_refused_unread(path: Path, pair: KeyPair) -> None:
    content = path.read_bytes()
    path.write_bytes(content + b" " * (MAX_PRIVATE_BYTES - len(content)))
    assert load_private(path, "s", "dx") == pair
    path.write_bytes(content + b" " * (MAX_PRIVATE_BYTES + 1 - len(content)))
    assert f"found {MAX_PRIVATE_BYTES + 1} bytes; expected at most {MAX_PRIVATE_BYTES}" in refusal(path)
    os.truncate(path, 2**40)  # takes no room on the disk, but would in memory
    assert f"found {2**40} bytes" in refusal(path)


def test_a_file_that_grows_is_read_no_further(path: Path, pair: KeyPair, monkeypatch: pytest.MonkeyPatch) -> None:
    fstat, content = os.fstat, path.read_bytes()

    def before_it_grew(descriptor: int) -> os.stat_result:
        status = fstat(descriptor)
        path.write_bytes(content + b" " * MAX_PRIVATE_BYTES)
        return status

    monkeypatch.setattr(os, "fstat", before_it_grew)
    assert f"found more than {MAX_PRIVATE_BYTES} bytes" in refusal(path, secret=pair.secret)


# --- public keys


@settings(max_examples=50)
@given(session=NAMES, names=st.lists(NAMES, unique=True, max_size=8), raw=st.binary(min_size=28, max_size=28))
def test_public_keys_read_back(tmp_path: Path, session: str, names: list[str], raw: bytes) -> None:
    texts = [z85.encode(raw + i.to_bytes(4, "big")).decode() for i in range(len(names))]
    public = PublicKeys(session, dict(zip(names, texts, strict=True)))
    public.save(tmp_path / "public.json")
    assert PublicKeys.load(tmp_path / "public.json") == public
    assert [path.name for path in tmp_path.iterdir()] == ["public.json"]


def test_as_many_keys_as_there_may_be(tmp_path: Path) -> None:
    def key(i: int) -> str:
        return z85.encode(i.to_bytes(32, "big")).decode()

    longest = {f"{i:04}" + "\U0001f44b" * (MAX_NAME - 4): key(i) for i in range(MAX_KEYS)}
    public = PublicKeys("s", longest)
    public.save(tmp_path / "public.json")
    assert PublicKeys.load(tmp_path / "public.json") == public
    with pytest.raises(ValueError, match=f"found {MAX_KEYS + 1} keys; expected at most {MAX_KEYS}"):
        PublicKeys("s", {**longest, "dx": key(MAX_KEYS)})


def test_public_keys_cannot_be_changed_afterwards(pair: KeyPair) -> None:
    given_keys = {"dx": pair.public}
    public = PublicKeys("s", given_keys)
    given_keys["dy"] = "nothing"
    assert dict(public.keys) == {"dx": pair.public}
    with pytest.raises(TypeError):
        public.keys["dy"] = pair.public  # type: ignore[index]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"dx": "no key"}, "found no public key for 'dx'; expected 40 characters of Z85"),
        ({"dx": 7}, "found no public key for 'dx'"),
        ({"": "0" * 40}, "other than a name"),
        ({"a\nb": "0" * 40}, "other than a name"),
        ({"dx": "0" * 40, "dy": "0" * 40}, "found the same public key for 'dx' and 'dy'"),
        (["dx"], "found no mapping"),
    ],
)
def test_invalid_public_keys_are_refused_in_memory_and_in_files(tmp_path: Path, keys: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PublicKeys("s", keys)
    file = tmp_path / "public.json"
    PublicKeys("s", {}).save(file)
    rewritten(file, lambda data: data.update(keys=keys))
    with pytest.raises(KeyFileError, match=said):
        PublicKeys.load(file)


def test_a_private_key_is_no_public_file(path: Path, pair: KeyPair) -> None:
    with pytest.raises(KeyFileError, match="found no file of manyhands public keys") as caught:
        PublicKeys.load(path)
    assert all(form not in told(caught.value) for form in forms(pair.secret))


def test_public_keys_that_others_can_write_are_refused(tmp_path: Path, pair: KeyPair) -> None:
    file, link = tmp_path / "public.json", tmp_path / "link.json"
    PublicKeys("s", {"dx": pair.public}).save(file)
    link.symlink_to(file)
    assert PublicKeys.load(link).keys == {"dx": pair.public}  # what is public may be found through a link
    for bits in (0o664, 0o646):
        file.chmod(bits)
        with pytest.raises(KeyFileError, match=f"found mode {bits:04o}, which lets others add keys"):
            PublicKeys.load(file)


def test_public_keys_are_replaced_whole_or_not_at_all(
    tmp_path: Path, pair: KeyPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, target = tmp_path / "public.json", tmp_path / "target"
    PublicKeys("s", {"dx": pair.public}).save(file)
    before = file.read_bytes()
    # a link where the new content is to be written does not lead it elsewhere
    target.write_text("mine")
    (tmp_path / ".public.json.part").symlink_to(target)
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(5, "Input/output error")))
        with pytest.raises(OSError, match="Input/output"):
            PublicKeys("s", {}).save(file)
    assert file.read_bytes() == before
    assert target.read_text() == "mine"
    assert {path.name for path in tmp_path.iterdir()} == {"public.json", "target"}
    PublicKeys("s", {}).save(file)
    assert PublicKeys.load(file) == PublicKeys("s", {})


# --- rings


def test_a_ring_holds_its_peers_and_nobody_else(pair: KeyPair) -> None:
    others = {name: new_pair().public for name in ("cx", "cy", "supervisor")}
    ring = ring_of("dx", pair, PublicKeys("s", {"dx": pair.public, **others}), ["cx", "supervisor"])
    assert ring == KeyRing("dx", pair, {"cx": others["cx"], "supervisor": others["supervisor"]})
    # a machine of its own need not know more than the peers
    assert ring_of("dx", pair, PublicKeys("s", {"cx": others["cx"]}), ["cx"]).peers == {"cx": others["cx"]}
    with pytest.raises(TypeError):
        ring.peers["cy"] = others["cy"]  # type: ignore[index]


def test_a_ring_that_cannot_be_made_names_whose_key(pair: KeyPair) -> None:
    other = new_pair().public
    with pytest.raises(
        KeyFileError, match="s: found no public key of 'cx', which 'dx' talks to; expected one; make it"
    ):
        ring_of("dx", pair, PublicKeys("s", {"dx": pair.public}), ["cx"])
    with pytest.raises(KeyFileError, match="found another public key of 'dx' than the one of its pair"):
        ring_of("dx", pair, PublicKeys("s", {"dx": other}), [])
    with pytest.raises(KeyFileError, match="found the same public key for 'cx' and 'dx'"):
        ring_of("dx", pair, PublicKeys("s", {"cx": pair.public}), ["cx"])
    with pytest.raises(KeyFileError, match="among its own peers"):
        ring_of("dx", pair, PublicKeys("s", {"dx": pair.public}), ["dx"])
    with pytest.raises(ValueError, match="found no public key for 'cx'"):
        KeyRing("dx", pair, {"cx": "0" * (KEY_LENGTH - 1)})
