"""`lpvguard solve`: answer problems of the numerical engine; those that carry an answer are compared, exit 1
on any miss."""

from typing import Annotated

import typer

from .shared import app


@app.command(epilog="Example: lpvguard solve problems.json -o answers.json --jobs 2")
def solve(
    problems: Annotated[str, typer.Argument(help="JSON list of problems; - is standard input.")],
    out: Annotated[
        str | None, typer.Option("-o", "--out", help="Answers (default: standard output).")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Answer problems of the numerical engine; those that carry an answer are compared, exit 1 on any
    miss."""
    from ..extras.problems.solve import run_solve

    raise typer.Exit(run_solve(problems, out, jobs))
