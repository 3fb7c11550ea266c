"""The passivity lemmas of [Bianchini2010]_ for any system: part of the public API of ``manyhands.design``.

Read ``storage`` first (supply rates and storage functions), then ``lemma1`` and ``lemma2``; ``best_level`` searches a
level, ``frequency`` and ``hinfinity`` confirm it by frequency responses, ``continuous`` is Lemma 3.
"""
