"""How a run's processes reach each other: allowed combinations, addresses, and recipients of public keys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.plan.keys import ephemeral
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.reach import Listen, ReachError, reach
from manyhands.launch.plan.topology import roster, topology
from manyhands.launch.session import Session, load_session

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
OBSERVERS = "observers={watch: {reads: [telemetry]}}"


@pytest.fixture(scope="module")
def session() -> Session:
    return load_session(SESSIONS / "example1.yaml", [OBSERVERS])


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("7400", "found '7400'; expected HOST:PORT"),
        (":7400", "expected HOST:PORT"),
        ("192.0.2.7:", "expected HOST:PORT"),
        ("192.0.2.7:0", "expected HOST:PORT"),
        ("192.0.2.7:65536", "expected HOST:PORT"),
        ("192.0.2.7:x", "expected HOST:PORT"),
        ("host:7400", "found the host 'host'; expected an IPv4 address"),
        ("::1:7400", "expected an IPv4 address"),
        ("0.0.0.0:7400", "found 0.0.0.0; expected the one address that others reach this machine at"),
    ],
)
def test_an_invalid_address_is_reported(text: str, found: str) -> None:
    with pytest.raises(ReachError) as error:
        Listen.parse(text)
    assert str(error.value).startswith("--listen: ")
    assert found in str(error.value)


def test_an_address() -> None:
    assert Listen.parse("192.0.2.7:7400") == Listen("192.0.2.7", 7400)


@pytest.mark.parametrize(
    ("transport", "wishes", "found"),
    [
        ("ipc", {"insecure": True}, "--transport: found ipc; expected tcp"),
        ("ipc", {"listen": Listen("127.0.0.1", 1)}, "--transport: found ipc; expected tcp"),
        ("tcp", {"remote": frozenset({"dw"})}, "--remote: found 'dw'; expected one of"),
        ("tcp", {"remote": frozenset({"dx"}), "insecure": True}, "--remote needs --listen"),
        (
            "tcp",
            {"remote": frozenset({"dx"}), "listen": Listen("127.0.0.1", 7400)},
            "--remote needs --keys",
        ),
        ("tcp", {"listen": Listen("127.0.0.1", 65530)}, "after which 7 more are used; expected at most 65528"),
    ],
)
def test_wishes_that_do_not_go_together(session: Session, transport: str, wishes: dict[str, Any], found: str) -> None:
    with pytest.raises(ReachError) as error:
        reach(Plan(session), transport, **wishes)
    assert found in str(error.value)


def test_keys_and_no_encryption_do_not_go_together(session: Session) -> None:
    with pytest.raises(ReachError, match="give either --insecure or --keys"):
        reach(Plan(session), "tcp", insecure=True, keys=ephemeral(roster(session), session.name))


def test_tcp_is_encrypted_unless_the_user_opts_out(session: Session) -> None:
    assert reach(Plan(session), "tcp").ring() is not None
    assert reach(Plan(session), "tcp", insecure=True).ring() is None
    assert reach(Plan(session), "ipc").ring() is None


def test_public_keys_go_to_nodes_that_share_a_channel(session: Session) -> None:
    ways = reach(Plan(session), "tcp")
    assert ways.keys is not None
    for name, allowed in Plan(session).peers.items():
        assert ways.public(name).keys() == {name, *allowed}
        assert all(ways.keys.public.keys[other] == key for other, key in ways.public(name).items())
    assert ways.public("dx").keys() == {"dx", "cx", "supervisor"}
    assert ways.public("watch").keys() == {"watch", "supervisor"}


def test_listeners_have_their_own_ports_and_local_links_need_none(session: Session) -> None:
    graph = topology(session)
    listen = Listen("192.0.2.7", 7400)
    ways = reach(Plan(session), "tcp", insecure=True, listen=listen, remote=frozenset({"dy"}))
    places = {(link.binder, link.connector): ways.address(graph, i) for i, link in enumerate(graph.links)}
    (number,) = (i for i, link in enumerate(graph.links) if link.connector == "dy")
    far = [binder for binder, connector in places if connector == "dy"]
    assert [places.pop((binder, "dy")) for binder in far] == [f"192.0.2.7:{7401 + number}"]
    assert set(places.values()) == {""}
    assert ways.hub_address() == "192.0.2.7:7400"
    assert ways.observer_address(graph, 0) == f"192.0.2.7:{7401 + len(graph.links)}"


def test_where_no_node_is_elsewhere_local_links_use_tcp_as_asked(session: Session) -> None:
    graph = topology(session)
    ways = reach(Plan(session), "tcp", insecure=True, listen=Listen("192.0.2.7", 7400))
    links = [ways.address(graph, i) for i in range(len(graph.links))]
    assert links == [f"127.0.0.1:{7401 + i}" for i in range(len(links))]


def test_without_a_port_any_will_do_and_ipc_needs_none(session: Session) -> None:
    graph = topology(session)
    assert reach(Plan(session), "tcp", insecure=True).address(graph, 0) == "127.0.0.1:*"
    assert reach(Plan(session), "ipc").hub_address() == reach(Plan(session), "ipc").address(graph, 0) == ""
