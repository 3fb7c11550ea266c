"""The documentation site builds without a warning, lists every page and every decision, and fits a narrow window.

Its words lead to the glossary, and its search lists guides before reasons.
"""

from __future__ import annotations

import inspect
import json
import os
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest

import manyhands as mh
from manyhands.launch.app.cli import GROUPS
from manyhands.launch.session.schema import session_schema

from ..support.browser import browsing
from ..support.site import CHROMIUM, PAGES, ROOT, build, found_by, opened, site_module, wider

GENERATED, READING = site_module("generated"), site_module("reading")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
pytestmark = pytest.mark.long  # a site takes half a minute to build


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


def test_what_a_function_returns_stands_below_it_with_its_attributes(html: Path) -> None:
    page = (html / "docs" / "site" / "names.html").read_text()
    for function in (getattr(mh, name) for name in mh.__all__ if inspect.isfunction(getattr(mh, name))):
        for one in GENERATED.returned(function):
            assert re.search(rf'id="[\w.]+\.{one.__name__}"', page)
    assert "how the run went, once it is over" in page  # an attribute of what mh.run returns


def test_what_a_page_lists_stands_below_it(html: Path) -> None:
    """In the navigation: decisions below their list, devices and parts of a session file below theirs."""
    navigation = (html / "docs" / "decisions" / "0033-wave-links.html").read_text().partition("sidebar-tree")[2]
    why = navigation.partition('<span class="caption-text">Why</span>')[2]
    assert why.count('class="toctree-l2') >= len([*(ROOT / "docs" / "decisions").glob("0*.md")])
    for page in ("session-file/device", "session-file/scene", "devices/odrive"):
        assert 'class="toctree-l2 current' in (html / "docs" / f"{page}.html").read_text()


class Prose(HTMLParser):
    """The running text of a page in its order: what is in a link to the glossary, and what is in none.

    Attributes:
        pieces: each piece of text, the entry of the glossary to which it leads, and whether the site made the link.
    """

    SILENT = frozenset({"h1", "h2", "h3", "h4", "h5", "h6", "code", "pre", "figcaption", "script", "style"})

    def __init__(self) -> None:
        super().__init__()
        self.pieces: list[tuple[str, str | None, bool]] = []
        self._within: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("br", "img", "hr", "input", "meta", "link", "col", "wbr", "path", "line", "polyline", "circle"):
            self._within.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        while self._within and self._within.pop()[0] != tag:
            pass

    def handle_data(self, data: str) -> None:
        tags = [tag for tag, _ in self._within]
        signature = any(tag == "dt" and "sig" in (about.get("class") or "") for tag, about in self._within)
        if "article" not in tags or signature or self.SILENT & {*tags}:
            return
        link = next((about for tag, about in self._within if tag == "a"), None)
        if link is None:
            self.pieces.append((data, None, False))
        elif "glossary.html#" in (href := link.get("href") or ""):
            self.pieces.append((data, href.partition("#")[2], "word" in (link.get("class") or "").split()))


def prose(page: Path) -> list[tuple[str, str | None, bool]]:
    parser = Prose()
    parser.feed(page.read_text())
    return parser.pieces


def test_the_first_use_of_a_word_leads_to_the_glossary(html: Path) -> None:
    words = READING.glossary_words((ROOT / "docs" / "glossary.md").read_text())
    assert {"ledger", "rung", "osp", "Δ_D", "κ", "θ", "Φ_E", "enforced", "driver's word", "wave link"} <= words.keys()
    glossary = unescape((html / "docs" / "glossary.html").read_text()).replace("’", "'")
    ids = {
        heading: at
        for at, heading in re.findall(r'<section id="([^"]+)">\n(?:<span[^>]*></span>)?<h3>(.+?)<a', glossary)
    }
    patterns = {word: re.compile(READING.forms(word)) for word in words}
    linked = 0
    for page in [*(html / "docs").rglob("*.html"), html / "README.html"]:
        pieces = prose(page) if page.name != "glossary.html" else []
        entries = {entry for _, entry, _ in pieces if entry is not None}
        linked += len(entries)
        for word, pattern in patterns.items():
            used = [(entry, made) for text, entry, made in pieces if pattern.search(text)]
            assert not used or ids[words[word]] in entries, f"{page.name}: {word} has no link"
            made = [place for place, (entry, by_site) in enumerate(used) if by_site and entry == ids[words[word]]]
            assert made in ([], [0]), f"{page.name}: {word} was used before its link"
    assert linked > 100


def test_a_search_puts_reasons_last() -> None:
    """By what is added to Sphinx's own scores, which are at most 27, and 4: no reason comes before any other page."""
    scores = READING.scores(ROOT)
    pages = {str(path.relative_to(ROOT).with_suffix("")) for path in (ROOT / "docs").rglob("*.md")}
    assert pages - {"docs/site/index"} <= scores.keys()
    why = {name for name in scores if name.startswith("docs/decisions/")}
    assert max(scores[name] for name in why) + 31 < min(scores[name] for name in scores.keys() - why)
    assert scores["docs/tutorial"] > scores["docs/worlds"] > scores["docs/session-file/scene"] > scores["docs/theory"]


@pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")
def test_the_sites_own_search_keeps_to_it(html: Path) -> None:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    with browsing(CHROMIUM) as browser:
        for word in ("wave", "delay", "wall"):
            found, _ = found_by(browser, html, word)
            why = [one.startswith("docs/decisions/") for one in found]
            assert True in why
            assert why == sorted(why), f"{word}: {found}"


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
