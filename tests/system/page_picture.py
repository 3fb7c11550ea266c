"""Draws docs/images/page.png: the page of the shipped session browser.yaml, while its left device is dragged.

python -m tests.system.page_picture [FILE]
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from ..support.browser import browsing, centre, open_page, until, viewed

LEFT, BALL = '[data-device="left"]', '[data-mass="ball"]'
ROUNDS = 3  # times that the hand goes to and fro


def main(target: Path) -> None:
    """Drag the device to and fro, and take the picture while it is held."""
    executable = shutil.which("chromium")
    if executable is None:
        raise SystemExit("found no chromium; expected one to draw the page with")
    wrong: list[str] = []
    with viewed() as (address, _), browsing(executable) as browser:
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
        page.mouse.up()
    if wrong:
        raise SystemExit("\n".join(wrong))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "docs" / "images" / "page.png")
