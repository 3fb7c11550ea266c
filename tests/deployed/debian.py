"""Root file systems of Debian's own packages, for where no registry of images can be reached.

A command in one uses this machine's network. It finds the registry of Python's packages as pip does here: with this
machine's names (:data:`NAMES`), certificates and configuration of pip (:data:`REGISTRY`).
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.deployed.checks import ROOT, must

MIRROR: Final = os.environ.get("DEBIAN_MIRROR", "http://deb.debian.org/debian")

SUITES: Final = {"3.11": "bookworm", "3.13": "trixie", "3.14": "forky"}
"""The suite of Debian whose ``python3`` is of a version."""

NAMES: Final = ("/etc/resolv.conf", "/etc/hosts")
REGISTRY: Final = ("/etc/ssl/certs/ca-certificates.crt", "/etc/pip.conf")


def of_this_machine(*files: str) -> list[Path]:
    """Those of these files that there are."""
    return [Path(file) for file in files if Path(file).exists()]


def root_file_system(target: Path, suite: str, packages: Sequence[str]) -> Path:
    """Make an archive (``.tar``) or a folder of a suite with these packages and what they require.

    Returns:
        ``target``.

    Raises:
        SystemExit: mmdebstrap failed.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    # no recommendations, documents or translations, and no apt: an image is no place to install more
    options = ["--variant=essential", "--aptopt=APT::Install-Recommends false", "--quiet"]
    options += ["--aptopt=Acquire::Check-Valid-Until false"]  # a mirror may be of some weeks ago
    options += [f"--dpkgopt=path-exclude=/usr/share/{part}/*" for part in ("doc", "man", "locale", "info")]
    must(["mmdebstrap", *options, f"--include={','.join(packages)}", suite, target, MIRROR], within=1200.0)
    return target


_FRESH: Final = 24 * 3600.0  # s


def archive(suite: str, packages: Sequence[str]) -> Path:
    """The archive of such a root file system in out/debian/, made anew if it is older than a day."""
    digest = hashlib.sha256(" ".join([MIRROR, *sorted(packages)]).encode()).hexdigest()[:12]
    kept = ROOT / "out" / "debian" / f"{suite}-{digest}.tar"
    if not kept.exists() or time.time() - kept.stat().st_mtime > _FRESH:
        root_file_system(kept.with_suffix(".new.tar"), suite, packages).replace(kept)
    return kept
