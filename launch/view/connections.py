"""Which connections the page's server keeps, so that those who say nothing do not keep out those who do. Pure.

A connection is *open to question* until a page has been admitted over it. Until then it has a deadline for each request
and its answer, and it is the first to go when there is no room for another: a browser asks as soon as it has connected,
so a crowd of silent connections pushes itself out.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, Protocol

from manyhands.protocol.clock import Duration, Instant, from_seconds

MOST_CONNECTIONS: Final = 64
"""Connections at a time, of which pages are some."""

MOST_OF_AN_ADDRESS: Final = 32
"""Connections of one address at a time: a browser has six, and one for each page."""

ANSWERED_WITHIN: Final = from_seconds(10.0)
"""How long a request may take from the connection, or from the answer before, until its own answer was taken."""


class Connection(Protocol):
    """What is asked of a connection; asyncio's transports are some."""

    def is_closing(self) -> bool:
        """Whether it is over, or will be."""
        ...

    def abort(self) -> None:
        """End it at once."""
        ...


Client = tuple[str, int]
"""Address and port of whoever has connected."""


class Connections:
    """The connections of a server.

    Attributes:
        refused: connections that were ended, by reason.
    """

    def __init__(self, refused: Counter[str]) -> None:
        self.refused = refused
        self._all: dict[Client, Connection] = {}
        self._since: dict[Client, Instant] = {}  # of those open to question, the longest first

    def opened(self, client: Client, connection: Connection, now: Instant) -> None:
        """Somebody has connected: where there is no room, end the connection that has been silent for longest."""
        self._forget_closed()
        self._all[client], self._since[client] = connection, now
        if sum(host == client[0] for host, _ in self._all) > MOST_OF_AN_ADDRESS:
            self._end(next(one for one in self._since if one[0] == client[0]), "too_many")
        elif len(self._all) > MOST_CONNECTIONS:
            self._end(next(iter(self._since)), "too_many")

    def answered(self, client: Client, now: Instant) -> None:
        """A request was answered; the next one has as long again."""
        if self._since.pop(client, None) is not None:
            self._since[client] = now

    def admitted(self, client: Client) -> None:
        """It carries a page now, which is looked after elsewhere."""
        self._since.pop(client, None)

    def end_overdue(self, now: Instant) -> None:
        """End the connections whose request, or its answer, takes too long."""
        self._forget_closed()
        for client in [client for client, since in self._since.items() if Duration(now - since) > ANSWERED_WITHIN]:
            self._end(client, "too_slow")

    def _end(self, client: Client, why: str) -> None:
        self.refused[why] += 1
        del self._since[client]
        self._all.pop(client).abort()

    def _forget_closed(self) -> None:
        for client in [client for client, connection in self._all.items() if connection.is_closing()]:
            del self._all[client]
            self._since.pop(client, None)
