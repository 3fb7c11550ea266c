"""A real browser on the page of a real session: a test starts, questions and ends it, and collects its errors."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Page, sync_playwright

from .commands import read_until, started

SESSION: Final = "browser.yaml"
SLOWED: Final = ("--set", "period=0.01", "--set", "design.tau=0.004")
"""A machine whose processor also draws the page cannot keep 1 kHz."""

QUIET: Final = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-background-timer-throttling",  # of two pages one is behind the other, and holds a device all the same
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
)

UNTIL: Final = """([condition, limit]) => new Promise((done, fail) => {
  const end = setTimeout(() => fail(new Error("it never became so")), limit);
  const looks = new MutationObserver(look);
  looks.observe(document, { subtree: true, attributes: true, childList: true, characterData: true });
  function look() {
    if (!holds()) return;
    clearTimeout(end);
    looks.disconnect();
    done();
  }
  function holds() {
    const { name, where, what } = condition;
    const element = document.querySelector(where);
    if (!element) return false;
    const value = name === "text" ? element.textContent : (element.getAttribute(name) ?? "");
    if (what.equals !== undefined) return value === what.equals;
    if (what.has !== undefined) return value.includes(what.has);
    return value !== "" && (what.above !== undefined ? Number(value) > what.above : Number(value) < what.below);
  }
  look();
})"""
"""Waits for the page to change, not for time: its own policy forbids the evaluation that polling would need."""


def until(page: Page, where: str, name: str, **what: Any) -> None:
    """Wait until an attribute of an element, or its text: ``equals``, ``has``, or is ``above`` or ``below`` it."""
    page.evaluate(UNTIL, [{"where": where, "name": name, "what": what}, 60_000])


@contextmanager
def viewed(*options: str | Path) -> Iterator[tuple[str, int]]:
    """A session that can be dragged, and its page, served with these options.

    Yields the page's address and the supervisor's process id.
    """
    with started("launch", SESSION, *SLOWED) as launched:
        read_until(launched, "running")
        with started("view", "--session", str(launched.pid), *options) as view:
            address = re.sub(r"^page: ", "", read_until(view, "page: ").strip())
            yield address, launched.pid
            view.send_signal(signal.SIGINT)
            assert view.wait(60) == 130
        launched.send_signal(signal.SIGINT)
        launched.wait(60)


@contextmanager
def browsing(executable: str) -> Iterator[Browser]:
    """A browser that sends nothing by itself."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(QUIET), timeout=60_000)
        try:
            yield browser
        finally:
            browser.close()


def open_page(browser: Browser, address: str, width: int, scheme: Any, wrong: list[str]) -> Page:
    """Open the page and wait until its plot moves; every later error of the page is added to ``wrong``."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.set_default_timeout(60_000)
    host = urlsplit(address).netloc

    def requested(url: str) -> None:
        if urlsplit(url).netloc != host:
            wrong.append(f"request to {url}")

    page.on("request", lambda request: requested(request.url))
    page.on("websocket", lambda opened: requested(opened.url))
    page.on("pageerror", lambda error: wrong.append(f"error {error}"))
    page.on("console", lambda told: wrong.append(told.text) if told.type in ("error", "warning") else None)
    page.goto(address)
    until(page, "#plot", "data-points", above=100)
    tick = int(page.get_attribute("#plot", "data-last-tick") or 0)
    until(page, "#plot", "data-last-tick", above=tick)
    return page


def picture(page: Page, folder: Path, name: str) -> None:
    """Save a picture of the whole page."""
    page.screenshot(path=folder / f"{name}.png", full_page=True)


def centre(page: Page, where: str) -> tuple[float, float]:
    """The middle of an element, px."""
    page.locator(where).scroll_into_view_if_needed()
    box = page.locator(where).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
