"""When each node was last heard of."""

from __future__ import annotations

from collections.abc import Iterable

from manyhands.protocol.clock import Duration, Instant


class Attention:
    """Remembers instants by name; who was never heard of counts as heard when first asked for."""

    def __init__(self) -> None:
        self._heard: dict[str, Instant] = {}

    def note(self, name: str, now: Instant) -> None:
        """``name`` was heard of."""
        self._heard[name] = now

    def forget(self, name: str) -> None:
        """What comes from ``name`` is somebody else's from now on."""
        self._heard.pop(name, None)

    def quiet(self, names: Iterable[str], now: Instant, after: Duration) -> list[str]:
        """Those of ``names`` that have not been heard of for more than ``after``."""
        return [name for name in names if now - self._heard.setdefault(name, now) > after]
