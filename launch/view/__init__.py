"""The page of a running session: an observer that serves what the session shows of itself to a browser.

It looks on through the session's gallery, as every command that looks on does, and can say one thing: where a person's
hand, on the page, wants a device to be that can be held (:mod:`manyhands.protocol.transport.grip`).
"""
