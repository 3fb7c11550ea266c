"""Which nodes a launch starts on which machines, and what it runs there."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.plan.hosts import ended_there, hosts_of, require_hosts_alone, ssh_command
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.reach import Listen, ReachError, reach
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
LISTEN = Listen("192.0.2.7", 7400)


def plan(*overrides: str) -> Plan:
    watch = "observers={watch: {reads: [telemetry]}}"
    return Plan(load_session(SESSIONS / "example1.yaml", [watch, *overrides]))


def test_several_nodes_may_share_a_host() -> None:
    found = hosts_of(["cx=me@lab", "dy=192.0.2.9", "dx=me@lab"], plan())
    assert list(found.items()) == [("dx", "me@lab"), ("dy", "192.0.2.9"), ("cx", "me@lab")]
    assert hosts_of([], plan("colocate=true")) == {}


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["dx"], "found 'dx'; expected NODE=HOST"),
        (["dx="], "found 'dx='; expected NODE=HOST"),
        (["dx=-oProxyCommand=x"], "expected NODE=HOST"),
        (["dx=a host"], "expected NODE=HOST"),
        (["dx=a;b"], "expected NODE=HOST"),
        (["dx=a\n"], "expected NODE=HOST"),
        (["dw=lab"], "found 'dw'; expected one of"),
        (["watch=lab"], "found the observer watch; expected a device or a coupling"),
        (["environment=lab"], "found environment; expected a device or a coupling"),
        (["dx=lab", "dx=lab"], "found dx twice"),
        (["dz=lab"], "give either --on or --remote for dz"),
        (["cx=lab"], "found cx on lab without dx; expected --on dx=lab as well"),
        (["cx=lab", "dx=other"], "found cx on lab without dx"),
    ],
)
def test_what_cannot_be_started_there_is_named(words: list[str], found: str) -> None:
    with pytest.raises(ReachError) as error:
        hosts_of(words, plan(), ["dz"])
    assert found in str(error.value)
    assert "--on" in str(error.value)


def test_a_process_of_several_nodes_stays_here() -> None:
    with pytest.raises(ReachError, match="found colocate: true; expected false"):
        hosts_of(["dx=lab"], plan("colocate=true"))


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (("ipc", False, True), "--on: found --transport ipc; expected tcp"),
        (("tcp", True, True), "--on needs keys"),
        ((None, False, False), "--on needs --listen"),
    ],
)
def test_options_that_do_not_go_with_it(options: tuple[str | None, bool, bool], found: str) -> None:
    with pytest.raises(ReachError, match=found):
        require_hosts_alone({"dx": "lab"}, *options)
    require_hosts_alone({}, *options)


def test_the_command_holds_names_and_addresses_alone() -> None:
    command = ssh_command("dx", "me@lab", "tcp://192.0.2.7:7400", "~/bin/manyhands")
    at = command.index("--")
    assert command[at + 1 :] == ["me@lab", "~/bin/manyhands node dx --bundle - --connect tcp://192.0.2.7:7400"]
    assert command[:2] == ["ssh", "-T"]
    assert "BatchMode=yes" in command


def test_an_end_there_is_one_line() -> None:
    assert ended_there("lab", 1, "") == "ended on lab (ssh: exit code 1)"
    assert ended_there("lab", 255, "a\nb") == "ended on lab (ssh: exit code 255: b)"


def test_keys_are_made_for_the_run_and_links_between_nodes_there_stay_there() -> None:
    of = plan()
    ways = reach(of, "tcp", listen=LISTEN, hosts={"dx": "lab", "cx": "lab", "dy": "lab"})
    assert ways.keys is not None
    assert ways.remote == {"dx", "cx", "dy"}
    places = {(link.binder, link.connector): ways.address(of.graph, i) for i, link in enumerate(of.graph.links)}
    assert places["cx", "dx"] == "127.0.0.1:*"
    assert places["environment", "cx"].startswith("192.0.2.7:")
    assert places["cy", "dy"].startswith("192.0.2.7:")
    assert places["cz", "dz"] == ""  # of this machine: ipc
