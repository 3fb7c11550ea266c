"""An account in words of which node waits for which, for a session that does not go on."""

from __future__ import annotations

from typing import Final

from manyhands.nodes.environment.membership import Membership

from .process import SimulatedProcess
from .world import SimulatedSession

LATELY: Final = 40  # notes


def account(world: SimulatedSession, everything: bool = False) -> str:
    """Every node with its tick, what it waits for and its links; the environment's members; what happened before."""
    lines = [f"at {world.scheduler.now / 1e6:.3f} ms, after {world.scheduler.steps} steps:"]
    for name, state in world.conductor.states.items():
        process = world.processes.get(name)
        lines.append(f"  {name} ({state}): {'no process' if process is None else _where(process, world)}")
    members = world.members
    if members is not None:
        for member in members.all:
            state = member.membership.state
            due = f", due {member.due}" if state is Membership.REJOINING else ""
            early = f", early {member.early[0]}" if member.early else ""
            lines.append(
                f"  member {member.peer_link.peer.name}: {state.value}{due}{early}, from {member.membership._until}"
            )
        lines.append(f"  resumes {members._resumes}, ahead {members.ahead}, ticks {world.tick}")
    links = world.conductor._recovery._links._states.items()
    states = (f"{binder}-{connector} {state}" for (binder, connector), state in links)
    lines.append(f"  links: {', '.join(states)}")
    return "\n".join(
        [*lines, "  lately:", *(f"    {note}" for note in list(world.notes)[0 if everything else -LATELY :])]
    )


def _where(process: SimulatedProcess, world: SimulatedSession) -> str:
    turn = process.turn
    stack = [] if turn is None else turn.stack()
    where = " < ".join(f"{function}@{tick}" for function, tick in stack) or "not in its loop"
    peer_links = ", ".join(
        f"{peer_link.peer.name}:{peer_link.tick}"
        + ("" if peer_link.link is not None else " absent")
        + ("" if peer_link.handshake is None else f" shaking hands ({peer_link.handshake.state})")
        + (" new" if peer_link.new else "")
        + (f" told {peer_link.other_tick}" if peer_link.other_tick > peer_link.tick else "")
        for peer_link in process.peer_links
    )
    stopped = f", stopped until {process.held / 1e6:.3f} ms" if process.held > world.scheduler.now else ""
    return f"{where}; heard {peer_links or 'nobody'}{stopped}"
