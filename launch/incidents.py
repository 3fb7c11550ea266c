"""What happened to a session that it withstood: told in order, and counted for each node."""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

MOST_INCIDENTS: Final = 100
"""How many are kept, the latest: a session may run for days."""


_FORGOTTEN = " earlier incidents"


class Incidents:
    """The latest incidents, and how many there were.

    Attributes:
        total: how many were told in all.
        restarts: how often each node came back into the session.
    """

    def __init__(self) -> None:
        self._latest: deque[str] = deque(maxlen=MOST_INCIDENTS)
        self.total = 0
        self.restarts: Counter[str] = Counter()

    def tell(self, sentence: str) -> None:
        """One more happened."""
        self._latest.append(sentence)
        self.total += 1

    @property
    def sentences(self) -> tuple[str, ...]:
        """The latest, oldest first; the first line says how many are no longer kept, if any are not."""
        forgotten = self.total - len(self._latest)
        return (*([f"{forgotten}{_FORGOTTEN}"] if forgotten else []), *self._latest)


def is_summary(sentence: str) -> bool:
    """Whether a sentence says how many incidents are no longer kept, and tells none."""
    return sentence.endswith(_FORGOTTEN) and sentence.removesuffix(_FORGOTTEN).isdecimal()
