"""Recordings of runs: how they are read, checked and converted.

Read ``mcap`` first (the bytes), then ``reading`` (their rows), ``run`` and ``recording`` (their meaning). ``integrity``
checks the bytes. ``tables``, ``arrays`` and ``curves`` turn them into numbers.
"""
