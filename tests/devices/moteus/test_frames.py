"""Frames of moteus, byte by byte: against what the maker's package makes, and against the maker's documents.

The vectors are of the package ``moteus`` 1.1.1. Where it is installed (extra ``dev``), it is asked itself as well, and
``MANYHANDS_REQUIRE_MOTEUS=1`` demands that it is.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import os
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.devices.moteus import frames


def maker() -> Any:
    if importlib.util.find_spec("moteus") is None:
        assert os.environ.get("MANYHANDS_REQUIRE_MOTEUS") != "1", "MANYHANDS_REQUIRE_MOTEUS is set; there is no moteus"
        pytest.skip("there is no package moteus")
    return importlib.import_module("moteus")


def controller(package: Any) -> Any:
    int8 = package.multiplex.INT8
    resolution = package.PositionResolution()
    for name in ("position", "velocity", "kp_scale", "kd_scale", "velocity_limit", "accel_limit", "ilimit_scale"):
        setattr(resolution, name, int8)
    query = package.QueryResolution()
    query._extra = {int(frames.Register.MILLISECONDS): package.multiplex.INT32}
    return package.Controller(id=1, transport=object(), position_resolution=resolution, query_resolution=query)


def makers_torque(of: Any, value: float, most: float, lives: float) -> bytes:
    made: bytes = of.make_position(
        position=math.nan, velocity=0.0, feedforward_torque=value, kp_scale=0.0, kd_scale=0.0, maximum_torque=most,
        watchdog_timeout=lives, velocity_limit=-0.1, accel_limit=-0.05, ilimit_scale=0.0,
    ).data  # fmt: skip
    return made


def test_a_torque_is_what_the_package_makes_of_it() -> None:
    made = "01000a022080000d220000803e022300000d250000003f0d270ad7a33c0228ffff012b00"
    assert frames.torque(0.25, 0.5, 0.02).hex() == made
    assert len(frames.torque(1e9, 1e9, 1e9)) == len(bytes.fromhex(made)) <= 48


def test_questions_are_what_the_package_asks() -> None:
    assert frames.QUERY.hex() == "11001f01130d1970"
    assert frames.STOP.hex() == "010000"
    assert frames.diagnostic(b"conf get id.id\n").hex() == "40010f636f6e66206765742069642e69640a"
    assert frames.DIAGNOSTIC_POLL.hex() == "420130"
    assert frames.seal(b"can send 8001 0100") == b"can send 8001 0100 *66"


def test_the_package_itself_makes_the_same() -> None:
    of = controller(package := maker())
    for value in (-0.31, 0.0, 1e-7, 2.5):
        assert frames.torque(value, 0.7, 0.013) == makers_torque(of, value, 0.7, 0.013)
    assert of.make_query().data == frames.QUERY
    assert of.make_stop().data == frames.STOP
    assert of.make_diagnostic_write(b"conf get id.id\n").data == frames.diagnostic(b"conf get id.id\n")
    assert of.make_diagnostic_read().data == frames.DIAGNOSTIC_POLL
    line = importlib.import_module("moteus.fdcanusb_device")._append_checksum(b"can send 8001 0100")
    assert line == frames.seal(b"can send 8001 0100")
    answer = bytes.fromhex("21000a2f010000803e000000bfcdcccc3d230d302a60505050")
    said = package.multiplex and importlib.import_module("moteus.protocol").parse_reply(answer)
    assert frames.registers(answer) == pytest.approx(said)


def test_the_example_of_the_documents() -> None:
    """mjbots/moteus docs/protocol/can.md: a frame, its line, and the answer, word by word."""
    payload = bytes.fromhex("01000a07206000200150ff140400130d")
    line = frames.command(frames.can_id(0, 1, answered=True), payload)
    assert line == b"can send 8001 01000a07206000200150ff140400130d\n"
    source, destination, answer = frames.received(b"rcv 100 2404000a005000000170ff230d181400") or (0, 0, b"")
    assert (source, destination) == (1, 0)
    found = frames.registers(answer)
    assert found is not None
    assert (found[0], found[1], found[2], found[3]) == (10, 0x50, 0x100, -144)  # of int16, whose units are not ours
    assert (found[0xD], found[0xE], found[0xF]) == (12.0, 20, 0)


def test_a_frame_is_padded_to_a_size_that_can_fd_has() -> None:
    words = frames.command(1, bytes(33)).split()
    assert bytes.fromhex(words[3].decode()) == bytes(33) + b"\x50" * 15


def test_lines_with_a_wrong_checksum_are_none() -> None:
    assert frames.unseal(b"rcv 100 50") == (b"rcv 100 50", False)
    assert frames.unseal(frames.seal(b"rcv 100 50")) == (b"rcv 100 50", True)
    assert frames.unseal(frames.seal(b"rcv 100 50").replace(b"5", b"4")) is None
    assert frames.unseal(b"rcv 100 *zz") is None


@given(st.binary(max_size=64))
def test_any_bytes_are_registers_or_none(data: bytes) -> None:
    found = frames.registers(data)
    assert found is None or all(isinstance(value, int | float) for value in found.values())


@given(st.binary(max_size=80))
def test_any_line_is_a_frame_or_none(line: bytes) -> None:
    frames.unseal(line)
    found = frames.received(b"rcv " + line)
    assert found is None or len(found) == 3


def test_a_line_for_the_console_has_an_end() -> None:
    with pytest.raises(ValueError, match="found 62 bytes; expected at most 61"):
        frames.diagnostic(b"x" * 62)
