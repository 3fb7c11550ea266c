"""Sessions that refuse to start and report why: a wrong member, or a wrong certificate."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import pytest

from manyhands.design.certificate import content, identity, to_json
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.kernel.bundle import Bundle, CouplingBundle

from ..support.commands import MANYHANDS
from .rogues.stage import SESSION, Forge, play, prepared


def stolen(stiffer: float) -> dict[str, Any]:
    """The certificate's content with one block so many times as stiff; its id is left as it was."""
    certificate = prepared().certificate
    assert certificate is not None
    data: dict[str, Any] = json.loads(to_json(certificate))
    data["coupling"]["blocks"]["cy"]["stiffness"][0][0] *= stiffer
    return data


def in_cy(change: Callable[[CouplingBundle], CouplingBundle]) -> Forge:
    def forge(bundles: dict[str, Bundle]) -> dict[str, Bundle]:
        cy = bundles["cy"]
        assert isinstance(cy, CouplingBundle)
        return {**bundles, "cy": change(cy)}

    return forge


def with_other_feedthrough(bundle: CouplingBundle) -> CouplingBundle:
    block = bundle.block
    return replace(bundle, block=StateSpace(block.A, block.B, block.C, block.D * 1.01))


def with_stolen_certificate(bundle: CouplingBundle) -> CouplingBundle:
    """With a block that could be certified, too, but differs from the agreed one."""
    return replace(bundle, common=replace(bundle.common, certificate=identity(stolen(1.5))))


@dataclass(frozen=True)
class Ending:
    """A cause that ends a session, and its message."""

    sentence: str
    acts: Mapping[str, str] | None = None
    forge: Forge | None = None


ENDINGS: Final = {
    "a hello under another's name": Ending(
        "supervisor refused dx: found the name dz from dx; expected its own", acts={"dx": "under another's name"}
    ),
    "an endpoint for a link of others": Ending(
        "supervisor refused cy: found endpoints for dy, dz; expected them for dy", acts={"cy": "with another's link"}
    ),
    "a handshake that stops half-way": Ending(
        "found no answer of dx in the time allowed (awaiting welcome)",
        acts={"dx": "halfway device", "cx": "hurried coupling"},
    ),
    "another feedthrough than the certificate's": Ending(
        "environment refused cy: found a feedthrough D_V with the digest", forge=in_cy(with_other_feedthrough)
    ),
    "a stolen certificate with one block changed": Ending(
        "supervisor refused cy: found the certificate", forge=in_cy(with_stolen_certificate)
    ),
}


@pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS)
def test_a_session_does_not_start_with(ending: Ending) -> None:
    outcome = play(acts=ending.acts, forge=ending.forge).outcome
    assert outcome.code == 1
    assert ending.sentence in outcome.faults[0]
    assert outcome.recording is not None
    assert outcome.recording.x.shape[0] == 0, "a hand was moved"
    assert all(node["ticks"] == 0 for node in outcome.report["nodes"].values())


def unchanged_id(data: dict[str, Any]) -> None:
    """The thief knows of no id."""


def id_made_anew(data: dict[str, Any]) -> None:
    data["id"] = identity(data)


def other_session(data: dict[str, Any]) -> None:
    certificate = prepared().certificate
    assert certificate is not None
    data.update(content(certificate), session="example-2")
    data["id"] = identity(data)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        pytest.param(
            unchanged_id, "not proved: the id is the SHA-256 of the content", id="one block changed, the id as it was"
        ),
        pytest.param(id_made_anew, "not proved: V_hat of cy is Delta_V-OSP", id="one block changed, the id made anew"),
        pytest.param(other_session, "a certificate of another session", id="one that holds, of another session"),
    ],
)
def test_launch_refuses_a_stolen_certificate(
    change: Callable[[dict[str, Any]], None], sentence: str, tmp_path: Path
) -> None:
    data = stolen(3.0)
    change(data)
    path = tmp_path / "stolen.json"
    path.write_text(json.dumps(data))
    done = subprocess.run(
        [*MANYHANDS, "launch", str(SESSION), "--certificate", str(path), "--transport", "tcp", "--duration", "0.1"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 3, done.stderr
    assert sentence in " ".join(done.stderr.split())
    assert done.stdout == ""
