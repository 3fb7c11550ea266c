"""The command about devices: what is plugged in, and what is known of each."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import Json, errors, out, refuse
from manyhands.launch.doctor.devices import (
    OWN_DRIVER,
    PluggedIn,
    Survey,
    driver_options,
    parameters_to_give,
    survey,
)
from manyhands.launch.look.display import say
from manyhands.launch.output import pipe_may_close, print_json
from manyhands.launch.session.device_file import SUFFIX, DeviceFile, catalogue, catalogue_file, device_file

commands = typer.Typer()


def _names(incomplete: str) -> list[str]:
    return [name for name in catalogue() if name.startswith(incomplete)]


@commands.command(epilog="Example: manyhands devices omega.3")
def devices(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]", help="Print what is known of this device: a name of the catalogue, or a device file.",
            autocompletion=_names,
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--catalogue", help="List the devices of the catalogue.")] = False,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Show which devices are plugged in, what is missing to use them, and the line to try next.

    Nothing is opened, and no device notices. With NAME, print its device file: each number with its source.
    """
    with errors(), pipe_may_close():
        if name is not None:
            if listed:
                refuse("give either NAME or --catalogue")
            file = device_file(Path(name)) if name.endswith(SUFFIX) else catalogue_file(name)
            if as_json:
                print_json(file.as_plain())
            else:
                _print_file(file)
        elif listed:
            files = [catalogue_file(name) for name in catalogue()]
            if as_json:
                print_json({file.name: file.device for file in files})
                return
            width = max(len(file.name) for file in files)
            for file in files:
                say(out, f"{file.name.ljust(width)}  {file.device}")
        else:
            found = survey()
            if as_json:
                print_json(found.as_plain())
            else:
                _print_survey(found)


def _print_survey(found: Survey) -> None:
    for device in found.devices:
        _print_device(device)
    for name, address in found.silent.items():
        say(out, f"{name}: no service answers at {address}; start its maker's service if you have one")
    others = f"{found.others or 'no'} other USB device{'s' if found.others > 1 else ''}"
    none = "" if found.devices else "found no device that is known; "
    say(out, f"{none}{others}; manyhands devices --catalogue lists what is known")


def _print_device(device: PluggedIn) -> None:
    called = f", {device.name!r}" if device.usb and device.name else ""
    where = f"USB {device.usb}{called} at {device.place}" if device.usb else f"{device.place}: {device.name}"
    may_be = device.known[0] if len(device.known) == 1 else f"one of {', '.join(device.known)}"
    say(out, f"{may_be}: {where}")
    for sentence in device.missing:
        say(out, f"  missing: {sentence}")
    if device.rule:
        say(out, f"  rule: {device.rule}")
    if device.next:
        say(out, f"  next: {device.next}")


def _print_file(file: DeviceFile) -> None:
    say(out, f"{file.name}: {file.device}")
    for key, value in file.keys.items():
        say(out, f"  {key}: {_shown(value)}")
        say(out, f"      {file.sources[key]}")
    for sentence in file.by_itself:
        say(out, f"  by itself, outside every certificate: {sentence}")
    for key, value in file.identification.items():
        say(out, f"  identification {key}: {_shown(value)}")
    for sentence in file.notes:
        say(out, f"  {sentence}")
    if file.found_by.source:
        say(out, f"  found by {', '.join(file.found_by.usb) or 'its service or port'} ({file.found_by.source})")
    say(out, "in a session, where each line with # is yours:")
    for line in _block(file):
        say(out, line)


def _block(file: DeviceFile) -> Iterator[str]:
    """The device in a session, as YAML; what the file does not know is a comment with what to run."""
    yield from ("devices:", "  stick:", f"    from: {json.dumps(file.name) if ' ' in file.name else file.name}")
    options, path = driver_options(file), " (docs/drivers.md)"
    if file.driver is None:
        yield f'    # driver: "{OWN_DRIVER}"  # yours, for this package has none of it{path}'
    if "dof" not in file.keys:
        yield "    # dof: 1  # how many axes yours has"
    if file.needs and "parameters" not in file.keys:
        yield f"    # parameters: {parameters_to_give(file)}"
        for key, what in file.needs.items():
            yield f"    #   {key.upper()}: {what}"
    if "osp" not in file.keys:
        yield "    # osp: OSP  # what it surely dissipates, N·s/m, or N·m·s/rad where it turns; to measure it, run"
        yield f"    #   manyhands identify {options} -o stick.device.yaml"
        yield "    #   and take from: ./stick.device.yaml, which has all that is stated here"
    if file.keys.get("dof", 1) != 1 and "held" not in file.keys:
        yield "    # held: torque  # with its linkage, where its motors hold joint torques (docs/mechanisms.md)"
    if not {"sample_age", "actuation_delay"} & file.keys.keys():
        yield "    # what your driver states, such as limits, sample_age and actuation_delay; to print it, run"
        yield f"    #   manyhands check-driver {options} --no-push"


def _shown(value: object) -> str:
    """A value as a session file states it, in one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_shown(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)
