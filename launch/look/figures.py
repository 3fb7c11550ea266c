"""Figures and their files, the same for every picture: colours, size, formats, and a file that is whole or not there.

Matplotlib is used without a screen and without its global state; SVG keeps text as text.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final

from matplotlib import rc_context
from matplotlib.figure import Figure

from manyhands.design.files import replacing
from manyhands.launch.files import TargetError, require_target

SUFFIXES: Final = (".png", ".svg", ".pdf")

# Okabe and Ito's colours, which every kind of colour vision can distinguish
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
COLOURS: Final = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)

DPI = 130

_DATES: Final = {".svg": "Date", ".pdf": "CreationDate"}  # the key of a format's metadata that would differ each time


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size, inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def require_picture(path: Path) -> None:
    """Refuse a name that no picture can be written to, before the work begins.

    Raises:
        TargetError: the folder does not exist, or the suffix is none of :data:`SUFFIXES`.
    """
    require_target(path)
    if path.suffix not in SUFFIXES:
        raise TargetError(f"{path}: found the suffix {path.suffix!r}; expected one of {', '.join(SUFFIXES)}")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure whole or not at all, in the format of the suffix; the same figure gives the same bytes.

    Returns:
        The path.
    """
    with (
        rc_context({"svg.fonttype": "none", "svg.hashsalt": "manyhands"}),
        warnings.catch_warnings(),
        replacing(path) as file,
    ):
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)  # a box stands for it
        metadata = {_DATES[path.suffix]: None} if path.suffix in _DATES else None
        figure.savefig(file, format=path.suffix[1:], dpi=DPI, metadata=metadata)
    return path
