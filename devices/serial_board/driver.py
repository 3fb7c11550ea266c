"""The driver of a board that speaks the board protocol: :class:`SerialBoard`.

    devices:
      stick: {dof: 2, driver: serial-board, parameters: {port: /dev/ttyACM0}, osp: ..., limits: {...}}

At the start it greets the board, reads from its answer what it can do, and measures the way of a force to the board and
of the state that answers it back (:func:`manyhands.devices.starting.trips`). From the longest trip R and the board's
own period P it states its timing: a displacement is at most P + R/2 old, and a force acts after at most R/2. Only the
sum of both counts for a certificate.

The board ends every force by itself, at an instant of its own clock that the frame names
(:mod:`manyhands.devices.serial_board.conversation`). So a frame that a stalled port delivers late is no force.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Final

from manyhands.devices.serial_board.conversation import Arrived, Conversation
from manyhands.devices.serial_board.frames import VERSION, About, Feature, Status, force, hello
from manyhands.devices.serial_port import PortError, SerialPort
from manyhands.devices.starting import checked, measured_times, trips
from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import DeviceSpecification, DeviceTiming, up
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds, seconds

GREETING: Final = from_seconds(2.0)
"""How long a board may take to answer; one that starts when its port is opened needs a second and more."""

HELLO_EVERY: Final = from_seconds(0.1)

PARAMETERS: Final[Mapping[str, object]] = {
    "port": "",
    "baud": 115200,
    "silence": 0.01,
    "sample_age": None,
    "actuation_delay": None,
}
"""What a session may give, and what holds where it does not; times in s. ``silence``: without a state for so long the
board counts as gone. The last two stand in for what would be measured."""

_AXES: Final = ("x", "y", "z", "rx", "ry", "rz")


class BoardError(RuntimeError):
    """A board does not answer, or is no longer of use; the message names its port and says what to do."""


class SerialBoard(DeviceDriver):
    """A board behind a serial port."""

    def __init__(
        self,
        ports: Sequence[str],
        period: float,
        parameters: Mapping[str, Any],
        clock: Clock | None = None,
    ) -> None:
        """Open the port, greet the board, and measure how long a force and its answer take.

        Args:
            ports: of the session's device; the board has as many axes.
            period: of the session, s.
            parameters: :data:`PARAMETERS`, of which ``port`` is required.
            clock: what the driver measures by; the realtime clock by default.

        Raises:
            ValueError: the parameters are not those.
            BoardError: no board of this protocol answers, or it has another number of axes.
            PortError: the port cannot be opened.
        """
        given = checked(parameters, PARAMETERS, ("silence", "sample_age", "actuation_delay"))
        self._clock = clock or RealtimeClock()
        self._silence = from_seconds(given["silence"])
        self._nonce = int.from_bytes(os.urandom(4), "little")
        self._board = Conversation(self._nonce)
        self._given = 0  # the number of the last force
        self._unsent = self._old = 0
        self._oldest = 0.0  # s
        self._told: float | None = None  # J, up to the displacement that was returned last
        self._told_now: float | None = None
        self._port = SerialPort(given["port"], given["baud"])
        try:
            self._about = self._greet()
            if self._about.axes != len(ports):
                raise BoardError(
                    f"{self._port.path}: found a board of {self._about.axes} axes ({self._about.name}); expected "
                    f"{len(ports)}, the dof of the session's device"
                )
            self._timing, self._measured = self._timed(given), measured_times(given)
        except BaseException:
            self._port.close()
            raise

    # --- the start

    def _greet(self) -> About:
        board, port, end = self._board, self._port, Instant(self._clock.now() + GREETING)
        due = self._clock.now()
        while (now := self._clock.now()) < end:
            if now >= due:
                port.write(b"\0" + hello(self._nonce))  # the zero ends whatever the board has heard before
                due = Instant(now + HELLO_EVERY)
            port.wait(HELLO_EVERY)
            self._read()
            if board.about is not None and board.about.version != VERSION:
                raise BoardError(
                    f"{port.path}: found a board of protocol version {board.about.version}; expected {VERSION}: "
                    "flash a firmware of this version"
                )
            if board.about is not None and board.newest is not None:
                return board.about
        heard = f"something else ({board.broken} frames)" if board.broken else "no answer"
        raise BoardError(
            f"{port.path}: found {heard} within {seconds(GREETING):g} s; expected a board that speaks the manyhands "
            "board protocol: see that its firmware runs, and that the port and its baud rate are right"
        )

    def _timed(self, given: Mapping[str, Any]) -> DeviceTiming:
        """The timing as the session gives it, or as it is measured; both are rounded up."""
        shortest, longest = trips(self._trip)
        age, delay = given["sample_age"], given["actuation_delay"]
        measured_age = up(self._about.period + longest / 2.0)
        if age is None:
            jitter = min(measured_age, up(self._about.period + (longest - shortest) / 2.0))
            return DeviceTiming(measured_age, jitter, up(longest / 2.0) if delay is None else delay)
        return DeviceTiming(age, None, up(longest / 2.0) if delay is None else delay)

    def _trip(self) -> Duration:
        """From a force of zero to the state that answers it."""
        sent = self._clock.now()
        number = self._send_none()
        end = Instant(sent + GREETING)
        while (now := self._clock.now()) < end:
            self._port.wait(self._silence)
            self._read()
            newest = self._board.newest
            if newest is not None and newest.state.answers == number:
                return Duration(now - sent)
        raise BoardError(f"{self._port.path}: found states that answer no force; expected the last force's number")

    # --- the loop

    def specification(self) -> DeviceSpecification:
        """What the board says of itself, and the timing that was measured."""
        about = self._about
        return DeviceSpecification(
            force=about.force,
            displacement=about.displacement,
            speed=about.speed,
            timing=self._timing,
            measured=self._measured,
            axes=(axes := _names(about.rotations)),
            turning=tuple(axis for axis, turns in zip(axes, about.rotations, strict=True) if turns),
            mass=about.mass if all(about.mass) else None,
            step=about.step if all(about.step) else None,
            holds_torque=Feature.HOLDS_TORQUE in about.features,
        )

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The newest displacement, m."""
        self._read()
        newest = self._usable()
        age = self._board.age(self._clock.now())
        self._oldest = max(self._oldest, age)
        self._old += age > self._timing.sample_age
        self._told_now = newest.state.work
        return newest.state.x

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        """Send the force f, N, and when it ends."""
        self._send(f, Duration(until - at) if until is not None else from_seconds(self._about.longest))

    def release(self, at: Instant) -> None:
        """Send no force."""
        self._send_none()

    def exerted(self) -> Sequence[float] | None:
        """The force that the board exerts, N; None where its newest state does not answer the last force yet."""
        self._read()
        newest = self._board.newest
        return newest.state.f if newest is not None and newest.state.answers == self._given else None

    def work(self) -> float | None:
        """The work of the board's motors since the last call, J; None where the board does not tell."""
        before, self._told = self._told, self._told_now
        return None if self._told is None or before is None else self._told - before

    def figures(self) -> Mapping[str, float]:
        """What came late or not at all."""
        return {
            "oldest_ms": 1e3 * self._oldest,
            "older_than_stated": float(self._old),
            "missing_states": float(self._board.missing),
            "broken_frames": float(self._board.broken),
            "unsent_forces": float(self._unsent),
        }

    def close(self) -> None:
        """Send no force, and close the port."""
        try:
            self.release(Instant(0))
        except (PortError, ValueError):
            return  # it is gone, and the force ends by itself
        finally:
            self._port.close()

    # --- both

    def _read(self) -> None:
        self._board.take(self._port.read(), self._clock.now())

    def _send(self, f: Sequence[float], lives: Duration) -> int:
        self._given = (self._given + 1) % 65536
        until = self._board.board_time(self._clock.now()) + lives // 1000
        self._unsent += not self._port.write(force(self._given, until, f))
        return self._given

    def _send_none(self) -> int:
        return self._send([0.0] * self._about.axes, from_seconds(self._about.longest))

    def _usable(self) -> Arrived:
        """The newest state, of a board that is there and obeys."""
        newest = self._board.newest
        assert newest is not None  # noqa: S101 -- no driver is made without one
        silent = self._clock.now() - newest.at
        if silent > self._silence:
            raise BoardError(
                f"{self._port.path}: found no state for {1e-6 * silent:.3g} ms; expected one every "
                f"{1e3 * self._about.period:g} ms"
            )
        status = newest.state.status
        if status & (Status.BRAKED | Status.FAULT) or not status & Status.READY:
            raise BoardError(
                f"{self._port.path}: found the board {_said(status)}; expected one that is ready and obeys"
            )
        return newest


def _names(rotations: Sequence[bool]) -> tuple[str, ...]:
    """x, y and z for axes that move, rx, ry and rz for those that turn; numbers where there are more of a kind."""
    counts, names = [0, 0], []
    for turns in rotations:
        names.append((turns, counts[turns]))
        counts[turns] += 1
    if max(counts) > 3:
        return tuple(str(axis) for axis in range(len(rotations)))
    return tuple(_AXES[3 * turns + number] for turns, number in names)


def _said(status: Status) -> str:
    if status & Status.BRAKED:
        return "braked by its own protection"
    return "with a fault" if status & Status.FAULT else "without power for its motors"
