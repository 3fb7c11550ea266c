"""An observer: reads what its session lists for it, and writes nothing.

Read ``scene`` first (what is known of a session), then ``tracks`` (the last seconds of each trace), ``alarms``, and
``node`` (the process that prints).
"""
