"""Arrays in a .npz file, read without running its code or trusting the sizes that it states."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import open_regular

_HEADERS: Final[Mapping[int, Callable[[Any], Any]]] = {
    1: np.lib.format.read_array_header_1_0,
    2: np.lib.format.read_array_header_2_0,
}
"""The function that reads an array's header (shape, order and type), by the version of its format."""


def read_arrays(path: Path, choices: Sequence[Sequence[str]], most: int) -> dict[str, NDArray[np.generic]]:
    """The arrays of a ``.npz`` file that the first complete list in ``choices`` names.

    The size that a member states is compared with the file and the limit before memory is allocated for it.

    Args:
        path: the file.
        choices: lists of array names; the first list of which the file has every array is read.
        most: greatest size in bytes, of the file and of its unpacked content.

    Raises:
        OSError, ValueError: the file cannot be read, is damaged or too large, or matches no list of names.
    """
    try:
        with open_regular(path, most) as file, zipfile.ZipFile(file) as archive:
            members = {member.filename: member for member in archive.infolist()}
            for wanted in choices:
                files = [f"{name}.npy" for name in wanted]
                if members.keys() >= {*files}:
                    if sum(members[one].file_size for one in files) > most:
                        raise ValueError(f"larger than {most} bytes when unpacked")
                    return {name: _array(archive, members[one]) for name, one in zip(wanted, files, strict=True)}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:  # encrypted: RuntimeError
        raise ValueError(f"which is damaged ({error})") from error
    raise ValueError(f"which does not hold {', or '.join(', '.join(wanted) for wanted in choices)}")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """One array; ValueError unless the size in its header is the size of its file."""
    with archive.open(member) as file:
        major, _ = np.lib.format.read_magic(file)
        if major not in _HEADERS:
            raise ValueError(f"with an array of version {major}; expected 1 or 2")
        shape, _, dtype = _HEADERS[major](file)
        if dtype.hasobject:
            raise ValueError("which holds Python's objects and not numbers or texts")  # reading them would run code
        stated = math.prod(shape) * dtype.itemsize
        if member.file_size - file.tell() != stated:
            raise ValueError(f"with an array of {stated} bytes by its header and {member.file_size} in its file")
        file.seek(0)
        array: NDArray[np.generic] = np.lib.format.read_array(file, allow_pickle=False)
    return array
