"""What a person or a program calls: the command line (``cli/``), the same in Python (``api``), and what they print.

Read ``cli/`` for a command, ``api`` for a function of ``import manyhands as mh``. The other modules are what both use.
"""
