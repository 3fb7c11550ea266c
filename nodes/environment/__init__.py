"""The shared virtual environment E: sees tool positions p and D_V, never x.

Read ``core`` (the pure step) and ``clutch`` first, then ``membership`` (active and frozen couplings), ``late_arrivals``
and ``energy`` (why a coupling is frozen or scaled), and ``deadline`` with ``node`` (the loop). ``enforced`` with
``model`` is the environment without a proof, and with ``scene`` that of contacts and friction.
"""
