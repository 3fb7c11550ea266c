"""The command line's two output streams, and what becomes of them when they can no longer be written to.

Standard error is for a person who watches. A pipe that was closed, a terminal that hung up or a full disk behind it is
no reason to end a session: from then on nothing is written there, and :func:`lost_at` names the cause. Standard output
is for results. Where its reader has had enough (``| head``) a command goes on to its end and keeps its exit code,
unless it does nothing but print (:func:`pipe_may_close`). Any other failure there is the command's.

This is done below Python's text layer, so it holds for whatever writes to the streams.
"""

from __future__ import annotations

import errno
import io
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
    """Descriptor 1 or 2; after the first error it leads to nowhere, so that whatever is still buffered can leave.

    What is written here has left the text layer's buffer, so a signal handler that raises between two steps makes no
    text appear twice. Below this buffer it would: the buffer repeats a write that raised after it was done.

    Attributes:
        lost: the error that ended it; None while it works.
        raises_when_closed: whether a reader that left is an error (``BrokenPipeError``, once).
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(io.FileIO(descriptor, "w", closefd=False))
        self.lost: OSError | None = None
        self.raises_when_closed = False

    def write(self, data: ReadableBuffer, /) -> int:
        """Buffer the data, and write what does not fit; all of it counts as written once the stream is lost.

        Raises:
            OSError: standard output cannot be written, for another reason than a reader that left.
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
        """Write what is buffered.

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
        """Lead to nowhere from now on; raises the error where it is the command's."""
        self.lost = error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        left = error.errno == errno.EPIPE
        if self.fileno() == _OUT and (self.raises_when_closed or not left):
            raise type(error)(error.errno, error.strerror, _NAMES[_OUT]) from error


def install() -> None:
    """Make standard output and standard error streams of :class:`Output`; to be called once, first of all.

    A descriptor that the process was started without is opened on nothing: otherwise the next file or socket would get
    its number, and receive what is meant for a person. Characters that the stream's encoding lacks are escaped.
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
    """Why ``stream`` can no longer be written to, for a person; None if it can, or is no stream of ours."""
    output = _output_of(stream)
    if output is None or output.lost is None:
        return None
    return f"{_NAMES[output.fileno()]}: {output.lost.strerror}"


def has_room(stream: IO[str]) -> bool:
    """Whether ``stream`` takes something now; a terminal that was stopped (Ctrl-S) or a full pipe does not."""
    output = _output_of(stream)
    return output is None or bool(select.select([], [output], [], 0)[1])


@contextmanager
def pipe_may_close() -> Iterator[None]:
    """For a command that does nothing but print: it is done, and well, when nobody reads standard output any more."""
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
