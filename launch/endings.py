"""How a process ended, in words."""

from __future__ import annotations

import signal


def ending(code: int) -> str:
    """What an exit code says (negative: the signal that killed it), to follow the process's name."""
    return f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"


def signal_name(number: int) -> str:
    """A signal's name; the realtime signals between the first and the last have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
