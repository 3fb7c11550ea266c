"""Where each part of a picture stands: in layers from left to right, with as few crossings as some sweeps find. Pure.

Who looks on stands in a row of its own below, so that no line of its need lead through the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rich.cells import cell_len

from manyhands.launch.graph.parts import LAYERS, Drawing, Part
from manyhands.protocol.messages import Role

CHARACTER: Final = 7.25
"""Width of a character of the labels, px: of a font whose characters are all as wide."""

LINE: Final = 17.0
"""Height of a line of a label, px."""

PADDING: Final = 10.0
GAP: Final = 22.0
"""Between two boxes of a layer, px."""

MARGIN: Final = 24.0
HEAD: Final = 44.0
"""Above the boxes, for the title, px."""

AISLE: Final = 16.0
"""How far beside a box the lines lead down to who looks on, px."""

BELOW: Final = 56.0
"""Between the layers and who looks on, px."""

_SWEEPS: Final = 4
_HEALTH: Final = 10  # characters of the longest health, in brackets


@dataclass(frozen=True)
class Box:
    """A part's place, px: the upper left corner, width and height."""

    x: float
    y: float
    width: float
    height: float

    @property
    def middle(self) -> float:
        """The height of its middle."""
        return self.y + self.height / 2


@dataclass(frozen=True)
class Layout:
    """A picture's size, px, and the places of its parts by name."""

    width: float
    height: float
    boxes: dict[str, Box]


def layout(drawing: Drawing) -> Layout:
    """Place the parts of a drawing."""
    columns = _layers(drawing)
    sizes = {part.name: _size(part) for part in drawing.parts}
    heights = [sum(sizes[one.name][1] for one in column) + GAP * (len(column) - 1) for column in columns]
    tallest = max(heights, default=0.0)
    aisle = 70.0 + CHARACTER * max((cell_len(tie.label) + _HEALTH for tie in drawing.ties if tie.is_shown), default=0)
    boxes: dict[str, Box] = {}
    x = MARGIN
    for column, height in zip(columns, heights, strict=True):
        width = max(sizes[part.name][0] for part in column)
        spare = (tallest - height) / len(column)  # spread over the whole height, each in the middle of its share
        y = HEAD + spare / 2
        for part in column:
            own = sizes[part.name][1]
            if part.role is Role.ENVIRONMENT:  # as high as what leads to it, so that links run level
                boxes[part.name] = Box(x, HEAD, width, tallest)
            else:
                boxes[part.name] = Box(x, y, width, own)
            y += own + GAP + spare
        x += width + aisle
    right, bottom = x - aisle + AISLE, HEAD + tallest
    x, lowest = MARGIN, bottom
    for part in drawing.parts:
        if part.role is Role.OBSERVER:
            width, height = sizes[part.name]
            boxes[part.name] = Box(x, bottom + BELOW, width, height)
            x, lowest = x + width + GAP, max(lowest, bottom + BELOW + height)
    title = 2 * MARGIN + 1.4 * CHARACTER * (cell_len(drawing.title) + _HEALTH)
    return Layout(max(right, x - GAP, title) + MARGIN, lowest + MARGIN, boxes)


def _layers(drawing: Drawing) -> list[list[Part]]:
    """The parts of each layer that has any, from top to bottom."""
    columns = [[part for part in drawing.parts if LAYERS.get(part.role) == layer] for layer in range(len(LAYERS))]
    columns = [column for column in columns if column]
    near: dict[str, list[str]] = {}
    for tie in drawing.ties:
        first, second = tie.ends
        near.setdefault(first, []).append(second)
        near.setdefault(second, []).append(first)
    for sweep in range(_SWEEPS):
        forward = sweep % 2 == 0
        for place in range(1, len(columns)) if forward else range(len(columns) - 2, -1, -1):
            beside = columns[place - 1 if forward else place + 1]
            order = {part.name: (number + 0.5) / len(beside) for number, part in enumerate(beside)}
            own = {part.name: (number + 0.5) / len(columns[place]) for number, part in enumerate(columns[place])}

            def centre(part: Part, order: dict[str, float] = order, own: dict[str, float] = own) -> float:
                of = [order[other] for other in near.get(part.name, ()) if other in order]
                return sum(of) / len(of) if of else own[part.name]

            columns[place].sort(key=centre)
    return columns


def _size(part: Part) -> tuple[float, float]:
    lines = part.label
    return 2 * PADDING + CHARACTER * max(map(cell_len, lines)), 2 * PADDING + LINE * len(lines)
