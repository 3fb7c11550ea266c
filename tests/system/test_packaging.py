"""From the source distribution to a wheel to an installation: the way on which layouts with links lose files.

An installation of the base alone runs what a guest needs, and names the extra that anything else needs.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import tarfile
import zipfile
from contextlib import ExitStack
from importlib.metadata import distribution
from pathlib import Path

import pytest
import typer
from packaging.metadata import Metadata

from manyhands.extras import EXTRAS
from manyhands.launch.app.cli import app
from manyhands.launch.session.shipped import shipped_sessions

from ..support.capture import free_ports
from ..support.commands import run as manyhands
from ..support.installed import NEEDED, ROOT, Distributions, base_sizes, build, install_base, link, run
from ..support.rooms import ROOMS
from .test_seats import Said, command, hosted, invitation_to, report_of

MOST_BASE = 60.0
"""MB, of the base without numpy."""

RUN_EXAMPLES = """
import json, sys
from typer.testing import CliRunner
from manyhands.launch.app.cli import app
found = {}
for name, arguments in json.load(sys.stdin).items():
    done = CliRunner().invoke(app, arguments)
    found[name] = done.exit_code, done.stderr
json.dump(found, sys.stdout)
"""


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Distributions:
    return build(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def wheel(distributions: Distributions) -> Path:
    return distributions.wheel


@pytest.fixture(scope="module")
def base(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install_base(tmp_path_factory.mktemp("base"), wheel)


def test_the_wheel_holds_every_file_of_the_rooms_once(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    held = {name for name in names if name.startswith("manyhands/")}
    expected = {
        f"manyhands/{name}"
        for name in ("__init__.py", "__init__.pyi", "__main__.py", "extras.py", "lazy_names.py", "py.typed")
    }
    for room in ROOMS:
        for path in (ROOT / room).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                expected.add(f"manyhands/{path.relative_to(ROOT)}")
    assert held == expected
    assert len(names) == len(set(names))
    others = {re.sub(r"^manyhands-[^/]+\.dist-info/", "", name) for name in names} - held
    assert others == {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    assert wheel.name.endswith("-py3-none-any.whl"), "what is not compiled is of any platform"


def test_the_source_distribution_holds_no_caches_links_or_output(distributions: Distributions) -> None:
    with tarfile.open(distributions.sdist) as archive:
        members = archive.getmembers()
    names = [member.name.partition("/")[2] for member in members]
    assert all(member.isfile() for member in members)
    assert not [name for name in names if re.search(r"(^|/)(__pycache__|out|dist|\.venv|\.\w+_cache)/", name)]
    assert {"LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff", "Makefile", "tests/conftest.py"} <= {*names}


def test_the_metadata_are_valid_and_name_every_extra(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        found = Metadata.from_email(archive.read(name), validate=True)
    assert found.description_content_type == "text/markdown"
    assert found.description is not None
    assert found.description.startswith("# manyhands")
    assert found.license_expression == "Apache-2.0"
    assert {*EXTRAS, "all", "dev", "docs"} == {*(found.provides_extra or ())}


@pytest.mark.long
def test_the_installed_package_designs_and_runs(wheel: Path, tmp_path: Path) -> None:
    """With nothing of the checkout on the path but its dependencies."""
    site = tmp_path / "site"
    pip = [sys.executable, "-P", "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]
    run(*pip, site, wheel, cwd=tmp_path)
    python = [sys.executable, "-P"]
    where = run(*python, "-c", "import manyhands; print(manyhands.__file__)", cwd=tmp_path, PYTHONPATH=str(site))
    assert Path(where.strip()).is_relative_to(site)
    command = [*python, "-m", "manyhands"]
    run(*command, "design", "example1.yaml", "-o", "c.json", cwd=tmp_path, PYTHONPATH=str(site))
    run(*command, "verify", "c.json", cwd=tmp_path, PYTHONPATH=str(site))
    run(
        *command, "launch", "example1.yaml", "--certificate", "c.json", "--clock", "simulated", "--duration", "0.1",
        "--report", "r.json", cwd=tmp_path, PYTHONPATH=str(site),
    )  # fmt: skip
    assert (tmp_path / "r.json").exists()


def test_the_base_has_no_library_of_an_extra(base: Path, tmp_path: Path) -> None:
    modules = [module for every in EXTRAS.values() for module in every]
    code = f"from importlib.util import find_spec; print([name for name in {modules} if find_spec(name)])"
    assert run(base / "python", "-c", code, cwd=tmp_path).strip() == "[]"


def test_a_guest_and_every_kind_of_node_need_the_base_alone(base: Path, tmp_path: Path) -> None:
    guests = ("guest.observer", "guest.remote", "guest.seat")
    nodes = ("device.__main__", "coupling.__main__", "environment.__main__", *guests)
    code = "import " + ", ".join(f"manyhands.nodes.{module}" for module in nodes)
    run(base / "python", "-c", code, cwd=tmp_path)
    assert "Share:" in run(base / "manyhands", "--help", cwd=tmp_path)
    for arguments, words in (
        (("join", "nothing.invitation"), "error: nothing.invitation: found no file"),
        (("node", "dx", "--bundle", "no.bundle", "--connect", "tcp://127.0.0.1:7400"), "error: no.bundle: cannot be"),
    ):
        done = subprocess.run([base / "manyhands", *arguments], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stderr.startswith(words)


def test_a_guest_takes_a_seat_with_the_base_alone(base: Path, tmp_path: Path) -> None:
    """No SciPy for its simulated hand, no library of recordings, no solver."""
    home, away = tmp_path / "home", tmp_path / "away"
    with ExitStack() as stack:
        host = stack.enter_context(hosted(home, f"127.0.0.1:{free_ports(4)[0]}"))
        path = invitation_to("right_seat", home, away)
        join = command("join", path.name, "--yes", cwd=away, program=[str(base / "manyhands")])
        guest = Said(stack.enter_context(join))
        host.joined("right_seat")
        host.go_on(1000)
        assert guest.end(signal.SIGINT) == 130
        host.left("right_seat")
        assert host.end(signal.SIGINT) == 130
    assert "right_seat" in report_of(home)["nodes"]


@pytest.mark.parametrize("template", sorted(shipped_sessions()))
def test_the_base_copies_and_shows_every_shipped_session(template: str, base: Path, tmp_path: Path) -> None:
    """`sessions`, `new`, `graph` and the keys of `invite` need no solver."""
    commands = [
        ["sessions", template],
        ["new", "mine", "--from", template],
        ["graph", "mine.yaml"],
        ["graph", "mine.yaml", "--access"],
        ["graph", "mine.yaml", "--format", "svg", "-o", "mine.svg"],
        ["invite", "mine.yaml", "--keys", "keys"],
    ]
    code = RUN_EXAMPLES
    asked = {str(number): arguments for number, arguments in enumerate(commands)}
    done = subprocess.run(
        [base / "python", "-P", "-c", code], cwd=tmp_path, input=json.dumps(asked), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for number, (ended, said) in json.loads(done.stdout).items():
        assert ended == 0, f"{asked[number]}: {said}"
    assert {path.name for path in tmp_path.iterdir()} == {"mine.yaml", "mine.svg", "keys"}


def test_the_base_reads_sessions_in_python_and_finds_hands_that_are_not_passive(base: Path, tmp_path: Path) -> None:
    code = """
import manyhands as mh
print(mh.load("ball"))
try:
    mh.load("example1", {"devices.dx.hand": {"operator": {"num": [1.0, -1.0], "den": [1.0, 1.0]}}})
except mh.SessionError as error:
    print(error)
"""
    read, refused = run(base / "python", "-P", "-c", code, cwd=tmp_path).splitlines()
    assert read.startswith("Session(ball: ")
    assert "operator not passive at 0 rad/s: the least eigenvalue of its Hermitian part there is -1 N·s/m" in refused


def test_a_certificate_is_proved_beside_the_base_with_python_flint_alone(base: Path, tmp_path: Path) -> None:
    """The extra `proof`; a session is read with all its checks where SciPy is, so comparing with one needs `design`."""
    manyhands("design", "example1", "-o", tmp_path / "c.json")
    site = tmp_path / "site"
    site.mkdir()
    link(distribution("python-flint"), site)
    verify = [base / "manyhands", "verify", "c.json"]
    assert "proved" in run(*verify, cwd=tmp_path, PYTHONPATH=str(site))
    environment = {**os.environ, "PYTHONPATH": str(site)}
    compared = [*verify, "--session", "example1"]
    done = subprocess.run(compared, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.endswith("pip install 'manyhands[design]'\n")) == (2, True)


def test_the_base_is_small_but_for_numpy(base: Path) -> None:
    """docs/installing.md has the sizes by package; most of numpy is its OpenBLAS."""
    sizes = base_sizes(base)
    others = {name: size for name, size in sizes.items() if name != "numpy"}
    assert sizes["numpy"] > 20.0
    assert sum(others.values()) <= MOST_BASE, others


def test_without_its_extra_each_command_names_it_and_writes_nothing(base: Path, tmp_path: Path) -> None:
    group = typer.main.get_group(app)
    examples = {}
    for name in group.list_commands(None):
        (line,) = [line for line in group.get_command(None, name).epilog.splitlines() if line.startswith("Example: ")]
        examples[name] = shlex.split(line.removeprefix("Example: manyhands "))
    done = subprocess.run(
        [base / "python", "-P", "-c", RUN_EXAMPLES],
        cwd=tmp_path,
        input=json.dumps({name: examples[name] for name in NEEDED}),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for name, (code, text) in json.loads(done.stdout).items():
        assert code == 2, f"{name}: {text}"
        assert re.fullmatch(r"error: found no \w+(, \w+)*; expected .*\n", text), f"{name}: {text}"
        assert text.endswith(f": pip install 'manyhands[{NEEDED[name]}]'\n"), f"{name}: {text}"
    assert not list(tmp_path.iterdir())


def test_without_its_extra_each_function_of_python_names_it(base: Path, tmp_path: Path) -> None:
    code = """
from pathlib import Path
import manyhands as mh
from manyhands.launch.recordings.formats import RUN_SUFFIXES
from manyhands.launch.recordings.recording import require_suffix
for act in (
    lambda: mh.certify({}),
    lambda: mh.passivity.greatest_output_level,
    lambda: mh.read("a.mcap"),
    lambda: require_suffix(Path("a.mcap"), RUN_SUFFIXES),
    lambda: mh.plot(None),
):
    try:
        act()
    except ImportError as error:
        print(str(error).partition(": pip install ")[2])
"""
    found = run(base / "python", "-P", "-c", code, cwd=tmp_path).splitlines()
    extras = ["design"] * 2 + ["record"] * 2 + ["plot"]
    assert found == [f"'manyhands[{extra}]'" for extra in extras]
