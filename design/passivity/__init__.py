"""The passivity lemmas of [Bianchini2010]_ for any system: part of the public API of ``manyhands.design``.

Read ``storage`` first (supply rates and storage functions), then ``lemma1`` and ``lemma2``. ``best_level`` searches the
greatest level. ``frequency`` and ``hinfinity`` search over frequency, and ``continuous`` has Lemma 3 and Theorem 1.
"""
