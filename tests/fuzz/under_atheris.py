"""Hands one harness to atheris; everything that decides stands in the harness, which knows nothing of it.

python tests/fuzz/under_atheris.py HARNESS [libFuzzer's arguments]
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

WATCHED = ["manyhands.protocol", "manyhands.launch.run.conductor", "manyhands.devices"]
"""Whose branches guide the search."""


def main() -> None:
    """Fuzz until libFuzzer's own limits end it."""
    harness, *arguments = sys.argv[1:]
    with atheris.instrument_imports(include=WATCHED):
        import seeds

    # libFuzzer starts itself again to merge a corpus, by this as the beginning of a shell's command
    command = f"{sys.executable} {Path(__file__).resolve()} {harness}"
    atheris.Setup([command, *arguments], seeds.CHECKS[harness])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
