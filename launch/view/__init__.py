"""The page of a running session: an observer that serves what the session shows of itself to a browser.

It reads the session's broadcast, as every command that observes does, and sends one thing: where a person's hand, on
the page, moves a device (:mod:`manyhands.protocol.transport.pointer`). Read ``server``, ``feed``, ``pointer``,
``security``.
"""
