"""The functions of ``import manyhands as mh``: what the commands do, for programs and notebooks.

Each function is what the command of its name calls. Quantities are in SI units. Errors have one line that names the
place, what was found and what would be right; the classes are those that the commands catch. A function that needs an
extra of the package begins with :func:`manyhands.extras.require`, which raises an ``ImportError`` without it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from manyhands.design.certificate import Certificate, certificate_of, content, read_plain
from manyhands.design.errors import CertificateError, DesignError
from manyhands.extras import explained, require
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.launch.session.session import whole_ticks
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.bundle import CLOCKS, REALTIME, SIMULATED
from manyhands.nodes.kernel.factory import is_shipped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import Console

    from manyhands.design.proof import Proof
    from manyhands.design.world import World
    from manyhands.launch.app.background import BackgroundRun
    from manyhands.launch.app.budget import DelayBudget
    from manyhands.launch.app.start import SettledForm
    from manyhands.launch.audit.simulation import Silence
    from manyhands.launch.plan.prepare import Prepared
    from manyhands.launch.recordings.recording import Recording
    from manyhands.launch.recordings.run import RecordedRun
    from manyhands.launch.run.options import StartOptions

Source = Session | str | Path | Mapping[str, Any]
"""A session; or its file, the name of a shipped one, or its data as a dict, as :func:`load` takes them."""

Progress = Callable[[str], None]
"""Called with what is being done, as a text."""


def load(source: Source, changes: Mapping[str, Any] | None = None) -> Session:
    """A session from a file, from the name of a shipped one, or from Python data.

    Args:
        source: a path; a name such as ``"example1"``, if no such file exists; a dict of the form of a session file,
            whose models and drivers may stand beside the script that runs; or a session, which is returned as it is.
        changes: values by path of keys, as ``--set`` takes them: ``{"design.tau": 0.0005}``.

    Raises:
        SessionError: the file, the data or a change are wrong.
        MissingExtra: the session has a hand or an environment whose passivity the extra ``design`` decides.

    Example:
        >>> import manyhands as mh
        >>> mh.load("example1")
        Session(example-1: T = 0.001 s, devices dx, dy, dz, couplings cx, cy, cz, environment network)
        >>> mh.load("example1", {"period": 0.0005}).period
        0.0005
    """
    with explained():
        if isinstance(source, Session):
            session = source
        elif isinstance(source, Mapping):
            session = Session.from_dict(source)
            if session.foreign_code and (script := _script_folder()) is not None:
                session = session.with_code_in(script)
        else:
            session = load_named(source)
        return session.replace(changes) if changes else session


def _script_folder() -> Path | None:
    """The folder of the script that runs, beside which its user's code stands; None at a prompt."""
    main = getattr(sys.modules.get("__main__"), "__file__", None)
    return None if main is None else Path(main).parent


@overload
def certify(session: Source, part: None = None, *, progress: Progress | None = None) -> Certificate: ...
@overload
def certify(  # type: ignore[overload-overlap]  # of all names of parts, this one alone gives a world
    session: Source, part: Literal["environment"], *, progress: Progress | None = None
) -> World: ...
@overload
def certify(session: Source, part: str, *, progress: Progress | None = None) -> Certificate: ...
def certify(session: Source, part: str | None = None, *, progress: Progress | None = None) -> Certificate | World:
    """Find the virtual coupling that a session asks for, and prove it.

    Args:
        session: the session, or what :func:`load` takes.
        part: for a session with wave links, the part to design: a coupling with a wave link, ``"in-tick"`` for all
            users without one, or ``"environment"``.
        progress: called with each step.

    Raises:
        Infeasible: no coupling of the class can be certified; its ``remedies`` are what helps, each tried.
        DesignError: no coupling was found, for another reason.
        ValueError: the session has no part of that name, or has wave links and no part is named.

    Example:
        >>> import manyhands as mh
        >>> certificate = mh.certify("example1")
        >>> certificate.stiffness.diagonal().round(1)      # N/m
        array([1110.2, 1110.2, 1110.2])
        >>> certificate.damping.diagonal().round(4)        # N·s/m
        array([0.2598, 0.2598, 0.2598])
        >>> certificate.save("example1.cert.json")
    """
    require("design")
    from manyhands.launch.plan import sites
    from manyhands.launch.plan.remedies import with_remedies

    loaded = _settled(load(session))
    names = sites.part_names(loaded)
    if not loaded.wave_links:
        if part is not None:
            raise ValueError(f"part: found {part!r}; expected none, since {loaded.name} has no wave links")
        part = sites.IN_TICK
    if part not in names:
        raise ValueError(
            f"part: found {part!r}; expected one of {', '.join(names)}, since {loaded.name} has wave links"
        )
    try:
        if part == ENVIRONMENT:
            return sites.world(loaded, progress)
        return sites.part(loaded, part).design(progress).certificate
    except DesignError as error:
        raise with_remedies(error, loaded, part) from None


def verify(
    certificate: Certificate | World | str | Path,
    session: Source | None = None,
    parts: Sequence[Certificate | str | Path] = (),
    *,
    progress: Progress | None = None,
) -> Proof:
    """Prove a certificate again, from its physical data, in exact and ball arithmetic.

    Args:
        certificate: the certificate, or its file; or those of a world.
        session: the session that it should belong to, or what :func:`load` takes; None for any.
        parts: for a world, certificates of its parts that should meet it; each is proved, too.
        progress: called with the name of each part of the proof.

    Returns:
        The findings; true if everything is proved.

    Raises:
        CertificateError: a file is no certificate.
        ValueError: parts are given for a certificate that is not a world's.

    Example:
        >>> import manyhands as mh
        >>> certificate = mh.certify("example1")
        >>> proof = mh.verify(certificate, "example1")
        >>> proof
        Proof(example-1: proved, 18 findings)
        >>> bool(mh.verify(certificate, mh.load("example1", {"devices.dx.osp": 1.0})))
        False
    """
    require("proof" if session is None else "design")
    from manyhands.design.proof import Proof, ProofInputError
    from manyhands.design.world import is_world
    from manyhands.launch.plan.proofs import prove_loop, prove_parts

    wanted = None if session is None else load(session)
    name, data = _plain_of(certificate)
    try:
        if is_world(data):
            others = dict(_plain_of(part) for part in parts)
            own, proofs = prove_parts(data, others, wanted, progress)
            findings = [(own.findings, "")] + [(proof.findings, f"{part}: ") for part, proof in proofs.items()]
            return Proof(own.subject, tuple(one.about(prefix) for found, prefix in findings for one in found))
        if parts:
            raise ValueError(f"parts: found some for {name}, which is no world; expected none")
        held = certificate if isinstance(certificate, Certificate) else certificate_of(data, Path(name))
        return prove_loop(held, data, wanted, progress)
    except ProofInputError as error:
        raise CertificateError(f"{name}: {error}") from error


def _plain_of(certificate: Certificate | World | str | Path) -> tuple[str, Mapping[str, Any]]:
    """A name for messages, and the plain data of the certificate's file."""
    if isinstance(certificate, Certificate):
        return f"certificate {certificate.id[:16]}", {"id": certificate.id, **content(certificate)}
    if isinstance(certificate, str | Path):
        return str(certificate), read_plain(Path(certificate))
    from manyhands.design.world import world_content

    return f"world {certificate.id[:16]}", {"id": certificate.id, **world_content(certificate)}


def budget(session: Source) -> DelayBudget:
    """The stiffness that can be certified for each device, over the delay inside the tick and the period.

    Nothing is designed: a budget shows before any design how much a shorter delay or period would gain.

    Raises:
        SessionError: the session is wrong.

    Example:
        >>> import manyhands as mh
        >>> mh.budget("example1")
        DelayBudget(example-1: T = 0.001 s, tau = 0 s, dx 2740 N/m, dy 2740 N/m, dz 2740 N/m)
        >>> mh.budget("example1").columns()["tau_s"][:6]
        array([0.      , 0.000125, 0.00025 , 0.0005  , 0.00075 , 0.001   ])
    """
    require("design")
    from manyhands.launch.app.budget import session_budget

    return session_budget(_settled(load(session)))


def simulate(
    session: Source,
    duration: float,
    *,
    certificate: Certificate | str | Path | None = None,
    uncertified: bool = False,
    silences: Sequence[Silence] = (),
    progress: Callable[[int], None] | None = None,
) -> RecordedRun:
    """Simulate a session in this process, as fast as it goes: the numbers are those of :func:`run`, bit for bit.

    A simulation shakes no hand, so that a session that cannot be certified is simulated too, with a warning.

    Args:
        session: the session, or what :func:`load` takes.
        duration: s.
        certificate: the certificate to run under, or its file; by default the session is designed.
        uncertified: whether an uncertified session is simulated without a warning.
        silences: which couplings fall silent, and when.
        progress: called every 1000 ticks with the number of ticks that are done.

    Raises:
        NotCertified: the certificate does not hold, or is another session's; or there is no coupling to simulate.
        CertificateError: the certificate cannot be read.
        ValueError: the duration, a silence or a site's period makes no sense.

    Example:
        >>> import manyhands as mh
        >>> run = mh.simulate("example1", 2.0)
        >>> run
        RecordedRun(example-1, simulated clock: 2000 ticks of 0.001 s, ports dx, dy, dz)
        >>> run.x.shape, float(abs(run.velocity).max().round(3))     # m; m/s
        ((2000, 3), 0.144)
    """
    require("design")
    from manyhands.launch.app.start import SettledForm
    from manyhands.launch.audit.simulation import require_one_period, simulate
    from manyhands.launch.run.options import StartOptions

    loaded = load(session)
    require_one_period(loaded)
    with _about("duration"):
        ticks = whole_ticks(loaded, duration, kept=True)
    prepared = _prepared(SettledForm(loaded), StartOptions(SIMULATED, certificate=_file(certificate), uncertified=True))
    if not prepared.certified and not uncertified:
        warnings.warn(f"{loaded.name} is not certified; launch refuses it without uncertified=True", stacklevel=2)
    return simulate(prepared, ticks, silences, progress)


def run(
    session: Source,
    duration: float | None = None,
    *,
    clock: str = REALTIME,
    transport: str = "ipc",
    certificate: Certificate | str | Path | None = None,
    uncertified: bool = False,
    record: str | Path | None = None,
    directory: str | Path | None = None,
) -> BackgroundRun:
    """Run every device, coupling and the environment as processes of this machine, for as long as a ``with`` block.

    The session starts when the block is entered, and ends when it is left, or after ``duration``. In real time a
    session that states no delay is designed for the one that is measured here, as the command does. On a machine with
    fewer processors than processes, each coupling runs in its device's process, unless the session states ``colocate``.

    Args:
        session: the session, or what :func:`load` takes.
        duration: s; None until the block is left, or ``stop`` is called.
        clock: "realtime" or "simulated".
        transport: "ipc" or "tcp", which is encrypted.
        certificate: the certificate to run under, or its file; by default the session is designed.
        uncertified: run even if nothing proves the session stable.
        record: the recording's file: ``.mcap``, ``.npz`` or ``.csv``.
        directory: a new folder that keeps session, certificate, report and logs.

    Raises:
        NotCertified: no certificate was found and ``uncertified`` is false; or the certificate does not hold.
        CertificateError, RecordingError, TargetError: a file cannot be read, or cannot be written.
        ProbeFailed: the delay of this machine could not be measured.
        RunFailed: a process failed; raised when the block is entered or left.
        ValueError: an argument makes no sense.

    Example:
        >>> import manyhands as mh
        >>> with mh.run("example1", 0.2, clock="simulated", record="run.mcap") as run:
        ...     run.wait()
        True
        >>> run.report["duration"], sorted(run.report["nodes"])[:3]
        (0.2, ['cx', 'cy', 'cz'])
        >>> mh.read("run.mcap").x.shape
        (200, 3)
    """
    require("design")
    from manyhands.launch.app.background import BackgroundRun
    from manyhands.launch.app.start import settle_form
    from manyhands.launch.run.options import StartOptions
    from manyhands.launch.run.supervised import require_files
    from manyhands.protocol.transport.zeromq import SCHEMES

    for name, value, valid in (("clock", clock, CLOCKS), ("transport", transport, SCHEMES)):
        if value not in valid:
            raise ValueError(f"{name}: found {value!r}; expected {' or '.join(valid)}")
    loaded = load(session)
    with _about("duration"):
        ticks = 0 if duration is None else whole_ticks(loaded, duration)
    options = StartOptions(
        clock,
        ticks,
        transport,
        certificate=_file(certificate),
        uncertified=uncertified,
        record=None if record is None else Path(record),
        directory=None if directory is None else Path(directory),
    )
    require_files(options)
    form = settle_form(loaded, options)
    prepared = _prepared(form, options)
    model = loaded.foreign_code.get("environment.model")
    if model is not None and not is_shipped(model.factory):
        warnings.warn(f"{loaded.name} runs the code of the model {model.factory}", stacklevel=2)
    return BackgroundRun(prepared, form.ways, options)


def read(path: str | Path) -> RecordedRun | Recording:
    """Read a recording: everything of an ``.mcap`` file, or x and f_v of a table: ``.npz``, ``.csv`` or ``.parquet``.

    Both results have ``session``, ``period``, ``ports``, ``time``, ``x``, ``f_v``, ``velocity``, ``columns()``,
    ``to_pandas()`` and ``save()``.

    Raises:
        RecordingError: the file cannot be read, or is no recording.

    Example:
        >>> import manyhands as mh
        >>> mh.simulate("example1", 0.1).save("run.npz")
        >>> mh.read("run.npz")
        Recording(example-1: 100 ticks of 0.001 s, ports dx, dy, dz)
    """
    from manyhands.launch.recordings.formats import RUN_SUFFIXES, STREAMED
    from manyhands.launch.recordings.recording import require_format
    from manyhands.launch.recordings.run import read_run
    from manyhands.launch.recordings.tables import read_saved

    file = Path(path)
    require_format(file, RUN_SUFFIXES)
    return read_run(file) if file.suffix == STREAMED else read_saved(file)


def plot(
    what: RecordedRun | Recording | Certificate | DelayBudget, quantity: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw a run over time, a design over frequency, or a budget over the delay.

    Quantities of a recording are its topics over time: ``"velocity"`` (the default), ``"sample"``, ``"force"``,
    ``"tool"``, ``"reaction"``, ``"tools"``, ``"masses"``, ``"orientations"``, ``"ledger"``, ``"interface"``,
    ``"wave"``, ``"tank"``; and ``"tau"``, a histogram. A certificate has ``"impedance"`` (the default), of the
    environment and as it is felt, and ``"structure"``, of V. A budget has each of its devices and wave links by name,
    by default the first device.

    Args:
        what: what to draw.
        quantity: which of its quantities.
        ax: the matplotlib axes to draw into; by default those of a new figure of pyplot.

    Returns:
        The axes.

    Raises:
        NotDrawable: the recording does not hold the quantity.
        ValueError: the quantity is none of the object's, or a certificate's environment has no matrices.

    Example:
        >>> import manyhands as mh
        >>> from matplotlib.figure import Figure
        >>> above, below = Figure().subplots(2, 1)
        >>> run = mh.simulate("example1", 0.5)
        >>> mh.plot(run, "sample", ax=above).get_ylabel(), mh.plot(run, "ledger", ax=below).get_ylabel()
        ('x [m]', 'E [J]')
    """
    require("plot")
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots(layout="constrained")[1]
    if isinstance(what, Certificate):
        _plot_certificate(what, quantity or "impedance", ax)
        return ax
    from manyhands.launch.app.budget import DelayBudget

    if isinstance(what, DelayBudget):
        _plot_budget(what, quantity, ax)
        return ax
    from manyhands.launch.look.plots import VELOCITY, draw_delays, draw_panel, picture_of_recording, picture_of_run
    from manyhands.launch.recordings.run import RecordedRun

    wanted = [quantity or VELOCITY]
    picture = picture_of_run(what, wanted) if isinstance(what, RecordedRun) else picture_of_recording(what, wanted)
    if picture.delays is not None:
        draw_delays(ax, picture.delays)
    else:
        draw_panel(ax, picture.time, picture.panels[0])
    return ax


def _plot_certificate(certificate: Certificate, quantity: str, ax: Axes) -> None:
    from manyhands.launch.app.design_plots import draw_impedances, draw_structure

    if quantity == "impedance":
        found = certificate.frequency_responses()
        draw_impedances(ax, found.omega, {"E": found.E, "F(E,V)": found.F}, certificate.loop.units())
    elif quantity == "structure":
        loop = certificate.loop
        static = loop.partition.embed([block.response(1.0).real for block in certificate.blocks])
        draw_structure(ax, static, loop.partition, loop.ports, loop.units())
    else:
        raise ValueError(f"quantity: found {quantity!r}; expected impedance or structure for a certificate")


def _plot_budget(budget: DelayBudget, name: str | None, ax: Axes) -> None:
    from manyhands.launch.app.budget import budget_keys, draw_budget, draw_wave_link

    devices = {device.name: device for device in budget.devices}
    links = {link.name: link for link in budget.wave_links}
    name = name or budget.devices[0].name
    if name in links:
        draw_wave_link(ax, links[name])
    elif name in devices:
        draw_budget(ax, budget, devices[name])
        ax.legend(handles=budget_keys(budget), fontsize="x-small", frameon=False)
    else:
        raise ValueError(f"quantity: found {name!r}; expected one of {', '.join([*devices, *links])}")


def _settled(session: Session) -> Session:
    """The session with the delay that it is designed for, measured on this machine if it asks for that."""
    from manyhands.launch.app.start import SettledForm, settle_delay
    from manyhands.launch.run.options import StartOptions

    return settle_delay(SettledForm(session), StartOptions(SIMULATED), _quiet(), warnings.warn).session


def _prepared(form: SettledForm, options: StartOptions) -> Prepared:
    """The session with its delay, its couplings and its certificates."""
    from manyhands.launch.app.start import settle_and_prepare

    return settle_and_prepare(form, options, _quiet(), warnings.warn)[1]


def _quiet() -> Console:
    """A console that shows nothing."""
    from rich.console import Console

    return Console(quiet=True)


def _file(certificate: Certificate | str | Path | None) -> Certificate | Path | None:
    return Path(certificate) if isinstance(certificate, str) else certificate


@contextmanager
def _about(argument: str) -> Iterator[None]:
    """Name the argument in a ValueError about its value."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{argument}: {error}") from None
