"""Session files, keys, the supervisor, the command line: from a YAML file to processes and back to pictures.

Read ``session/`` (the file), ``plan/`` (what follows from it) and ``run/`` (the processes); then ``recordings/``, and
what shows them: ``observe/``, ``graph/``, ``view/``. ``cli/`` is the entry, ``doctor/`` looks at the machine.
"""
