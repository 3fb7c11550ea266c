"""Shipped sessions: listed with what they are, printed as they are, and copied to begin with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from manyhands.launch.session import SessionError
from manyhands.launch.session.shipped import load_named, shipped_sessions

from ....support.commands import manyhands_command

pytestmark = pytest.mark.usefixtures("own_interrupt")

SHIPPED = Path(__file__).parents[4] / "launch" / "sessions"


def test_every_shipped_session_is_listed_with_a_sentence() -> None:
    found = json.loads(manyhands_command("sessions", "--json").stdout)
    assert list(found) == sorted(file.stem for file in SHIPPED.glob("*.yaml"))
    for name, text in found.items():
        assert text.endswith("."), name
        assert len(text) > 20, name
    assert manyhands_command("sessions").stdout.splitlines()[0].split(maxsplit=1) == ["ball", found["ball"]]


def test_a_folder_of_its_name_does_not_hide_a_shipped_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`manyhands host ball` makes a folder `ball`, and is to be called again beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ball").mkdir()
    (tmp_path / "mine").mkdir()
    assert load_named("ball").name == "ball"
    with pytest.raises(SessionError, match="a folder"):
        load_named("mine")


@pytest.mark.parametrize("name", ["ball", "ball.yaml"])
def test_a_session_is_printed_as_it_is(name: str) -> None:
    assert manyhands_command("sessions", name).stdout == (SHIPPED / "ball.yaml").read_text()


@pytest.mark.parametrize("template", sorted(shipped_sessions()))
def test_a_copy_differs_in_its_name_alone(template: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = manyhands_command("new", "my-own", "--from", template)
    assert (done.exit_code, done.stdout) == (0, "")
    assert done.stderr == f"my-own.yaml: a copy of {template}; next: manyhands design my-own.yaml\n"
    own, original = (
        (folder / name).read_text() for folder, name in ((tmp_path, "my-own.yaml"), (SHIPPED, f"{template}.yaml"))
    )
    differing = [(a, b) for a, b in zip(own.splitlines(), original.splitlines(), strict=True) if a != b]
    assert [line for line, _ in differing] == ["session: my-own"]
    assert load_named("my-own.yaml").name == "my-own"


def test_a_file_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("mine")
    done = manyhands_command("new", "mine")
    assert done.exit_code == 2
    assert done.stderr.startswith("error: mine.yaml: found a file; expected a free name")
    assert Path("mine.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["new", "A B"], "expected a session name"),
        (["new", "../up"], "expected a session name"),
        (["new", "mine", "--from", "exampl1"], "did you mean 'example1'?"),
        (["sessions", "bal"], "did you mean 'ball'?"),
        (["design", "exampel1"], "did you mean 'example1'?"),
        (["launch", "nothing-like-it"], "`manyhands sessions` lists"),
    ],
)
def test_a_name_that_there_is_not_is_one_error(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = manyhands_command(*arguments)
    assert done.exit_code == 2
    assert words in done.stderr
    assert done.stderr.count("error:") == 1
    assert not list(tmp_path.iterdir())
