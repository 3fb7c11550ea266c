"""How much there is to read, and what a newcomer's word finds: pages and helps by their words, and the site's search.

    python -m benchmarks.words [--root FOLDER] [--html FOLDER] [--times N]

The pages and the first page's groups are those of ``--root``, a checkout; the helps are those of the installed program.
``--html`` is a site that was built before, of that checkout. Without it the site is built into a temporary folder. The
search needs Debian's Chromium. Its time is that from opening the search's page until the first of its results is shown.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Final

import typer

from manyhands.launch.app.cli import GROUPS, app
from tests.support.browser import browsing
from tests.support.site import CHROMIUM, ROOT, build, found_by, site_module

WORDS: Final = ("stiffness", "wall", "delay", "phone", "mesh", "wheel", "record", "partner", "noise", "install")
"""What people come with."""

NEWCOMER: Final = ("README.md", "docs/tutorial.md", "docs/installing.md")
WHY: Final = "docs/decisions/"


def words(path: Path) -> int:
    """The words of a file, tables and code included."""
    return len(path.read_text(encoding="utf-8").split())


def helps() -> int:
    """The words of what ``manyhands COMMAND --help`` prints, of all commands together."""
    group = typer.main.get_group(app)
    count = 0
    for name in (name for listed in GROUPS.values() for name in listed):
        command = group.get_command(None, name)  # type: ignore[arg-type]  # it needs no context
        with typer.Context(command, info_name=f"manyhands {name}", max_content_width=80) as context:
            count += len(command.get_help(context).split())
    return count


def pages(root: Path) -> dict[str, list[Path]]:
    """The pages of each group of the first page, without what is made of the code; the newcomer's own come first."""
    newcomer = [root / name for name in NEWCOMER]
    found = {"newcomer's path": newcomer}
    for group, names in site_module("reading").grouped(root).items():
        files = [root / f"{name}.md" for name in names if not name.startswith(("docs/site/", WHY))]
        found[group] = [file for file in files if file not in newcomer]
    return {group: files for group, files in found.items() if files} | {"why": sorted((root / WHY).glob("*.md"))}


def search_table(chromium: str, html: Path, times: int) -> list[str]:
    """A row for each of a newcomer's words."""
    lines = ["| word | comes first | results | the first decision is at | ms |", "|---|---|---:|---:|---:|"]
    with browsing(chromium) as browser:
        for word in WORDS:
            each = [found_by(browser, html, word) for _ in range(times)]
            found, took = each[0][0], statistics.median(shown for _, shown in each)
            why = [place for place, one in enumerate(found, 1) if one.startswith(f"{WHY}0")]
            first = found[0] if found else "nothing"
            lines.append(f"| {word} | {first} | {len(found)} | {why[0] if why else 'none'} | {took:.0f} |")
    return lines


def main(arguments: list[str]) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=ROOT)
    parser.add_argument("--html", type=Path)
    parser.add_argument("--times", type=int, default=5)
    given = parser.parse_args(arguments)
    if CHROMIUM is None:
        parser.error("found no chromium; expected one to search the site with")
    lines = ["| what | pages | words |", "|---|---:|---:|", f"| `--help` of all commands | – | {helps()} |"]
    for group, files in pages(given.root.resolve()).items():
        lines.append(f"| {group} | {len(files)} | {sum(map(words, files))} |")
    with tempfile.TemporaryDirectory() as folder:
        if given.html is None:
            built = build(Path(folder))
            if built.returncode:
                sys.stderr.write(built.stderr)
                return 1
        lines += ["", *search_table(CHROMIUM, (given.html or Path(folder) / "html").resolve(), given.times)]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
