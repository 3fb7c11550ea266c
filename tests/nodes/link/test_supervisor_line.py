"""A node's line to the supervisor, message by message; the test holds the other end."""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping

import pytest

from manyhands.nodes.kernel.bundle import Common, Peer
from manyhands.nodes.kernel.lifetime import Life as RealLife
from manyhands.nodes.kernel.lifetime import Sight, Stopped
from manyhands.nodes.link import supervisor_line as control_module
from manyhands.nodes.link.process import EXIT_FAILED, HostedNode, run_members
from manyhands.nodes.link.supervisor_line import ControlLine, Refused, TelemetryLost
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_TEXT
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Connect,
    Echo,
    Fault,
    Figures,
    Message,
    NodeHello,
    Offer,
    Probe,
    Ready,
    Refusal,
    RefusalCode,
    Report,
    Return,
    Role,
    Shift,
    Start,
    Stop,
    Telemetry,
    Welcome,
)
from manyhands.protocol.transport import Link, TransportError, Trouble
from tests.support.memory_transport import MemoryTransport

REPORT = Report(5, Figures())
SECOND = 1_000_000_000


def common(clock: str = "realtime", control: str = "memory://control") -> Common:
    return Common(
        session="s", name="dx", role=Role.DEVICE, certificate="c", period=0.001, clock=clock, transport="tcp",
        public={}, private="", directory="", control=control, ports=("dx",), peers=(), telemetry_ticks=100,
        telemetry_first=100,
    )  # fmt: skip


class AnsweringLine:
    """A link whose other end gives scripted answers; None lets time pass for a reader, at once."""

    def __init__(self) -> None:
        self.said: list[Message] = []
        self.coming: deque[bytes | None] = deque()
        self.answer: Callable[[Message], list[Message]] = lambda _: []
        self.room = 10**9
        self.state: Trouble | None = None
        self.waits = 0

    def send(self, frame: bytes) -> bool:
        if self.room == 0:
            return False
        self.room -= 1
        message = decode(frame, MAX_CONTROL_BYTES)
        self.said.append(message)  # type: ignore[arg-type]
        self.say(*self.answer(message))  # type: ignore[arg-type]
        return True

    def say(self, *messages: Message) -> None:
        self.coming.extend(map(encode, messages))

    def recv(self, timeout: Duration | None) -> bytes | None:
        if self.coming:
            return self.coming.popleft()
        assert timeout is not None
        self.waits += timeout > 0
        assert self.waits < 10_000, "it waits for ever"
        return None

    def trouble(self) -> Trouble | None:
        return self.state

    def close(self) -> None:
        pass


class Doors:
    """A transport that makes one line, and notes how often its doors were attended to."""

    def __init__(self, line: AnsweringLine) -> None:
        self.line, self.attended = line, 0
        self.strangers: dict[str, int] = {}

    def join(self, endpoint: str, identity: str) -> AnsweringLine:
        assert (endpoint, identity) == ("memory://control", "dx")
        return self.line

    def attend(self) -> None:
        self.attended += 1

    def refused(self) -> Mapping[str, int]:
        return self.strangers


class Life:
    """A life that goes on for so many calls of ``check``, or as long as its watch allows."""

    def __init__(self, looks: int = 10**9, orphaned: bool = False) -> None:
        self.stopping = self.orphaned = False
        self._looks, self._orphaned = looks, orphaned

    def check(self) -> None:
        self._looks -= 1
        if self._looks <= 0:
            self.stopping, self.orphaned = True, self._orphaned


@pytest.fixture
def line() -> AnsweringLine:
    return AnsweringLine()


def test_a_start_may_be_a_minute_ahead_and_no_more() -> None:
    """A start in a hundred years was accepted, and the guest then waited for it without a word."""
    now = Instant(7 * SECOND)
    for epoch in (0, now, now + 60 * SECOND):
        ControlLine.require_near(Start(epoch, 5), now)
    with pytest.raises(Refused, match=r"found a start in 60 s; expected at most 60 s"):
        ControlLine.require_near(Start(now + 60 * SECOND + 1, 5), now)
    with pytest.raises(Refused, match="expected at most 60 s"):
        ControlLine.require_near(Start(2**62, 5), now)


def control(line: AnsweringLine, **changes: object) -> ControlLine:
    return ControlLine(Doors(line), common(**changes))  # type: ignore[arg-type]


def test_a_conversation_from_hello_to_the_last_word() -> None:
    """Over the transport in memory, with the hub in the same hand."""
    transport = MemoryTransport()
    hub, endpoint = transport.bind_hub("control", ["dx"])

    def heard() -> Message:
        received = hub.recv()
        assert received is not None
        sender, frame = received
        assert sender == "dx"
        return decode(frame, MAX_CONTROL_BYTES)  # type: ignore[return-value]

    def say(*messages: Message) -> None:
        for message in messages:
            assert hub.send("dx", encode(message))

    one, life = ControlLine(transport, common(control=endpoint)), Life()
    one.hello({"cx": "ipc:///s/dx-cx"}, 4321)
    assert heard() == NodeHello(PROTOCOL_VERSION, "c", "s", "dx", Role.DEVICE, 4321, {"cx": "ipc:///s/dx-cx"})
    say(Welcome(), Connect({"cx": "ipc:///s/cx-dx"}))
    assert one.peers_endpoints(life) == {"cx": "ipc:///s/cx-dx"}  # type: ignore[arg-type]
    one.ready(("holds itself up",))
    assert heard() == Ready(("holds itself up",))
    for far in (Start(2**63 - 1, 5), Start(0, 5, 2**63 - 1), Start(0, 2**63 - 1)):  # it ended in a traceback
        say(far)
        with pytest.raises(Refused, match="expected at most"):
            one.start(life)  # type: ignore[arg-type]
    say(Start(10**9, 5))
    assert one.start(life) == Start(10**9, 5)  # type: ignore[arg-type]
    one.publish(Telemetry(3, Figures({"speed": 0.5}), {}))
    assert heard() == Telemetry(3, Figures({"speed": 0.5}), {})
    say(Stop("reported"))
    one.report(REPORT, life)  # type: ignore[arg-type]
    assert heard() == REPORT
    assert (one.dropped, one.malformed) == (0, 0)
    assert one.connection() is Sight.PRESENT
    transport.close()


def test_a_refusal_is_passed_on_as_it_came(line: AnsweringLine) -> None:
    line.say(Refusal(RefusalCode.NAME, "supervisor refused dx: because"))
    with pytest.raises(Refused, match=r"^supervisor refused dx: because$"):
        control(line).peers_endpoints(Life())  # type: ignore[arg-type]


def test_a_stop_ends_it(line: AnsweringLine) -> None:
    line.say(Welcome(), Stop("the session ends"))
    with pytest.raises(Stopped):
        control(line).peers_endpoints(Life())  # type: ignore[arg-type]


def test_what_makes_no_sense_is_counted_and_waited_past(line: AnsweringLine) -> None:
    line.coming.extend([b"", b"\xc1", bytes(100)])
    line.say(Ready(), Telemetry(1, Figures(), {}), Start(0, 1), Welcome(), Welcome(), Connect({"cx": "e"}))
    one = control(line)
    assert one.peers_endpoints(Life()) == {"cx": "e"}  # type: ignore[arg-type]
    assert one.malformed == 7


def test_a_life_that_ends_is_noticed_while_it_waits(line: AnsweringLine) -> None:
    with pytest.raises(Stopped):
        control(line).start(Life(looks=3))  # type: ignore[arg-type]
    assert line.waits == 3


@pytest.mark.parametrize("trouble", [Trouble.NOT_ADMITTED, Trouble.NOT_PROVED])
def test_a_refusing_supervisor_is_given_up_at_once(line: AnsweringLine, trouble: Trouble) -> None:
    line.state = trouble
    with pytest.raises(Refused) as error:
        control(line).peers_endpoints(Life())  # type: ignore[arg-type]
    assert str(error.value) == (
        f"dx: cannot join the supervisor at memory://control: {trouble}; see that the session runs there, and that "
        "what you were given, bundle and key or invitation, is of its present keys"
    )
    assert line.waits == 1


@pytest.mark.parametrize("trouble", [Trouble.NOBODY, Trouble.BROKEN_OFF])
def test_an_absent_or_busy_supervisor_is_given_a_minute(line: AnsweringLine, trouble: Trouble) -> None:
    line.state = trouble
    with pytest.raises(Refused, match=str(trouble)):
        control(line).peers_endpoints(Life())  # type: ignore[arg-type]
    assert line.waits * control_module.PATIENCE == 60 * SECOND
    line.waits = 0
    line.state = None
    with pytest.raises(Stopped):  # one that is there, and takes its time, is waited for
        control(line).peers_endpoints(Life(looks=2 * control_module._JOINING_WAITS))  # type: ignore[arg-type]


class Test_telemetry:
    def test_what_nobody_takes_is_dropped_and_counted(self, line: AnsweringLine) -> None:
        line.room = 2
        one = control(line, clock="realtime")
        for tick in range(5):
            one.publish(Telemetry(tick, Figures(), {}))
        assert one.dropped == 3
        assert line.said == [Telemetry(0, Figures(), {}), Telemetry(1, Figures(), {})]

    def test_a_recording_in_simulated_time_is_whole_or_an_error(self, line: AnsweringLine) -> None:
        line.room = 1
        one = control(line, clock="simulated")
        one.publish(Telemetry(1, Figures(), {}))
        with pytest.raises(TelemetryLost, match="record less"):
            one.publish(Telemetry(2, Figures(), {}))

    def test_whoever_knocks_is_attended_to(self, line: AnsweringLine) -> None:
        doors = Doors(line)
        one = ControlLine(doors, common())  # type: ignore[arg-type]
        for tick in range(3):
            one.publish(Telemetry(tick, Figures(), {}))
        assert doors.attended == 3
        assert line.said[-1] == Telemetry(2, Figures(), {})
        doors.strangers = {"no_key": 3, "shut": 1}
        assert one.refused() == doors.strangers
        one.publish(Telemetry(3, Figures({"late": 1.0}), {}))
        one.publish(Telemetry(4, Figures({"not_admitted": 2.0}), {}))
        assert line.said[-2:] == [
            Telemetry(3, Figures({"late": 1.0, "not_admitted": 4.0}), {}),
            Telemetry(4, Figures({"not_admitted": 6.0}), {}),
        ]


class Clock:
    """Time that passes only with each look at it."""

    def __init__(self, steps: Iterator[int]) -> None:
        self._now, self._steps = 0, steps

    def now(self) -> Instant:
        self._now += next(self._steps)
        return Instant(self._now)

    def sleep_until(self, t: Instant) -> None:
        raise AssertionError("nothing sleeps here")


def test_the_clocks_offset_is_that_of_the_shortest_round_trip(line: AnsweringLine) -> None:
    """One way is 25 ns both ways; all others have 75 ns more on the way back, which would make 37 of error."""
    ahead, quick = 5 * SECOND, 7
    ways = [50 if k == quick else 125 for k in range(32)]
    clock = Clock(step for way in ways for step in (1000, way))
    line.answer = lambda probe: [Echo(probe.sent, probe.sent + ahead + 25, probe.sent + ahead + 25)]  # type: ignore[union-attr]
    assert control(line).clock_offset(clock, Life()) == ahead  # type: ignore[arg-type]
    assert len(line.said) == 32


def test_an_echo_of_another_question_is_ignored_without_delay(line: AnsweringLine) -> None:
    stray = Echo(0, 10**12, 10**12)
    line.answer = lambda probe: [stray, Echo(probe.sent, probe.sent, probe.sent)]  # type: ignore[union-attr]
    one = control(line)
    assert one.clock_offset(Clock(iter([10] * 64)), Life()) == -5  # type: ignore[arg-type]
    assert one.malformed == 32
    assert len(line.said) == 32


class Test_a_guest_in_its_loop:
    def test_a_stop_is_heard_behind_other_words(self, line: AnsweringLine) -> None:
        one = control(line)
        line.say(Echo(0, 0, 0))
        line.coming.append(b"\xc1")
        line.say(Stop("the session ends"))
        assert [one.sight(Instant(0)) for _ in range(2)] == [Sight.ENDING, Sight.ENDING]
        assert line.waits == 0

    @pytest.mark.parametrize("trouble", [None, *Trouble])
    def test_only_a_loss_is_an_end(self, line: AnsweringLine, trouble: Trouble | None) -> None:
        one = control(line)
        line.state = trouble
        expected = Sight.GONE if trouble is Trouble.LOST else Sight.PRESENT
        assert one.sight(Instant(0)) is expected
        assert one.connection() is expected

    def test_it_sends_a_sign_of_life_every_second(self, line: AnsweringLine) -> None:
        one = control(line)
        for tenth in range(31):
            one.sight(Instant(SECOND + tenth * SECOND // 10))
        assert line.said == [Probe(k * SECOND) for k in (1, 2, 3, 4)]

    def test_it_keeps_the_latest_answer(self, line: AnsweringLine) -> None:
        one = control(line)
        one.sight(Instant(0))
        assert one.echo is None
        line.say(Echo(0, 1, 1, None), Echo(SECOND, 1, 1, 0.04))
        one.sight(Instant(SECOND))
        assert one.echo == Echo(SECOND, 1, 1, 0.04)
        assert one.malformed == 0


class Test_a_guest_that_waits_to_be_let_in:
    def test_it_shows_that_it_lives_once_it_is_welcome(self, line: AnsweringLine) -> None:
        one = control(line)
        assert one.joining(Instant(SECOND)) is Sight.PRESENT
        assert line.said == []  # the supervisor would take it for a stranger
        line.say(Welcome(), Connect({}))
        one.peers_endpoints(Life())  # type: ignore[arg-type]
        for tenth in range(21):
            one.joining(Instant(SECOND + tenth * SECOND // 10))
        assert line.said == [Probe(k * SECOND) for k in (1, 2, 3)]
        line.say(Echo(3 * SECOND, 0, 0), Start(10**9, 5))
        assert one.start(Life()) == Start(10**9, 5)  # type: ignore[arg-type]
        assert one.malformed == 0

    def test_a_line_that_is_lost_is_an_end(self, line: AnsweringLine) -> None:
        one = control(line)
        line.state = Trouble.LOST
        assert one.joining(Instant(0)) is Sight.GONE


class OfTwoNodes:
    """A node of a process of two, which has no peers."""

    by_itself = ()

    def establish(self, links: Mapping[str, Link]) -> None:
        assert not links


def test_a_guest_whose_second_line_is_lost_ends_before_its_loop(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first node has all it needs; the second waits for a Start that cannot come any more."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # the process is not the guest's
    lines = AnsweringLine(), AnsweringLine()
    controls = [control(one) for one in lines]
    clock = iter(range(0, 10**12, 1000))

    def answer(message: Message) -> list[Message]:
        now = next(clock)
        match message:
            case NodeHello():
                return [Welcome(), Connect({})]
            case Probe(sent):
                return [Echo(sent, now, now)]
            case Ready():
                return [Start(10**9, 5)]
        return []

    def until_ready(message: Message) -> list[Message]:
        if isinstance(message, Ready):
            lines[1].state = Trouble.LOST
            return []
        return answer(message)

    lines[0].answer, lines[1].answer = answer, until_ready
    members = [HostedNode(common(), OfTwoNodes(), Doors(one), own) for one, own in zip(lines, controls, strict=True)]  # type: ignore[arg-type]
    life = RealLife(None)
    assert run_members(members, life, remote=True) == EXIT_FAILED
    assert life.orphaned
    assert "lost the supervisor" in capsys.readouterr().err


class Test_the_last_word:
    def test_it_stays_until_it_was_heard(self, line: AnsweringLine) -> None:
        line.say(Echo(0, 0, 0), Start(0, 0), Stop("reported"))
        control(line).report(REPORT, Life())  # type: ignore[arg-type]
        assert line.said == [REPORT]
        assert (len(line.coming), line.waits) == (0, 0)

    def test_it_waits_for_room_and_is_sent_once(self, line: AnsweringLine) -> None:
        line.room = 0
        life = Life()

        def make_room() -> None:
            line.room = 1
            if line.said:
                line.say(Stop("reported"))

        life.check = make_room  # type: ignore[method-assign]
        control(line).report(REPORT, life)  # type: ignore[arg-type]
        assert line.said == [REPORT]
        assert line.waits == 2

    def test_it_is_repeated_every_second_and_gives_up_in_the_end(self, line: AnsweringLine) -> None:
        control(line).report(REPORT, Life())  # type: ignore[arg-type]
        assert line.waits * control_module.PATIENCE == 10 * SECOND
        assert line.said == [REPORT] * 10

    def test_nobody_there_is_not_waited_for(self, line: AnsweringLine) -> None:
        control(line).report(REPORT, Life(looks=1, orphaned=True))  # type: ignore[arg-type]
        assert line.waits == 1

    def test_a_broken_connection_has_a_second_to_come_again(self, line: AnsweringLine) -> None:
        line.state = Trouble.LOST
        control(line).fault("dx: broken", Life())  # type: ignore[arg-type]
        assert line.waits * control_module.PATIENCE == SECOND
        life = Life()

        def come_again() -> None:
            if line.waits == 2 * control_module.REPEAT_WAITS - 1:
                line.state = None
            if line.waits == 3 * control_module.REPEAT_WAITS:
                line.say(Stop("received"))

        life.check = come_again  # type: ignore[method-assign]
        control(line).fault("dx: broken", life)  # type: ignore[arg-type]
        assert line.waits == 3 * control_module.REPEAT_WAITS
        assert line.said == [Fault("dx: broken")] * 4

    def test_a_fault_presents_any_text_safely(self, line: AnsweringLine) -> None:
        control(line).fault("\x1b[2J" + "x" * 10_000, Life(looks=1, orphaned=True))  # type: ignore[arg-type]
        (fault,) = line.said
        assert isinstance(fault, Fault)
        assert len(fault.text) == MAX_TEXT
        assert "\x1b" not in fault.text


class Test_what_is_said_to_a_node_in_its_loop:
    def test_words_are_heard_in_their_order_and_only_they(self, line: AnsweringLine) -> None:
        one = control(line)
        words = [Absent("cx"), Return("cx", "ipc:///s/cx"), Shift("cx", 2), Absent("cx")]
        line.say(words[0], Echo(0, 0, 0), words[1], Ready(), *words[2:])
        line.coming.insert(2, b"\xc1")
        assert [one.listen() for _ in range(6)] == [*words, None, None]
        assert one.malformed == 2
        assert line.waits == 0

    def test_it_may_wait_for_one(self, line: AnsweringLine) -> None:
        one = control(line)
        assert one.listen(Duration(5)) is None
        assert line.waits == 1
        line.say(Absent("cx"))
        assert one.listen(Duration(5)) == Absent("cx")
        assert line.waits == 1

    def test_words_wait_while_only_its_end_is_looked_for(self, line: AnsweringLine) -> None:
        one = control(line)
        line.say(Absent("cx"), Stop("the session ends"))
        assert one.sight(Instant(0)) is Sight.ENDING
        assert one.listen() == Absent("cx")

    def test_words_nobody_obeys_take_a_bounded_room(self, line: AnsweringLine) -> None:
        one = control(line)
        line.say(*(Shift("cx", k % 8) for k in range(1000)))
        for _ in range(1000):
            one.sight(Instant(0))
        assert len(one._words) == control_module._WORDS_KEPT
        kept = [one.listen() for _ in range(control_module._WORDS_KEPT)]
        assert kept[-1] == Shift("cx", 999 % 8)  # the latest
        assert one.listen() is None

    def test_absent_peers_are_reported_before_connect(self, line: AnsweringLine) -> None:
        line.say(Welcome(), Absent("cx"), Absent("cy"), Connect({}))
        one = control(line)
        assert one.peers_endpoints(Life()) == {}  # type: ignore[arg-type]
        assert one.absent == {"cx", "cy"}
        assert [one.listen(), one.listen(), one.listen()] == [Absent("cx"), Absent("cy"), None]  # and offered a place
        assert one.malformed == 0


class PartlyTakenTransport:
    """A transport of whose addresses some are taken."""

    def __init__(self, line: AnsweringLine, taken: frozenset[str]) -> None:
        self._line, self._taken = line, taken
        self.bound: list[tuple[str, str, str]] = []

    def join(self, _endpoint: str, _identity: str) -> AnsweringLine:
        return self._line

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        if address in self._taken:
            raise TransportError(f"{address} is taken")
        self.bound.append((name, peer, address))
        return self._line, f"tcp://{address}"  # type: ignore[return-value]


class Test_a_place_for_a_peer_that_was_lost:
    def bound_with(
        self, line: AnsweringLine, *taken: str, address: str = "10.0.0.1:7401", times: int = 1
    ) -> PartlyTakenTransport:
        doors = PartlyTakenTransport(line, frozenset(taken))
        one = ControlLine(doors, common())  # type: ignore[arg-type]
        peer = Peer("cx", Role.COUPLING, ("dx",), binds=True, address=address)
        for _ in range(times):
            one.bind_anew(peer)
        return doors

    def test_it_has_another_name_each_time_and_the_same_address(self, line: AnsweringLine) -> None:
        doors = self.bound_with(line, times=2)
        assert doors.bound == [("dx-cx.1", "cx", "10.0.0.1:7401"), ("dx-cx.2", "cx", "10.0.0.1:7401")]

    def test_where_its_port_is_taken_any_of_that_address_will_do(self, line: AnsweringLine) -> None:
        doors = self.bound_with(line, "10.0.0.1:7401", times=2)
        assert doors.bound == [("dx-cx.1.any", "cx", "10.0.0.1:*"), ("dx-cx.2.any", "cx", "10.0.0.1:*")]

    @pytest.mark.parametrize("address", ["", "10.0.0.1:7401"])
    def test_an_address_that_cannot_be_bound_is_reported(self, line: AnsweringLine, address: str) -> None:
        with pytest.raises(TransportError):
            self.bound_with(line, address, "10.0.0.1:*", address=address)

    def test_it_is_offered(self, line: AnsweringLine) -> None:
        control(line).offer("cx", "ipc:///s/dx-cx.1")
        assert line.said == [Offer("cx", "ipc:///s/dx-cx.1")]


def test_a_guest_measures_the_way_as_its_loop_would_see_it(line: AnsweringLine) -> None:
    """From when a probe was due to leave, to when a loop that wakes once in a period reads the answer."""
    clock = RealtimeClock()
    line.answer = lambda said: [Echo(said.sent, 0, 0)] if isinstance(said, Probe) else []
    measured = control(line)
    before = clock.now()
    found = measured.round_trips(clock, Life(), 20, from_seconds(1e-3))  # type: ignore[arg-type]
    assert len(found) == 4  # every fifth time
    assert [said.sent - line.said[0].sent for said in line.said] == [0, 5_000_000, 10_000_000, 15_000_000]  # type: ignore[union-attr]
    assert all(0 <= trip <= clock.now() - before for trip in found)


def test_an_answer_to_an_earlier_measurement_is_no_part_of_this_one(line: AnsweringLine) -> None:
    line.answer = lambda said: [Echo(said.sent - 1_700_000_000, 0, 0), Echo(said.sent, 0, 0)]  # type: ignore[union-attr]
    found = control(line).round_trips(RealtimeClock(), Life(), 20, from_seconds(1e-3))  # type: ignore[arg-type]
    assert len(found) == 4


@pytest.mark.parametrize("end", ["stop", "life"])
def test_a_guest_that_measures_ends_when_it_is_asked_to(end: str, line: AnsweringLine) -> None:
    line.answer = lambda _: [Stop("the return failed; join again")] if end == "stop" else []
    measured = control(line)
    with pytest.raises(Stopped):
        measured.round_trips(RealtimeClock(), Life(3), 10**6, from_seconds(1e-4))  # type: ignore[arg-type]
    assert (measured.stop is not None and measured.stop.again) is (end == "stop")


def test_a_guest_seeks_its_peers_where_it_reaches_the_supervisor(line: AnsweringLine) -> None:
    found: list[str] = []

    class Connecting(Doors):
        def connect(self, endpoint: str, _peer: str) -> AnsweringLine:
            found.append(endpoint)
            return self.line

    peer = Peer("environment", Role.ENVIRONMENT, ("x",), False)
    for host in ("", "ball.example.org"):
        own = ControlLine(Connecting(line), common(), host=host)  # type: ignore[arg-type]
        line.coming += [encode(Welcome()), encode(Connect({"environment": "tcp://192.168.1.5:7401"}))]
        found += own.peers_endpoints(Life()).values()  # type: ignore[arg-type]
        own.connect("tcp://192.168.1.5:7402", peer)
    assert found == [
        "tcp://192.168.1.5:7401",
        "tcp://192.168.1.5:7402",
        "tcp://ball.example.org:7401",
        "tcp://ball.example.org:7402",
    ]
