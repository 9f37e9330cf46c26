"""The software component of a vehicle's monitor: its ARXML, and the C source of its runnables."""

from collections.abc import Sequence
from pathlib import Path

from ...core.compiled import Core
from ...vehicle.project import Project
from ..fmu.variables import Variable, monitor_variables
from .description import ASSESSMENT, SIGNALS, description

_SOURCE = """\
/* {name}.c -- runnables of the monitor's software component, called by the RTE of {name}.arxml.
 *
 * Init compares the parameters of the RTE with the coefficients. If they differ, the verdict is "fault".
 * Step takes one sample. If a signal cannot be read, Step pushes no sample, and the monitor sees a gap. */
#include "Rte_{name}.h"
#include "lpvguard/monitor.h"

static lpvg_monitor_t monitor;
static int64_t now_us;
static boolean ready = FALSE;

FUNC(void, {name}_CODE) {name}_Init(void)
{{
    const lpvg_coeff_reals_t* reals = &lpvg_coeff.reals;
    now_us = 0;
    ready = (boolean)(Rte_CData_coefficients_crc32() == lpvg_coeff.words.crc32{parameters}
        && lpvg_monitor_init(&monitor, &lpvg_coeff) == lpvg_status_ok);
}}

FUNC(void, {name}_CODE) {name}_Step(void)
{{
    lpvg_sample_t sample;
    lpvg_frame_t record;
    lpvg_status_t status = lpvg_status_ok;
    Std_ReturnType result = RTE_E_OK;
    if (ready == FALSE)
    {{
        (void)Rte_Write_{sent}_verdict((uint8)lpvg_verdict_fault);
        return;
    }}
    now_us += (int64_t)lpvg_coeff.words.sample_period_us;
    sample.t_us = now_us;
{reads}
    if (result == RTE_E_OK)
    {{
        status = lpvg_monitor_push(&monitor, &sample);
    }}
    while (lpvg_monitor_take_record(&monitor, &record))
    {{
    }}
{writes}
}}
"""
_RESULTS = {
    "margin": "monitor.frame.margin",
    "statistic": "monitor.frame.statistic",
    "evidence": "monitor.frame.evidence",
    "energy_ratio": "monitor.energy.ratio",
    "change_ratio": "monitor.change.ratio",
    "verdict": "(uint8)lpvg_monitor_verdict(&monitor, now_us)",
    "reason": "(uint8)lpvg_monitor_reason(&monitor)",
    "status": "(uint8)status",
    "frames": "monitor.frame.sequence",
    "bin": "monitor.frame.bin",
}
"""C expression of each element of the provided port."""


def monitor_component(project: Project, folder: Path) -> dict[str, str]:
    """Return the files of a vehicle's software component.

    Parameters
    ----------
    project : Project
    folder : Path
        Generated folder of the vehicle, by ``lpvguard export``.

    Returns
    -------
    dict of str to str
        Text of NAME.arxml and NAME.c, by the file's name.

    Raises
    ------
    InputError
        If the folder is incomplete, or the package autosar is not installed.

    References
    ----------
    AUTOSAR Classic Platform 4.2.2, Software Component Template and Specification of RTE.
    """
    core = Core(folder)
    variables = monitor_variables(project, core.thresholds)
    received = [v for v in variables if v.causality == "input"]
    sent = [v for v in variables if v.name in _RESULTS]
    name = f"Lpvguard_{project.name}"
    crc = int(core.words["crc32"][0])
    return {
        f"{name}.arxml": description(name, core.period_s, received, sent, core.thresholds, crc),
        f"{name}.c": _source(name, project, received, sent, core.thresholds),
    }


def _source(
    name: str,
    project: Project,
    received: Sequence[Variable],
    sent: Sequence[Variable],
    parameters: dict[str, float],
) -> str:
    """Write the C source of the runnables."""
    inputs = len(project.inputs)
    places = ["speed", *(f"u[{k}]" for k in range(inputs)), *(f"y[{k}]" for k in range(len(project.outputs)))]
    reads = [
        f"    result = (Std_ReturnType)(result | Rte_Read_{SIGNALS}_{v.name}(&sample.{place}));"
        for v, place in zip(received, places, strict=True)
    ]
    writes = [f"    (void)Rte_Write_{ASSESSMENT}_{v.name}({_RESULTS[v.name]});" for v in sent]
    checks = [f"\n        && Rte_CData_{key}() == reals->{key}" for key in parameters]
    return _SOURCE.format(
        name=name,
        sent=ASSESSMENT,
        parameters="".join(checks),
        reads="\n".join(reads),
        writes="\n".join(writes),
    )
