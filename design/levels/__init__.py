"""The passivity level of each party of the loop, and condition (10) that joins them.

Read ``contract`` first (the condition), then ``device``, ``spring_damper`` and ``environment``. ``network`` has the
level that a network of masses and springs keeps by its physics alone.
"""
