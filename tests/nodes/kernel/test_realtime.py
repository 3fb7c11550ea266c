"""Requests to the kernel: granted where allowed, refused in one sentence elsewhere, and given back."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.realtime import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    FEW_LINKS,
    FIFO_PRIORITY,
    NETWORK_NICE,
    Linux,
    RealtimeWishes,
    Scheduling,
    may_raise,
    memory_needed,
    prepare,
    restore,
)
from manyhands.protocol.clock import Duration

MIB = 2**20
ORDINARY = Scheduling(os.SCHED_OTHER, 0, 2**64 - 1)


class Answers:
    """A system of given limits, which keeps what was done to it."""

    def __init__(
        self,
        capabilities: set[int] | None = None,
        memory_limit: int | None = None,
        priority_limit: int = 0,
        processors: set[int] | None = None,
        refuses: int = 0,
    ) -> None:
        self.capabilities, self.limit, self.priority = capabilities or set(), memory_limit, priority_limit
        self.usable = processors or {3}
        self.refuses = refuses
        self.locked = False
        self.now = ORDINARY
        self.keeps_reset = self.unfavoured = False
        self.nice = 0

    def capable(self, capability: int) -> bool:
        return capability in self.capabilities

    def memory_limit(self) -> int | None:
        return self.limit

    def mapped(self) -> int:
        return 300 * MIB

    def lock_memory(self) -> None:
        if self.refuses:
            raise OSError(self.refuses, os.strerror(self.refuses))
        self.locked = True

    def unlock_memory(self) -> None:
        self.locked = False

    def priority_limit(self) -> int:
        return self.priority

    def scheduling(self) -> Scheduling:
        return self.now

    def schedule(self, wanted: Scheduling) -> int:
        if self.refuses and wanted.priority > 0:
            self.now = Scheduling(self.now.policy, self.now.priority, wanted.runaway)  # the limit was first
            raise OSError(self.refuses, os.strerror(self.refuses))
        if self.keeps_reset and not wanted.policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        self.now = wanted
        return 1

    def favour_network(self, nice: int) -> int:
        if self.unfavoured:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        self.nice = nice
        return 1

    def processors(self) -> set[int]:
        return self.usable

    def timer_slack(self) -> int | None:
        return 50_000


@pytest.mark.parametrize(
    ("limit", "capabilities", "locked"),
    [
        (None, set(), True),
        (8 * MIB, set(), False),
        (8 * MIB, {CAP_IPC_LOCK}, True),
        (363 * MIB, set(), False),  # enough for what is mapped, and not for what comes
        (364 * MIB, set(), True),
    ],
)
def test_memory_is_locked_only_where_the_limit_leaves_room(
    limit: int | None, capabilities: set[int], locked: bool
) -> None:
    system = Answers(capabilities, memory_limit=limit)
    granted = prepare(RealtimeWishes(priority=0), system).memory_locked
    assert granted.granted is system.locked is locked
    if not locked:
        assert f"expected at least {memory_needed(RealtimeWishes(), system) // MIB} MiB" in granted.answer


@given(st.integers(0, 99), st.integers(0, 99), st.booleans(), st.sets(st.integers(0, 7), min_size=1))
def test_priority_is_within_wish_and_limit_and_for_pinned_processes(
    wish: int, limit: int, capable: bool, processors: set[int]
) -> None:
    system = Answers({CAP_SYS_NICE} if capable else set(), priority_limit=limit, processors=processors)
    granted = prepare(RealtimeWishes(memory=False, priority=wish, runaway=Duration(7_000_000)), system)
    assert granted.fifo.granted is (wish > 0 and len(processors) == 1 and (capable or limit > 0))
    assert may_raise(system) is (capable or limit > 0)
    if granted.fifo.granted:
        assert system.now.policy == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        assert system.now.priority == (wish if capable else min(wish, limit))
        assert system.now.below == (system.now.priority > 1)
        assert system.now.runaway == 7_000  # us
    else:
        assert system.now == ORDINARY
        assert granted.before is None
    restore(granted, system)
    assert system.now == ORDINARY


@pytest.mark.parametrize(("links", "zeromq"), [(1, 10), (FEW_LINKS, 10), (FEW_LINKS + 1, 9), (32, 9)])
def test_zeromqs_thread_comes_down_to_a_loop_with_many_links(links: int, zeromq: int) -> None:
    system = Answers({CAP_SYS_NICE})
    assert prepare(RealtimeWishes(memory=False, links=links), system).fifo.granted
    assert system.now.priority == zeromq
    assert system.now.priority - system.now.below == 9  # the loop's


def test_refusals_of_the_kernel_are_reported_and_undone() -> None:
    system = Answers({CAP_SYS_NICE, CAP_IPC_LOCK}, refuses=errno.EPERM)
    granted = prepare(RealtimeWishes(), system)
    assert not granted.memory_locked.granted
    assert "mlockall: Operation not permitted" in granted.memory_locked.answer
    assert not granted.fifo.granted
    assert "Operation not permitted" in granted.fifo.answer
    assert system.now == ORDINARY  # its limit, too
    assert granted.table() == {
        "memory_locked": 0.0,
        "fifo": 0.0,
        "timer_slack": 0.0,
        "pinned": 1.0,
    }


def test_who_may_not_have_children_inherit_again_goes_back_without() -> None:
    system = Answers(priority_limit=50)
    granted = prepare(RealtimeWishes(), system)
    assert granted.fifo.granted
    system.keeps_reset = True
    restore(granted, system)
    assert system.now == Scheduling(os.SCHED_RESET_ON_FORK, 0, ORDINARY.runaway)


def test_the_thread_for_tcp_is_favoured_and_never_raised() -> None:
    system = Answers(priority_limit=99)
    granted = prepare(RealtimeWishes(), system)
    assert (system.nice, granted.fifo.granted) == (NETWORK_NICE, True)
    assert granted.fifo.answer.endswith("; nice -10 for the thread of TCP")
    restore(granted, system)
    assert system.nice == 0


def test_a_machine_that_refuses_the_nice_value_grants_the_rest() -> None:
    system = Answers(priority_limit=99)
    system.unfavoured = True
    granted = prepare(RealtimeWishes(), system)
    assert granted.fifo.granted
    assert granted.fifo.answer.endswith("; nice 0 for the thread of TCP (Operation not permitted)")
    restore(granted, system)
    assert system.now == ORDINARY


def test_every_grant_and_every_refused_wish_is_reported() -> None:
    granted = prepare(RealtimeWishes(memory=False, priority=0), Answers())
    assert all(grant.answer for grant in granted.grants().values())
    assert granted.fifo.answer == granted.memory_locked.answer == "not asked for"


# --- the kernel itself, in processes of their own


def run(code: str, pin: bool = True) -> subprocess.CompletedProcess[str]:
    start = "import os\n" + (f"os.sched_setaffinity(0, {{{min(os.sched_getaffinity(0))}}})\n" if pin else "")
    return subprocess.run(
        [sys.executable, "-P", "-c", start + code], capture_output=True, text=True, check=False, timeout=60
    )


permitted = pytest.mark.skipif(not may_raise(), reason="real-time priorities are not permitted here")

PREPARED = """
import threading, zmq
from pathlib import Path
from manyhands.nodes.kernel.realtime import Linux
from manyhands.nodes.kernel.realtime import RealtimeWishes, prepare, restore
from manyhands.protocol.clock import Duration
def policies():
    # by name of the thread
    threads = Path("/proc/self/task").iterdir()
    return {(t / "comm").read_text().strip(): os.sched_getscheduler(int(t.name)) for t in threads}
locked = lambda: int(next(l for l in open("/proc/self/status") if l.startswith("VmLck")).split()[1])
before = Linux().scheduling()
"""


@permitted
def test_the_loops_thread_and_zeromqs_are_raised_and_come_back() -> None:
    done = run(
        PREPARED
        + """
context = zmq.Context()
one, other = context.socket(zmq.PAIR), context.socket(zmq.PAIR)
one.bind("tcp://127.0.0.1:*")
other.connect(one.getsockopt_string(zmq.LAST_ENDPOINT))
other.send(b"")
one.recv()  # so ZeroMQ's thread works
halt = threading.Event()
stranger = threading.Thread(target=halt.wait, daemon=True)
stranger.start()
granted = prepare(RealtimeWishes())
assert granted.fifo.granted, granted
raised = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
assert os.sched_getscheduler(0) == policies()["ZMQbg/IO/0"] == raised, policies()
priority = lambda thread: os.sched_getparam(thread).sched_priority
(sender,) = (int(t.name) for t in Path("/proc/self/task").iterdir() if (t / "comm").read_text() == "ZMQbg/IO/0\\n")
assert priority(sender) == priority(0) + 1  # a frame leaves when it is sent
assert os.sched_getscheduler(stranger.native_id) == os.SCHED_OTHER
child = os.fork()
if child == 0:
    os._exit(os.sched_getscheduler(0))
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == os.SCHED_OTHER
restore(granted)
assert set(policies().values()) == {os.SCHED_OTHER}
assert Linux().scheduling() == before
assert locked() == 0
halt.set()
stranger.join()
context.destroy(linger=0)
"""
    )
    assert done.returncode == 0, done.stderr


@permitted
def test_a_thread_is_pinned_and_raised_for_a_while() -> None:
    done = run(
        PREPARED
        + """
from manyhands.nodes.kernel.realtime import realtime_thread
processors = os.sched_getaffinity(0)
for _ in range(2):
    try:
        with realtime_thread() as fifo:
            assert fifo.granted, fifo
            assert os.sched_getscheduler(0) == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            assert len(os.sched_getaffinity(0)) == 1
            raise InterruptedError
    except InterruptedError:
        pass
    assert Linux().scheduling() == before
    assert os.sched_getaffinity(0) == processors
assert locked() == 0
"""
    )
    assert done.returncode == 0, done.stderr


@permitted
def test_a_stranger_over_tcp_reaches_no_thread_with_a_priority(tmp_path: Path) -> None:
    """Of a transport with both: the thread of ipc is raised, and that of TCP only favoured, whatever it has to do."""
    done = run(
        PREPARED
        + f"""
from manyhands.protocol.transport.zeromq import ZmqTransport
transport = ZmqTransport.tcp(directory=Path({str(tmp_path)!r}))
for address in ("", "127.0.0.1:*"):
    one, endpoint = transport.bind(f"link{{len(address)}}", "peer", address)
    assert endpoint.startswith("tcp" if address else "ipc"), endpoint
    other = transport.connect(endpoint, "peer")
    assert other.send(b"") and one.recv(None) == b""
times = lambda: {{(t / "comm").read_text().strip(): int((t / "schedstat").read_text().split()[2])
                 for t in Path("/proc/self/task").iterdir()}}
def woken():  # by frames of the link over TCP, the last of the two
    before = times()
    for _ in range(50):
        one.send(b"")
        other.recv(None)
    return {{name for name, count in times().items() if name.startswith("ZMQbg/IO") and count > before[name] + 25}}
granted = prepare(RealtimeWishes(memory=False))
assert granted.fifo.granted, granted
found = policies()
assert found["ZMQbg/IO/0"] == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, found
assert found["ZMQbg/IO/1"] == os.SCHED_OTHER, found
tcp = next(int(t.name) for t in Path("/proc/self/task").iterdir() if (t / "comm").read_text() == "ZMQbg/IO/1\\n")
assert os.getpriority(os.PRIO_PROCESS, tcp) < 0
assert woken() == {{"ZMQbg/IO/1"}}, times()
restore(granted)
assert os.getpriority(os.PRIO_PROCESS, tcp) == 0
transport.close()
"""
    )
    assert done.returncode == 0, done.stderr


@permitted
def test_a_guest_pins_itself_to_a_processor_that_its_name_chooses() -> None:
    several = sorted(os.sched_getaffinity(0))
    code = (
        "import os\nfrom manyhands.nodes.kernel.realtime import pin_guest\n"
        "pin_guest({!r})\nprint(*os.sched_getaffinity(0))"
    )
    found = {int(run(code.format(f"d{i}"), pin=False).stdout) for i in range(8)}  # ValueError: several, or none
    assert found == set(several) if len(several) <= 2 else found <= set(several)


@permitted
def test_threads_that_are_still_starting_are_left_alone() -> None:
    """ZeroMQ's would abort the process if they were changed just then."""
    done = run(
        PREPARED
        + """
for _ in range(300):
    context = zmq.Context()
    context.socket(zmq.PAIR)
    granted = prepare(RealtimeWishes(memory=False))
    assert granted.fifo.granted, granted
    restore(granted)
    context.destroy(linger=0)
"""
    )
    assert done.returncode == 0, done.stderr


@permitted
def test_a_loop_gone_wild_is_ended() -> None:
    done = run(PREPARED + "prepare(RealtimeWishes(memory=False, runaway=Duration(50_000_000)))\nwhile True: pass")
    assert done.returncode == -signal.SIGXCPU, done.stderr


def test_pages_in_use_are_locked_where_that_is_permitted() -> None:
    done = run(
        PREPARED
        + "granted = prepare(RealtimeWishes(priority=0)).memory_locked.granted\nprint(granted == (locked() > 0))"
    )
    assert done.stdout.strip() == "True", done.stderr


def test_too_small_a_limit_leaves_the_process_able_to_allocate() -> None:
    """As an ordinary user; locking with what is to come would have the next allocations fail."""
    code = """
import resource
from manyhands.nodes.kernel.realtime import RealtimeWishes, prepare
resource.setrlimit(resource.RLIMIT_MEMLOCK, (8 << 20, 8 << 20))
if os.getuid() == 0:
    os.setuid(65534)
granted = prepare(RealtimeWishes())
assert not granted.memory_locked.granted and "RLIMIT_MEMLOCK 8 MiB" in granted.memory_locked.answer, granted
bytearray(256 << 20)
"""
    done = run(code)
    assert done.returncode == 0, done.stderr


def test_a_process_that_is_not_pinned_keeps_its_scheduling() -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one processor")
    done = run(PREPARED + "print(prepare(RealtimeWishes()).fifo.granted, Linux().scheduling() == before)", pin=False)
    assert done.stdout.split() == ["False", "True"], done.stderr


def test_linux_answers() -> None:
    system = Linux()
    assert system.mapped() > MIB
    assert system.processors() == os.sched_getaffinity(0)
    assert 0 <= system.priority_limit() <= 99
    assert system.timer_slack() is not None
    assert FIFO_PRIORITY < 50
