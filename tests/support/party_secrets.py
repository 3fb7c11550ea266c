"""The data of each party that the other parties must not learn, and the forms in which it could appear."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from zmq.utils import z85

from . import distinctive_session
from .patterns import is_distinctive

_NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?")
_DIGITS = 12  # significant ones of a number's text that are looked for: it may have been written with fewer than all

_Lists = list[list[float]]


def own_numbers(name: str, session: Mapping[str, Any], bundle: Mapping[str, Any]) -> _Lists:
    """The numbers of ``name`` alone, from its part of the session file and from its bundle."""
    if name in distinctive_session.DEVICES:
        return [*_numbers(session["devices"][name]), *_numbers({**bundle, "common": None})]
    if name in distinctive_session.COUPLINGS:
        given = [
            session["design"][key][list(distinctive_session.COUPLINGS).index(name)] for key in ("stiffness", "damping")
        ]
        rungs = [bundle, *bundle["softer"]]
        own = [[rung["block"], rung["level"]] for rung in rungs]  # K and the limits are its device's
        return [*_numbers(given), *_numbers(own)]
    return [*_numbers(session["environment"]), *_numbers({**bundle, "common": None})]


def _numbers(plain: object) -> _Lists:
    """The numbers of a tree, including those in formulas."""
    formulas = [[float(number) for number in _NUMBER.findall(text)] for text in distinctive_session.texts(plain)]
    return [*distinctive_session.number_lists(plain), *formulas]


def shared_with(name: str, bundles: Mapping[str, Mapping[str, Any]]) -> set[float]:
    """The others' numbers that ``name`` may know: its devices' K and limits a coupling, D_V the environment.

    The rungs' timing, kappa, share and c are the session's, and every device's; so is what lateness may put in.
    """
    shared: list[object] = [
        [bundles[device][key] for key in ("rungs", "allowance")] for device in distinctive_session.DEVICES
    ]
    if name in distinctive_session.COUPLINGS:
        device = bundles[distinctive_session.COUPLINGS[name]]
        gains = [rung["K"] for rung in (bundles[name], *bundles[name]["softer"])]
        shared += [gains, device.get("limits")]
        shared.append(bundles[distinctive_session.ENVIRONMENT]["feedthrough_rungs"][name])
    elif name == distinctive_session.ENVIRONMENT:
        couplings = [bundles[coupling] for coupling in distinctive_session.COUPLINGS]
        shared += [rung["block"]["D"] for coupling in couplings for rung in (coupling, *coupling["softer"])]
    return {abs(number) for numbers in _numbers(shared) for number in numbers}


def forbidden_numbers(name: str, session: Mapping[str, Any], bundles: Mapping[str, Mapping[str, Any]]) -> _Lists:
    """The distinctive numbers of the others; numbers of one list stay together.

    A number that is ``name``'s own as well, up to rounding, is no secret: springs and dampers of softer rungs stand in
    one proportion in all blocks (decision 16), so that their A agree in more digits than are searched for.
    """
    known = shared_with(name, bundles) | {session["period"]}
    known |= {abs(n) for numbers in own_numbers(name, session, bundles[name]) for n in numbers}
    lists = (numbers for other in bundles if other != name for numbers in own_numbers(other, session, bundles[other]))
    return [kept for numbers in lists if (kept := [n for n in numbers if is_distinctive(n) and not _among(n, known)])]


def _among(number: float, known: set[float]) -> bool:
    return any(math.isclose(abs(number), other, rel_tol=10.0 ** (1 - _DIGITS)) for other in known)


def forbidden_texts(name: str, session: Mapping[str, Any]) -> set[str]:
    """The names of parties without a link to ``name``, and the others' formulas."""
    hands = [session["devices"][device]["hand"] for device in distinctive_session.DEVICES if device != name]
    texts = {hand[intent] for hand in hands for intent in ("force", "motion")} | {distinctive_session.HUB}
    if name in distinctive_session.DEVICES:
        texts |= {*distinctive_session.DEVICES, *distinctive_session.COUPLINGS} - {name, _coupling_of(name)}
    elif name in distinctive_session.COUPLINGS:
        texts |= {*distinctive_session.DEVICES, *distinctive_session.COUPLINGS} - {
            name,
            distinctive_session.COUPLINGS[name],
        }
    else:
        texts -= {distinctive_session.HUB}
    return texts


def _coupling_of(device: str) -> str:
    return next(coupling for coupling, held in distinctive_session.COUPLINGS.items() if held == device)


def as_numbers(lists: Iterable[Iterable[float]]) -> dict[bytes, str]:
    """The numbers as a processor or a text holds them, with either sign.

    As float 32 those that stand together, two by two: the four bytes of one alone turn up by accident.
    """
    out: dict[bytes, str] = {}
    for numbers in lists:
        numbers = list(numbers)
        for number in numbers:
            for signed in (number, -number):
                out |= {struct.pack(form, signed): f"{signed!r} ({form})" for form in ("<d", ">d")}
            out[_as_text(number)] = f"{number!r} (text)"
        for pair in pairwise(numbers):
            out |= {struct.pack(form, *pair): f"{pair!r} ({form})" for form in ("<2f", ">2f")}
    return out


def _as_text(number: float) -> bytes:
    """The beginning of a number's text, whatever its length, without an exponent."""
    text = repr(abs(number)).partition("e")[0]
    leading = len(text) - len(text.lstrip("0."))
    return text[: leading + _DIGITS + 1].encode()  # one more for the point


def as_doubles(lists: Iterable[Iterable[float]]) -> dict[bytes, str]:
    """The distinctive numbers as a processor holds them."""
    return {struct.pack("<d", n): repr(n) for numbers in lists for n in numbers if is_distinctive(n)}


def as_texts(texts: Iterable[str]) -> dict[bytes, str]:
    """Texts as they are."""
    return {text.encode(): text for text in texts}


def as_keys(keys: Mapping[str, str]) -> dict[bytes, str]:
    """Keys in both forms: their characters, and the 32 bytes that these encode."""
    text = {key.encode(): f"{what} (text)" for what, key in keys.items()}
    return text | {z85.decode(key): f"{what} (bytes)" for what, key in keys.items()}
