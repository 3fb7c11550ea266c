"""What somebody on another machine needs to take part with one node: its bundle and its key, and nothing of others."""

from __future__ import annotations

from pathlib import Path

from manyhands.design.files import replacing
from manyhands.launch.bundles import Run, bundle_of
from manyhands.launch.files import require_target
from manyhands.launch.keys import Keys
from manyhands.launch.preparation import Prepared
from manyhands.launch.reach import Listen, ReachError, reach
from manyhands.launch.session.error import one_of
from manyhands.nodes import bundle as bundle_files
from manyhands.nodes.bundle import Bundle


def invite(prepared: Prepared, name: str, keys: Keys | None, clock: str, path: Path) -> Bundle:
    """Cut one node's (or observer's) bundle and write it for its owner's eyes only (mode 0600); returns it.

    Args:
        prepared: the session, under the certificate that it will be launched with.
        name: the node or observer.
        keys: the session's keys; None for a session that is not encrypted.
        clock: "realtime" or "simulated", as it will be launched.
        path: where the bundle goes; a file that is there is replaced.

    Raises:
        ReachError: no such node or observer.
        KeyFileError: no key of it, or of somebody it has to do with.
        TargetError, OSError: the file cannot be written.
    """
    session = prepared.session
    valid = (*session.roles, *session.observers)
    if name not in valid:
        raise ReachError(f"{session.name}: found no node or observer {name!r:.100}; expected {one_of(valid, name)}")
    require_target(path)
    ways = reach(prepared, "tcp", insecure=keys is None, keys=keys, listen=Listen(), remote=frozenset())
    # what only the guest knows is filled in when it joins; traces, for it cannot be told later that they are wanted
    bundle = bundle_of(prepared, Run(clock, None, "", reach=ways), name)
    with replacing(path, mode=0o600) as file:
        file.write(bundle_files.encoded(bundle))
    return bundle
