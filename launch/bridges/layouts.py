"""Layouts of Foxglove and PlotJuggler for one session: which curves stand in which plot.

The topics of a session have its nodes' names, so a layout is made for the session, from the table of topics
(:mod:`manyhands.protocol.channels`). Live session and recording have the same topics: one layout serves both.
:func:`pages_of` chooses the curves; :func:`foxglove_layout` and :func:`plotjuggler_layout` write them in the form of
each program ([Foxglove2023]_, [PlotJuggler2024]_).
"""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from manyhands.design.files import replacing
from manyhands.design.models.scene import ContactScene
from manyhands.launch.files import TargetError, require_target
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.monitor.session_state import About
from manyhands.nodes.recorder.format import FIGURES, SUPERVISOR, Recorded
from manyhands.nodes.recorder.scene_messages import POSE, SCENE
from manyhands.nodes.rows.figures import FIGURES as DECLARED
from manyhands.nodes.rows.units import unit_of_all
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic, topic_name
from manyhands.protocol.messages import Role

Field: TypeAlias = str | int
"""A key of an object, or a place in an array."""


@dataclass(frozen=True)
class Series:
    """A number of a topic's messages.

    Attributes:
        topic: its full name.
        path: from the message to the number.
        label: for people.
    """

    topic: str
    path: tuple[Field, ...]
    label: str


@dataclass(frozen=True)
class Plot:
    """A plot of curves of one unit."""

    title: str
    unit: str
    curves: tuple[Series, ...]


@dataclass(frozen=True)
class Page:
    """A page of plots, one below the other."""

    title: str
    plots: tuple[Plot, ...]


Topics: TypeAlias = Collection[tuple[str, str]]
"""The topics that there are, by node and name."""

_PAGES: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "motion": {
        "positions of devices and tools": ("sample", "tool"),
        "forces": ("force", "reaction"),
        "masses": ("masses",),
    },
    "turning": {"orientations of devices and tools": ("orientation", "proxy"), "torques": ("torque",)},
    "promises": {"ledgers": ("ledger",), "accounts of lateness": ("interface",), "delays": ("tau",)},
    "wave links": {"waves": ("wave",), "tanks": ("tank",)},
}
"""By page and plot, the topics that it shows."""

_LEAST_DISTANCE: Final = 0.1  # m, of the camera of the 3-D panel


def live_topics(about: About) -> Topics:
    """The topics that the nodes of a running session report."""
    return [(node, topic.name) for node in about.nodes for topic in about.topics(node)]


def pages_of(recorded: Recorded, there: Topics) -> list[Page]:
    """The pages of a session's layout.

    Args:
        recorded: the session.
        there: its topics; others are left out, and so is a plot or a page without any.
    """
    pages = []
    for title, plots in _PAGES.items():
        found = [_plot(name, topics, recorded, there) for name, topics in plots.items()]
        if title == "promises":
            found += [_figures(*one.plot, one.name, recorded) for one in DECLARED.values() if one.plot is not None]
        filled = tuple(plot for plot in found if plot.curves)
        if filled:
            pages.append(Page(title, filled))
    return pages


def _plot(title: str, wanted: Sequence[str], recorded: Recorded, there: Topics) -> Plot:
    curves, units = list[Series](), list[str]()
    for node in recorded.roles:
        for topic in recorded.topics(node):
            if topic.name in wanted and (node, topic.name) in there:
                curves += _curves(recorded, node, topic)
                units.append(unit_of_all(topic, recorded.columns(node, topic), recorded.turning))
    return Plot(title, " or ".join(dict.fromkeys(units)), tuple(curves))


def _curves(recorded: Recorded, node: str, topic: Topic) -> Iterator[Series]:
    name = topic_name(recorded.session, node, topic.name)
    if topic.columns is Columns.ONE:
        yield Series(name, (topic.trace,), f"{node} {topic.symbol}")
        return
    for place, column in enumerate(recorded.columns(node, topic)):
        yield Series(name, (topic.trace, place), f"{topic.symbol} of {column} at {node}")


def _figures(title: str, role: Role, figure: str, recorded: Recorded) -> Plot:
    own = [node for node, its in recorded.roles.items() if its is role]
    curves = (Series(topic_name(recorded.session, node, TELEMETRY), (FIGURES, figure), node) for node in own)
    return Plot(title, "", tuple(curves))


def states_of(recorded: Recorded) -> list[Series]:
    """The words that change in a session's condition: its phase, and the state of each node."""
    topic = topic_name(recorded.session, SUPERVISOR, CONDITION)
    return [Series(topic, ("phase",), recorded.session), *(Series(topic, ("states", n), n) for n in recorded.roles)]


def foxglove_layout(recorded: Recorded, there: Topics) -> bytes:
    """A layout for Foxglove's *Import from file* (JSON): a tab for each page, and states below."""
    panels: dict[str, Any] = {}
    tabs = []
    space = recorded.scene or recorded.drawing
    if space is not None:
        panels["3D!scene"] = _foxglove_scene(recorded, space)
        tabs.append({"title": "scene", "layout": "3D!scene"})
    for number, page in enumerate(pages_of(recorded, there)):
        own = {f"Plot!page{number}plot{place}": _foxglove_plot(plot) for place, plot in enumerate(page.plots)}
        panels |= own
        tabs.append({"title": page.title, "layout": _below_each_other([*own])})
    panels["Tab!pages"] = {"activeTabIdx": 0, "tabs": tabs}
    panels["StateTransitions!states"] = {
        "foxglovePanelTitle": "states",
        "isSynced": True,
        "paths": [_series(curve) for curve in states_of(recorded)],
    }
    layout = {"direction": "column", "first": "Tab!pages", "second": "StateTransitions!states", "splitPercentage": 70}
    whole = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(whole, ensure_ascii=False, indent=2).encode() + b"\n"


def _foxglove_scene(recorded: Recorded, space: ContactScene | WorldDrawing) -> dict[str, Any]:
    """The 3-D panel: it looks at the middle of a scene along -z, with y upwards, as the page does.

    At a world whose z is upwards it looks obliquely from above, along y.
    """
    low, high = space.bounds
    environments = [node for node, role in recorded.roles.items() if role is Role.ENVIRONMENT]
    return {
        "foxglovePanelTitle": "scene",
        "followMode": "follow-pose",
        "followTf": recorded.session,
        "cameraState": {
            "perspective": True,
            "distance": _LEAST_DISTANCE + 1.5 * math.dist(low, high),
            "phi": 60 if isinstance(space, WorldDrawing) and space.up == "z" else 0,
            "thetaOffset": 0,
            "targetOffset": [(a + b) / 2 for a, b in zip(low.tolist(), high.tolist(), strict=True)],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.01,
            "far": 5000,
        },
        "topics": {
            topic_name(recorded.session, node, topic): {"visible": True}
            for nodes, topic in ((environments, SCENE), (recorded.hands, POSE))
            for node in nodes
        },
        "transforms": {},
        "layers": {},
        "scene": {},
    }


def _foxglove_plot(plot: Plot) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": f"{plot.title}{plot.unit and f', {plot.unit}'}",
        "paths": [_series(curve) for curve in plot.curves],
        "xAxisVal": "timestamp",
        "yAxisLabel": plot.unit,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "sidebarDimension": 200,
    }


def _series(curve: Series) -> dict[str, Any]:
    return {
        "value": foxglove_path(curve),
        "enabled": True,
        "timestampMethod": "receiveTime",
        "label": curve.label,
    }


def foxglove_path(curve: Series) -> str:
    """A curve in Foxglove's notation; names with other characters than letters, digits, ``_`` and ``-`` are quoted."""
    topic = curve.topic if re.fullmatch(r"(/[A-Za-z0-9_-]+)+", curve.topic) else json.dumps(curve.topic)
    return topic + "".join(f"[{one}]" if isinstance(one, int) else f".{_quoted(one)}" for one in curve.path)


def _quoted(key: str) -> str:
    return key if re.fullmatch("[A-Za-z_][A-Za-z0-9_-]*", key) else json.dumps(key)


def _below_each_other(panels: Sequence[str]) -> Any:
    """A tree of splits of which each panel has the same height."""
    first, *rest = panels
    if not rest:
        return first
    height = 100 / len(panels)
    return {"direction": "column", "first": first, "second": _below_each_other(rest), "splitPercentage": height}


_COLOURS: Final = ("#1f77b4", "#d62728", "#1ac938", "#ff7f0e", "#f14cc1", "#9467bd", "#17becf", "#bcbd22")


def plotjuggler_layout(recorded: Recorded, there: Topics) -> bytes:
    """A layout for PlotJuggler (XML): a tab for each page."""
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for page in pages_of(recorded, there):
        container = ET.SubElement(ET.SubElement(tabs, "Tab", tab_name=page.title, containers="1"), "Container")
        sizes = ";".join([f"{1 / len(page.plots):.6f}"] * len(page.plots))
        split = ET.SubElement(container, "DockSplitter", orientation="-", count=str(len(page.plots)), sizes=sizes)
        for plot in page.plots:
            title = f"{plot.title}{plot.unit and f' [{plot.unit}]'}"
            area = ET.SubElement(split, "DockArea", name=title)
            shown = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
            ET.SubElement(shown, "limitY")
            for place, curve in enumerate(plot.curves):
                colour = _COLOURS[place % len(_COLOURS)]
                ET.SubElement(shown, "curve", name=plotjuggler_name(curve), color=colour)
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


def plotjuggler_name(curve: Series) -> str:
    """The name that PlotJuggler gives a number of a JSON message: keys after slashes, places in brackets."""
    return curve.topic + "".join(f"[{one}]" if isinstance(one, int) else f"/{one}" for one in curve.path)


LAYOUTS: Final[Mapping[str, Callable[[Recorded, Topics], bytes]]] = {
    ".json": foxglove_layout,
    ".xml": plotjuggler_layout,
}
"""The forms of a layout, by suffix: that of Foxglove and that of PlotJuggler."""


def save_layout(path: Path, recorded: Recorded, there: Topics) -> None:
    """Write a session's layout, whole or not at all, in the form of the suffix.

    Raises:
        TargetError: the suffix is another, or the file cannot be written there.
    """
    if path.suffix not in LAYOUTS:
        raise TargetError(
            f"{path}: found the suffix {path.suffix!r}; expected .json for Foxglove or .xml for PlotJuggler"
        )
    require_target(path)
    try:
        with replacing(path) as file:
            file.write(LAYOUTS[path.suffix](recorded, there))
    except OSError as error:
        raise TargetError(f"{path}: cannot be written: {error.strerror}") from error
