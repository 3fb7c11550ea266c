"""A drawing as SVG: one file without scripts or external content, for light and dark displays, with selectable text.

The parts stand in layers from left to right. A few sweeps over the layers sort each by its neighbours' positions, which
leaves few crossings. Observers stand in a row below, so that their lines need not cross the environment. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Final

from rich.cells import cell_len

from manyhands.launch.look.graph.parts import LAYERS, Drawing, Part, Tie
from manyhands.protocol.messages import Role

CHARACTER: Final = 7.25
"""Width of a character of the labels, px; the font is monospaced."""

LINE: Final = 17.0
"""Height of a line of a label, px."""

PADDING: Final = 10.0
GAP: Final = 22.0
"""Between two boxes of a layer, px."""

MARGIN: Final = 24.0
HEAD: Final = 44.0
"""Above the boxes, for the title, px."""

AISLE: Final = 16.0
"""Distance from a box to the line that leads down to an observer, px."""

BELOW: Final = 56.0
"""Between the layers and the row of observers, px."""

_SWEEPS: Final = 4
_HEALTH: Final = 10  # characters of the longest health, in brackets


@dataclass(frozen=True)
class Box:
    """A part's position, px: its upper left corner, width and height."""

    x: float
    y: float
    width: float
    height: float

    @property
    def middle(self) -> float:
        """The y coordinate of its middle, px."""
        return self.y + self.height / 2


@dataclass(frozen=True)
class Layout:
    """The size of a drawing, px, and the boxes of its parts by name."""

    width: float
    height: float
    boxes: dict[str, Box]


def layout(drawing: Drawing) -> Layout:
    """The positions of a drawing's parts."""
    columns = _layers(drawing)
    sizes = {part.name: _size(part) for part in drawing.parts}
    heights = [sum(sizes[one.name][1] for one in column) + GAP * (len(column) - 1) for column in columns]
    tallest = max(heights, default=0.0)
    aisle = 70.0 + CHARACTER * max((cell_len(tie.label) + _HEALTH for tie in drawing.ties if tie.is_shown), default=0)
    boxes: dict[str, Box] = {}
    x = MARGIN
    for column, height in zip(columns, heights, strict=True):
        width = max(sizes[part.name][0] for part in column)
        spare = (tallest - height) / len(column)  # spreads the column over the whole height
        y = HEAD + spare / 2
        for part in column:
            own = sizes[part.name][1]
            if part.role is Role.ENVIRONMENT:  # as high as the layer before it, so that links run level
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
    """The parts of each layer that is not empty, from top to bottom.

    Each sweep sorts every layer by the mean position of each part's neighbours in the layer before it. The sweeps
    alternate in direction, so that both neighbouring layers count.
    """
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


_STYLE = """
    svg { color-scheme: light dark; }
    .ground { fill: #ffffff; }
    text { font: 12px ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace; fill: #1b1f24;
      user-select: text; white-space: pre; }
    .title { font-size: 16px; font-weight: 600; }
    .name { font-weight: 600; }
    .small, .tie text { fill: #57606a; }
    .tie text { font-size: 11px; paint-order: stroke; stroke: #ffffff; stroke-width: 4px; }
    .box { fill: #f6f8fa; stroke: #57606a; stroke-width: 1.5; }
    .environment .box { fill: #eef4fb; }
    .observer .box { stroke-dasharray: 4 3; }
    .line { fill: none; stroke: #57606a; stroke-width: 1.5; }
    .aside .line { stroke-dasharray: 2 4; }
    .ok { --health: #2e7d32; } .free, .waiting { --health: #757575; } .late { --health: #b26a00; }
    .frozen { --health: #0277bd; } .silent { --health: #8e24aa; } .away { --health: #c62828; }
    .told .box, .told .line { stroke: var(--health); stroke-width: 2.5; }
    .told .health { fill: var(--health); font-weight: 600; }
    @media (prefers-color-scheme: dark) {
      .ground { fill: #0d1117; } text { fill: #e6edf3; } .small, .tie text { fill: #9da7b3; }
      .tie text { stroke: #0d1117; } .box { fill: #161b22; stroke: #8b949e; } .environment .box { fill: #14202e; }
      .line { stroke: #8b949e; }
      .ok { --health: #4caf50; } .free, .waiting { --health: #9e9e9e; } .late { --health: #ffb74d; }
      .frozen { --health: #4fc3f7; } .silent { --health: #ce93d8; } .away { --health: #ef5350; }
    }
"""


def svg(drawing: Drawing) -> str:
    """The text of the SVG file."""
    placed = layout(drawing)
    health = "" if drawing.health is None else f": {drawing.health.value}"
    parts = ", ".join(part.whole for part in drawing.parts)
    size = f'width="{placed.width:.0f}" height="{placed.height:.0f}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {placed.width:.0f} {placed.height:.0f}" '
        'role="img" aria-labelledby="graph-title graph-description">',
        f'  <title id="graph-title">{_text(drawing.title + health)}</title>',
        f'  <desc id="graph-description">{_text(f"Nodes: {parts}")}</desc>',
        f"  <style>{_STYLE}  </style>",
        f'  <rect class="ground" {size}/>',
        f'  <text class="title" x="{MARGIN:.0f}" y="28">{_text(drawing.title + health)}</text>',
        *(_tie(tie, placed.boxes[tie.ends[0]], placed.boxes[tie.ends[1]]) for tie in drawing.ties),
        *(_part(part, placed.boxes[part.name]) for part in drawing.parts),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _tie(tie: Tie, first: Box, second: Box) -> str:
    """A curve from the first box's right side to the second box's left; level where the second box is tall enough."""
    if tie.looks:
        return _look(tie, first, second)
    x0, x1 = first.x + first.width, second.x
    y0 = first.middle
    y1 = (
        min(max(y0, second.y + PADDING), second.y + second.height - PADDING) if _spans(second, first) else second.middle
    )
    bend = (x1 - x0) / 2
    kind = "tie link" if tie.is_link else "tie aside"
    health = "" if tie.health is None else f" told {tie.health.value}"
    label = tie.label if tie.health is None else f"{tie.label} ({tie.health.value})"
    at, level = x0 + 0.5 * (x1 - x0), y0 + 0.5 * (y1 - y0) - 5
    return (
        f'  <g class="{kind}{health}"><title>{_text(tie.whole)}</title>'
        f'<path class="line" d="M {x0:.1f} {y0:.1f} C {x0 + bend:.1f} {y0:.1f} {x1 - bend:.1f} {y1:.1f} '
        f'{x1:.1f} {y1:.1f}"/><text x="{at:.1f}" y="{level:.1f}" text-anchor="middle">{_text(label)}</text></g>'
    )


def _look(tie: Tie, seen: Box, observer: Box) -> str:
    """A line from a box's right side down through the aisle, where no box stands, to the top of the observer's box."""
    x0, y0 = seen.x + seen.width, seen.middle + seen.height / 4
    x1, y1 = observer.x + observer.width / 2, observer.y
    down, bend = x0 + AISLE, BELOW / 2
    low = y1 - BELOW + PADDING
    return (
        f'  <g class="tie aside"><title>{_text(tie.whole)}</title><path class="line" d="M {x0:.1f} {y0:.1f} '
        f"Q {down:.1f} {y0:.1f} {down:.1f} {min(y0 + PADDING, low):.1f} L {down:.1f} {low:.1f} "
        f'C {down:.1f} {low + bend:.1f} {x1:.1f} {y1 - bend:.1f} {x1:.1f} {y1:.1f}"/></g>'
    )


def _spans(tall: Box, other: Box) -> bool:
    return tall.height > other.height and tall.y <= other.middle <= tall.y + tall.height


def _part(part: Part, box: Box) -> str:
    health = "" if part.health is None else f" told {part.health.value}"
    label = part.label
    top = box.middle - LINE * len(label) / 2
    classes = ["name", *["small"] * (len(label) - 1)]
    if part.health is not None:
        classes[-1] = "health"
    texts = "".join(
        f'<text class="{kind}" x="{box.x + PADDING:.1f}" y="{top + LINE * (number + 0.75):.1f}">{_text(line)}</text>'
        for number, (kind, line) in enumerate(zip(classes, label, strict=True))
    )
    return (
        f'  <g class="node {part.role.value}{health}"><title>{_text(part.whole)}</title><rect class="box" '
        f'x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="6"/>{texts}</g>'
    )


def _text(text: str) -> str:
    """A text for XML: special characters escaped, characters that XML forbids replaced."""
    return escape("".join(c if c.isprintable() else "\ufffd" for c in text))
