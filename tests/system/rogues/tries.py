"""Attempts of strangers at the doors of a running session and the expected results, as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import zmq

from .stage import OBSERVER, SUPERVISOR, RogueSession
from .strangers import GREETING, OVERSIZED, Claim, Fate


@dataclass(frozen=True)
class Door:
    """A listening socket: its owner, its peer, and the socket type that connects to it."""

    of: str
    to: str
    kind: int = zmq.PAIR

    def __str__(self) -> str:
        return f"the door of {self.of} for {self.to}"

    def endpoint(self, stage: RogueSession) -> str:
        """Where it is."""
        if self == HUB:
            return stage.hub
        return stage.observer if self.to == OBSERVER else stage.links[self.of, self.to]


HUB: Final = Door(SUPERVISOR, "members", zmq.DEALER)
WATCH: Final = Door(SUPERVISOR, OBSERVER, zmq.PULL)
CX_DX: Final = Door("cx", "dx")
CY_DY: Final = Door("cy", "dy")
CZ_DZ: Final = Door("cz", "dz")
ENVIRONMENT_CY: Final = Door("environment", "cy")


@dataclass(frozen=True)
class Try:
    """A stranger's attempt, the visible answer, its count, and its socket type if it differs from the door's."""

    what: str
    door: Door
    claim: Callable[[RogueSession, str], Claim]
    fate: Fate
    reason: str
    kind: int | None = None

    def __str__(self) -> str:
        return f"{self.what}, at {self.door}"


def _unknown(door: Door) -> Try:
    return Try("an unknown key", door, Claim.unknown, Fate.NOT_ADMITTED, "unknown_key")


def _pretended(name: str, door: Door) -> Try:
    what = f"the public key of {name} without its secret"
    return Try(what, door, lambda stage, of: Claim.pretended(stage, name, of), Fate.ENDED, "not_proved")


def _real(name: str, door: Door, reason: str, what: str = "") -> Try:
    """A real key at the wrong door; a key that the door wants is admitted and dismissed afterwards."""
    fate = Fate.ADMITTED if reason == "second_peer" else Fate.NOT_ADMITTED
    told = f"the real key of {name}" + (f", {what}" if what else "")
    return Try(told, door, lambda stage, of: Claim.of(stage, name, of), fate, reason)


TRIES: Final = (
    _unknown(HUB),
    _pretended("dz", HUB),
    Try(
        "the real key of dz, which takes the supervisor for cx",
        HUB,
        lambda stage, _: Claim.of(stage, "dz", "cx"),
        Fate.ENDED,
        "not_proved",
    ),
    _unknown(WATCH),
    _real("dx", WATCH, "wrong_key", "to look on"),
    _real(OBSERVER, WATCH, "second_peer", "a second time"),
    Try(
        f"the real key of {OBSERVER}, with a socket that can write",
        WATCH,
        lambda stage, of: Claim.of(stage, OBSERVER, of),
        Fate.ADMITTED,  # ZeroMQ does not compare the two ends' types
        "second_peer",
        zmq.PAIR,
    ),
    _unknown(CX_DX),
    _pretended("dx", CX_DX),
    _real("dy", CX_DX, "unknown_key", "a device at its neighbour's coupling"),
    _real("cy", CX_DX, "unknown_key"),
    _real(OBSERVER, CX_DX, "unknown_key", "an observer that would write samples"),
    _real("environment", CX_DX, "wrong_key"),
    _real("dx", CX_DX, "second_peer", "while the first connection lives"),
    _real("dx", CY_DY, "unknown_key", "a device asking for a neighbour's forces"),
    _real("cx", CY_DY, "unknown_key", "a coupling writing another's samples"),
    _pretended("cy", ENVIRONMENT_CY),
    _real("dy", ENVIRONMENT_CY, "unknown_key"),
    _real("cx", ENVIRONMENT_CY, "wrong_key", "a coupling writing another's tool and reading its forces"),
    _real("cy", ENVIRONMENT_CY, "second_peer", "while the first connection lives"),
)
"""Attempts to connect with keys."""

WITHOUT_KEYS: Final = tuple(
    (mechanism, door) for door in (HUB, WATCH, CX_DX, ENVIRONMENT_CY) for mechanism in ("NULL", "PLAIN")
)
"""Attempts by mechanisms that know no keys; each is counted as no_key."""

CROWDS: Final[Mapping[str, tuple[bytes, int]]] = {
    "nothing said": (b"", 200),
    "half a greeting": (GREETING[:30], 200),
    "garbage": (b"GET / HTTP/1.1\r\nHost: manyhands\r\n\r\n" * 4, 200),
    "a frame of 4 EiB": (GREETING + OVERSIZED, 20),
}
"""TCP connections that are opened and left: what each says, and how many there are at the door of a coupling."""

AT_THE_HUB: Final = 4
"""By which part of them there are at the supervisor's: it looks at once, shuts its door, and the kernel tries again."""

CROWDED: Final = (CY_DY, HUB)
HALFWAY: Final = (CZ_DZ, HUB)
"""Where a handshake of real keys stops in its middle."""


def crowded(door: Door) -> int:
    """The number of idle connections opened at a door in all, including halfway handshakes."""
    part = AT_THE_HUB if door == HUB else 1
    return (door in CROWDED) * sum(size // part for _, size in CROWDS.values()) + (door in HALFWAY)
