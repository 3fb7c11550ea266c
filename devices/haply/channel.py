"""A WebSocket to this machine, and HTTP beside it: after the start nothing is waited for.

The protocol is that of ``websockets`` without its input and output (:class:`websockets.client.ClientProtocol`); the
socket is this module's. :meth:`Channel.send` may be called from another thread than :meth:`Channel.read`, as long as no
two threads send at once.
"""

from __future__ import annotations

import http.client
import json
import select
import socket
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from manyhands.devices.haply.service import HaplyError

if TYPE_CHECKING:
    from websockets.client import ClientProtocol

PATIENCE: Final = 5.0
"""s; how long the service may take to accept a connection, or to answer over HTTP."""

_AT_ONCE: Final = 1 << 16


class Channel:
    """An open WebSocket.

    Attributes:
        name: its address.
        owed: what the protocol itself has to say, the answer to a ping or to a close; :meth:`answer` sends it.
    """

    def __init__(self, port: int) -> None:
        """Connect to the service, and shake hands.

        Raises:
            HaplyError: nobody listens there, or no WebSocket.
            ModuleNotFoundError: the library ``websockets`` is not installed.
        """
        from websockets.client import ClientProtocol
        from websockets.exceptions import InvalidHandshake
        from websockets.uri import parse_uri

        self.name, self.owed = f"ws://localhost:{port}", b""
        self._text: list[bytes] = []  # of a message that has come in part
        self._unsent = b""  # the rest of a frame that the kernel had no room for
        self._messages: list[str] = []
        self._protocol: ClientProtocol = ClientProtocol(parse_uri(f"{self.name}/"), max_size=1 << 22)
        try:
            self._socket = socket.create_connection(("localhost", port), timeout=PATIENCE)
        except OSError as error:
            raise _absent(self.name, error) from error
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._protocol.send_request(self._protocol.connect())
            self._socket.sendall(b"".join(self._protocol.data_to_send()))
            while self._protocol.state.name == "CONNECTING":
                self._take(self._socket.recv(_AT_ONCE))
                if self._protocol.handshake_exc is not None:
                    raise self._protocol.handshake_exc
            self._socket.setblocking(False)
        except (OSError, InvalidHandshake) as error:
            self._socket.close()
            raise HaplyError(
                f"{self.name}: found something else than a WebSocket ({error}); expected Haply's Inverse Service "
                "there: see which program has that port"
            ) from error

    def read(self) -> list[str]:
        """All messages that have come, perhaps none.

        Raises:
            HaplyError: the service has closed the connection.
        """
        while True:
            try:
                data = self._socket.recv(_AT_ONCE)
            except BlockingIOError:
                break
            except OSError as error:
                raise self._closed(error.strerror) from error
            if not data and not self._messages:
                raise self._closed("its end")
            if not data:
                break
            self._take(data)
        messages, self._messages = self._messages, []
        self.owed += b"".join(self._protocol.data_to_send())
        return messages

    def send(self, text: str) -> bool:
        """Send a message at once; False where the kernel has no room for it, so that the service will not hear it.

        Raises:
            HaplyError: the service has closed the connection.
        """
        from websockets.frames import Frame, Opcode

        return self._put(Frame(Opcode.TEXT, text.encode()).serialize(mask=True))

    def wait(self, timeout: float) -> None:
        """Wait until something has come, at most ``timeout`` s."""
        select.select([self._socket], [], [], max(0.0, timeout))

    def close(self) -> None:
        """Say that this is the end, and close the socket; a second call does nothing."""
        with suppress(HaplyError, OSError):
            if self._socket.fileno() >= 0 and self._protocol.state.name == "OPEN":
                self._protocol.send_close(1000)
                self.owed += b"".join(self._protocol.data_to_send())
                self.answer()
        self._socket.close()

    def answer(self) -> None:
        """Send what is owed, one at a time with :meth:`send`.

        Raises:
            HaplyError: the service has closed the connection.
        """
        if self.owed and self._put(self.owed):
            self.owed = b""

    def _put(self, data: bytes) -> bool:
        if self._unsent:
            self._unsent = self._unsent[self._written(self._unsent) :]
            if self._unsent:
                return False
        sent = self._written(data)
        if 0 < sent < len(data):
            self._unsent = data[sent:]
        return sent > 0

    def _written(self, data: bytes) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._closed(error.strerror) from error

    def _take(self, data: bytes) -> None:
        from websockets.frames import Frame, Opcode

        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        for event in self._protocol.events_received():
            if not isinstance(event, Frame):
                continue
            if event.opcode in (Opcode.TEXT, Opcode.CONT):
                self._text.append(bytes(event.data))
                if event.fin:
                    self._messages.append(b"".join(self._text).decode(errors="replace"))
                    self._text = []
            elif event.opcode is Opcode.CLOSE and not self._messages:
                raise self._closed("a close")

    def _closed(self, why: str | None) -> HaplyError:
        return HaplyError(
            f"{self.name}: found {why or 'its end'}; expected an open connection: the service was stopped, or has "
            "ended the session (see the Haply Hub)"
        )


def asked(port: int, path: str, body: dict[str, Any] | None = None, timeout: float = PATIENCE) -> Any:
    """What the service answers to a GET, or to a POST with ``body``: its ``data`` where it is in an envelope.

    It has ``timeout`` s for that.

    Raises:
        HaplyError: no answer, one that is no JSON, or a refusal.
    """
    line = http.client.HTTPConnection("localhost", port, timeout=timeout)
    where = f"http://localhost:{port}{path}"
    try:
        if body is None:
            line.request("GET", path)
        else:
            line.request("POST", path, json.dumps(body), {"Content-Type": "application/json"})
        answer = line.getresponse()
        found: Any = json.loads(answer.read())
    except ConnectionRefusedError as error:
        raise _absent(where, error) from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise HaplyError(f"{where}: found {error or type(error).__name__}; expected an answer in JSON") from error
    finally:
        line.close()
    if answer.status != 200 or (isinstance(found, dict) and found.get("ok") is False):
        why = found.get("error") if isinstance(found, dict) else None
        raise HaplyError(f"{where}: found the refusal {answer.status} {why or answer.reason}; expected it done")
    return found.get("data", found) if isinstance(found, dict) else found


def _absent(where: str, error: OSError) -> HaplyError:
    return HaplyError(
        f"{where}: found no service ({error.strerror or error}); expected Haply's Inverse Service: open the Haply Hub, "
        "or start haply-inverse-service, and see that the port is right"
    )
