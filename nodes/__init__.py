"""The processes of a session. Each: ``core.py`` (a pure step), ``node.py`` (its I/O), ``__main__.py``."""
