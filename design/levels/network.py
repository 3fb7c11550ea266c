"""The level that a spring-mass-damper network keeps by its physics alone: no program, sparse, up to a thousand ports.

The mechanical energy over T is a storage function of E_hat. In a tick with port velocities w and mass velocities v, a
network discretised by backward Euler dissipates at least

    [w; v]^T Z [w; v],       Z = B + T/2 K  >= 0       (K, B as in :mod:`manyhands.design.models.network`, ports first).

Hence Phi_E is admissible wherever Z + blockdiag(Phi_E, 0) >= 0. The least such Phi_E is -S, with S the Schur complement
of Z onto the ports. Z grows with every stiffness and damping and does not contain the masses, so a level that holds at
the lower ends of intervals holds for every network between them.

Z is a sum of links, and no link has a positive entry off the diagonal. Such a matrix is positive semidefinite when some
y > 0 has Z y >= 0 in every row [Berman1994]_. One sparse solve finds y, and one pass over the links checks it exactly.
:func:`structured_level` uses this for levels with the structure of V.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from manyhands.design.errors import SolverFailure
from manyhands.design.levels.environment import LoopMargins
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network
from manyhands.design.models.statespace import Matrix, symmetric_part

MOST_EXACT = 64  # size of a connected group, ports and masses, up to which an exact proof of its inequality is quick

_RESERVE = 1e-6  # part of the best margin given up; half of it becomes room in Z + blockdiag(Phi_E, 0)
_ROUNDING = 1e-12  # of a row's diagonal: a node with a smaller row sum has no link to ground
_INNER_SLACK = 1e-9  # of a mass's own Z: its row of Z y is above zero by this, so that rounding keeps it positive
_OUTER_SLACK = 1e-6  # part of a port's level given up for the same reason
_ITERATIONS = 60  # each a sparse solve; every level is valid, and soon within a few per cent of its limit
_COLUMNS = 128  # right-hand sides solved at a time, which bounds the dense memory


def link_matrices(network: Network) -> tuple[csc_array, csc_array]:
    """K (N/m) and B (N*s/m), (m+n) x (m+n) and sparse; ports first, then masses."""
    index = {name: i for i, name in enumerate([*network.ports, *(name for name, _ in network.masses)])}
    rows: list[int] = []
    columns: list[int] = []
    signs: list[float] = []
    of_link: list[int] = []
    for number, link in enumerate(network.links):
        ends = [(index[end], arm) for end, arm in zip(link.ends, link.arms, strict=True) if end != GROUND]
        for i, a in ends:
            for j, b in ends:
                rows.append(i)
                columns.append(j)
                signs.append(a * b if i == j else -a * b)
                of_link.append(number)
    shape = (len(index), len(index))
    weights = np.array([(link.stiffness, link.damping) for link in network.links]).reshape(-1, 2)
    entries = np.array(signs)[:, None] * weights[np.array(of_link, dtype=np.intp)]
    K, B = (coo_array((entries[:, i], (rows, columns)), shape=shape).tocsc() for i in (0, 1))
    return K, B


def dissipation_matrix(network: Network, T: float) -> csc_array:
    """Z = B + T/2 K, (m+n) x (m+n), sparse, N*s/m.

    Example:
        >>> from manyhands import passivity
        >>> wall = passivity.Network(("hand",), (), (passivity.NetworkLink(("hand", "ground"), 1000.0, 0.2),))
        >>> passivity.dissipation_matrix(wall, T=0.001).toarray().tolist()      # B + T K / 2, N*s/m
        [[0.7]]
    """
    K, B = link_matrices(network)
    Z = csc_array(B + T / 2.0 * K)
    Z.eliminate_zeros()
    return Z


def port_dissipation(Z: csc_array, m: int, together: Matrix | None = None) -> Matrix:
    """S = Z_uu - Z_uq Z_qq^{-1} Z_qu, m x m, N*s/m: E_hat is S-ISP, and Phi_E = -S is the least that Z admits.

    Args:
        Z: :func:`dissipation_matrix` of the network.
        m: number of ports.
        together: :meth:`.Network.together`; all 1 unless given.

    Raises:
        SolverFailure: links are so far apart that Z_qq is singular in floats.
    """
    tied = _tied_masses(Z, m, together)
    S = Z[:m, :m].toarray()
    if len(tied):
        Z_qu = csc_array(Z[tied][:, :m])
        solver = _factored(csc_array(Z[tied][:, tied]))
        for first in range(0, m, _COLUMNS):
            chosen = slice(first, first + _COLUMNS)
            S[:, chosen] -= Z_qu.T @ solver.solve(Z_qu[:, chosen].toarray())
    return symmetric_part(S)


def physical_level(
    network: Network, T: float, Delta_G: tuple[Matrix, ...], Delta_V: tuple[Matrix, ...], partition: Partition
) -> Matrix:
    """The Phi_E, proved by the network's energy, that leaves condition (10) the greatest margin.

    With Z in place of E_hat, S takes the place of H(w) in :mod:`manyhands.design.levels.environment`, and no search
    over the frequency is necessary. Each group of ports that links or blocks of V connect gets its own part of Phi_E.
    A group of more than :data:`MOST_EXACT` ports and masses gets Phi_E = 0, which needs no further proof. So does a
    group whose links are too far apart for floats.

    Args:
        network: the network; of a network known up to intervals, the one at all lower ends.
        T: period, s.
        Delta_G: level of the devices behind the transformation, block by block, N*s/m.
        Delta_V: level of V_hat, block by block, N*s/m.
        partition: of the ports.

    Returns:
        Phi_E, m x m with the structure, N*s/m; Z + blockdiag(Phi_E, 0) >= 0.
    """
    m, moves = partition.size, network.together()
    Z = dissipation_matrix(network, T)
    together = coo_array(
        (
            np.ones(m),
            ([p for block in partition.blocks for p in block], [block[0] for block in partition.blocks for _ in block]),
        ),
        shape=Z.shape,
    )
    _, group = connected_components(abs(Z) + together, directed=False)
    Phi = np.zeros((m, m))
    members: dict[int, list[int]] = {}
    for number, block in enumerate(partition.blocks):
        members.setdefault(int(group[block[0]]), []).append(number)
    for label, numbers in members.items():
        nodes = np.flatnonzero(group == label)
        if len(nodes) > MOST_EXACT:
            continue
        ports = [port for number in numbers for port in partition.blocks[number]]
        order = [*ports, *nodes[nodes >= m]]
        try:
            S = port_dissipation(csc_array(Z[order][:, order]), len(ports), moves[order])
        except SolverFailure:
            continue
        at = iter(range(len(ports)))
        blocks = tuple(tuple(next(at) for _ in partition.blocks[number]) for number in numbers)
        own = Partition(tuple(partition.names[number] for number in numbers), blocks)
        margins = LoopMargins(own.embed([Delta_G[i] for i in numbers]), own.embed([Delta_V[i] for i in numbers]), own)
        Phi[np.ix_(ports, ports)] = margins.level((1.0 - _RESERVE) * margins.limit(S))
    return Phi


def diagonal_level(network: Network, T: float) -> Matrix:
    """A level Phi_E = -diag(s_i), s_i >= 0, of a network that no other party has to serve: with it Phi_E <= 0.

    The s_i are equal and the greatest possible over each group of connected ports, up to :data:`MOST_EXACT` ports and
    masses. A larger group gets those of :func:`structured_level`. A group that floats freely gets 0.

    Args:
        network: the network; of a network known up to intervals, the one at all lower ends.
        T: period, s.

    Returns:
        Phi_E, m x m and diagonal, N*s/m; Z + blockdiag(Phi_E, 0) >= 0.
    """
    m, moves = len(network.ports), network.together()
    Z = dissipation_matrix(network, T)
    _, group = connected_components(Z, directed=False)
    kept = np.zeros(m)
    for label in np.unique(group[:m]):
        nodes = np.flatnonzero(group == label)
        ports = nodes[nodes < m]
        own = csc_array(Z[nodes][:, nodes])
        if len(nodes) > MOST_EXACT:
            singles = Partition(tuple(map(str, ports)), tuple((i,) for i in range(len(ports))))
            kept[ports] = [float(block[0, 0]) for block in structured_level(own, singles, together=moves[nodes]).blocks]
            continue
        try:
            values = np.linalg.eigvalsh(port_dissipation(own, len(ports), moves[nodes]))
        except SolverFailure:
            continue  # its ports keep nothing, which needs no proof
        if values[0] > _RESERVE * values[-1]:  # less may be rounding
            kept[ports] = (1.0 - _RESERVE) * values[0]
    return np.diag(-kept)


@dataclass(frozen=True, eq=False)
class StructuredLevel:
    """A level with the structure of V that a network of any size keeps by its physics: Phi_E = -blockdiag(blocks).

    Attributes:
        blocks: one m_i x m_i matrix >= 0 for each block of the partition, N*s/m.
        witness: y > 0, m + n entries. Z - blockdiag(blocks, 0) has no positive entry off its diagonal, and its product
            with y has no negative row; it is therefore positive semidefinite. A check adds up link by link.
    """

    blocks: tuple[Matrix, ...]
    witness: Matrix

    __repr__ = brief_repr


def structured_level(
    Z: csc_array, partition: Partition, weights: Matrix | None = None, together: Matrix | None = None
) -> StructuredLevel:
    """A level with the structure of V by weighted diagonal dominance, for networks of any size.

    Inverse iteration y = Z^{-1} (weights * y at the ports, 0 at the masses) keeps y > 0 and approaches the motion in
    which the network dissipates least for the weights. At every iterate y, the numbers (Z y)_i / y_i at the ports are a
    diagonal level, to which the links within a block are added. In the limit the numbers are s * weights with the
    greatest admissible s. A network that floats freely, without any link to ground, keeps no level.

    Args:
        Z: :func:`dissipation_matrix` of the network.
        partition: of its m ports.
        weights: m entries > 0, such as the devices' levels; the levels are to be proportional to them. None: all equal.
        together: :meth:`.Network.together`; all 1 unless given.

    Example:
        >>> from manyhands import passivity
        >>> wall = passivity.Network(("hand",), (), (passivity.NetworkLink(("hand", "ground"), 1000.0, 0.2),))
        >>> Z, each = passivity.dissipation_matrix(wall, 0.001), passivity.Partition(("c",), ((0,),))
        >>> passivity.structured_level(Z, each)
        StructuredLevel(blocks=(0.699999), witness=[1])
    """
    m, size = partition.size, Z.shape[0]
    _, component = connected_components(Z, directed=False)
    inner = _INNER_SLACK * Z.diagonal()
    load = np.concatenate([np.ones(m) if weights is None else weights, np.zeros(size - m)])
    solved = np.flatnonzero(np.isin(component, component[_grounded(Z, together)]))
    y = np.ones(size) if together is None else together.copy()
    kept = np.zeros(m)
    solver = None
    with suppress(SolverFailure):  # then the network keeps nothing
        solver = _factored(csc_array(Z[solved][:, solved])) if len(solved) else None
    if solver is not None:
        for _ in range(_ITERATIONS):
            y[solved] = solver.solve(((load + inner) * y)[solved])
            greatest = np.zeros(int(component.max()) + 1)
            np.maximum.at(greatest, component, y)
            y /= greatest[component]
        kept = (1.0 - _OUTER_SLACK) * (Z[:m] @ y) / y[:m]
    # A level as small as the masses' slack may be rounding: its component then keeps nothing, with y = 1 as witness.
    empty = np.isin(component, component[:m][kept <= inner[:m]])
    y[empty] = 1.0 if together is None else together[empty]
    kept = np.where(empty[:m], 0.0, kept)
    blocks = []
    for block in partition.blocks:
        ports = list(block)
        inside = (1.0 - _OUTER_SLACK) * Z[ports][:, ports].toarray()
        np.fill_diagonal(inside, 0.0)
        blocks.append(np.diag(kept[ports] - inside @ y[ports] / y[ports]) + inside)
    return StructuredLevel(tuple(blocks), y)


def _factored(Z: csc_array) -> SuperLU:
    try:
        return splu(Z)
    except RuntimeError as error:  # how scipy says that a factor is singular
        raise SolverFailure(f"the network's links are too far apart for floating point: {error}") from error


def _grounded(Z: csc_array, together: Matrix | None) -> NDArray[np.bool_]:
    """Which ports and masses have a link to ground: only that answers a motion in which no other link stretches."""
    moves = np.ones(Z.shape[0]) if together is None else together
    return np.asarray(Z @ moves > _ROUNDING * Z.diagonal() * moves)


def _tied_masses(Z: csc_array, m: int, together: Matrix | None) -> NDArray[np.intp]:
    """Indices of the masses whose part of Z is regular: all masses that links join to a port or to ground."""
    _, component = connected_components(Z, directed=False)
    anchored = _grounded(Z, together)
    anchored[:m] = True
    tied = np.isin(component, component[anchored])
    tied[:m] = False
    return np.flatnonzero(tied)
