"""What a run risks, stated before it happens: code of other packages, and a network that anybody can reach."""

from __future__ import annotations

from collections.abc import Collection

from rich.console import Console

from manyhands.launch.look.display import say
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.nodes.kernel.factory import is_shipped, library_of, place_of


def warn_of_code(console: Console, session: Session, elsewhere: Collection[str] = ()) -> None:
    """State, before it happens, that a run imports and executes code of other packages, and where it is from.

    Args:
        console: where to.
        session: the session.
        elsewhere: the nodes whose code this command does not run.
    """
    for key, name in session.foreign_code.items():
        what = "driver" if key.startswith("devices.") else "model"
        node = key.split(".")[1] if what == "driver" else ENVIRONMENT
        if node not in elsewhere and not is_shipped(name.factory):
            say(
                console,
                f"{session.name}: runs the code of the {what} {name.factory}, which is not confined ({key}); it is "
                f"from {place_of(name)}; run only {what}s from people you trust",
            )
        if node not in elsewhere and (library := library_of(name)) is not None:
            say(
                console,
                f"{session.name}: {node} loads a maker's library, which is not confined ({key}): {library}; run only "
                "libraries from people you trust",
            )


def warn_insecure(console: Console) -> None:
    """Warn in red that a run is open to everybody on the network."""
    console.print(
        "warning: --insecure: nothing is encrypted and nobody proves who they are; anybody who can reach these ports "
        "can read every motion and push every hand",
        style="bold red",
        markup=False,
        soft_wrap=True,
    )
