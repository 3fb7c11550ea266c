"""A run of the same processes and links, carried by a middleware and with no mathematics in them."""

from __future__ import annotations

import array
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import proc
from loop_runs import Failed, Run, Treatment, share_late

FOLDER = Path(__file__).parent
PEERS_VENV = FOLDER.parent / "out" / "peers-venv"
OPENING_TIME = 30.0  # s, for a peer's processes to find each other
_DEBIAN_PYTHON = "/usr/bin/python3"  # for which Debian's packages are


@dataclass(frozen=True)
class Middleware:
    """One that is measured beside the session.

    Attributes:
        label: what the table calls it.
        python: the interpreter it was installed for.
        installs: how ``--install`` gets it; empty where it is there anyway.
    """

    label: str
    python: str
    installs: tuple[str, ...]


def _from_pypi(label: str, *packages: str) -> Middleware:
    python = str(PEERS_VENV / "bin" / "python")
    return Middleware(label, python, (python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *packages))


BARE = "pyzmq"
MIDDLEWARES = {
    BARE: Middleware("bare pyzmq, PAIR over ipc", sys.executable, ()),
    "lcm": _from_pypi("LCM", "lcm"),
    "zenoh": _from_pypi("zenoh (peers, express)", "eclipse-zenoh"),
    "cyclonedds": _from_pypi("Cyclone DDS (under ROS 2)", "cyclonedds"),
    "dora": _from_pypi("dora", "dora-rs", "dora-rs-cli"),
    "rospy": Middleware(
        "ROS 1, rospy (tcp_nodelay)",
        _DEBIAN_PYTHON,
        ("apt-get", "install", "--yes", "--no-install-recommends", "python3-rospy", "python3-rosmaster",
         "python3-std-msgs"),
    ),
}  # fmt: skip


def peer(name: str, seconds: float, plan: dict[str, Any], treatment: Mapping[str, Treatment], folder: Path) -> Run:
    """The same processes and links, carried by a middleware.

    Args:
        name: which of :data:`MIDDLEWARES`.
        seconds: how long; a middleware that cannot keep up is ended after half as long again.
        plan: roles and links, as :mod:`chain` reads them; ``period``.
        treatment: of each node.
        folder: for its files, not there yet.

    Raises:
        Failed: it cannot be started, or did not come to its end.
    """
    folder.mkdir(mode=0o700)
    ticks = max(1, round(seconds * 1e9 / plan["period"]))
    plan = {**plan, "ticks": ticks, "limit": int(1.5e9 * seconds), "folder": str(folder), "port": _free_ports()}
    (folder / "plan.json").write_text(json.dumps(plan))
    with ExitStack() as stack:
        listener = stack.enter_context(socket.socket(socket.AF_UNIX))
        listener.bind(str(folder / "control"))
        listener.listen(len(plan["roles"]))
        listener.settimeout(OPENING_TIME)
        daemons = stack.enter_context(_started(name, plan, folder))
        try:
            nodes: dict[str, _Line] = {}
            pids_of: dict[str, int] = {}
            for _ in plan["roles"]:
                line = _accept(listener, stack)
                hello = line.hear(OPENING_TIME)
                nodes[hello["node"]], pids_of[hello["node"]] = line, hello["pid"]
            told = {line.hear(OPENING_TIME)["open"] for line in nodes.values()}
            for node, pid in pids_of.items():
                treatment[node].give(pid)
            pids = sorted({*pids_of.values(), *(one for daemon in daemons for one in proc.family(daemon))})
            epoch = time.monotonic_ns() + 50_000_000  # time for all to hear it
            used, began = proc.cpu_seconds(pids), time.monotonic()
            for line in nodes.values():
                line.say({"epoch": epoch})
            devices = [node for node, role in plan["roles"].items() if role == "device"]
            results = {node: nodes[node].hear(OPENING_TIME + 2.0 * seconds) for node in devices}
            cpu = (proc.cpu_seconds(pids) - used) / (time.monotonic() - began)
            resident = sum(proc.resident(pid) or 0.0 for pid in pids)
        except (TimeoutError, ValueError, OSError, KeyError) as error:
            raise Failed(f"{name}: {error}; its processes wrote: {_logs(folder)}") from error
    return Run(
        {node: _percentiles(result) for node, result in results.items()},
        min(result["ticks"] for result in results.values()),
        share_late(ticks, [(result["ticks"] + result["lost"], result["late"]) for result in results.values()]),
        len(pids),
        cpu,
        resident,
        ", ".join(sorted(told)),
    )


class _Line:
    """The conversation with a node that has connected."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._words = connection.makefile("r")

    def say(self, word: dict[str, Any]) -> None:
        self._connection.sendall(json.dumps(word).encode() + b"\n")

    def hear(self, wait: float) -> dict[str, Any]:
        """The node's next message.

        Raises:
            TimeoutError: no message came within ``wait`` seconds.
            ValueError: it has ended.
        """
        self._connection.settimeout(wait)
        said = self._words.readline()
        if not said:
            raise ValueError("a process ended before its time")
        word: dict[str, Any] = json.loads(said)
        return word

    def close(self) -> None:
        self._words.close()
        self._connection.close()


def _accept(listener: socket.socket, stack: ExitStack) -> _Line:
    line = _Line(listener.accept()[0])
    stack.callback(line.close)
    return line


@contextmanager
def _started(name: str, plan: dict[str, Any], folder: Path) -> Iterator[list[int]]:
    """The processes of a run; yields those that are not nodes, and ends all."""
    chain = [str(FOLDER / "loop_peers" / "chain.py"), name]
    ends = [str(folder / "plan.json"), str(folder / "control")]
    python = MIDDLEWARES[name].python
    running: list[subprocess.Popen[bytes]] = []

    def start(command: list[str], output: int | None = None) -> subprocess.Popen[bytes]:
        with (folder / f"{len(running)}.log").open("wb") as log:
            try:
                one = subprocess.Popen(  # noqa: S603 -- our own file, or the peer's own program
                    command, stdin=subprocess.DEVNULL, stdout=output or log, stderr=log, cwd=folder,
                    start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise Failed(f"{name}: {command[0]}: {error.strerror}; run with --install") from error
        running.append(one)
        return one

    try:
        daemons = []
        if name == "rospy":
            master = start([python, str(FOLDER / "loop_peers" / "rospy_master.py"), str(plan["port"])], subprocess.PIPE)
            daemons.append(master.pid)
            if master.stdout is None or not master.stdout.readline():
                raise Failed(f"{name}: its master did not start: {_logs(folder)}")
            master.stdout.close()
        if name == "dora":
            (folder / "dataflow.yml").write_text(json.dumps(_dataflow(plan, python, chain, ends)))  # YAML is JSON too
            command = str(Path(python).with_name("dora"))
            daemons.append(start([command, "run", str(folder / "dataflow.yml")]).pid)
        else:
            for node in plan["roles"]:
                start([python, *chain, node, *ends])
        yield daemons
    finally:
        _end(running)


def _end(running: list[subprocess.Popen[bytes]]) -> None:
    """End processes and whatever they have started."""
    everybody = {pid for one in running for pid in proc.family(one.pid)}
    for one in running:
        one.kill()
    for one in running:
        one.wait()
    for pid in everybody - {one.pid for one in running}:
        if any("chain.py" in argument for argument in proc.arguments(pid)):  # still the one that was seen
            os.kill(pid, signal.SIGKILL)


def _dataflow(plan: dict[str, Any], python: str, chain: list[str], ends: list[str]) -> dict[str, Any]:
    """The nodes and links as dora wants them."""
    neighbours: dict[str, list[str]] = {node: [] for node in plan["roles"]}
    for binder, connector in plan["links"]:
        neighbours[binder].append(connector)
        neighbours[connector].append(binder)
    return {
        "nodes": [
            {
                "id": node,
                "path": python,
                "args": " ".join([*chain, node, *ends]),
                "inputs": {f"from_{other}": f"{other}/to_{node}" for other in others},
                "outputs": [f"to_{other}" for other in others],
            }
            for node, others in neighbours.items()
        ]
    }


def _free_ports() -> int:
    """The first of two dozen ports that are free now."""
    while True:
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            first = int(one.getsockname()[1])
        if first + 24 < 65536:
            return first


def _percentiles(result: dict[str, Any]) -> dict[str, float]:
    taus = array.array("q", Path(result["taus"]).read_bytes())
    if not taus:
        raise Failed("not one tick was answered")
    ordered = sorted(tau / 1e3 for tau in taus)
    return {
        name: _quantile(ordered, part) for name, part in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999), ("max", 1.0))
    }


def _quantile(ordered: list[float], part: float) -> float:
    """The least value that ``part`` of all do not exceed."""
    return ordered[max(0, -int(-part * len(ordered) // 1) - 1)]


def _logs(folder: Path) -> str:
    """The last lines of what the processes of a run wrote."""
    texts = (log.read_text(errors="replace").strip() for log in sorted(folder.glob("*.log")))
    return " | ".join(text.splitlines()[-1][-200:] for text in texts if text) or "nothing"
