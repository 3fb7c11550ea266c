"""An observer: it reads the part of a session that the session lists for it, and writes nothing.

Read ``scene`` first (the state of a session), then ``tracks`` (the last seconds of each trace), ``alarms``, and
``node`` (the process that prints).
"""
