"""What a release rests on: the workflow that publishes, the citation, and a changelog by version, which agree."""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import yaml

import manyhands

ROOT = Path(__file__).parents[2]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
HEADINGS = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
UNRELEASED = "unreleased"


def workflow() -> dict[str, Any]:
    found: dict[Any, Any] = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())
    return {"on": found.pop(True)} | found  # YAML 1.1 reads the key `on` as a truth value


def versions() -> list[tuple[tuple[int, ...], str]]:
    """The changelog's versions, and the date of each, or :data:`UNRELEASED`."""
    out = []
    for heading in HEADINGS:
        found = re.fullmatch(r"(\d+)\.(\d+)\.(\d+) \((\d{4}-\d{2}-\d{2}|unreleased)\)", heading)
        assert found is not None, f"found the heading {heading!r}; expected a version with its date"
        out.append((tuple(map(int, found.groups()[:3])), found[4]))
    return out


def test_the_changelog_has_each_version_once_with_its_date_the_newest_first() -> None:
    found = versions()
    assert [version for version, _ in found] == sorted({version for version, _ in found}, reverse=True)
    dates = [date.fromisoformat(when) for _, when in found if when != UNRELEASED]
    assert dates == sorted(dates, reverse=True)
    assert UNRELEASED not in [when for _, when in found[1:]]


def test_version_and_citation_are_the_changelogs() -> None:
    """While a version is being made, the program says so: what it writes and reads is no longer the last release's."""
    newest, when = versions()[0]
    assert manyhands.__version__ == ".".join(map(str, newest)) + (".dev0" if when == UNRELEASED else "")
    assert CITATION["version"] == manyhands.__version__


def test_the_citation_names_the_paper() -> None:
    assert CITATION["cff-version"] == "1.2.0"
    assert {"title", "message", "authors"} <= CITATION.keys()
    (paper,) = CITATION["references"]
    references = " ".join((ROOT / "docs" / "references.md").read_text().split())
    (entry,) = re.findall(r"\*\*Bianchini2010\*\*: (.*?)(?= - \*\*)", references)
    publisher = paper["publisher"]["name"]
    for part in (paper["title"], paper["collection-title"], publisher, str(paper["year"]), paper["isbn"]):
        assert part in entry
    assert [author["family-names"] for author in paper["authors"]] == re.findall(r"[A-Z]\. (\w+)(?=,)", entry)[:3]


def test_only_a_tag_publishes_and_only_what_was_checked() -> None:
    found = workflow()
    assert found["on"] == {"push": {"tags": ["v[0-9]+.[0-9]+.[0-9]+"]}}
    jobs = found["jobs"]
    assert jobs["publish"]["needs"] == "check"
    assert jobs["check"]["needs"] == "wheels"
    assert jobs["wheels"]["needs"] == "build"
    assert "twine check --strict" in "".join(step.get("run", "") for step in jobs["build"]["steps"])


def test_only_the_publishing_job_may_ask_for_trust_and_it_runs_no_code_of_ours() -> None:
    found = workflow()
    assert found["permissions"] == {"contents": "read"}
    holders = {name: job["permissions"] for name, job in found["jobs"].items() if "permissions" in job}
    assert holders == {"publish": {"id-token": "write"}}
    publish = found["jobs"]["publish"]
    assert publish["environment"]["name"] == "pypi"
    assert [step["uses"].partition("@")[0] for step in publish["steps"]] == [
        "actions/download-artifact",
        "pypa/gh-action-pypi-publish",
    ]
    assert "secrets." not in (ROOT / ".github" / "workflows" / "release.yml").read_text()


@pytest.mark.parametrize("job", ["build", "wheels", "check", "publish"])
def test_every_action_is_pinned_to_a_commit(job: str) -> None:
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text()
    for step in workflow()["jobs"][job]["steps"]:
        if "uses" in step:
            assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", step["uses"])
            assert re.search(rf"{re.escape(step['uses'])}  # v\d+\.\d+\.\d+\n", text)
        else:
            assert "${{" not in step["run"]  # what is from outside comes by the environment, and is no code


def test_every_version_of_python_that_is_declared_is_checked() -> None:
    declared = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', (ROOT / "pyproject.toml").read_text())
    assert workflow()["jobs"]["check"]["strategy"]["matrix"]["python"] == declared
