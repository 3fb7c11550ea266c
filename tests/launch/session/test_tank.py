"""What lateness may put in, as a session file states it: a number, or an energy and a power."""

from __future__ import annotations

import pytest

from manyhands.launch.session import SessionError, load_session
from manyhands.nodes.kernel.allowance import LatenessAllowance

from ...support.simulated_recordings import SESSIONS

EXAMPLE = SESSIONS / "example1.yaml"


@pytest.mark.parametrize(
    ("override", "tank"),
    [
        ([], LatenessAllowance(5e-3, 1e-3)),
        (["faults.tank=0.02"], LatenessAllowance(0.02)),
        (["faults.tank=0"], LatenessAllowance(0.0)),
        (["faults.tank={energy: 0.01, power: 0.002}"], LatenessAllowance(0.01, 0.002)),
    ],
)
def test_a_tank_is_a_number_or_energy_and_power(override: list[str], tank: LatenessAllowance) -> None:
    session = load_session(EXAMPLE, override)
    assert session.faults.tank == tank
    assert session.faults.enforced_tank == tank
    written = session.model_dump(by_alias=True)["faults"]["tank"]
    assert written == ({"energy": tank.energy, "power": tank.power} if tank.power else tank.energy)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("faults.tank=-1", "a tank in J from 0 to 10"),
        ("faults.tank={energy: 0.01}", "{energy: ..., power: ...} in J and W, or a number in J"),
        ("faults.tank={energy: 0.01, power: 2}", "a power in W from 0 to 1"),
        ("faults.tank=[1, 2]", "a tank in J"),
    ],
)
def test_another_tank_is_refused(override: str, words: str) -> None:
    with pytest.raises(SessionError) as caught:
        load_session(EXAMPLE, [override])
    assert "faults.tank" in str(caught.value)
    assert words in str(caught.value)
