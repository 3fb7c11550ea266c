"""`manyhands doctor`: what this machine permits, how long a tick takes on it, and which stiffness that allows.

Read ``machine`` first (what the system permits), then ``examination`` (what is measured) and ``advice`` (what it
means). ``profile`` and ``rates`` turn measured delays into what a session in real time is designed for.
"""
