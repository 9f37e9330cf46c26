"""The command line. Exit status: 0 done, 1 a finding (falsified, alarmed, an answer missed), 2 bad input.

Results that machines read go to the file named with --json (``-``: standard output); progress and messages go
to standard error. Nothing is written except where -o or --json says.
"""

import errno
import os
import signal
import sys
import warnings
from collections.abc import Callable
from typing import Any

from typer.completion import completion_init  # type: ignore[attr-defined]  # Typer states no exports

from ..base.errors import InputError, InputWarning
from ..base.system import ENDING_SIGNALS, open_standard_streams
from . import (  # noqa: F401 - each adds its verb; sections.py has their order in --help
    a2l,
    arxml,
    bench,
    campaign,
    completion,
    data,
    dbc,
    design,
    evaluate,
    export,
    fit,
    fleet,
    fmu,
    generate,
    identify,
    ingest,
    lcm,
    live,
    new,
    plant,
    refine,
    replay,
    report,
    sim,
    solve,
)
from .shared import COMPLETE, PROGRAM, app, complain

MAY_IMPORT = (
    "base",
    "sources",
    "vehicle",
    "engine",
    "can",
    "drives",
    "fit",
    "start",
    "core",
    "measure",
    "identify",
    "control",
    "replay",
    "fleet",
    "refine",
    "evaluate",
    "loop",
    "report",
    "live",
    "problems",
    "fmu",
    "arxml",
    "bench",
)


def _end(number: int, _: Any) -> None:
    """Ends the program as an error does, so that nothing half-written stays behind."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def _refused(error: OSError) -> InputError:
    """Convert an error of the operating system into one about the file that it names."""
    what = error.strerror or str(error)
    if error.errno == errno.ENOSPC:
        scratch = "standard output or a scratch file"
        return InputError(scratch, "", f"cannot be written ({what})", "free space on the disk")
    place = os.fsdecode(error.filename) if isinstance(error.filename, (str, bytes)) else "a file"
    return InputError(place, "", f"cannot be used ({what})", "a file or folder that may be read and written")


def _shown_plainly(usual: Callable[..., None]) -> Callable[..., None]:
    """Return a display of warnings that says what was left out without a place in our code."""

    def show(message: Any, category: type[Warning], *place: Any) -> None:
        if issubclass(category, InputWarning):
            print(f"{PROGRAM}: warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *place)

    return show


def main() -> None:
    """Entry point of the console script."""
    open_standard_streams()
    warnings.showwarning = _shown_plainly(warnings.showwarning)
    for number in ENDING_SIGNALS:
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores SIGHUP
            signal.signal(number, _end)
    try:
        try:
            completes = COMPLETE in os.environ
            if completes:
                completion_init()  # adds the shells that Typer knows
            app(prog_name=PROGRAM if completes else None)
        finally:
            sys.stdout.flush()
    except InputError as error:
        complain(error)
        sys.exit(2)
    except OSError as error:
        if not isinstance(error, BrokenPipeError):
            complain(_refused(error))
        # The buffered output would fail again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(2)
