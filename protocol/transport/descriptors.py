"""How many file descriptors this process may have open: seen to before ZeroMQ needs them.

ZeroMQ aborts the process where it gets no descriptor for a socket of its own, and a process that is aborted clears
nothing away.
"""

import os
import resource
from pathlib import Path
from typing import Final

from manyhands.protocol.transport import TransportError

PLENTY: Final = 65536
"""What is asked for where the limit is too low: far more than all doors of a process hold before they shut."""

_PROCESS: Final = 48  # interpreter, log, and a transport without links: about 16
_LINK: Final = 12  # one with keys: listener, connection, monitor and mailboxes; its successor while the link is mended


def node_needs(links: int) -> int:
    """Descriptors of a process with so many links, generously."""
    return _PROCESS + _LINK * links


def require_descriptors(needed: int) -> None:
    """Make sure that this process may have so many descriptors; the soft limit is raised where the hard one allows it.

    Raises:
        TransportError: the hard limit is too low.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise TransportError(
            f"found that this process may open {hard} files (ulimit -Hn); expected at least {needed} for its sockets"
        )
    allow_descriptors()


def require_room() -> None:
    """Make sure that a transport without links finds the descriptors it needs beside those that are open.

    Raises:
        TransportError: the hard limit is too low.
    """
    require_descriptors(len(os.listdir(Path("/proc/self/fd"))) + _ROOM)


_ROOM: Final = 16


def allow_descriptors() -> None:
    """Raise the soft limit to :data:`PLENTY`, or as far as the hard one allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = PLENTY if hard == resource.RLIM_INFINITY else min(PLENTY, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
