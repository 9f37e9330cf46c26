"""Generate lpvguard_bus.c (lib/include/lpvguard/bus.h): where the CAN catalogue has the vehicle's signals."""

import numpy as np

from ..base.errors import InputError
from ..vehicle.project import CanPlace, Project
from .catalogue import BusSignal, Catalogue, Message, load_catalogue
from .codegen import ANY_PRIORITY
from .logs import EXTENDED, Frames

REFERENCE = CanPlace(message="GUARD_IN", signal="yaw_rate_command")
AUTHENTICATOR = "GUARD_IN_AUTH"
"""Message that authenticates the preceding frame of REFERENCE's message."""
REPORT = {
    "dp_demand": "demand",
    "monitor_margin": "statistic",
    "monitor_verdict": "verdict",
    "supervision_state": "supervision",
    "engagement": "engagement",
    "command_authentication": "authenticated",
}
"""Member of lpvg_bus_report_t for each signal of the report message."""
AUTHENTICATION = CanPlace(message="GUARD_OUT", signal="command_authentication")
"""Signal that tells whether the ECU only obeys authenticated commands."""
CHECKS = {
    "yaw_rate": ("VDC2", "{yaw_rate}"),
    "lateral": ("VDC2", "{lateral_acceleration}"),
    "wheel_difference": ("EBC2", "({relative_speed_rear1_right} - {relative_speed_rear1_left}) / 3.6f"),
    "brake_pedal": ("EBC1", "{brake_pedal_position}"),
    "abs_active": ("EBC1", "{abs_active}"),
    "measured": ("GUARD_IN", "{dp_measured}"),
    "request": ("GUARD_IN", "{control_request}"),
    "other_priority": ("GUARD_IN", "{other_priority}"),
}
"""Message and C expression for each member of lpvg_bus_signals_t that serves cross-checks or permission."""
OVERRIDE = CanPlace(message="EBC1", signal="abs_active")
"""Message that reports the driver's braking and ABS."""
PROPRIETARY_SPN = 520192
"""First parameter number that J1939-73 reserves for manufacturers, used for signals without their own
number."""


def command_authentication(frames: Frames, catalogue: Catalogue | None = None) -> str | None:
    """Return the name of AUTHENTICATION's value in the newest frame that contains the signal.

    Parameters
    ----------
    frames : Frames
    catalogue : Catalogue, optional, by default the shipped one

    Returns
    -------
    str, or None without such a frame
    """
    message = (catalogue or load_catalogue()).message(AUTHENTICATION.message)
    signal = next(s for s in message.signals if s.name == AUTHENTICATION.signal)
    identifier = np.uint32((message.id | EXTENDED) & ANY_PRIORITY)
    reports = np.flatnonzero(((frames.id & np.uint32(ANY_PRIORITY)) == identifier) & (frames.length == 8))
    if not len(reports):
        return None
    raw = int.from_bytes(frames.data[reports[-1], :8].tobytes(), "little")
    code = raw >> signal.start & ((1 << signal.length) - 1)
    return next(name for name, value in signal.values.items() if value == code)


def sends_demand(project: Project) -> bool:
    """Tell if the CAN catalogue has a message of ours for the vehicle's demand.

    Parameters
    ----------
    project : Project

    Returns
    -------
    bool, False if the input is measured, has no place, or lies on the car's own bus
    """
    place = project.inputs[0].can
    if project.can is not None or place is None:
        return False
    catalogue = load_catalogue()
    return any(
        m.name == place.message and m.source_address == catalogue.own_address for m in catalogue.messages
    )


def bus_source(project: Project) -> str:
    """Generate the C text of lpvguard_bus.c.

    Parameters
    ----------
    project : Project

    Returns
    -------
    str

    Raises
    ------
    InputError
        If a signal has no usable place on the bus; it names the signal.
    """
    catalogue = load_catalogue()
    where = f"vehicle {project.name}"
    report = _report_message(project, catalogue, where)
    values: dict[str, list[str]] = {}
    used: dict[str, list[BusSignal]] = {}
    for member, place in _places(project, where):
        message, signal = _received(catalogue, place, where)
        used.setdefault(message.name, []).append(signal)
        scale = "" if place.factor == 1.0 else f" * (lpvg_real_t){1.0 / place.factor:.17g}"
        values.setdefault(message.name, []).append(f"signals->{member} = (lpvg_real_t){signal.name}{scale};")
    _, override = _received(catalogue, OVERRIDE, where)
    needed = {name: signals[0].spn or PROPRIETARY_SPN for name, signals in used.items()}
    needed[OVERRIDE.message] = override.spn or PROPRIETARY_SPN
    for member, (name, expression) in CHECKS.items():
        for signal in catalogue.message(name).signals:
            if "{" + signal.name + "}" in expression:
                used.setdefault(name, []).append(signal)
                expression = expression.replace("{" + signal.name + "}", signal.name)
        values.setdefault(name, []).append(f"signals->{member} = {expression};")
    cases = "".join(take_case(catalogue.message(name), used[name], values[name]) for name in sorted(used))
    return bus_table(project.name, catalogue, needed, cases, report)


def _report_message(project: Project, catalogue: Catalogue, where: str) -> Message:
    """Message with the vehicle's input; raise InputError unless it is our message with a single demand."""
    demand = _place(project.inputs[0].name, project.inputs[0].can, where)
    report = catalogue.message(demand.message)
    if (
        project.n_u != 1
        or report.source_address != catalogue.own_address
        or demand.signal != "dp_demand"
        or demand.factor != 1.0
    ):
        raise InputError(
            where,
            f"signal {project.inputs[0].name}",
            f"{demand.message}.{demand.signal}",
            "one input, which our message sends as dp_demand with factor 1",
        )
    return report


def _places(project: Project, where: str) -> list[tuple[str, CanPlace]]:
    """Members of lpvg_bus_signals_t with their places on the bus."""
    return [
        ("speed", _place("speed", project.speed.can, where)),
        ("reference", REFERENCE),
        *((f"y[{j}]", _place(s.name, s.can, where)) for j, s in enumerate(project.outputs)),
    ]


def bus_table(name: str, catalogue: Catalogue, needed: dict[str, int], cases: str, report: Message) -> str:
    """Generate the C text of lpvguard_bus.c for the vehicle ``name``.

    ``needed`` holds the suspect parameter number that reports the loss of a message, by its name. ``cases``
    are the C cases of lpvg_bus_take. ``report`` is the message that reports to the vehicle.
    """
    command, authenticator = catalogue.message(REFERENCE.message), catalogue.message(AUTHENTICATOR)
    needs = ", ".join(
        f"[{i}] = {{LPVG_CAN_{message}_INDEX, {spn}u}}" for i, (message, spn) in enumerate(needed.items())
    )
    return f"""\
/* Generated by lpvguard export; do not edit. \
Where the signals of {name} lie on the bus: lpvguard/bus.h. */
#include "lpvguard/bus.h"

#include "lpvg_can_codec.h"

const lpvg_bus_t lpvg_bus = {{
    .rules = lpvg_can_rules,
    .n_rules = LPVG_CAN_RECEIVED,
    .own_address = 0x{catalogue.own_address:02X}u,
    .command_id = LPVG_CAN_{command.name}_ID,
    .authenticator_id = LPVG_CAN_EXTENDED | 0x{authenticator.id:08X}u,
    .command_data_id = LPVG_CAN_{command.name}_E2E_DATA_ID,
    .n_needed = {len(needed)}u,
    .needed = {{{needs}}},
}};

void lpvg_bus_take(lpvg_bus_signals_t* signals, uint8_t index, const lpvg_can_frame_t* frame)
{{
    switch (index) {{
{cases}    default:
        break;
    }}
}}

{_report(report)}"""


def _place(name: str, place: CanPlace | None, where: str) -> CanPlace:
    if place is None:
        raise InputError(where, f"signal {name}", "no place on the bus", "can = { message, signal, factor }")
    return place


def _received(catalogue: Catalogue, place: CanPlace, where: str) -> tuple[Message, BusSignal]:
    message = catalogue.message(place.message)
    signal = next((s for s in message.signals if s.name == place.signal), None)
    if signal is None or message.source_address == catalogue.own_address or message.codec != "generated":
        raise InputError(
            where,
            f"{place.message}.{place.signal}",
            "not a signal that we receive",
            "a signal of another node's message in the CAN catalogue",
        )
    return message, signal


def take_case(message: Message, signals: list[BusSignal], statements: list[str]) -> str:
    """Generate a C case of a switch over message indices.

    The case decodes signals of ``frame`` to floats of their names.

    Parameters
    ----------
    message : Message
    signals : list of BusSignal, signals to decode
    statements : list of str, C statements after the decoding

    Returns
    -------
    str
    """
    prefix = f"lpvg_can_{message.name.lower()}"
    names = list(dict.fromkeys(s.name for s in signals))
    lines = [
        f"    case LPVG_CAN_{message.name}_INDEX: {{",
        f"        {prefix}_t message;",
        *(f"        float {name};" for name in names),
        f"        if ({prefix}_unpack(&message, frame) == lpvg_status_ok) {{",
    ]
    # decode writes NaN if there is no value. The code that reads the number refuses NaN.
    lines += [
        f"            (void)lpvg_can_decode(&{prefix}_{name}, message.{name}, &{name});" for name in names
    ]
    lines += [f"            {statement}" for statement in statements]
    return "\n".join([*lines, "        }", "        break;", "    }", ""])


def _report(message: Message) -> str:
    prefix = f"lpvg_can_{message.name.lower()}"
    lines = [
        "lpvg_status_t lpvg_bus_pack_report(const lpvg_bus_report_t* report, lpvg_can_frame_t* frame, "
        "uint8_t* counter)",
        "{",
        f"    {prefix}_t message;",
        "    lpvg_status_t status;",
        "    if ((report == NULL) || (frame == NULL) || (counter == NULL)) {",
        "        return lpvg_status_bad_argument;",
        "    }",
    ]
    lines += [
        f"    message.{s.name} = lpvg_can_encode(&{prefix}_{s.name}, (float)report->{REPORT[s.name]});"
        for s in message.signals
    ]
    lines += [
        f"    status = {prefix}_pack(&message, frame);",
        "    return (status == lpvg_status_ok) ? "
        f"lpvg_can_e2e_protect(frame, LPVG_CAN_{message.name}_E2E_DATA_ID, counter) : status;",
        "}",
        "",
    ]
    return "\n".join(lines)
