"""A run beside the program that started it: the supervisor in a thread, the session's processes as always.

The supervisor waits in a poll, so that its thread needs the interpreter a few times a second only. The nodes are
processes of their own, which nothing that this program does can delay, except by the processors that it uses.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import Outcome, Progress
from manyhands.launch.run.processes import EndRequest
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervised import claimed_files, run_prepared, write_files


class RunFailed(Exception):
    """A session's processes failed; the message has the first fault, and ``faults`` all of them.

    Example:
        >>> import manyhands as mh
        >>> error = mh.RunFailed("example-1", ("dx: ended with 1", "cx: ended with 1"))
        >>> print(error)
        example-1: dx: ended with 1 (and 1 more)
    """

    def __init__(self, session: str, faults: tuple[str, ...]) -> None:
        super().__init__(f"{session}: {faults[0]}" + (f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""))
        self.faults = faults


class BackgroundRun:
    """A session that runs while the ``with`` block does; :func:`manyhands.launch.app.api.run` makes it.

    Entering it starts the processes and waits until all of them are ready. Leaving it ends the session, waits until
    every process is gone, and writes what was asked for. It is entered once.

    Attributes:
        prepared: the session with its coupling and certificate.
        outcome: how the run went, once it is over; None before.
    """

    def __init__(self, prepared: Prepared, ways: Reach, options: StartOptions) -> None:
        """Plan a run; nothing is started yet.

        Args:
            prepared: the session with its coupling and certificate.
            ways: how the processes reach each other.
            options: its clock, its ticks, and what is kept of it.
        """
        self.prepared = prepared
        self.outcome: Outcome | None = None
        self._ways, self._options = ways, options
        self._progress: Progress | None = None
        self._changed = threading.Condition()
        self._ended = False
        self._error: BaseException | None = None
        self._request: EndRequest | None = None
        self._thread = threading.Thread(target=self._run, name=f"manyhands-{prepared.session.name}")
        self._files = ExitStack()

    def __enter__(self) -> Self:
        """Start the session, and wait until it runs.

        Raises:
            RuntimeError: the run has been entered before.
            RecordingError, TargetError: a file cannot be written.
            RunFailed: the session did not start.
        """
        if self._request is not None:
            raise RuntimeError("a run is entered once: make a new one for each with block")
        with ExitStack() as files:
            files.enter_context(claimed_files(self._options))
            self._files = files.pop_all()
        self._request = EndRequest()
        self._thread.start()
        try:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or self._phase is SessionPhase.RUNNING)
        except BaseException:
            self._finish()
            raise
        if self._failed:
            self._finish()
            self._raise()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the session, and wait until nothing of it is left.

        Raises:
            RunFailed: a process failed; not raised over an exception of the block.
            RecordingError, TargetError, OSError: a file cannot be written.
        """
        self._finish()
        if kind is None:
            self._raise()

    def _finish(self) -> None:
        self.stop()
        self._thread.join()
        self._files.close()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error
        if self.outcome is not None and self.outcome.faults:
            raise RunFailed(self.prepared.session.name, self.outcome.faults)

    def stop(self) -> None:
        """Ask the session to end, as Ctrl-C does; :meth:`wait` waits for the end."""
        if self._request is not None:
            self._request.ask()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the session is over.

        Args:
            timeout: s, at most; None for as long as it takes.

        Returns:
            Whether it is over.
        """
        with self._changed:
            return self._changed.wait_for(lambda: self._ended, timeout)

    def wait_for(self, condition: Callable[[Progress], bool], timeout: float | None = None) -> bool:
        """Wait until a condition of the session's state holds, or the session is over.

        Args:
            condition: called with :attr:`progress` whenever it changes.
            timeout: s, at most; None for as long as it takes.

        Returns:
            Whether it holds.

        Raises:
            RuntimeError: the run has not been entered.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._ended or condition(self.progress), timeout)
            return condition(self.progress)

    @property
    def progress(self) -> Progress:
        """The session's state: its phase, that of each node, and the latest telemetry. It changes a few times a second.

        Raises:
            RuntimeError: the run has not been entered.
        """
        if self._progress is None:
            raise RuntimeError("the run has not begun: ask inside its with block")
        return self._progress

    @property
    def report(self) -> Mapping[str, Any]:
        """The report of the run (docs/files.md).

        Raises:
            RuntimeError: the run is not over.
        """
        if self.outcome is None:
            raise RuntimeError("the run is not over: ask after wait(), or after its with block")
        return self.outcome.report

    def __repr__(self) -> str:
        session, clock = self.prepared.session.name, self._options.clock
        if self.outcome is None:
            state = "not started" if self._progress is None else self._progress.phase.value
        else:
            state = f"over after {self.outcome.report['duration']:g} s, {len(self.outcome.faults)} faults"
        return f"BackgroundRun({session}, {clock} clock, {state})"

    @property
    def _phase(self) -> SessionPhase | None:
        return None if self._progress is None else self._progress.phase

    @property
    def _failed(self) -> bool:
        return self._error is not None or (self.outcome is not None and bool(self.outcome.faults))

    def _show(self, progress: Progress) -> None:
        with self._changed:
            self._progress = progress
            self._changed.notify_all()

    def _run(self) -> None:
        """Run the session; the body of the thread."""
        try:
            show, interrupt = self._show, self._request
            self.outcome = run_prepared(self.prepared, self._ways, self._options, show=show, interrupt=interrupt)
            write_files(self.outcome, self._options, lambda _text: None)
        except BaseException as error:  # noqa: BLE001  # raised again in the thread that leaves the block
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
