"""What the steps of encoders add to the forces of a linear loop, and when dry friction takes it up.

A coupling sees x + delta in place of a device's displacement x, and |delta_j| <= q_j/2 for an encoder with steps of q_j
(m). With V and E linear, and closed by x,

    f = Y x + Y delta,        |(Y delta)_i| <= w_i = sum_j ||y_ij||_1 q_j/2,

y_ij the impulse responses of Y = E (I + V E)^-1 from displacement (m) to force (N), and ||.||_1 their peak gains
(:mod:`manyhands.design.peak_gain`). Theorem 3 is about Y x. The rest is a force of at most w_i at every instant,
however long it is held, so that it does at most w_i |dx_i| of work. A device that burns at least c_i |v_i| besides
v' Delta_D v, with c_i >= w_i at every port, keeps the promise of its level towards Y x
(docs/decisions/0051-encoder-steps-and-friction.md has the proof). Without that friction nothing is promised about
energy, and w_i is the size of what is felt.

The bound needs Y, and so a world that is known as one linear system.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.levels.encoder import EncoderClaim
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.peak_gain import peak_gain
from manyhands.design.problem import HapticLoop

_ABOVE: Final = 1e-6
"""Of the force: what a proof in balls, which bounds the same sum from above, may find more than floats do."""


def not_covered(loop: HapticLoop) -> str:
    """Why no bound on the force of the encoders' steps is known for this loop, in words; empty where there is one."""
    world = loop.environment
    if world.declared_level is not None:
        return "of this world only a level is known, and not the forces that follow from displacements"
    if world.nominal is not world:
        return "the world is known up to intervals"
    return ""


def force_of_steps(loop: HapticLoop, blocks: Sequence[StateSpace]) -> Matrix | None:
    """The force w by port, N, slightly more; None where it is not known.

    :func:`not_covered` says why it is not, unless there are too many states, or their responses do not decay in time.

    Args:
        loop: the loop; its devices state the steps of their encoders.
        blocks: the realisation of each block of V, as it is run.
    """
    from manyhands.design.proof.quantisation import MOST_STATES  # needs the prover's libraries, which no guest has

    if not_covered(loop):
        return None
    Y = closed(loop.partition.join(tuple(blocks)), loop.cut.environment.environment(loop.period))
    if Y.order + len(loop.ports) > MOST_STATES:
        return None
    half = steps(loop) / 2.0
    bound = peak_gain(StateSpace(Y.A, Y.B * half, Y.C, Y.D * half)).sum(axis=1)
    return np.asarray(bound * (1.0 + _ABOVE)) if np.all(np.isfinite(bound)) else None


def encoder_claim(loop: HapticLoop, blocks: Sequence[StateSpace]) -> EncoderClaim | None:
    """The claim about the steps of the loop's encoders; None where no device states a step.

    Where the levels keep a part of the friction for the steps, that part is what is claimed.

    Raises:
        KeptTooLittle: the steps add more than that.
        Infeasible: the levels count on friction, and nothing bounds what the steps take of it.
    """
    if not np.any(steps(loop)):
        return None
    force = force_of_steps(loop, blocks)
    if loop.speed is None:
        if force is None:
            return EncoderClaim(None, False)
        return EncoderClaim(tuple(force.tolist()), bool(np.all(friction(loop) >= force)))
    if force is None:
        why = not_covered(loop) or "the responses of the loop do not decay in time"
        raise Infeasible(
            f"dry friction is to count below {loop.speed:g} {loop.units()('m/s')}, and what the encoders' steps take "
            f"of it is not known: {why}"
        )
    kept = np.array(loop.kept if loop.kept is not None else [0.0] * len(loop.ports))
    if np.any(force > kept):
        raise KeptTooLittle(force)
    return EncoderClaim(tuple(kept.tolist()), bool(np.all(friction(loop) >= kept)))


class KeptTooLittle(DesignError):
    """The steps of encoders add more to the forces than the levels keep of the dry friction.

    Attributes:
        force: what they add, by port, N.
    """

    def __init__(self, force: Matrix) -> None:
        super().__init__("the steps of the encoders add more than is kept of the dry friction")
        self.force = force


def closed(V: StateSpace, E: StateSpace) -> StateSpace:
    """Y = E (I + V E)^-1, from displacement (m) to force (N): f = E p, p = x - V f; states of V, then of E."""
    m, n_V = E.inputs, V.order
    N = np.linalg.inv(np.eye(m) + E.D @ V.D)
    C, D = np.hstack([-N @ E.D @ V.C, N @ E.C]), N @ E.D
    # p = x - C_V x_V - D_V f
    of_p = np.hstack([-V.C, np.zeros((m, E.order))]) - V.D @ C
    A = np.block(
        [[V.A, np.zeros((n_V, E.order))], [np.zeros((E.order, n_V)), E.A]],
    )
    A = A + np.vstack([V.B @ C, E.B @ of_p])
    return StateSpace(A, np.vstack([V.B @ D, E.B @ (np.eye(m) - V.D @ D)]), C, D)


def steps(loop: HapticLoop) -> Matrix:
    """The steps q by port, m; 0 where none is stated."""
    return _by_port(loop, "step")


def friction(loop: HapticLoop) -> Matrix:
    """The dry friction c by port, N; 0 where none is stated."""
    return _by_port(loop, "friction")


def _by_port(loop: HapticLoop, name: str) -> Matrix:
    out = np.zeros(len(loop.ports))
    for device in loop.devices:
        stated: tuple[float, ...] | None = getattr(device, name)
        if stated is not None:
            out[list(device.ports)] = stated
    return out
