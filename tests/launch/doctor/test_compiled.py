"""What the compiled tick is worth here: both take turns, and the pure one runs the sources beside the extensions."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import manyhands
from manyhands.launch.app.examination import compiled_object, compiled_sentence
from manyhands.launch.doctor import compiled
from manyhands.launch.doctor.advice import Worth
from manyhands.launch.doctor.compiled import TURNS, by_turns, pure_python
from manyhands.launch.doctor.probe import Ticking, Way
from manyhands.launch.doctor.profile import Lateness, ProbeInterrupted
from manyhands.launch.doctor.wakeup import Spread
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.session.shipped import load_named

WHERE = "import manyhands.nodes.device.tick as tick; print(tick.__file__)"


def measured(median: float) -> Ticking:
    tau = Spread(median, median, median, median)
    return Ticking(Way("run", "ipc", "ipc"), tau, 1000, 0, Lateness(median, median, median, median), 1000.0)


def in_turns(medians: dict[bool, list[float]]) -> Callable[[], Ticking]:
    """A measurement that gives these medians one after the other, by whether its processes would be pure Python."""

    def measure() -> Ticking:
        return measured(medians["PYTHONPATH" in os.environ].pop(0))

    return measure


def test_both_take_turns_and_the_ratio_is_of_one_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONPATH", raising=False)
    found = by_turns(in_turns({False: [150.0, 160.0, 170.0], True: [200.0, 200.0, 240.0]}))
    assert found.medians == (160.0, pytest.approx(640 / 3))
    assert found.ratio == pytest.approx(0.75)
    assert found.spread == (pytest.approx(170 / 240), pytest.approx(0.8))
    assert len(found.compiled) == len(found.pure) == TURNS


def test_it_is_told_with_the_stiffness_of_either(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONPATH", raising=False)
    worth = Worth.of(haptic_loop(load_named("example1")))
    found = by_turns(in_turns({False: [150.0] * TURNS, True: [200.0] * TURNS}))
    sentence = compiled_sentence(found, worth)
    assert "takes 0.75 of the time of pure Python here (0.75 to 0.75 in 3 turns; medians 150 µs and 200 µs)" in sentence
    pure, fast = (1.37 / (0.5e-3 + 1.5 * tau) for tau in (200e-6, 150e-6))
    assert sentence.endswith(f": {fast:.0f} N/m in place of {pure:.0f} N/m at the median.")
    told = compiled_object(found, worth)
    assert told is not None
    assert told["stiffness"] == {"compiled": pytest.approx(fast), "pure": pytest.approx(pure)}
    assert compiled_object(None, worth) is None


def test_turns_that_disagree_tell_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONPATH", raising=False)
    found = by_turns(in_turns({False: [150.0, 150.0, 400.0], True: [200.0] * TURNS}))
    sentence = compiled_sentence(found, Worth.of(haptic_loop(load_named("example1"))))
    assert "was not to be seen: the first takes 0.75 to 2.00 of the other's time" in sentence
    assert "in place of" not in sentence


def test_ctrl_c_ends_it_between_two_turns() -> None:
    def measure() -> Ticking:
        signal.raise_signal(signal.SIGTERM)
        return measured(1.0)

    with pytest.raises(ProbeInterrupted) as caught:
        by_turns(measure)
    assert caught.value.signal is signal.SIGTERM


@pytest.mark.parametrize("before", [None, "/nowhere"])
def test_extensions_beside_the_sources_are_passed_over(
    before: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of an extension's name stands beside a module's source: it would be taken, and cannot be loaded."""
    package = tmp_path / "manyhands"
    with monkeypatch.context() as patch:
        patch.delenv("PYTHONPATH", raising=False)
        with pure_python() as folder:  # a package of links to the sources here, as an installed one has them
            (tmp_path / "real").mkdir()
            compiled._link(folder / "manyhands", package)
            for link in package.rglob("*.py"):
                source = link.resolve()
                link.unlink()
                link.write_bytes(source.read_bytes())
    (package / "nodes" / "device" / f"tick{compiled.EXTENSION_SUFFIXES[0]}").write_bytes(b"no library")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    asked = [sys.executable, "-P", "-c", WHERE]
    broken = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert "tick" in broken.stderr, "the extension takes precedence"
    assert broken.returncode != 0
    monkeypatch.setattr(manyhands, "__file__", str(package / "__init__.py"))
    if before is None:
        monkeypatch.delenv("PYTHONPATH")
    else:
        monkeypatch.setenv("PYTHONPATH", before)
    with pure_python() as folder:
        done = subprocess.run(asked, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == str(folder / "manyhands" / "nodes" / "device" / "tick.py")
    assert os.environ.get("PYTHONPATH") == before
    assert not folder.exists()
