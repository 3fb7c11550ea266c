"""Boards with motors and encoders behind a serial port: an open protocol, its driver, and a firmware core in C.

``PROTOCOL.md`` has the protocol, ``firmware/`` the board's end of it. The driver's short name is ``serial-board``.
"""

from manyhands.devices.serial_board.driver import BoardError, SerialBoard

__all__ = ["BoardError", "SerialBoard"]
