"""Observing running sessions from another terminal: which there are, and what they show of themselves.

Read ``sessions`` first (which run), then ``tables`` (list and top) and ``topics`` (echo and rates).
"""
