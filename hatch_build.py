"""Build hook: compiles the modules of the tick with mypyc (docs/decisions/0032-a-compiled-tick.md).

Every wheel has it, with the tag of its platform. Hatch's own environment variable turns the hook off, for a wheel that
is pure Python (py3-none-any):

    HATCH_BUILD_NO_HOOKS=true pip install .

Where there is no compiler, or it fails, the wheel is pure Python as well, and a warning gives the reason. An editable
installation is never compiled: an extension would take precedence over the source that somebody edits.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MODULES = [
    "protocol/clock",
    "protocol/codec",
    "protocol/gate",
    "protocol/transport/zeromq",
    "nodes/kernel/arithmetic",
    "nodes/kernel/passivity",
    "nodes/link/join",
    "nodes/link/peer_link",
    "nodes/joins",
    "nodes/rows/distribution",
    "nodes/rows/two_port",
    "nodes/device/core",
    "nodes/device/drivers",
    "nodes/device/dry_joints",
    "nodes/device/friction",
    "nodes/device/given",
    "nodes/device/speed_bound",
    "nodes/device/interface",
    "nodes/device/mechanism",
    "nodes/device/node",
    "nodes/device/play",
    "nodes/device/pointer",
    "nodes/device/simulated",
    "nodes/device/telemetry",
    "nodes/device/tick",
    "nodes/device/wall_time",
    "nodes/coupling/block",
    "nodes/coupling/core",
    "nodes/coupling/port",
    "nodes/coupling/node",
    "nodes/coupling/within",
    "nodes/environment/clutch",
    "nodes/environment/core",
    "nodes/environment/energy",
    "nodes/environment/late_arrivals",
    "nodes/environment/membership",
    "nodes/environment/node",
    "nodes/environment/pace",
    "nodes/environment/scene",
    "nodes/wave_link/ends",
    "nodes/wave_link/faces",
    "nodes/wave_link/play_out",
    "nodes/wave_link/rows",
    "nodes/wave_link/tank",
]
"""The modules that a tick runs through. A class of theirs can be derived from in these modules alone."""

_FOLDERS = ("design", "protocol", "nodes")  # what these modules import; types are taken from there

# a sum of products must be rounded after each product, as Python does it: -ffp-contract=off
_SETUP = """
from mypyc.build import mypycify
from setuptools import setup

extensions = mypycify(["--config-file", "mypy.ini", *{files!r}], opt_level="3", debug_level="0")
for extension in extensions:
    extension.extra_compile_args.append("-ffp-contract=off")
setup(name="compiled", packages=[], ext_modules=extensions)
"""

# what these modules import lends its types alone: where a later numpy states its own more narrowly, a line of a module
# that is not compiled says nothing against those that are
_MYPY = """
[mypy]
explicit_package_bases = True
namespace_packages = True
ignore_missing_imports = True
ignore_errors = True
"""
_OF_A_MODULE = """
[mypy-{name}]
ignore_errors = False
"""


class NotCompiled(Exception):
    """The modules could not be compiled; the text gives the reason."""


def compiled(root: Path, folder: Path, modules: list[str] = MODULES) -> dict[str, str]:
    """Compile ``modules`` of the checkout ``root`` in the empty ``folder``.

    Returns:
        The extensions, by file the place in the wheel.

    Raises:
        NotCompiled: there is no compiler, no header or no mypyc, or one of them failed.
    """
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        raise NotCompiled(f"found no C compiler {compiler}; expected one")
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        raise NotCompiled(f"found no {header}; expected the headers of this Python (python3-dev)")
    for library in ("mypyc", "setuptools"):
        if importlib.util.find_spec(library) is None:
            raise NotCompiled(f"found no {library}; expected mypy[mypyc]")
    package = folder / "manyhands"
    package.mkdir()
    for file in (root / "src" / "manyhands").glob("*.py*"):
        shutil.copy(file, package)
    (package / "py.typed").touch()
    for name in _FOLDERS:
        shutil.copytree(root / name, package / name, ignore=shutil.ignore_patterns("__pycache__"))
    names = (f"manyhands.{module.replace('/', '.')}" for module in modules)
    (folder / "mypy.ini").write_text(_MYPY + "".join(_OF_A_MODULE.format(name=name) for name in names))
    (folder / "setup.py").write_text(_SETUP.format(files=[f"manyhands/{module}.py" for module in modules]))
    done = subprocess.run(
        [sys.executable, "setup.py", "--quiet", "build_ext", "--inplace"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise NotCompiled(_last_words(done.stderr or done.stdout))
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    found = [*folder.glob(f"*{suffix}"), *package.rglob(f"*{suffix}")]
    return {str(file): str(file.relative_to(folder)) for file in found}


def _last_words(output: str) -> str:
    """The last line of a failed compilation that says anything; a build's log is no place for a thousand others."""
    said = [line.strip() for line in output.splitlines() if line.strip()]
    return said[-1][:500] if said else "the compiler failed, and said nothing"


class CompiledTick(BuildHookInterface[Any]):
    """Adds the extensions to a wheel."""

    PLUGIN_NAME = "custom"

    _folder: tempfile.TemporaryDirectory[str] | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile before the wheel is packed; see the module."""
        if version == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()
        try:
            extensions = compiled(Path(self.root), Path(self._folder.name))
        except NotCompiled as reason:
            self.app.display_warning(f"the tick is not compiled, and stays pure Python: {reason}")
            return
        build_data["force_include"].update(extensions)
        build_data["pure_python"], build_data["infer_tag"] = False, True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled; the wheel has it."""
        if self._folder is not None:
            self._folder.cleanup()
