"""The lines of JSON that a process of the probe and the one that started it exchange.

A task; of a tick's processes the endpoints of the links that each binds, those that each connects to, that it is ready,
and the instant of the first tick; the figures.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from manyhands.nodes.realtime import Grant, Granted


class PeerGone(Exception):
    """The process that started this one has closed its side."""


def tell(message: Mapping[str, Any]) -> None:
    """A line to the process that started this one."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def hear() -> dict[str, Any]:
    """The next line from the process that started this one.

    Raises:
        PeerGone: there is none any more.
    """
    line = sys.stdin.readline()
    if not line.endswith("\n"):
        raise PeerGone
    message: dict[str, Any] = json.loads(line)
    return message


def said(granted: Granted) -> dict[str, Any]:
    """What was granted, as a line of JSON carries it."""
    return {"granted": {name: [grant.granted, grant.said] for name, grant in granted.grants().items()}}


def granted(figures: Mapping[str, Any]) -> dict[str, Grant]:
    """What a process of the probe has :func:`said`."""
    return {name: Grant(bool(yes), str(text)) for name, (yes, text) in figures["granted"].items()}
