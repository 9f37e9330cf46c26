"""`lpvguard plant`: run the simulated truck's own tool: its frequency response against Table I, single
experiments, a digest."""

from __future__ import annotations

import subprocess
from contextlib import nullcontext
from pathlib import Path

import typer

from ..base import artefacts
from .shared import app


@app.command(
    epilog="Example: lpvguard plant frequency-response",
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
)
def plant(context: typer.Context) -> None:
    """Run the simulated truck's own tool: its frequency response against Table I, single experiments, a
    digest."""
    from ..loop.generate import plant_tool

    words = list(context.args)
    at = words.index("-o") + 1 if "-o" in words[:-1] else None
    with nullcontext() if at is None else artefacts.new_file(Path(words[at]), "plant") as scratch:
        if at is not None:
            words[at] = scratch
        status = subprocess.run([plant_tool(), *words], check=False).returncode
        if at is None or status:
            raise typer.Exit(status)
