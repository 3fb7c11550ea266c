"""A run computed again: ``simulation`` has the cores in one process, ``replay`` and ``audit`` compare a recording.

Read ``simulation`` first, then ``recompute`` (how any party follows its recording), and ``audit`` (the order of the
checks) with ``device``, ``coupling``, ``environment`` and ``wave_link`` (a party's each). ``findings`` is what they
return, ``promises`` what follows for each promise.
"""
