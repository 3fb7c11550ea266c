"""Pure mathematics: models, passivity, LMIs, couplings, certificates. No sockets, no clocks.

Read ``models/`` first, then ``passivity/`` and ``levels/`` (the promise of each party). ``problem``, ``theorem3`` and
``theorem4`` find a coupling and its levels, ``synthesis`` leads from a request to a ``certificate``, and ``proof/``
proves it without any code of the others.

The public library is :mod:`manyhands.design.passivity`, under the shorter name ``manyhands.passivity``.
"""
