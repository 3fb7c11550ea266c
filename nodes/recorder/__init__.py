"""The recorder: a process of its own, so that neither a slow nor a full disk reaches the loop.

Read ``format`` first (the messages of the file), then ``core`` (from observations to bytes, with ``coverage``),
``mcap`` (the file) and ``node`` (the process).
"""
