"""`lpvguard data`: a public data set, made anew from where it was published."""

from pathlib import Path
from typing import Annotated

import typer

from .shared import app, console, progress_bar


@app.command(epilog="Example: lpvguard data genesis_g80 --from genesis_path_follower -o data/genesis_g80")
def data(
    name: Annotated[str, typer.Argument(help="Data set of the table.")],
    source: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Clone of its repository, or folder with its files (default: git fetches it)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder to write (default: the data set's name).")
    ] = None,
    table: Annotated[
        Path | None, typer.Option(help="Table of data sets of your own (default: the shipped one).")
    ] = None,
) -> None:
    """Rebuild measured data from their public source at the stated commits, and check every file's hash."""
    from ..extras.sources.rebuild import rebuild
    from ..extras.sources.table import load_data_set

    data_set, target = load_data_set(name, table), Path(name) if out is None else out
    with progress_bar("data") as tell:
        files = rebuild(name, data_set, target, source, tell)
    console.print(
        f"{data_set.title}: {len(files)} files written to {target}, each with the hash that the table "
        f"states; {data_set.licence}, {data_set.repository}"
    )
