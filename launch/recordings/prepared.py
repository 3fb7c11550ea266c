"""A recording's session, ready to be recomputed: from the session and the certificate that the file itself holds.

Both are read as their own files are, and nothing is believed that they do not prove: the certificate is proved again,
and has to be this session's.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from manyhands.design.errors import CertificateError
from manyhands.launch.bundles import mass_names
from manyhands.launch.plan import Plan
from manyhands.launch.preparation import UNCERTIFIED, NotCertified, Prepared, prepare
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import Run
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.nodes.recorder.layout import CERTIFICATE_FILE, SESSION_FILE

Progress = Callable[[str], None]

MOST_VALUES: Final = 100_000_000
"""Numbers of a recording that is recomputed: what is recomputed is kept beside what was recorded, 0.8 GB of each."""


def session_of(path: Path, run: Run) -> Session:
    """The session that a recording holds.

    Args:
        path: the recording, for messages.
        run: what was read from it.

    Raises:
        RecordingError: it holds none, one that cannot be read, or another one than was recorded.
    """
    with _unpacked(path, run) as folder:
        return _session(path, run, folder)


def prepared_of(path: Path, run: Run, progress: Progress | None = None) -> Prepared:
    """The session of a recording with its coupling, its certificate and its ladder.

    Args:
        path: the recording, for messages.
        run: what was read from it.
        progress: told what a design is doing, where there is one: of the ladder, or of a session without certificate.

    Raises:
        RecordingError: session or certificate are missing or cannot be read, or are not those that were recorded.
        NotCertified: the certificate does not hold, or is another session's.
    """
    with _unpacked(path, run) as folder:
        session = _session(path, run, folder)
        certified = CERTIFICATE_FILE in run.attachments
        if not certified and not run.recorded.certificate.startswith(UNCERTIFIED):
            raise RecordingError(f"{path}: found no certificate in it; expected {run.recorded.certificate[:16]}")
        try:
            prepared = prepare(session, folder / CERTIFICATE_FILE if certified else None, not certified, progress)
        except CertificateError as error:
            raise RecordingError(_within(path, folder, error)) from error
        except NotCertified as error:
            raise NotCertified(_within(path, folder, error)) from error
    if prepared.id != run.recorded.certificate:
        raise NotCertified(
            f"{path}: found the certificate {prepared.id[:32]} in it; expected {run.recorded.certificate[:32]}, which "
            "it says that its session ran under"
        )
    return prepared


@contextmanager
def _unpacked(path: Path, run: Run) -> Iterator[Path]:
    """A folder with the session, and the certificate where there is one; gone afterwards."""
    if SESSION_FILE not in run.attachments:
        raise RecordingError(f"{path}: found no session in it; expected the attachment {SESSION_FILE}")
    with tempfile.TemporaryDirectory(prefix="recorded-") as name:
        folder = Path(name)
        for attachment in (SESSION_FILE, CERTIFICATE_FILE):
            if attachment in run.attachments:
                (folder / attachment).write_bytes(run.attachments[attachment])
        yield folder


def _session(path: Path, run: Run, folder: Path) -> Session:
    try:
        session = load_session(folder / SESSION_FILE)
    except SessionError as error:
        raise RecordingError(_within(path, folder, error)) from error
    recorded, graph = run.recorded, Plan(session).graph
    for what, found, expected in (
        ("name", session.name, recorded.session),
        ("period", session.period, recorded.period),
        ("nodes", dict(graph.nodes), dict(recorded.roles)),
        ("ports", {name: graph.ports[name] for name in graph.nodes}, dict(recorded.ports)),
        ("masses", mass_names(session), tuple(recorded.masses)),
    ):
        if found != expected:
            raise RecordingError(
                f"{path}: found a session whose {what} are {found!r:.200}; expected {expected!r:.200}, as recorded"
            )
    values = run.ticks * sum(len(trace.columns) for trace in run.traces.values())
    if values > MOST_VALUES:
        raise RecordingError(
            f"{path}: found {values} numbers; expected at most {MOST_VALUES}, which memory has room for"
        )
    return session


def _within(path: Path, folder: Path, error: Exception) -> str:
    """An error's text with the recording's name in place of that of the folder that its parts were unpacked to."""
    return str(error).replace(f"{folder}/", f"{path}: in it: ")
