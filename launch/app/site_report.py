"""`manyhands design` and `verify` for a session with wave links: its sites, its users in the tick, and its world.

Each part is designed, proved and written by itself. A site's file depends on nothing but the site.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from manyhands.design.certificate import Certificate, certificate_of, read_plain, save
from manyhands.design.errors import CertificateError, DesignError, Infeasible
from manyhands.design.world import CONDITION_A, World, save_world
from manyhands.launch.app.design_report import (
    CERTIFIED,
    INFEASIBLE,
    certificate_object,
    interruptible,
    print_certificate,
    print_findings,
    print_request,
    progress_on,
)
from manyhands.launch.files import EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED, EXIT_OK, TargetError, require_target
from manyhands.launch.look.display import say
from manyhands.launch.output import print_json
from manyhands.launch.plan.sites import IN_TICK, in_tick, part_files, part_names, site, world
from manyhands.launch.session import ENVIRONMENT, Session


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


def run_design_parts(
    session: Session, out: Console, err: Console, output: Path | None, only: str | None, as_json: bool
) -> int:
    """Design, prove, write and show the parts of a session with wave links, or one of them.

    Args:
        session: the session.
        out: for results.
        err: for progress and messages.
        output: the file for the world's certificate, beside which those of the other parts are written; with ``only``,
            the file for that part. None for no files.
        only: name of the only part to design; None for all.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    objects: dict[str, Any] = {}
    files = {} if output is None else {only: output} if only else part_files(session, output)
    for name in part_names(session) if only is None else (only,):
        try:
            with interruptible() as asked, progress_on(err, f"designing {name}") as progress:
                if name == ENVIRONMENT:
                    made: World | Certificate = world(session, progress)
                    stopped = bool(asked)
                else:
                    part = in_tick(session) if name == IN_TICK else site(session, name)
                    designed = part.design(progress)
                    made, stopped = designed.certificate, designed.interrupted or bool(asked)
        except KeyboardInterrupt:
            say(err, f"{session.name}: interrupted before {name} was certified")
            return EXIT_INTERRUPTED
        except DesignError as error:
            reason = error.condition if isinstance(error, Infeasible) else str(error)
            relax = error.relax if isinstance(error, Infeasible) else ()
            objects[name] = {"status": INFEASIBLE, "reason": reason, "relax": list(relax)}
            if as_json:
                print_json(objects)
            say(err, f"{session.name}: {name}: not certified: {reason}")
            for way in relax:
                say(err, f"  could help: {way}")
            return EXIT_NOT_CERTIFIED
        objects[name] = _keep(made, files.get(name), err)
        if not as_json:
            _print(out, made)
        if stopped:
            say(err, f"{session.name}: interrupted; {name} has the best coupling so far, and it is certified")
            return EXIT_INTERRUPTED
    if as_json:
        print_json(objects)
    return EXIT_OK


def _keep(made: World | Certificate, path: Path | None, err: Console) -> dict[str, Any]:
    """Write a part's certificate if it has a file; returns its object for ``--json``."""
    if path is not None:
        if isinstance(made, World):
            save_world(made, path)
        else:
            save(made, path)
        say(err, f"written to {path}; prove it again with: manyhands verify {path}")
    return world_object(made) if isinstance(made, World) else certificate_object(made)


def _print(console: Console, made: World | Certificate) -> None:
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
    table.add_row("margin of (A)", f"{made.margins[CONDITION_A]:.4f} N·s/m{_strictness(made.margins[CONDITION_A])}")
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
            print_request(out, Path(name), certificate_of(other, Path(name)), session)
    for path, finding in failing:
        because = f" ({finding.argument})" if finding.argument else ""
        say(err, f"{path}: not proved: {finding.condition}: found {finding.value:.6g}{because}")
    if failing:
        return EXIT_NOT_CERTIFIED
    if not as_json:
        level = ", where the level of the environment is enforced at run time" if _enforced(data) else ""
        say(out, f"{data['session']}: the world is proved{level}; {data['id']}")
        say(out, f"its parties are {', '.join(stated)}; certificates that were proved together with it: {len(others)}")
    return EXIT_OK


def _enforced(data: Mapping[str, Any]) -> bool:
    return bool(data["environment"]["type"] == "declared")
