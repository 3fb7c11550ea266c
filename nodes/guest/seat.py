"""A guest at a seat: the device and the coupling of a wave link, in one process on the guest's own machine.

    read the invitation -> fetch its part of the session -> welcome -> measure -> ask -> shake hands -> tick ...
    -> let go by a ramp -> report

**Before it engages** the guest measures how long frames take to the session and back. From that and from b follows what
will be felt (:class:`FeltDistance`), which the user is asked about. Nothing moves before the answer: the coupling takes
part at s = 0 only once its waves come, and its force rises by the clutch's ramp. How long the host's end of the wave
link waits for late waves the guest cannot know before. Once both ends have measured that, the host tells the round trip
in its answers to the guest's signs of life, and the guest says once what is felt (:func:`felt_as_measured`).

**Leaving** is felt by nobody: the environment freezes the coupling, and the device lets its own hand go by a ramp
(:meth:`manyhands.nodes.device.core.Guard.leave`). A guest that loses its session lets go in the same way and joins
again, until its user ends it or the session is no longer there.
"""

from __future__ import annotations

import dataclasses
import math
import select
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Final, TextIO

import numpy as np

from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.guest.invitation import Invitation, InvitationError, read_invitation
from manyhands.nodes.guest.seat_part import SeatPart, decoded_part
from manyhands.nodes.kernel.bundle import (
    BundleError,
    Common,
    CouplingBundle,
    DeviceBundle,
    OrientationPart,
    WaveEnd,
    elsewhere,
    foreign_code,
)
from manyhands.nodes.kernel.factory import FactoryError, require_allowed
from manyhands.nodes.kernel.lifetime import Life, Sight, Stopped
from manyhands.nodes.link.process import EXIT_BAD_INPUT, EXIT_OK, EXIT_REFUSED, Node, run_together
from manyhands.nodes.link.supervisor_line import PATIENCE, REPEAT_WAITS, ControlLine, Refused, require_hub
from manyhands.nodes.wave_link.ends import UserEnd
from manyhands.nodes.wave_link.felt import kilograms, stiffness_and_mass
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, from_seconds, seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.keys import KeyFileError, KeyRing
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Fetch, Piece, presentable
from manyhands.protocol.transport import Link, TransportError, Trouble
from manyhands.protocol.transport.zeromq import ZmqTransport

WARMING: Final = 0.5
"""How long the way to the session is used before it is measured, s: a new connection and a new process begin slowly."""

MEASURING: Final = 1.0
"""How long the way to the session is then measured before the user is asked, s."""

MOST_MEASURED: Final = 3
"""How often it is measured at most, until a measurement is calm."""

CALM: Final = 2.0
"""A measurement is calm if :data:`COVERED` of its round trips took no more than this many times the median."""

COVERED: Final = 0.99
"""The part of the waves that a play-out waits for (nodes/wave_link/play_out.py)."""

TIME_TO_ANSWER: Final = 45.0
"""How long the question waits for its answer, s: the session keeps the seat for a minute."""

SETTLED: Final = 3.0
"""The time after joining at which both ends have measured how late waves come, s: for a third of a second, and for two
windows of a second (nodes/wave_link/ends.py)."""

_GLANCE: Final = 0.1  # s, between two looks at the life while waiting for the user
_LONG_WAITS: Final = 50  # waits for a part before the user is told that nothing comes: ten seconds
_NOBODY_WAITS: Final = 10  # the same where nobody answers at all
TIMEOUT: Final = 60.0
"""For so long a host is waited for that nobody hears at, s: it may be busy starting."""


@dataclasses.dataclass(frozen=True)
class FeltDistance:
    """What a user will feel of the distance: K = 2b/R against a wall, and M = bR/2 in free space.

    Attributes:
        network: the shortest time that a frame took to the session and back, s.
        play_out: what both ends wait so that waves that are late come in time, and half a period of each, s.
        stiffness: K, N/m, of the spring in series with the coupling; in the softest direction.
        mass: M, kg; in the heaviest direction.
        units: of its ports.
    """

    network: float
    play_out: float
    stiffness: float
    mass: float
    units: Units = TRANSLATING

    @property
    def round_trip(self) -> float:
        """R, s."""
        return self.network + self.play_out

    def sentence(self) -> str:
        """What will be felt, in two lines."""
        return (
            f"round trip R of about {_ms(self.round_trip)}: {_ms(self.network)} of network and {_ms(self.play_out)} of "
            "play-out\n"
            f"a wall will feel no stiffer than about K = {self.stiffness:.4g} {self.units('N/m')}, and free space "
            f"will weigh about M = {kilograms(self.mass, self.units)} more"
        )


def _ms(time: float) -> str:
    """A time, s, in ms for a sentence: three digits, and no power of ten."""
    return f"{float(f'{1e3 * time:.3g}'):g} ms"


def felt(coupling: CouplingBundle, trips: Sequence[Duration]) -> FeltDistance:
    """What will be felt with these round trips to the session, ns each, of which there must be one at least.

    The play-out of both ends together waits for :data:`COVERED` of the waves, or for as many ticks as the session
    states. A wave waits for half a period of each end besides. Where an end sends one in several ticks, a wave waits
    for its turn, and a play-out that measures its depth buffers as long (:mod:`manyhands.nodes.wave_link.thinning`).

    Raises:
        ValueError: there is no round trip, or the coupling has no wave link.
    """
    if not trips or coupling.wave is None:
        raise ValueError(f"found {len(trips)} round trips; expected one at least, and a wave link")
    wave, least = coupling.wave, min(trips)
    if wave.depth is None:
        covered = Duration(int(np.quantile(trips, COVERED, method="higher")))
        depth = seconds(Duration(covered - least)) + _turn(wave, coupling.common.period)
    else:
        depth = wave.depth * (coupling.common.period + wave.peer_period)
    network, period = seconds(least), coupling.common.period
    play_out = depth + _turn(wave, period) + 0.5 * (period + wave.peer_period)
    felt_as = stiffness_and_mass(_impedance(wave), network + play_out)
    return FeltDistance(network, play_out, *felt_as, Units.of(coupling.common.kinds))


SMOOTH: Final = 4.0
"""k R/b, up to which a tool that is far away was seen to turn without a buzz (0054-orientation.md, Measured)."""


def turning_sentence(device: DeviceBundle, network: float) -> str | None:
    """What turning a tool so far away feels like; None for a device whose hand feels no torque.

    The proxy that comes back is that of a hand R before. So in free space the spring drags like a damper k R, and
    beyond :data:`SMOOTH` it buzzes. R is that of the network alone: a proxy waits for no play-out.

    Args:
        device: at the seat.
        network: the shortest time that a frame took to the session and back, s.
    """
    own = device.orientation
    if not isinstance(own, OrientationPart):  # no port, or no torque
        return None
    drag, R = own.stiffness * network, _ms(network)
    buzzes = f", and buzzes: {SMOOTH * own.osp / network:.3g} N·m/rad would not" if drag > SMOOTH * own.osp else ""
    return (
        f"turning drags like about {drag:.3g} N·m·s/rad, for what the tool answers is {R} old; its spring of "
        f"{own.stiffness:.3g} N·m/rad is what a wall feels like{buzzes}"
    )


def felt_as_measured(coupling: CouplingBundle, R: float) -> str:
    """What is felt at the round trip R, s, that both ends of a seat's wave link measure, as a sentence.

    Raises:
        ValueError: the coupling has no wave link.
    """
    if coupling.wave is None:
        raise ValueError("found a coupling without a wave link; expected one with it")
    units, (K, M) = Units.of(coupling.common.kinds), stiffness_and_mass(_impedance(coupling.wave), R)
    return (
        f"both ends measure a round trip R of {_ms(R)}: a wall feels no stiffer than K = {K:.4g} {units('N/m')}, and "
        f"free space weighs M = {kilograms(M, units)} more"
    )


def _turn(wave: WaveEnd, period: float) -> float:
    """How long waves wait for their turn, in the mean, at both ends together, s."""
    return 0.5 * ((wave.every - 1.0) * period + (wave.peer_every - 1.0) * wave.peer_period)


def _impedance(wave: WaveEnd) -> tuple[float, float]:
    """The least and the greatest eigenvalue of b, N*s/m."""
    b = np.linalg.eigvalsh(wave.b)
    return float(b[0]), float(b[-1])


def is_calm(trips: Sequence[Duration]) -> bool:
    """Whether these round trips, ns, show the network, and no burst of something that has just begun."""
    return bool(trips and np.quantile(trips, COVERED, method="higher") <= CALM * np.median(trips))


class SeatLife(Life):
    """The life of a guest at a seat: once it ticks, a request to end, or the session's end, makes it let go first.

    A second request ends it at once.

    Attributes:
        joined: called once the handshakes are done, before the first tick.
        seen: called from time to time in the loop, which it must not hold up.
    """

    def __init__(self) -> None:
        """Handle the signals of this process."""
        self.joined: Callable[[], None] = lambda: None
        self.seen: Callable[[], None] = lambda: None
        super().__init__(None)

    def enter_loop(self) -> None:
        """Begin the loop, and report that the guest is in."""
        super().enter_loop()
        self.joined()

    def begin(self) -> None:
        """Begin anew, for another attempt to join.

        Raises:
            Stopped: the user has asked to end meanwhile.
        """
        self._raises = True
        self.failure, self.orphaned, self.watch = None, False, lambda: Sight.PRESENT
        if self.signal is not None:
            raise Stopped
        self.stopping = self.leaving = False

    def check(self) -> None:
        """Check that the session is still there."""
        sight = self.watch()
        if sight is Sight.PRESENT:
            if not self._raises:
                self.seen()
            return
        self.orphaned = sight is Sight.GONE
        if self._raises:
            self.stopping = True
        else:
            self.leaving = True

    def _asked_to_stop(self, signum: int, frame: FrameType | None) -> None:
        if self._raises or self.leaving:
            super()._asked_to_stop(signum, frame)
        self.leaving, self.signal = True, signum


def fetch(link: Link, invitation: Invitation, life: Life, timeout: float = TIMEOUT) -> bytes:
    """What the session sends to the guest of an invitation, piece by piece.

    Args:
        link: to the session's hub, with the key of the invitation.
        invitation: whose it is.
        life: whether the guest should still wait.
        timeout: for so long a host that nobody hears at is waited for, s.

    Raises:
        Stopped: the user has asked to end.
        Refused: the session cannot be reached, or knows the invitation's key no longer.
        BundleError: the pieces do not fit each other.
    """
    content, total, waits = bytearray(), 1, 0
    asking, told = True, False
    clock = RealtimeClock()
    due = clock.now() + from_seconds(timeout)
    while len(content) < total:
        if asking:
            link.send(encode(Fetch(len(content))))
        frame = link.recv(PATIENCE)
        if frame is None:
            life.check()
            if life.stopping:
                raise Stopped
            waits += 1
            waiting = clock.now() < due
            require_hub(link, invitation.seat, f"tcp://{invitation.address}", waiting)
            if not told and (waits >= _LONG_WAITS or (_nobody(link) and waits >= _NOBODY_WAITS)):
                told = True
                _say(_why_waiting(link, invitation, timeout))
            # the hub may still hold an earlier connection, and drops what comes over this one meanwhile
            asking = waits % REPEAT_WAITS == 0
            continue
        match decode(frame, MAX_CONTROL_BYTES):
            case Piece(at, whole, piece) if at == len(content) and (whole == total or not content):
                content += piece
                total, asking = whole, True
            case _:  # the answer to a Fetch that was repeated
                asking = False
    if len(content) > total:
        raise BundleError(f"what {invitation.session!r:.100} has sent: found {len(content)} bytes; expected {total}")
    return bytes(content)


def _nobody(link: Link) -> bool:
    return link.trouble() in (Trouble.NOBODY, Trouble.BROKEN_OFF)


def _why_waiting(link: Link, invitation: Invitation, timeout: float) -> str:
    """Why a guest waits for so long: nobody is there, or somebody else has the seat."""
    if _nobody(link):
        return (
            f"{invitation.session}: nobody answers at {invitation.address}: the session may not run yet, or not any "
            f"more; waiting for {timeout:g} s altogether (--timeout); Ctrl-C ends"
        )
    return (
        f"{invitation.session}: no answer yet: somebody may have taken the seat {invitation.seat} with this "
        "invitation; waiting for it to be free; Ctrl-C ends"
    )


def with_force(device: DeviceBundle, most: float | None) -> DeviceBundle:
    """The bundle of a guest's device, whose limits of force are the lesser of the session's and its user's own.

    The device clips every force to its limits last before the actuator, so this holds whatever the session sends.

    Args:
        device: the bundle, as the session has sent it.
        most: the user's limit, N; None for that of the session.
    """
    if most is None:
        return device
    force = tuple(min(limit, most) for limit in device.limits.force)
    return dataclasses.replace(device, limits=dataclasses.replace(device.limits, force=force))


def force_sentence(device: DeviceBundle) -> str:
    """The greatest force that a device may exert on its user, in words."""
    most = max(device.limits.force)
    return (
        f"the device may push with up to {most:.4g} {Units.of(device.common.kinds)('N')}"
        if math.isfinite(most)
        else "no limit bounds the force"
    )


def take_seat(
    path: Path | None,
    address: str | None,
    yes: bool,
    allowed: str | None = None,
    most_force: float | None = None,
    timeout: float = TIMEOUT,
) -> int:
    """Join the session of an invitation, and stay until Ctrl-C or the session's end; returns the exit code.

    Args:
        path: the invitation's file; None asks the user for the line.
        address: where the session listens, HOST:PORT; None for the address in the invitation.
        yes: whether to engage without a question.
        allowed: the factory of another package whose code the session may run here; None for none.
        most_force: the greatest force that the device may exert here, N; None for the session's limits alone.
        timeout: for so long a host that nobody hears at is waited for, s.
    """
    try:
        invitation = read_invitation(path)
        if address is not None:
            invitation = invitation.at(address)
    except (InvitationError, KeyFileError) as error:
        _say(f"error: {error}")
        return EXIT_BAD_INPUT
    host = invitation.address.rpartition(":")[0]
    try:
        socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
    except OSError as error:
        _say(
            f"error: {host}: cannot be looked up: {error.strerror}; expected the session's host, or --connect HOST:PORT"
        )
        return EXIT_REFUSED
    life: SeatLife | None = None
    try:  # from its first line on: a life raises at any instant
        life = SeatLife()
        _say(f"{invitation.session}: going to take the seat {invitation.seat} at {invitation.address}")
        code = _Visit(invitation, host, yes, allowed, most_force, timeout).stay(life)
    except Stopped:
        code = EXIT_OK
    except Refused as error:
        _say(f"error: {error}")
        code = EXIT_REFUSED
    except (BundleError, FactoryError, TransportError) as error:
        _say(f"error: {error}")
        code = EXIT_BAD_INPUT
    ended_by = signal.SIGINT if life is None else life.signal
    return code if ended_by is None or code != EXIT_OK else 128 + ended_by


class _Visit:
    """The attempts of one user to join one session, one after the other."""

    def __init__(
        self,
        invitation: Invitation,
        host: str,
        yes: bool,
        allowed: str | None,
        most_force: float | None,
        timeout: float,
    ) -> None:
        self._invitation, self._host, self._sure, self._allowed = invitation, host, yes, allowed
        self._most_force, self._timeout = most_force, timeout
        self._lines: Sequence[ControlLine] = ()
        self._distance: FeltDistance | None = None
        self._since: Instant | None = None  # when the guest was in; None before
        self._told = False  # whether it was told, since then, what is felt

    def stay(self, life: SeatLife) -> int:
        while True:
            life.begin()
            self._lines, self._since, self._told = (), None, False
            try:
                code = self._attempt(life)
            finally:
                if self._since is not None:
                    stayed = seconds(Duration(RealtimeClock().now() - self._since))
                    _say(f"{self._invitation.seat}: out, after {stayed:.1f} s")
            if life.signal is not None:
                # a user who ends it while the session is lost has ended it, as at any other instant
                return EXIT_OK if life.orphaned and life.failure is None else code
            if not self._lines:
                if code == EXIT_OK and not life.stopping:
                    _say(f"{self._invitation.session}: the host ended the session before the seat was taken")
                return code
            stops = [line.stop for line in self._lines if line.stop is not None]
            if not (any(stop.again for stop in stops) or (life.orphaned and not stops)):
                if code == EXIT_OK:
                    ended = "the host has ended the session" if stops else "the session is over: its last tick is done"
                    _say(f"{self._invitation.session}: {ended}")
                return code
            _say(f"{self._invitation.session}: the session was lost; joining again")

    def _attempt(self, life: SeatLife) -> int:
        part = self._fetched(life)
        placed = dataclasses.replace(part.device, common=self._placed(part.device.common))
        device = with_force(elsewhere(placed), self._most_force)
        coupling = dataclasses.replace(part.coupling, common=self._placed(part.coupling.common))
        inside = CouplingNode(coupling)
        try:
            node = DeviceNode(device, driver_of(device), inside=[inside])
        except (ValueError, OverflowError) as error:
            _say(f"error: {error}")
            return EXIT_BAD_INPUT
        life.joined = partial(self._joined, coupling.common.period)
        life.seen = partial(self._tell, coupling, inside)
        nodes: list[tuple[Common, Node, KeyRing | None]] = [(device.common, node, part.ring(device.common)),
                 (coupling.common, inside, part.ring(coupling.common))]  # fmt: skip
        try:
            return run_together(nodes, life, True, self._host, partial(self._engage, device, coupling))
        finally:
            node.close()

    def _fetched(self, life: Life) -> SeatPart:
        """The seat's part of the session as it runs now; of its code, the user must have allowed what it names."""
        invitation = self._invitation
        transport = ZmqTransport(None, True, invitation.ring)
        try:
            link = transport.join(f"tcp://{invitation.address}", invitation.device)
            part = decoded_part(fetch(link, invitation, life, self._timeout), invitation)
        finally:
            transport.close()
        require_allowed(foreign_code(part.device), self._allowed)
        return part

    def _placed(self, common: Common) -> Common:
        # no directory, whatever the invitation says: its author must not choose where this machine writes files
        control = f"tcp://{self._invitation.address}"
        return dataclasses.replace(common, transport="tcp", control=control, directory="", private="")

    def _engage(self, device: DeviceBundle, coupling: CouplingBundle, lines: Sequence[ControlLine], life: Life) -> None:
        """Measure, report what will be felt, and ask.

        Raises:
            Stopped: the user does not want it.
            ValueError: no frame came back.
        """
        period, clock = coupling.common.period, RealtimeClock()
        lines[0].round_trips(clock, life, math.ceil(WARMING / period), from_seconds(period))
        trips: Sequence[Duration] = ()
        for _ in range(MOST_MEASURED):
            trips = lines[0].round_trips(clock, life, math.ceil(MEASURING / period), from_seconds(period))
            if is_calm(trips):
                break
        _say(f"{self._invitation.seat}: ports {', '.join(coupling.common.ports)}, a tick every {1e3 * period:.3g} ms")
        self._distance = felt(coupling, trips)
        _say(self._distance.sentence())
        if (turning := turning_sentence(device, self._distance.network)) is not None:
            _say(turning)
        _say(f"{force_sentence(device)}; --max-force N bounds it here")
        if not self._sure and not answered_yes(f"take the seat {self._invitation.seat}? [y/N] ", life.check):
            _say("not joined")
            life.stopping = True
            raise Stopped
        self._sure = True
        self._lines = lines
        _say(f"{self._invitation.session}: joining; Ctrl-C leaves")

    def _joined(self, period: float) -> None:
        """Report that the guest is in: its rate, the delay and how to leave."""
        self._since = RealtimeClock().now()
        delay = "" if self._distance is None else f", round trip R of about {_ms(self._distance.round_trip)}"
        _say(f"{self._invitation.seat}: in, at {1.0 / period:.4g} ticks a second{delay}; Ctrl-C leaves")

    def _tell(self, coupling: CouplingBundle, node: CouplingNode) -> None:
        """Tell once what is felt, when both ends have settled and the host has told R; the loop waits for this."""
        if self._told or self._since is None:
            return
        settled = self._since + from_seconds(SETTLED)
        echoes = [line.echo for line in self._lines if line.echo is not None and line.echo.sent >= settled]
        R = next((echo.round_trip for echo in echoes if echo.round_trip is not None), None)
        end = next((join for join in node.joins if isinstance(join, UserEnd)), None)
        if R is None or end is None or end.face.holding or not _has_room(sys.stderr):
            return
        self._told = True
        _say(f"{self._invitation.seat}: {felt_as_measured(coupling, R)}")
        if end.without_datagrams:
            _say(
                f"{self._invitation.seat}: no datagram comes through, so the waves go by TCP, where a lost packet "
                "delays all that follow; the host's ports have to be open to UDP, too"
            )


def _has_room(stream: TextIO) -> bool:
    """Whether a line can be written without waiting: a terminal may have been stopped."""
    try:
        return bool(select.select([], [stream], [], 0.0)[1])
    except (OSError, ValueError):  # it is no file, or closed
        return True


def answered_yes(question: str, look: Callable[[], None]) -> bool:
    """Ask the user at the terminal; no answer within :data:`TIME_TO_ANSWER` is no.

    Args:
        question: what to ask.
        look: called again and again while nothing comes; may raise.
    """
    print(question, end="", file=sys.stderr, flush=True)  # noqa: T201 -- the process's own channel to its user
    clock = RealtimeClock()
    until = clock.now() + from_seconds(TIME_TO_ANSWER)
    while clock.now() < until:
        ready, _, _ = select.select([sys.stdin], [], [], _GLANCE)
        if ready:
            return sys.stdin.readline().strip().lower() in ("y", "yes")
        look()
    _say("")
    return False


def _say(text: str) -> None:
    # parts of an invitation may hold terminal commands
    print(presentable(text), file=sys.stderr, flush=True)  # noqa: T201
