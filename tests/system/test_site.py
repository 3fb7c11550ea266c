"""The documentation site builds without a warning, lists every page and every decision, and fits a narrow window."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

import manyhands as mh
from manyhands.launch.app.cli import GROUPS
from manyhands.launch.session.schema import session_schema

from ..support.browser import browsing
from ..support.site import CHROMIUM, PAGES, ROOT, build, opened, wider

REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site. A link to a page or a heading that there is not is a warning, and a page that no list names."""
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr
    return folder / "html"


def test_the_site_builds_without_a_warning(html: Path) -> None:
    index = (html / "docs" / "site" / "index.html").read_text()
    for page in ("../tutorial", "../design", "../remote", "../../protocol/SPEC", "../decisions/README", "names"):
        assert f'href="{page}.html"' in index
    assert "wave_link" in (html / "searchindex.js").read_text()


def test_the_reference_has_every_name_command_and_key(html: Path) -> None:
    """Nothing of it is written by hand, so a part that is missing was lost while the page was made."""
    pages = {name: (html / "docs" / "site" / f"{name}.html").read_text() for name in ("names", "passivity", "commands")}
    documented = re.compile(r'<dt class="sig[^>]* id="(?:[\w.]+\.)?(\w+)"')
    assert {*mh.__all__} - {"passivity"} <= {*documented.findall(pages["names"])}
    assert {*mh.passivity.__all__} == {*documented.findall(pages["passivity"])} & {*mh.passivity.__all__}
    for command in (name for group in GROUPS.values() for name in group):
        assert f"Usage: manyhands {command} " in pages["commands"]
    keys = (html / "docs" / "site" / "session-keys.html").read_text()
    for part in (session_schema(), *session_schema()["$defs"].values()):
        for key in part["properties"]:
            assert f'<span class="pre">{key}</span>' in keys
    assert json.loads((html / "session.schema.json").read_text()) == session_schema()


@pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")
def test_no_page_is_wider_than_a_narrow_window(html: Path) -> None:
    """What is wide, a table, a formula or code, scrolls by itself."""
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    with browsing(CHROMIUM) as browser:
        for name in PAGES:
            page = opened(browser, html, name, 390)
            assert not (found := wider(page)), f"{name}: {found}"
            page.close()


def test_every_decision_is_in_the_list() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = (folder / "README.md").read_text()
    for file in folder.glob("0*.md"):
        number, _, title = file.read_text().splitlines()[0].removeprefix("# ").partition(". ")
        assert f"- [{number}. {title}]({file.name})\n" in listed
