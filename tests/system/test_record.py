"""A session that already runs is recorded from another terminal, inspected, and exported."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.recordings.info import read_info
from manyhands.launch.recordings.integrity import findings
from manyhands.launch.recordings.run import read_run

from ..support.commands import read_until, started


@pytest.mark.long
def test_a_running_session_is_recorded_from_another_terminal(tmp_path: Path) -> None:
    kept, part, rest = tmp_path / "run", tmp_path / "part.mcap", tmp_path / "rest.mcap"
    slow = ["--set", "design.tau=0", "--set", "period=0.01"]  # a tenth of the ticks to record and to read
    with started("launch", "example1.yaml", *slow, "--directory", kept) as session:
        read_until(session, "running")
        with (
            started("record", kept, "-o", part) as first,
            started("record", "--running", "example-1", "-o", rest) as other,
        ):
            read_until(first, "recording example-1")
            read_until(other, "recording example-1")
            first.send_signal(signal.SIGINT)
            said = first.communicate(timeout=120)[1]
            assert first.returncode == 0, said
            assert "it was asked to end;" in said
            assert session.poll() is None  # it goes on, and so does the other recording
            session.send_signal(signal.SIGINT)
            said = other.communicate(timeout=120)[1]
            assert (other.returncode, session.wait(120)) == (0, 130), said
            assert "the session is over;" in said or "the session's supervisor is gone;" in said

    for file in (part, rest):
        assert findings(file) == []
        info, whole = read_info(file), read_run(file)
        assert (info.cut, info.recorded.session, info.recorded.masses) == (None, "example-1", ("hub",))
        assert {name: (kept / name).read_bytes() for name in ("session.yaml", "certificate.json")} == whole.attachments
        assert info.first is not None
        told = {device: ~np.isnan(whole.traces[device, "sample"].values[:, 0]) for device in info.recorded.devices}
        assert min(int(np.flatnonzero(there)[0]) for there in told.values() if there.any()) == info.first
        for device, there in told.items():
            assert int((~there[info.first : info.ticks]).sum()) == info.missing.get(device, 0)
    assert json.loads((kept / "certificate.json").read_text())["id"] == info.recorded.certificate
