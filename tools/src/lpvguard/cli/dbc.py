"""`lpvguard dbc`: write the CAN database of our bus (DBC), for any tool that shows or sends decoded
traffic."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from .shared import app


@app.command(
    epilog="Example: lpvguard dbc -o lpvguard.dbc; "
    "candump -L vcan0 | .venv/bin/cantools decode -s lpvguard.dbc"
)
def dbc(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write (default: standard output).")
    ] = None,
) -> None:
    """Write the CAN database of our bus (DBC), for any tool that shows or sends decoded traffic."""
    from ..can.dbc import dbc_text

    if out is None:
        sys.stdout.write(dbc_text())
    else:
        artefacts.write_file(out, dbc_text(), "dbc")
