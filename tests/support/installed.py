"""The built distributions, and an installation with the libraries of the base alone.

No registry is asked: the base's libraries are linked from this environment, found by what the wheel and they themselves
state that they require.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]

NEEDED = {
    "mesh": "mesh",
    "design": "design",
    "verify": "design",
    "budget": "design",
    "identify": "design",
    "sweep": "design",
    "simulate": "design",
    "launch": "design",
    "demo": "design,record,plot",
    "view": "view",
    "record": "record",
    "info": "record",
    "plot": "plot",
    "export": "record",
    "replay": "record,design",
    "audit": "record,design",
    "host": "design",
    "invite": "design",  # a bundle; keys alone need none
    "doctor": "design",
}
"""The extras that the example of each command needs; those of other commands need none."""


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Run a program to its end and return its standard output.

    Raises:
        AssertionError: its exit code is not 0; the message has its output.
    """
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class Distributions(NamedTuple):
    """The files that are published."""

    sdist: Path
    wheel: Path


PURE = {"HATCH_BUILD_NO_HOOKS": "true"}
"""The environment in which a wheel is built as pure Python: compiling takes a minute, and a test of its own."""


def build(out: Path) -> Distributions:
    """The source distribution, and the wheel built from it where it is unpacked, without the checkout around it.

    The wheel is pure Python.
    """
    command = [sys.executable, "-P", "-m", "build", "--no-isolation", "--outdir"]
    run(*command, out, "--sdist", ROOT, cwd=out)
    (sdist,) = out.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        # Python 3.11 has filters from its fourth patch on
        archive.extractall(out, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    (source,) = [path for path in out.iterdir() if path.is_dir()]
    run(*command, out, "--wheel", source, cwd=out, **PURE)
    (wheel,) = out.glob("*.whl")
    return Distributions(sdist, wheel)


def install_base(folder: Path, wheel: Path) -> Path:
    """A virtual environment with the wheel and what it requires without any extra; returns its ``bin``."""
    venv.create(folder, with_pip=False)
    pip = [sys.executable, "-P", "-m", "pip", "--python", folder / "bin" / "python", "install", "--quiet"]
    run(*pip, "--no-deps", "--no-index", wheel, cwd=folder)
    site = _site(folder)
    (installed,) = Distribution.discover(name="manyhands", path=[str(site)])
    for library in _required(installed):
        link(library, site)
    return folder / "bin"


def link(library: Distribution, site: Path) -> None:
    """Link a distribution of this environment into a folder."""
    for entry in {file.parts[0] for file in library.files or ()} - {"..", "__pycache__"}:
        if not (site / entry).exists():
            (site / entry).symlink_to(library.locate_file(entry))


def base_sizes(bin_: Path) -> dict[str, float]:
    """What each distribution of such an environment takes on the disk, MB, as ``du`` counts it: whole blocks.

    What Python compiles of it at the installation is not counted, for it depends on how it was installed.
    """
    site = _site(bin_.parent)
    (installed,) = Distribution.discover(name="manyhands", path=[str(site)])
    return {one.name: _size(one) for one in (installed, *_required(installed))}


def _size(one: Distribution) -> float:
    places = {Path(str(one.locate_file(file))) for file in one.files or () if file.suffix != ".pyc"}
    return sum(place.stat().st_blocks * 512 for place in places if place.exists()) / 2**20


def _site(folder: Path) -> Path:
    return Path(sysconfig.get_path("purelib", "venv", {"base": str(folder), "platbase": str(folder)}))


def _required(installed: Distribution) -> list[Distribution]:
    """What a distribution requires without extras, and what that requires in turn."""
    found: dict[str, Distribution] = {}
    waiting = [(installed, "")]
    while waiting:
        one, extra = waiting.pop()
        for text in one.requires or ():
            requirement = Requirement(text)
            name = canonicalize_name(requirement.name)
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
                waiting += [(distribution(name), wanted) for wanted in requirement.extras]
                if name not in found:
                    found[name] = distribution(name)
                    waiting.append((found[name], ""))
    return list(found.values())
