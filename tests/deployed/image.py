"""``make container``: the image of deploy/Containerfile, built upon Debian's own packages, and what it does.

    python -m tests.deployed.image

The Containerfile takes its two base images from a registry. Here their places are taken by images that mmdebstrap makes
of Debian's packages, with the same file otherwise. Each command then runs in the image, as its user, without network.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from typing import Final

from manyhands.nodes.kernel.realtime import FIFO_PRIORITY, NETWORK_NICE
from tests.deployed.checks import Checks, done, must, require_programs, require_root, sources
from tests.deployed.debian import REGISTRY, archive, of_this_machine

SUITE: Final = "trixie"
_BOTH: Final = ("ca-certificates", "passwd", "python3", "python-is-python3")
_RUN: Final = (*_BOTH, "libstdc++6")  # which Python's slim image has as well, and wheels of numpy and ZeroMQ need
_BUILD: Final = (*_BOTH, "python3-dev", "python3-pip", "python3-venv", "gcc", "libc6-dev")
_USER: Final = "10001:10001"
_ULIMITS: Final = (f"--ulimit=rtprio={FIFO_PRIORITY}", "--ulimit=memlock=-1", f"--ulimit=nice={20 - NETWORK_NICE}")
_DEFAULTS: Final = ("--ulimit=nofile=1024:1024", "--ulimit=nproc=4096:4096")
"""In place of podman's own, which are beyond what some machines let root have."""


class Store:
    """Images and containers in folders of their own: those of this machine are neither seen nor changed."""

    def __init__(self, folder: Path) -> None:
        self._options = ["--root", folder / "root", "--runroot", folder / "run", "--storage-driver", _driver()]

    def buildah(self, *words: str | Path, within: float = 1800.0) -> CompletedProcess[str]:
        """Run buildah."""
        return done(["buildah", *self._options, *words], within=within)

    def run(self, image: str, *words: str, options: Sequence[str] = (), shell: bool = False) -> CompletedProcess[str]:
        """Run a command in the image, as its user, with the limits that docs/installing.md gives and no capability."""
        entry = ["--entrypoint", json.dumps(["/bin/sh", "-c"])] if shell else []
        fixed = ["--rm", "--network=none", "--cap-drop=ALL", "--security-opt=no-new-privileges", *_DEFAULTS]
        limits = _ULIMITS if may_raise_limits() else ()
        return done(
            [
                "podman",
                *self._options,
                "--runtime=runc",
                "--cgroup-manager=cgroupfs",
                "run",
                *fixed,
                *limits,
                *entry,
                *options,
                image,
                *words,
            ],
            within=300.0,
        )

    def base(self, name: str, archive: Path) -> None:
        """Make an image of a root file system.

        Raises:
            SystemExit: buildah failed.
        """
        container = must(["buildah", *self._options, "from", "scratch"]).strip()
        must(["buildah", *self._options, "add", container, archive, "/"])
        must(["buildah", *self._options, "commit", "--rm", container, name])

    def size(self, image: str) -> float:
        """Of an image, MB."""
        text = must(["podman", *self._options, "image", "inspect", image])
        return float(json.loads(text)[0]["Size"]) / 1e6


def may_raise_limits() -> bool:
    """Whether this machine lets root have the limits that docs/installing.md grants; some take the right away."""
    return done(["prlimit", f"--rtprio={FIFO_PRIORITY}:{FIFO_PRIORITY}", "true"]).returncode == 0


def _driver() -> str:
    """Images are kept in layers where the kernel permits a layer upon a layer, and as copies elsewhere."""
    return "overlay" if "overlay" in Path("/proc/filesystems").read_text() else "vfs"


@contextmanager
def store() -> Iterator[Store]:
    """A store, while it is entered."""
    folder = Path(tempfile.mkdtemp(prefix="mh-image-"))
    try:
        yield Store(folder)
    finally:
        for mounted in reversed([line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]):
            if mounted.startswith(f"{folder}/"):
                done(["umount", "--lazy", mounted])
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    """Build the image and run it; returns the exit code."""
    require_root()
    require_programs({"mmdebstrap": "mmdebstrap", "buildah": "buildah", "podman": "podman", "runc": "runc"})
    checks = Checks()
    with store() as images, tempfile.TemporaryDirectory(prefix="mh-sources-") as folder:
        source = sources(Path(folder) / "manyhands")
        for kind, packages in (("run", _RUN), ("build", _BUILD)):
            began = time.monotonic()
            base = archive(SUITE, packages)
            images.base(f"localhost/debian-{kind}", base)
            size, took = base.stat().st_size / 1e6, time.monotonic() - began
            checks.say(f"      {kind}: {size:.0f} MB of {SUITE}, {took:.0f} s")
        _built(checks, images, source, "localhost/manyhands", "design,record")
        if not checks.failed:
            _serves(checks, images, "localhost/manyhands")
            _built(checks, images, source, "localhost/manyhands-guest", "")
            _guest(checks, images, "localhost/manyhands-guest")
    return checks.end()


def _built(checks: Checks, images: Store, source: Path, name: str, extras: str) -> None:
    began = time.monotonic()
    mounts = [f"--volume={path}:{path}:ro" for path in of_this_machine(*REGISTRY)]
    bases = {"BUILD": "localhost/debian-build", "RUN": "localhost/debian-run", "EXTRAS": extras}
    arguments = [f"--build-arg={key}={value}" for key, value in bases.items()]
    found = images.buildah(
        "build", "--isolation=chroot", "--network=host", "--pull-never", "--layers", *mounts, *arguments,
        "-f", source / "deploy" / "Containerfile", "-t", name, source,
    )  # fmt: skip
    built = found.returncode == 0
    what = f"{images.size(name):.0f} MB, {time.monotonic() - began:.0f} s" if built else found.stdout + found.stderr
    checks.that(f"deploy/Containerfile builds {name}, with the extras {extras or 'none'}", built, what)


def _serves(checks: Checks, images: Store, image: str) -> None:
    def runs(sentence: str, words: str, *, holds: str = "", shell: bool = False) -> str:
        found = images.run(image, *([words] if shell else words.split()), shell=shell)
        said = found.stdout + found.stderr
        shown = (found.stdout.strip().splitlines() or [""])[-1]
        checks.that(sentence, found.returncode == 0 and holds in said, shown if found.returncode == 0 else said)
        return found.stdout

    runs("the image's command runs", "--version")
    who = images.run(image, "id -u; id -g; grep CapEff /proc/self/status", shell=True).stdout.split()
    checks.that(
        "as a user without any capability", who[:2] == _USER.split(":") and who[-1:] == ["0" * 16], " ".join(who)
    )
    tools = images.run(image, "command -v pip pip3 gcc cc apt-get dpkg-deb || true", shell=True).stdout.split()
    checks.that(
        "without pip, compiler or apt-get",
        not {Path(tool).name for tool in tools} & {"pip", "pip3", "gcc", "cc", "apt-get"},
        tools,
    )
    text = images.run(image, "doctor", "--duration", "2", "--json")
    try:
        found = json.loads(text.stdout)
    except ValueError:
        checks.that("doctor examines the machine", False, text.stderr)
        return
    granted = {name: right["granted"] for name, right in found["granted"].items()}
    if may_raise_limits():
        right = granted["fifo"] and granted["memory_locked"]
        checks.that("the three limits grant SCHED_FIFO and locked memory, without a capability", right, granted)
    else:
        checks.say("---   the limits of real time were not tried: this machine's root may not raise limits")
    checks.that(
        "the tick is compiled",
        found["machine"]["compiled"],
        f"ratio to pure Python {found['compiled_tick']['ratio']:.2f}" if found["compiled_tick"] else "pure Python",
    )
    checks.that("doctor knows that it is in a container", found["machine"]["container"])
    runs(
        "it designs, proves, runs and audits a session",
        "set -e; manyhands design example1 -o c.json; manyhands verify c.json --session example1; "
        "manyhands launch example1 --certificate c.json --clock simulated --duration 1 --record r.mcap; "
        "manyhands audit r.mcap",
        holds="holds",
        shell=True,
    )
    for clock in ("realtime",):
        runs(
            f"and runs it in the clock {clock}", f"launch example1 --set design.tau=0.0005 --clock {clock} --duration 2"
        )
    inside = images.run(image, "host", "ball", "--listen", "127.0.0.1:7400", "-o", "/data/ball", "--duration", "2")
    checks.that(
        "it serves a session for 2 s, with its folders",
        inside.returncode == 0,
        inside.stderr if inside.returncode else "",
    )


def _guest(checks: Checks, images: Store, image: str) -> None:
    found = images.run(image, "join", "nothing.invitation")
    checks.that(
        "the guest's image has the base: join runs",
        found.returncode == 2 and "found no file" in found.stderr,
        found.stderr,
    )
    found = images.run(image, "design", "example1")
    checks.that(
        "and names the extra for what it lacks",
        found.returncode == 2 and "manyhands[design]" in found.stderr,
        found.stderr,
    )


if __name__ == "__main__":
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.exit(main())
