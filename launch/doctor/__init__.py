"""`manyhands doctor`: what this machine permits, how fast a tick is on it, and what that allows to certify.

Read ``machine`` first (what the system permits), then ``examination`` (what is measured) and ``advice`` (what it
means).
"""
