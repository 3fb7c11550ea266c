"""The properties of a machine that matter for a loop at 1 kHz; they are only read, never changed.

A property that cannot be read is None: a container may hide it, and another kernel may lack it.
"""

from __future__ import annotations

import os
import platform
import sys
import sysconfig
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import zmq

from manyhands.nodes.device import tick
from manyhands.nodes.kernel.realtime import CAP_IPC_LOCK, CAP_SYS_NICE, Linux

_CONTAINER_MARKS = (".dockerenv", "run/.containerenv", "run/systemd/container")


@dataclass(frozen=True)
class Machine:
    """One machine, for one user.

    Attributes:
        kernel: system and release.
        preemption: PREEMPT_RT, PREEMPT_DYNAMIC, PREEMPT, or "voluntary or none".
        virtual: the kind of virtual machine; None where no sign of one is found.
        container: whether this process runs in a container.
        processors: number of processors of the machine.
        usable: the numbers of the processors that this process may use.
        governors: the different frequency governors of the usable processors; None where they cannot be read.
        clock_source: the kernel's clock source.
        priority_limit: RLIMIT_RTPRIO.
        may_raise: whether the process has CAP_SYS_NICE.
        memory_limit: RLIMIT_MEMLOCK, bytes; None for no limit.
        may_lock: whether the process has CAP_IPC_LOCK.
        realtime_share: the greatest part of a processor's time for real-time threads; None for no limit.
        python: implementation, version and compiler.
        gil: whether the interpreter has a global lock.
        zeromq: version of libzmq.
        pyzmq: version of its Python binding.
        curve: whether libzmq can encrypt (CURVE).
        ipc: whether libzmq can use Unix-domain sockets.
        compiled: whether the modules of a tick are compiled.
    """

    kernel: str
    preemption: str
    virtual: str | None
    container: bool
    processors: int
    usable: tuple[int, ...]
    governors: tuple[str, ...] | None
    clock_source: str | None
    priority_limit: int
    may_raise: bool
    memory_limit: int | None
    may_lock: bool
    realtime_share: float | None
    python: str
    gil: bool
    zeromq: str
    pyzmq: str
    curve: bool
    ipc: bool
    compiled: bool

    def plain(self) -> dict[str, Any]:
        """The machine as plain data, for ``--json``."""
        return asdict(self) | {"usable": list(self.usable), "governors": self.governors and list(self.governors)}


def examine(root: Path = Path("/")) -> Machine:
    """The properties of this machine.

    Args:
        root: the folder with proc and sys.
    """
    system, name = Linux(), platform.uname()
    usable = tuple(sorted(os.sched_getaffinity(0)))
    return Machine(
        kernel=f"{name.system} {name.release}",
        preemption=preemption(name.version),
        virtual=virtual(root),
        container=any((root / mark).exists() for mark in _CONTAINER_MARKS),
        processors=os.cpu_count() or len(usable),
        usable=usable,
        governors=governors(root, usable),
        clock_source=_text(root / "sys/devices/system/clocksource/clocksource0/current_clocksource"),
        priority_limit=system.priority_limit(),
        may_raise=system.capable(CAP_SYS_NICE),
        memory_limit=system.memory_limit(),
        may_lock=system.capable(CAP_IPC_LOCK),
        realtime_share=realtime_share(root),
        python=f"{platform.python_implementation()} {platform.python_version()}, {platform.python_compiler()}",
        gil=has_gil(),
        zeromq=zmq.zmq_version(),
        pyzmq=zmq.__version__,
        curve=bool(zmq.has("curve")),
        ipc=bool(zmq.has("ipc")),
        compiled=has_compiled_tick(),
    )


def has_compiled_tick() -> bool:
    """Whether the modules of a tick are extensions (docs/decisions/0032-a-compiled-tick.md)."""
    return not str(tick.__file__).endswith(".py")


def preemption(version: str) -> str:
    """The preemption model that a kernel's version line names."""
    words = version.split()
    found = next((word for word in ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT") if word in words), None)
    return found or "voluntary or none"


def virtual(root: Path) -> str | None:
    """The kind of virtual machine; None where no sign of one is found.

    A flag of the processor shows that there is a hypervisor. The firmware's tables, if there are any, name its product.
    """
    kind = _text(root / "sys/hypervisor/type")
    flags = next((line for line in (_text(root / "proc/cpuinfo") or "").splitlines() if line.startswith("flags")), "")
    if kind is None and "hypervisor" not in flags.split():
        return None
    product = _text(root / "sys/class/dmi/id/product_name")
    return product or kind or "a hypervisor"


def governors(root: Path, usable: tuple[int, ...]) -> tuple[str, ...] | None:
    """The different frequency governors of the usable processors; None where none can be read."""
    paths = (root / f"sys/devices/system/cpu/cpu{n}/cpufreq/scaling_governor" for n in usable)
    found = {text for path in paths if (text := _text(path)) is not None}
    return tuple(sorted(found)) or None


def realtime_share(root: Path) -> float | None:
    """The greatest part of a processor's time for real-time threads; None where it is unbounded or unknown."""
    runtime, period = (_text(root / f"proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period"))
    if runtime is None or period is None or int(runtime) < 0:
        return None
    return int(runtime) / int(period)


def has_gil() -> bool:
    """Whether this interpreter runs with its global lock; even a free-threaded build may."""
    if not sysconfig.get_config_var("Py_GIL_DISABLED"):
        return True
    return bool(getattr(sys, "_is_gil_enabled", lambda: True)())


def _text(path: Path) -> str | None:
    """The text of a file of the kernel; None where it is absent, not readable, or empty."""
    try:
        return path.read_text(errors="replace").strip() or None
    except OSError:
        return None
