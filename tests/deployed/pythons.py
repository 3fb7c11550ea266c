"""``make pythons``: the suite on every version of Python that pyproject.toml declares, where each is to be had.

    python -m tests.deployed.pythons [--target pytest] [--only 3.14] [TESTS ...]

A version is an interpreter on PATH, one of pyenv's, or ``python3`` of the suite of Debian that has it, in a root file
system that mmdebstrap makes. Each gets an environment of its own with everything that development needs, a wheel with
the compiled tick, whose import is checked, and the suite: all that `make test` runs, or the tests that are named.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.deployed.checks import ROOT, Checks, done, sources
from tests.deployed.debian import NAMES, REGISTRY, SUITES, of_this_machine, root_file_system

_PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text())
VERSIONS: Final = tuple(
    version for line in _PROJECT["project"]["classifiers"] for version in re.findall(r"Python :: (3\.\d+)$", line)
)
_TICK: Final = _PROJECT["tool"]["cibuildwheel"]["test-command"]
_PACKAGES: Final = (
    "python3", "python3-venv", "python3-dev", "gcc", "g++", "libc6-dev", "make", "git", "ca-certificates", "iproute2",
    "util-linux", "procps", "systemd",
)  # fmt: skip
_ENTER: Final = """
for place in dev dev/shm sys; do mkdir -p "$0/$place"; mount --bind "/$place" "$0/$place"; done
mount -t proc proc "$0/proc"
exec chroot "$0" "$@"
"""
"""Enters a root file system from a mount namespace of its own, with which the mounts end."""


@dataclass(frozen=True)
class Interpreter:
    """A version of Python.

    Attributes:
        source: where it is from, for the report.
        program: the interpreter.
        root: the root file system that it runs in; None for this machine's.
    """

    source: str
    program: str
    root: Path | None = None

    def run(self, command: Sequence[str | Path], source: Path, within: float) -> tuple[int, str]:
        """Run a command in a copy of the sources; returns its exit code and output."""
        inner = Path("/", source.relative_to(self.root)) if self.root else source
        words = ["sh", "-c", 'cd "$0" && exec "$@"', inner, *command]
        inside = ["unshare", "--mount", "--", "sh", "-c", _ENTER, self.root] if self.root else []
        found = done([*inside, *words], within=within, env=_environment(self.root))
        return found.returncode, found.stdout + found.stderr


def _environment(root: Path | None) -> dict[str, str]:
    outer = {
        key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV", "PYENV_VERSION")
    }
    if root is None:
        return outer
    kept = {key: value for key, value in outer.items() if key.startswith(("MANYHANDS_", "OPENBLAS_"))}
    return {**kept, "PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "LANG": "C.UTF-8"}


@contextmanager
def interpreter(version: str) -> Iterator[Interpreter | str]:
    """The interpreter of a version, while it is entered; where there is none, the reason."""
    for source, program in _here(version):
        found = done([program, "-c", "import sys, ensurepip, venv; print('%d.%d.%d' % sys.version_info[:3])"])
        if found.returncode == 0 and found.stdout.startswith(f"{version}."):
            yield Interpreter(f"{source}, {found.stdout.strip()}", program)
            return
    missing = [
        tool
        for tool in ("mmdebstrap", "chroot", "unshare")
        if shutil.which(tool, path=f"{os.environ['PATH']}:/usr/sbin") is None
    ]
    if version not in SUITES or os.geteuid() != 0 or missing:
        why = "no suite of Debian has it as python3" if version not in SUITES else "Debian's needs root and mmdebstrap"
        yield f"none on PATH, none of pyenv's, and {why}"
        return
    with tempfile.TemporaryDirectory(prefix="mh-python-", ignore_cleanup_errors=True) as name:
        root = root_file_system(Path(name) / "root", SUITES[version], _PACKAGES)
        for file in of_this_machine(*NAMES, *REGISTRY):
            shutil.copy(file, root / file.relative_to("/"))
        yield Interpreter(f"Debian {SUITES[version]}", "/usr/bin/python3", root)


def _here(version: str) -> Iterator[tuple[str, str]]:
    """Where an interpreter of a version may be on this machine."""
    if (own := shutil.which(f"python{version}")) is not None:
        yield "PATH", own
    home = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    for folder in sorted(home.glob(f"versions/{version}.*"), reverse=True):
        yield "pyenv", str(folder / "bin" / "python")


def main() -> int:
    """Run the suite on each version; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", default="pytest", help="of the Makefile, where no tests are named")
    parser.add_argument("--only", action="append", choices=VERSIONS, help="this version; repeatable")
    parser.add_argument("tests", nargs="*", help="what pytest is given in place of the whole suite")
    asked = parser.parse_args()
    checks = Checks()
    for version in asked.only or VERSIONS:
        with interpreter(version) as found:
            if isinstance(found, str):
                checks.say(f"---   Python {version} could not be had: {found}")
                continue
            place = (found.root / "root") if found.root else Path(tempfile.gettempdir())
            with tempfile.TemporaryDirectory(prefix="mh-suite-", dir=place) as name:
                _suite(checks, version, found, Path(name) / "manyhands", asked.tests, asked.target)
    return checks.end()


def _suite(checks: Checks, version: str, python: Interpreter, source: Path, tests: Sequence[str], target: str) -> None:
    """Check one version, in a copy of what is committed or was changed since."""
    sources(source)
    for command in (["git", "init", "-q"], ["git", "add", "-A"]):
        done(["git", "-C", source, *command[1:]])

    def step(sentence: str, command: Sequence[str | Path], within: float) -> bool:
        began = time.monotonic()
        code, said = python.run(command, source, within)
        last = (re.findall(r"=+ (.* in .*) =+", said) or [""])[-1]
        took = f"{last or 'done'}, {time.monotonic() - began:.0f} s"
        checks.that(f"Python {version} ({python.source}): {sentence}", code == 0, took if code == 0 else said)
        return code == 0

    if not step("everything is installed", ["make", f"PYTHON={python.program}", ".venv/.installed"], 1800.0):
        return
    build = ".venv/bin/python -m build --no-isolation --wheel --outdir wheel ."
    take = ".venv/bin/python -m pip install --quiet --no-deps --no-index --target tick wheel/*-linux_*.whl"
    step("a wheel has the compiled tick", ["sh", "-ec", f"{build}; {take}; PYTHONPATH=tick .venv/bin/{_TICK}"], 1800.0)
    command = [".venv/bin/pytest", "-q", *tests] if tests else ["make", f"PYTHON={python.program}", target]
    step("the suite" if not tests else " ".join(tests), command, 3 * 3600.0)


if __name__ == "__main__":
    sys.exit(main())
