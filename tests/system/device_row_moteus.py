"""The row of a moteus in the campaign of faults (tests/system/device_faults.py)."""

from __future__ import annotations

import struct
from typing import Final

from ..fakes.far_side import Given
from ..fakes.moteus import fake_moteus
from .device_row import Fault
from .device_row_motor_axis import AT_ONCE, motor_row

_FRAME: Final = struct.Struct("<3s4s2sf4s2sf2sf")
"""Mode, position and velocity, the torque, gains, the greatest torque, the watchdog's time: each after its register."""


class MoteusWire:
    """The torques on a fdcanusb's wire, by the maker's list of registers.

    Attributes:
        given: the torques, in the order in which they came.
    """

    def __init__(self) -> None:
        self.given: list[Given] = []

    def take(self, line: str, at: int) -> None:
        """A line that was read at an instant, ns."""
        words = line.split()
        if words[:2] != ["can", "send"]:
            return
        frame = bytes.fromhex(words[3])
        if frame[:3] != b"\x01\x00\x0a":  # one register of int8, the mode: position
            return
        _, _, of_torque, torque, _, of_most, most, of_lives, lives = _FRAME.unpack_from(frame)
        if (of_torque, of_most, of_lives) != (b"\x0d\x22", b"\x0d\x25", b"\x0d\x27"):  # one float each
            raise ValueError(f"found the frame {frame.hex()}; expected registers 0x22, 0x25 and 0x27 in their places")
        self.given.append(Given(at, at + int(1e9 * lives), (max(-most, min(most, torque)),)))


MOTEUS: Final = motor_row(
    "moteus",
    fake_moteus,
    MoteusWire,
    {
        "under voltage": Fault(
            ["hold 40"],
            AT_ONCE,
            "fault 40, under voltage: see its supply and cables",
            then=["free"],
            after="cannot be made: found MotorError",
        ),
    },
)
