"""The handshake over every transport, both sides at once: after any fault both end with a clear error."""

import dataclasses
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
import pytest

from manyhands.protocol.clock import Clock, Instant, RealtimeClock, SimulatedClock
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.handshake import Expected, HandshakeRefused, HandshakeTimeout, LinkHandshake, shake_hands
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, Role, Tool
from manyhands.protocol.transport import Link

if TYPE_CHECKING:
    from conftest import Ends

SECOND = 1_000_000_000
PORTS = ("dx",)
COUPLING = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "cx", Role.COUPLING, PORTS, ((0.1,),))
ENVIRONMENT = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "environment", Role.ENVIRONMENT, PORTS)


def opening(own: LinkHello = COUPLING) -> LinkHandshake:
    return LinkHandshake(own, Expected("environment", Role.ENVIRONMENT, PORTS), opens=True)


def awaiting(own: LinkHello = ENVIRONMENT) -> LinkHandshake:
    return LinkHandshake(own, Expected("cx", Role.COUPLING, PORTS), opens=False)


def within(seconds: float, clock: Clock) -> Instant:
    return Instant(clock.now() + int(seconds * SECOND))


def shake_and_leave(link: Link, handshake: LinkHandshake) -> LinkHello:
    """What a process does: it ends, and closes its link, as soon as the handshake failed."""
    clock = RealtimeClock()
    try:
        return shake_hands(link, handshake, clock, within(10, clock))
    except HandshakeRefused:
        link.close()
        raise


def both_shake(ends: "Ends", connector: LinkHandshake, binder: LinkHandshake) -> tuple[Future, Future, Link, Link]:
    bound, endpoint = ends.binder.bind("cx", "dx")
    connected = ends.connector.connect(endpoint, "supervisor")
    with ThreadPoolExecutor(2) as both:
        futures = both.submit(shake_and_leave, connected, connector), both.submit(shake_and_leave, bound, binder)
    return (*futures, connected, bound)


def test_an_established_link_carries_signals_at_once(ends: "Ends") -> None:
    connector, binder, connected, bound = both_shake(ends, opening(), awaiting())
    assert connector.result() == ENVIRONMENT
    assert binder.result() == COUPLING
    signal = Tool(0, 1, np.ones(1))
    assert connected.send(encode(signal))
    frame = bound.recv(None)
    assert frame is not None
    assert decode(frame, MAX_CONTROL_BYTES) == signal


@pytest.mark.parametrize(
    ("coupling", "environment", "expected"),
    [
        (
            dataclasses.replace(COUPLING, version=PROTOCOL_VERSION + 1),
            ENVIRONMENT,
            f"environment refused cx: found protocol version {PROTOCOL_VERSION + 1}; expected {PROTOCOL_VERSION}",
        ),
        (
            COUPLING,
            dataclasses.replace(ENVIRONMENT, version=PROTOCOL_VERSION + 1),
            f"environment refused cx: found protocol version {PROTOCOL_VERSION}; expected {PROTOCOL_VERSION + 1}",
        ),
        (
            dataclasses.replace(COUPLING, certificate="bad1dea"),
            ENVIRONMENT,
            "environment refused cx: found the certificate bad1dea; expected c0ffee",
        ),
        (
            COUPLING,
            dataclasses.replace(ENVIRONMENT, role=Role.DEVICE),  # reported by the connecting side
            "cx refused environment: found the role device; expected environment",
        ),
    ],
    ids=["connector's version", "binder's version", "certificate", "connector refuses"],
)
def test_a_mismatch_is_a_clear_error_on_both_sides(
    ends: "Ends", coupling: LinkHello, environment: LinkHello, expected: str
) -> None:
    if environment.role is Role.DEVICE:
        coupling = dataclasses.replace(coupling, feedthrough=None)
    connector, binder, *_ = both_shake(ends, opening(coupling), awaiting(environment))
    for side in (connector, binder):
        assert isinstance(side.exception(), HandshakeRefused)
        assert expected in str(side.exception())


def test_rubbish_instead_of_a_hello_is_refused_with_an_answer(ends: "Ends") -> None:
    bound, endpoint = ends.binder.bind("cx", "dx")
    stranger = ends.connector.connect(endpoint, "supervisor")
    assert stranger.send(b"GET / HTTP/1.1")
    with pytest.raises(HandshakeRefused, match="environment refused cx: found a malformed frame"):
        shake_and_leave(bound, awaiting())
    answer = stranger.recv(None)
    assert answer is not None
    assert b"malformed" in answer


@pytest.mark.parametrize("opens", [True, False])
def test_a_silent_peer_is_not_waited_for_longer_than_allowed(ends: "Ends", opens: bool) -> None:
    bound, endpoint = ends.binder.bind("cx", "dx")
    connected = ends.connector.connect(endpoint, "supervisor")
    clock = RealtimeClock()
    side, link, missing = (opening(), connected, "environment") if opens else (awaiting(), bound, "cx")
    with pytest.raises(HandshakeTimeout, match=f"found no answer of {missing} in the time allowed"):
        shake_hands(link, side, clock, within(0.03, clock))


def test_time_that_stands_still_does_not_make_it_wait_for_ever(ends: "Ends") -> None:
    bound, _ = ends.binder.bind("cx", "dx")
    with pytest.raises(HandshakeTimeout):
        shake_hands(bound, awaiting(), SimulatedClock(), Instant(30_000_000))


def test_a_deadline_in_the_past_is_over(ends: "Ends") -> None:
    bound, _ = ends.binder.bind("cx", "dx")
    with pytest.raises(HandshakeTimeout):
        shake_hands(bound, awaiting(), RealtimeClock(), Instant(0))


class DeafLink:
    """A link whose other end has gone: it delivers what came before, and takes nothing more."""

    def __init__(self, *frames: bytes) -> None:
        self._frames = list(frames)

    def send(self, frame: bytes) -> bool:
        return False

    def recv(self, timeout: object) -> bytes | None:
        return self._frames.pop(0) if self._frames else None

    def close(self) -> None: ...


def test_a_peer_that_left_is_named() -> None:
    clock = RealtimeClock()
    with pytest.raises(HandshakeTimeout, match="cx left before the handshake was over"):
        shake_hands(DeafLink(encode(COUPLING)), awaiting(), clock, within(1, clock))


def test_a_refusal_that_cannot_be_delivered_is_still_an_error_here() -> None:
    clock = RealtimeClock()
    with pytest.raises(HandshakeRefused, match="found a malformed frame"):
        shake_hands(DeafLink(b"\xc1"), awaiting(), clock, within(1, clock))


def test_a_refusal_leaves_though_the_process_ends_at_once(ends: "Ends") -> None:
    """The refusing process closes its whole transport; the other one only begins to listen afterwards."""
    bound, endpoint = ends.binder.bind("cx", "dx")
    connected = ends.connector.connect(endpoint, "supervisor")
    unfit = opening(dataclasses.replace(COUPLING, certificate="bad1dea"))
    gone = threading.Event()

    def refuse_and_end() -> None:
        with pytest.raises(HandshakeRefused):
            shake_and_leave(bound, awaiting())
        ends.close_binder()
        gone.set()

    with ThreadPoolExecutor(1) as other:
        ended = other.submit(refuse_and_end)
        for message in unfit.start():
            assert connected.send(encode(message))
        assert gone.wait(10)
        ended.result()
    frame = connected.recv(None)
    assert frame is not None
    unfit.receive(decode(frame, MAX_CONTROL_BYTES))
    assert unfit.refusal is not None
    assert "found the certificate bad1dea; expected c0ffee" in unfit.refusal
