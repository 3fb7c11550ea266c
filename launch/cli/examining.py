"""The command that draws a recorded run: plot."""

from __future__ import annotations

import typer

commands = typer.Typer()
