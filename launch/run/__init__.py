"""A session's processes: started, watched, brought back, ended, and what is reported of them.

Read ``states`` and ``conductor`` first (pure decisions), then ``supervisor`` (their I/O) and ``processes``;
``recovery`` and ``breaches`` answer faults, ``recorder``, ``broadcast``, ``display`` and ``outcome`` show what happens.
"""
