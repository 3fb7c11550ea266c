"""The reference of the format keeps up with the models."""

import re
from pathlib import Path

import pytest

from manyhands.launch.session import (
    BlockMatrices,
    CouplingBlock,
    Design,
    Device,
    Hand,
    Link,
    NetworkEnvironment,
    Rational,
    Session,
    TraceData,
    limits,
    load_session,
)
from manyhands.launch.session.fields import SessionModel
from manyhands.launch.session.problems import keys_of

PAGE = (Path(__file__).parents[2] / "docs" / "session-file.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))
MODELS: dict[str, tuple[type[SessionModel], ...]] = {
    "Session": (Session,),
    "Device": (Device,),
    "Hand": (Hand, Rational, TraceData),
    "Coupling": (CouplingBlock,),
    "Environment": (NetworkEnvironment,),
    "Link": (Link,),
    "Design": (Design,),
    "Matrices": (BlockMatrices,),
}


@pytest.mark.parametrize("section", MODELS)
def test_every_key_has_its_row_and_every_row_its_key(section: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \|", SECTIONS[section], flags=re.MULTILINE)
    assert rows == [key for model in MODELS[section] for key in keys_of(model)]
    assert "\nExample: `" in SECTIONS[section]


def test_every_part_of_a_session_has_a_section() -> None:
    def parts(model: type[SessionModel]) -> set[type[SessionModel]]:
        return set(model.__subclasses__()).union(*(parts(part) for part in model.__subclasses__()))

    assert parts(SessionModel) == {model for models in MODELS.values() for model in models}


def test_the_example_is_a_session(tmp_path: Path) -> None:
    (example,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    path = tmp_path / "two-hands.yaml"
    path.write_text(example, encoding="utf-8")
    assert load_session(path).blocks == (("left",), ("right.x", "right.y"))


def test_the_limits_are_the_ones_in_force() -> None:
    told = PAGE.replace(",", "")
    for limit in (
        f"most {limits.MAX_NODES} values",
        f"most {limits.MAX_DEPTH} deep",
        f"most {limits.MAX_OVERRIDES} overrides",
        f"whole 1 to {limits.MAX_DOF} |",
        f"devices by name | | required | 1 to {limits.MAX_DEVICES} |",
        f"by name | | required | 1 to {limits.MAX_COUPLINGS} |",
        f"at most {limits.MAX_PORTS}.",
        f"at most {limits.MAX_MASSES} |",
        f"1 to {limits.MAX_LINKS} |",
        f"states (at most {limits.MAX_ORDER})",
        f"degree at most {limits.MAX_DEGREE})",
    ):
        assert limit in told
    assert (limits.MAX_FILE_BYTES, limits.MAX_MAGNITUDE, limits.MIN_POSITIVE) == (1 << 20, 1e12, 1e-12)
    assert (limits.MAX_TRACE_ROWS, limits.MAX_COEFFICIENT) == (10**6, 1e24)
