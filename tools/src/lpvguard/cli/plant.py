"""`lpvguard plant`: run the simulated truck's own tool: its frequency response against Table I, single
experiments, a digest."""

import subprocess
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
    from ..extras.loop.generate import plant_tool

    words = list(context.args)
    if "-o" not in words[:-1]:
        raise typer.Exit(subprocess.run([plant_tool(), *words], check=False).returncode)
    at = words.index("-o") + 1
    with artefacts.new_file(Path(words[at]), "plant") as scratch:
        words[at] = str(scratch)
        status = subprocess.run([plant_tool(), *words], check=False).returncode
        if status:
            raise typer.Exit(status)
