"""Proof of a certificate in exact rational and ball arithmetic, from its plain JSON data.

The proof shares no code with synthesis, and trusts no result of a solver or of numpy. It reads the file's numbers as
exact rational numbers, rebuilds E_hat and V_hat from the physical data, and proves every inequality of Theorem 3
[Bianchini2010]_ at the certificate's levels and storage matrices. Read ``prove`` first, then ``claim``, ``contract``
and the parties, and the arithmetic last. ``world`` proves the certificate of a world, and that certificates meet it.
"""

from manyhands.design.proof.finding import Finding, Proof, ProofInputError
from manyhands.design.proof.prove import prove
from manyhands.design.proof.world import prove_together, prove_world

__all__ = ["Finding", "Proof", "ProofInputError", "prove", "prove_together", "prove_world"]
