"""Observing running sessions from another terminal: which sessions run, their state, and their values.

Read ``sessions`` first (which run), then ``tables`` (list and top) and ``topics`` (echo and rates).
"""
