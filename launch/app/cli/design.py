"""The commands that design and prove: design, verify, budget, sweep."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from manyhands.design.certificate import read_plain
from manyhands.design.world import is_world
from manyhands.extras import require
from manyhands.launch.app.cli.common import (
    Json,
    Overrides,
    SessionPath,
    end,
    err,
    errors,
    out,
    part_names,
    refuse,
    require_folder,
    session_files,
    session_keys,
    time_of,
)
from manyhands.launch.app.design_report import run_budget, run_own_budget, run_verify
from manyhands.launch.app.own_device import OwnDevice
from manyhands.launch.app.parts_report import require_parts, run_design, run_verify_world
from manyhands.launch.files import EXIT_FAILED, require_target
from manyhands.launch.look.display import progress_bar, say
from manyhands.launch.recordings.recording import require_suffix
from manyhands.launch.run.options import StartOptions
from manyhands.launch.session.shipped import load_named
from manyhands.launch.session.yaml import read_choices
from manyhands.nodes.kernel.bundle import SIMULATED

commands = typer.Typer()


@commands.command(epilog="Example: manyhands design example1.yaml -o example1.cert.json")
def design(
    session: SessionPath,
    output: Annotated[Path | None, typer.Option("-o", metavar="CERT", help="Write the certificate here.")] = None,
    pictures: Annotated[
        Path | None, typer.Option("--plot", metavar="DIR", help="Draw the design into this folder.")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            "--part",
            metavar="NAME",
            help="With wave links: design one part, a coupling's site, in-tick or environment.",
            autocompletion=part_names,
        ),
    ] = None,
    overrides: Overrides = [],  # noqa: B006 -- typer reads the default and makes its own list
    as_json: Json = False,
) -> None:
    """Find a virtual coupling, prove it, and write the certificate. Exit code 3: infeasible.

    A session with wave links has a certificate for each site, one for the users in the tick, and one for its world,
    which is written to CERT; the others stand beside it, under the name of their part.

    Ctrl-C ends a long search and keeps the best coupling so far, proved like any other (exit code 130).
    """
    with errors("design"):
        from manyhands.launch.app.start import SettledForm, settle_delay

        if pictures is not None:
            require("plot")
        loaded = load_named(session, overrides)
        require_parts(loaded, output, part)
        if output is not None:
            require_target(output)
        require_folder(pictures)
        loaded = settle_delay(SettledForm(loaded), StartOptions(SIMULATED), err).session
        end(run_design(loaded, out, err, output, pictures, part, as_json))


@commands.command(name="verify", epilog="Example: manyhands verify example1.cert.json --session example1.yaml")
def verify_command(
    certificate: Annotated[Path, typer.Argument(metavar="CERT", help="A certificate file.")],
    session: Annotated[
        Path | None,
        typer.Option(
            "--session",
            metavar="SESSION",
            help="Also check that it belongs to this session.",
            autocompletion=session_files,
        ),
    ] = None,
    together: Annotated[
        list[Path], typer.Option("--with", metavar="CERT", help="Of a world: also prove this part of it; repeatable.")
    ] = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Prove a certificate again, from its physical data in exact and ball arithmetic. Exit code 3: not proved.

    For a world, --with also proves that the certificates of sites, or of the users in the tick, meet it. With
    --session, the world and each of them is compared with its part of the session.
    """
    with errors("proof" if session is None else "design"):  # without SciPy a session is not read with all its checks
        loaded = None if session is None else load_named(session, [])
        data = read_plain(certificate)
        if is_world(data):
            end(run_verify_world(certificate, data, together, loaded, out, err, as_json))
        elif together:
            refuse(f"--with: found {certificate}, which is no world's certificate; expected that of a world")
        else:
            end(run_verify(certificate, loaded, out, err, as_json))


@commands.command(epilog="Example: manyhands budget --osp 0.05 --rate 1000")
def budget(
    session: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SESSION]", help="A session file; none where --osp states a device.", autocompletion=session_files
        ),
    ] = None,
    osp: Annotated[float | None, typer.Option(metavar="N·s/m", help="What the device surely damps.")] = None,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Of the loop.")] = OwnDevice.rate,
    delay: Annotated[
        str | None, typer.Option(metavar="TIME", help="From a sample to the force that answers it; else several.")
    ] = None,
    jitter: Annotated[
        str | None, typer.Option(metavar="TIME", help="By how much the age of a sample varies at most.")
    ] = None,
    friction: Annotated[float, typer.Option(metavar="N", help="Its least dry friction.")] = OwnDevice.friction,
    step: Annotated[float, typer.Option(metavar="M", help="Of its encoder.")] = OwnDevice.step,
    speed: Annotated[
        float | None, typer.Option(metavar="M/S", help="Below which friction is to damp; else several.")
    ] = OwnDevice.speed,
    kappa: Annotated[
        float, typer.Option(metavar="1/M", help="Of a linkage whose motors hold torques; with --force and --fastest.")
    ] = OwnDevice.curvature,
    force: Annotated[float, typer.Option(metavar="N", help="The greatest force of that linkage.")] = OwnDevice.force,
    fastest: Annotated[float, typer.Option(metavar="M/S", help="Its greatest speed.")] = OwnDevice.fastest,
    turning: Annotated[
        bool, typer.Option("--turning", help="It turns: all of these are in N·m and rad.")
    ] = OwnDevice.turning,
    picture: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw the curves (.png, .svg or .pdf).")
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Show the stiffness that can be certified for each device, over the delay inside the tick and the period.

    Without a session, for the device that --osp and the other options state.

    With one, at another rate: --set period=0.0005 (s; 2 kHz). With another delay inside the tick: --set
    design.tau=0.0002.

    For a user who is 80 ms away, one way, R is 160 ms there and back, beyond any tick: --set
    'couplings.cx.wave_link={mass: 0.5, round_trip: 0.16}' shows what is felt over a wave link.
    """
    with errors("design"):
        from manyhands.launch.app.start import SettledForm, settle_delay

        if picture is not None:
            from manyhands.launch.look.figures import require_picture

            require_picture(picture)
        late = None if delay is None else time_of("--delay", delay)
        varies = 0.0 if jitter is None else time_of("--jitter", jitter)
        own = OwnDevice(osp or 0.0, rate, late, varies, friction, step, speed, kappa, force, fastest, turning)
        if session is None and osp is not None and not overrides:
            _require_device(own)
            end(run_own_budget(own, out, err, picture, as_json))
            return
        if session is None or osp is not None or own != OwnDevice(0.0):
            beside = "--osp beside a session or --set" if osp is not None else "an option of --osp without it"
            found = "neither SESSION nor --osp" if session is None and osp is None else beside
            refuse(f"found {found}; expected a session file, or a device by --osp and the options after it")
        loaded = settle_delay(SettledForm(load_named(session, overrides)), StartOptions(SIMULATED), err).session
        end(run_budget(loaded, out, err, picture, as_json))


def _require_device(own: OwnDevice) -> None:
    """Refuse what is out of range before it becomes a session, whose keys the user has never seen."""
    for option, value, least in (
        ("--osp", own.osp, True),
        ("--rate", own.rate, True),
        ("--delay", own.delay, False),
        ("--jitter", own.jitter, False),
        ("--friction", own.friction, False),
        ("--step", own.step, False),
        ("--speed", own.speed, True),
        ("--kappa", own.curvature, False),
        ("--force", own.force, own.curvature > 0.0),
        ("--fastest", own.fastest, own.curvature > 0.0),
    ):
        if value is not None and not (0.0 < value < math.inf or (value == 0.0 and not least)):
            refuse(f"{option}: found {value:g}; expected a number " + ("greater than 0" if least else "of 0 or more"))
    for option, time in (("--delay", own.delay), ("--jitter", own.jitter)):
        if time is not None and time > 1.0 / own.rate:
            refuse(f"{option}: found {time:g} s; expected at most a period, {1.0 / own.rate:g} s")
    if own.speed is not None and not own.friction:
        refuse("--speed: found a device without dry friction; expected --friction, which damps below a speed")


@commands.command(epilog="Example: manyhands sweep example1.yaml --vary 'design.tau=[0, 0.0002, 0.0005]' -o sweep.csv")
def sweep(
    session: SessionPath,
    output: Annotated[
        Path,
        typer.Option(
            "-o", metavar="FILE", help="Where the table goes (.csv); it goes on from FILE.journal, if there is one."
        ),
    ],
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="KEY=[VALUE,...]",
            help="Values of one key; repeatable, for every combination.",
            autocompletion=session_keys,
        ),
    ],
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", min=1, help="Processes; by default one for each processor.")
    ] = None,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Design a session for every combination of values, in parallel. Exit code 1: some design has no result.

    What cannot be certified is a result, too. A sweep that was ended goes on where it was, by the same command.
    """
    with errors("design"):
        from manyhands.launch.app.sweep import sweep as run_sweep

        loaded = load_named(session, overrides)
        choices = dict(read_choices(one) for one in vary)
        require_suffix(output, (".csv",))
        with progress_bar(err, "designing", total=None) as tell:
            found = run_sweep(
                loaded,
                choices,
                workers=workers,
                journal=output.with_name(f"{output.name}.journal"),
                progress=lambda done, every: tell(done, total=every),
            )
        found.save(output)
        say(err, f"{len(found)} designs written to {output}")
        for index, error in sorted(found.errors.items()):
            say(err, f"error: {dict(found.cases[index])}: {error}")
        end(EXIT_FAILED if found.errors else 0)
