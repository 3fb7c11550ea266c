"""Recordings of runs: written at a run's end, read, checked, converted, replayed, audited, drawn.

Read ``mcap`` first (the bytes), then ``run`` and ``recording`` (what they mean); ``integrity`` checks the bytes,
``replay`` and ``audit`` (with its parts) compute the run again, ``tables``, ``curves`` and ``plots`` show it.
"""
