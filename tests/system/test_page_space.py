"""The page draws a scene in space: its camera, drags in the view's plane, contacts, and what it does without WebGL."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, CDPSession, Page

from manyhands.design.models.contacts import Surface
from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session.shipped import load_named
from manyhands.protocol.messages import Figures

from ..support.browser import SPACE, Camera, ShownPage, browsing, camera_after, centre, frames, until
from ..support.scenes import random_scene
from ..support.slot import as_told, described
from .test_page_drawing import Played, scene

CHROMIUM = shutil.which("chromium")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
pytestmark = pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")

CARRY = replace(scene("carry"), grips=("anna", "ben"))
ANNA, BEN = '[data-device="anna"]', '[data-device="ben"]'
QUARTER = 18  # presses of an arrow key: 90°
NO_WEBGL = """() => {
  const all = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...others) {
    return kind.startsWith("webgl") ? null : all.call(this, kind, ...others);
  };
}"""

COUNTED = """() => {
  window.pictures = 0;
  const clear = WebGL2RenderingContext.prototype.clear; // once for each picture
  WebGL2RenderingContext.prototype.clear = function (mask) {
    window.pictures += 1;
    return clear.call(this, mask);
  };
}"""
FIVE_TURNS = """async () => {
  const frame = () => new Promise(requestAnimationFrame);
  let still = 0; // frames without a picture
  for (let i = 0; i < 3600 && still < 10; i += 1) {
    const before = window.pictures;
    await frame();
    still = window.pictures === before ? still + 1 : 0;
  }
  const before = window.pictures;
  for (let i = 0; i < 5; i += 1) {
    document.querySelector(".space").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
  }
  for (let i = 0; i < 3; i += 1) await frame();
  return [still, window.pictures - before];
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    with browsing(CHROMIUM) as found:
        yield found


def shown(browser: Browser, before: str = "") -> ShownPage:
    """The page of the scene at rest."""
    played = Played(CARRY)
    played.stand(0.0, {})
    return ShownPage(browser, played.feed, 1280, "light", before)


def closing(page: ShownPage) -> Iterator[ShownPage]:
    """Of pages that a module opens: a browser ends the process of a closed page some time later."""
    yield page
    assert page.wrong == []
    page.page.close()


@pytest.fixture(scope="module")
def carry(browser: Browser) -> Iterator[ShownPage]:
    yield from closing(shown(browser, before=f"({COUNTED})()"))


@pytest.fixture(scope="module")
def without_webgl(browser: Browser) -> Iterator[ShownPage]:
    yield from closing(shown(browser, before=f"({NO_WEBGL})()"))


@pytest.fixture
def first(carry: ShownPage) -> Page:
    """The page with the first view, the drawing focused."""
    page = carry.page
    until(page, SPACE, "data-camera", has=" ")
    page.locator(SPACE).focus()
    camera_after(page, "Home")
    carry.demands.clear()
    return page


def dragged(page: ShownPage, device: str, right: float, down: float) -> list[float]:
    """Drag a device by so many px, and let go: where the page asked it to be in the end, m."""
    mouse = page.page.mouse
    x, y = centre(page.page, f'[data-device="{device}"]')
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + right, y + down, steps=3)
    mouse.up()
    page.await_demand({"release": device})
    return [demand["position"] for demand in page.demands if demand.get("grasp") == device][-1]


def test_keys_turn_zoom_and_move_the_view_and_home_restores_it(first: Page) -> None:
    home = Camera.of(first)
    assert (home.azimuth, home.elevation) == pytest.approx((math.radians(25), math.radians(15)), abs=1e-6)
    turned = camera_after(first, "ArrowRight", "ArrowUp", "ArrowUp")
    assert (turned.azimuth, turned.elevation) == pytest.approx((math.radians(30), math.radians(25)), abs=1e-6)
    assert camera_after(first, "+").distance == pytest.approx(home.distance / 1.15, rel=1e-5)
    assert camera_after(first, "-", "-").distance == pytest.approx(home.distance * 1.15, rel=1e-5)
    at = camera_after(first, "Home")
    to = camera_after(first, "Shift+ArrowRight")  # 24 px
    assert (to.target - at.target).tolist() == pytest.approx(at.moved(at.target, 24.0, 0.0).tolist(), abs=1e-5)
    again = camera_after(first, "Home")
    assert again[:3] == home[:3]
    assert again.target.tolist() == home.target.tolist()


def test_a_pointer_turns_the_view_and_the_wheel_zooms_once_it_has_the_focus(first: Page) -> None:
    box = first.locator(SPACE).bounding_box()
    assert box is not None
    x, y = box["x"] + 40, box["y"] + 40
    home = Camera.of(first)
    first.locator("#pause").focus()
    first.mouse.move(x, y)
    first.mouse.wheel(0, 1)
    first.mouse.down()
    first.mouse.move(x + 50, y + 20)
    first.mouse.up()
    frames(first)
    turned = Camera.of(first)
    assert turned.azimuth - home.azimuth == pytest.approx(-0.4, abs=1e-5)
    assert turned.elevation - home.elevation == pytest.approx(0.16, abs=1e-5)
    assert turned.distance == home.distance  # the wheel scrolled the page
    first.mouse.wheel(0, 200)
    frames(first)
    assert Camera.of(first).distance == pytest.approx(home.distance * math.exp(0.3), rel=1e-5)


@pytest.mark.parametrize(("presses", "azimuth", "right"), [(0, 0.0, [1, 0, 0]), (QUARTER, math.pi / 2, [0, 0, -1])])
def test_a_drag_moves_the_device_in_the_views_plane(
    first: Page, carry: ShownPage, presses: int, azimuth: float, right: list[int]
) -> None:
    """First level and from the front, where x is to the right on the screen; then from the right, where -z is."""
    camera = camera_after(first, *("ArrowLeft",) * 5, *("ArrowDown",) * 3, *("ArrowRight",) * presses)
    assert camera[:2] == pytest.approx((azimuth, 0.0), abs=1e-6)
    position = np.array(dragged(carry, "ben", 50.0, -30.0))  # the nearer one, seen from the right
    assert position.tolist() == pytest.approx(camera.moved(carry_tool("ben"), 50.0, -30.0).tolist(), abs=1e-6)
    length = float(position @ right)
    assert length > 0.01
    assert position.tolist() == pytest.approx((length * np.add(right, [0.0, 0.6, 0.0])).tolist(), abs=1e-6)


def test_a_drag_from_an_oblique_view_keeps_its_distance_from_the_eye(first: Page, carry: ShownPage) -> None:
    camera = camera_after(first, "ArrowRight", "ArrowRight", "ArrowUp", "+")
    position = dragged(carry, "ben", -35.0, 24.0)
    assert position == pytest.approx(camera.moved(carry_tool("ben"), -35.0, 24.0).tolist(), abs=1e-6)
    assert all(abs(value) > 1e-3 for value in position)


def carry_tool(name: str) -> Any:
    assert CARRY.scene is not None
    [tool] = [tool for tool in CARRY.scene.tools if tool.name == name]
    return np.array(tool.at)


def test_a_picture_is_drawn_once_in_a_frame_and_only_when_something_has_changed(first: Page) -> None:
    home = Camera.of(first)
    assert first.evaluate(FIVE_TURNS) == [10, 1]
    assert Camera.of(first).azimuth - home.azimuth == pytest.approx(math.radians(25), abs=1e-6)


class Fingers:
    """Fingers on a touch screen, by number."""

    def __init__(self, page: Page) -> None:
        self._session: CDPSession = page.context.new_cdp_session(page)
        self._down: dict[int, tuple[float, float]] = {}

    def put(self, finger: int, x: float, y: float) -> None:
        kind = "touchMove" if finger in self._down else "touchStart"
        self._down[finger] = x, y
        self._send(kind)

    def lift(self) -> None:
        self._down.clear()
        self._send("touchEnd")

    def _send(self, kind: str) -> None:
        points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in self._down.items()]
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def test_one_finger_turns_two_pinch_and_two_hold_two_devices(first: Page, carry: ShownPage) -> None:
    box = first.locator(SPACE).bounding_box()
    assert box is not None
    x, y = box["x"] + 60, box["y"] + 50
    home = Camera.of(first)
    fingers = Fingers(first)
    fingers.put(0, x, y)
    fingers.put(0, x + 25, y)
    frames(first)
    assert Camera.of(first).azimuth - home.azimuth == pytest.approx(-0.2, abs=1e-5)
    fingers.put(1, x + 125, y)
    fingers.put(1, x + 225, y)  # from 100 px apart to 200
    frames(first)
    pinched = Camera.of(first)
    assert pinched.distance == pytest.approx(home.distance / 2.0, rel=1e-5)
    assert pinched.azimuth - home.azimuth == pytest.approx(-0.2, abs=1e-5)
    fingers.lift()
    camera_after(first, "Home")

    for finger, device in enumerate((ANNA, BEN)):
        fingers.put(finger, *centre(first, device))
    x, y = centre(first, ANNA)
    fingers.put(0, x + 20, y)
    until(first, ANNA, "class", has="held")
    until(first, BEN, "class", has="held")
    fingers.put(1, *centre(first, BEN))
    assert not any("release" in demand for demand in carry.demands)
    fingers.lift()
    for device in ("anna", "ben"):
        carry.await_demand({"release": device})
    assert max(demand["position"][0] for demand in carry.demands if demand.get("grasp") == "anna") > 1e-3


def test_the_contacts_are_where_the_scene_has_them(carry: ShownPage) -> None:
    """One for each gap below 0, along its gradient, in random scenes."""
    found = 0
    for seed in range(8):
        given = random_scene(np.random.default_rng(seed), 3, 4)
        if seed % 2:  # what is stated of two things holds, although a spring joins them
            b0, b1, b2, b3 = given.bodies
            overlapping = (b0, b1, replace(b2, at=(b1.at[0] + 0.005, *b1.at[1:])), b3)
            given = replace(given, bodies=overlapping, surfaces=(*given.surfaces, (("b1", "b2"), Surface(500.0))))
        terms = given.geometry.geometry_terms()  # as a page receives it
        things = [
            {"name": name, "radius": thing["radius"], "place": thing["at"], "half": thing.get("half", [0.0, 0.0, 0.0]),
             "box": thing.get("shape") == "box", "driven": "motion" in thing}
            for name, thing in [*terms["tools"].items(), *terms["bodies"].items()]
        ]  # fmt: skip
        contacts = carry.page.evaluate(
            """async ([scene, things]) => {
              const { Contacts } = await import("/contacts.js");
              return new Contacts(scene, things).now();
            }""",
            [terms, things],
        )
        gap, gradient = given.contacts.gaps(given.points)
        normals = sorted(np.round(contact["normal"], 9).tolist() for contact in contacts)
        assert normals == sorted(gradient[gap < 0.0].round(9).tolist())
        found += len(contacts)
    assert found > 20


def test_the_rounding_of_a_sum_is_shown_as_zero(carry: ShownPage) -> None:
    found = carry.page.evaluate(
        """async () => {
          const { quantity } = await import("/format.js");
          return [-3.6e-17, 0, -2e-9, 5e-12, null].map((value) => quantity(value, "N"));
        }"""
    )
    assert found == ["0 N", "0 N", "-2.00 nN", "0.00500 nN", "–"]


def test_the_button_changes_between_plane_and_space(carry: ShownPage, first: Page) -> None:
    first.locator("#view-switch").click()
    until(first, "#world-drawing", "data-view", equals="plane")
    assert first.locator('#world-drawing rect[data-tool="anna"]').count() == 1
    assert first.get_attribute("#view-switch", "aria-pressed") == "false"
    first.locator("#view-switch").click()
    until(first, "#world-drawing", "data-view", equals="space")
    assert first.locator('#world-drawing rect[data-tool="anna"]').count() == 0


def test_a_finger_holds_a_device_in_the_plane_as_long_as_it_is_down(carry: ShownPage, first: Page) -> None:
    """A browser that took the drag for a scroll would cancel the pointer, and the hand would let go."""
    first.locator("#view-switch").click()
    until(first, "#world-drawing", "data-view", equals="plane")
    narrow = {"width": 390, "height": 844}
    fingers = Fingers(first)
    wide = first.viewport_size
    assert wide is not None
    first.set_viewport_size(narrow)
    carry.demands.clear()
    x, y = centre(first, ANNA)
    for step in range(40):
        fingers.put(0, x, y - 3 * step)
        frames(first)
    until(first, ANNA, "class", has="held")
    assert {demand.get("grasp") for demand in carry.demands} == {"anna"}
    fingers.lift()
    carry.await_demand({"release": "anna"})
    first.set_viewport_size(wide)
    first.locator("#view-switch").click()
    until(first, "#world-drawing", "data-view", equals="space")


@pytest.fixture(scope="module")
def engine(browser: Browser) -> Iterator[ShownPage]:
    """The shipped session of MuJoCo, all of whose bodies have moved; one may turn, and one is lost."""
    session = load_named("mujoco", ["design={coupling: given, stiffness: 900, damping: 0.2}"])
    drawing = drawing_of(session)
    assert drawing is not None
    about = describe(unproved(session), "simulated", "ipc", 0)
    puck = replace(drawing.frames["puck"], turns=True)
    told = replace(drawing, frames={**drawing.frames, "puck": puck}, hidden=("lost",))
    played = Played(replace(about, drawing=told))
    played.stand(0.02, {})
    yield from closing(ShownPage(browser, played.feed, 1280, "light"))


def test_an_engines_world_is_drawn_in_one_frame_with_the_tools(engine: ShownPage) -> None:
    """Its z is upwards. Each ring is where the camera sees its device, at once displaced along x and y of the model."""
    page = engine.page
    until(page, SPACE, "data-camera", has=" ")
    until(page, '[data-tool="left"]', "data-at", equals="0.02 0.02")
    moved = [float(part) for part in (page.get_attribute('[data-mass="puck"]', "data-at") or "").split()]
    assert moved == pytest.approx([0.02, 0.02, 0.02 - 0.0155])
    camera = Camera.of(page)
    box = page.locator(f"{SPACE} canvas").bounding_box()
    assert box is not None
    for device, start in (("left", [-0.06, 0.0, 0.015]), ("right", [0.06, 0.0, 0.015])):
        x, y, z = np.add(start, [0.02, 0.02, 0.0])
        right, down = camera.seen(np.array([x, z, -y]))
        ring = centre(page, f'[data-device="{device}"] .body')
        assert ring == pytest.approx(
            (box["x"] + box["width"] / 2 + right, box["y"] + box["height"] / 2 + down), abs=1.0
        )
    until(page, "#world-legend", "text", has="puck: how it is turned is not reported")
    until(page, "#world-legend", "text", has="lost: not drawn")


def test_without_webgl_a_scene_is_drawn_in_its_plane(without_webgl: ShownPage) -> None:
    page = without_webgl.page
    until(page, "#world-drawing", "data-view", equals="plane")
    until(page, "#world-legend", "text", has="this browser has no WebGL")
    until(page, '[data-tool="anna"]', "data-at", equals="0 0 0")
    assert page.locator("#view-switch").is_disabled()
    loaded = page.evaluate("performance.getEntriesByType('resource').map((entry) => new URL(entry.name).pathname)")
    assert "/view.js" in loaded
    assert not [path for path in loaded if path.startswith("/three/")]


def test_a_page_that_loses_its_webgl_goes_on_in_the_plane(first: Page) -> None:
    """The last test of this page."""
    first.evaluate(
        "document.querySelector('.space canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
    )
    until(first, "#world-drawing", "data-view", equals="plane")
    until(first, "#world-legend", "text", has="the browser took WebGL away")
    assert first.locator("#view-switch").is_disabled()


AT, TURN = [0.01, 0.02, 0.03, 0.6], (0.8, 0.0, 0.0, 0.6)  # of the gripper, and of the cube, by 74° about its vertical
LINE = (0.03, 0.0, 0.1)  # m, a point of the axis of its jaw


@pytest.fixture(scope="module")
def gripper(browser: Browser) -> Iterator[ShownPage]:
    """The shipped gripper, whose jaw turns about a line beside the thumb."""
    session = load_named("gripper", ["design={coupling: given, stiffness: 2, damping: 0.002}"])
    drawing = drawing_of(session)
    assert drawing is not None
    thumb = replace(drawing.frames["thumb"], axes={"pinch.jaw": LINE})
    told = replace(drawing, frames={**drawing.frames, "thumb": thumb})
    played = Played(replace(describe(unproved(session), "simulated", "ipc", 0), drawing=told))
    played.stand(0.0, {}, {"x": AT, "x_e": AT, "R": [*TURN, 1.0, 0.0, 0.0, 0.0], "q": [0.0] * 6})
    yield from closing(ShownPage(browser, played.feed, 1280, "light"))


def test_an_axis_that_turns_and_a_reported_orientation_are_seen_to_turn(gripper: ShownPage) -> None:
    page = gripper.page
    until(page, SPACE, "data-camera", has=" ")
    until(page, '[data-tool="pinch"]', "data-at", equals="0.01 0.02 0.03 0.6")

    c, s = np.cos(0.6), np.sin(0.6)  # about -y
    back = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    px, py, pz = np.array(LINE) + back @ (np.array([-0.02, 0.0, 0.14]) - LINE) + AT[:3]
    right, down = Camera.of(page).seen(np.array([px, pz, -py]))
    box = page.locator(f"{SPACE} canvas").bounding_box()
    assert box is not None
    seen = (box["x"] + box["width"] / 2 + right, box["y"] + box["height"] / 2 + down)
    assert centre(page, '[data-device="pinch"] .body') == pytest.approx(seen, abs=1.0)

    root = 0.5**0.5  # the model's z is upwards in the picture, whose y is
    assert turn_of(page, '[data-tool="pinch"]') == pytest.approx(hamilton((root, -root, 0, 0), about_y(0.25 - 0.6)))
    assert turn_of(page, '[data-mass="cube"]') == pytest.approx(hamilton((root, -root, 0, 0), TURN))
    assert turn_of(page, '[data-mass="palm"]') == pytest.approx((root, -root, 0.0, 0.0))


def turn_of(page: Page, selector: str) -> tuple[float, ...]:
    """How a thing is turned in the picture, a unit quaternion."""
    return tuple(float(part) for part in (page.get_attribute(selector, "data-turn") or "").split())


def about_y(angle: float) -> tuple[float, ...]:
    return float(np.cos(angle / 2)), 0.0, float(np.sin(angle / 2)), 0.0


def hamilton(p: tuple[float, ...], q: tuple[float, ...]) -> tuple[float, ...]:
    """The product of two quaternions, by the vectors of their imaginary parts."""
    u, v = np.array(p[1:]), np.array(q[1:])
    return (p[0] * q[0] - float(u @ v), *(p[0] * v + q[0] * u + np.cross(u, v)).tolist())


PIVOT = np.array([0.01, 0.0, 0.005])  # m, in the stick's own axes, along which it stands at the start
R, Q = (0.6, 0.0, 0.8, 0.0), (0.8, 0.0, 0.0, 0.6)  # 106° about the model's y, and 74° about its z
TORQUE = (0.003, -0.004, 0.0)
DOWN = Figures({}, {"buttons_down": {"pen.grip": 1.0, "pen.menu": 0.0}})


@pytest.fixture(scope="module")
def pen(browser: Browser) -> Iterator[ShownPage]:
    """A stick that a hand has turned, about a point beside its middle, while a button is held down."""
    played = Played(described(" ".join(map(str, PIVOT))))
    played.stand(0.0, {"device": DOWN}, {"x": AT[:3], "x_e": [0.01, 0.0, 0.0], **as_told(R, Q, TORQUE)})
    yield from closing(ShownPage(browser, played.feed, 1280, "light"))


def matrix(turn: tuple[float, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The rotation of a unit quaternion, by what it does to each axis."""
    back = (turn[0], *(-part for part in turn[1:]))
    return np.array([hamilton(hamilton(turn, (0.0, *axis)), back)[1:] for axis in np.eye(3).tolist()]).T


def test_a_tool_that_its_hand_turns_is_drawn_by_its_proxy_and_its_device_beside_it(pen: ShownPage) -> None:
    page = pen.page
    until(page, SPACE, "data-camera", has=" ")
    until(page, '[data-tool="pen"]', "data-at", equals="0.01 0 0")
    root = 0.5**0.5
    upright = (root, -root, 0.0, 0.0)  # the model's z is upwards in the picture, whose y is
    assert turn_of(page, '[data-tool="pen"]') == pytest.approx(hamilton(upright, Q))
    assert turn_of(page, '[data-device="pen"]') == pytest.approx(hamilton(upright, R))

    box = page.locator(f"{SPACE} canvas").bounding_box()
    assert box is not None
    for at, turn, where in ((AT[:3], R, '[data-device="pen"] .body'), ([0.01, 0.0, 0.0], Q, "#world .pressed")):
        x, y, z = np.array(at) + PIVOT - matrix(turn) @ PIVOT
        right, down = Camera.of(page).seen(np.array([x, z, -y]))
        seen = (box["x"] + box["width"] / 2 + right, box["y"] + box["height"] / 2 + down)
        assert centre(page, where) == pytest.approx(seen, abs=1.0)


def test_the_angle_the_torque_and_a_pressed_button_are_beside_the_force(pen: ShownPage) -> None:
    page = pen.page
    item = page.locator('[data-force-of="pen"]')
    angle = 2 * math.acos(abs(float(np.dot(R, Q))))
    text = f"turned {angle:.2f} rad from its tool; t x 3.00 mN·m, y -4.00 mN·m, z 0 N·m; pressed: grip"
    until(page, '[data-force-of="pen"]', "text", has=text)
    assert float(item.get_attribute("data-angle") or "nan") == pytest.approx(angle, rel=1e-5)
    assert page.get_attribute("#world .pressed", "data-pressed") == "grip"
    assert page.locator("#world .pressed").is_visible()
    assert page.locator(".space text", has_text="a quarter turn of an arc: 2.50 mN·m").is_visible()
    tabs = page.locator("#plot-tabs button").all_inner_texts()
    assert [tab for tab in tabs if tab.startswith(("Angle", "Torque"))] == ["Angle (rad)", "Torque (N·m)"]
    page.locator("#tab-t").click()
    assert page.locator("#plot-legend label span").all_inner_texts() == ["t pen x", "t pen y", "t pen z"]
    page.locator("#view-switch").click()
    until(page, "#world-drawing", "data-view", equals="plane")
    assert page.locator("#world .pressed").is_visible()
    page.locator("#view-switch").click()
    until(page, "#world-drawing", "data-view", equals="space")


def test_the_arc_of_a_torque_turns_right_handed_about_its_axis(pen: ShownPage) -> None:
    at, radius = np.array([0.1, 0.2, 0.3]), 0.05
    for axis in ([0.0, 2.0, 0.0], [0.0, -1.0, 0.0], [3.0, 0.0, 4.0], [-0.1, 0.2, 0.3]):
        for angle in (0.5, 2.0, 3.7):
            places = np.array(
                pen.page.evaluate(
                    """async ([at, axis, radius, angle]) => {
                      const { Arc } = await import("/shapes.js");
                      const arc = new Arc(radius, 0.001, { of: () => undefined });
                      arc.put(at, axis, angle);
                      return arc.along(13);
                    }""",
                    [at.tolist(), axis, radius, angle],
                )
            )
            u = np.array(axis) / np.linalg.norm(axis)
            arms = places - at
            assert np.linalg.norm(arms, axis=1) == pytest.approx(radius)
            assert arms @ u == pytest.approx(0.0, abs=1e-9)
            steps = [math.atan2(float(u @ np.cross(a, b)), float(a @ b)) for a, b in pairwise(arms)]
            assert steps == pytest.approx([angle / 12] * 12)


@pytest.fixture(scope="module")
def sensing(browser: Browser) -> Iterator[ShownPage]:
    """The same stick in a hand that senses alone."""
    played = Played(replace(described(), sensed=("pen",)))
    played.stand(0.0, {}, {"x": AT[:3], "x_e": AT[:3], **as_told(R, Q, TORQUE)})
    yield from closing(ShownPage(browser, played.feed, 1280, "light"))


def test_a_tool_whose_hand_senses_alone_is_drawn_as_it_was_told_and_without_a_torque(sensing: ShownPage) -> None:
    page = sensing.page
    until(page, SPACE, "data-camera", has=" ")
    until(page, '[data-tool="pen"]', "data-at", has="0.01")
    upright = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)
    assert turn_of(page, '[data-tool="pen"]') == pytest.approx(hamilton(upright, Q))
    assert turn_of(page, PEN) == pytest.approx(hamilton(upright, R))
    assert "turned" not in page.locator('[data-force-of="pen"]').inner_text()
    assert not page.locator(".space text", has_text="a quarter turn").count()


@pytest.fixture(scope="module")
def turnable(browser: Browser) -> Iterator[ShownPage]:
    """A stick that this page may turn, and that is turned already."""
    played = Played(replace(described(), grips=("pen",)))
    played.stand(0.0, {}, {"x": AT[:3], "x_e": AT[:3], **as_told(R, Q, TORQUE)})
    yield from closing(ShownPage(browser, played.feed, 1280, "light"))


@pytest.fixture
def pens(turnable: ShownPage) -> Page:
    page = turnable.page
    until(page, SPACE, "data-camera", has=" ")
    page.locator(SPACE).focus()
    camera_after(page, "Home", "ArrowRight", "ArrowUp")
    turnable.demands.clear()
    return page


PEN = '[data-device="pen"]'
RING = f"{PEN} .body"


def by(page: Page, right: float, up: float, towards: float, angle: float) -> tuple[float, ...]:
    """The stick's orientation, turned on by an angle about a direction of the picture, in the model's axes."""
    back, to_the_right, upwards = Camera.of(page).axes
    x, y, z = (right * to_the_right + up * upwards + towards * back).tolist()
    half = angle / 2
    return hamilton((math.cos(half), *(math.sin(half) * part for part in (x, -z, y))), R)


def turned_to(page: ShownPage) -> tuple[float, ...]:
    """Where the page asked the stick to be turned in the end; where it asked it to be is where it was."""
    page.await_demand({"release": "pen"})
    last = [demand for demand in page.demands if demand.get("grasp") == "pen"][-1]
    assert last["position"] == pytest.approx(AT[:3])
    return tuple(last["turn"])


@pytest.mark.parametrize("button", ["left", "right"])
def test_a_drag_with_shift_or_the_right_button_turns_a_device(button: Any, turnable: ShownPage, pens: Page) -> None:
    """As a ball of 100 px about its ring: 60° for half of the radius, and half a turn for all of it, or farther."""
    x, y = centre(pens, RING)
    home = Camera.of(pens)
    for dx, dy, expected in (
        (50, 0, by(pens, 0, 1, 0, math.radians(60))),
        (0, 50, by(pens, 1, 0, 0, math.radians(60))),
        (-250, 0, by(pens, 0, 1, 0, math.radians(-180))),
    ):
        turnable.demands.clear()
        if button == "left":
            pens.keyboard.down("Shift")
        pens.mouse.move(x, y)
        pens.mouse.down(button=button)
        pens.mouse.move(x + dx, y + dy, steps=3)
        pens.mouse.up(button=button)
        pens.keyboard.up("Shift")
        assert abs(float(np.dot(turned_to(turnable), expected))) == pytest.approx(1.0, abs=1e-4)  # of whole px
    assert Camera.of(pens)[:3] == home[:3]


def test_a_drag_without_shift_moves_a_device_and_keeps_its_turn(turnable: ShownPage, pens: Page) -> None:
    x, y = centre(pens, RING)
    pens.mouse.move(x, y)
    pens.mouse.down()
    pens.mouse.move(x + 30, y, steps=2)
    pens.mouse.up()
    turnable.await_demand({"release": "pen"})
    last = [demand for demand in turnable.demands if demand.get("grasp") == "pen"][-1]
    assert np.linalg.norm(np.subtract(last["position"], AT[:3])) > 1e-3
    assert last["turn"] == pytest.approx(R)


def test_keys_turn_a_device_about_the_directions_of_the_picture(turnable: ShownPage, pens: Page) -> None:
    for keys, expected in (
        ("d", (0, 1, 0, 3)),
        ("a", (0, 1, 0, -3)),
        ("s", (1, 0, 0, 3)),
        ("W", (1, 0, 0, -15)),
        ("q", (0, 0, 1, 3)),
        ("E", (0, 0, 1, -15)),
        ("dd", (0, 1, 0, 6)),
    ):
        turnable.demands.clear()
        pens.locator(PEN).focus()
        for key in keys:
            pens.keyboard.press(key if key.islower() else f"Shift+{key}")
        pens.keyboard.press("Escape")
        *direction, degrees = expected
        assert turned_to(turnable) == pytest.approx(by(pens, *direction, math.radians(degrees)), abs=1e-6)
    assert "turned by 1.85 rad" in (pens.get_attribute(PEN, "aria-valuetext") or "")


def test_a_second_finger_beside_the_ring_turns_the_device_and_not_the_camera(turnable: ShownPage, pens: Page) -> None:
    """About the line from the eye, by the angle that the finger goes around the ring."""
    x, y = centre(pens, RING)
    home = Camera.of(pens)
    fingers = Fingers(pens)
    fingers.put(0, x, y)
    fingers.put(1, x + 150, y)
    fingers.put(1, x, y - 40)  # a quarter of a turn to the left, upwards, and nearer
    until(pens, PEN, "class", has="held")
    frames(pens)
    fingers.lift()
    assert abs(float(np.dot(turned_to(turnable), by(pens, 0, 0, 1, math.pi / 2)))) == pytest.approx(1.0, abs=1e-4)
    assert Camera.of(pens)[:3] == home[:3]
    turnable.demands.clear()
    fingers.put(1, x + 150, y)
    fingers.put(1, x + 175, y)
    fingers.lift()
    frames(pens)
    assert Camera.of(pens).azimuth - home.azimuth == pytest.approx(-0.2, abs=1e-5)  # nobody holds the device
    assert turnable.demands == []
