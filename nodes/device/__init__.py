"""A force-feedback device: samples x, applies f_v, paces the loop.

Read ``core`` (the pure step and its limits), then ``node`` (the loop) and ``drivers`` (where x comes from);
``simulated`` and ``pointer`` are the simulated hands. ``interface`` keeps account of lateness, with ``speed_bound`` and
``given``; ``telemetry`` keeps the figures.
"""
