"""The session of a recording as it ran: its coupling, its certificate and its ladder, from the file's attachments."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from manyhands.design.errors import CertificateError, OldCertificate
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import UNCERTIFIED, Prepared, prepare
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, SESSION_FILE, media_type

StepProgress = Callable[[str], None]

MOST_VALUES: Final = 100_000_000
"""The most numbers of a recording that is recomputed: the recorded and the recomputed ones need 0.8 GB each."""


def prepared_of(path: Path, run: RecordedRun, progress: StepProgress | None = None) -> Prepared:
    """The session of a recording with its coupling, its certificate and its ladder.

    Args:
        path: the recording, for messages.
        run: its content.
        progress: called with the step of a design, where one is needed: for a ladder, or a session without certificate.

    Raises:
        RecordingError: session or certificate are missing or cannot be read, or differ from those that were recorded.
            Where the certificate's version is read no more, the message names the release that audits the recording.
        NotCertified: the certificate does not hold, or belongs to another session.
    """
    with _unpacked(path, run) as folder:
        session = _session(path, run, folder)
        certified = CERTIFICATE_FILE in run.attachments
        if not certified and not run.recorded.certificate.startswith(UNCERTIFIED):
            raise RecordingError(
                f"{path}: found no certificate in it; expected {run.recorded.certificate[:16]} attached"
            )
        try:
            prepared = prepare(session, folder / CERTIFICATE_FILE if certified else None, not certified, progress)
        except OldCertificate as error:
            raise RecordingError(
                f"{path}: found a certificate of format version {error.version} in it; audit and replay it with "
                f"manyhands {error.reader}, the last release that reads one"
            ) from error
        except CertificateError as error:
            raise RecordingError(_within(path, folder, error)) from error
        except NotCertified as error:
            raise NotCertified(_within(path, folder, error)) from error
    if prepared.id != run.recorded.certificate:
        raise NotCertified(
            f"{path}: found the certificate {prepared.id[:32]} in it; expected {run.recorded.certificate[:32]}, which "
            "its session ran under by its metadata"
        )
    return prepared


@contextmanager
def _unpacked(path: Path, run: RecordedRun) -> Iterator[Path]:
    """A temporary folder with the recording's session, and with its certificates if there are any."""
    if SESSION_FILE not in run.attachments:
        raise RecordingError(f"{path}: found no session in it; expected the attachment {SESSION_FILE}")
    with tempfile.TemporaryDirectory(prefix="recorded-") as temporary:
        folder = Path(temporary)
        for name, data in run.attachments.items():
            if media_type(name):
                (folder / name).write_bytes(data)
        yield folder


def _session(path: Path, run: RecordedRun, folder: Path) -> Session:
    try:
        session = load_session(folder / SESSION_FILE)
    except SessionError as error:
        raise RecordingError(_within(path, folder, error)) from error
    recorded, graph = run.recorded, Plan(session).graph
    for what, found, expected in (
        ("name", session.name, recorded.session),
        ("period", session.period, recorded.period),
        ("periods of sites", session.own_periods, dict(recorded.periods)),
        ("wave links", tuple(session.wave_links), recorded.linked),
        ("nodes", dict(graph.nodes), dict(recorded.roles)),
        ("ports", {name: graph.ports[name] for name in graph.nodes}, dict(recorded.ports)),
        ("masses", session.environment.reported(session.ports), tuple(recorded.masses)),
        ("orientations", session.environment.oriented, tuple(recorded.oriented)),
        ("devices whose orientation is a port", session.hands, tuple(recorded.hands)),
        ("devices whose orientation is sensed", session.sensed_hands, tuple(recorded.sensed)),
    ):
        if found != expected:
            raise RecordingError(
                f"{path}: found a session with the {what} {found!r:.200}; expected {expected!r:.200}, as recorded"
            )
    values = run.ticks * sum(len(trace.columns) for trace in run.traces.values())
    if values > MOST_VALUES:
        raise RecordingError(
            f"{path}: found {values} numbers; expected at most {MOST_VALUES}, since all are kept in memory"
        )
    return session


def _within(path: Path, folder: Path, error: Exception) -> str:
    """An error's text, with the recording's name in place of the temporary folder's."""
    return str(error).replace(f"{folder}/", f"{path}: in it: ")
