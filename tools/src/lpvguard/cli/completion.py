"""`lpvguard completion`: the script with which a shell completes verbs and options."""

import sys
from enum import StrEnum
from typing import Annotated

import typer
from typer.completion import get_completion_script  # type: ignore[attr-defined]  # Typer states no exports

from .shared import COMPLETE, PROGRAM, app


class Shell(StrEnum):
    """Shells with tested completion."""

    bash = "bash"
    zsh = "zsh"
    fish = "fish"


@app.command(epilog='Example: eval "$(lpvguard completion bash)"')
def completion(shell: Annotated[Shell, typer.Argument(help="Shell that will read the script.")]) -> None:
    """Print the script with which a shell completes verbs and options; read it from the shell's start file.

    bash: eval "$(lpvguard completion bash)" in ~/.bashrc. zsh: the same with zsh in ~/.zshrc, after compinit.
    fish: lpvguard completion fish | source, in ~/.config/fish/config.fish.
    """
    sys.stdout.write(get_completion_script(prog_name=PROGRAM, complete_var=COMPLETE, shell=shell) + "\n")
