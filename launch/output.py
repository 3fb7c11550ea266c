"""The command line's two output streams, and what happens when they can no longer be written.

Standard error is for a person who watches. If its pipe or terminal is closed, or its disk is full, the session goes on:
from then on nothing is written there, and :func:`lost_at` names the cause. Standard output is for results. When its
reader ends first (``| head``), a command continues to its end and keeps its exit code, unless it only prints
(:func:`pipe_may_close`). Any other failure of standard output fails the command.

All this happens below Python's text layer, so it holds for every writer.
"""

from __future__ import annotations

import errno
import io
import json
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Final, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_OUT, _ERR = 1, 2
_NAMES: Final = {_OUT: "standard output", _ERR: "standard error"}


class Output(io.BufferedWriter):
    """Descriptor 1 or 2; after the first error it writes to /dev/null, so that buffered text can be flushed.

    Data that is written here has left the buffer of the text layer, so a signal handler that raises between two steps
    makes no text appear twice. Below this buffer it would: a buffer repeats a write that raised after it was done.

    Attributes:
        lost: the error that ended the stream; None while it works.
        raises_when_closed: whether a closed pipe is an error (``BrokenPipeError``, once).
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(io.FileIO(descriptor, "w", closefd=False))
        self.lost: OSError | None = None
        self.raises_when_closed = False

    def write(self, data: ReadableBuffer, /) -> int:
        """Buffer the data, and write what does not fit; returns the number of bytes, lost ones included.

        Raises:
            OSError: standard output cannot be written; a closed pipe counts only with ``raises_when_closed``.
        """
        view, done = memoryview(data).cast("B"), 0
        while True:
            try:
                super().write(view[done:])
                return len(view)
            except BlockingIOError as error:  # another program has made the terminal non-blocking
                done += error.characters_written
                select.select([], [self], [])
            except OSError as error:
                self._lose(error)

    def flush(self) -> None:
        """Write the buffered data.

        Raises:
            OSError: as by :meth:`write`.
        """
        while True:
            try:
                return super().flush()
            except BlockingIOError:
                select.select([], [self], [])
            except OSError as error:
                self._lose(error)

    def _lose(self, error: OSError) -> None:
        """Write to /dev/null from now on; raise the error if it has to fail the command."""
        self.lost = error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        left = error.errno == errno.EPIPE
        if self.fileno() == _OUT and (self.raises_when_closed or not left):
            raise type(error)(error.errno, error.strerror, _NAMES[_OUT]) from error


def install() -> None:
    """Make standard output and standard error streams of :class:`Output`; a process calls this once, at its start.

    If the process was started without one of the descriptors 0 to 2, that one is opened on /dev/null. Otherwise the
    next file or socket would get its number and receive text for a person. Characters that the stream's encoding lacks
    are escaped.
    """
    for descriptor in (0, _OUT, _ERR):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free
    sys.stdout, sys.stderr = _stream(sys.stdout, _OUT), _stream(sys.stderr, _ERR)


def _stream(before: TextIO | None, descriptor: int) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        Output(descriptor),
        encoding="utf-8" if before is None else before.encoding,
        errors="backslashreplace",
        line_buffering=descriptor == _ERR or getattr(before, "line_buffering", False),
        write_through=getattr(before, "write_through", False),
    )


def lost_at(stream: IO[str]) -> str | None:
    """Why ``stream`` can no longer be written, as a text; None if it works, or is not an :class:`Output`."""
    output = _output_of(stream)
    if output is None or output.lost is None:
        return None
    return f"{_NAMES[output.fileno()]}: {output.lost.strerror}"


def has_room(stream: IO[str]) -> bool:
    """Whether ``stream`` can be written without waiting; a stopped terminal (Ctrl-S) or a full pipe cannot."""
    output = _output_of(stream)
    return output is None or bool(select.select([], [output], [], 0)[1])


@contextmanager
def pipe_may_close() -> Iterator[None]:
    """For a command that only prints: while entered, a closed standard output ends the command without an error."""
    output = _output_of(sys.stdout)
    if output is not None:
        output.raises_when_closed = True
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        return
    finally:
        if output is not None:
            output.raises_when_closed = False


def _output_of(stream: IO[str]) -> Output | None:
    found = getattr(stream, "buffer", None)
    return found if isinstance(found, Output) else None


def print_json(data: object) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(data, indent=2, allow_nan=False))  # noqa: T201 -- what the function is for
