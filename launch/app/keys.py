"""What `manyhands invite` prints of a session's keys: what was made, and where each file must go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from manyhands.launch.files import EXIT_OK
from manyhands.launch.look.display import say, titled_table
from manyhands.launch.output import print_json
from manyhands.launch.plan.keys import PRIVATE, PUBLIC, SUFFIX, KeyState, Made, make_keys, private_path
from manyhands.launch.plan.topology import roster
from manyhands.launch.session import Session


def run_keys(session: Session, folder: Path, renew: Sequence[str], out: Console, err: Console, as_json: bool) -> int:
    """Make a session's keys, and print what was made and where each file must go.

    Args:
        session: the session.
        folder: the folder of its keys; made if absent.
        renew: names whose keys are to be replaced.
        out: for the table.
        err: for what to do next.
        as_json: print one JSON object instead of the table.

    Returns:
        The exit code.

    Raises:
        KeyFileError: as :func:`make_keys`.
        OSError: a file cannot be written.
    """
    made = make_keys(session, folder, renew)
    states = {name: state for state in KeyState for name in getattr(made, state.value)}
    if as_json:
        print_json(_object(session, folder, made, states))
    else:
        table = titled_table(f"{session.name}: keys", ("name", "role", "key"))
        for name, role in roster(session).items():
            table.add_row(name, role.value, states[name].value)
        out.print(table)
    _print_next_steps(session, folder, made, err)
    return EXIT_OK


def _object(session: Session, folder: Path, made: Made, states: dict[str, KeyState]) -> dict[str, object]:
    """The object that ``--json`` prints; it has the paths of the files, and no key."""
    private = folder / PRIVATE
    return {
        "session": session.name,
        "public": str(folder / PUBLIC),
        "keys": {
            name: {
                "role": role.value,
                "key": states[name].value,
                "private": None if states[name] is KeyState.ELSEWHERE else str(private_path(private, name)),
            }
            for name, role in roster(session).items()
        },
        "stale": list(made.stale),
    }


def _print_next_steps(session: Session, folder: Path, made: Made, err: Console) -> None:
    private = folder / PRIVATE
    say(err, f"to machines that launch the session: {folder / PUBLIC}")
    say(
        err,
        f"to the machine that runs NAME, and to no other: {private}/NAME{SUFFIX} (mode 0600; over a secure channel), "
        "with its bundle (manyhands invite)",
    )
    if made.new or made.renewed:
        say(err, f"the public keys have changed: older copies of {PUBLIC} and older bundles are no longer valid")
    for name in made.elsewhere:
        say(
            err,
            f"{name}: its private key is not in this folder: it is on its own machine, or lost; "
            f"replace a lost key with --renew {name}",
        )
    if made.stale:
        say(err, f"no longer in {session.name}, and left in place: {', '.join(made.stale)}")
