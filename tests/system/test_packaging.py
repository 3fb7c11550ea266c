"""From the source distribution to a wheel to an installation: the way on which layouts with links lose files."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("design", "protocol", "nodes", "launch")


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
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


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel built from the unpacked source distribution, without the checkout around it."""
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-P", "-m", "build", "--no-isolation", "--outdir"]
    run(*build, out, "--sdist", ROOT, cwd=out)
    (sdist,) = out.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        # Python 3.11 has filters from its fourth patch on
        archive.extractall(out, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    (source,) = [path for path in out.iterdir() if path.is_dir()]
    run(*build, out, "--wheel", source, cwd=out)
    (built,) = out.glob("*.whl")
    return built


def test_the_wheel_holds_every_file_of_the_rooms_once(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    held = {name for name in names if name.startswith("manyhands/")}
    expected = {"manyhands/__init__.py", "manyhands/__main__.py", "manyhands/py.typed"}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                expected.add(f"manyhands/{path.relative_to(ROOT)}")
    assert held == expected
    assert len(names) == len(set(names))
    assert not any(name.startswith(("tests/", "src/", "launch/", "nodes/")) for name in names)


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
