"""Proof of a certificate in exact rational and ball arithmetic, from its plain JSON data.

Nothing here shares code with synthesis, and nothing is believed that a solver, or numpy, has said: the physical
data are read as the exact rational numbers that the file's floats are, E_hat and V_hat are rebuilt from them, and
every inequality of Theorem 3 [Bianchini2010]_ is proved at the certificate's levels and storage matrices.
"""

from manyhands.design.proof.finding import Finding, ProofInputError
from manyhands.design.proof.proving import prove

__all__ = ["Finding", "ProofInputError", "prove"]
