"""Systems of one tick: state space, devices, couplings, environments, weights.

Read ``statespace`` first, then ``coupling``, ``device`` and ``environment``. Environments are built from ``network``
and ``integrators``; ``weights`` serves the transparency objectives.
"""
