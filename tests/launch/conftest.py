"""Random sessions for everything that follows from a session's structure; a recording of Example 1's first ticks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.session import Session

from ..support.simulated_recordings import TICKS, attachments_of, prepared_as, recorded_of, simulated, written


@st.composite
def plain_sessions(draw: st.DrawFn) -> dict[str, Any]:
    """A session with random devices whose ports are dealt to random couplings in a random order, and observers."""
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=4))
    devices = {f"d{i}": {"dof": n, "osp": 1.0, "driver": "simulated", "mass": 0.2} for i, n in enumerate(sizes)}
    ports = [f"d{i}.{a}" if n > 1 else f"d{i}" for i, n in enumerate(sizes) for a in range(n)]
    dealt = draw(st.permutations(ports))
    owner = [draw(st.integers(0, 2)) for _ in dealt]
    couplings = {
        f"c{c}": {"ports": [p for p, o in zip(dealt, owner, strict=True) if o == c]} for c in sorted(set(owner))
    }
    channels = ["telemetry", "environment/telemetry"]
    channels += [f"{name}/{channel}" for name in devices for channel in ("sample", "force", "telemetry")]
    channels += [f"{name}/{channel}" for name in couplings for channel in ("tool", "reaction", "telemetry")]
    reads = st.lists(st.sampled_from(channels), min_size=1, max_size=5, unique=True)
    links = [{"between": [port, "ground"], "stiffness": 100.0, "damping": 0.1} for port in ports]
    return {
        "session": "drawn",
        "period": 0.001,
        "devices": devices,
        "couplings": couplings,
        "environment": {"type": "network", "masses": {}, "links": links},
        "design": {"coupling": "spring-damper"},
        "observers": {f"o{i}": {"reads": draw(reads)} for i in range(draw(st.integers(0, 2)))},
    }


@pytest.fixture(scope="session")
def drawn_plain_sessions() -> st.SearchStrategy[dict[str, Any]]:
    """Random sessions as a file has them."""
    return plain_sessions()


@pytest.fixture(scope="session")
def drawn_sessions() -> st.SearchStrategy[Session]:
    """Random sessions."""
    return plain_sessions().map(lambda plain: Session.model_validate(plain, context={"folder": Path()}))


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepared_as("example1")


@pytest.fixture(scope="module")
def recording(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    return written(path, recorded_of(prepared), attachments_of(prepared), simulated(prepared, TICKS))
