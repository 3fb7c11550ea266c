"""Session files, keys, the supervisor and the command line: from a YAML file to processes, recordings and plots.

Read ``session/`` (the file), ``plan/`` (what follows from it) and ``run/`` (the processes), then ``recordings/``. The
rooms ``observe/``, ``graph/`` and ``view/`` show sessions, ``cli/`` is the entry, and ``doctor/`` examines the machine.
"""
