"""MuJoCo's compiler in a process of its own, with limits of time and memory, and no way to a file.

MuJoCo's compiler is large, and written for models that its user trusts. So no model is compiled where a session runs.
A child process (``python -m manyhands.nodes.environment.mujoco_compiler``) reads the text from its standard input,
gives up the right to open files, bounds its own time and memory, compiles, and makes the first tick. It answers with
the compiled model, or with one sentence. A child that does not answer is killed, and always reaped.

The text is held against :mod:`manyhands.nodes.environment.mjcf` before the child begins, and the compiled model in it.
"""

from __future__ import annotations

import base64
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from manyhands.nodes.environment.mjcf import ModelRefused, require_bounded, require_model, steps_of
from manyhands.nodes.environment.mujoco_library import import_mujoco

SECONDS: Final = 10
"""The longest that the child may compute, s, over all its threads."""

MOST_WAIT: Final = 60.0
"""The longest that its answer is awaited, s: a busy machine leaves the child a part of its time."""

MEMORY: Final = 1 << 29
"""Bytes that the compiler, the model and its first tick may take together."""

_EXPECTED: Final = f"one that it compiles and begins in {SECONDS} s and {MEMORY >> 20} MiB"
_COMPILED: Final = b"M"
_REFUSED: Final = b"R"
_NAME: Final = "model.mjb"


def compiled(text: str, assets: Mapping[str, bytes], period: float) -> Any:
    """MuJoCo's model of a text, compiled within limits.

    Args:
        text: MuJoCo's XML.
        assets: the files that it may name, by name.
        period: T, s.

    Raises:
        ModelRefused: the text asks for what it may not have, MuJoCo refuses it, or the limits were not enough.
        ImportError: MuJoCo is not there, or not as expected.
    """
    mujoco = import_mujoco()
    require_bounded(text, assets, period)
    return mujoco.MjModel.from_binary_path(_NAME, {_NAME: _compiled(text, tuple(sorted(assets.items())), period)})


@lru_cache(maxsize=2)  # a launch asks for its model once for the probe and once for the run
def _compiled(text: str, assets: tuple[tuple[str, bytes], ...], period: float) -> bytes:
    """The compiled model in MuJoCo's own format, from a child process."""
    task = {"text": text, "assets": {name: base64.b64encode(file).decode() for name, file in assets}, "period": period}
    child = subprocess.Popen(  # noqa: S603 -- our own interpreter and module, no shell
        [sys.executable, "-P", "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # a pool of memory for each thread would count as taken
        env={**os.environ, "MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    with child:
        try:
            answer, _ = child.communicate(json.dumps(task).encode(), timeout=MOST_WAIT)
        except subprocess.TimeoutExpired:
            answer = b""
        finally:
            child.kill()
    kind, content = answer[:1], answer[1:]
    if kind == _COMPILED:
        return content
    if kind == _REFUSED:
        raise ModelRefused(content.decode(errors="replace"))
    raise ModelRefused(_unanswered(child.returncode))


def _unanswered(code: int) -> str:
    """What is said of a child that ended without an answer, from its exit code."""
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return f"found a model that takes MuJoCo longer; expected {_EXPECTED}"
    ended = f"the signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    return f"found a model at which MuJoCo's compiler ended by {ended}; expected {_EXPECTED}"


def _confine() -> None:
    """Give up files, and bound time and memory; what is open stays open."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    pages = Path("/proc/self/statm").read_text().split()[0]
    taken = int(pages) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))  # the last: from now on nothing can be opened


def _answer(task: Mapping[str, Any], mujoco: Any, np: Any) -> bytes:
    """The compiled model, or the sentence that refuses it."""
    assets = {name: base64.b64decode(file) for name, file in task["assets"].items()}
    try:
        model = mujoco.MjModel.from_xml_string(task["text"], assets)
        require_model(model, task["period"])
        content = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, content)
        steps = steps_of(float(model.opt.timestep), task["period"])
        model.opt.timestep = task["period"] / steps
        mujoco.mj_step(model, mujoco.MjData(model), steps)
        return _COMPILED + bytes(content)
    except ModelRefused as refused:
        return _REFUSED + str(refused).encode()
    except Exception as error:  # noqa: BLE001 -- MuJoCo raises whatever its bindings translate; the parent reports it
        said = " ".join(str(error).split())[:300] or type(error).__name__
        return _REFUSED + f"found a model that MuJoCo refuses ({said}); expected {_EXPECTED}".encode()


def main() -> None:
    """The child: a task on standard input, an answer on standard output."""
    import numpy as np

    mujoco = import_mujoco()
    mujoco.set_mju_user_warning(lambda text: None)  # without it MuJoCo writes a file
    task = json.load(sys.stdin)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what MuJoCo prints is no answer
    _confine()
    answers.write(_answer(task, mujoco, np))
    answers.flush()
    os._exit(0)  # with its memory full the interpreter may not come to its own end


if __name__ == "__main__":
    main()
