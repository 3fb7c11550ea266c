"""The driver's prototypes and the fake's functions against what the maker's headers declare.

SOURCE: declarations as two public repositories have them in `dhdc.h` and `drdc.h`, read there and written down here by
name, result and types: BezniF/fdo6 `include/dhdc.h` (SDK 3.10.0), and WPI-AIM/ambf `external/DHD/include/drdc.h` (SDK
3.7.0). Names of arguments, defaults and comments are left out.
"""

from __future__ import annotations

import ctypes
import re
from ctypes import POINTER, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_ushort, c_void_p
from typing import Any

import pytest

from manyhands.devices.force_dimension.library import PROTOTYPES

from ...fakes.compiled import FAKES
from ...fakes.dhd import library

SOURCE = """
const char* dhdErrorGetLastStr ()
void dhdGetSDKVersion (int*, int*, int*, int*)
int dhdGetDeviceCount ()
int drdOpenID (char)
int drdClose (char)
bool drdIsInitialized (char)
int dhdGetSerialNumber (ushort*, char)
const char* dhdGetSystemName (char)
int dhdGetSystemType (char)
int dhdEnableExpertMode ()
int dhdSetComMode (int, char)
int dhdGetComMode (char)
int dhdSetTimeGuard (int, char)
int dhdSetGravityCompensation (int, char)
int dhdSetBrakes (int, char)
int dhdEnableForce (uchar, char)
int dhdSetWatchdog (uchar, char)
int dhdGetVelocityThreshold (uint*, char)
int dhdGetStatus (int[], char)
int dhdGetPosition (double*, double*, double*, char)
int dhdGetDeltaEncoders (int*, int*, int*, char)
int dhdDeltaEncodersToJointAngles (int, int, int, double*, double*, double*, char)
int dhdDeltaEncoderToPosition (int, int, int, double*, double*, double*, char)
int dhdDeltaPositionToEncoder (double, double, double, int*, int*, int*, char)
int dhdDeltaJointAnglesToJacobian (double, double, double, double[][], char)
int dhdDeltaJointTorquesExtrema (double, double, double, double[], double[], char)
int dhdSetDeltaJointTorques (double, double, double, char)
bool dhdHasWrist (char)
bool dhdHasActiveWrist (char)
int dhdGetOrientationFrame (double[][], char)
int dhdSetWristJointTorques (double, double, double, char)
int dhdGetForce (double*, double*, double*, char)
int dhdSetForce (double, double, double, char)
uint dhdGetButtonMask (char)
double dhdGetComFreq (char)
int dhdStop (char)
"""

KINDS: dict[str, Any] = {
    "void": None, "int": c_int, "bool": c_bool, "double": c_double, "const char*": c_char_p, "char": c_byte,
    "uchar": c_ubyte, "unsigned char": c_ubyte, "int*": POINTER(c_int), "int[]": POINTER(c_int),
    "uint": c_uint, "unsigned": c_uint, "uint*": POINTER(c_uint), "unsigned*": POINTER(c_uint),
    "ushort*": POINTER(c_ushort),
    "unsigned short*": POINTER(c_ushort), "double*": POINTER(c_double), "double[]": c_void_p, "double[][]": c_void_p,
}  # fmt: skip

DECLARED = re.compile(r"^((?:const )?\w+ ?\*?) ?(\w+) ?\(([^)]*)\)", re.MULTILINE)


def declared(text: str) -> dict[str, tuple[Any, tuple[Any, ...]]]:
    found = {}
    for result, name, arguments in DECLARED.findall(text):
        types = [one.strip() for one in arguments.split(",") if one.strip() not in ("", "void")]
        found[name] = (KINDS[result.replace(" *", "*").strip()], tuple(KINDS[one] for one in types))
    return found


def of_the_fake() -> dict[str, tuple[Any, tuple[Any, ...]]]:
    """The definitions of dhd.c, without the names of arguments."""
    text = (FAKES / "dhd.c").read_text()
    text = re.sub(r"^SETTER\((\w+), (\w+(?: char)?),", r"int \1(\2 value, char id)", text, flags=re.MULTILINE)
    found = {}
    for result, name, arguments in re.findall(
        r"^((?:const )?\w+ \*?)((?:dhd|drd)[A-Z]\w*)\(([^)]*)\)", text, re.MULTILINE
    ):
        types = []
        for one in (given.strip() for given in arguments.split(",")):
            if one == "void":
                continue
            kind, star, rest = re.fullmatch(r"(.+?) (\*?)\w+((?:\[\w+\])*)", one).groups()  # type: ignore[union-attr]
            types.append(f"{kind}{star}{'[]' * rest.count('[')}")
        found[name] = (KINDS[result.replace(" *", "*").strip()], tuple(KINDS[one] for one in types))
    return found


def test_the_driver_calls_functions_as_the_headers_declare_them() -> None:
    source = declared(SOURCE)
    for name, prototype in PROTOTYPES.items():
        assert source[name] == prototype, name


def test_the_fake_defines_functions_as_the_headers_declare_them() -> None:
    source, fake = declared(SOURCE), of_the_fake()
    assert source.keys() == fake.keys()
    for name, prototype in fake.items():
        assert source[name] == prototype, name


@pytest.mark.parametrize("name", sorted(PROTOTYPES))
def test_the_fake_exports_what_the_driver_calls(name: str) -> None:
    assert getattr(ctypes.CDLL(str(library())), name)
