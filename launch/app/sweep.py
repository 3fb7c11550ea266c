"""A sweep: the same task for many sessions, on any executor, with a journal from which an ended sweep goes on.

Each case is a session with some values changed. What is done is one line of the journal: a whole line, written at once
and brought to the disk, or none. A line is known by its case, the SHA-256 over the session, the task and the version of
this program. So a second run of the same sweep, or of a larger one, computes only what the journal does not have.

A process that dies takes others with it: a pool of processes is broken as a whole. The cases that were under way are
then computed again one by one, each in a pool that is not broken, so that the one that kills its process is found.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands import __version__
from manyhands.design.errors import DesignError
from manyhands.design.files import naming, replacing
from manyhands.design.models.brief import brief_names
from manyhands.launch.app.api import Source, load
from manyhands.launch.files import TargetError, claimed, require_target
from manyhands.launch.plan.sites import whole
from manyhands.launch.recordings.formats import write_csv
from manyhands.launch.recordings.recording import data_frame, require_format
from manyhands.launch.session import Session

if TYPE_CHECKING:
    import pandas

Row = Mapping[str, str | int | float | bool | None]
"""What a task finds: plain values by name."""
Task = Callable[[Session], Row]
"""A function at the top level of a module, so that other processes can import it."""

_HEAD: Final = b"manyhands-sweep 1"
"""The first line of a journal."""
_UNDER_WAY: Final = 64  # cases that are handed to an executor at once; more only fill its queue


def designed(session: Session) -> Row:
    """The task of a sweep by default: the session's coupling, designed and proved.

    Returns:
        Whether it is ``certified``; its least ``stiffness_N/m``, and that of each coupling where there are several, as
        ``stiffness_cx_N/m``; the ``margin_N·s/m`` of condition (10), ``gamma`` of a
        transparency aim, and the ``certificate`` by its id; or the ``reason`` why there is none.
    """
    try:
        found = whole(session).design().certificate
    except DesignError as error:
        return {"certified": False, "reason": str(error)}
    partition, units = found.loop.partition, found.loop.units
    each = {
        f"stiffness_{name}_{units(*(found.loop.ports[p] for p in ports))('N/m')}": float(
            np.linalg.eigvalsh(found.stiffness[np.ix_(ports, ports)])[0]
        )
        for name, ports in zip(partition.names, partition.blocks, strict=True)
        if len(partition.names) > 1
    }
    return {
        "certified": True,
        f"stiffness_{units()('N/m')}": float(np.linalg.eigvalsh(found.stiffness)[0]),
        **each,
        f"margin_{units()('N·s/m')}": found.margins["(10)"],
        "gamma": None if found.transparency is None else found.transparency.gamma,
        "certificate": found.id,
    }


@dataclass(frozen=True, eq=False)
class Sweep:
    """The results of a sweep, in the order of its cases.

    Attributes:
        cases: what each case has changed, by path of keys.
        rows: what the task found of each; None for a case without a result.
        errors: why a case has no result, by its index.
    """

    cases: tuple[Mapping[str, Any], ...]
    rows: tuple[Row | None, ...]
    errors: Mapping[int, str]

    def __len__(self) -> int:
        return len(self.cases)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The results as a table by name: what was changed, what was found, and ``error`` where a case has none.

        A number that a case does not have is NaN.
        """
        changed = dict.fromkeys(key for case in self.cases for key in case)
        found = dict.fromkeys(key for row in self.rows if row is not None for key in row)
        table = {key: _column([case.get(key) for case in self.cases]) for key in changed}
        table |= {key: _column([None if row is None else row.get(key) for row in self.rows]) for key in found}
        if self.errors:
            table["error"] = _column([self.errors.get(index, "") for index in range(len(self))])
        return table

    def to_pandas(self) -> pandas.DataFrame:
        """The table of :meth:`columns` as a data frame.

        Raises:
            RecordingError: pandas is not installed.
        """
        return data_frame(self.columns())

    def save(self, path: str | Path) -> None:
        """Write the table of :meth:`columns` as ``.csv``, whole or not at all.

        Raises:
            RecordingError: the suffix is another.
            OSError: nothing can be written there.
        """
        path = Path(path)
        require_format(path, (".csv",))
        with replacing(path) as file:
            write_csv(file, self.columns())

    def __repr__(self) -> str:
        varied = brief_names([*dict.fromkeys(key for case in self.cases for key in case)])
        return f"Sweep({len(self)} cases of {varied}; {len(self.errors)} without a result)"


def _column(values: list[Any]) -> NDArray[Any]:
    """An array of numbers where all values are, with NaN for None; else of the values as they are."""
    numbers = [value for value in values if value is not None]
    if numbers and all(isinstance(value, bool) for value in numbers) and len(numbers) == len(values):
        return np.array(values, dtype=np.bool_)
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in numbers):
        return np.array([np.nan if value is None else value for value in values])
    column = np.empty(len(values), dtype=np.object_)
    column[:] = values
    return column


def sweep(
    session: Source,
    changes: Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]],
    task: Task = designed,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    journal: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Compute a task for many variants of a session, in parallel.

    Args:
        session: the session, or what :func:`manyhands.launch.app.api.load` takes.
        changes: a list of values for each path of keys, of which every combination is a case; or a list of cases, each
            as :meth:`Session.replace` takes it.
        task: what to compute of each session; by default its design, :func:`designed`.
        executor: where it is computed: any executor of ``concurrent.futures``, or ``Client.get_executor()`` of Dask. By
            default a pool of processes of this machine, which is replaced if one of its processes dies.
        workers: number of processes of that pool; by default one for each processor.
        journal: a file that keeps what is done. If it exists, the sweep goes on from there.
        progress: called with the number of cases that are done, and of all.

    Returns:
        The results. A case whose task raised an error, or killed its process, has none, and is tried again by the next
        sweep with this journal.

    Raises:
        SessionError: a case is no session.
        TargetError: the journal cannot be written, or is another file.
        BrokenExecutor: the executor that was given broke; the journal has what was done before.
        ValueError: the task is a lambda or a local function, and a journal or other processes need its name.

    Example:
        >>> import manyhands as mh
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> with ThreadPoolExecutor(1) as executor:
        ...     found = mh.sweep("example1", {"design.tau": [0.0, 0.0005], "period": [0.001, 0.002]}, executor=executor)
        >>> found
        Sweep(4 cases of design.tau, period; 0 without a result)
        >>> found.columns()["stiffness_N/m"].round()
        array([1110.,  589.,  391.,  294.])
    """
    named = getattr(task, "__qualname__", "<without a name>")
    if "<" in named and (journal is not None or executor is None):
        expected = "a function at the top level of a module, which other processes and the journal know by its name"
        raise ValueError(f"task: found {named}; expected {expected}")
    base = load(session)
    cases = _cases(changes)
    sessions = [base.replace(case) for case in cases]
    names = [_identity(one, task) for one in sessions]
    rows: dict[int, Row] = {}
    errors: dict[int, str] = {}
    with ExitStack() as stack:
        kept = None if journal is None else stack.enter_context(_Journal(Path(journal)))
        known = {} if kept is None else kept.rows
        rows |= {index: known[name] for index, name in enumerate(names) if name in known}
        todo = [index for index in range(len(cases)) if index not in rows]
        if progress is not None:
            progress(len(rows), len(cases))
        work = partial(_computed, task)
        plain = {index: sessions[index].to_dict() for index in todo}
        for index, outcome in stack.enter_context(closing(_outcomes(work, plain, executor, workers))):
            if isinstance(outcome, str):
                errors[index] = outcome
            else:
                rows[index] = outcome
                if kept is not None:
                    kept.add(names[index], cases[index], outcome)
            if progress is not None:
                progress(len(rows) + len(errors), len(cases))
    return Sweep(cases, tuple(rows.get(index) for index in range(len(cases))), errors)


def _cases(changes: Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]]) -> tuple[Mapping[str, Any], ...]:
    if isinstance(changes, Mapping):
        return tuple(dict(zip(changes, values, strict=True)) for values in product(*changes.values()))
    return tuple(dict(case) for case in changes)


def _identity(session: Session, task: Task) -> str:
    """The name of a case in a journal."""
    about = [__version__, task.__module__, getattr(task, "__qualname__", ""), session.as_plain()]
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


def _computed(task: Task, plain: Mapping[str, Any]) -> Row | str:
    """What the task finds of a session, or the text of the error that it raised; in whichever process this runs."""
    try:
        found = task(Session.from_dict(plain))
        return {str(name): _plain(value) for name, value in found.items()}
    except Exception as error:  # noqa: BLE001  # a task is foreign code; its error is the result of its case
        return f"{type(error).__name__}: {error}"


def _plain(value: object) -> str | int | float | bool | None:
    value = value.item() if isinstance(value, np.generic) else value
    if value is not None and not isinstance(value, str | int | float | bool):
        raise TypeError(f"found a {type(value).__name__} in the result; expected numbers, texts, true, false or None")
    return value


Outcome = Row | str
Work = Callable[[Mapping[str, Any]], Outcome]


def _outcomes(
    work: Work, plain: Mapping[int, Mapping[str, Any]], executor: Executor | None, workers: int | None
) -> Generator[tuple[int, Outcome], None, None]:
    """The outcome of each case as it comes: a row, or the text of an error. Closed early, it cancels what is left."""
    if not plain:
        return
    todo = deque(plain)
    suspects: deque[int] = deque()
    while todo or suspects:
        # forked on every version of Python: what spawns asks a user's script for an `if __name__ == "__main__"`
        pool: AbstractContextManager[Executor] = (
            ProcessPoolExecutor(workers, get_context("fork")) if executor is None else nullcontext(executor)
        )
        with pool as current:
            flying: dict[Future[Outcome], int] = {}
            try:
                while todo or suspects or flying:
                    queue, most = (suspects, 1) if suspects else (todo, _UNDER_WAY)
                    while queue and len(flying) < most:
                        flying[current.submit(work, plain[queue[0]])] = queue[0]
                        queue.popleft()  # after the submission, which a broken pool refuses
                    for future in wait(flying, return_when=FIRST_COMPLETED).done:
                        yield flying[future], future.result()
                        del flying[future]
            except BrokenProcessPool:
                if executor is not None:
                    raise
                if len(flying) == 1:
                    yield from ((index, "the process that computed it died") for index in flying.values())
                else:
                    suspects.extend(flying.values())
            finally:
                for future in flying:
                    future.cancel()


class _Journal:
    """The file of a sweep, one line of JSON for each case that is done.

    Attributes:
        rows: what is done, by the name of the case.
    """

    def __init__(self, path: Path) -> None:
        require_target(path)
        self._path = path
        self._files = ExitStack()
        self._descriptor = -1
        self.rows: dict[str, Row] = {}

    def __enter__(self) -> _Journal:
        """Lock the file, read it, and cut off a line that a killed run had begun.

        Raises:
            TargetError: another run writes to it, or it is no journal.
            OSError: it cannot be opened, or is a link.
        """
        with ExitStack() as files:
            files.enter_context(claimed(self._path))
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
            files.callback(os.close, self._descriptor)
            with open(self._descriptor, "rb", closefd=False) as file:
                whole, _, begun = file.read().rpartition(b"\n")
            head, *lines = whole.split(b"\n") if whole else [begun]
            if head != _HEAD and not (not whole and _HEAD.startswith(begun)):
                raise TargetError(f"{self._path}: found another file; expected the journal of a sweep, or none")
            for number, line in enumerate(lines, start=2):
                try:
                    known = json.loads(line)
                    self.rows[known["case"]] = known["row"]
                except (ValueError, KeyError, TypeError) as error:
                    found = f"found no case in line {number}"
                    raise TargetError(f"{self._path}: {found}; expected the journal as a sweep wrote it") from error
            os.ftruncate(self._descriptor, len(whole) + 1 if whole else 0)
            os.lseek(self._descriptor, 0, os.SEEK_END)
            if not whole:
                self._write(_HEAD)
            self._files = files.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def add(self, name: str, changes: Mapping[str, Any], row: Row) -> None:
        """Write a line for a case that is done."""
        self._write(json.dumps({"case": name, "changes": changes, "row": row}, default=repr).encode())

    def _write(self, line: bytes) -> None:
        data = line + b"\n"
        with naming(self._path):
            while data:
                data = data[os.write(self._descriptor, data) :]
            os.fsync(self._descriptor)
