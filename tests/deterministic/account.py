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
                f"  member {member.join.peer.name}: {state.value}{due}{early}, from {member.membership._until}"
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
    joins = ", ".join(
        f"{join.peer.name}:{join.tick}"
        + ("" if join.link is not None else " absent")
        + ("" if join.handshake is None else f" shaking hands ({join.handshake.state})")
        + (" new" if join.new else "")
        + (f" told {join.other_tick}" if join.other_tick > join.tick else "")
        for join in process.joins
    )
    stopped = f", stopped until {process.held / 1e6:.3f} ms" if process.held > world.scheduler.now else ""
    return f"{where}; heard {joins or 'nobody'}{stopped}"
