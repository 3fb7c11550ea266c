"""A force-feedback device: samples x, applies f_v, paces the loop.

Read ``core`` (the pure step and its limits), then ``node`` (the loop) and ``drivers`` (where x comes from);
``simulated``, ``intent`` and ``pointer`` are the simulated hands, ``telemetry`` keeps the figures.
"""
