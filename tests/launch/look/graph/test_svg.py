"""A session's graph as a picture: complete, without overlaps, and any name is shown as text."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from manyhands.launch.files import TargetError
from manyhands.launch.look.graph import format_of, show
from manyhands.launch.look.graph.parts import Drawing, Part, Tie, drawing_of_live, drawing_of_session, graph_object
from manyhands.launch.look.graph.svg import Box, layout, svg
from manyhands.launch.look.graph.text import mermaid
from manyhands.launch.plan.plan import Plan
from manyhands.launch.session import Session, load_session
from manyhands.nodes.monitor.session_state import Health, LiveSession, NodeAbout
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Role

from ....support.observed_frames import ABOUT, condition, telemetry

SESSIONS = Path(__file__).parents[4] / "launch" / "sessions"
SVG = "{http://www.w3.org/2000/svg}"


def example() -> Session:
    observers = "observers={watch: {reads: [telemetry]}, scope: {reads: [cx/tool, d/sample, d/force]}}"
    return load_session(SESSIONS / "example1-operator.yaml", [observers])


def scene(silent: tuple[str, ...] = ("cx",), **states: str) -> LiveSession:
    seen = LiveSession(ABOUT)
    for number in range(1, 8):
        for name in ABOUT.nodes:
            seen.take(telemetry(name, 100 * number), Instant(100_000_000 * number))
    seen.take(condition(silent=silent, **states), Instant(10**9))
    return seen


def titles(root: ET.Element, kind: str) -> list[str]:
    return [g.findtext(f"{SVG}title") or "" for g in root.iter(f"{SVG}g") if kind in (g.get("class") or "").split()]


@settings(max_examples=15)
@given(data=st.data())
def test_every_node_and_link_has_its_place_and_none_covers_another(
    drawn_sessions: st.SearchStrategy[Session], data: st.DataObject
) -> None:
    session = data.draw(drawn_sessions)
    drawing = drawing_of_session(Plan(session))
    assert [part.name for part in drawing.parts] == [*session.roles, *session.observers]
    placed = layout(drawing)
    assert placed.boxes.keys() == {part.name for part in drawing.parts}
    for box in placed.boxes.values():
        assert box.x >= 0
        assert box.y >= 0
        assert box.x + box.width <= placed.width
        assert box.y + box.height <= placed.height
    for one, other in combinations(placed.boxes.values(), 2):
        assert not overlap(one, other)
    x = {role: {placed.boxes[p.name].x for p in drawing.parts if p.role is role} for role in Role}
    assert max(x[Role.DEVICE]) < min(x[Role.COUPLING]) <= max(x[Role.COUPLING]) < min(x[Role.ENVIRONMENT])
    root = ET.fromstring(svg(drawing))
    assert len(titles(root, "node")) == len(drawing.parts)
    assert len(titles(root, "link")) == sum(tie.is_link for tie in drawing.ties)
    assert len(titles(root, "aside")) == sum(not tie.is_link for tie in drawing.ties)


def overlap(one: Box, other: Box) -> bool:
    return (
        one.x < other.x + other.width and other.x < one.x + one.width
        and one.y < other.y + other.height and other.y < one.y + one.height
    )  # fmt: skip


def test_links_that_need_not_cross_do_not() -> None:
    """Couplings in the opposite order of their devices are put beside them."""
    names = [f"{n}" for n in range(6)]
    parts = [Part(f"d{n}", Role.DEVICE) for n in names] + [Part(f"c{n}", Role.COUPLING) for n in reversed(names)]
    ties = [Tie((f"d{n}", f"c{n}"), ("p",), "x", "f") for n in names]
    boxes = layout(Drawing("t", (*parts, Part("environment", Role.ENVIRONMENT)), tuple(ties))).boxes
    devices, couplings = (sorted(names, key=lambda n, kind=kind: boxes[f"{kind}{n}"].y) for kind in "dc")
    assert devices == couplings


def test_the_picture_of_a_file() -> None:
    text = svg(drawing_of_session(Plan(example())))
    root = ET.fromstring(text)
    assert root.get("role") == "img"
    assert root.findtext(f"{SVG}title") == "example-1-operator"
    assert "d: device; ports d.x, d.y, d.z" in (root.findtext(f"{SVG}desc") or "")
    assert "prefers-color-scheme: dark" in text
    assert titles(root, "link")[0] == "cx to environment: p, back: f_v; ports d.x"
    assert titles(root, "aside") == ["cx, scope: tool", "d, scope: sample, force"]
    assert titles(root, "told") == []  # a file is neither well nor ill
    shown = [element.text for element in root.iter(f"{SVG}text")]
    assert shown.count("x → ← f_v") == 3
    assert "observer, reads telemetry" in shown
    assert not [element for element in root.iter() if element.tag in (f"{SVG}script", f"{SVG}image", f"{SVG}use")]


def test_the_picture_shows_each_nodes_state_in_colour_and_words() -> None:
    root = ET.fromstring(svg(drawing_of_live(scene(d="lost"))))
    assert root.findtext(f"{SVG}title") == "s: away"
    kinds = {(g.get("class") or ""): g for g in root.iter(f"{SVG}g") if "node" in (g.get("class") or "")}
    assert set(kinds) == {"node device told away", "node coupling told silent", "node coupling told ok",
                          "node environment told ok", "node observer"}  # fmt: skip
    words = [element.text for element in root.iter(f"{SVG}text") if element.get("class") == "health"]
    assert words == ["away: lost", "silent: running", "ok: 1000 ticks/s", "ok: 1000 ticks/s"]
    labels = [element.text for element in root.iter(f"{SVG}text") if "→" in (element.text or "")]
    assert labels == ["p → ← f_v (silent)", "p → ← f_v (ok)", "x → ← f_v (away)", "x → ← f_v (away)"]


def test_a_coupling_in_its_devices_process_has_no_link_to_it() -> None:
    session = load_session(SESSIONS / "example1.yaml", ["colocate=true"])
    drawing = drawing_of_session(Plan(session))
    joined = [tie for tie in drawing.ties if not tie.is_link]
    assert [(tie.ends, tie.label) for tie in joined] == [((f"d{n}", f"c{n}"), "one process") for n in "xyz"]
    assert "coupling, in dx" in {line for part in drawing.parts for line in part.label}
    nodes = {**ABOUT.nodes, "cx": NodeAbout(Role.COUPLING, ("d.x",), "d")}
    running = drawing_of_live(LiveSession(replace(ABOUT, nodes=nodes)))
    assert [tie.ends for tie in running.ties if tie.why == "one process"] == [("d", "cx")]


NASTY = st.text(min_size=1, max_size=12) | st.sampled_from(
    ["<script>", 'a"]; click n0 "x"', "&amp;", "]]>", "\x00\x1b[31m", "end", "`x`", "%%{init}%%", "\ud800", "a|b"]
)


@settings(max_examples=30)
@given(name=NASTY, port=NASTY, title=NASTY)
def test_whatever_a_name_is_it_is_text(name: str, port: str, title: str) -> None:
    parts = (Part(f"d{name}", Role.DEVICE, (port,), name, (), Health.LATE, port), Part("e", Role.ENVIRONMENT, (port,)))
    drawing = Drawing(title, parts, (Tie((f"d{name}", "e"), (port,), name, port, Health.OK),), Health.LATE)
    root = ET.fromstring(svg(drawing))
    assert {element.tag.removeprefix(SVG) for element in root.iter()} == {
        "svg", "title", "desc", "style", "rect", "text", "g", "path",
    }  # fmt: skip
    printable = "".join(c if c.isprintable() else "\ufffd" for c in f"d{name}")
    assert printable in [element.text for element in root.iter(f"{SVG}text")]
    lines = mermaid(drawing).splitlines()
    assert len(lines) == 8
    assert re.fullmatch(r'  n0\(\["[^"\[\]|`]*"\]\)', lines[2])
    assert re.fullmatch(r'  n0 <-->\|"[^"|]*"\| n1', lines[4])


def test_mermaid_of_a_running_session() -> None:
    lines = mermaid(drawing_of_live(scene())).splitlines()
    assert lines[0] == "flowchart LR"
    assert '  n1["cx<br/>coupling<br/>d.x<br/>silent: running"]' in lines
    assert '  n0 <-->|"x → ← f_v, silent"| n1' in [line.replace("#95;", "_") for line in lines]
    assert "  class n1 silent" in lines
    assert "  class n0,n2,n3 ok" in lines
    styles = [line for line in lines if line.startswith("  linkStyle ")]
    numbers = sorted(int(n) for line in styles for n in line.split()[1].split(","))
    assert numbers == [0, 1, 2, 3]


def test_as_json_and_text_of_a_running_session() -> None:
    said = graph_object(drawing_of_live(scene()))
    assert said["links"][0] == {
        "between": ["environment", "cx"],
        "ports": ["d.x"],
        "signals": {"environment": ["reaction"], "cx": ["tool"]},
        "health": "silent",
    }
    assert said["nodes"]["d"] == {
        "role": "device", "ports": ["d.x", "d.y"], "state": "running", "rate": 1000.0, "health": "ok",
    }  # fmt: skip
    assert said["observers"] == {"scope": {"reads": ["cx/tool", "telemetry"]}}
    text = io.StringIO()
    show(drawing_of_live(scene()), Console(file=text, width=140), "text", None)
    rows = [[c.strip() for c in line.split("│")[1:-1]] for line in text.getvalue().splitlines() if line[:1] == "│"]
    assert ["cx", "coupling", "d.x", "running", "silent"] in rows
    assert ["d", "cy", "d.y", "sample (x, m)", "force (f_v, N)", "ok"] in rows


@pytest.mark.parametrize(
    ("name", "file", "as_json", "form"),
    [
        (None, None, False, "text"), (None, None, True, "json"), ("svg", None, False, "svg"),
        (None, "g.svg", False, "svg"), (None, "g.mmd", False, "mermaid"), (None, "g.txt", False, "text"),
        (None, "g.json", False, "json"), ("mermaid", "g.md", False, "mermaid"), (None, "g.svg", True, "json"),
    ],
)  # fmt: skip
def test_the_form_that_is_meant(name: str | None, file: str | None, as_json: bool, form: str) -> None:
    assert format_of(name, None if file is None else Path(file), as_json) == form


def test_an_unknown_suffix_is_refused() -> None:
    with pytest.raises(TargetError, match=r"g\.png: found the suffix '\.png'; expected \.svg"):
        format_of(None, Path("g.png"), as_json=False)


@pytest.mark.parametrize("form", ["text", "mermaid", "svg", "json"])
def test_a_file_holds_what_would_have_been_printed(
    form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "graph"
    text = io.StringIO()
    console = Console(file=text, width=140)
    for output in (None, path):
        show(drawing_of_session(Plan(example())), console, form, output)
        show(drawing_of_live(scene()), console, form, output)
        if output is None:
            printed = capsys.readouterr().out or text.getvalue()
    assert capsys.readouterr().out == ""
    assert printed.endswith(path.read_text())
    assert [entry.name for entry in tmp_path.iterdir()] == ["graph"]
