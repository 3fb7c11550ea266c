"""The processes of a session. Each: ``core.py`` (a pure step), ``node.py`` (its I/O), ``__main__.py``.

Read ``kernel/`` (what each stands on), ``rows/`` (what it reports) and ``link/`` (what joins two, starts them, and
leads to the supervisor), then ``device/``, ``coupling/`` and ``environment/`` in the order of the tick, and
``wave_link/``. ``monitor/`` and ``recorder/`` look on, and ``guest/`` has the nodes that are started elsewhere.
"""
