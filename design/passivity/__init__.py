"""The lemmas and theorems of [Bianchini2010]_ as a library, for any linear system: ``manyhands.passivity``.

A system is *output strictly passive* (OSP) with the level Delta and *input strictly passive* (ISP) with the level Phi
if from rest, over any time,

    energy put in  =  sum y^T u  >=  sum y^T Delta y + sum u^T Phi u.

| of the paper | names |
|---|---|
| systems | ``StateSpace``, ``SpringDamper``, ``Network`` of ``NetworkLink``, ``Partition`` |
| Definition 1, continuous time | ``Dissipative``, ``continuous_storage_inequality``, ``mass_with_damping``,
``device_level``, ``device_with_level``, ``passive_operator`` |
| Lemma 1, (2) | ``analyse``, ``storage_inequality``, ``greatest_output_level``, ``greatest_input_level``,
``dissipation_matrix`` and ``structured_level`` for networks of any size |
| Lemma 2, (3) and (4) | ``storage_by_lemma2``, ``lemma2_matrix``, ``schur_matrix``, ``lemma2_expression`` |
| Lemma 3, Theorem 1 | ``feedback_with_passive``, ``lemma3``, ``theorem1`` |
| loop transformation (7)-(9) | ``loop_gain``, ``transformed_device``, ``transformed_coupling``,
``transformed_environment`` |
| Theorem 3, (10) | ``loop_inequality``, ``least_coupling_level``; ``manyhands.verify`` proves it for a whole loop |
| Theorem 4 | ``manyhands.certify`` |

Force is in N, displacement in m, velocity in m/s and time in s. A level is in N*s/m where the system leads from force
to velocity. Section 10 of docs/design.md shows the names at work. Each is imported at its first use, because a node
must not load a solver.

Read ``storage`` first (supply rates and storage functions), then ``lemma1`` and ``lemma2``. ``best_level`` searches the
greatest level. ``frequency`` and ``hinfinity`` search over frequency, and ``continuous`` has Lemma 3 and Theorem 1.

Example:
    A spring of 1000 N/m between hand and tool, for a device that dissipates 1.37 N*s/m, every millisecond:

    >>> import manyhands as mh
    >>> T, V = 1e-3, mh.passivity.StateSpace.static([[1.0 / 1000.0]])
    >>> K = mh.passivity.loop_gain([[1.37]], T)                      # (8), m/N
    >>> V_hat = mh.passivity.transformed_coupling(V, K, T)           # (7)
    >>> mh.passivity.analyse(V_hat).holds                            # Lemma 1: is it passive?
    True
    >>> print(f"{mh.passivity.greatest_output_level(V_hat).value:.3f} N*s/m")
    0.787 N*s/m
"""

from manyhands.lazy_names import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
