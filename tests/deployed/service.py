"""``make service``: systemd's own checks of the unit, with the program that is installed here.

    python -m tests.deployed.service

`systemd-analyze verify` ends with 0 for an unknown key and prints a line, so that only silence counts. Each check is
also made on a unit that is broken in one place, and must find it.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from tests.deployed.checks import ROOT, Checks, done, require_programs

UNIT: Final = ROOT / "deploy" / "manyhands-host@.service"
_INSTALLED: Final = "/opt/manyhands/bin/manyhands"
_MOST_EXPOSED: Final = 2.0  # of 10, in systemd's rating; what docs/installing.md states

BROKEN: Final[dict[str, Callable[[str], str]]] = {
    "an unknown key": lambda text: text.replace("Restart=on-failure", "Restarts=on-failure"),
    "a value that is none": lambda text: text.replace("Type=exec", "Type=executable"),
    "a program that is not there": lambda text: text.replace("ExecStart=", "ExecStart=/nowhere"),
    "a limit that is no number": lambda text: text.replace("LimitRTPRIO=10", "LimitRTPRIO=ten"),
    "an order after what there is not": lambda text: text.replace(
        "After=network-online.target", "After=network-online"
    ),
}


def main() -> int:
    """Check the unit and the broken ones; returns the exit code."""
    require_programs({"systemd-analyze": "systemd"})
    checks = Checks()
    program = Path(sys.executable).parent / "manyhands"
    text = UNIT.read_text().replace(_INSTALLED, str(program))
    checks.that("the unit starts the program where docs/installing.md installs it", str(program) in text)
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "manyhands-host@ball.service"
        file.write_text(text)
        code, said = verified(file)
        checks.that("systemd-analyze verify accepts the unit without a word", (code, said) == (0, ""), said)
        rated = exposure(file)
        checks.that(f"its exposure is at most {_MOST_EXPOSED:g} of 10", rated <= _MOST_EXPOSED, f"{rated:g}")
        for what, change in BROKEN.items():
            file.write_text(change(text))
            code, said = verified(file)
            checks.that(f"{what} is found", bool(code or said), said.replace(str(file), UNIT.name))
        file.write_text(text.replace("ProtectSystem=strict", "ProtectSystem=no").replace("DynamicUser=yes", ""))
        more = exposure(file)
        checks.that("a unit that may write anywhere is rated worse", more > _MOST_EXPOSED, f"{more:g}")
    return checks.end()


def verified(file: Path) -> tuple[int, str]:
    """Exit code and words of systemd's check of a unit."""
    found = done(["systemd-analyze", "verify", "--man=no", file])
    return found.returncode, (found.stdout + found.stderr).strip()


def exposure(file: Path) -> float:
    """systemd's rating of what a unit may do, 0 to 10."""
    found = done(["systemd-analyze", "security", "--offline=yes", "--no-pager", file])
    (rating,) = re.findall(r"Overall exposure level for \S+: ([\d.]+)", found.stdout) or ["10"]
    return float(rating)


if __name__ == "__main__":
    raise SystemExit(main())
