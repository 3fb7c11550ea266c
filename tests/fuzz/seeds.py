"""The fuzzer's seeds that are made by hand: every byte example of SPEC.md, and a conversation for everything that a
harness has a branch for.

They are made whenever they are needed, and stand in no file. The files of the corpus are what runs of the fuzzer found
worth keeping, named by a digest.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import fuzz_board
import fuzz_codec
import fuzz_conductor
import fuzz_gate
import fuzz_handshake
import fuzz_path
from draws import Dictation, Misdictated
from forger import HOW, KIND_NAMES

import manyhands.protocol

CORPUS: Final = Path(__file__).parent / "corpus"
SPEC: Final = Path(manyhands.protocol.__file__).parent / "SPEC.md"

CHECKS: Final[Mapping[str, Callable[[bytes], None]]] = {
    "codec": fuzz_codec.check,
    "handshake": fuzz_handshake.check,
    "gate": fuzz_gate.check,
    "path": fuzz_path.check,
    "board": fuzz_board.check,
    "conductor": fuzz_conductor.check,
}
"""Every harness by its name."""


def seeds(harness: str) -> dict[str, bytes]:
    """The hand-made seeds of a harness, by name."""
    made = {
        "codec": _codec,
        "handshake": _handshake,
        "gate": _gate,
        "path": _path,
        "board": _board,
        "conductor": _conductor,
    }[harness]
    return {f"{number:02}-{name}": data for number, (name, data) in enumerate(made())}


def _codec() -> Iterator[tuple[str, bytes]]:
    text = SPEC.read_text(encoding="utf-8")
    for name, frame in re.findall(r"^\| `(\w+)\(.*\)` \| `([0-9a-f ]+)` \|$", text, re.MULTILINE):
        yield f"spec-{name}", bytes.fromhex(frame)
    yield "deep-arrays", b"\xdc\x01\x00" * 30
    yield "deep-maps", b"\x92\x05" + b"\xde\x08\x00\xa1a" * 20
    yield "long-array", b"\xdd\xff\xff\xff\xff"
    yield "long-map", b"\x92\x05\xdf\xff\xff\xff\xff"
    yield "long-text", b"\x92\x08\xdb\xff\xff\xff\xff"
    yield "long-bytes", b"\x94\x10\x00\x00\xc6\xff\xff\xff\xff"
    yield "foreign-hello", b"\x98\x01\x07" + b"\x91" * 100
    yield "key-twice", bytes.fromhex("9205 82 a161a162 a161a163")
    yield "extension", b"\x92\x22\xd4\x01\x00"
    yield "not-utf-8", b"\x92\x08\xa2\xc3\x28"
    yield "short-floats", b"\x94\x20\x01\x81\xa1a\xca\x7f\xc0\x00\x00\x80"
    for how in HOW:
        yield f"how-{how}".replace(" ", "-"), fuzz_codec.FORGED + _bytes(fuzz_codec.play, how)
    for kind in KIND_NAMES:
        yield f"made-{kind}", fuzz_codec.FORGED + _bytes(fuzz_codec.play, "made", kind)


def _handshake() -> Iterator[tuple[str, bytes]]:
    for side in fuzz_handshake.SIDES:
        hello = ("as it is", "hoped for")
        welcome = ("as it is", "welcome")
        for name, said in {
            "good": (*hello, *welcome),
            "twice": (*hello, *hello, *welcome),
            "welcome-first": (*welcome, *hello),
            "refused": ("as it is", "refusal", *hello),
            "refused-late": (*hello, "as it is", "refusal"),
            **{
                wrong.replace(" ", "-"): ("as it is", wrong, *hello)
                for wrong in ("foreign", "other certificate", "other session", "other name", "other role",
                              "other ports", "more ports", "other feedthrough", "node hello", "echo", "sample")
            },
        }.items():  # fmt: skip
            yield f"{side}-{name}".replace(" ", "-"), _bytes(fuzz_handshake.play, side, "pure", *said)
        # each frame after 5 ns; 0: the answers find room
        over = (0, 5, *hello, 0) if fuzz_handshake.SIDES[side].opens else (5, *hello, 0, 5, *welcome)
        yield f"{side}-link".replace(" ", "-"), _bytes(fuzz_handshake.play, side, "over a link", *over)
        yield f"{side}-silence".replace(" ", "-"), _bytes(fuzz_handshake.play, side, "over a link")
    yield "made", _bytes(fuzz_handshake.play, "device", "pure", "made", "LinkHello")
    yield "field", _bytes(fuzz_handshake.play, "environment", "pure", "field", "hoped for", 6, 2)
    yield "raw", _bytes(fuzz_handshake.play, "environment", "pure", "raw", b"\x98\x01\x02")


def _gate() -> Iterator[tuple[str, bytes]]:
    def traffic(*told: object, kind: str = "Sample", width: int = 1, bounded: str = "none", first: int = 0) -> bytes:
        return _bytes(fuzz_gate.play, kind, width, bounded, first, *told)

    for kind in fuzz_gate.KINDS:
        yield f"{kind}-honest", traffic(*("honest", 7, 64, -64) * 3, kind=kind, width=2)
    words = ("honest in other words", 7, 64, 0, 0, 0)
    yield "other-words", traffic(*words, 0, 0, *words, 1, 2)
    for name in ("awaited", "tool", "late", "first", "early", "narrow", "wide", "widest", "hello", "foreign"):
        yield f"forged-{name}", traffic("forged", 7, 64, 0, "as it is", name, "honest", 7, 1, 2, width=2, first=1)
    for bounded in fuzz_gate.BOUNDS:
        far = ("honest", 7, 0, "forged", 7, 64, "as it is", "far", "forged", 7, 64, "as it is", "a step too far")
        yield f"{bounded}-far".replace(" ", "-"), traffic(*far, "honest", 7, 128, bounded=bounded)
    yield "not-finite", traffic("forged", 7, 64, "field", "awaited", 3, 1, 1, math.nan)
    yield "replayed", traffic("honest", 7, 1, "replayed", 7, 1)
    for how in HOW:
        yield f"how-{how}".replace(" ", "-"), traffic("forged", 7, 64, how, kind="Force")


def _path() -> Iterator[tuple[str, bytes]]:
    coupling, environment = fuzz_path.Direction  # the ends, by the direction in which they send
    probe, silence, soon = fuzz_path.PROBE, fuzz_path.SILENCE, 10**6

    def sends(end: int, tick: int = 1, shipped: int = 4, after: int = soon) -> tuple[object, ...]:
        return (after, end, "send", tick, 8, shipped)

    def hears(end: int, number: int, after: int = 0) -> tuple[object, ...]:
        return (after, end, "deliver", number)

    def path(*told: tuple[object, ...], first: int = 0) -> bytes:
        return _bytes(fuzz_path.play, first, *(one for step in told for one in step))

    # datagrams are numbered as they were sent, those of the coupling before those of the environment
    up = (sends(coupling), hears(environment, 0), sends(environment), hears(coupling, 1))
    up = (*up, sends(coupling, after=probe), hears(environment, 1))
    yield "up", path(*up, sends(environment), sends(coupling))
    yield "broken", path(*up, sends(environment, after=silence), sends(coupling), hears(environment, 2))
    yield "deaf", path(*up, sends(coupling, after=silence - 1), hears(environment, 2), sends(environment))
    yield "copy", path(*up, hears(environment, 1), hears(environment, 0))
    yield "reflected", path(*up, hears(coupling, 0), hears(environment, 2))
    yield "overtaken", path(*up, sends(coupling), sends(coupling), hears(environment, 3), hears(environment, 2))
    yield "poorer", path(*up, sends(coupling, shipped=0), hears(environment, 2))
    yield "greatest", path(*up, first=fuzz_path.TICKS[-1])
    yield "quiet", path(*up, (fuzz_path.KEEP_ALIVE, coupling, "quiet"), (0, environment, "quiet"))
    yield "other-key", path(*up, (soon, environment, "seal"), (soon, coupling, "seal"))
    for number in range(3):
        for place in (0, 1, 9, 17, 40, 60):
            yield f"changed-{number}-{place}", path(*up, (0, environment, "deliver changed", number, place, b"x", 1))
    for what in (b"", bytes(8), bytes(80)):
        yield f"bytes-{len(what)}", path(*up, (0, environment, "deliver bytes", 1, 5, 17, what))
    for name in ("newer", "older", "wide", "poor", "key", "ready"):
        yield f"frame-{name}", path(*up, (0, environment, "frame", "as it is", name))
    for how in HOW:
        yield f"how-{how}".replace(" ", "-"), path(*up, (0, environment, "frame", how))


def _board() -> Iterator[tuple[str, bytes]]:
    def conversation(*told: object, axes: int = 2, clock: int = 0) -> bytes:
        return _bytes(fuzz_board.play, axes, clock, *told)

    def state(cut: int, *x: int, after: int = 500) -> tuple[object, ...]:
        return (after, "state", *x, cut)

    yield "states", conversation(*state(5, 1, 2), *state(0, 3, 4, after=3_000_000), *state(9, 5, 6))
    yield "wraps", conversation(*state(1, 1, 2), *state(1, 3, 4), clock=2**32 - 700)
    yield "changed", conversation(*state(5, 1, 2), 1, "changed", 3, 255, *state(7, 3, 4))
    yield "other-hello", conversation(1, "about", 6, *state(5, 1, 2))
    yield "code", conversation(1, "code", bytes(range(1, 255)))


def _conductor() -> Iterator[tuple[str, bytes]]:
    def session(*told: object, remote: str = "nobody") -> bytes:
        return _bytes(fuzz_conductor.play, remote, *told)

    up = ("all good hellos", "all ready")
    nodes = fuzz_conductor.NODES
    frame = [("frame", node, "as it is") for node in nodes]
    yield (
        "good-run",
        session(*up, *(one for said in frame for one in (*said, "report", 0)), *_each("exit", nodes, 0)),
    )
    yield "one-by-one", session(*_each("good hello", nodes), *_each("ready", nodes, 10**15))
    yield "telemetry", session(*up, "frame", nodes[0], "as it is", "telemetry", 0)
    yield "fault", session(*up, "frame", nodes[0], "as it is", "fault", 0, "exit", nodes[0], 1)
    for code in (0, 1, -9, -15, -40):
        yield f"exit{code}", session("good hello", nodes[0], "exit", nodes[0], code)
    yield "interrupted", session(*up, "interrupt", "interrupt")
    yield "interrupted-before-ready", session("all good hellos", "interrupt", "all ready")
    yield "too-late", session("all good hellos", "too late", "all ready", "too late")
    yield "ready-first", session("ready", nodes[0], 0, *up)
    yield "ready-before-the-others", session("good hello", nodes[0], "ready", nodes[0], 0, *up)
    yield "hello-twice", session("all good hellos", "all good hellos")
    for wrong in ("other certificate", "other session", "other name", "other role", "foreign", "no endpoints",
                  "other endpoints", "start", "welcome", "link hello"):  # fmt: skip
        said = ("as it is", wrong, 0)
        yield wrong.replace(" ", "-"), session(*(("frame", nodes[-1], *said) * 2), *up)
        yield f"stranger-{wrong}".replace(" ", "-"), session("frame", "stranger", *said, *up)
    yield "stranger-hello", session("frame", "stranger", "as it is", "hello", 0, *up)
    yield "flood-of-hellos", session(*("frame", nodes[0], "as it is", "foreign", 0) * 40)
    for observer in fuzz_conductor.OBSERVERS:
        for name in ("hello", "other role", "other endpoints", "foreign", "ready", "fault"):
            told = ("frame", observer, "as it is", name, 0)
            yield f"observer-{name}".replace(" ", "-"), session(*told, *up, *told)
    for remote in ("a device", "all"):
        far = f"remote-{remote}".replace(" ", "-")
        yield f"{far}-run", session(*up, *("frame", nodes[0], "as it is", "report", 0), remote=remote)
        yield f"{far}-silent", session(*up, "silent", nodes[0], remote=remote)
        yield f"{far}-fault", session(*up, "frame", nodes[0], "as it is", "fault", 0, remote=remote)
        yield f"{far}-never-came", session("too late", remote=remote)
        yield f"{far}-interrupted", session("good hello", nodes[0], "interrupt", "too late", remote=remote)
    for node in nodes[2:]:  # a device, the coupling, the environment
        yield f"back-{node}", session(*up, "exit", node, -9, "good return", node, remote="nobody, restarts")
    *_, c, environment = nodes
    both = ("exit", environment, -9, "exit", c, -9, "good return", environment, "good return", c)
    yield "given-up", session(*up, *both * 3, remote="nobody, restarts")
    yield "no-process", session(*up, "exit", environment, -9, "no process", environment, remote="nobody, restarts")
    dead = ("exit", c, -9)
    offered = ("good offer", environment, c)
    back = ("frame", c, "as it is")
    for name, told in {
        "offer-not-owed": (*offered, *dead, *offered, *offered),
        "offer-of-another": (*dead, "good offer", nodes[0], c),
        "absent-from-a-node": (*dead, "frame", environment, "as it is", "absent", 0),
        "fault-on-the-way": (*dead, *offered, "good hello", c, *back, "fault", 0, "exit", c, 1, "good return", c),
        "refused-on-the-way": (*dead, *offered, *back, "other certificate", 0, "exit", c, 4, "good return", c),
        "lost-while-shaking-hands": (*dead, *offered, "good hello", c, "exit", environment, -9),
        "too-long-on-the-way": (*dead, *offered, "look", 2**62, "exit", c, -9),
        "done-while-one-is-away": (*dead, "frame", environment, "as it is", "report", 0, "too late"),
        "ended-while-one-is-away": (*dead, "interrupt", *_each("exit", nodes, 0)),
        "shift-and-back": ("shift", c, 2, *dead, "good return", c, "exit", environment, -9, "good return", environment),
    }.items():
        yield name, session(*up, *told, remote="nobody, restarts")
    joined = ("silent", nodes[0], "good return", nodes[0])
    yield "joined-again", session(*up, *joined * 4, remote="a device, restarts")


def _each(event: str, nodes: tuple[str, ...], *rest: object) -> list[object]:
    return [told for node in nodes for told in (event, node, *rest)]


def _bytes(play: Callable[[Dictation], None], *told: object) -> bytes:
    """The data that leads a harness to given decisions, whatever it then finds."""
    dictation = Dictation(*told)
    # what the harness finds fault with is for the replay to say, not for the writing of seeds
    with contextlib.suppress(AssertionError, ValueError):
        play(dictation)
        if dictation.more:
            raise Misdictated(f"nobody asked for the last decisions of {told}")
    return dictation.bytes


def write(harness: str, folder: Path) -> None:
    """Put the hand-made seeds of a harness into a folder, for the fuzzer."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in seeds(harness).items():
        (folder / name).write_bytes(data)
