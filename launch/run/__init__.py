"""The processes of a session: how they start, run, come back and end, and what is reported of them.

Read ``states`` and ``conductor`` first (pure decisions), then ``supervisor`` (their I/O) and ``processes``.
``recovery`` and ``breaches`` answer faults. ``recorder``, ``broadcast`` and ``outcome`` show what happens.
"""
