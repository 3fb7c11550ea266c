"""`manyhands design`, part by part, and `verify` for a world and its parts.

Each part of a session is designed, proved and written by itself: the users in the tick, who are all where there is no
wave link; each site; and the world. A site's file depends on nothing but the site.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from manyhands.design.certificate import Certificate, certificate_of, read_plain, save
from manyhands.design.environments import environment_of
from manyhands.design.errors import CertificateError, DesignError, TriedChange
from manyhands.design.models.axis import Units
from manyhands.design.models.weights import Filter
from manyhands.design.world import CONDITION_A, World, save_world
from manyhands.launch.app.design_report import (
    CERTIFIED,
    INFEASIBLE,
    certificate_object,
    infeasible_object,
    interruptible,
    print_about,
    print_certificate,
    print_findings,
    progress_on,
    say_failing,
)
from manyhands.launch.files import EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED, EXIT_OK, TargetError, require_target
from manyhands.launch.look.display import could_help, say
from manyhands.launch.output import print_json
from manyhands.launch.plan.engine import engine_lines
from manyhands.launch.plan.feel import feel_lines
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.remedies import with_remedies
from manyhands.launch.plan.sites import IN_TICK, part, part_files, part_names, world
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.nodes.kernel.driver_statement import outside

if TYPE_CHECKING:
    from manyhands.design.synthesis import Designed


def require_parts(session: Session, output: Path | None, only: str | None) -> None:
    """Refuse a part that the session does not have, and files of its parts that cannot be written.

    Raises:
        TargetError: a file cannot be written, or the session has no part of that name.
    """
    names = part_names(session) if session.wave_links else ()
    if only is not None and only not in names:
        expected = f"one of {', '.join(names)}" if names else "a session with wave links"
        raise TargetError(f"--part: found {only!r}; expected {expected}")
    if output is not None and only is None:
        for file in part_files(session, output).values():
            require_target(file)


def run_design(
    session: Session,
    out: Console,
    err: Console,
    output: Path | None,
    pictures: Path | None,
    only: str | None,
    as_json: bool,
) -> int:
    """Design, prove, write and show the parts of a session, or one of them.

    Ctrl-C ends a search and keeps the best coupling so far, proved like any other; a second Ctrl-C ends at once.

    Args:
        session: the session.
        out: for results.
        err: for progress and messages.
        output: the file for the certificate of the world, or of the only part; those of the other parts are written
            beside it. With ``only``, the file for that part. None for no files.
        pictures: the folder for plots of a session without wave links; None for none.
        only: name of the only part to design; None for all.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    files = {} if output is None else {only: output} if only else part_files(session, output)
    for line in (*unstated_times(session), *engine_lines(session)):
        say(err, line)
    several, objects = bool(session.wave_links), dict[str, Any]()
    if several and pictures is not None:
        say(err, "no pictures: they show the environment's response, which a site does not know")
    code = EXIT_OK
    for name in part_names(session) if only is None else (only,):
        subject, what = (f"{session.name}: {name}", name) if several else (session.name, "the coupling")
        try:
            with interruptible() as asked, progress_on(err, f"designing {what}") as progress:
                designed = world(session, progress) if name == ENVIRONMENT else part(session, name).design(progress)
        except KeyboardInterrupt:
            before = f"{name} was certified" if several else "a coupling was found"
            say(err, f"{session.name}: interrupted before {before}")
            return EXIT_INTERRUPTED
        except DesignError as error:
            say(err, f"{subject}: not certified: {error}")
            objects[name] = _infeasible(session, error, could_help(err, with_remedies(error, session, name)))
            code = EXIT_NOT_CERTIFIED
            break
        objects[name] = _keep(designed, session.units(), files.get(name), out, err, as_json)
        for line in () if isinstance(designed, World) else feel_lines(session, [designed.certificate]):
            say(err, line)
        if pictures is not None and not isinstance(designed, World) and not several:
            _draw(designed, pictures, err)
        if asked or (not isinstance(designed, World) and designed.interrupted):
            say(err, f"{subject}: interrupted; this is the best coupling so far, and it is certified")
            code = EXIT_INTERRUPTED
            break
    if as_json:
        print_json(objects if several else objects[IN_TICK])
    elif code == EXIT_OK:
        for name, device in session.devices.items():
            if device.by_itself:
                say(out, outside(name, device.by_itself))
    return code


def unstated_times(session: Session) -> Iterator[str]:
    """A line for each device whose driver may have an age and a delay of which the session states neither."""
    for name, device in session.devices.items():
        if device.factory is not None and device.sample_age is None and device.actuation_delay is None:
            yield (
                f"warning: {name}: found no sample_age and no actuation_delay of its driver {device.factory}; expected "
                "those that manyhands check-driver prints, or sample_age: 0; launch refuses a driver that states more"
            )


def _infeasible(session: Session, error: DesignError, helps: Sequence[TriedChange]) -> dict[str, Any]:
    """The object that ``--json`` prints for a part that cannot be certified."""
    relax = {"relax": [str(one) for one in helps], "changes": [dict(one.changes) for one in helps]}
    if not session.wave_links:
        return infeasible_object(haptic_loop(session), str(error)) | relax
    return {"status": INFEASIBLE, "reason": str(error)} | relax


def _keep(
    designed: World | Designed, units: Units, path: Path | None, out: Console, err: Console, as_json: bool
) -> dict[str, Any]:
    """Write a part's certificate if it has a file, and print it; returns its object for ``--json``."""
    made = designed if isinstance(designed, World) else designed.certificate
    if path is not None:
        if isinstance(made, World):
            save_world(made, path)
        else:
            save(made, path)
    if not as_json:
        _print(out, made, units)
    if path is not None:
        say(err, f"written to {path}; prove it again with: manyhands verify {path}")
    return world_object(made) if isinstance(made, World) else certificate_object(made)


def _print(console: Console, made: World | Certificate, units: Units) -> None:
    if isinstance(made, Certificate):
        print_certificate(console, made)
        return
    console.print(f"world {made.id}")
    table = Table(title=f"{made.session}: the world keeps its contracts", title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row("wave links", "\n".join(f"{name} {link.id}" for name, link in made.wave_links.items()))
    if made.in_tick is not None:
        table.add_row("users in the tick", f"{', '.join(made.in_tick.ports)}: {made.in_tick.id}")
    table.add_row("assumes", f"T = {made.period:g} s")
    table.add_row(
        "margin of (A)", f"{made.margins[CONDITION_A]:.4f} {units('N·s/m')}{_strictness(made.margins[CONDITION_A])}"
    )
    console.print(table)


def _strictness(margin: float) -> str:
    return "" if margin > 0.0 else ": (A) holds, and is not strict"


def world_object(made: World) -> dict[str, Any]:
    """The object that ``--json`` prints for a world."""
    return {
        "status": CERTIFIED,
        "id": made.id,
        "margin": made.margins[CONDITION_A],
        "period": made.period,
        "wave_links": {
            name: {"id": link.id, "b": link.b.tolist(), "tank": link.tank} for name, link in made.wave_links.items()
        },
        "in_tick": None if made.in_tick is None else {"id": made.in_tick.id, "ports": list(made.in_tick.ports)},
    }


def _draw(designed: Designed, folder: Path, err: Console) -> None:
    """Draw the four plots of a design, and say where they are."""
    from manyhands.launch.app.design_plots import plot_design  # matplotlib takes a while to import

    certificate = designed.certificate
    if certificate.loop.environment.declared_level is not None:
        say(err, "no pictures: they show the environment's response, and of this one only its level is known")
        return
    loop, levels, claim = certificate.loop, certificate.levels, certificate.transparency
    embed = loop.partition.embed
    with progress_on(err, "drawing") as progress:
        paths = plot_design(
            folder,
            E=loop.cut.environment.environment(loop.period),
            blocks=certificate.blocks,
            partition=loop.partition,
            K=embed(loop.loop_gain(levels.device.kappa)),
            Delta_V=embed(levels.Delta_V),
            Phi_E=levels.Phi_E,
            Delta_G=levels.device.share * embed(levels.Delta_D),
            T=loop.period,
            ports=loop.ports,
            units=loop.units(),
            W1=None if claim is None else _at_points(claim.aim.W1),
            W2=None if claim is None else _at_points(claim.aim.W2),
            objective=None if claim is None else claim.aim.objective,
            gamma=None if claim is None else claim.gamma,
            counted=(loop.environment.environment(loop.period), loop.counted) if loop.series else None,
            history=designed.history,
            history_label=designed.watched,
            progress=progress,
        )
    say(err, "pictures: " + ", ".join(str(path) for path in paths))


def _at_points(weight: Filter) -> Callable[[complex], complex]:
    return lambda z: complex(weight.response(np.array([z]))[0])


def run_verify_world(
    file: Path,
    data: Mapping[str, Any],
    together: Sequence[Path],
    session: Session | None,
    out: Console,
    err: Console,
    as_json: bool,
) -> int:
    """Prove a world again, and that other certificates meet it by the contracts that it states.

    Args:
        file: of the world, for messages.
        data: its plain data.
        together: files of certificates of sites and of the users in the tick; each is proved, too.
        session: the session that the world and each part are to be of; None for none.
        out: for results.
        err: for progress and messages.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.

    Raises:
        CertificateError: a file is not a certificate.
    """
    from manyhands.design.proof import ProofInputError
    from manyhands.launch.plan.proofs import prove_parts

    others = {str(path): read_plain(path) for path in together}
    try:
        with progress_on(err, "proving") as progress:
            proof, parts = prove_parts(data, others, session, progress)
    except ProofInputError as error:
        raise CertificateError(f"{file}: {error}") from error
    failing = [(str(file), finding) for finding in proof.failing]
    failing += [(name, finding) for name, part in parts.items() for finding in part.failing]
    stated = [*data["wave_links"], *([IN_TICK] if data["in_tick"] is not None else [])]
    if as_json:
        status = INFEASIBLE if failing else CERTIFIED
        object_ = {"status": status, "id": data["id"], "margins": data["margins"], "parties": stated}
        print_json(object_ | {"together": len(others), "failing": [finding.condition for _, finding in failing]})
    else:
        print_findings(out, proof.findings)
        for name, other in others.items():
            print_about(out, Path(name), certificate_of(other, Path(name)))
    say_failing(err, failing)
    if failing:
        return EXIT_NOT_CERTIFIED
    if not as_json:
        proved = environment_of(data["environment"], tuple(data["ports"])).verdict("")
        say(out, f"{data['session']}: the world is {proved}; {data['id']}")
        say(out, f"its parties are {', '.join(stated)}; certificates that were proved together with it: {len(others)}")
    return EXIT_OK
