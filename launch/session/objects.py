"""Python objects in a session's data: arrays, linear systems and transfer functions become what a file would state.

A session can be made from a dict of the form of a session file. Its values may be objects of other libraries, which are
known by their attributes alone, so that none of these libraries is needed:

| object | known by | where it may stand |
|---|---|---|
| numpy array or scalar | its type | anywhere |
| linear system (``control.ss``, ``scipy.signal``, :class:`.LinearSystem`) | ``A``, ``B``, ``C``, ``D``, ``dt`` | \
``environment``; a block of ``design.matrices`` |
| transfer function (``control.tf``, ``scipy.signal``) | ``num``, ``den``, ``dt`` | ``environment``; in s with one \
input and output wherever a file states ``{num: [...], den: [...]}`` |

``dt`` is the sample time in s. 0 and None stand for continuous time. True stands for the session's period.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from manyhands.launch.session.errors import SessionError, key_text, show
from manyhands.launch.session.limits import MAX_DEPTH
from manyhands.launch.session.yaml import KeyPath, SessionTree, SourcePlace

_ENVIRONMENT: Final = ("environment",)
_MATRICES: Final = ("design", "matrices")


def tree_of(data: Mapping[str, Any], source: str) -> SessionTree:
    """The tree of a session's Python data; every place in it is ``source``, without a line.

    Raises:
        SessionError: the data are no mapping, or hold something that no session file can state.
    """
    if not isinstance(data, Mapping):
        raise SessionError(source, None, "", show(data), "a mapping with the keys of a session file")
    reader = _Reader(source, data.get("period"))
    plain = reader.plain(data, ())
    return SessionTree(source, plain, {(): SourcePlace(source, None), **reader.places})


def plain_value(value: object, at: KeyPath, tree: SessionTree) -> tuple[Any, Mapping[KeyPath, SourcePlace]]:
    """One value for the key ``at`` of a session, as plain data, with the places in it.

    Raises:
        SessionError: no session file can state it there.
    """
    reader = _Reader(tree.source, tree.data.get("period"))
    return reader.plain(value, at), reader.places


class _Reader:
    """Turns Python data into plain data, and collects the place of every key and item."""

    def __init__(self, source: str, period: object) -> None:
        self.source, self.period = source, period
        self.places: dict[KeyPath, SourcePlace] = {}

    def error(self, at: KeyPath, found: str, expected: str) -> SessionError:
        return SessionError(self.source, None, key_text(at), found, expected)

    def plain(self, value: object, at: KeyPath) -> Any:
        """The plain form of a value."""
        if len(at) > MAX_DEPTH:
            raise self.error(at[:MAX_DEPTH], f"nesting deeper than {MAX_DEPTH}", "flatter data")
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        elif all(hasattr(value, name) for name in "ABCD"):
            value = self._system(value, at)
        elif all(hasattr(value, name) for name in ("num", "den")):
            value = self._transfer(value, at)
        if isinstance(value, Mapping):
            return self._mapping(value, at)
        if isinstance(value, list | tuple):
            for index in range(len(value)):
                self.places[(*at, index)] = SourcePlace(self.source, None)
            return [self.plain(item, (*at, index)) for index, item in enumerate(value)]
        if isinstance(value, os.PathLike):
            return os.fspath(value)
        if value is None or isinstance(value, str | bool | int | float):
            return value
        raise self.error(at, show(value), "a number, a text, a list, a mapping, an array or a linear system")

    def _mapping(self, value: Mapping[Any, Any], at: KeyPath) -> dict[str, Any]:
        for key in value:
            if not isinstance(key, str):
                raise self.error(at, f"the key {show(key)}", "a name as the key")
            self.places[(*at, key)] = SourcePlace(self.source, None)
        return {key: self.plain(item, (*at, key)) for key, item in value.items()}

    def _system(self, system: Any, at: KeyPath) -> dict[str, Any]:
        """The keys that a file states for a linear system at this place."""
        matrices = {name: np.asarray(getattr(system, name), dtype=np.float64).tolist() for name in "ABCD"}
        discrete = self._discrete(system, at)
        if at == _ENVIRONMENT:
            return {"type": "state-space", "time": "discrete" if discrete else "continuous", **matrices}
        if at[:-1] == _MATRICES:
            if not discrete:
                raise self.error(at, "a system in continuous time", f"one in discrete time, dt = {self.period} s")
            return matrices
        raise self.error(at, "a linear system", "one as environment, or as a block of design.matrices")

    def _transfer(self, transfer: Any, at: KeyPath) -> dict[str, Any]:
        """The keys that a file states for a transfer function at this place."""
        if self._discrete(transfer, at):
            raise self.error(at, "a transfer function in z", "one in s, or the system in state space")
        num, den = transfer.num, transfer.den
        if isinstance(num[0], int | float | np.number):  # SciPy's, with one input and one output
            num, den = [[num]], [[den]]
        rows = [[_rational(*entry) for entry in zip(*row, strict=True)] for row in zip(num, den, strict=True)]
        if at == _ENVIRONMENT:
            return {"type": "transfer-function", "entries": rows}
        if len(rows) != 1 or len(rows[0]) != 1:
            size = f"{len(rows)} outputs and {len(rows[0])} inputs"
            raise self.error(at, f"a transfer function with {size}", "one with one input and one output")
        return rows[0][0]

    def _discrete(self, system: Any, at: KeyPath) -> bool:
        """Whether a system is in discrete time, with the session's period."""
        if not hasattr(system, "dt"):
            raise self.error(
                at, f"{show(system)} without a sample time", "the attribute dt, in s; 0 for continuous time"
            )
        dt = system.dt
        if dt is None or (dt == 0 and dt is not False):
            return False
        period = self.period
        if dt is not True and not (isinstance(period, int | float) and math.isclose(dt, period, rel_tol=1e-9)):
            raise self.error(at, f"the sample time {dt!r} s", f"the session's period, {period!r} s, or continuous time")
        return True


def _rational(num: Any, den: Any) -> dict[str, Any]:
    return {"num": np.asarray(num, dtype=np.float64).tolist(), "den": np.asarray(den, dtype=np.float64).tolist()}
