"""The limit of open file descriptors of this process, which is raised or refused before ZeroMQ needs them.

ZeroMQ aborts the process where it gets no descriptor for a socket of its own, and an aborted process leaves its files.
"""

import os
import resource
from pathlib import Path
from typing import Final

from manyhands.protocol.transport import TransportError

PLENTY: Final = 65536
"""The limit that a process asks for: far more descriptors than all its doors use before they shut."""

_PROCESS: Final = 48  # interpreter, log, and a transport without links need about 16
_LINK: Final = 12  # a link with keys: listener, connection, monitor and mailboxes; and its successor after a loss


def node_needs(links: int) -> int:
    """The descriptors of a process with so many links, with a generous reserve."""
    return _PROCESS + _LINK * links


def require_descriptors(needed: int) -> None:
    """Make sure that this process may have so many descriptors; raise the soft limit where the hard limit allows it.

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
    """Make sure that a transport without links gets its descriptors beside those that are open.

    Raises:
        TransportError: the hard limit is too low.
    """
    require_descriptors(len(os.listdir(Path("/proc/self/fd"))) + _ROOM)


_ROOM: Final = 16


def allow_descriptors() -> None:
    """Raise the soft limit to :data:`PLENTY`, or as far as the hard limit allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = PLENTY if hard == resource.RLIM_INFINITY else min(PLENTY, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
