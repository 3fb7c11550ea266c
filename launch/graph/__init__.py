"""What `manyhands graph` shows: a session's nodes and links, or who may read and write what, in several forms.

:mod:`parts` is what every picture is made of, :mod:`layout` puts it in its place, :mod:`svg` and :mod:`mermaid` draw
it, :mod:`tables` and :mod:`objects` say it in words and in JSON.
"""

from manyhands.launch.graph.objects import access_object, graph_object, scene_object
from manyhands.launch.graph.showing import FORMATS, format_of, show_scene, show_session

__all__ = [
    "FORMATS",
    "access_object",
    "format_of",
    "graph_object",
    "scene_object",
    "show_scene",
    "show_session",
]
