"""What `manyhands graph` prints: every node, link and capability, whole at any width."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from manyhands.launch.look.graph import show, show_access
from manyhands.launch.look.graph.parts import access_object, drawing_of_session, graph_object
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import Session, load_session

SESSIONS = Path(__file__).parents[4] / "launch" / "sessions"
OBSERVERS = "observers={watch: {reads: [telemetry]}, scope: {reads: [cx/tool, d/sample]}}"


def example() -> Session:
    return load_session(SESSIONS / "example1-operator.yaml", [OBSERVERS])


def printed(session: Session, access: bool, width: int = 140) -> str:
    text = io.StringIO()
    plan, console = Plan(session), Console(file=text, width=width)
    if access:
        show_access(plan, console, "text", None)
    else:
        show(drawing_of_session(plan), console, "text", None)
    return text.getvalue()


def rows(text: str) -> list[list[str]]:
    """The cells of every line of the tables."""
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")]


def test_nodes_and_links() -> None:
    assert rows(printed(example(), access=False)) == [
        ["d", "device", "d.x, d.y, d.z"],
        ["cx", "coupling", "d.x"],
        ["cy", "coupling", "d.y"],
        ["cz", "coupling", "d.z"],
        ["environment", "environment", "d.x, d.y, d.z"],
        ["watch", "observer", "reads telemetry"],
        ["scope", "observer", "reads cx/tool, d/sample"],
        ["cx", "environment", "d.x", "tool (p, m)", "reaction (f_v, N)"],
        ["cy", "environment", "d.y", "tool (p, m)", "reaction (f_v, N)"],
        ["cz", "environment", "d.z", "tool (p, m)", "reaction (f_v, N)"],
        ["d", "cx", "d.x", "sample (x, m)", "force (f_v, N)"],
        ["d", "cy", "d.y", "sample (x, m)", "force (f_v, N)"],
        ["d", "cz", "d.z", "sample (x, m)", "force (f_v, N)"],
    ]


def test_the_capability_table_has_one_row_a_node_and_channel() -> None:
    text = printed(example(), access=True)
    shown = rows(text)
    assert shown[:7] == [
        ["d", "device", "writes", "sample (x, m)", "to cx: d.x"],
        ["", "", "", "", "to cy: d.y"],
        ["", "", "", "", "to cz: d.z"],
        ["d", "device", "reads", "force (f_v, N)", "from cx: d.x"],
        ["", "", "", "", "from cy: d.y"],
        ["", "", "", "", "from cz: d.z"],
        ["d", "device", "writes", "telemetry", "to supervisor: d.x, d.y, d.z"],
    ]
    assert shown[-1] == ["scope", "observer", "reads", "observation", "from supervisor: d/sample, cx/tool"]
    assert not [row for row in shown if row[1] == "observer" and row[2] != "reads"]
    named = [(row[0], row[3].split(" ")[0]) for row in shown if row[0]]
    assert named == list(dict.fromkeys((row.node, row.channel) for row in Plan(example()).access))
    assert "a coupling sends the D_V of its block to the environment" in text


@pytest.mark.parametrize("access", [False, True])
def test_nothing_is_cut_short_where_there_is_little_room(access: bool) -> None:
    text = printed(example(), access, width=60)
    assert "…" not in text
    folded = re.sub(r"\s", "", "".join(row[-1 if access else 0] for row in rows(text)))
    assert "fromenvironment:d.x" in folded if access else "environment" in folded


def test_json_of_the_graph(capsys: pytest.CaptureFixture[str]) -> None:
    show(drawing_of_session(Plan(example())), Console(), "json", None)
    said = json.loads(capsys.readouterr().out)
    assert said["session"] == "example-1-operator"
    assert said["nodes"]["d"] == {"role": "device", "ports": ["d.x", "d.y", "d.z"]}
    assert said["links"][0] == {
        "between": ["environment", "cx"],
        "ports": ["d.x"],
        "signals": {"environment": ["reaction"], "cx": ["tool"]},
    }
    assert said["observers"] == {"watch": {"reads": ["telemetry"]}, "scope": {"reads": ["cx/tool", "d/sample"]}}


def test_json_of_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    show_access(Plan(example()), Console(), "json", None)
    said = json.loads(capsys.readouterr().out)
    assert said["access"][0] == {
        "node": "d",
        "role": "device",
        "action": "write",
        "channel": "sample",
        "peer": "cx",
        "ports": ["d.x"],
    }
    assert said["access"][-1] == {
        "node": "scope",
        "role": "observer",
        "action": "read",
        "channel": "observation",
        "peer": "supervisor",
        "ports": ["d.x", "d.y", "d.z"],
        "content": ["d/sample", "cx/tool"],
    }
    assert said["session"] == "example-1-operator"


@settings(max_examples=40)
@given(data=st.data())
def test_both_forms_say_all_there_is(drawn_sessions: st.SearchStrategy[Session], data: st.DataObject) -> None:
    session = data.draw(drawn_sessions)
    graph, plain = topology(session), graph_object(drawing_of_session(Plan(session)))
    assert {name: node["ports"] for name, node in plain["nodes"].items()} == {n: [*p] for n, p in graph.ports.items()}
    assert [(*link["between"], *link["ports"]) for link in plain["links"]] == [
        (link.binder, link.connector, *link.ports) for link in graph.links
    ]
    # each end writes on the links exactly what the table allows it
    writes = {
        (end, channel, other)
        for link in plain["links"]
        for end, other in (link["between"], link["between"][::-1])
        for channel in link["signals"][end]
    }
    table: list[dict[str, Any]] = access_object(Plan(session))["access"]
    assert writes == {
        (row["node"], row["channel"], row["peer"])
        for row in table
        if row["action"] == "write" and row["channel"] not in ("telemetry", "observation")
    }
    assert len(table) == len(Plan(session).access)
    text = printed(session, access=True)
    for row in Plan(session).access:
        direction = "to" if row.action == "write" else "from"
        assert f"{direction} {row.peer}: {', '.join((row.content or row.ports)[:1])}" in text
