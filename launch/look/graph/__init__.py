"""What `manyhands graph` shows: a session's nodes and links, or its access rights, in several forms.

Read :mod:`parts` first (the elements of every drawing), then :mod:`svg` (the drawing), :mod:`text` (tables and
Mermaid), and :mod:`show` (the choice among them).
"""

from manyhands.launch.look.graph.parts import access_object, graph_object, live_object
from manyhands.launch.look.graph.show import FORMATS, format_of, show_running, show_session

__all__ = [
    "FORMATS",
    "access_object",
    "format_of",
    "graph_object",
    "live_object",
    "show_running",
    "show_session",
]
