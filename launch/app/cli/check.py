"""The commands that try the code of other packages: check-driver, check-model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from pydantic_core import PydanticCustomError

from manyhands.launch.app.cli.common import Json, end, err, errors, out, refuse
from manyhands.launch.conformance.driver import Bench, Push, checked_apart, clock_for
from manyhands.launch.conformance.driver import check_driver as try_driver
from manyhands.launch.conformance.judgement import Judgement, broken, print_judgements
from manyhands.launch.conformance.model import check_model as try_model
from manyhands.launch.files import EXIT_FAILED, EXIT_OK
from manyhands.launch.look.display import say
from manyhands.launch.output import print_json
from manyhands.launch.session.fields import problems_of
from manyhands.launch.session.foreign import factory_of, plain_parameters
from manyhands.launch.session.limits import MAX_DOF, MAX_STIFFNESS
from manyhands.launch.session.yaml import parse_tree
from manyhands.nodes.device.plugin import PluginDriver, made_driver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification
from manyhands.nodes.environment.model import PROXY, REACT, make_model
from manyhands.nodes.kernel.factory import DRIVERS, ENGINES, MODELS, FactoryError, FactoryName, published
from manyhands.protocol.clock import RealtimeClock

commands = typer.Typer()

Parameters = Annotated[
    str,
    typer.Option(
        "--parameters", metavar="YAML", help="What the factory is called with, such as '{port: /dev/ttyACM0}'."
    ),
]
Period = Annotated[float, typer.Option("--period", metavar="S", help="The length of a tick, in s.")]


@commands.command(name="check-driver", epilog="Example: manyhands check-driver my_joystick:make --dof 2 --no-push")
def check_driver(
    driver: Annotated[str, typer.Argument(metavar="DRIVER", help="package.module:factory, or a published short name.")],
    dof: Annotated[int, typer.Option("--dof", metavar="N", help="The number of axes.")] = 1,
    parameters: Parameters = "{}",
    period: Period = 0.001,
    force: Annotated[float, typer.Option("--force", metavar="N", help="The greatest push, in N.")] = 0.5,
    travel: Annotated[
        float, typer.Option("--travel", metavar="M", help="A push ends once the device has moved so far, in m.")
    ] = 0.01,
    push: Annotated[
        bool,
        typer.Option(
            "--push/--no-push",
            help="Exert forces. With --no-push the device is only read, without a question, and nothing about forces "
            "is judged. The keys for the session file are what the driver states, with a push and without.",
        ),
    ] = True,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before a push of hardware.")] = False,
    as_json: Json = False,
) -> None:
    """Try a driver: read the device, push it a little on each axis, fall silent, and name what is wrong.

    This imports the driver and runs its code. Hardware is pushed only after a question. Let the device stand free:
    nobody holds it. Where the driver states moved_by_force=False, nothing is pushed. Exit code 0: nothing is broken. 1:
    something is.
    """
    with errors():
        for option, value, most in (("--force", force, 1000.0), ("--travel", travel, 1.0), ("--period", period, 0.1)):
            if not 0.0 < value <= most:
                refuse(f"{option}: found {value:g}; expected a number greater than 0 and at most {most:g}")
        ports = ports_of("device", dof)
        name = named_factory(driver, DRIVERS, parameters)
        made, stated = made_driver(name, ports, period)
        if len(stated.force) != dof:
            made.close()
            raise FactoryError(f"the driver {name.factory}: found {len(stated.force)} axes; expected --dof {dof}")
        if (
            push
            and stated.moved_by_force
            and stated.hardware
            and not yes
            and not _agreed(min(force, *stated.force), travel)
        ):
            say(err, "no force is exerted")
            push = False
        own = AxisMap(tuple(range(dof)), (1.0,) * dof)
        plugin = PluginDriver(name.factory, made, own, stated, period)
        bench = Bench(plugin, period, clock_for(stated, RealtimeClock()))
        pushes = Push(force, travel) if push else None
        found = checked_apart(bench, lambda: list(try_driver(bench, stated, pushes)))
        _end(found, {"driver": name.factory}, as_json, f"for the session file: {_keys(stated)}")


@commands.command(name="check-model", epilog="Example: manyhands check-model my_world:make --ports 2 --level 0.2")
def check_model(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="package.module:factory, or a published short name.")],
    ports: Annotated[
        str, typer.Option("--ports", metavar="N|NAMES", help="The number of ports, or their names by commas.")
    ] = "1",
    parameters: Parameters = "{}",
    period: Period = 0.001,
    reach: Annotated[
        float, typer.Option("--reach", metavar="M", help="The greatest displacement of a tool, in m.")
    ] = 0.02,
    level: Annotated[
        float | None, typer.Option("--level", metavar="N·s/m", help="The level that the session declares.")
    ] = None,
    stiffness: Annotated[
        float | None,
        typer.Option("--stiffness", metavar="N/m", help="The springs to the proxies, for a model with proxy()."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Try a model of the environment: move its tools along probe motions, and name what is wrong.

    This imports the model and runs its code. It also reports the passivity level that the probes need. Exit code 0:
    nothing is broken. 1: something is.
    """
    with errors():
        for option, value, most in (("--reach", reach, 10.0), ("--period", period, 0.1)):
            if not 0.0 < value <= most:
                refuse(f"{option}: found {value:g}; expected a number greater than 0 and at most {most:g}")
        names = ports_of("port", int(ports)) if ports.isdecimal() else tuple(ports.split(","))
        name = named_factory(model, ENGINES if model in published(ENGINES) else MODELS, parameters)
        if stiffness is not None and not 0.0 < stiffness <= MAX_STIFFNESS:
            refuse(f"--stiffness: found {stiffness:g}; expected a number greater than 0 and at most {MAX_STIFFNESS:g}")
        method = REACT if stiffness is None else PROXY
        found = list(
            try_model(
                name.factory,
                lambda: make_model(name, names, period, method),
                names,
                period,
                reach,
                level,
                stiffness=stiffness,
            )
        )
        _end(found, {"model": name.factory}, as_json)


def _end(found: list[Judgement], what: dict[str, str], as_json: bool, advice: str = "") -> None:
    """Print what was found, and ``advice`` where nothing is broken, and end the command."""
    if as_json:
        print_json({**what, "findings": [finding.as_plain() for finding in found]})
    else:
        print_judgements(out, found)
        if advice and not broken(found):
            say(out, advice)
    end(EXIT_FAILED if broken(found) else EXIT_OK)


def ports_of(name: str, number: int) -> tuple[str, ...]:
    """The ports of a device or a model with so many axes; ends the command where there are too many."""
    if not 1 <= number <= MAX_DOF:
        refuse(f"found {number} axes or ports; expected 1 to {MAX_DOF}")
    return (name,) if number == 1 else tuple(f"{name}.{axis}" for axis in range(number))


def named_factory(name: str, group: str, parameters: str) -> FactoryName:
    """The factory that the user names; its module is looked for in the current folder as well."""
    place = "--parameters"
    try:
        given = plain_parameters(parse_tree(f"parameters: {parameters}", place).data["parameters"])
        place = "DRIVER" if group == DRIVERS else "MODEL"
        return FactoryName(factory_of(name, group), given, str(Path.cwd()))
    except PydanticCustomError as error:
        problem = problems_of(error)[0]
        raise FactoryError(f"{place}: found {problem.found}; expected {problem.expected}") from error


def _agreed(force: float, travel: float) -> bool:
    """Whether the user at the terminal agrees to a push; no terminal is no."""
    question = f"this pushes real hardware with {force:g} N, up to {1e3 * travel:g} mm at a time; nobody may hold it"
    if not sys.stdin.isatty():
        say(err, f"{question}: there is no terminal to ask at; give --yes or --no-push")
        return False
    say(err, f"{question}. Push it? [y/N]")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _keys(stated: DeviceSpecification) -> str:
    """The keys of a session's device that keep to what a driver states."""
    limits = {"force": stated.force, "displacement": stated.displacement, "speed": stated.speed}
    texts = [f"{key}: [{', '.join(f'{value:g}' for value in values)}]" for key, values in limits.items()]
    keys = [f"dof: {len(stated.force)}", f"limits: {{{', '.join(texts)}}}"]
    timing = stated.timing
    if timing.sample_age:
        keys += [f"sample_age: {timing.sample_age:g}", f"age_jitter: {timing.jitter:g}"]
    if timing.actuation_delay:
        keys.append(f"actuation_delay: {timing.actuation_delay:g}")
    return ", ".join(keys)
