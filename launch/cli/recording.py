"""The commands about recordings: record, info, export."""

from __future__ import annotations

import typer

commands = typer.Typer()
