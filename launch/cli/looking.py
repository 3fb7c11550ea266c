"""The commands that look on at running sessions: list, echo, hz, top."""

from __future__ import annotations

import typer

commands = typer.Typer()
