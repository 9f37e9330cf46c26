"""Send the messages of an MCAP recording live to Foxglove and PlotJuggler on this machine.

The package foxglove-sdk provides the server, which only allows reading. Its queue for each client holds
BACKLOG messages. A client that is too slow loses the oldest messages, and nothing waits for it.
"""

import json
from collections.abc import Sequence
from typing import Any

import foxglove
import pyarrow as pa

from ...base.errors import InputError
from ...replay.messages import messages, schemas
from ...replay.replayer import Alarm, Replayer

LOOPBACK = "127.0.0.1"
BACKLOG = 16_384
"""Length of a client's queue; more than the messages of one piece of any source."""


class FoxgloveServer:
    """Listener of a Watch that serves Foxglove's WebSocket clients until ``stop``.

    Parameters
    ----------
    replayer : Replayer
    port : int, 0 means any free port

    Raises
    ------
    InputError
        If the port is taken.
    """

    def __init__(self, replayer: Replayer, port: int):
        # The server finds its channels through the context, so the context must stay alive.
        self._context = context = foxglove.Context()
        self._channels = {
            topic: foxglove.Channel(topic, schema=schema, context=context)
            for topic, schema in schemas(replayer.series_columns()).items()
        }
        try:
            self._server = foxglove.start_server(
                name="lpvguard live",
                host=LOOPBACK,
                port=port,
                capabilities=[],
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            expected = "a free port of this machine"
            raise InputError("live", f"--foxglove {port}", str(error), expected) from None
        self.url = f"ws://{LOOPBACK}:{self._server.port}"

    def listens(self) -> bool:
        """Tell if a client subscribes to a topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def hear(self, series: pa.Table, alarms: list[Alarm], parts: Sequence[dict[str, Any]] = ()) -> None:
        """Queue the messages of a piece for the clients."""
        for message in messages(series, alarms, parts):
            content = json.dumps(message.content).encode()
            self._channels[message.topic].log(content, log_time=message.t_ns)

    def stop(self) -> None:
        """Close every connection."""
        self._server.stop()
