"""What a recorder is given to start with: where to write, what of, and where its supervisor finds it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from manyhands.design.files import open_new
from manyhands.nodes.recorder.layout import Recorded


class PlanError(Exception):
    """A plan cannot be read; names the file and what is wrong."""


@dataclass(frozen=True)
class Plan:
    """A recorder's plan.

    Attributes:
        file: the recording, absolute.
        directory: the run's own directory, mode 0700, where the recorder binds its socket.
        recorded: what it will be told.
        attachments: files that go into the recording, contents by name; texts.
        started: when the recording was, ns since 1970.
    """

    file: Path
    directory: Path
    recorded: Recorded
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    started: int = 0

    def save(self, path: Path) -> None:
        """Write it for its owner's eyes only (mode 0600).

        Raises:
            OSError: the file cannot be written.
        """
        plain = {
            "file": str(self.file),
            "directory": str(self.directory),
            "recorded": self.recorded.as_metadata(),
            "attachments": {name: data.decode() for name, data in self.attachments.items()},
            "started": self.started,
        }
        with open_new(path, mode=0o600) as file:
            file.write(json.dumps(plain).encode())

    @classmethod
    def load(cls, path: Path) -> Plan:
        """Read it.

        Raises:
            PlanError: not readable, or no plan.
        """
        try:
            data = json.loads(path.read_text())
            return cls(
                Path(data["file"]),
                Path(data["directory"]),
                Recorded.from_metadata(data["recorded"]),
                {name: text.encode() for name, text in data["attachments"].items()},
                int(data["started"]),
            )
        except OSError as error:
            raise PlanError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise PlanError(f"{path}: not a recorder's plan: {type(error).__name__}: {error}") from error
