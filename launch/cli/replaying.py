"""The commands that recompute a recorded run: replay, audit."""

from __future__ import annotations

import typer

commands = typer.Typer()
