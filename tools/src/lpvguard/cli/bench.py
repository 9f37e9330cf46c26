"""`lpvguard bench`: measure performance, beside peers in the same run; prints a table."""

from typing import Annotated

import typer

from .shared import app


@app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
    epilog="Example: lpvguard bench validation --json out/validation.json",
)
def bench(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            help="bounds, can, chain, confirmation, core, fleet, isolation, lives, proofs, rates, refine, "
            "robust, sharpness, soak, steer, synthesis or validation; NAME -- --help for options."
        ),
    ],
) -> None:
    """Measure performance, beside peers in the same run; prints a table."""
    from ..extras.bench import run

    run(name, context.args)
