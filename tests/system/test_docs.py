"""The documents are true: their commands run, their links lead somewhere, their citations resolve."""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.commands import MANYHANDS, forked, manyhands_command, read_until, run, started
from ..support.rooms import ROOMS

ROOT = Path(__file__).parents[2]
DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "protocol" / "SPEC.md"]
CODE = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]


def commands(text: str) -> list[tuple[list[str], int]]:
    """The manyhands commands of the console blocks, with the exit code that a comment may state."""
    out = []
    for block in re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL):
        for line in block.splitlines():
            command, _, comment = line.removeprefix("$ ").partition(" #")
            if command.startswith("manyhands "):
                stated = re.search(r"exit (\d+)", comment)
                out.append((shlex.split(command)[1:], int(stated[1]) if stated else 0))
    return out


@pytest.mark.usefixtures("own_interrupt")
@pytest.mark.parametrize("measuring", [False, pytest.param(True, marks=pytest.mark.alone)], ids=["others", "doctor"])
def test_the_readmes_commands_run_as_they_stand(
    measuring: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that start processes are processes themselves; the others run in this one, where all is imported.

    A run lasts as long as it is useful to a reader; here it is over sooner.
    """
    monkeypatch.chdir(tmp_path)
    found = commands((ROOT / "README.md").read_text())
    assert len(found) >= 6
    for stated, expected in found:
        if (stated[0] == "doctor") != measuring:
            continue
        arguments = [*stated, "--duration", "0.2"] if stated[0] in ("launch", "simulate") else stated
        in_real_time = stated[0] == "launch" or "design.tau=auto" in stated
        if measuring:  # it begins with nothing, as where a user measures the machine
            process = subprocess.run([*MANYHANDS, *arguments], capture_output=True, text=True, check=False)
            code, errors = process.returncode, process.stderr
        elif in_real_time:
            process = forked(*arguments)
            code, errors = process.returncode, process.stderr
        else:
            done = manyhands_command(*arguments)
            code, errors = done.exit_code, done.stderr
        assert code == expected, f"{arguments}: {errors}"


@pytest.mark.long
def test_the_readmes_terminals_show_what_they_say(tmp_path: Path) -> None:
    """The lines of the three terminals, in their order; Ctrl-C ends a running command, as a person would."""
    text = (ROOT / "README.md").read_text()
    lines = re.findall(r"^(\d) \$ manyhands (.*?)(?:  +#.*)?$", text, flags=re.MULTILINE)
    assert [terminal for terminal, _ in lines] == ["1", "2", *"3333"]
    (launch, view, listing, *later) = [shlex.split(line) for _, line in lines]
    with started(*launch, cwd=tmp_path) as session:
        read_until(session, "running")
        with started(*view, cwd=tmp_path) as page:
            read_until(page, "http://127.0.0.1:")
            assert "browser" in run(*listing)
            page.send_signal(signal.SIGINT)
            page.communicate(timeout=60)
        session.send_signal(signal.SIGINT)
        session.communicate(timeout=60)
        assert session.returncode == 130
    for arguments in later:
        run(*arguments, cwd=tmp_path)
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.usefixtures("own_interrupt")
def test_every_key_of_the_files_is_documented(tmp_path: Path) -> None:
    designed = manyhands_command("design", "example1.yaml", "-o", tmp_path / "c.json", "--json")
    assert designed.exit_code == 0, designed.stderr
    run("launch", "example1.yaml", "--duration", "0.1", "--clock", "simulated", "--report", "r.json", cwd=tmp_path)
    text = (ROOT / "docs" / "files.md").read_text()
    certificate, report = (json.loads((tmp_path / name).read_text()) for name in ("c.json", "r.json"))
    printed = json.loads(designed.stdout)
    parts = [certificate, certificate["levels"], certificate["storage"], certificate["coupling"], printed]
    parts += [report, *report["nodes"].values(), report["nodes"]["dx"]["tau_us"], report["nodes"]["dx"]["ledger"]]
    for key in {key for part in parts for key in part}:
        assert f"`{key}`" in text, f"docs/files.md does not tell what {key!r} is"


@pytest.mark.usefixtures("own_interrupt")
def test_the_readmes_session_is_valid_and_certified(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    (tmp_path / "session.yaml").write_text(block)
    done = manyhands_command("design", tmp_path / "session.yaml", "--json")
    assert done.exit_code == 0, done.stderr


@pytest.mark.usefixtures("own_interrupt")
def test_the_readmes_speeds_are_printed_under_their_names(tmp_path: Path) -> None:
    """And those of `simulate` are those that the processes report."""
    text = (ROOT / "README.md").read_text()
    named = r"dx has a peak speed of ([\d.]+) m/s and a final speed of ([\d.]+) m/s"
    ((peak, final),) = re.findall(named, " ".join(text.split()))
    simulated = manyhands_command("simulate", "example1.yaml", "--duration", "2")
    assert f"dx: peak speed {peak} m/s, final speed {final} m/s, " in simulated.stdout
    assert (
        f"peak speed {peak} m/s" in re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    )
    run("launch", "example1.yaml", "--duration", "2", "--clock", "simulated", "--report", "r.json", cwd=tmp_path)
    told = json.loads((tmp_path / "r.json").read_text())["nodes"]
    for name in ("dx", "dy", "dz"):
        speeds = [f"{told[name][key]:.3g}" for key in ("peak_speed", "final_speed")]
        assert "{}: peak speed {} m/s, final speed {} m/s, ".format(name, *speeds) in simulated.stdout


def test_the_readmes_python_prints_its_quoted_output(tmp_path: Path) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-P", "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"# {done.stdout}" == block.splitlines(keepends=True)[-1]


def test_the_python_of_datagrams_prints_its_quoted_output(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "decisions" / "0035-datagrams.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-P", "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert block.endswith("".join(f"# {line}\n" for line in done.stdout.splitlines()))
    assert len(done.stdout.splitlines()) == 2


def test_the_readmes_architecture_is_drawn_by_the_command_it_names(tmp_path: Path) -> None:
    text = (ROOT / "README.md").read_text()
    assert "`manyhands graph example1.yaml --format svg` draws this picture" in " ".join(text.split())
    run("graph", "example1.yaml", "--format", "svg", "-o", "drawn.svg", cwd=tmp_path)
    assert (tmp_path / "drawn.svg").read_text() == (ROOT / "docs" / "images" / "architecture.svg").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text()):
        if not target.startswith("https://"):  # what is outside is not ours to test
            assert (document.parent / target).exists(), f"{document.name} links to {target}"


def test_citations_resolve() -> None:
    known = set(re.findall(r"\*\*(\w+)\*\*:", (ROOT / "docs" / "references.md").read_text()))
    cited = {key for path in CODE for key in re.findall(r"\[([A-Z][A-Za-z]+\d{4})\]_", path.read_text())}
    assert cited
    assert cited <= known


def test_citations_of_documents_resolve() -> None:
    """In decisions and pages a key stands alone in brackets, or with others, with or without a link to the list."""
    known = set(re.findall(r"\*\*(\w+)\*\*:", (ROOT / "docs" / "references.md").read_text()))
    pages = [path for path in (ROOT / "docs").rglob("*.md") if path.name != "references.md"]
    lists = [found for path in pages for found in re.findall(r"\[([A-Z][A-Za-z]+\d{4}[\w,\s]*)\]", path.read_text())]
    cited = {key for found in lists for key in re.split(r",\s+", found)}
    assert {"Rakhsha2019", "Secchi2003", "Acary2016", "Kim2017", "Peyrl2008", "MartinDorel2017", "Devadze2020"} <= cited
    assert cited <= known


def test_references_stand_in_one_list_in_order() -> None:
    text = (ROOT / "docs" / "references.md").read_text()
    listed = re.findall(r"^- \*\*(\w+)\*\*:", text.partition("\n## ")[0], flags=re.MULTILINE)
    assert listed == re.findall(r"\*\*(\w+)\*\*:", text)
    assert listed == sorted(set(listed), key=str.casefold)


def test_the_readmes_two_commands_are_targets() -> None:
    text = (ROOT / "README.md").read_text()
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = re.findall(r"^make (\w+)", text, flags=re.MULTILINE)
    assert named == ["demo", "test"]
    assert set(named) <= targets
