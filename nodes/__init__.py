"""The processes of a session. Each: ``core.py`` (a pure step), ``node.py`` (its I/O), ``__main__.py``.

Read ``device/``, ``coupling/`` and ``environment/`` in the order of the tick; ``process`` starts them, ``peer_link``
joins two, ``supervisor_line`` leads to the supervisor; ``recorder/`` and ``observer/`` look on.
"""
