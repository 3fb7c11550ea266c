"""What joins two processes: a link with its gate, its recovery, the line to the supervisor, and a process's main.

Read ``join`` first, then ``relink``, ``supervisor_line`` and ``process``.
"""
