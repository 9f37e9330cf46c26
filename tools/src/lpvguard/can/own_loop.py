"""Put the guarded controller on a car's own bus.

The loop receives the messages of speed and outputs, and sends the demands in their message of the same bus.
Two messages of lpvguard's CAN catalogue join them: GUARD_IN commands the loop, and GUARD_OUT reports it. Here
they have the vehicle's sample period. The command has the range of the controlled output.

    lpvguard_bus.c, lpvg_can_codec.h, .c    the loop's signals, for the core
    lpvg_can_own.h, .c                      frames of the car to frames of the codec (own_code.py)
    lpvg_demand.h, .c                       demands to frames of the car (demand_code.py)
    lpvg_rest.h, .c                         the rest of the bus, for simulations: sensors to frames of the
                                            car, and frames with demands to values

There are limits. A frame has at most 8 bytes, and at most 7 messages carry speed and outputs. Beyond them,
only the demands' code is made.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

from ..base.errors import InputWarning
from ..vehicle.project import Project, Signal
from .bus import AUTHENTICATOR, PROPRIETARY_SPN, REFERENCE, bus_table, take_case
from .catalogue import Catalogue, Message, Node, Supervision, load_catalogue
from .codegen import codec_files
from .demand_code import demand_files, enclosed, packing
from .own import CarBus, Sent, demand_messages, own_bus, sensor_messages
from .own_code import BANNER, checked_lines, own_files, raw_value

REST, REST_HEADER = "rest", "lpvg_rest.h"
REPORT = "GUARD_OUT"
BYTES, MESSAGES = 8, 7
"""Most bytes of a frame, and most messages of the car in the loop."""
_MIDDLE, _MOST = 32127, 32000
"""Raw value of a command of 0, and steps from it to the controlled output's largest value."""


def loop_signals(project: Project) -> list[Signal]:
    """Signals that the loop receives: speed and outputs."""
    return [project.speed, *project.outputs]


def loop_files(project: Project) -> dict[str, str]:
    """Generate the C code of a vehicle's loop on its own bus.

    Parameters
    ----------
    project : Project, with can.demand

    Returns
    -------
    dict[str, str], text by file name; beyond the limits the demands' files alone, with a warning

    Raises
    ------
    InputError
        If the database lacks an entry.
    """
    signals, demands = loop_signals(project), demand_messages(project)
    bus = own_bus(project, signals)
    if misfit := _misfit(bus, demands):
        warnings.warn(f"vehicle {project.name}: no ECU code: {misfit}", InputWarning, stacklevel=1)
        return demand_files(demands, project.n_u)
    catalogue = _with_ours(project, bus.catalogue)
    needed = {
        name: PROPRIETARY_SPN + k
        for k, name in enumerate((REFERENCE.message, *(m.ours.name for m in bus.messages)))
    }
    source = bus_table(
        project.name, catalogue, needed, _cases(project, bus, catalogue), catalogue.message(REPORT)
    )
    return {
        "lpvguard_bus.c": source,
        **codec_files(catalogue),
        **own_files(replace(bus, catalogue=catalogue)),
        **demand_files(demands, project.n_u),
        **_rest_files(sensor_messages(project, bus, signals), len(signals), demands, project.n_u),
    }


def _misfit(bus: CarBus, demands: list[Sent]) -> str | None:
    """Why the loop cannot work on the bus; None: it can."""
    if len(bus.messages) > MESSAGES:
        return f"{len(bus.messages)} messages carry speed and outputs; the loop takes at most {MESSAGES}"
    for m in (*bus.messages, *(d.message for d in demands)):
        if m.car.length > BYTES:
            return f"message {m.car.name} has {m.car.length} bytes; the loop takes at most {BYTES}"
    return None


def _with_ours(project: Project, catalogue: Catalogue) -> Catalogue:
    """Catalogue of the car's messages, and of ours that command and report the loop."""
    shipped, period_ms = load_catalogue(), max(1, round(project.Ts_s * 1000))
    controlled = project.outputs[project.controlled]
    scale = 2.0 ** math.ceil(math.log2(max(abs(controlled.min), abs(controlled.max)) / _MOST))
    range_ = {"scale": scale, "offset": -scale * _MIDDLE, "unit": controlled.unit}
    accepted = Supervision(min=controlled.min, max=controlled.max)
    range_ |= {"positive": controlled.positive, "supervise": accepted}
    command, report = shipped.message(REFERENCE.message), shipped.message(REPORT)
    ours = [
        command.model_copy(
            update={
                "period_ms": period_ms,
                "signals": [
                    s.model_copy(update={"name": "reference", **range_}) if s.name == REFERENCE.signal else s
                    for s in command.signals
                    if s.name != "dp_measured"
                ],
            }
        ),
        shipped.message(AUTHENTICATOR),
        report.model_copy(
            update={"period_ms": period_ms, "signals": [s for s in report.signals if s.name != "dp_demand"]}
        ),
    ]
    nodes = [*catalogue.nodes, *(n for n in shipped.nodes if n.address == command.source_address)]
    return _joined(catalogue, nodes, ours)


def _joined(catalogue: Catalogue, nodes: list[Node], messages: list[Message]) -> Catalogue:
    """Catalogue with more messages, checked as a whole."""
    both = [m.model_dump() for m in (*catalogue.messages, *messages)]
    return Catalogue.model_validate({"schema": 1, "nodes": [n.model_dump() for n in nodes], "messages": both})


def _cases(project: Project, bus: CarBus, catalogue: Catalogue) -> str:
    """C cases that take the signals of the loop from frames of the catalogue.

    The car does not say on its bus who brakes. Its command message releases the loop instead.
    """
    members = {project.speed.name: "speed"} | {s.name: f"y[{j}]" for j, s in enumerate(project.outputs)}
    cases = ""
    for m in bus.messages:
        places = [(name, bus.places[name]) for name in members if bus.places[name][0].name == m.ours.name]
        statements = []
        for name, (_, halves, factor) in places:
            total = " + ".join(f"(lpvg_real_t){h.name}" for h in halves)
            statements.append(f"signals->{members[name]} = ({total}) * (lpvg_real_t){1.0 / factor:.17g};")
        cases += take_case(
            catalogue.message(m.ours.name), [h for _, (_, halves, _) in places for h in halves], statements
        )
    command = catalogue.message(REFERENCE.message)
    statements = [
        "signals->reference = (lpvg_real_t)reference;",
        "signals->request = control_request;",
        "signals->other_priority = other_priority;",
        "signals->brake_pedal = 0.0f;",
        "signals->abs_active = 0.0f;",
    ]
    return cases + take_case(command, command.signals, statements)


def _rest_files(sensors: list[Sent], n: int, demands: list[Sent], n_u: int) -> dict[str, str]:
    """C code of the rest of the bus: sensors [n] to frames, and frames to demands [n_u]."""
    header, source = packing(REST, sensors, n)
    taken = f"lpvg_status_t lpvg_{REST}_take(const lpvg_can_frame_t* frame, float* u)"
    sent = (*sensors, *demands)
    header += f"""
/* A message of the car: name, identifier with its flags, period. First those that lpvg_{REST}_pack makes. */
typedef struct lpvg_{REST}_message_t {{
    const char* name;
    uint32_t id;
    uint32_t period_us;
}} lpvg_{REST}_message_t;
#define LPVG_{REST.upper()}_NAMES {len(sent)}u
extern const lpvg_{REST}_message_t lpvg_{REST}_messages[LPVG_{REST.upper()}_NAMES];

/* Takes the demands of a frame into u [{n_u}]. Returns bad_sample, changing nothing, when the frame has none,
 * or has a wrong length or checksum. */
LPVG_NODISCARD {taken};
"""
    rows = "".join(
        f'    {{"{m.car.name}", 0x{m.identifier:08X}u, {m.ours.period_ms * 1000}u}},\n'
        for m in (s.message for s in sent)
    )
    cases = "".join(_take_demands(d) for d in demands)
    source = (
        f'{BANNER}#include "{REST_HEADER}"\n\n#include <math.h>\n{source}\n'
        f"const lpvg_{REST}_message_t lpvg_{REST}_messages[LPVG_{REST.upper()}_NAMES] = {{\n{rows}}};\n\n"
        f"{taken}\n{{\n    const uint8_t* data = frame->data;\n    const uint32_t id = frame->id;\n"
        f"    const uint32_t length = frame->dlc;\n{cases}    return lpvg_status_bad_sample;\n}}\n"
    )
    return {REST_HEADER: enclosed(REST, header), f"lpvg_{REST}.c": source}


def _take_demands(sent: Sent) -> str:
    """C statements that take the demands of one message."""
    m = sent.message
    declared, assigned, right = checked_lines(m)
    values = []
    for signals, k, factor in sent.signals:
        s = signals[0]
        raw, top = f"(double)(({raw_value(s)}))", 1 << (s.length - 1)
        if s.is_signed:
            raw = f"(double)(({raw_value(s)}) ^ 0x{top:X}u) - {top}.0"
        values.append(
            f"        u[{k}] = (float)(({float(s.scale)!r} * ({raw}) + {float(s.offset)!r}) / {factor!r});\n"
        )
    lines = [f"    if ((id == 0x{m.identifier:08X}u) && (length == {m.car.length}u)) {{\n"]
    lines += ["    " + line for line in (*declared, *assigned)]
    lines += [f"        if ({right} == 0) {{\n            return lpvg_status_bad_sample;\n        }}\n"]
    return "".join([*lines, *values, "        return lpvg_status_ok;\n    }\n"])
