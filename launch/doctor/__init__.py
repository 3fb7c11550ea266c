"""What this machine permits, how long a tick takes on it, and which delay and form follow for a session.

Read ``machine`` first (what the system permits), then ``wakeup`` and ``probe`` (what is measured) and ``advice`` (what
it means). ``profile`` and ``rates`` turn measured delays into what a session in real time is designed for; ``delay``
and ``colocation`` settle a session by them.
"""
