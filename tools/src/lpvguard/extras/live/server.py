"""Serve the page of `lpvguard live`: one process, read only, for browsers on this machine.

A browser asks for the next view when it has drawn the previous one. A slow browser asks less often and skips
views; nothing is queued. Every answer has at most MOST_ROWS rows of the series.
"""

import asyncio
import csv
import io
import signal
import threading
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import tornado.web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from ...base.errors import InputError
from .watch import Watch

LOOPBACK = "127.0.0.1"
NAMES = (LOOPBACK, "localhost")
"""Host names that a request may use; another name comes from the page of another site."""
MOST_ROWS = 1200
LONGEST_S = 86_400.0
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
LIBRARIES = ("bokeh.min.js", "bokeh-api.min.js")
"""Parts of BokehJS from the package bokeh."""
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}


class _Handler(tornado.web.RequestHandler):
    """Answers read requests from pages of this server."""

    SUPPORTED_METHODS = ("GET", "HEAD")

    def initialize(self, watch: Watch) -> None:
        """Take the Watch that the page shows."""
        self.watch = watch

    def prepare(self) -> None:
        """Refuse requests with a host name that is not this machine's."""
        if urlsplit(f"//{self.request.host}").hostname not in NAMES:
            raise tornado.web.HTTPError(403)

    def set_default_headers(self) -> None:
        """Limit what a browser may load, and forbid caching."""
        for name, value in (
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
        ):
            self.set_header(name, value)

    def number(self, name: str, default: float | None = None) -> float | None:
        """A finite number from the query; status 400 for any other value."""
        text = self.get_query_argument(name, None)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise tornado.web.HTTPError(400)
        return value


class _File(_Handler):
    def get(self, name: str) -> None:
        """Send a file of the page."""
        name = name or "page.html"
        if name in LIBRARIES:
            folder = resources.files("bokeh").joinpath("server", "static", "js")
        else:
            folder = resources.files(__package__)
        self.set_header("Content-Type", f"{KINDS[name.rpartition('.')[2]]}; charset=utf-8")
        self.write(folder.joinpath(name).read_bytes())


class _What(_Handler):
    def get(self) -> None:
        """Send the constants of the page."""
        self.write(self.watch.what())


class _View(_Handler):
    def get(self) -> None:
        """Send a view of the page; the query has span [s] and until [s] (missing: now)."""
        span = self.number("span", 60.0)
        assert span is not None
        self.write(self.watch.view(min(max(span, 1.0), LONGEST_S), self.number("until"), MOST_ROWS))


class _Drive(_Handler):
    def get(self) -> None:
        """Send the longest stretch without a gap between ``from`` and ``to`` [s] as a drive table."""
        begin, end = self.number("from", 0.0), self.number("to", np.inf)
        assert begin is not None and end is not None
        columns, rows = self.watch.drive(begin, end)
        if len(rows) < 2:
            self.set_status(404)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.write("this window has no two successive samples\n")
            return
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(columns)
        table.writerows([f"{t:.6f}", *(f"{x:.9g}" for x in rest)] for t, *rest in rows.tolist())
        name = f"{self.watch.replayer.project.name}_{rows[0, 0]:.0f}_{rows[-1, 0]:.0f}.csv"
        self.set_header("Content-Type", "text/csv; charset=utf-8")
        self.set_header("Content-Disposition", f'attachment; filename="{name}"')
        self.write(text.getvalue())


def application(watch: Watch) -> tornado.web.Application:
    """Web application with the page of ``watch``."""
    own: dict[str, Any] = {"watch": watch}
    files = "|".join([*LIBRARIES, "page.js", "page.css"]).replace(".", r"\.")
    return tornado.web.Application(
        [
            (rf"/({files}|)", _File, own),
            ("/what", _What, own),
            ("/view", _View, own),
            ("/drive.csv", _Drive, own),
        ],
        log_function=lambda handler: None,
    )


async def serve(watch: Watch, port: int, ready: Any = None, until: asyncio.Event | None = None) -> None:
    """Serve the page of a watch until told to end.

    Parameters
    ----------
    watch : Watch
    port : int, 0 is any free one
    ready : Any, optional
    until : asyncio.Event or None, optional

    Raises
    ------
    InputError
        If the port is taken.
    """
    try:
        sockets = bind_sockets(port, LOOPBACK)
    except (OSError, OverflowError) as error:
        raise InputError("live", f"--port {port}", str(error), "a free port of this machine") from None
    server = HTTPServer(application(watch), max_body_size=0, max_header_size=16_384)
    server.add_sockets(sockets)
    ends = until or asyncio.Event()
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, ends.set)
    thread = threading.Thread(target=watch.run, name="source", daemon=True)
    thread.start()
    if ready is not None:
        ready(f"http://{LOOPBACK}:{sockets[0].getsockname()[1]}/")
    try:
        await ends.wait()
    finally:
        watch.stop()
        server.stop()
        await server.close_all_connections()
        thread.join(5.0)
