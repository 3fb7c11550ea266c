"""The command that serves the page of a running session: view."""

from __future__ import annotations

import typer

commands = typer.Typer()
