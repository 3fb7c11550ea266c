"""Systems of one tick: state space, devices, couplings, environments, operators, weights.

Read ``statespace`` first, then ``coupling``, ``device`` and ``environment``. Environments are built from ``network``
and ``integrators``; ``operators`` serves simulated hands, and ``weights`` the transparency objectives.
"""
