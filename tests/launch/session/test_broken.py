"""Broken session files: one line each that names file, line, key, error and reason."""

from pathlib import Path

import pytest

from manyhands.launch.session import SessionError, load_session

from ...support.broken_sessions import BROKEN, ENTRIES, NETWORK, STATES, WAVES


@pytest.mark.parametrize("base", [NETWORK, WAVES, STATES, ENTRIES])
def test_what_is_changed_is_sound(base: str, tmp_path: Path) -> None:
    (tmp_path / "sound.yaml").write_text(base)
    load_session(tmp_path / "sound.yaml")


@pytest.mark.parametrize("name", BROKEN)
def test_broken_file(name: str, tmp_path: Path) -> None:
    broken = BROKEN[name]
    path = broken.write(name, tmp_path)
    with pytest.raises(SessionError) as caught:
        load_session(path)
    error = caught.value
    assert (error.line, error.key) == (broken.line, broken.key)
    assert broken.found in str(error).partition("; expected ")[0]
    message = str(error)
    assert message.startswith(f"{path}:{broken.line}: {broken.key + ': ' if broken.key else ''}found ")
    assert broken.expected in message.partition("; expected ")[2]
    assert message.isprintable()  # so it is one line, too
