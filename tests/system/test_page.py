"""The page in a browser: it draws motion, shows incidents, and passes a drag to the other user."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest

from ..support.browser import (
    BOXES,
    CARRIED,
    HAND,
    RED,
    TURNED,
    browsing,
    centre,
    lift,
    open_page,
    picture,
    take_to_turn,
    turn,
    until,
    viewed,
    written,
)
from ..support.slot import rail

CHROMIUM = shutil.which("chromium")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
PICTURES = Path(os.environ.get("MANYHANDS_PAGE_OUT", Path(__file__).parents[2] / "out" / "page"))

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine"),
    pytest.mark.alone,  # a browser draws with all the processor time that it can have
]

LEFT, RIGHT_FORCE = '[data-device="left"]', '[data-force-of="right"]'
BALL = '[data-mass="ball"]'
MOVED = 0.001  # m: no other hand moves in this session
FELT = 0.01  # N
# The page's excess over its window (px) as it is, and that of a table over its section with the widest figure that a
# party can have in each cell: a section that scrolls hides it from the page.
OVERFLOW = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
WIDEST = """() => {
  const table = document.querySelector("#parties-table");
  for (const cell of table.querySelectorAll("td")) cell.textContent = "0.0266 nJ";
  return table.getBoundingClientRect().right - table.parentElement.getBoundingClientRect().right;
}"""


def node_of(supervisor: int, node: str) -> int:
    """The process id of a session's node."""
    children = Path(f"/proc/{supervisor}/task/{supervisor}/children").read_text().split()
    [found] = [int(pid) for pid in children if f"/{node}.bundle" in Path(f"/proc/{pid}/cmdline").read_text()]
    return found


def test_the_page_of_a_session_that_is_dragged_and_hurt() -> None:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    PICTURES.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    with viewed() as (address, supervisor), browsing(CHROMIUM) as browser:
        wide = open_page(browser, address, 1280, "light", wrong)
        picture(wide, PICTURES, "running-1280-light")

        until(wide, "#lateness", "text", has="proved up to 4000 µs, enforced beyond (tank 5.00 mJ and 1.00 mW)")
        until(wide, '[data-account="left"]', "text", has="J")
        until(wide, "#account-bound", "text", equals="≥ -5.00 mJ − 1.00 mW t")

        x, y = centre(wide, LEFT)
        wide.mouse.move(x, y)
        wide.mouse.down()
        wide.mouse.move(x + 60, y, steps=6)
        until(wide, LEFT, "data-held", equals="here")
        until(wide, BALL, "data-at", above=MOVED)
        until(wide, RIGHT_FORCE, "data-force", above=FELT)
        picture(wide, PICTURES, "dragged-1280-light")

        narrow = open_page(browser, address, 390, "dark", wrong)
        until(narrow, LEFT, "data-held", equals="elsewhere")
        picture(narrow, PICTURES, "dragged-390-dark")
        wide.bring_to_front()
        wide.mouse.up()
        until(wide, LEFT, "data-held", equals="")
        until(narrow, LEFT, "data-held", equals="")

        wide.locator(LEFT).focus()
        for _ in range(6):
            wide.keyboard.press("Shift+ArrowLeft")
        until(wide, LEFT, "data-held", equals="here")
        until(wide, BALL, "data-at", below=-MOVED / 2.0)  # it comes to rest at -0.65 mm, after an overshoot
        until(wide, RIGHT_FORCE, "data-force", below=-FELT)
        picture(wide, PICTURES, "keys-1280-light")
        wide.keyboard.press("Escape")
        until(wide, LEFT, "data-held", equals="")

        wide.locator("#tab-x").focus()
        wide.keyboard.press("ArrowRight")
        until(wide, "#tab-v", "aria-selected", equals="true")
        until(wide, "#plot", "data-points", above=100)
        for page, scheme in ((wide, "dark"), (narrow, "light")):
            page.emulate_media(color_scheme=scheme)
        picture(wide, PICTURES, "velocity-1280-dark")
        picture(narrow, PICTURES, "running-390-light")

        os.kill(node_of(supervisor, "right_tool"), signal.SIGKILL)
        for page, name in ((wide, "alarm-1280-dark"), (narrow, "alarm-390-light")):
            until(page, "#alarms-list", "text", has="right_tool was killed by SIGKILL")
            picture(page, PICTURES, name)
            assert page.evaluate(OVERFLOW) <= 0, "the page is wider than its window"
            assert page.evaluate(WIDEST) <= 0, "figures of parties do not fit into their section"

        os.kill(supervisor, signal.SIGINT)
        for page in (wide, narrow):
            until(page, "body", "data-state", equals="over")
        assert wrong == []


@pytest.mark.long
def test_two_people_carry_a_ball_in_two_browsers() -> None:
    """Each drags one tool with a mouse: towards the ball, and up."""
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    PICTURES.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    with viewed(session=CARRIED) as (address, _), browsing(CHROMIUM) as browser:
        pages = [open_page(browser, address, 1280, "light", wrong), open_page(browser, address, 390, "dark", wrong)]
        lift(pages)
        picture(pages[0], PICTURES, "carried-1280-light")
        picture(pages[1], PICTURES, "carried-390-dark")
        for page in pages:
            page.emulate_media(color_scheme="dark" if page is pages[0] else "light")
        picture(pages[0], PICTURES, "carried-1280-dark")
        picture(pages[1], PICTURES, "carried-390-light")
        for page in pages:
            page.bring_to_front()
            page.mouse.up()
        until(pages[0], RED, "data-at", below=0.01, axis=1)  # m: it has fallen
    assert wrong == []


@pytest.mark.long
def test_a_person_turns_a_bar_between_rails_in_a_browser(tmp_path: Path) -> None:
    """The rails hold it, so device and tool differ, and a torque acts; let go, the device turns back to its tool."""
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    PICTURES.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    with viewed(session=(str(written(rail(), tmp_path)),)) as (address, _), browsing(CHROMIUM) as browser:
        wide = open_page(browser, address, 1280, "light", wrong)
        narrow = open_page(browser, address, 390, "dark", wrong)
        wide.bring_to_front()
        at = take_to_turn(wide)
        until(narrow, HAND, "data-held", equals="elsewhere")
        turn(wide, *at, looking=narrow)
        for page, name in ((wide, "turned-1280-light"), (narrow, "turned-390-dark")):
            assert page.evaluate(BOXES) == []
            picture(page, PICTURES, name)
        wide.bring_to_front()
        wide.mouse.up()
        until(narrow, HAND, "data-held", equals="")
        until(wide, '[data-force-of="hand"]', "data-angle", below=TURNED / 2.0)
    assert wrong == []


def test_a_page_with_a_token(tmp_path: Path) -> None:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    token = tmp_path / "token"
    token.touch(0o600)
    token.write_text("0123456789abcdef")
    wrong: list[str] = []
    with viewed("--token-file", token) as (address, _), browsing(CHROMIUM) as browser:
        stranger = browser.new_page()
        stranger.goto(address, timeout=60_000)
        until(stranger, "body", "data-state", equals="refused")
        until(stranger, "#connection", "text", has="a token is needed")
        page = open_page(browser, f"{address}#token=0123456789abcdef", 1280, "light", wrong)
        assert page.url == address, "the token is to be seen"
        assert wrong == []
