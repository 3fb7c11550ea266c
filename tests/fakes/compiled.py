"""C code of the tests, compiled once a session: a test that needs it is skipped where there is no compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

FAKES = Path(__file__).parent
FIRMWARE = Path(__file__).parents[2] / "devices" / "serial_board" / "firmware"
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_COMPILER") == "1"

STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


@cache
def _folder() -> Path:
    """Outside the folder of any one test, which ends empty; `folder_of_compiled` in tests/conftest.py sets it."""
    return Path(os.environ["MANYHANDS_COMPILED"])


@cache
def built(name: str, sources: tuple[Path, ...], flags: tuple[str, ...] = ()) -> Path:
    """A program or a library, by the platform's own compiler."""
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        assert not REQUIRED, "MANYHANDS_REQUIRE_COMPILER is set, and there is no C compiler"
        pytest.skip("there is no C compiler")
    made = _folder() / name
    command: Sequence[str] = (
        *(compiler, "-O2", f"-I{FIRMWARE}", f"-I{FAKES}", *flags),
        *(str(source) for source in sources),
        *("-lm", "-o", str(made)),
    )
    subprocess.run(command, check=True, capture_output=True, text=True)
    return made


def board() -> Path:
    """The fake board, a program."""
    return built("board", (FAKES / "board.c", FIRMWARE / "mhb.c"), ("-std=gnu99", "-Wall", "-Wextra", "-Werror"))


def core() -> Path:
    """The firmware's core alone, a library: C99 and nothing else."""
    return built("libmhb.so", (FIRMWARE / "mhb.c",), ("-std=c99", *STRICT, "-shared", "-fPIC"))
