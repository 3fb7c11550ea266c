"""The shared virtual environment E: sees tool positions p and D_V, never x.

Read ``core`` (the pure step) and ``clutch`` first, then ``membership`` (who takes part), ``late_arrivals`` and
``energy`` (who is frozen or scaled), and ``node`` (the loop); ``enforced`` with ``model`` is the environment without a
proof.
"""
