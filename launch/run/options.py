"""How a session is to be started, as every command and Python state it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from manyhands.design.certificate import Certificate
from manyhands.launch.plan.reach import Listen
from manyhands.nodes.kernel.bundle import REALTIME


@dataclass(frozen=True)
class Hosting:
    """What is kept of a session whose seats are taken and left, from one start to the next.

    Attributes:
        folder: the folder of its certificates, keys and invitations.
        address: where guests reach this machine, HOST:PORT.
    """

    folder: Path
    address: str


@dataclass(frozen=True)
class StartOptions:
    """How a session is to be started.

    Attributes:
        clock: "realtime" or "simulated".
        ticks: number of ticks; 0 runs until somebody ends it.
        transport: "ipc" or "tcp"; None for "tcp" where nodes are started by ssh, and "ipc" elsewhere.
        insecure: whether links over "tcp" are without encryption and keys.
        keys: the folder of the session's keys; None for keys of this run alone.
        listen: where remote nodes and observers reach this machine.
        remote: nodes that join by invitation.
        on: ``NODE=HOST`` for each node that is started on another machine by ssh.
        program: what starts manyhands there.
        hosting: for seats whose users come and go; None where there are none.
        together: whether a remote node that leaves ends the session.
        certificate: the certificate to run under, or its file; None to design.
        uncertified: whether to run even if nothing proves the session stable.
        record: the file for every x and f_v; ``.mcap`` is written while the session runs, other formats at its end.
        report: the file for the report.
        directory: a new folder that keeps session, certificate, report and logs.
    """

    clock: str = REALTIME
    ticks: int = 0
    transport: str | None = None
    insecure: bool = False
    keys: Path | None = None
    listen: Listen | None = None
    remote: frozenset[str] = frozenset()
    on: tuple[str, ...] = ()
    program: str = "manyhands"
    hosting: Hosting | None = None
    together: bool = False
    certificate: Path | Certificate | None = None
    uncertified: bool = False
    record: Path | None = None
    report: Path | None = None
    directory: Path | None = None
