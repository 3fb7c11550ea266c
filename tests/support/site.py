"""The documentation site: built, and looked at in a browser.

python -m tests.support.site [FOLDER]    # builds it, and takes pictures of ten pages at two widths
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Final

from playwright.sync_api import Browser, Page

from .browser import browsing

ROOT: Final = Path(__file__).parents[2]
CHROMIUM: Final = shutil.which("chromium")
WIDTHS: Final = (1280, 390)  # px: a screen, and a telephone
HIGHEST: Final = 6_000  # px of a picture: of a long page its beginning
PAGES: Final = (
    *("docs/site/index", "docs/tutorial", "docs/theory", "docs/design", "docs/session-file/device"),
    *("docs/loop-benchmark", "docs/site/session-keys", "docs/site/commands", "docs/site/names", "protocol/SPEC"),
)
"""Pages of every kind: text, formulas, tables, code, pictures, and what is made of the code."""

BEYOND: Final = """() => {
  const room = document.documentElement.clientWidth;
  const article = document.querySelector("article");
  const scrolls = (element) => {
    for (let one = element; one !== article; one = one.parentElement)
      if (["auto", "scroll"].includes(getComputedStyle(one).overflowX)) return true;
    return false;
  };
  return [...article.querySelectorAll("*")]
    .filter((one) => one.getBoundingClientRect().right > room + 1 && !scrolls(one))
    .map((one) => `${one.tagName.toLowerCase()}: ${one.textContent.trim().slice(0, 40)}`).slice(0, 5);
}"""
"""The elements of the text that reach beyond the window, and are in no part of it that scrolls by itself.

The theme lets the whole text scroll, so that the page's own width says nothing.
"""


def site_module(name: str) -> ModuleType:
    """A module of docs/site/, which no package has."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "site" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def build(target: Path) -> subprocess.CompletedProcess[str]:
    """Build the site into ``target``/html; a warning ends it with an error."""
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    return subprocess.run(
        [*command, "--conf-dir", "docs/site", "--doctree-dir", target / "doctrees", ".", target / "html"],
        cwd=ROOT, capture_output=True, text=True, timeout=600,
    )  # fmt: skip


def opened(browser: Browser, html: Path, page: str, width: int) -> Page:
    """A page of the built site, in a window of this width."""
    window = browser.new_page(viewport={"width": width, "height": 900})
    window.set_default_timeout(60_000)
    window.goto((html / f"{page}.html").as_uri())
    return window


_SHOWN: Final = """(() => {
  window.shown = {};
  new MutationObserver(() => {
    if (document.querySelector("ul.search > li")) window.shown.first ??= performance.now();
    const told = document.querySelector("p.search-summary")?.textContent ?? "";
    if (/found|did not match/.test(told)) window.shown.all = performance.now();
  }).observe(document, { subtree: true, childList: true, characterData: true });
})()"""
"""Notes when a search shows its first result, ms after the page was opened, and when it has ended."""


def found_by(browser: Browser, html: Path, word: str) -> tuple[list[str], float]:
    """The pages that the site's search lists for a word, in its order, and after how many ms it showed the first."""
    page = browser.new_page()
    page.set_default_timeout(60_000)
    page.add_init_script(_SHOWN)
    page.goto(f"{(html / 'search.html').as_uri()}?q={word}")
    page.wait_for_function("() => window.shown.all")
    links: list[str] = page.evaluate(
        "() => [...document.querySelectorAll('ul.search > li > a')].map((link) => link.getAttribute('href'))"
    )
    first: float = page.evaluate("() => window.shown.first ?? window.shown.all")
    page.close()
    return [re.split("[?#]", link)[0] for link in links], first


def wider(page: Page) -> str:
    """What makes a page wider than its window; empty where nothing does."""
    beyond: list[str] = page.evaluate(BEYOND)
    return "; ".join(beyond)


def main(target: Path) -> None:
    """Take the pictures, and print what is wider than its window."""
    if CHROMIUM is None:
        raise SystemExit("found no chromium; expected one to look at the site with")
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browsing(CHROMIUM) as browser:
        built = build(Path(folder))
        if built.returncode:
            raise SystemExit(built.stderr)
        for name in PAGES:
            for width in WIDTHS:
                page = opened(browser, Path(folder) / "html", name, width)
                tall = min(HIGHEST, page.evaluate("() => document.documentElement.scrollHeight"))
                page.set_viewport_size({"width": width, "height": tall})
                page.screenshot(path=target / f"{name.rpartition('/')[2]}-{width}.png")
                if found := wider(page):
                    sys.stdout.write(f"{name} at {width} px: {found}\n")
                page.close()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/docs-pictures"))
