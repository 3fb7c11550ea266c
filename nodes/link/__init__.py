"""What joins two processes: a link with its gate, its recovery, the line to the supervisor, and a process's main.

Read ``peer_link`` first, then ``relink``, ``supervisor_line`` and ``process``.
"""
