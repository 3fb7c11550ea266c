"""The claim of a ladder beyond its certificates: its rungs may be mixed, block by block.

The rungs are certificates of one loop, each for a longer delay inside the tick and with a coupling and levels of its
own. Let Phi_E be a level of E_hat that one of them proves, and let each block i of V be at any rung r(i). Theorem 3 of
[Bianchini2010]_ requires (10) with the levels of the mixture,

    [ D - Phi_E    -Phi_E    ]
    [ -Phi_E       V - Phi_E ]  > 0,    D = blockdiag(share_r(i) Delta_D,i),   V = blockdiag(Delta_V,i of rung r(i)).

A rung proves Delta_D <= the devices' levels for its own Delta_D as a whole. If two blocks share a device, blocks of
Delta_D from two different rungs may together exceed the device's promise. So mixtures are proved only for rungs that
state the same Delta_D over such blocks. Designed ladders do, unless a device holds torques: these leave less of its
level at a longer delay (:mod:`manyhands.design.levels.held_torque`).

The number of mixtures is the number of rungs to the power of the number of blocks. Two arguments avoid testing each.
If Phi_E joins no two blocks, (10) with its rows reordered is one condition for each block. A block's condition at its
rung is a part of the whole (10) of that rung, so that one proof for each rung is enough. If Phi_E <= 0, (10) is
blockdiag(D, V) > 0 plus [I; I] (-Phi_E) [I I] >= 0 for every mixture.

If two blocks share the ports of a device, the device may have a different gain kappa for each of them. Delta_D joins no
two blocks, so that the device's dissipation, and with it the form F_t of :mod:`manyhands.design.proof.device`, is
separate for each block.

Encoder steps are covered with one coupling. A change of rung has no impulse response whose peak gain could be summed.
So rungs whose certificates count on dry friction to cover steps are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from flint import fmpq

from manyhands.design.proof import contract, exact
from manyhands.design.proof.claim import Claim, read
from manyhands.design.proof.exact import Sparse
from manyhands.design.proof.finding import Finding, Verdict, weakest
from manyhands.design.proof.rational import rounded

_SHARED = ("period", "period_tolerance", "ports", "devices", "structure", "environment", "series", "speed")
_STRUCTURED = "Phi_E joins no two blocks, so that every mixture is made of conditions that (10) of a rung contains"
_PASSIVE = "Phi_E <= 0, so that (10) is positive for all levels that are"


@dataclass(frozen=True)
class LadderProof:
    """The findings about a ladder, given that each of its certificates is proved.

    Attributes:
        one_loop: the rungs are certificates of one loop, and their delays grow.
        together: (10) holds at every rung with the common Phi_E, so that all blocks may change at once.
        independent: (10) holds in every mixture, so that each block may change by itself.
    """

    one_loop: Finding
    together: Finding
    independent: Finding


def prove_ladder(rungs: Sequence[Mapping[str, Any]], common: int) -> LadderProof:
    """Prove the common claim of the rungs; :func:`manyhands.design.proof.prove` proves each rung by itself.

    Args:
        rungs: the plain data of the certificates, the shortest delay first.
        common: index of the rung whose Phi_E, with the storage that proves it, is to serve all rungs.

    Raises:
        ProofInputError: the data of a rung are no certificate of this version; the message names the key.
        ValueError: there are no rungs, or ``common`` is not the index of a rung.
    """
    if not 0 <= common < len(rungs):
        raise ValueError(f"found rung {common} of {len(rungs)}; expected one of them, counted from 0")
    claims = [read(data) for data in rungs]
    Phi_E = claims[common].Phi_E
    one_loop = _one_loop(claims)
    if not one_loop.holds:
        refused = Verdict(False, float("nan"), "the rungs are not of one loop")
        return LadderProof(one_loop, *(refused.finding(text) for text in (_TOGETHER, _INDEPENDENT)))
    together = _at_every_rung(claims, Phi_E)
    return LadderProof(
        one_loop,
        together.finding(_TOGETHER),
        _in_every_mixture(claims, claims[common], Phi_E, together).finding(_INDEPENDENT),
    )


_TOGETHER = "condition (10) at every rung, with the common Phi_E"
_INDEPENDENT = "condition (10) in every mixture of rungs, with the common Phi_E"


def _one_loop(claims: Sequence[Claim]) -> Finding:
    """The physical data of all rungs are equal to the last number, and tau grows."""
    condition = "the rungs are certificates of one loop, for growing delays"
    first = claims[0]
    for number, claim in enumerate(claims[1:], 1):
        different = [key for key in _SHARED if claim.data.get(key) != first.data.get(key)]
        if different or claim.blocks != first.blocks:  # equal mappings may differ in the order of the blocks
            argument = f"rung {number}: {different[0] if different else 'the order of structure'} is not rung 0's"
            return Finding(condition, False, float("nan"), 0.0, argument=argument)
    if any(claim.encoder is not None and claim.encoder.covered for claim in claims):
        argument = "dry friction covers encoder steps with one coupling, and not while a rung changes"
        return Finding(condition, False, float("nan"), 0.0, argument=argument)
    steps = [after.tau - before.tau for before, after in pairwise(claims)]
    least = min(steps, default=fmpq(1))
    return Finding(condition, bool(least > 0), rounded(least), 0.0, argument="compared")


def _at_every_rung(claims: Sequence[Claim], Phi_E: Sparse) -> Verdict:
    size = 2 * len(claims[0].ports)
    return weakest(
        {
            f"rung {number}": exact.definite_by_groups(contract.condition_10(replace(claim, Phi_E=Phi_E)), size)
            for number, claim in enumerate(claims)
        }
    )


def _in_every_mixture(claims: Sequence[Claim], claim: Claim, Phi_E: Sparse, together: Verdict) -> Verdict:
    """From (10) at every rung to every mixture, by the structure or the sign of Phi_E; all rungs need one Delta_D."""
    if not together.holds:
        return together
    shared = _sharing_a_device(claims[0])
    for number, other in enumerate(claims[1:], 1):
        if any(other.Delta_D[i].rational() != claims[0].Delta_D[i].rational() for i in shared):
            text = f"rung {number} states a different Delta_D from rung 0: a mixture could exceed the devices' promises"
            return Verdict(False, float("nan"), text)
    block_of = {port: number for number, block in enumerate(claim.blocks) for port in block.ports}
    if all(block_of[i] == block_of[j] for i, j in Phi_E):
        return Verdict(True, together.least, f"{_STRUCTURED}; {together.argument}")
    negated = exact.difference({}, Phi_E)
    passive = exact.definite_by_groups(negated, len(claim.ports), strict=False)
    if passive.holds:
        return Verdict(True, together.least, f"{_PASSIVE}; {passive.argument}")
    return Verdict(False, passive.least, "Phi_E joins blocks and is not proved to be <= 0")


def _sharing_a_device(claim: Claim) -> list[int]:
    """The blocks of V that have ports of a device in common with another block."""
    block_of = {port: number for number, block in enumerate(claim.blocks) for port in block.ports}
    blocks = [{block_of[port] for port in device.ports} for device in claim.devices]
    return sorted(set().union(*(own for own in blocks if len(own) > 1)))
