"""Session files, keys, the supervisor and the command line: from a YAML file to processes, recordings and plots.

Read from the bottom up: ``session/`` (the file), ``plan/`` (what follows from it), ``run/`` (the processes). Beside
these, ``recordings/`` reads what a run leaves, ``audit/`` computes it again, ``doctor/`` examines the machine and
``conformance/`` drivers and models. ``look/`` shows sessions, ``bridges/`` hand them to other programs, and ``app/`` is
the entry. Each imports only what is below it (pyproject.toml has the order).
"""
