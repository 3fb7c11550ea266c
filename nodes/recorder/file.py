"""The recording on the disk: pieces are appended whole, or the file stays as it was before."""

from __future__ import annotations

import os
from pathlib import Path

from manyhands.design.files import open_beside


class RecordingFile:
    """A file that takes the place of an older one when it has its beginning, and grows from then on.

    Every piece is on the disk (fdatasync) when :meth:`append` returns: what a power failure takes is what came after.
    """

    def __init__(self, path: Path, beginning: bytes) -> None:
        """Begin the file.

        Raises:
            OSError: it cannot be written; an older one of that name is still there.
        """
        partial, self._file = open_beside(path)
        self._fd = self._file.fileno()
        self._length = 0
        try:
            self.append(beginning)
            os.replace(partial, path)
        except BaseException:
            self.close()
            partial.unlink(missing_ok=True)
            raise

    def append(self, piece: bytes) -> None:
        """Add a piece, whole or not at all.

        Raises:
            OSError: there is no room, or the disk fails.
        """
        try:
            rest = memoryview(piece)
            while rest:
                rest = rest[os.write(self._fd, rest) :]
            os.fdatasync(self._fd)
        except OSError:
            os.ftruncate(self._fd, self._length)  # needs no room
            os.lseek(self._fd, self._length, os.SEEK_SET)
            raise
        self._length += len(piece)

    def close(self) -> None:
        """Close it."""
        self._file.close()  # nothing is buffered in it
