"""The recorder: a process of its own, so that neither a slow nor a full disk reaches the loop.

Read ``format`` first (what the file looks like), then ``core`` (what is taken in), ``mcap`` (the file), ``node``.
"""
