"""Which module belongs to which extra: one table, held against what is declared and what is imported."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from manyhands.extras import EXTRAS, MissingExtra, explained, require

from .support.commands import manyhands_command
from .support.rooms import ROOMS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SETS = PROJECT["optional-dependencies"]
NO_MODULES = {"all", "dev", "docs"}  # sets of other extras, and of tools


def names_in(requirements: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(text).name) for text in requirements}


BY_MODULE = packages_distributions()


PART_OF = {"mujoco-core": "mujoco"}  # from its version 4 on mujoco requires it; older environments have it alone


def distributions_of(module: str) -> set[str]:
    return {PART_OF.get(name, name) for name in map(canonicalize_name, BY_MODULE[module])}


def test_the_table_has_the_extras_that_are_declared() -> None:
    assert EXTRAS.keys() == SETS.keys() - NO_MODULES
    (everything,) = map(Requirement, SETS["all"])
    assert everything.extras == EXTRAS.keys() - {
        "proof",
        "parquet",
        "pandas",
        "foxglove",
        "ros",
        "mujoco",
        "mesh",
        "haply",
    }


def test_requirements_of_versions_0_end_at_the_next_minor() -> None:
    """A next minor of 0.x may break what was tested, so each requirement ends before one of them."""
    every = [Requirement(text) for one in (PROJECT["dependencies"], *SETS.values()) for text in one]
    here = {canonicalize_name(name) for names in BY_MODULE.values() for name in names}
    installed = {one.name: Version(version(one.name)) for one in every if canonicalize_name(one.name) in here}
    young = [one for one in every if one.name in installed and installed[one.name].major == 0]
    assert {"typer", "uvicorn", "h11", "foxglove-sdk", "rosbags"} <= {one.name for one in young}
    assert [str(one) for one in young if one.specifier.contains("0.9999")] == []
    assert [str(one) for one in young if not one.specifier.contains(installed[one.name])] == []


@pytest.mark.parametrize("extra", EXTRAS)
def test_every_library_of_an_extra_has_its_module_in_the_table(extra: str) -> None:
    provided = [distributions_of(module) for module in EXTRAS[extra]]
    declared = names_in(SETS[extra])
    assert all(one & declared for one in provided)
    assert declared <= set().union(*provided)


def test_every_import_of_the_product_is_declared() -> None:
    """By the base, or by an extra that the table has; what only a library of the base brings is the base's as well."""
    base = names_in(PROJECT["dependencies"]) | {"pydantic-core"}
    extras = {module for modules in EXTRAS.values() for module in modules}
    imported = set()
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
                    imported.add(node.module.partition(".")[0])
    types_alone = {"_typeshed"}  # of every type checker, and imported by none of our processes
    others = imported - set(sys.stdlib_module_names) - {"manyhands"} - extras - types_alone
    assert {module: distributions_of(module) for module in others if not distributions_of(module) & base} == {}


def test_a_missing_module_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    require(*EXTRAS)
    monkeypatch.setitem(sys.modules, "flint", None)
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(MissingExtra, match=r"^found no flint; expected the extra design: pip"):
        require("design", "plot")
    both = r"^found no mcap, flint; expected the extras record, design: pip install 'manyhands\[record,design\]'$"
    with pytest.raises(MissingExtra, match=both):
        require("record", "design")
    with pytest.raises(MissingExtra, match=r"manyhands\[record\]"), explained():
        import mcap.records  # noqa: F401


def test_every_extra_that_a_text_tells_to_install_exists() -> None:
    """In messages, documents and examples: pip would pass over another one with a warning."""
    told: dict[str, set[str]] = {}
    for path in (ROOT / name for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).split()):
        if path.suffix in (".py", ".md", ".yaml", ".html", ".js"):
            for listed in re.findall(r"manyhands\[([a-z, ]+)\]|'\.\[([a-z, ]+)\]'", path.read_text(encoding="utf-8")):
                for extra in "".join(listed).split(","):
                    told.setdefault(extra.strip(), set()).add(path.name)
    assert {"all", "haply", "record"} <= told.keys()
    assert {extra: names for extra, names in told.items() if extra not in SETS} == {}


@pytest.mark.parametrize("driver", ["haply-inverse3", "tests.test_extras:in_need"])
def test_a_driver_whose_library_is_missing_says_how_to_get_it(driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before its hardware is asked, which may not answer either; a stranger's driver may need a library of ours too."""
    monkeypatch.setitem(sys.modules, "websockets", None)
    done = manyhands_command("check-driver", driver, "--dof", 3, "--no-push")
    assert done.exit_code == 2
    extra = "haply" if driver == "haply-inverse3" else "view"
    end = f"cannot be made: found no websockets; expected the extra {extra}: pip install 'manyhands[{extra}]'"
    assert done.stderr.splitlines()[-1].endswith(end)


def in_need(ports: tuple[str, ...], period: float, parameters: object) -> None:
    import websockets  # noqa: F401


@pytest.mark.parametrize(
    ("module", "extra", "arguments"),
    [
        ("matplotlib", "plot", ("design", "example1.yaml", "--plot", "pictures")),
        ("matplotlib", "plot", ("budget", "example1.yaml", "--plot", "budget.png")),
        ("mcap", "record", ("launch", "example1.yaml", "--record", "run.mcap", "--duration", "0.1")),
        ("mcap", "record", ("host", "ball", "--listen", "127.0.0.1:7400", "--record", "run.mcap")),
    ],
)
@pytest.mark.usefixtures("own_interrupt")
def test_an_option_that_needs_an_extra_is_refused_before_any_work(
    module: str, extra: str, arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    done = manyhands_command(*arguments)
    assert done.exit_code == 2
    assert done.stderr == f"error: found no {module}; expected the extra {extra}: pip install 'manyhands[{extra}]'\n"
    assert not list(tmp_path.iterdir())


def test_a_missing_module_of_nobodys_is_reported_as_it_is() -> None:
    with pytest.raises(ModuleNotFoundError, match="No module named 'nowhere_at_all'") as found, explained():
        import nowhere_at_all  # noqa: F401
    assert not isinstance(found.value, MissingExtra)
