"""pyxcp as the master of a slave of lpvguard/xcp.h, over any bus that it can be given."""

import logging
import threading
from typing import Any

from pyxcp.config import create_application_from_config
from pyxcp.daq_stim import DaqList, DaqOnlinePolicy
from pyxcp.master import Master

TO_SLAVE, TO_MASTER = 0x98EF27F9, 0x98EFF927
"""Identifiers with the flag of 29 bits, as lpvg_can_frame_t and pyxcp have it."""
PATIENCE_S = 60.0
"""How long a test waits for what must come; nothing is said of how soon it does."""


class Rows(DaqOnlinePolicy):
    """A list of measurements (name, address, type), and the rows that came."""

    def __init__(self, measurements: list[tuple[str, int, str]], prescaler: int = 1):
        one = DaqList(
            name="list",
            event_num=0,
            stim=False,
            enable_timestamps=False,
            measurements=[(name, address, 0, kind) for name, address, kind in measurements],
            priority=0,
            prescaler=prescaler,
        )
        super().__init__([one], logging.getLogger("lpvguard.xcp_master"))
        self.pid_off = False
        self.rows: list[dict[str, Any]] = []
        self.names = [name for name, _, _ in measurements]
        self.came = threading.Condition()

    def on_daq_list(self, daq_list: int, timestamp0: int, timestamp1: int, payload: list) -> None:
        with self.came:
            names = [header[0] for header in self.daq_lists[daq_list].headers]
            self.rows.append(dict(zip(names, payload, strict=True)))
            self.came.notify()

    def wait_for(self, n: int) -> list[dict[str, Any]]:
        """The first n rows."""
        with self.came:
            assert self.came.wait_for(lambda: len(self.rows) >= n, PATIENCE_S), (
                f"{len(self.rows)} rows of {n}"
            )
            return self.rows[:n]


def master(rows: Rows | None = None, bus: Any = None, **interface: str) -> Master:
    """A master on a python-can interface (interface=, channel=), or on an object that stands for a bus."""
    names = {"can_id_master": TO_SLAVE, "can_id_slave": TO_MASTER, **(interface or {"interface": "custom"})}
    app = create_application_from_config({"Transport": {"CAN": names}}, logging.ERROR)
    app.general.disable_error_handling = True  # refusals are raised
    app.transport.timeout = PATIENCE_S
    return Master("can", app, policy=rows, transport_layer_interface=bus)
