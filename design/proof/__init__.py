"""Proof of a certificate in exact rational and ball arithmetic, from its plain JSON data; no code of synthesis.

Nothing is believed that a solver, or numpy, has computed: the physical data are read as the exact rational numbers that
the file's floats are, E_hat and V_hat are rebuilt, and every inequality of Theorem 3 [Bianchini2010]_ is proved at the
certificate's levels and storage matrices. Read ``prove``, then ``claim``, ``contract`` and the parties; last the
arithmetic.
"""

from manyhands.design.proof.finding import Finding, ProofInputError
from manyhands.design.proof.prove import prove

__all__ = ["Finding", "ProofInputError", "prove"]
