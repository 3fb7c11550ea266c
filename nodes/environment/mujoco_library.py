"""Which MuJoCo is installed: one alone, and of a version that this package is tested with.

MuJoCo is published as two distributions that write the same files: ``mujoco``, and from 4.0 on ``mujoco-core``, which
``mujoco`` of the same version requires. Of two different versions the one that was installed last has overwritten files
of the other, and pip says nothing.
"""

from __future__ import annotations

import importlib
import re
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

from manyhands.extras import explained

OLDEST: Final = (3, 2, 7)
"""The oldest version with which the tests of the engine were run."""

NEWEST: Final = 4
"""The newest major version with which they were run."""

_DISTRIBUTIONS: Final = ("mujoco", "mujoco-core")
_WANTED: Final = f"'mujoco>={'.'.join(map(str, OLDEST))},<{NEWEST + 1}'"


class WrongMujoco(ImportError):
    """MuJoCo is there twice, broken, or of a version that was not tested; the message names what to install."""


def installed() -> dict[str, str]:
    """The versions of MuJoCo's distributions that are installed, by name."""
    found = {}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def require_one(found: dict[str, str]) -> None:
    """Refuse distributions of different versions.

    Args:
        found: as from :func:`installed`.

    Raises:
        WrongMujoco: there are two versions.
    """
    if len({*found.values()}) > 1:
        both = " and ".join(f"{name} {number}" for name, number in found.items())
        raise WrongMujoco(
            f"found {both}, which write the same files; expected one version: pip uninstall -y "
            f"{' '.join(_DISTRIBUTIONS)}, then pip install {_WANTED}"
        )


def require_tested(number: str) -> None:
    """Refuse a version that the tests of the engine were not run with.

    Args:
        number: the version, such as "3.17.0".

    Raises:
        WrongMujoco: it is older or newer.
    """
    parts = tuple(int(part) for part in re.findall(r"\d+", number)[:3])
    if not OLDEST <= parts < (NEWEST + 1,):
        raise WrongMujoco(f"found MuJoCo {number}; expected one that was tested: pip install {_WANTED}")


def import_mujoco() -> Any:
    """The module ``mujoco``.

    Raises:
        MissingExtra: it is not installed.
        WrongMujoco: it is there twice, in parts, or of a version that was not tested.
    """
    found = installed()
    require_one(found)
    try:
        with explained():
            module = importlib.import_module("mujoco")
            number, _ = module.__version__, module.MjModel
    except (ImportError, AttributeError) as error:
        if not found:
            raise  # MissingExtra: there is none at all
        both = " and ".join(f"{name} {number}" for name, number in found.items())
        raise WrongMujoco(
            f"found {both}, of which files are missing; expected a whole one: pip uninstall -y "
            f"{' '.join(_DISTRIBUTIONS)}, then pip install {_WANTED}"
        ) from error
    require_tested(number)
    return module
