"""A drawing as Mermaid's flowchart, which many places show that take Markdown."""

from __future__ import annotations

from manyhands.launch.graph.parts import Drawing
from manyhands.nodes.observer.scene import Health
from manyhands.protocol.messages import Role

_SHAPES = {
    Role.DEVICE: ('(["', '"])'),
    Role.COUPLING: ('["', '"]'),
    Role.ENVIRONMENT: ('[["', '"]]'),
    Role.OBSERVER: ('>"', '"]'),
}

_CLASSES = {
    Health.OK: "stroke:#2e7d32,stroke-width:2px",
    Health.WAITING: "stroke:#757575,stroke-dasharray:4 3",
    Health.LATE: "stroke:#b26a00,stroke-width:3px",
    Health.FROZEN: "stroke:#0277bd,stroke-width:3px",
    Health.SILENT: "stroke:#8e24aa,stroke-width:3px,stroke-dasharray:4 3",
    Health.AWAY: "stroke:#c62828,stroke-width:3px,stroke-dasharray:2 3",
}


def mermaid(drawing: Drawing) -> str:
    """The drawing's text. Links lead from a hand to the world, and say what goes there and back."""
    ids = {part.name: f"n{number}" for number, part in enumerate(drawing.parts)}
    lines = ["flowchart LR", f"  accTitle: {_plain(drawing.title)}"]
    for part in drawing.parts:
        before, after = _SHAPES[part.role]
        lines.append(f"  {ids[part.name]}{before}{'<br/>'.join(map(_escaped, part.label))}{after}")
    healths: dict[Health, list[int]] = {}
    for number, tie in enumerate(drawing.ties):
        first, second = (ids[end] for end in tie.ends)
        label = tie.label if tie.health is None else f"{tie.label}, {tie.health.value}"
        lines.append(f'  {first} {"<-->" if tie.is_link else "-.-"}|"{_escaped(label)}"| {second}')
        if tie.health is not None:
            healths.setdefault(tie.health, []).append(number)
    for health, style in _CLASSES.items():
        of = [ids[part.name] for part in drawing.parts if part.health is health]
        if of:
            lines += [f"  classDef {health.value} {style}", f"  class {','.join(of)} {health.value}"]
        if health in healths:
            lines.append(f"  linkStyle {','.join(map(str, healths[health]))} {style}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    """Fit for a quoted label: what means something there as its number."""
    return "".join(c if c.isalnum() or c in " .,:_-/→←…" else f"#{ord(c)};" for c in text)


def _plain(text: str) -> str:
    """Fit for a line that is not quoted."""
    return "".join(c if c.isalnum() or c in " .,_-" else " " for c in text)
