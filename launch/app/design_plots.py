"""`manyhands design --plot DIR`: a finished design as four plots, and the frequency responses in them.

The plots show over frequency what the certificate claims by matrix inequalities: transparency as singular values below
a level, and passivity as least eigenvalues above zero. Two more show the structure of V as a map, and the convergence
of the synthesis. The plots prove nothing and need no solver: they are computed from the systems themselves, for many
frequencies at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from manyhands.design.frequency_responses import closed_loop, coupling_response, frequencies, response
from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.design.models.coupling import Partition
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.launch.look.figures import BLUE, GREEN, VERMILLION, new_figure, save

Complex = NDArray[np.complex128]
Filter = Callable[[complex], complex]
"""A weight's response at a point of the z plane."""


def shaped_response(
    E: Complex, V: Complex, F: Complex, points: Complex, W1: Filter | None, W2: Filter | None, objective: str | None
) -> tuple[str, Complex]:
    """The response that the objective keeps small, and its name: W1 E V W2, W1 (F - E) W2, or E V without one.

    Args:
        E: response of the environment, points x m x m.
        V: response of the coupling, points x m x m.
        F: response of the closed loop, points x m x m.
        points: z at each point.
        W1: weight on the left; None for 1.
        W2: weight on the right; None for 1.
        objective: "loop-shaping", "closed-loop", or anything else.
    """
    if objective not in ("loop-shaping", "closed-loop"):
        return "E V", E @ V
    weight = np.array([(W1(z) if W1 else 1.0) * (W2(z) if W2 else 1.0) for z in points])[:, None, None]
    if objective == "closed-loop":
        return "W₁ (F(E,V) − E) W₂", weight * (F - E)
    return "W₁ E V W₂", weight * (E @ V)


MOST_STATES, MOST_PORTS = 400, 100  # of E; above, the plots over frequency would take minutes and gigabytes

_ROUNDING = 1e-12  # relative rounding error of V_hat, from the difference V - K of nearly equal matrices
_NAMED_PORTS, _NAMED_BLOCKS, _WRITTEN_PORTS = 40, 24, 8  # above these numbers, a map has no such labels


def plot_design(
    folder: Path,
    *,
    E: StateSpace,
    blocks: tuple[StateSpace, ...],
    partition: Partition,
    K: Matrix,
    Delta_V: Matrix,
    Phi_E: Matrix,
    Delta_G: Matrix,
    T: float,
    ports: Sequence[str],
    units: Units = TRANSLATING,
    W1: Filter | None = None,
    W2: Filter | None = None,
    objective: str | None = None,
    gamma: float | None = None,
    counted: tuple[StateSpace, StateSpace] | None = None,
    history: Sequence[float] = (),
    history_label: str = "‖WZ − I‖",
    progress: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Draw a design into ``folder``, which is made if absent.

    Args:
        folder: where singular-values.png, passivity.png, structure.png and convergence.png go. The first two are left
            out above :data:`MOST_STATES` states or :data:`MOST_PORTS` ports, the last without a history.
        E: the environment, discrete, from displacement (m) to force (N).
        blocks: the blocks of V, discrete, from force (N) to displacement (m), in the partition's order.
        partition: the structure of V.
        K: gain of the loop transformation, m x m, m/N.
        Delta_V: level of the coupling, m x m, N*s/m.
        Phi_E: level of the environment, m x m, N*s/m.
        Delta_G: share Delta_D, the level of G_hat, m x m, N*s/m.
        T: period, s.
        ports: names of the m ports.
        units: of the ports.
        W1: weight on the left; None for 1.
        W2: weight on the right; None for 1.
        objective: "loop-shaping" for W1 E V W2, "closed-loop" for W1 (F(E,V) - E) W2; anything else shows E V.
        gamma: the level of the objective.
        counted: the world and C, if a part C of the world's compliance is counted in series: E and the blocks are then
            those that are run, and the objective is about the world and the blocks less C. None if nothing is counted.
        history: one number for each iteration of the synthesis.
        history_label: name of the quantity in ``history``.
        progress: called with what is being drawn, as a text.

    Returns:
        The paths of the plots.
    """
    report = progress or (lambda _text: None)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    if E.order > MOST_STATES or len(ports) > MOST_PORTS:
        report("pictures: none over frequency, the environment is too large")
    else:
        report("pictures: frequency responses")
        omega = frequencies([E, *blocks, *([] if counted is None else counted)], T)
        angles = omega * T
        points = np.exp(1j * angles)
        E_z, V_z = response(E, angles), coupling_response(blocks, partition, angles)
        F_z = closed_loop(E_z, V_z)
        world_z, own_z = (E_z, V_z)
        if counted is not None:
            world, C = counted
            world_z, own_z = response(world, angles), V_z - response(C, angles)
        label, shaped = shaped_response(world_z, own_z, F_z, points, W1, W2, objective)
        report("pictures: singular values")
        paths.append(plot_singular_values(folder, omega, {"E": world_z, "F(E,V)": F_z}, label, shaped, gamma, units))
        report("pictures: passivity")
        E_hat = (T * points / (points - 1.0))[:, None, None] * E_z
        V_hat = ((points - 1.0) / (T * points))[:, None, None] * (V_z - K)
        paths.append(plot_passivity(folder, omega, E_hat, Phi_E, V_hat, Delta_V, Delta_G, units))
    report("pictures: structure")
    static = coupling_response(blocks, partition, np.zeros(1))[0].real
    paths.append(plot_structure(folder, static, partition, ports, units))
    if len(history):
        report("pictures: convergence")
        paths.append(plot_convergence(folder, history, history_label))
    return tuple(paths)


def plot_singular_values(
    folder: Path,
    omega: NDArray[np.float64],
    impedances: Mapping[str, Complex],
    label: str,
    shaped: Complex,
    gamma: float | None,
    units: Units,
) -> Path:
    """singular-values.png: what the hands feel, E and F(E,V), above; what the objective keeps small, below.

    Args:
        folder: the folder of the file.
        omega: frequencies, rad/s.
        impedances: name and response (points x m x m, N/m).
        label: name of ``shaped``.
        shaped: points x m x m.
        gamma: the level to draw; None for none.
        units: of the ports.
    """
    figure = new_figure(8.0, 7.0)
    above, below = figure.subplots(2, 1, sharex=True)
    draw_impedances(above, omega, impedances, units)
    above.set_xlabel("")
    largest = _singular_band(below, omega, shaped, label, GREEN, "-")
    peak = int(np.argmax(largest))
    below.plot(omega[peak], largest[peak], "o", color=GREEN, markersize=5)
    if gamma is not None:
        below.axhline(gamma, color="black", linewidth=1.2, linestyle=":", label=f"level γ = {gamma:.4g}")
    text = f"{label}: largest {largest[peak]:.4g}, at {omega[peak]:.3g} rad/s"
    below.set_title(text, loc="left", fontsize="medium")
    below.set_ylabel("singular values")
    below.set_xlabel("frequency [rad/s]")
    below.set_xscale("log")
    below.set_yscale("log")
    _finish(below)
    return save(figure, folder / "singular-values.png")


def draw_impedances(axes: Axes, omega: NDArray[np.float64], impedances: Mapping[str, Complex], units: Units) -> None:
    """Draw the singular values of two impedances over frequency: that of the environment, and the one that is felt.

    Args:
        axes: where.
        omega: frequencies, rad/s.
        impedances: name and response (points x m x m, N/m).
        units: of the ports.
    """
    for (name, values), colour, line in zip(impedances.items(), (BLUE, VERMILLION), ("-", "--"), strict=True):
        _singular_band(axes, omega, values, name, colour, line)
    axes.set_xlabel("frequency [rad/s]")
    axes.set_ylabel(f"singular values [{units('N/m')}]")
    axes.set_title("stiffness: of the environment, and as the hands feel it", loc="left", fontsize="medium")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _finish(axes)


def plot_passivity(
    folder: Path,
    omega: NDArray[np.float64],
    E_hat: Complex,
    Phi_E: Matrix,
    V_hat: Complex,
    Delta_V: Matrix,
    Delta_G: Matrix,
    units: Units,
) -> Path:
    """passivity.png: each party's promise over frequency, as a least eigenvalue that must not be negative.

    The upper panel has He E_hat + Phi_E, and how far the devices' level Delta_G reaches below zero. The lower panel has
    He V_hat - V_hat* Delta_V V_hat.

    Args:
        folder: the folder of the file.
        omega: frequencies, rad/s.
        E_hat: response of the environment, points x m x m, N*s/m.
        Phi_E: its level, m x m, N*s/m.
        V_hat: response of the coupling, points x m x m, m/(N*s).
        Delta_V: its level, m x m, N*s/m.
        Delta_G: level of the devices behind their samplers, m x m, N*s/m.
        units: of the ports.
    """
    figure = new_figure(8.0, 7.0)
    above, below = figure.subplots(2, 1, sharex=True)
    bound = float(np.linalg.eigvalsh(Delta_G)[0])
    above.plot(omega, _least(E_hat), color=BLUE, linewidth=1.8, label="Ê alone")
    above.plot(
        omega, _least(E_hat + Phi_E), color=VERMILLION, linewidth=1.5, linestyle="--", label="Ê + Φ_E, promised ≥ 0"
    )
    above.axhline(0.0, color="black", linewidth=1.0)
    above.axhline(-bound, color="0.35", linewidth=1.2, linestyle=":", label=f"−(devices' level), {-bound:.3g}")
    above.set_yscale("symlog", linthresh=max(bound, 1e-300))  # linear near zero, logarithmic above
    above.set_ylabel(f"least eigenvalue of He [{units('N·s/m')}]")
    above.set_title(
        "environment: passive where Ê is above 0, not certifiable below the dotted line", loc="left", fontsize="medium"
    )
    supplied = np.conj(np.swapaxes(V_hat, 1, 2)) @ Delta_V @ V_hat
    rounding = _ROUNDING * np.linalg.norm(V_hat, axis=(1, 2))
    _signed(below, omega, _least(V_hat), rounding, "He V̂", BLUE, "-")
    _signed(below, omega, _least(V_hat - supplied), rounding, "He V̂ − V̂* Δ_V V̂, promised ≥ 0", VERMILLION, "--")
    below.set_ylabel(f"least eigenvalue [{units('m/(N·s)')}]")
    below.set_xlabel("frequency [rad/s]")
    below.set_title("coupling: output strictly passive at level Δ_V", loc="left", fontsize="medium")
    for axes in (above, below):
        axes.set_xscale("log")
        _finish(axes)
    return save(figure, folder / "passivity.png")


def plot_structure(folder: Path, static: Matrix, partition: Partition, ports: Sequence[str], units: Units) -> Path:
    """structure.png: |V(1)| entry by entry, with the ports of a block side by side and the blocks outlined.

    Args:
        folder: the folder of the file.
        static: V(1), m x m, m/N.
        partition: the structure of V.
        ports: names of the m ports.
        units: of the ports.
    """
    figure = new_figure(7.0, 6.0)
    draw_structure(figure.subplots(), static, partition, ports, units)
    return save(figure, folder / "structure.png")


def draw_structure(axes: Axes, static: Matrix, partition: Partition, ports: Sequence[str], units: Units) -> None:
    """Draw |V(1)| entry by entry as a map; arguments as of :func:`plot_structure`."""
    order = [port for block in partition.blocks for port in block]
    shown = np.abs(static[np.ix_(order, order)])
    m = len(order)
    masked = np.ma.masked_equal(shown, 0.0)  # exact zeros stay white
    least, most = (float(masked.min()), float(masked.max())) if masked.count() else (1.0, 1.0)
    colours = colormaps["cividis"].reversed()
    image = axes.imshow(masked, cmap=colours, norm=LogNorm(least / 1.001, most * 1.001), interpolation="nearest")
    if axes.figure is not None:
        axes.figure.colorbar(image, ax=axes, label=f"|V(1)| [{units('m/N')}]", shrink=0.8)
    outlines, at = [], 0
    for name, block in zip(partition.names, partition.blocks, strict=True):
        size = len(block)
        outlines.append(Rectangle((at - 0.5, at - 0.5), size, size))
        if 1 < len(partition.blocks) <= _NAMED_BLOCKS:
            side = "left" if at + size / 2 < m / 2 else "right"
            x = at + size - 0.35 if side == "left" else at - 0.65
            axes.text(x, at + size / 2 - 0.5, name, ha=side, va="center", color=VERMILLION, fontsize="small")
        at += size
    axes.add_collection(PatchCollection(outlines, facecolor="none", edgecolor=VERMILLION, linewidth=1.8))
    if m <= _NAMED_PORTS:
        names = [ports[port] for port in order]
        axes.set_xticks(range(m), names, rotation=90 if max(map(len, names)) > 3 and m > 6 else 0)
        axes.set_yticks(range(m), names)
    if m <= _WRITTEN_PORTS:
        middle = np.sqrt(least * most)
        for i, j in zip(*np.nonzero(shown), strict=True):
            ink = "white" if shown[i, j] > middle or least == most else "black"
            axes.text(j, i, f"{shown[i, j]:.3g}", ha="center", va="center", color=ink, fontsize="small")
    axes.set_xlabel("force at port")
    axes.set_ylabel("displacement at port")
    count = len(partition.blocks)
    text = f"structure of V: {count} block{'s' if count > 1 else ''}, {m} port{'s' if m > 1 else ''}; white is zero"
    axes.set_title(text, loc="left", fontsize="medium")


def plot_convergence(folder: Path, history: Sequence[float], label: str) -> Path:
    """convergence.png: one number for each iteration.

    Args:
        folder: the folder of the file.
        history: the numbers; the axis is logarithmic if all are positive.
        label: name of the quantity.
    """
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    axes.plot(range(1, len(history) + 1), history, "o-", color=BLUE, markersize=4, linewidth=1.4, label=label)
    if min(history) > 0.0:
        axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("iteration")
    axes.set_ylabel(label)
    axes.set_title(f"convergence: {history[-1]:.4g} after {len(history)}", loc="left", fontsize="medium")
    axes.grid(alpha=0.3, which="both")
    return save(figure, folder / "convergence.png")


def _singular_band(
    axes: Axes, omega: NDArray[np.float64], values: Complex, name: str, colour: str, line: str
) -> NDArray[np.float64]:
    """Draw the largest singular value as a line, and the range down to the least one as a band; return the largest."""
    singular = np.linalg.svd(values, compute_uv=False)
    axes.plot(omega, singular[:, 0], color=colour, linewidth=1.8, linestyle=line, label=name)
    if singular.shape[1] > 1:
        axes.fill_between(omega, singular[:, -1], singular[:, 0], color=colour, alpha=0.15, linewidth=0.0)
    return np.asarray(singular[:, 0])


def _least(values: Complex) -> NDArray[np.float64]:
    """The least eigenvalue of the Hermitian part at each point."""
    return np.asarray(np.linalg.eigvalsh((values + np.conj(np.swapaxes(values, 1, 2))) / 2.0)[:, 0])


def _signed(
    axes: Axes,
    omega: NDArray[np.float64],
    values: NDArray[np.float64],
    rounding: NDArray[np.float64],
    name: str,
    colour: str,
    line: str,
) -> None:
    """Draw positive values as a line on a logarithmic axis, and negative ones as crosses at their magnitude.

    A value whose magnitude is below ``rounding`` has no reliable sign and is not drawn.
    """
    axes.set_yscale("log")
    axes.plot(
        omega, np.where(values > rounding, values, np.nan), color=colour, linewidth=1.6, linestyle=line, label=name
    )
    negative = values < -rounding
    if np.any(negative):
        label = f"{name}: negative"
        axes.plot(omega[negative], -values[negative], "x", color=colour, markersize=5, label=label)


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    axes.legend(loc="best", fontsize="small", framealpha=0.9, edgecolor="none")
