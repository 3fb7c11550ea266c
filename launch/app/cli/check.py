"""The commands that try the code of other packages, and a device behind a driver: check-driver, check-model, probe."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Self

import typer
from pydantic_core import PydanticCustomError

from manyhands.design.models.axis import Units
from manyhands.launch.app.cli.common import Json, end, err, errors, out, refuse
from manyhands.launch.conformance.answers import Explained, Question, ask_device, called
from manyhands.launch.conformance.driver import Bench, NeverReturned, Push, checked_apart, clock_for, run_apart
from manyhands.launch.conformance.driver import check_driver as try_driver
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken, print_judgements
from manyhands.launch.conformance.model import check_model as try_model
from manyhands.launch.files import EXIT_FAILED, EXIT_OK
from manyhands.launch.look.display import say, status
from manyhands.launch.output import print_json
from manyhands.launch.session.fields import problems_of
from manyhands.launch.session.foreign import factory_of, plain_parameters
from manyhands.launch.session.limits import MAX_DOF, MAX_STIFFNESS
from manyhands.launch.session.yaml import parse_tree
from manyhands.nodes.device.plugin import DriverFailure, PluginDriver, made_driver
from manyhands.nodes.device.specification import AGE_JITTER, AxisMap, DeviceSpecification
from manyhands.nodes.environment.model import PROXY, REACT, make_model
from manyhands.nodes.kernel.driver_statement import outside
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


Driver = Annotated[str, typer.Argument(metavar="DRIVER", help="package.module:factory, or a published short name.")]
Dof = Annotated[int, typer.Option("--dof", metavar="N", help="The number of axes.")]
Force = Annotated[float, typer.Option("--force", metavar="N", help="The greatest push, in N.")]
Travel = Annotated[
    float, typer.Option("--travel", metavar="M", help="A push ends once the device has moved so far, in m.")
]
Torque = Annotated[
    float,
    typer.Option("--torque", metavar="N·m", help="The greatest torque on a device that exerts one in space, in N·m."),
]
Yes = Annotated[bool, typer.Option("--yes", help="Do not ask before a push of hardware.")]


@commands.command(name="check-driver", epilog="Example: manyhands check-driver my_joystick:make --dof 2 --no-push")
def check_driver(
    driver: Driver,
    dof: Dof = 1,
    parameters: Parameters = "{}",
    period: Period = 0.001,
    force: Force = 0.5,
    travel: Travel = 0.01,
    torque: Torque = 0.005,
    push: Annotated[
        bool,
        typer.Option(
            "--push/--no-push",
            help="Exert forces. With --no-push the device is only read, without a question, and nothing about forces "
            "is judged. The keys for the session file are what the driver states, with a push and without.",
        ),
    ] = True,
    yes: Yes = False,
    as_json: Json = False,
) -> None:
    """Try a driver: read the device, push it a little on each axis, fall silent, and name what is wrong.

    A device that states a torque in space is turned a little about each axis as well, by up to 0.2 rad.

    This imports the driver and runs its code. Hardware is pushed only after a question. Let the device stand free:
    nobody holds it. Where the driver states moved_by_force=False, nothing is pushed. Exit code 0: nothing is broken. 1:
    something is.
    """
    with errors():
        require_in_range({"--force": (force, 1000.0), "--travel": (travel, 1.0), "--period": (period, 0.1)})
        require_in_range({"--torque": (torque, 100.0)})
        name, plugin, stated = made(driver, dof, parameters, period)
        asked = push and stated.moved_by_force and stated.hardware and not yes
        if asked and not sys.stdin.isatty():
            plugin.close()
            refuse("found real hardware to push, and no terminal to ask at; expected --yes, or --no-push to read alone")
        turned = (
            min(torque, stated.orientation.torque or 0.0) if stated.orientation and stated.orientation.felt else 0.0
        )
        if asked and not _agreed(min(force, *stated.force), travel, stated.units, turned):
            say(err, "no force is exerted")
            push = False
        bench = Bench(plugin, period, clock_for(stated, RealtimeClock()))
        pushes = Push(force, travel, torque) if push else None
        found = checked_apart(bench, lambda: list(try_driver(bench, stated, pushes)))
        if stated.uncovered and not as_json:
            say(out, outside("the device", stated.uncovered))
        own_words = {"by_itself": list(stated.uncovered)} if stated.uncovered else {}
        latency = stated.promised().latency
        slower = f"; its period is at least {latency:g} s, the age and delay together" if latency > period else ""
        room = f"; its times are those of one start, {room_sentence(stated)}" if stated.measured else ""
        keys = f"for the session file: {_keys(stated)}{slower}{room}"
        _end(found, {"driver": name.factory, **own_words}, as_json, keys)


@commands.command(epilog="Example: manyhands probe serial-board --parameters '{port: /dev/ttyACM0}'")
def probe(
    driver: Driver,
    dof: Dof = 1,
    parameters: Parameters = "{}",
    period: Period = 0.001,
    seconds: Annotated[float, typer.Option("--seconds", metavar="S", help="How long the device is read, in s.")] = 5.0,
    force: Force = 0.5,
    travel: Travel = 0.01,
    push: Annotated[bool, typer.Option("--push/--no-push", help="Push after the reading; else only read.")] = True,
    yes: Yes = False,
    as_json: Json = False,
) -> None:
    """Show what a device reads, push it gently, and say in words what it answered.

    Move the device by hand while it is read, to see that each axis counts. Then let it stand free: after a question
    each axis is pushed both ways. An axis that does not answer is explained. A rotational axis has N·m and mrad. Exit
    code 0: every axis that was pushed moved in the direction of the force. 1: one did not.
    """
    with errors():
        require_in_range({"--force": (force, 1000.0), "--travel": (travel, 1.0), "--period": (period, 0.1)})
        require_in_range({"--seconds": (seconds, 3600.0)})
        name, plugin, stated = made(driver, dof, parameters, period)
        bench = Bench(plugin, period, clock_for(stated, RealtimeClock()))
        question = Question()
        if yes or not (push and stated.moved_by_force and stated.hardware):
            question.answer(push)
        pushes, ticks = Push(force, travel) if push else None, max(1, round(seconds / period))
        live = _Live(bench, stated, question, lambda: _agreed(min(force, *stated.force), travel, stated.units))
        with live:
            try:
                found = run_apart(bench, lambda: ask_device(bench, stated, ticks, pushes, question), look=live.look)
            except NeverReturned as error:
                raise DriverFailure(f"the driver {name.factory}: {error}", raised=False) from error
        if as_json:
            reads = [{"axis": one.axis, "low": one.low, "high": one.high} for one in found.reads]
            print_json({"driver": name.factory, "reads": reads, "answers": [one.as_plain() for one in found.answers]})
        else:
            for sentence in _sentences(found, stated, push):
                say(out, sentence)
        end(EXIT_OK if all(answer.right for answer in found.answers) else EXIT_FAILED)


def _sentences(found: Explained, stated: DeviceSpecification, push: bool) -> Iterator[str]:
    """What was found, as sentences."""
    moved = {answer.axis for answer in found.answers if answer.moved}
    for one in found.reads:
        yield one.sentence(one.axis in moved)
    for answer in found.answers:
        yield from answer.sentences()
    if found.answers and found.answers[-1].wrong and len(found.answers) < len(stated.axes):
        yield "the axes after it were not pushed"
    if push and not stated.moved_by_force:
        yield "nothing was pushed: the driver states that no force moves its device (moved_by_force=False)"
    elif not found.answers:
        yield "no force was exerted"
    if stated.uncovered:
        yield outside("the device", stated.uncovered)


class _Live:
    """Shows what a device reads on a terminal, and asks the question when it is time."""

    def __init__(
        self,
        bench: Bench,
        stated: DeviceSpecification,
        question: Question,
        agreed: Callable[[], bool],
    ) -> None:
        self._bench, self._stated, self._question, self._agreed = bench, stated, question, agreed
        self._shown = ExitStack()
        self._tell: Callable[[str], None] = lambda _text: None

    def __enter__(self) -> Self:
        self._tell = self._shown.enter_context(status(err, "reading"))
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.close()

    def look(self) -> None:
        """Show the newest sample, and ask the question once."""
        if self._bench.samples.x:
            stated = self._stated
            places = zip(stated.axes, stated.units_by_axis, self._bench.samples.x[-1], strict=True)
            told = (f"{called(axis)} {1e3 * x:+9.3f} {units('mm')}" for axis, units, x in places)
            self._tell("  ".join(told))
        question = self._question
        if question.asked.is_set() and not question.answered.is_set():
            self._shown.close()  # so that nothing is drawn over the question
            self._tell = lambda _text: None
            question.answer(self._agreed())


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
        require_in_range({"--reach": (reach, 10.0), "--period": (period, 0.1)})
        names = _ports("port", int(ports)) if ports.isdecimal() else tuple(ports.split(","))
        name = _factory(model, ENGINES if model in published(ENGINES) else MODELS, parameters)
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


def _end(found: list[Judgement], what: dict[str, Any], as_json: bool, advice: str = "") -> None:
    """Print what was found, and ``advice`` where nothing is broken, and end the command."""
    if as_json:
        print_json({**what, "findings": [finding.as_plain() for finding in found]})
    else:
        print_judgements(out, found)
        unjudged = sum(finding.verdict is Conformance.OPEN for finding in found)
        if unjudged:
            say(out, f"{len(found) - unjudged} of {len(found)} checks were judged")
        if advice and not broken(found):
            say(out, advice)
    end(EXIT_FAILED if broken(found) else EXIT_OK)


def require_in_range(options: Mapping[str, tuple[float, float]]) -> None:
    """End the command unless each option's value is greater than 0, and at most the number beside it."""
    for option, (value, most) in options.items():
        if not 0.0 < value <= most:
            refuse(f"{option}: found {value:g}; expected a number greater than 0 and at most {most:g}")


def made(
    driver: str, dof: int, parameters: str, period: float
) -> tuple[FactoryName, PluginDriver, DeviceSpecification]:
    """The factory, the driver with its own axes, and what it states.

    Raises:
        FactoryError: it cannot be made, or has another number of axes.
    """
    name = _factory(driver, DRIVERS, parameters)
    own, stated = made_driver(name, _ports("device", dof), period)
    if len(stated.force) != dof:
        own.close()
        raise FactoryError(f"the driver {name.factory}: found {len(stated.force)} axes; expected --dof {dof}")
    axes = AxisMap(tuple(range(dof)), (1.0,) * dof)
    return name, PluginDriver(name.factory, own, axes, stated, period), stated


def _ports(name: str, number: int) -> tuple[str, ...]:
    if not 1 <= number <= MAX_DOF:
        refuse(f"found {number} axes or ports; expected 1 to {MAX_DOF}")
    return (name,) if number == 1 else tuple(f"{name}.{axis}" for axis in range(number))


def _factory(name: str, group: str, parameters: str) -> FactoryName:
    """The factory that the user names; its module is looked for in the current folder as well."""
    place = "--parameters"
    try:
        given = plain_parameters(parse_tree(f"parameters: {parameters}", place).data["parameters"])
        place = "DRIVER" if group == DRIVERS else "MODEL"
        return FactoryName(factory_of(name, group), given, str(Path.cwd()))
    except PydanticCustomError as error:
        problem = problems_of(error)[0]
        raise FactoryError(f"{place}: found {problem.found}; expected {problem.expected}") from error


def _agreed(force: float, travel: float, units: Units, torque: float = 0.0) -> bool:
    """Whether the user at the terminal agrees to a push, and to a torque (N·m) in space; no terminal is no."""
    push = f"{force:g} {units('N')}, up to {1e3 * travel:g} {units('mm')} at a time"
    push += f", and turns it with {torque:g} N·m" if torque else ""
    question = f"this pushes real hardware with {push}; nobody may hold it"
    if not sys.stdin.isatty():
        say(err, f"{question}: there is no terminal to ask at; give --yes or --no-push")
        return False
    say(err, f"{question}. Push it? [y/N]")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def room_sentence(stated: DeviceSpecification) -> str:
    """Why the times for a session are greater than those that a driver has measured; to follow the starts."""
    whole = ", and the jitter is all of the age" if AGE_JITTER in stated.measured else ""
    return f"with half as much again for the next ones{whole}: the driver measures them anew at each start"


def _keys(stated: DeviceSpecification) -> str:
    """The keys of a session's device that keep to what a driver states."""
    keys = {"dof": len(stated.force), **stated.session_keys()}
    if not stated.moved_by_force:  # which design cannot know, for it runs no foreign code
        keys["by_itself"] = stated.uncovered
    return ", ".join(f"{key}: {_text(value)}" for key, value in keys.items())


def _text(value: Any) -> str:
    """A key's value, as YAML in a line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_text(one)}' for key, one in value.items())}}}"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False) if " " in value else value
    return f"{value:g}"
