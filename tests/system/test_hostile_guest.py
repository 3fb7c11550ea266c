"""A guest whose face sends waves of any size ends nobody's session, and changes nobody's account but its own.

Real processes over encrypted TCP and datagrams; the guest's wave link is the product's, except for what it tells.
"""

from __future__ import annotations

import json
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest

from ..support.capture import free_ports
from .test_seats import SEATS, command, guest, hosted, invitation_to

HOSTILE = '''
"""Every Python process of this user begins with this: from the 500th message on U is between 1e-2 and 1e6."""
from random import Random

from manyhands.nodes.wave_link import faces

honest, chance, count = faces._Face.message, Random(1), [0]


def message(face):
    told = honest(face)
    count[0] += 1
    if count[0] < 500:
        return told
    size = 10.0 ** chance.uniform(-2.0, 6.0) * chance.choice([-1.0, 1.0])
    return told._replace(U=tuple(at + size if count[0] % 2 else size for at in told.U))


faces._Face.message = message
'''


@pytest.mark.long
@pytest.mark.alone
def test_bursts_of_a_guest_end_no_session_and_change_no_other_account(tmp_path: Path) -> None:
    """Nothing bounded such waves: the world played all of them, and the tanks at both ends kept what they left."""
    home, here, there, code = (tmp_path / name for name in ("home", "here", "there", "code"))
    code.mkdir()
    (code / "sitecustomize.py").write_text(HOSTILE)
    address = f"127.0.0.1:{free_ports(4)[0]}"
    with ExitStack() as stack:
        host = stack.enter_context(hosted(home, address))
        left = stack.enter_context(guest("left_seat", home, here))
        path = invitation_to("right_seat", home, there)
        hostile = command("join", path.name, "--yes", cwd=there, within=("env", f"PYTHONPATH={code}"))
        stack.enter_context(hostile)
        host.joined(*SEATS)
        host.go_on(3000)
        assert host.there >= {"left_seat", "left"}
        assert host.end(signal.SIGINT) == 130
        assert left.end() == 0
    report = json.loads((home / "run.json").read_text())
    world = report["nodes"]["environment"]
    assert world["dropped"]["out_of_range"] > 500
    energy = world["energy"]
    assert "left_seat" not in energy.get("scaled", {})
    assert "left_seat" not in energy.get("stopped", {})
    assert energy.get("given", {}).get("right_seat", 0.0) < 0.1
    assert world["ledger"]["margin"] >= -1e-12
