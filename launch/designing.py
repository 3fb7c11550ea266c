"""What `manyhands design`, `verify` and `budget` do, from a loaded session or file to what is printed and written."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np
import typer
from rich.console import Console

from manyhands.design.certificate import load, save
from manyhands.design.differences import differences
from manyhands.design.errors import CertificateError, DesignError, Infeasible
from manyhands.design.weights import Filter
from manyhands.launch.display import say, status
from manyhands.launch.exits import EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED, EXIT_OK
from manyhands.launch.files import naming
from manyhands.launch.loop import coupling_request, haptic_loop
from manyhands.launch.preparation import certify
from manyhands.launch.session import Session
from manyhands.launch.summary import certificate_object, infeasible_object, print_certificate, print_findings

if TYPE_CHECKING:
    from manyhands.design.synthesis import Designed

Progress = Callable[[str], None]


def run_design(
    session: Session, out: Console, err: Console, output: Path | None, pictures: Path | None, as_json: bool
) -> int:
    """Design, prove, write and show a session's coupling.

    Ctrl-C ends a search and keeps the best coupling so far, proved like any other; a second one ends at once.

    Args:
        session: the session.
        out: for results.
        err: for progress and messages.
        output: where the certificate goes.
        pictures: folder for pictures.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    try:
        with interruptible() as asked, telling(err, "designing the coupling") as progress:
            designed = certify(session, progress)
    except KeyboardInterrupt:
        say(err, f"{session.name}: interrupted before a coupling was found")
        return EXIT_INTERRUPTED
    except DesignError as error:
        reason = error.condition if isinstance(error, Infeasible) else str(error)
        relax = error.relax if isinstance(error, Infeasible) else ()
        if as_json:
            print_json(infeasible_object(haptic_loop(session), reason, relax))
        say(err, f"{session.name}: not certified: {reason}")
        for way in relax:
            say(err, f"  could help: {way}")
        return EXIT_NOT_CERTIFIED
    certificate = designed.certificate
    if output is not None:
        with naming(output):
            save(certificate, output)
    if as_json:
        print_json(certificate_object(certificate))
    else:
        print_certificate(out, certificate)
        if output is not None:
            say(err, f"written to {output}; prove it again with: manyhands verify {output}")
    if pictures is not None and certificate.loop.enforced:
        say(err, "no pictures: they show how the environment responds, and of a model no more than its level is known")
    elif pictures is not None:
        with telling(err, "drawing") as progress:
            paths = _draw(designed, pictures, progress)
        say(err, "pictures: " + ", ".join(str(path) for path in paths))
    if designed.interrupted or asked:
        say(err, f"{session.name}: interrupted; this is the best coupling so far, and it is certified")
        return EXIT_INTERRUPTED
    return EXIT_OK


def _draw(designed: Designed, folder: Path, progress: Progress) -> tuple[Path, ...]:
    """The four pictures of a design."""
    from manyhands.launch.design_plots import plot_design  # matplotlib takes a while to import

    certificate = designed.certificate
    loop, levels, claim = certificate.loop, certificate.levels, certificate.transparency
    embed = loop.partition.embed
    return plot_design(
        folder,
        E=loop.environment.environment(loop.period),
        blocks=certificate.blocks,
        partition=loop.partition,
        K=embed(loop.loop_gain(levels.device.kappa)),
        Delta_V=embed(levels.Delta_V),
        Phi_E=levels.Phi_E,
        Delta_G=levels.device.share * embed(levels.Delta_D),
        T=loop.period,
        ports=loop.ports,
        W1=None if claim is None else _at_points(claim.aim.W1),
        W2=None if claim is None else _at_points(claim.aim.W2),
        objective=None if claim is None else claim.aim.objective,
        gamma=None if claim is None else claim.gamma,
        history=designed.history,
        history_label=designed.watched,
        progress=progress,
    )


def _at_points(weight: Filter) -> Callable[[complex], complex]:
    return lambda z: complex(weight.response(np.array([z]))[0])


def run_verify(file: Path, session: Session | None, out: Console, err: Console, as_json: bool) -> int:
    """Prove a certificate again, and that it is the session's where one is given.

    Returns:
        The exit code.

    Raises:
        CertificateError: the file is no certificate.
    """
    from manyhands.design.proof import Finding, ProofInputError, prove

    certificate, data = load(file)
    try:
        with telling(err, "proving") as progress:
            findings = prove(data, progress)
    except ProofInputError as error:
        raise CertificateError(f"{file}: {error}") from error
    if session is not None:
        found = differences(certificate, haptic_loop(session), coupling_request(session))
        findings += tuple(Finding(f"it is the session's: {text}", False, 1.0, 0.0) for text in found)
    failing = [finding for finding in findings if not finding.holds]
    if as_json:
        object_ = certificate_object(certificate, proved=not failing)
        print_json(object_ | {"failing": [finding.condition for finding in failing]})
    else:
        print_findings(out, findings)
    for finding in failing:
        because = f" ({finding.argument})" if finding.argument else ""
        say(err, f"{file}: not proved: {finding.condition}: found {finding.value:.6g}{because}")
    if failing:
        return EXIT_NOT_CERTIFIED
    if not as_json:
        enforced = ", ".join(certificate.loop.enforced)
        proved = f"proved, where the level of the {enforced} is enforced at run time" if enforced else "proved"
        say(out, f"{certificate.loop.session}: {proved}; certificate {certificate.id}")
    return EXIT_OK


def run_budget(session: Session, out: Console, err: Console, picture: Path | None, as_json: bool) -> int:
    """Show what stiffness the session's devices could certify against delay and period.

    Returns:
        The exit code.
    """
    from manyhands.launch.budget import budget, budget_object, plot_budget, print_budget

    found = budget(haptic_loop(session))
    if as_json:
        print_json(budget_object(found))
    else:
        print_budget(out, found)
    if picture is not None:
        plot_budget(found, picture)
        say(err, f"picture: {picture}")
    return EXIT_OK


def print_json(data: object) -> None:
    """One JSON object on standard output."""
    typer.echo(json.dumps(data, indent=2, allow_nan=False))


@contextmanager
def telling(err: Console, what: str) -> Iterator[Progress]:
    """A status line with what is being done, on a terminal."""
    with status(err, what) as update:
        yield lambda text: update(f"{what}: {text}")


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """While entered, the first Ctrl-C is a KeyboardInterrupt, which a search may answer with its best so far.

    Yields:
        The signals that came, so that a request is known even where something on its way has caught it.

    Raises:
        KeyboardInterrupt: it came, and nobody answered it; also where something on its way made another error of it.
    """
    asked: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        if len(asked) > 1:
            raise SystemExit(EXIT_INTERRUPTED)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, note)
    try:
        yield asked
    except Exception:
        if asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, before)
