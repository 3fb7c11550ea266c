"""The page of a running session: an observer that shows the session in a browser.

It reads the session's broadcast, as every observing command does. It sends one thing only: the position to which a
person drags a device on the page (:mod:`manyhands.protocol.transport.pointer`). Read ``server``, ``feed``, ``pointer``,
``security``.
"""
