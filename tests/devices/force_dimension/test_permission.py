"""A maker's library is code: a run states which one it loads, and none that a file from elsewhere names is loaded."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from manyhands.launch.app.risks import warn_of_code
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.factory import FactoryError, FactoryName, is_shipped, require_allowed

FACTORY = "manyhands.devices.force_dimension:ForceDimension"

LINKS = ", ".join(f"{{between: [omega.{axis}, ground], stiffness: 10}}" for axis in range(3))

SESSION = """
session: desk
period: 0.001
devices:
  omega: {{dof: 3, osp: 1.0, driver: {driver}, parameters: {{{parameters}}}}}
couplings: {{hand: {{devices: [omega]}}}}
environment: {{type: network, links: [{links}]}}
design: {{coupling: spring-damper}}
"""


def stated(folder: Path, driver: str, parameters: str, *elsewhere: str) -> str:
    path = folder / "desk.yaml"
    path.write_text(SESSION.format(driver=driver, parameters=parameters, links=LINKS))
    text = io.StringIO()
    warn_of_code(Console(file=text, width=1000), load_session(path), elsewhere)
    return text.getvalue()


def test_a_run_states_which_library_it_loads(tmp_path: Path) -> None:
    said = stated(tmp_path, "force-dimension", "library: /opt/sdk/libdrd.so")
    assert "omega loads a maker's library, which is not confined (devices.omega.driver): /opt/sdk/libdrd.so" in said
    assert "libdrd as FORCEDIM_SDK names it" in stated(tmp_path, "force-dimension", "serial: 7001")
    assert stated(tmp_path, "force-dimension", "serial: 7001", "omega") == ""
    assert "maker's library" not in stated(tmp_path, "serial-board", "port: /dev/ttyACM0")


@pytest.mark.parametrize("allowed", [None, FACTORY])
def test_a_library_that_a_file_from_elsewhere_names_is_refused(allowed: str | None) -> None:
    name = FactoryName(FACTORY, {"library": "/tmp/theirs.so"})
    assert is_shipped(FACTORY)
    with pytest.raises(FactoryError, match=r"parameters.library: found '/tmp/theirs.so', code that a file from"):
        require_allowed(name, allowed)


def test_the_driver_itself_needs_the_permission_that_others_need() -> None:
    name = FactoryName(FACTORY, {"serial": 7001})
    with pytest.raises(FactoryError, match="no permission for it"):
        require_allowed(name, None)
    require_allowed(name, FACTORY)
