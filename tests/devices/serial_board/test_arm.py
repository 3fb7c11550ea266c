"""The whole firmware of `firmware/mps2_an385` on an emulated Cortex-M3, and the driver at its UART.

Debian's gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm; `make firmware` requires them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from manyhands.devices.serial_board import SerialBoard
from manyhands.protocol.clock import Instant

from ...fakes.compiled import FIRMWARE

TOOLS = ("arm-none-eabi-gcc", "qemu-system-arm")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_ARM") == "1"
PATIENCE = 30.0  # s
MS = 1_000_000


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        assert not REQUIRED, f"MANYHANDS_REQUIRE_ARM is set; found no {', '.join(missing)}"
        pytest.skip(f"found no {', '.join(missing)}")
    made, board = tmp_path_factory.mktemp("arm") / "board.elf", FIRMWARE / "mps2_an385"
    subprocess.run(
        [TOOLS[0], "-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2", "-mcpu=cortex-m3", "-mthumb",
         "-ffreestanding", "-nostartfiles", "--specs=nosys.specs", "-T", board / "memory.ld", board / "main.c",
         FIRMWARE / "mhb.c", "-o", made],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return made


@pytest.fixture
def port(image: Path) -> Iterator[str]:
    """The pseudo-terminal at the UART of a board that runs."""
    command = [
        TOOLS[1],
        "-M",
        "mps2-an385",
        "-kernel",
        str(image),
        "-display",
        "none",
        "-monitor",
        "none",
        "-serial",
        "pty",
    ]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as board:
        assert board.stdout is not None
        try:
            found = re.search(r"/dev/pts/\d+", board.stdout.readline())
            assert found is not None
            yield found.group()
        finally:
            board.kill()


def test_the_firmware_is_pushed_and_lets_go(port: str) -> None:
    with closing(SerialBoard(("dx.0",), 1e-3, {"port": port, "silence": 0.9})) as driver:
        assert driver.specification().mass == pytest.approx((0.2,), rel=1e-6)
        begin, end = driver.sample(0, Instant(0))[0], time.monotonic() + PATIENCE
        driver.work()
        x, worked, tick = begin, 0.0, 0
        while x < begin + 0.001:
            assert time.monotonic() < end, "it never moved"
            tick += 1
            driver.apply([0.5], Instant(0), Instant(40 * MS))
            x = driver.sample(tick, Instant(0))[0]
            worked += driver.work() or 0.0
            time.sleep(1e-3)
        # f dx while the force lasted; it may have ended by itself where this machine was slow, so at most that
        assert 0.0 < worked <= 0.5 * (x - begin) + 1e-6
        while driver.exerted() != (0.0,):  # nothing was applied since: the last force ends by itself
            assert time.monotonic() < end, "its force never ended"
            driver.sample(tick, Instant(0))
