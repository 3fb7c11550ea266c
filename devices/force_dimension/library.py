"""The maker's library, libdrd, as it stands on the user's machine: where it is, its functions, and what they answer.

It is not part of manyhands and never shipped: Force Dimension gives it to those who ask for the SDK. It is found by
:func:`load`. Of its functions :data:`PROTOTYPES` has those that the driver calls, as ``dhdc.h`` and ``drdc.h`` declare
them (SDK 3.10 in the repository BezniF/fdo6, ``include/dhdc.h``; 3.7 in WPI-AIM/ambf, ``external/DHD/include``). What
they do beyond that is told by the documentation of forcedimension-core, which repeats the maker's own.

Code in a library runs with the rights of its user, and nothing confines it.
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import sys
from collections.abc import Sequence
from ctypes import POINTER, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_ushort, c_void_p
from pathlib import Path
from typing import Any, Final

VARIABLE: Final = "FORCEDIM_SDK"
"""The environment variable that names the library, or the folder into which the SDK was unpacked."""

OLDEST: Final = "3.10"
"""The first SDK known to have all functions."""

TIMEGUARD: Final = 1
"""Of a reading: the device was not asked, and the values are those of the last reading."""

SATURATED: Final = 2
"""Of torques: a motor cannot give what was asked, and all of them are scaled down."""

SYNCHRONOUS: Final = 0
"""The mode in which an exchange over USB is over when its call returns."""

_D, _I, _ID = POINTER(c_double), POINTER(c_int), c_byte

PROTOTYPES: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "dhdErrorGetLastStr": (c_char_p, ()),
    "dhdGetSDKVersion": (None, (_I, _I, _I, _I)),
    "dhdGetDeviceCount": (c_int, ()),
    "drdOpenID": (c_int, (_ID,)),
    "drdClose": (c_int, (_ID,)),
    "drdIsInitialized": (c_bool, (_ID,)),
    "dhdGetSerialNumber": (c_int, (POINTER(c_ushort), _ID)),
    "dhdGetSystemName": (c_char_p, (_ID,)),
    "dhdGetSystemType": (c_int, (_ID,)),
    "dhdEnableExpertMode": (c_int, ()),
    "dhdSetComMode": (c_int, (c_int, _ID)),
    "dhdGetComMode": (c_int, (_ID,)),
    "dhdSetTimeGuard": (c_int, (c_int, _ID)),
    "dhdSetGravityCompensation": (c_int, (c_int, _ID)),
    "dhdSetBrakes": (c_int, (c_int, _ID)),
    "dhdEnableForce": (c_int, (c_ubyte, _ID)),
    "dhdSetWatchdog": (c_int, (c_ubyte, _ID)),
    "dhdGetVelocityThreshold": (c_int, (POINTER(c_uint), _ID)),
    "dhdGetStatus": (c_int, (_I, _ID)),
    "dhdGetPosition": (c_int, (_D, _D, _D, _ID)),
    "dhdGetDeltaEncoders": (c_int, (_I, _I, _I, _ID)),
    "dhdDeltaEncodersToJointAngles": (c_int, (c_int, c_int, c_int, _D, _D, _D, _ID)),
    "dhdDeltaEncoderToPosition": (c_int, (c_int, c_int, c_int, _D, _D, _D, _ID)),
    "dhdDeltaPositionToEncoder": (c_int, (c_double, c_double, c_double, _I, _I, _I, _ID)),
    "dhdDeltaJointAnglesToJacobian": (c_int, (c_double, c_double, c_double, c_void_p, _ID)),
    "dhdDeltaJointTorquesExtrema": (c_int, (c_double, c_double, c_double, c_void_p, c_void_p, _ID)),
    "dhdSetDeltaJointTorques": (c_int, (c_double, c_double, c_double, _ID)),
    "dhdHasWrist": (c_bool, (_ID,)),
    "dhdHasActiveWrist": (c_bool, (_ID,)),
    "dhdGetOrientationFrame": (c_int, (c_void_p, _ID)),
    "dhdSetWristJointTorques": (c_int, (c_double, c_double, c_double, _ID)),
    "dhdGetForce": (c_int, (_D, _D, _D, _ID)),
    "dhdGetButtonMask": (c_uint, (_ID,)),
    "dhdGetComFreq": (c_double, (_ID,)),
    "dhdStop": (c_int, (_ID,)),
}
"""The result and the arguments of each function by its name; ``char ID`` is the device's number."""


class ForceDimensionError(RuntimeError):
    """A device, or the maker's library, is not of use; the message names it and says what to do."""


def load(path: str) -> ctypes.CDLL:
    """The library, with its prototypes.

    Args:
        path: of the library; empty to take what :data:`VARIABLE` names, and else what the platform's search finds.

    Raises:
        ForceDimensionError: there is none, or it is another one.
    """
    found, why = None, []
    for place in [path] if path else _places():
        try:
            found = ctypes.CDLL(place)
            break
        except OSError as error:
            why.append(str(error))
    if found is None:
        raise ForceDimensionError(
            f"found no library of Force Dimension ({why[0]:.200}); expected libdrd of the maker's SDK: give its path "
            f"as parameters.library, set {VARIABLE} to the folder of the SDK, or copy it to where the linker looks"
        )
    lacks = [name for name in PROTOTYPES if not hasattr(found, name)]
    if lacks:
        raise ForceDimensionError(
            f"{found._name}: found a library without {', '.join(lacks[:3])}; expected libdrd of SDK {OLDEST} or newer, "
            "which has the functions of libdhd as well"
        )
    for name, (result, arguments) in PROTOTYPES.items():
        function = getattr(found, name)
        function.restype, function.argtypes = result, arguments
    return found


def _places() -> list[str]:
    """Where it may be: beside :data:`VARIABLE`, or under the names that the linker looks for."""
    mac = sys.platform == "darwin"
    names = ["libdrd.dylib"] if mac else ["libdrd.so", "libdrd.so.3"]
    given = os.environ.get(VARIABLE, "")
    if not given:
        return names
    if Path(given).is_file():
        return [given]
    kind = f"mac-{platform.machine()}-clang" if mac else f"lin-{platform.machine()}-gcc"
    folder = Path(given) / "lib" / "release" / kind
    return [str(one) for one in sorted(folder.glob(f"{names[0].partition('.')[0]}.*"))] + names


OFF_ROTATION: Final = 1e-3
"""By how much R R^T may differ from 1 in any entry."""


def is_rotation(rows: Sequence[float]) -> bool:
    """Whether nine numbers, row by row, are those of a rotation."""
    x, y, z = rows[0:3], rows[3:6], rows[6:9]
    for i, one in enumerate((x, y, z)):
        for other in (x, y, z)[i:]:
            if not abs(sum(a * b for a, b in zip(one, other, strict=True)) - (one is other)) <= OFF_ROTATION:
                return False  # so for NaN
    return (
        x[0] * (y[1] * z[2] - y[2] * z[1]) + x[1] * (y[2] * z[0] - y[0] * z[2]) + x[2] * (y[0] * z[1] - y[1] * z[0])
        > 0.0
    )  # and no mirror


def quaternion(rows: Sequence[float]) -> list[float]:
    """(w, x, y, z) of a rotation's nine numbers, row by row.

    Of the four numbers, whose squares these traces are four times of, that of the greatest size divides.
    """
    a, b, c, d, e, f, g, h, i = rows
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    most = squares.index(max(squares))
    products = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )[most]
    return [product / (2.0 * math.sqrt(squares[most])) for product in products]


class Kinematics:
    """What the library says of the device's mechanism: from counts to angles, place, and Jacobian. It moves nothing.

    The joints' angles are in rad, places in m, the Jacobian J = dx/dq in m/rad.
    """

    def __init__(self, library: ctypes.CDLL, device: int, name: str) -> None:
        """Of the open device with this number; ``name`` is for messages."""
        self._library, self.device, self.name = library, device, name
        self._q, self._x, self._force = (tuple(c_double() for _ in range(3)) for _ in range(3))
        self._counts = tuple(c_int() for _ in range(3))
        self._J, self._low, self._high = (c_double * 9)(), (c_double * 3)(), (c_double * 3)()
        self._frame = (c_double * 9)()

    def called(self, function: str, *arguments: Any) -> int:
        """Call a function of this device, and return its answer.

        Raises:
            ForceDimensionError: it answers less than 0.
        """
        answer = int(getattr(self._library, function)(*arguments, self.device))
        if answer < 0:
            raise self.failed(function)
        return answer

    def failed(self, function: str) -> ForceDimensionError:
        """The error of a call that failed, in the library's words."""
        said = self._library.dhdErrorGetLastStr() or b"no reason"
        return ForceDimensionError(
            f"{self.name}: {function} failed: found {said.decode(errors='replace')!r}; expected a device that answers: "
            "see that its cable is plugged in and its power is on, and that no other program has opened it"
        )

    def read(self) -> tuple[bool, list[int]]:
        """The encoders' counts of one instant, and whether the device was asked for them now."""
        answer = self.called("dhdGetDeltaEncoders", *self._counts)
        return answer != TIMEGUARD, [count.value for count in self._counts]

    def close(self) -> None:
        """Close the device; one that is gone needs none."""
        self._library.drdClose(self.device)

    def buttons(self) -> int:
        """The buttons that are held down, bit by bit."""
        return int(self._library.dhdGetButtonMask(self.device))

    def rate(self) -> float:
        """The rate at which forces are sent, by the library's own count, kHz."""
        return float(self._library.dhdGetComFreq(self.device))

    def position(self) -> list[float]:
        """The tip's position as the library gives it, m; the device is asked for it."""
        self.called("dhdGetPosition", *self._x)
        return [value.value for value in self._x]

    @property
    def wrist(self) -> bool:
        """Whether it has a wrist, whose orientation it measures."""
        return bool(self._library.dhdHasWrist(self.device))

    @property
    def active_wrist(self) -> bool:
        """Whether that wrist has motors."""
        return bool(self._library.dhdHasActiveWrist(self.device))

    def frame(self) -> list[float]:
        """The rotation from the axes of the wrist to those of places, its rows one after the other.

        Raises:
            ForceDimensionError: the device does not answer, or what it tells is no rotation.
        """
        self.called("dhdGetOrientationFrame", self._frame)
        rows = list(self._frame)
        if not is_rotation(rows):
            told = ", ".join(f"{value:.3g}" for value in rows)
            raise ForceDimensionError(
                f"{self.name}: found an orientation frame of {told}; expected a rotation: see that its wrist is "
                "calibrated, and tell us if it is"
            )
        return rows

    def force(self) -> list[float]:
        """The force that the library takes the motors to exert, N."""
        self.called("dhdGetForce", *self._force)
        return [value.value for value in self._force]

    def angles(self, counts: Sequence[int]) -> list[float]:
        """The joints' angles of counts, rad."""
        self.called("dhdDeltaEncodersToJointAngles", *counts, *self._q)
        return [value.value for value in self._q]

    def place(self, counts: Sequence[int]) -> list[float]:
        """The tip's place of counts, m."""
        self.called("dhdDeltaEncoderToPosition", *counts, *self._x)
        return [value.value for value in self._x]

    def counts(self, place: Sequence[float]) -> list[int]:
        """The counts next to a place, m."""
        self.called("dhdDeltaPositionToEncoder", *place, *self._counts)
        return [count.value for count in self._counts]

    def jacobian(self, q: Sequence[float]) -> list[float]:
        """J at angles q, its rows one after the other, m/rad."""
        self.called("dhdDeltaJointAnglesToJacobian", *q, self._J)
        return list(self._J)

    def torques(self, q: Sequence[float]) -> tuple[list[float], list[float]]:
        """The least and the greatest torque of each motor at angles q, N·m."""
        self.called("dhdDeltaJointTorquesExtrema", *q, self._low, self._high)
        return list(self._low), list(self._high)
