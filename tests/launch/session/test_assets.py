"""The files of an engine's model: by name alone, of the session's own folder, regular, and within limits."""

from __future__ import annotations

import base64
import os
from pathlib import Path

import pytest

from manyhands.launch.files import EXIT_BAD_INPUT
from manyhands.launch.plan.engine import require_engine
from manyhands.launch.session import SessionError, load_session
from manyhands.launch.session.limits import MAX_ASSET_BYTES, MAX_ASSETS
from manyhands.nodes.kernel.factory import FactoryError

from ...support.commands import manyhands_command

SHIPPED = Path(__file__).parents[3] / "launch" / "sessions" / "mujoco.yaml"


def session(folder: Path) -> Path:
    path = folder / "s.yaml"
    path.write_text(SHIPPED.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def test_assets_are_kept_in_the_session_and_handed_to_the_engine(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_bytes(b"v 0 0 0\n")
    loaded = load_session(session(tmp_path), ["environment.assets=[part.obj]"])
    content = base64.b64encode(b"v 0 0 0\n").decode()
    assert loaded.foreign_code["environment.model"].parameters["assets"] == {"part.obj": content}
    assert type(loaded).model_validate(loaded.as_plain()) == loaded


@pytest.mark.parametrize("key", ["model", "assets"])
@pytest.mark.parametrize("name", ["/etc/hostname", "../part.obj", "folder/part.obj", ".hidden", "a b", "link", "pipe"])
def test_nothing_else_is_read(name: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for place in (tmp_path / "folder" / "part.obj", tmp_path.parent / "part.obj", tmp_path / ".hidden"):
        place.write_text("secret", encoding="utf-8")
    (tmp_path / "link").symlink_to("/etc/hostname")
    os.mkfifo(tmp_path / "pipe")
    value = f"['{name}']" if key == "assets" else f"'{name}'"
    with pytest.raises(SessionError, match=rf"environment\.{key}: found '.*expected .*file") as refused:
        load_session(session(tmp_path), [f"environment.{key}={value}"])
    assert "secret" not in str(refused.value)


def test_their_number_and_size_have_limits(tmp_path: Path) -> None:
    path = session(tmp_path)
    with pytest.raises(SessionError, match=rf"expected at most {MAX_ASSETS}, each once"):
        load_session(path, [f"environment.assets=[{', '.join(f'a{i}' for i in range(MAX_ASSETS + 1))}]"])
    for name in ("one", "two"):
        (tmp_path / name).write_bytes(bytes(MAX_ASSET_BYTES // 2 + 1))
    with pytest.raises(SessionError, match=rf"more than {MAX_ASSET_BYTES} bytes together"):
        load_session(path, ["environment.assets=[one, two]"])


def test_a_model_that_is_refused_ends_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "table.xml").write_text('<mujoco><include file="/etc/hostname"/></mujoco>', encoding="utf-8")
    loaded = load_session(session(tmp_path), ["environment.model=table.xml"])
    with pytest.raises(FactoryError, match=r"^environment\.model: found <include>"):
        require_engine(loaded)
    ended = manyhands_command("launch", str(tmp_path / "s.yaml"), "--set", "environment.model=table.xml")
    assert ended.exit_code == EXIT_BAD_INPUT
    assert "error: environment.model: found <include>" in ended.stderr
