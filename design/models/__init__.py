"""Systems of one tick: state space, devices, couplings, environments, operators, weights.

Read ``statespace`` first, then ``coupling``, ``device`` and ``environment``; ``network`` and ``integrators`` are what
an environment is made of, ``operators`` and ``weights`` serve simulations and objectives.
"""
