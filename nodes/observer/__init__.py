"""An observer: it reads the nodes that its session permits, and writes nothing into the session.

Read ``scene`` first (the session as an observer sees it), then ``tracks`` (the last seconds of each trace), ``alarms``,
and ``node`` (the process that prints).
"""
