"""Everything that follows from a session's structure agrees: blocks of V, links, ports of the processes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import Session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.protocol.messages import Role


@settings(max_examples=60)
@given(data=st.data())
def test_blocks_links_and_ports_agree(drawn_sessions: st.SearchStrategy[Session], data: st.DataObject) -> None:
    session = data.draw(drawn_sessions)
    graph, loop = topology(session), haptic_loop(session)
    mask = loop.partition.mask()
    index = {port: i for i, port in enumerate(session.ports)}
    assert graph.ports[ENVIRONMENT] == session.ports
    # every coupling is linked to the environment by exactly its block, whose entries are the mask's
    for name, block in zip(loop.partition.names, loop.partition.blocks, strict=True):
        (to_environment,) = [link for link in graph.links_of(name) if link.binder == ENVIRONMENT]
        assert to_environment.ports == tuple(session.ports[p] for p in block)
        assert np.all(mask[np.ix_(block, block)])
    # a device is linked to a coupling exactly where they share ports, and by those
    for device in session.devices:
        for coupling in session.couplings:
            shared = {p for p in graph.ports[coupling] if p in graph.ports[device]}
            links = [set(link.ports) for link in graph.links if (link.binder, link.connector) == (coupling, device)]
            assert links == ([shared] if shared else [])
    # no link joins two devices or two couplings, and ports of different blocks never share a coupling's link
    for link in graph.links:
        roles = {graph.nodes[link.binder], graph.nodes[link.connector]}
        assert roles in ({Role.ENVIRONMENT, Role.COUPLING}, {Role.COUPLING, Role.DEVICE})
        rows = [index[p] for p in link.ports]
        assert np.all(mask[np.ix_(rows, rows)])
    # every port reaches its device and the environment exactly once
    for role, expected in ((Role.DEVICE, 1), (Role.COUPLING, 1)):
        carried = [p for link in graph.links if graph.nodes[link.connector] is role for p in link.ports]
        assert sorted(carried) == sorted(session.ports * expected)
