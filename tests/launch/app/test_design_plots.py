"""The pictures of a design show the systems' behaviour, and their files are whole or absent."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from manyhands.design import frequency_responses
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.launch.app import design_plots
from manyhands.launch.app.design_plots import closed_loop, coupling_response, frequencies, plot_design, response
from manyhands.launch.look import figures as kit

T = 1e-3
DELTA_D = 1.37 * np.eye(3)
PORTS = ("dx", "dy", "dz")
NETWORK = Network(
    PORTS,
    (("hub", 3.0),),
    (
        NetworkLink(("dx", "hub"), 3800.0, 0.1),
        NetworkLink(("dy", "hub"), 3500.0, 0.2),
        NetworkLink(("dz", "hub"), 3300.0, 0.3),
        NetworkLink(("hub", GROUND), 2600.0, 0.5),
    ),
)
EACH = Partition(("cx", "cy", "cz"), ((0,), (1,), (2,)))
MIXED = Partition(("cxz", "cy"), ((2, 0), (1,)))
C26 = SpringDamper(np.diag([704.9058, 704.9336, 704.8754]), np.diag([0.0372] * 3))
C28 = SpringDamper(np.diag([2735.5, 2734.6, 2735.5]), -1e-3 * np.diag([0.2648, 0.2798, 0.2838]))
JOINED = SpringDamper(np.array([[700.0, 0, -50], [0, 650, 0], [-50, 0, 600]]), np.diag([0.05] * 3))


def low_pass(z: complex) -> complex:
    """1/(1 + s/125) by backward Euler."""
    return 1.0 / (1.0 + (z - 1.0) / (T * z) / 125.0)


def level(coupling: SpringDamper) -> Matrix:
    """The greatest Delta_V in closed form."""
    Delta_D = 1.37 * np.eye(len(coupling.stiffness))
    J = Delta_D - coupling.stiffness * T / 2.0
    X = np.linalg.solve(J, Delta_D)
    return X.T @ (J + coupling.damping) @ X - Delta_D


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Every figure by the name of its file; nothing is written, which is most of the time."""
    kept: dict[str, Figure] = {}

    def keep(figure: Figure, path: Path) -> Path:
        kept[path.name] = figure
        return path

    monkeypatch.setattr(design_plots, "save", keep)
    return kept


def draw(folder: Path, coupling: SpringDamper = C26, partition: Partition = EACH, **changes) -> tuple[Path, ...]:
    arguments = {
        "E": NETWORK.environment(T),
        "blocks": tuple(part.realisation(T) for part in coupling.restrict(partition)),
        "partition": partition,
        "K": T / 2.0 * np.linalg.inv(DELTA_D),
        "Delta_V": level(coupling),
        "Phi_E": -0.4 * np.eye(3),
        "Delta_G": DELTA_D,
        "T": T,
        "ports": PORTS,
    }
    return plot_design(folder, **(arguments | changes))


def line(axes: Axes, label: str) -> tuple[Matrix, Matrix]:
    (found,) = [one for one in axes.get_lines() if one.get_label() == label]
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_four_pictures_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kit, "DPI", 30)  # the same, sooner
    said: list[str] = []
    paths = draw(tmp_path / "new" / "folder", history=[3.0, 0.2, 1e-5], progress=said.append)
    names = ["singular-values.png", "passivity.png", "structure.png", "convergence.png"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == sorted(names)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert len(said) == 5


def test_without_a_history_there_is_no_convergence(tmp_path: Path, figures: dict[str, Figure]) -> None:
    assert [path.name for path in draw(tmp_path)] == ["singular-values.png", "passivity.png", "structure.png"]
    assert set(figures) == {"singular-values.png", "passivity.png", "structure.png"}


def test_responses_are_those_of_the_systems() -> None:
    rng = np.random.default_rng(0)
    E, partition = NETWORK.environment(T), MIXED
    angles = rng.uniform(0.01, np.pi, 7)
    points = np.exp(1j * angles)
    blocks = tuple(part.realisation(T) for part in JOINED.restrict(partition))
    V = partition.join(blocks)
    for z, E_z, V_z in zip(points, response(E, angles), coupling_response(blocks, partition, angles), strict=True):
        np.testing.assert_allclose(E_z, E.response(z), rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(V_z, V.response(z), rtol=1e-9, atol=1e-15)
        F = closed_loop(E_z[None], V_z[None])[0]
        np.testing.assert_allclose(F + E_z @ V_z @ F, E_z, rtol=1e-8, atol=1e-6)
    static = StateSpace.static(np.array([[2.0, 1.0]]))
    np.testing.assert_array_equal(response(static, angles), np.broadcast_to([[2.0, 1.0]], (7, 1, 2)))


def test_chunks_do_not_change_the_response(monkeypatch: pytest.MonkeyPatch) -> None:
    E, angles = NETWORK.environment(T), np.linspace(0.1, 3.0, 50)
    whole = response(E, angles)
    monkeypatch.setattr(frequency_responses, "_CHUNK", 200)
    np.testing.assert_allclose(response(E, angles), whole, rtol=1e-13)


def test_frequencies_know_the_resonances() -> None:
    """A peak of a width of 1e-5 of its frequency is on the grid."""
    radius, angle = 1.0 - 1e-6, 0.1
    A = radius * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    omega = frequencies([StateSpace(A, np.eye(2), np.eye(2), np.zeros((2, 2)))], T)
    assert np.min(np.abs(omega * T - angle)) < 1e-9
    assert np.all(np.diff(omega) > 0.0)
    assert omega[-1] == pytest.approx(np.pi / T)
    assert omega[0] > 0.0


def test_the_level_of_example_2_is_reached_where_it_is(tmp_path: Path, figures: dict[str, Figure]) -> None:
    draw(tmp_path, C28, objective="loop-shaping", W1=low_pass, gamma=12.636)
    above, below = figures["singular-values.png"].axes
    omega, values = line(below, "W₁ E V W₂")
    assert np.max(values) == pytest.approx(12.636, abs=2e-3)
    assert omega[np.argmax(values)] == pytest.approx(66.4, abs=0.1)
    assert line(below, "level γ = 12.64")[1][0] == 12.636
    E = NETWORK.environment(T)
    omega, values = line(above, "E")
    assert values[100] == pytest.approx(np.linalg.norm(E.response(np.exp(1j * omega[100] * T)), 2))


def test_closed_loop_and_no_objective(tmp_path: Path, figures: dict[str, Figure]) -> None:
    draw(tmp_path, objective="closed-loop", W1=low_pass, W2=low_pass, gamma=1e4)
    above, below = figures["singular-values.png"].axes
    omega, values = line(below, "W₁ (F(E,V) − E) W₂")
    z = np.exp(1j * omega[200] * T)
    E = NETWORK.environment(T).response(z)
    V = EACH.join([part.realisation(T) for part in C26.restrict(EACH)]).response(z)
    F = np.linalg.inv(np.eye(3) + E @ V) @ E
    assert values[200] == pytest.approx(abs(low_pass(z)) ** 2 * np.linalg.norm(F - E, 2))
    assert line(above, "F(E,V)")[1][200] == pytest.approx(np.linalg.norm(F, 2))
    draw(tmp_path, objective="feasible")
    below = figures["singular-values.png"].axes[1]
    assert line(below, "E V")[1][200] == pytest.approx(np.linalg.norm(E @ V, 2))
    assert not [one for one in below.get_lines() if "level" in str(one.get_label())]


def test_passivity_is_seen_to_hold_and_to_fail(tmp_path: Path, figures: dict[str, Figure]) -> None:
    claim = "He V̂ − V̂* Δ_V V̂, promised ≥ 0"
    draw(tmp_path, Delta_V=0.999 * level(C26))
    above, below = figures["passivity.png"].axes
    assert np.min(line(above, "Ê + Φ_E, promised ≥ 0")[1]) > 0.0
    assert np.min(line(above, "Ê alone")[1]) == pytest.approx(0.463, abs=1e-3)  # the network's own reserve
    assert line(above, "−(devices' level), -1.37")[1][0] == -1.37
    assert claim in [str(one.get_label()) for one in below.get_lines()]
    assert not [one for one in below.get_lines() if "negative" in str(one.get_label())]
    draw(tmp_path, Delta_V=1.01 * level(C26), Phi_E=-0.5 * np.eye(3))
    above, below = figures["passivity.png"].axes
    assert np.min(line(above, "Ê + Φ_E, promised ≥ 0")[1]) < 0.0
    omega, _ = line(below, f"{claim}: negative")
    assert len(omega) > 0


def test_rounding_is_not_drawn(tmp_path: Path, figures: dict[str, Figure]) -> None:
    """At its greatest level V_hat has nothing left as w -> 0, where rounding has either sign."""
    draw(tmp_path, C28)
    below = figures["passivity.png"].axes[1]
    assert not [one for one in below.get_lines() if "negative" in str(one.get_label())]
    omega, values = line(below, "He V̂ − V̂* Δ_V V̂, promised ≥ 0")
    assert np.all(np.isnan(values[omega < 0.5]))
    assert np.all(np.isfinite(values[omega > 50.0]))


def test_structure_shows_blocks_and_exact_zeros(tmp_path: Path, figures: dict[str, Figure]) -> None:
    draw(tmp_path, JOINED, MIXED)
    axes = figures["structure.png"].axes[0]
    (image,) = axes.get_images()
    shown = image.get_array()
    static = np.linalg.inv(JOINED.stiffness)  # V(1)
    order = [2, 0, 1]
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), np.array([[0, 0, 1], [0, 0, 1], [1, 1, 0]], bool))
    np.testing.assert_allclose(shown.filled(0.0), np.abs(static[np.ix_(order, order)]), rtol=1e-9)
    assert [text.get_text() for text in axes.get_xticklabels()] == ["dz", "dx", "dy"]
    assert {"cxz", "cy"} <= {text.get_text() for text in axes.texts}
    assert len(axes.collections[0].get_paths()) == 2


def test_one_port_and_many(tmp_path: Path, figures: dict[str, Figure], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frequency_responses, "_PER_DECADE", 5)  # the same pictures, sooner
    for m in (1, 41):  # named, and too many to name
        ports = tuple(f"p{i}" for i in range(m))
        network = Network(ports, (), tuple(NetworkLink((port, GROUND), 500.0, 0.1) for port in ports))
        paths = draw(
            tmp_path,
            SpringDamper(600.0 * np.eye(m), 0.1 * np.eye(m)),
            Partition(ports, tuple((i,) for i in range(m))),
            E=network.environment(T),
            K=T / 2.0 / 1.37 * np.eye(m),
            Phi_E=np.zeros((m, m)),
            Delta_G=1.37 * np.eye(m),
            ports=ports,
        )
        assert len(paths) == 3
        assert ("p0" in [text.get_text() for text in figures["structure.png"].axes[0].get_xticklabels()]) == (m == 1)


@pytest.mark.parametrize(("limit", "value"), [("MOST_STATES", 4), ("MOST_PORTS", 2)])
def test_a_large_world_is_drawn_without_its_frequencies(
    tmp_path: Path, figures: dict[str, Figure], monkeypatch: pytest.MonkeyPatch, limit: str, value: int
) -> None:
    monkeypatch.setattr(design_plots, limit, value)
    said: list[str] = []
    paths = draw(tmp_path, history=[1.0], progress=said.append)
    assert [path.name for path in paths] == ["structure.png", "convergence.png"]
    assert "too large" in said[0]


def test_an_interrupt_leaves_the_older_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "singular-values.png").write_bytes(b"older")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def interrupted(_figure: Figure, file: BinaryIO, **_options: object) -> None:
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupted)
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path, C28)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_history_with_zeros_is_drawn(tmp_path: Path, figures: dict[str, Figure]) -> None:
    draw(tmp_path, history=[1.0, 0.0], history_label="γ")
    axes = figures["convergence.png"].axes[0]
    assert axes.get_yscale() == "linear"
    assert axes.get_ylabel() == "γ"
