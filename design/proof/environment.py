"""The environment's promise: E_hat is (-Phi_E)-ISP, by the network's energy or by a storage matrix.

Or by neither: what is declared and enforced at run time is no more than found to be what the certificate counts on.
"""

from __future__ import annotations

from flint import arb_mat, fmpq

from manyhands.design.proof import balls, network, sparse, statics
from manyhands.design.proof.finding import Finding, Verdict
from manyhands.design.proof.physical import DeclaredData, DynamicsData, EnvironmentData, NetworkData, SystemData
from manyhands.design.proof.reading import MAX_DENSE, Table
from manyhands.design.proof.sparse import Sparse
from manyhands.design.proof.split import Split, delayed, dissipation, split_system
from manyhands.design.proof.statics import Undecided
from manyhands.design.proof.system import NotDiscretised, discrete, realised, transfer_order

_ISP = "E_hat is (-Phi_E)-ISP, (14)"


def order(data: DynamicsData, m: int) -> int:
    """Number of states of Rest, with those of the delay."""
    match data:
        case NetworkData():
            own = network.order(data)
        case SystemData():
            own = data.A.rows
        case _:
            own = transfer_order(data)
    return own + m * data.delay


def split(data: DynamicsData, T: fmpq) -> Split:
    """E_hat split, with its delay; a network in the middle of its intervals.

    Raises:
        ZeroDivisionError: a matrix is not proved regular.
        NotDiscretised: the discrete environment does not exist.
        Undecided: it has no static stiffness.
    """
    match data:
        case NetworkData():
            own = network.split(data, T)
        case SystemData():
            own = split_system(*discrete(data, T), arb_mat(statics.of_environment(data)), T)
        case _:
            own = split_system(*realised(data, T), arb_mat(statics.of_environment(data)), T)
    return delayed(own, data.delay, T)


def findings(data: EnvironmentData, P: Table | None, Phi_E: Sparse, m: int, T: fmpq) -> list[Finding]:
    """Whether E_hat is (-Phi_E)-ISP with the storage matrix P, or with its energy where P is None."""
    if isinstance(data, DeclaredData):
        return [_declared(data, Phi_E, m)]
    out = []
    if isinstance(data, NetworkData):
        physics = network.physical(data)
        condition = "masses are positive, no stiffness and no damping is negative"
        out.append(Finding(condition, physics.holds, physics.least, 0.0, argument=physics.argument))
        if not physics.holds:
            return [*out, _refused("the network is not a physical one")]
        if P is None and data.delay == 0:
            verdict = network.energy(data, Phi_E, T)
            because = "mechanical energy: monotone in every stiffness and damping, whatever the masses are"
            return [*out, verdict.finding(_ISP, because)]
        if P is not None and data.uncertain:
            return [*out, _refused("intervals need the energy: a storage matrix covers one network alone")]
    if P is None:
        return [*out, _refused("only a network without delay has its energy as a storage")]
    size = order(data, m)
    if size + m > MAX_DENSE:
        return [*out, _refused(f"{size} states and {m} ports are too many for a dense proof (at most {MAX_DENSE})")]
    if P.rows != size:
        return [*out, _refused(f"the storage matrix has {P.rows} rows, Rest has {size} states")]
    return [*out, *_matrix_findings(data, P, Phi_E, m, T)]


def _declared(data: DeclaredData, Phi_E: Sparse, m: int) -> Finding:
    """What is enforced at run time is at least as strict as the level that (10) is proved with."""
    declared: Sparse = {}
    sparse.add(declared, range(m), data.level)
    verdict = sparse.definite_by_groups(sparse.difference(Phi_E, declared), m, strict=False)
    if not verdict.holds:
        return _refused(f"the declared level is not proved to be at most Phi_E: {verdict.argument}")
    return Finding(_ISP, True, 0.0, 0.0, argument="not proved: enforced at run time by a controller", enforced=True)


def _refused(argument: str) -> Finding:
    return Finding(_ISP, False, float("nan"), 0.0, argument=argument)


def _matrix_findings(data: DynamicsData, stated: Table, Phi_E: Sparse, m: int, T: fmpq) -> list[Finding]:
    condition = "the static stiffness E1 = E(1) is symmetric and >= 0"
    if isinstance(data, NetworkData):
        static = Verdict(True, 0.0, "as a Schur complement of the network's K >= 0")
    else:
        try:
            static = statics.semidefinite(statics.of_environment(data))
        except Undecided as error:
            static = Verdict(False, float("nan"), str(error))
    if not static.holds:
        return [static.finding(condition)]
    conditions = {"P": "E_hat's storage matrix is positive", "M_E": _ISP}

    def test() -> dict[str, Verdict]:
        try:
            rest = split(data, T)
        except (NotDiscretised, Undecided) as error:
            return {"": Verdict(False, float("nan"), str(error))}
        P = balls.symmetrised(stated.witness())
        level = arb_mat(sparse.dense(Phi_E, range(m)))
        return {
            "P": balls.definite(P),
            "M_E": balls.definite(dissipation(rest, P, level, T)),
        }

    found = balls.all_decided(stated.rows + m, test)
    if "" in found:
        return [_refused(found[""].argument)]
    because = {"M_E": "M_E < 0: a storage matrix for E_hat less its integrators; E is stable with it"}
    proved = [verdict.finding(conditions[name], because.get(name, "")) for name, verdict in found.items()]
    return [static.finding(condition), *proved]
