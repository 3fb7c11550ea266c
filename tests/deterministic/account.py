"""Who waits for whom in a session that does not go on, in words."""

from __future__ import annotations

from typing import Final

from manyhands.nodes.environment.membership import Membership

from .process import Process
from .world import SimulatedSession

LATELY: Final = 40  # notes


def account(world: SimulatedSession, everything: bool = False) -> str:
    """Every node with its tick, what it waits for and its links; the environment's seats; what happened before."""
    lines = [f"at {world.scheduler.now / 1e6:.3f} ms, after {world.scheduler.steps} steps:"]
    for name, state in world.conductor.states.items():
        process = world.processes.get(name)
        lines.append(f"  {name} ({state}): {'no process' if process is None else _where(process, world)}")
    places = world.places
    if places is not None:
        for place in places.all:
            seat = place.attendance.seat
            due = f", due {place.due}" if seat is Membership.EXPECTED else ""
            early = f", early {place.early[0]}" if place.early else ""
            lines.append(
                f"  seat of {place.joint.peer.name}: {seat.value}{due}{early}, not before {place.attendance._until}"
            )
        lines.append(f"  resumes {places._resumes}, ahead {places.ahead}, ticks {world.tick}")
    links = world.conductor._recovery._links._states.items()
    states = (f"{binder}-{connector} {state}" for (binder, connector), state in links)
    lines.append(f"  links: {', '.join(states)}")
    return "\n".join(
        [*lines, "  lately:", *(f"    {note}" for note in list(world.notes)[0 if everything else -LATELY :])]
    )


def _where(process: Process, world: SimulatedSession) -> str:
    turn = process.turn
    stack = [] if turn is None else turn.stack()
    where = " < ".join(f"{function}@{tick}" for function, tick in stack) or "not in its loop"
    joints = ", ".join(
        f"{joint.peer.name}:{joint.tick}"
        + ("" if joint.link is not None else " absent")
        + ("" if joint.handshake is None else f" shaking hands ({joint.handshake.state})")
        + (" new" if joint.new else "")
        + (f" told {joint.told}" if joint.told > joint.tick else "")
        for joint in process.joints
    )
    stopped = f", stopped until {process.held / 1e6:.3f} ms" if process.held > world.scheduler.now else ""
    return f"{where}; heard {joints or 'nobody'}{stopped}"
