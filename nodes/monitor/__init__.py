"""What is computed from telemetry: a session's state, its last seconds, and how each promise stands. Pure.

Read ``session_state`` first, then ``tracks``, ``alarms``, ``causes`` and ``given``, and ``health`` with
``health_model``.
"""
