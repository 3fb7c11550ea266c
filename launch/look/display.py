"""What people are told: messages, progress bars, the figures of nodes as a table, and sentences about a session.

Which figures of a node every such table shows is declared with them (:mod:`manyhands.nodes.rows.figures`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Final, Protocol

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from manyhands.design.errors import Infeasible, TriedChange
from manyhands.design.models.axis import TRANSLATING, Units
from manyhands.nodes.environment.chatter import MOST as MOST_REVERSALS
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.given import GivenForce, shares_cell
from manyhands.nodes.monitor.health import PromiseState, condensed, is_present, missed, sentence
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.figures import Column, Figure
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.messages import Figures, PromiseStatus

COLUMNS: Final = tuple((figure, column) for figure in names.FIGURES.values() for column in figure.columns)
"""The figures that tables show, each with its column, in the order of the columns."""


def cell(figure: Figure, column: Column, figures: Figures) -> str:
    """A node's cell of a column; empty if the node has no such figure."""
    if not column.form:  # the shares of the force that a device was given of the force asked, since its start
        given = GivenForce.of(figures)
        return "" if given is None else shares_cell(given.by_force, given.by_time)
    value = (figures.table(figure.name) if column.key else figures).get(column.key or figure.name)
    return "" if value is None else format(value, column.form)


def figure_cells(figures: Figures) -> list[str]:
    """A node's cells of all :data:`COLUMNS`."""
    return [cell(figure, column, figures) for figure, column in COLUMNS]


def titled_table(title: str, words: Sequence[str], numbers: Sequence[str] = ()) -> Table:
    """An empty table with columns of words, which are folded and never cut, and then of numbers, at the right."""
    table = Table(title=escape(title), title_justify="left")
    for name in words:
        table.add_column(escape(name), overflow="fold")
    for name in numbers:
        table.add_column(escape(name), justify="right")
    return table


def figure_table(
    title: str, titles: Sequence[str], rows: Sequence[Sequence[str | Text]], ranks: Mapping[str, int], width: int
) -> tuple[Table, list[str]]:
    """A table whose columns all fit, and the titles of those that are left out because they do not.

    Args:
        title: of the table.
        titles: of its columns; what follows a line end stands in a second line.
        rows: a cell for each column.
        ranks: by column, for those that may be left out, the rank: the highest goes first.
        width: columns of the terminal.
    """
    needed = [
        max(max(map(cell_len, str(cell).split("\n"))) for cell in (titles[place], *(row[place] for row in rows))) + 3
        for place in range(len(titles))
    ]
    kept = list(range(len(titles)))
    left_out = []
    for name in sorted(ranks, key=ranks.__getitem__, reverse=True):
        if sum(needed[place] for place in kept) > width:
            kept.remove(titles.index(name))
            left_out.append(name)
    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for place in kept:
        left = titles[place] in _WORDS
        table.add_column(Text(titles[place]), justify="left" if left else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in (row[place] for place in kept)))
    return table, left_out


_WORDS: Final = ("node", "role", "state", "health")  # columns of words, which begin at the left


def heading(title: str, units: Units = TRANSLATING) -> str:
    """The title of a column, with its unit in a second line: that of these axes."""
    name, bracket, unit = title.removesuffix("]").partition(" [")
    return f"{name}\n[{units(unit)}]" if bracket else title


LEAST_SHOWN: Final = 1e-3
"""J; pairs that exchanged less energy are not shown."""

MOST_SHOWN: Final = 6
"""The most pairs that are shown, those with the most energy."""


def energy_line(figures: Figures) -> str:
    """One line with the energy between users and the couplings held to a budget; empty if there is none."""
    pairs = ((value, *key.partition("/")) for key, value in figures.table(names.MOVED).items() if value >= LEAST_SHOWN)
    moved = [f"{supplier} → {receiver} {value:.3g}" for value, supplier, _, receiver in sorted(pairs, reverse=True)]
    scaled = figures.table(names.SCALED)
    parts = [f"who moved whom [J]: {', '.join(moved[:MOST_SHOWN])}"] if moved else []
    if len(moved) > MOST_SHOWN:
        parts[0] += f" and {len(moved) - MOST_SHOWN} more"
    return "; ".join([*parts, *([f"held to an energy budget: {', '.join(scaled)}"] if scaled else [])])


def chatter_line(figures: Figures) -> str:
    """One line with the couplings whose force reverses more often than a hand, and why; empty without any."""
    found = {name: n for name, n in figures.table(names.CHATTER).items() if n >= MOST_REVERSALS}
    if not found:
        return ""
    most = ", ".join(f"{name} up to {n:.0f} times a second" for name, n in sorted(found.items()))
    if names.UNFINISHED in figures:
        whose, remedy = "scene", "ticks are late, or a contact opens and closes"
    elif figures.table(names.HELD):
        whose, remedy = "model", "its proxies jump, or ticks are late"
    else:
        whose, remedy = "model", "docs/models.md says why, and what a proxy does about it"
    return f"the {whose}'s force chatters: {most}; {remedy}"


def held_line(figures: Figures) -> str:
    """One line with the couplings whose proxies the proxy test held; empty without any."""
    held = [f"{name} in {counted(n, 'tick')}" for name, n in figures.table(names.HELD).items() if n > 0.0]
    return f"proxies held: {', '.join(held)}" if held else ""


def scene_line(figures: Mapping[str, float]) -> str:
    """One line with the ticks of a scene that were not solved or held its driven bodies; empty without any."""
    parts = []
    if (unfinished := figures.get(names.UNFINISHED, 0.0)) > 0.0:
        parts.append(f"contacts not solved to the end in {counted(unfinished, 'tick')}")
    if (paused := figures.get(names.PAUSED, 0.0)) > 0.0:
        parts.append(
            f"driven bodies paused in {counted(paused, 'tick')}, {figures.get(names.DRIVE_TANK, 0.0):.3g} J in the tank"
        )
    return "; ".join(parts)


def world_lines(figures: Figures) -> list[str]:
    """What the environment's figures say of energy between users, proxies, scenes and chatter; a line for each."""
    lines = (energy_line(figures), held_line(figures), scene_line(figures), chatter_line(figures))
    return [line for line in lines if line]


def promise_lines(rows: Iterable[PromiseStatus], notices: Collection[str] = ()) -> Iterator[tuple[str, str]]:
    """How the promises of a session stand, as lines, each with a style: the kept ones in one line, then the others.

    Args:
        rows: the promises.
        notices: the sentences that are printed beside the lines, and not repeated in them.
    """
    shown = condensed(rows)
    kept = [row.promise for row in shown if row.state == PromiseState.KEPT]
    if kept:
        yield f"kept: {', '.join(kept)}", ""
    for row in missed(shown):
        more = f"; {row.remark}" if _says_more(row) and row.remark not in notices else ""
        yield sentence(row) + more, _STYLES[PromiseState(row.state)] if is_present(row) else "dim"


def _says_more(row: PromiseStatus) -> bool:
    """Whether a row's remark has more than its cost: how a node is away, how long the others waited, or why a
    hand lacks its force.
    """
    away = row.promise == Promise.PRESENCE and row.state == PromiseState.BROKEN
    return bool(row.remark) and (away or row.promise in (Promise.PUNCTUALITY, Promise.GIVEN))


_STYLES: Final = {
    PromiseState.UNJUDGED: "",
    PromiseState.ENFORCED: "cyan",
    PromiseState.UNCHECKED: "magenta",
    PromiseState.BROKEN: "red",
}


@contextmanager
def status(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show the present activity on a terminal; yields a function that changes the text."""
    if not console.is_terminal:
        yield lambda _text: None
        return
    with console.status(text) as shown:
        yield shown.update


class TellsProgress(Protocol):
    """Shows how much is done."""

    def __call__(self, done: float | None = None, text: str | None = None, total: float | None = None) -> None:
        """``done`` of ``total`` is done, and ``text`` goes on; what is None stays as it is."""


@contextmanager
def progress_bar(console: Console, text: str, total: float | None = 1.0) -> Iterator[TellsProgress]:
    """Show a progress bar on a terminal, and remove it afterwards; yields a function that moves it.

    Args:
        console: where it goes.
        text: what is going on.
        total: what is to be done; None where that is not known yet.
    """
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(text, total=total)

        def tell(done: float | None = None, text: str | None = None, total: float | None = None) -> None:
            bar.update(task, completed=done, description=text, total=total)

        yield tell


def printable(text: str) -> str:
    """``text`` with a replacement character for every control code: names and sentences of guests may hold terminal
    commands.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in text)


def say(console: Console, text: str) -> None:
    """Print a message as it is: no markup, no pictures for names between colons, and no control codes.

    A terminal breaks it between words; what goes elsewhere stays one line.
    """
    console.print(printable(text), markup=False, emoji=False, soft_wrap=not console.is_terminal)


def could_help(err: Console, error: BaseException | None) -> tuple[TriedChange, ...]:
    """Try what would help where an error can say it, and print each change that does, with what it gives.

    A Ctrl-C ends the search, and nothing else.

    Args:
        err: where to.
        error: why something is not certified, or the cause of that.
    """
    found: list[TriedChange] = []
    if isinstance(error, Infeasible):
        with suppress(KeyboardInterrupt):
            for one in error.search():
                say(err, f"  could help: {one}")
                found.append(one)
        if error.untried:
            say(err, f"  not tried to the end, for lack of time: {', '.join(error.untried)}")
    return tuple(found)


def ranks(units: Units = TRANSLATING) -> dict[str, int]:
    """By column of the figures, and of the roles, which a narrow table leaves out first: the highest.

    A name often makes the role clear.
    """
    return {**{heading(column.title, units): column.rank for _, column in COLUMNS}, "role": 8}
