"""A bundle and a private key that come over standard input, from a launch that starts this node by ssh.

They come as one line of JSON: neither is on a command line, in an environment, or in a file that outlives its reading.
After that line the input stays open for as long as the launching process lives. Its end ends this one.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from manyhands.design.files import open_new
from manyhands.nodes.kernel.bundle import MAX_FILE_BYTES, Bundle, BundleError, elsewhere
from manyhands.protocol.plain import written

STDIN: Final = Path("-")
"""In place of a bundle's file."""


def handed_over(bundle: Bundle, key: bytes) -> bytes:
    """What goes to the node's standard input, as one line.

    Args:
        bundle: the node's bundle; no path of the launching machine goes with it.
        key: the content of the file of its private key.
    """
    bundle = replace(bundle, common=replace(bundle.common, directory="", private=""))
    return json.dumps({"bundle": written(elsewhere(bundle)), "key": json.loads(key)}, allow_nan=False).encode() + b"\n"


@contextmanager
def taken_over(name: str) -> Iterator[Path]:
    """The bundle that comes over standard input, with its key beside it, while entered.

    The files have mode 0600, in a new folder of mode 0700. The caller leaves the context once they are read.

    Raises:
        BundleError: what comes is not what :func:`handed_over` writes.
    """
    line = sys.stdin.buffer.readline(MAX_FILE_BYTES)
    try:
        parts = json.loads(line)
        bundle, key = parts["bundle"], parts["key"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BundleError("standard input: found no bundle and key; expected them as launch --on sends them") from error
    with TemporaryDirectory(prefix="manyhands-") as folder:
        path = Path(folder) / f"{name}.bundle"
        for of, content in ((path, bundle), (path.with_suffix(".key"), key)):
            with open_new(of, mode=0o600) as file:
                file.write(json.dumps(content).encode())
        yield path


def end_with_input() -> None:
    """Ask this process to end when its standard input ends."""

    def watch() -> None:
        while os.read(sys.stdin.fileno(), 65536):
            continue
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
