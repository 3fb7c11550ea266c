"""The command that measures a device: identify."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from manyhands.design.models.axis import Units
from manyhands.launch.app.cli.check import Driver, Parameters, Period, made, require_in_range, room_sentence
from manyhands.launch.app.cli.common import Json, end, err, errors, out, refuse, require_folder, time_of
from manyhands.launch.files import EXIT_FAILED, require_new_target
from manyhands.launch.look.display import say, titled_table
from manyhands.launch.output import print_json
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import DeviceSpecification, DeviceTiming
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.realtime import realtime_thread
from manyhands.protocol.clock import RealtimeClock, SimulatedClock

if TYPE_CHECKING:
    from manyhands.launch.identify.device_file import Statement
    from manyhands.launch.identify.experiment import AtPose
    from manyhands.launch.identify.rig import Rig, Safety

commands = typer.Typer()

LATE = 0.01
"""Part of the ticks; where more come late, the machine may be why too little was measured."""

_ADVICE = "end other programs, or give a longer --period"

STARTS = 3
"""How often a driver that measures its times is started: each start measures others."""

MOST_AXES = 3
"""The lines that determine the damping of more are too many."""

_EXAMPLE = "Example: manyhands identify serial-board --parameters '{port: /dev/ttyACM0}' -o stick.device.yaml"


@commands.command(name="identify", epilog=_EXAMPLE)
def identify(
    driver: Driver,
    dof: Annotated[int, typer.Option("--dof", metavar="N", help="The number of axes, 1 to 3.")] = 1,
    parameters: Parameters = "{}",
    period: Period = 0.001,
    force: Annotated[float, typer.Option("--force", metavar="N", help="The greatest force, in N.")] = 2.0,
    travel: Annotated[float, typer.Option("--travel", metavar="M", help="How far to each side, in m.")] = 0.03,
    speed: Annotated[float, typer.Option("--speed", metavar="M/S", help="The greatest wanted speed.")] = 0.25,
    poses: Annotated[
        int, typer.Option("--poses", metavar="N", help="At how many places; the least of all counts.")
    ] = 1,
    delay: Annotated[
        str, typer.Option("--delay", metavar="TIME", help="The loop's own delay, for the stiffness that follows.")
    ] = "0",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write a device file (YAML).")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a device file that exists.")] = False,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="DIR", help="Draw what was measured.")] = None,
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="The device's name in the file.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before real hardware moves.")] = False,
    as_json: Json = False,
) -> None:
    """Measure a device: the least damping and the least dry friction that its motion allows.

    The device moves to and fro along lines through its place, at four speeds, held by weak virtual springs. Let it
    stand free: nobody holds it. Any key ends the motion, and so does all that is out of its bounds. What is printed
    holds for a class of devices and for the driver's own statements; docs/identify.md has both. Exit code 0: an osp can
    be stated. 1: none can, or the motion ended early.
    """
    with errors("design", *(("plot",) if plot is not None else ())):
        from manyhands.design.identification import NotOfThisClass, TooLittle
        from manyhands.launch.identify.device_file import device_file, statement, write_device_file
        from manyhands.launch.identify.rig import Aborted, Safety

        bounds = {"--force": (force, 100.0), "--travel": (travel, 1.0), "--speed": (speed, 10.0)}
        time_of("--delay", delay)  # before anything moves
        require_in_range({**bounds, "--period": (period, 0.1)})
        if not 1 <= dof <= MOST_AXES:
            refuse(f"--dof: found {dof}; expected 1 to {MOST_AXES}")
        if not 1 <= poses <= 9:
            refuse(f"--poses: found {poses}; expected 1 to 9")
        require_folder(plot)
        if output is not None:
            require_new_target(output, overwrite)
        factory, plugin, stated = made(driver, dof, parameters, period)
        if not stated.moved_by_force:
            plugin.close()
            raise FactoryError(
                f"the driver {factory.factory}: found a device that no force moves; expected one that is"
            )
        starts = [stated.timing]
        while stated.measured and len(starts) < STARTS:
            plugin.close()
            factory, plugin, stated = made(driver, dof, parameters, period)
            starts.append(stated.timing)
        promised = stated.promised(starts)
        safety = Safety(force, travel, speed)
        try:
            measured = _measured(plugin, stated, period, safety, poses, yes)
        except (Aborted, NotOfThisClass, TooLittle, ValueError) as error:
            say(err, f"error: {error}")
            end(EXIT_FAILED)
        finally:
            plugin.close()
        said = statement(measured, stated)
        given, day = dict(factory.parameters), date.today().isoformat()
        content = device_file(name or driver, driver, given, stated, promised, len(starts), said, day)
        if as_json:
            print_json(content)
        else:
            _print(said, stated)
            say(out, _advice(said, stated, promised, period, time_of("--delay", delay)))
            if stated.measured:
                say(out, f"its times are those of {len(starts)} starts, {room_sentence(stated)}")
        if output is not None:
            write_device_file(output, content)
            say(err, f"{output}: written")
        if plot is not None:
            from manyhands.launch.app.identify_plots import plot_poses

            for path in plot_poses(plot, said.poses, stated.axes, stated.units):
                say(err, f"{path}: written")
        end(0 if said.osp is not None else EXIT_FAILED)


def _measured(
    plugin: PluginDriver, stated: DeviceSpecification, period: float, safety: Safety, number: int, yes: bool
) -> list[AtPose]:
    """What was found at each pose, each after a question where somebody can answer."""
    from manyhands.design.identification import TooLittle
    from manyhands.launch.identify.experiment import drag, experiment, poses
    from manyhands.launch.identify.keyboard import any_key
    from manyhands.launch.identify.rig import Aborted, Late, Rig

    ask = stated.hardware and not yes
    if ask and not sys.stdin.isatty():
        raise Aborted("this moves real hardware, and there is no terminal to ask at: give --yes")
    found = []
    clock = RealtimeClock() if stated.hardware else SimulatedClock()
    rig = Rig(plugin, stated, period, clock, safety, turns=realtime_thread if stated.hardware else nullcontext)
    wanted = [] if ask else poses(rig.origin, rig, number)
    for pose in range(number):
        if ask:
            _asked(pose, number, safety, stated.units)
        with any_key() as rig.stop:
            if pose and not ask:
                drag(rig, wanted[pose])
            try:
                found.append(experiment(rig, partial(_tell, f"pose {pose + 1} of {number}")))
            except Late as error:
                raise Late(f"{error}; {_ADVICE}") from error
            except TooLittle as error:
                many = rig.late > LATE * rig.ticks
                raise TooLittle(f"{error}; many ticks came late: {_ADVICE}" if many else str(error)) from error
            finally:
                if stated.hardware:
                    say(err, _lateness(rig))
    return found


def _lateness(rig: Rig) -> str:
    """What the machine did to the loop."""
    return (
        f"{rig.late} of {rig.ticks} ticks came late, the longest {1e3 * rig.longest:.3g} ms after the one before; "
        f"{rig.stale} displacements were older than the driver states, and are left out"
    )


def _tell(where: str, text: str) -> None:
    say(err, f"{where}: {text}")


def _asked(pose: int, number: int, safety: Safety, units: Units) -> None:
    """Ask the user to bring the device to a pose and let go."""
    from manyhands.launch.identify.rig import Aborted

    place = "Bring the device" if pose == 0 else "Bring it to another place and posture"
    say(
        err,
        f"pose {pose + 1} of {number}: it will move by ±{1e3 * safety.travel:g} {units('mm')} with up to "
        f"{safety.force:g} {units('N')} and {safety.speed:g} {units('m/s')}; any key ends that. "
        f"{place if pose else place + ' to a first pose'}, let go of it, and press Enter (or q and Enter to stop)",
    )
    if sys.stdin.readline().strip().lower() not in ("", "y", "yes"):
        raise Aborted("stopped; no force was exerted")


def _print(said: Statement, stated: DeviceSpecification) -> None:
    """A row for each pose and line."""
    from manyhands.launch.identify.experiment import line_name

    units = stated.units
    table = titled_table(
        "What motion allows: from … to",
        ("pose", "line"),
        (f"damping {units('N·s/m')}", f"dry friction {units('N')}", f"mass {units('kg')}"),
    )
    for number, one in enumerate(said.poses, start=1):
        for at, line in enumerate(one.lines):
            of = (one.found.by_line[at], one.found.friction[at], one.found.mass[at])
            name = line_name(line.u, stated.axes)
            table.add_row(str(number), name, *(f"{interval.low:.3g} … {interval.high:.3g}" for interval in of))
        if len(stated.axes) > 1:
            least = one.found.damping
            table.add_row(str(number), "least of all", f"{least.low:.3g} … {least.high:.3g}", "", "")
    out.print(table)
    if any(one.found.stribeck for one in said.poses):
        say(out, "dry friction falls with the speed (Stribeck), or damping grows faster than it: see docs/identify.md")


def _advice(said: Statement, stated: DeviceSpecification, promised: DeviceTiming, period: float, delay: float) -> str:
    """Which osp may be stated, and what follows."""
    from manyhands.design.budget import stiffest

    least = ", ".join(f"{value:g}" for value in said.friction or ())
    friction = f"friction: {{least: [{least}]}}" if least else ""
    if said.osp is None and any(one.found.stribeck for one in said.poses):
        return (
            "no osp can be stated: all that it burns can be drag, which grows faster than the speed and burns nothing "
            f"near rest; what may be stated: {friction or 'no friction either'}"
        )
    if said.osp is None:
        return (
            "no osp can be stated: the least damping that the motion allows is 0; give more travel or speed, or let "
            "the driver state a smaller age_jitter and step, where they are smaller"
        )
    tau = delay + promised.latency
    keys = f"osp: {said.osp:g}"
    if friction and said.step is not None:
        keys += f", {friction}"
    text = f"for the session file: {keys}"
    if tau > period:
        return (
            f"{text}; its delay of {1e3 * tau:.3g} ms is longer than the period: nothing can be certified at that rate"
        )
    rho = min(1.0, promised.jitter / period)
    limit = stiffest(said.osp * np.eye(len(stated.force)), period, tau, period_tolerance=rho)
    return (
        f"{text}; a coupling of up to {limit.certified:.4g} {stated.units('N/m')} follows, at a period of "
        f"{1e3 * period:g} ms and a delay of {1e3 * tau:.3g} ms"
    )
