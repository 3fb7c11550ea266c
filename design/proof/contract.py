"""Condition (10), the contract between the parties, proved exactly: the levels over all ports, and the margins.

With G_hat (share Delta_D)-OSP, V_hat Delta_V-OSP and E_hat (-Phi_E)-ISP, Theorem 3 of [Bianchini2010]_ requires

    [ share Delta_D - Phi_E    -Phi_E         ]
    [ -Phi_E                   Delta_V - Phi_E ]  > 0.                                                       (10)

**The loop is well posed** by the same promises. Suppose (I + D_E D_V) x = 0, y = D_V x, x = -D_E y. At infinite
frequency the promises give x'p >= p' Delta_V p for p = (D_V - K) x/T, and T y' D_E y >= -y' Phi_E y. With q = K x/T,
y = T (q + p), K = kappa T Delta_D^-1,

    (q + p)' Phi_E (q + p) >= x'y/T = q' Delta_D q/kappa + x'p >= q' (share Delta_D) q + p' Delta_V p,

because share <= 1/(2 kappa) by F_0 >= 0. This contradicts (10) unless q = p = 0, and then x = 0.

A model with an enforced level is evaluated ahead of the tick, so that it has no D_E. Its controller exerts the force f
that solves f = f_m - alpha Z w(f), Z = T D_V^-1. The solution is unique for every alpha >= 0 because D_V + D_V' > 0:
the promises of V_hat give x'p >= 0 for p = (D_V - K) x/T, hence x' D_V x >= x' K x.
"""

from __future__ import annotations

from flint import fmpq

from manyhands.design.proof import exact, rational, statics, wave_link
from manyhands.design.proof.claim import Claim, HeldTorqueData, StatedSpringDamper
from manyhands.design.proof.coupling import loop_stiffness_limit
from manyhands.design.proof.exact import Sparse
from manyhands.design.proof.finding import Finding, Verdict
from manyhands.design.proof.linkage import MOST_PARTS, bends_at_most

_ALLOWED = fmpq(1, 10**6)  # relative: a stated margin may exceed the proved margin by this


def device_levels(claim: Claim) -> Sparse:
    """The devices' promised levels, m x m, with what dry friction adds, less what held torques may give out."""
    out = exact.block_diagonal([device.ports for device in claim.devices], claim.osp)
    for port, paid in enumerate(friction_damping(claim)):
        exact.add_entry(out, port, port, paid)
    for device, held in zip(claim.devices, claim.held, strict=True):
        if held is not None:
            for port in device.ports:
                exact.add_entry(out, port, port, -held_damping(held, claim))
    return out


def held_damping(held: HeldTorqueData, claim: Claim) -> fmpq:
    """The damping d = K_geo (lambda T + 3 tau)/2 that pays for what held torques give out, N*s/m.

    Only where :func:`held_findings` hold; :mod:`manyhands.design.levels.held_torque` has the formula's reasons.
    """
    longest = (1 + claim.period_tolerance) * claim.period
    K_geo = held.kappa * held.force / (1 - _turned(held, claim) / 2)
    return K_geo * (longest + 3 * claim.tau) / 2


def _turned(held: HeldTorqueData, claim: Claim) -> fmpq:
    """How far the tip may turn in one hold: kappa l, l = v (lambda T + tau), dimensionless."""
    return held.kappa * held.speed * ((1 + claim.period_tolerance) * claim.period + claim.tau)


def friction_damping(claim: Claim) -> list[fmpq]:
    """(c - w)/v* by port, N*s/m: below v* dry friction of c, less the w that encoder steps add, is such a damping.

    (c - w) |v| >= (c - w) v^2/v* for |v| <= v*. It is 0 where no speed is stated. That w is enough for the steps is a
    finding of :mod:`manyhands.design.proof.quantisation`.
    """
    out = [fmpq(0)] * len(claim.ports)
    if claim.speed is None or not claim.speed > 0:
        return out
    force = None if claim.encoder is None else claim.encoder.force
    for device, stated in zip(claim.devices, claim.friction, strict=True):
        for c, port in zip(stated or (), device.ports, strict=False):
            w = fmpq(0) if force is None else force[port]
            out[port] = max(c - w, fmpq(0)) / claim.speed
    return out


def speed_findings(claim: Claim) -> list[Finding]:
    """Where a claim holds below a speed: v* > 0, the steps of encoders leave known friction, and the speed is kept."""
    if claim.speed is None:
        return []
    steps_known = not any(claim.step) or (claim.encoder is not None and claim.encoder.covered)
    holds = claim.speed > 0 and any(claim.friction) and steps_known
    condition = "v* > 0, and dry friction counts as damping below it beside what encoder steps take"
    found = [Finding(condition, bool(holds), rational.rounded(claim.speed), 0.0, "", "exactly")]
    slower = f"every axis is slower than {rational.rounded(claim.speed):g} m/s"
    return [*found, Finding(slower, True, rational.rounded(claim.speed), 0.0, "", "of every motion", assumed=True)]


def held_findings(claim: Claim) -> list[Finding]:
    """Of each device that holds torques: its numbers are positive, kappa l < 2, and its linkage bends by kappa."""
    found = []
    bending: dict[str, Verdict] = {}
    distinct = {held.stated for held in claim.held if held is not None and held.linkage is not None}
    for device, held in zip(claim.devices, claim.held, strict=True):
        if held is None:
            continue
        turned = _turned(held, claim)
        holds = held.kappa > 0 and held.force > 0 and held.speed > 0 and turned < 2
        condition = f"{device.name} holds torques: kappa, F and v > 0, kappa v (lambda T + tau) < 2"
        if held.length is not None:
            holds, condition = holds and held.length > 0, f"{condition}, L > 0"
        found.append(Finding(condition, holds, rational.rounded(2 - turned), 0.0, "", "exactly"))
        if holds and held.linkage is not None:
            if held.stated not in bending:
                bending[held.stated] = bends_at_most(held.linkage, held.kappa, MOST_PARTS // len(distinct))
            verdict = bending[held.stated]
            found.append(
                verdict.finding(f"the tip of {device.name} bends by at most {rational.rounded(held.kappa):g}/m")
            )
    return found


def orientation_findings(claim: Claim) -> list[Finding]:
    """Of each device with an orientation: what it burns pays for its spring's torque, held from tick to tick.

    This is (3) of docs/decisions/0054-orientation.md, on all of SO(3). Torques that joints hold take L^2 d of it first,
    and without a length they are not covered; call this only where :func:`held_findings` hold. Where an orientation is
    sensed, no torque acts on the hand, and nothing has to be paid for.
    """
    found = []
    half = ((1 + claim.period_tolerance) * claim.period + 3 * claim.tau) / 2
    for device, held, own in zip(claim.devices, claim.held, claim.orientation, strict=True):
        if held is not None and held.length is not None and (own is None or own.osp is None):
            # kappa is of turns as well there, and what they give out is paid by turning
            condition = f"{device.name}, whose turns count by a length, burns by turning as well"
            found.append(Finding(condition, False, float("nan"), 0.0, "", "it states no osp of an orientation"))
        if own is None:
            continue
        if own.osp is None:
            condition = f"the orientation of {device.name} is sensed, without a torque: k > 0, and nothing is needed"
            found.append(Finding(condition, own.stiffness > 0, rational.rounded(own.stiffness), 0.0, "", "exactly"))
            continue
        spare, less = own.osp - own.stiffness * half, ""
        if held is not None and held.length is not None:
            spare, less = spare - held.length**2 * held_damping(held, claim), " - L^2 d"
        holds = own.osp > 0 and own.stiffness > 0 and spare >= 0
        condition = f"the orientation of {device.name}: b > 0, k > 0, k (lambda T + 3 tau)/2 <= b{less}"
        found.append(Finding(condition, bool(holds), rational.rounded(spare), 0.0, "", "exactly"))
        if held is not None and held.length is None:
            condition = f"{device.name} holds the torque of its orientation itself, and not torques of joints"
            found.append(Finding(condition, False, float("nan"), 0.0, "", "it has a linkage without a length"))
    return found


def Delta_D(claim: Claim) -> Sparse:
    """The level that the design counts on, m x m, with the structure of V."""
    return exact.block_diagonal([block.ports for block in claim.blocks], claim.Delta_D)


def Delta_V(claim: Claim) -> Sparse:
    """The level of V_hat, m x m."""
    return exact.block_diagonal([block.ports for block in claim.blocks], claim.Delta_V)


def condition_10(claim: Claim) -> Sparse:
    """The left-hand side of (10), 2m x 2m, N*s/m."""
    m = len(claim.ports)
    out: Sparse = {(i, j): claim.share * value for (i, j), value in Delta_D(claim).items() if claim.share != 0}
    for (i, j), value in Delta_V(claim).items():
        exact.add_entry(out, m + i, m + j, value)
    for (i, j), value in claim.Phi_E.items():
        for row in (i, m + i):
            for column in (j, m + j):
                exact.add_entry(out, row, column, -value)
    return out


def one_party_each(claim: Claim) -> Finding:
    """Every port belongs to one device and to one block."""
    m = len(claim.ports)
    faults = []
    for what, parts in (("device", claim.devices), ("block", claim.blocks)):
        times = [0] * m
        for part in parts:
            for port in part.ports:
                times[port] += 1
        faults += [f"{claim.ports[i]} is in {n} {what}s" for i, n in enumerate(times) if n != 1]
    argument = "; ".join(faults[:3]) if faults else "counted"
    return Finding("every port has one device and one block of V", not faults, float(-len(faults)), 0.0, "", argument)


def times(claim: Claim) -> Finding:
    """0 < T, 0 <= tau <= T; and 0 < rho <= 1 where periods longer than T are claimed."""
    T, tau, rho = claim.period, claim.tau, claim.period_tolerance
    holds, condition = T > 0 and 0 <= tau <= T, "0 < T and 0 <= tau <= T"
    if "period_tolerance" in claim.data:
        holds, condition = holds and 0 < rho <= 1, f"{condition}, 0 < rho <= 1"
    return Finding(condition, holds, rational.rounded(T) if holds else 0.0, 0.0, "", "exactly")


def device_findings(claim: Claim) -> list[Finding]:
    """The devices promise Delta_D, each device its own part if there is a delay; and Delta_D > 0.

    Different periods alone do not separate the devices: without a delay, the form needs only what they dissipate
    together, at least sigma^T Delta_D sigma/lambda.
    """
    held = [*speed_findings(claim), *held_findings(claim)]
    if all(finding.holds for finding in held):
        held += orientation_findings(claim)
    if not all(finding.holds for finding in held):
        return held
    m = len(claim.ports)
    level, promised = Delta_D(claim), device_levels(claim)
    verdict = exact.definite_by_groups(exact.difference(promised, level), m, strict=False)
    if claim.tau != 0:
        owner = {port: i for i, device in enumerate(claim.devices) for port in device.ports}
        if any(owner[i] != owner[j] for i, j in level):
            verdict = Verdict(
                False, float("nan"), "with a delay, Delta_D may not join devices: each has a delay of its own"
            )
    return [*held, verdict.finding("Delta_D <= the devices' levels"), _positive("Delta_D > 0", level, m, "Delta_D")]


def gains(claim: Claim) -> Finding:
    """The gain and share are admissible: kappa > 0, share > 0, c >= 0."""
    holds = claim.kappa > 0 and claim.share > 0 and claim.c >= 0
    return Finding("kappa > 0, share > 0, c >= 0", holds, float(holds) - 1.0, 0.0, argument="exactly")


def level_of_coupling(claim: Claim) -> Finding:
    """Delta_V > 0."""
    return _positive("Delta_V > 0", Delta_V(claim), len(claim.ports), "Delta_V")


def loop_condition(claim: Claim) -> Finding:
    """Condition (10), for all ports."""
    return _positive("condition (10)", condition_10(claim), 2 * len(claim.ports), "(10)")


def well_posed(promises: list[Finding], enforced: bool = False) -> Finding:
    """I + D_E D_V is regular, or the controller's force is unique; both follow if all ``promises`` hold."""
    missing = [finding.condition for finding in promises if not finding.holds]
    argument = "follows from the promises at infinite frequency and (10)"
    if missing:
        argument = f"not proved, because this condition is not: {missing[0]}"
    what = "the controller has one force" if enforced else "I + D_E D_V is regular"
    return Finding(f"the loop is well posed: {what}", not missing, 0.0, 0.0, argument=argument)


def _positive(condition: str, matrix: Sparse, size: int, key: str) -> Finding:
    """The finding ``matrix`` > 0, with its least eigenvalue in N*s/m for the reader."""
    verdict = exact.definite_by_groups(matrix, size, name="rows")
    least = exact.least_eigenvalue(matrix, size)
    return Finding(condition, verdict.holds, least, 0.0, key, verdict.argument)


def margin_findings(claim: Claim) -> list[Finding]:
    """Every stated margin is at most the true margin, up to a relative 1e-6.

    "(10)", "Delta_D" and "Delta_V" are least eigenvalues, N*s/m. "J" is the least eigenvalue of
    Delta_D/(2 kappa) - (T/2) K over the spring-damper blocks: their distance to the limit of their stiffness.
    "felt stiffness" is that of (V(1) + (R/2) b^-1)^-1 over a wave link of round trip R, N/m.
    """
    m = len(claim.ports)
    return [
        margin_finding(name, stated, _margin_matrix(claim, name), 2 * m if name == "(10)" else m)
        for name, stated in claim.margins.items()
    ]


def margin_finding(name: str, stated: fmpq, matrix: Sparse | None, size: int) -> Finding:
    """The finding that a stated margin is at most the least eigenvalue of ``matrix``, up to a relative 1e-6.

    Args:
        name: of the margin.
        stated: its value in the file.
        matrix: of this size; None if no margin of this name is defined.
        size: number of rows.
    """
    condition = f"the margin {name[:60]} is not overstated"
    if matrix is None:
        return Finding(condition, False, float("nan"), 0.0, "", "no margin of this name is defined here")
    bound = stated - abs(stated) * _ALLOWED
    least = exact.least_eigenvalue(matrix, size)
    shifted = dict(matrix)
    for i in range(size):
        exact.add_entry(shifted, i, i, -bound)
    verdict = exact.definite_by_groups(shifted, size, strict=False)
    return Finding(condition, verdict.holds, least, rational.rounded(bound), argument=verdict.argument)


def _margin_matrix(claim: Claim, name: str) -> Sparse | None:
    match name:
        case "(10)":
            return condition_10(claim)
        case "Delta_D":
            return Delta_D(claim)
        case "Delta_V":
            return Delta_V(claim)
        case wave_link.FELT_STIFFNESS:
            try:
                felt = wave_link.felt_stiffness(claim)
            except (ZeroDivisionError, statics.Undecided):
                return None
            if felt is None or felt != felt.transpose():
                return None
            rows = enumerate(felt.tolist())
            return {(i, j): value for i, row in rows for j, value in enumerate(row) if value != 0}
        case "J" if claim.kappa > 0:
            out: Sparse = {}
            for block, part, level in zip(claim.blocks, claim.coupling, claim.Delta_D, strict=True):
                if not isinstance(part, StatedSpringDamper):
                    return None
                J = loop_stiffness_limit(part, level, claim.kappa, claim.period).tolist()
                for i, row in zip(block.ports, J, strict=True):
                    for j, value in zip(block.ports, row, strict=True):
                        if value != 0:
                            exact.add_entry(out, i, j, value)
            return out
        case _:
            return None
