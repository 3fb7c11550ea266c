"""Draws the pictures of docs/page.md and docs/worlds.md: pages of two sessions, while devices are dragged.

page.png shows browser.yaml; page-space.png and page-space-narrow.png show carry.yaml, whose ball two pages lift.

python -m tests.system.page_picture [FOLDER]
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Browser

from ..support.browser import CARRIED, SPACE, browsing, centre, lift, open_page, until, viewed

LEFT, BALL = '[data-device="left"]', '[data-mass="ball"]'
DOTS = 1.5  # of the screen of the pictures in space, in a px
ROUNDS = 3  # times that the hand goes to and fro


def dragged(browser: Browser, target: Path, wrong: list[str]) -> None:
    """Drag the left device to and fro, and take the picture while it is held."""
    with viewed() as (address, _):
        page = open_page(browser, address, 1280, "light", wrong)
        x, y = centre(page, LEFT)
        page.mouse.move(x, y)
        page.mouse.down()
        for _ in range(ROUNDS):
            page.mouse.move(x + 70, y, steps=8)
            until(page, BALL, "data-at", above=0.004)
            page.mouse.move(x - 60, y, steps=8)
            until(page, BALL, "data-at", below=-0.003)
        page.mouse.move(x + 60, y, steps=8)
        until(page, BALL, "data-at", above=0.0035)
        page.screenshot(path=target, full_page=True)
        page.close()


def carried(browser: Browser, wide: Path, narrow: Path, wrong: list[str]) -> None:
    """Two pages lift a ball, and their worlds are taken: one from the side where it begins, one from nearer."""
    with viewed(session=CARRIED) as (address, _):
        pages = [open_page(browser, address, *screen, wrong, DOTS) for screen in ((1280, "light"), (390, "dark"))]
        lift(pages)
        for page, keys, target in zip(pages, (["Home", "+"], ["Home", "+", "+", "+"]), (wide, narrow), strict=True):
            page.bring_to_front()
            page.locator(SPACE).focus()
            for key in keys:
                page.keyboard.press(key)
            page.evaluate("document.activeElement.blur()")
            page.locator("#world").screenshot(path=target)
        for page in pages:
            page.close()


def main(folder: Path) -> None:
    """Draw them all."""
    executable = shutil.which("chromium")
    if executable is None:
        raise SystemExit("found no chromium; expected one to draw the page with")
    wrong: list[str] = []
    with browsing(executable) as browser:
        dragged(browser, folder / "page.png", wrong)
        carried(browser, folder / "page-space.png", folder / "page-space-narrow.png", wrong)
    if wrong:
        raise SystemExit("\n".join(wrong))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "docs" / "images")
