"""Recordings of runs: how they are read, checked, converted, replayed, audited and drawn.

Read ``mcap`` first (the bytes), then ``run`` and ``recording`` (their meaning). ``integrity`` checks the bytes.
``replay`` and ``audit`` (with its parts) compute the run again. ``tables``, ``curves`` and ``plots`` show it.
"""
