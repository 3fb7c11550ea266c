"""Layouts of Foxglove and PlotJuggler: their forms, and the names that need quotes."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from manyhands.design.models.scene import Body, ContactScene
from manyhands.launch.bridges.layouts import (
    Series,
    foxglove_layout,
    foxglove_path,
    live_topics,
    pages_of,
    plotjuggler_layout,
    plotjuggler_name,
    save_layout,
)
from manyhands.launch.files import TargetError
from manyhands.nodes.environment.drawing import Frame, WorldDrawing
from manyhands.nodes.recorder.format import recorded_of

from ...support.observed_session import ABOUT, UNCERTIFIED
from ...support.slot import described

RECORDED, THERE = recorded_of(ABOUT), live_topics(ABOUT)


@pytest.mark.parametrize(
    ("curve", "foxglove", "plotjuggler"),
    [
        (Series("/a-1/d/sample", ("x", 2), ""), "/a-1/d/sample.x[2]", "/a-1/d/sample/x[2]"),
        (Series("/a.b/d/tau", ("tau_us",), ""), '"/a.b/d/tau".tau_us', "/a.b/d/tau/tau_us"),
        (Series("/a/d/c", ("states", "d.1"), ""), '/a/d/c.states."d.1"', "/a/d/c/states/d.1"),
        (Series("/a/d/c", ("states", "3d"), ""), '/a/d/c.states."3d"', "/a/d/c/states/3d"),
    ],
)
def test_names_of_curves(curve: Series, foxglove: str, plotjuggler: str) -> None:
    assert foxglove_path(curve) == foxglove
    assert plotjuggler_name(curve) == plotjuggler


def leaves(tree: Any) -> list[str]:
    """The panels of a layout's tree."""
    return [tree] if isinstance(tree, str) else [*leaves(tree["first"]), *leaves(tree["second"])]


def test_every_panel_of_foxglove_is_shown_and_has_its_settings() -> None:
    layout = json.loads(foxglove_layout(RECORDED, THERE))
    panels = layout["configById"]
    shown = leaves(layout["layout"])
    shown += [panel for tab in panels["Tab!pages"]["tabs"] for panel in leaves(tab["layout"])]
    assert sorted(shown) == sorted(panels)
    assert [tab["title"] for tab in panels["Tab!pages"]["tabs"]] == ["motion", "promises"]  # it has no wave link
    (positions,) = [panel for panel in panels.values() if panel.get("foxglovePanelTitle", "").startswith("positions")]
    assert positions["foxglovePanelTitle"].endswith(", m")
    series = {path["value"]: path["label"] for path in positions["paths"]}
    assert series["/pair/right/sample.x[1]"] == "x of right.y at right"


def test_a_hand_that_turns_has_a_page_of_plots_and_its_pose_in_the_scene() -> None:
    about = described()
    panels = json.loads(foxglove_layout(recorded_of(about), live_topics(about)))["configById"]
    assert "turning" in [tab["title"] for tab in panels["Tab!pages"]["tabs"]]
    assert panels["3D!scene"]["topics"]["/slot/pen/pose"] == {"visible": True}
    series = {path["value"]: path["label"] for panel in panels.values() for path in panel.get("paths", [])}
    assert series["/slot/pen/torque.t_v[2]"] == "t of z at pen"
    assert series["/slot/pen/proxy.Q[0]"] == "Q of qw at pen"


def test_a_scene_has_a_panel_of_its_own() -> None:
    body = Body("ball", 0.5, (0.2, 0.4, 0.0), 0.03)
    scene = ContactScene((), bodies=(body, replace(body, name="lid", at=(0.0, 0.0, 0.0))))
    layout = json.loads(foxglove_layout(replace(RECORDED, scene=scene), THERE))
    tabs = layout["configById"]["Tab!pages"]["tabs"]
    assert [tab["title"] for tab in tabs] == ["scene", "motion", "promises"]
    panel = layout["configById"][tabs[0]["layout"]]
    assert panel["topics"] == {"/pair/environment/scene": {"visible": True}}
    assert panel["followTf"] == "pair"
    camera = panel["cameraState"]
    assert camera["targetOffset"] == [0.1, 0.2, 0.0]
    assert camera["distance"] * math.tan(math.radians(camera["fovy"] / 2)) > 0.2  # what is 0.4 m high is seen whole
    assert "scene" not in [tab["title"] for tab in panels_without_scene()["Tab!pages"]["tabs"]]


def test_an_engines_world_is_seen_from_above_its_ground() -> None:
    frames = {"a": Frame((0.2, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), "b": Frame((0.0, 0.4, 0.1), (1.0, 0.0, 0.0, 0.0))}
    layout = json.loads(foxglove_layout(replace(RECORDED, drawing=WorldDrawing("z", frames, ())), THERE))
    camera = layout["configById"]["3D!scene"]["cameraState"]
    assert camera["targetOffset"] == [0.1, 0.2, 0.05]
    assert 0 < camera["phi"] < 90


def panels_without_scene() -> Any:
    return json.loads(foxglove_layout(RECORDED, THERE))["configById"]


def test_splits_give_each_plot_the_same_height() -> None:
    layout = json.loads(foxglove_layout(RECORDED, THERE))
    tree, left, heights = layout["configById"]["Tab!pages"]["tabs"][0]["layout"], 100.0, []
    while not isinstance(tree, str):
        heights.append(left * tree["splitPercentage"] / 100)
        left, tree = left - heights[-1], tree["second"]
    assert [*heights, left] == pytest.approx([100 / 3] * 3)


def test_the_layouts_of_both_programs_have_the_same_curves() -> None:
    root = ET.fromstring(plotjuggler_layout(RECORDED, THERE))
    expected = [curve for page in pages_of(RECORDED, THERE) for plot in page.plots for curve in plot.curves]
    assert [curve.get("name") for curve in root.iter("curve")] == [*map(plotjuggler_name, expected)]
    assert [tab.get("tab_name") for tab in root.iter("Tab")] == ["motion", "promises"]
    for split in root.iter("DockSplitter"):
        assert split.get("count") == str(len(split))
        assert len((split.get("sizes") or "").split(";")) == len(split)


def test_a_topic_that_is_not_there_is_in_no_plot() -> None:
    uncertified = live_topics(UNCERTIFIED)
    titles = [plot.title for page in pages_of(RECORDED, uncertified) for plot in page.plots]
    assert "ledgers" not in titles
    assert pages_of(RECORDED, [("left", "sample")])[0].plots[0].curves == (
        Series("/pair/left/sample", ("x", 0), "x of left at left"),
    )


def test_a_layout_of_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match=r"found the suffix '\.yaml'; expected \.json for Foxglove or \.xml"):
        save_layout(tmp_path / "layout.yaml", RECORDED, THERE)
    with pytest.raises(TargetError, match="found no folder"):
        save_layout(tmp_path / "none" / "layout.xml", RECORDED, THERE)
    assert [*tmp_path.iterdir()] == []


def test_names_are_written_as_xml_allows(tmp_path: Path) -> None:
    strange = replace(RECORDED, session='a"<&>b')
    save_layout(tmp_path / "layout.xml", strange, THERE)
    names = [curve.get("name") or "" for curve in ET.parse(tmp_path / "layout.xml").getroot().iter("curve")]
    assert names
    assert all(name.startswith('/a"<&>b/') for name in names)
