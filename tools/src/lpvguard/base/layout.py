"""Layout of the coefficients: the one description of a vehicle's generated structs.

A coefficient struct of the core is 32-bit words, then numbers, under one CRC-32. The tables COEFF (model,
estimator, monitor), CONTROL (controller), DIAGNOSIS (causes of alarms) and ISOLATION (parts) give

    lib/include/lpvguard: coeff.h, controller.h, diagnosis.h, isolation.h   the structs, between the marks
                                                 ``layout``
    lib/src: the files of CHECKS                 sizes and ranges that the core checks in ``lpvg_coeff_check``
    lib/COEFFICIENTS.md                          the tables for people
    core/seal.py, core/coefficients.py, core/control_coefficients.py
                                                 order, shapes and ranges of what is exported
    core/compiled.py                             names and shapes of what is read back

``python -m lpvguard.base.layout`` in a checkout writes the first three. The test
``tests/tools/base/test_layout.py`` fails when they differ from the tables. ``coeff.cpp`` checks conditions
between items of arrays (stable sections, even frames), and the field's meaning states them. A change of the
tables needs a higher ``schema`` of its struct and a new export of every vehicle.
"""

from pathlib import Path

from .errors import InputError
from .layout_parts import CONSTANTS as CONSTANTS
from .layout_parts import DIMENSIONS as DIMENSIONS
from .layout_parts import Field as Field
from .layout_parts import Layout as Layout
from .layout_parts import constant as constant
from .layout_parts import ends_of, head_fields, macros, text_of_shape

_COEFF_DIMENSIONS = tuple(DIMENSIONS)[:11]
COEFF = Layout(
    stem="coeff",
    struct="coeff",
    header="coeff.h",
    magic=0x4C505647,
    schema=8,
    dimensions=_COEFF_DIMENSIONS,
    words=(
        *head_fields("LPVG_COEFF", _COEFF_DIMENSIONS),
        Field("estimator_id", (), "", "LPVG_ESTIMATOR_ID: definition of the frames that gave the bounds"),
        Field("crc32", (), "", "CRC-32 over all words and numbers"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
        Field("settle_samples", (), "samples", "least time in the speed range before frames begin"),
        Field("confirm", (), "", "k of the k-of-m confirmation", "[1, of_last]"),
        Field("of_last", (), "", "m of the k-of-m confirmation", "[0, NHISTORY]"),
        Field(
            "energy_settle",
            (),
            "samples",
            "least time in the speed range before the left sum of the energy test begins",
            "[settle_samples, inf)",
        ),
        Field(
            "energy_rearm",
            (),
            "",
            "number of judgements below the threshold after which the next exceedance is a new alarm",
            "[1, inf)",
        ),
        Field("change_rearm", (), "", "the same number for the change test", "[1, inf)"),
        Field(
            "frame_length",
            ("NBINS",),
            "samples",
            "length of a frame: even, at most that of DC; half of it exceeds LPVG_NLATENCY",
        ),
        Field("cycles", ("NBINS",), "", "number of periods in a frame: 0 at DC, less than half its samples"),
        Field("pool_parts", ("NBINS",), "", "number of parts of a pool", "[1, NPOOL]"),
        Field("pool_frames", ("NBINS",), "", "number of frames in a part", "[1, inf)"),
        Field(
            "varying_entry",
            ("NVARYING",),
            "",
            "indices of the model entries that vary with speed",
            "[0, NENTRIES)",
        ),
    ),
    reals=(
        Field("speed_min", (), "m/s", "lower end of the scheduling range", "(0, speed_max)"),
        Field("speed_max", (), "m/s", "upper end of the scheduling range"),
        Field("speed_valid", ("2",), "m/s", "physical range of the signal"),
        Field("input_valid", ("NU", "2"), "input unit", "physical range"),
        Field("output_valid", ("NY", "2"), "output unit", "physical range"),
        Field("speed_tolerance", (), "-", "largest |v/mean - 1| in a frame", "(0, inf)"),
        Field("input_offset", ("NU",), "input unit", "offset that is subtracted from the input"),
        Field("output_offset", ("NY",), "output unit", "offset that is added to the output"),
        Field("base", ("NENTRIES",), "", "model entries that do not vary with speed"),
        Field("cell", ("NCELLS", "NVARYING", "4"), "", "cubic in the position 0..1 within a speed cell"),
        Field("C", ("NY", "NX"), "", "output matrix"),
        Field("C_pinv", ("NX", "NY"), "", "pseudo-inverse of C: gives the state from a measured output"),
        Field("turn", ("NBINS", "2"), "-", "cos - 1 and sin of the phase step 2 pi cycles / N"),
        Field("taper", ("NBINS", "2"), "-", "cos - 1 and sin of the window step 2 pi / N"),
        Field("scale", ("NBINS",), "-", "2 / sum(window), at DC 1 / sum(window)", "(0, inf)"),
        Field(
            "energy_corner",
            ("NBANDS - 1",),
            "-",
            "g of the low-pass g (z + 1) / (z - 1 + 2 g) at each corner, in non-decreasing order",
            "(0, 1)",
        ),
        Field(
            "energy_W",
            ("NDELTA", "NWEIGHT", "5"),
            "-",
            "sections of W_delta on |z| = rho, b0 b1 b2 a1 a2, stable (energy.cpp)",
        ),
        Field("energy_scale", ("NBANDS", "NY"), "1/output unit", "1 / sigma_j of each band", "(0, inf)"),
        Field("energy_forget", ("NBANDS",), "-", "1 - rho^2, rho of the left sums of the band", "(0, 1)"),
        Field(
            "energy_start",
            ("NBANDS", "NY"),
            "output unit",
            "largest response to samples before a restart",
            "[0, inf)",
        ),
        Field(
            "energy_direction",
            ("NDIRECTIONS", "NY"),
            "-",
            "direction a in units of sigma with sum |a_j| = 1; a single output if NDELTA > 1",
        ),
        Field("energy_threshold", (), "-", "calibrated threshold of the energy test's ratio", "[1, inf)"),
        Field(
            "energy_certificate", (), "-", "ratio of the energy test that refutes the certificate", "[1, inf)"
        ),
        Field("change_block_s", (), "s", "length of a block of LPVG_NBLOCK samples", "(0, inf)"),
        Field(
            "change_unit",
            ("NY", "2"),
            "1/output unit",
            "1 / rms of yhat_j, and 1 / rms of its change over a block, on the drives that set the bounds",
            "(0, inf)",
        ),
        Field(
            "change_prior",
            ("NY", "6"),
            "-",
            "prior that is added to the sums of phi phi': upper triangle row by row, positive definite",
        ),
        Field(
            "change_scale",
            ("NY", "3"),
            "1/output unit",
            "1 / size of theta_i on the drives that set the bounds, for regressors divided by their sizes",
            "(0, inf)",
        ),
        Field("change_forget", (), "-", "share of the sums that is forgotten per block", "(0, 1)"),
        Field("change_threshold", (), "-", "calibrated threshold of the change test's ratio", "(0, inf)"),
        Field("W_delta", ("NBINS", "NDELTA"), "-", "|W_delta| of the healthy set at the bin", "(0, inf)"),
        Field(
            "B_w",
            ("NBINS", "NY"),
            "output unit",
            "disturbance bound of the healthy set at the bin",
            "(0, inf)",
        ),
        Field(
            "W_certificate", ("NBINS", "NDELTA"), "-", "|W_delta| of the certificate at the bin", "(0, inf)"
        ),
        Field(
            "B_certificate",
            ("NBINS", "NY"),
            "output unit",
            "disturbance bound of the certificate at the bin",
            "(0, inf)",
        ),
        Field(
            "pool_scale",
            ("NSPEEDS", "NBINS", "2", "NY"),
            "1/output unit, -",
            "1 / bounds of a pool's error and of its share of |yhat|, 0: no bound",
            "[0, inf)",
        ),
        Field("threshold", (), "-", "calibrated threshold of the frame test's statistic", "(0, inf)"),
    ),
)

_CONTROL_DIMENSIONS = ("NK", "NM", "NG", "NU")
CONTROL = Layout(
    stem="control",
    struct="control_coeff",
    header="controller.h",
    magic=0x4C505643,
    schema=3,
    dimensions=_CONTROL_DIMENSIONS,
    words=(
        *head_fields("LPVG_CONTROL", _CONTROL_DIMENSIONS),
        Field("crc32", (), "", "CRC-32 over all words and numbers, as in coeff.h"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
    ),
    reals=(
        Field("speed_min", (), "m/s", "first node", "(0, speed_max)"),
        Field("speed_max", (), "m/s", "last node"),
        Field("u_max", ("NG", "NU"), "input unit", "largest |demand| at every node", "(0, inf)"),
        Field("rate_max", ("NU",), "input unit/s", "largest |change of demand|", "(0, inf)"),
        Field("A1", ("NK",), "-", "a and a' of each pair, then a of a single state"),
        Field("engage", ("NK", "2"), "-", "change of x for u - v, and for the drift of v"),
        Field("BL", ("NG", "NU", "NK", "NM + NU"), "", "rows of B, then of L"),
    ),
)


# --- expressions and intervals ---


DIAGNOSIS = Layout(
    stem="diagnosis",
    struct="diagnosis_table",
    header="diagnosis.h",
    magic=0x4C505644,
    schema=2,
    dimensions=("NY",),
    words=(
        *head_fields("LPVG_DIAGNOSIS", ("NY",)),
        Field("crc32", (), "", "CRC-32 over all words and numbers, as in coeff.h"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
        Field(
            "blocks",
            (),
            "blocks",
            "least number of settled blocks since an alarm to judge causes",
            "[8, 65536]",
        ),
        Field("stride", (), "blocks", "distance between two tried delays", "[1, 4]"),
        Field("cell_blocks", (), "blocks", "length of a cell of the ring before the alarm", "[1, 65536]"),
    ),
    reals=(
        Field("block_s", (), "s", "length of a block of LPVG_NBLOCK samples", "(0, inf)"),
        Field(
            "unit",
            ("NY", "2"),
            "1/output unit",
            "1 / rms of yhat_j, and 1 / rms of its change over a block, on the drives that set the bounds",
            "(0, inf)",
        ),
        Field(
            "spread",
            ("NY", "10"),
            "output unit squared",
            "covariance of a healthy theta, for regressors divided by their sizes: upper triangle row by "
            "row, positive definite",
        ),
        Field(
            "correlated",
            ("NY",),
            "-",
            "ratio of an estimate's variance to its variance with a white residue",
            "(0, inf)",
        ),
        Field(
            "residue",
            ("NY", "2"),
            "output unit squared; -",
            "largest mean square of a healthy residue: a constant, and a share of the mean square of yhat_j",
            "(0, inf)",
        ),
        Field("rough", ("NY",), "output unit squared", "largest mean square of healthy noise", "(0, inf)"),
        Field(
            "still",
            ("NY",),
            "-",
            "the output is frozen below this ratio of the mean squares of dy_j and dyhat_j",
            "(0, 1)",
        ),
        Field(
            "excited", (), "-", "least mean square of yhat_j, divided by its size, to judge causes", "(0, 1)"
        ),
        Field(
            "fits",
            (),
            "-",
            "largest misfit of an accepted cause: chi-squared with 3 degrees of freedom",
            "(0, inf)",
        ),
        Field("margin", (), "-", "least difference in misfit to the second-best cause", "[0, inf)"),
        Field("interval", (), "-", "half width of an interval in standard deviations", "(0, inf)"),
        Field(
            "kept", ("NY",), "-", "share of the spread that is constant within a drive; 0: unknown", "[0, 1)"
        ),
    ),
)


_ISOLATION_DIMENSIONS = ("NX", "NU", "NY", "DELAY", "NCELLS", "NVARYING")
_COLUMNS, _PARTS = "5 * (NY + NU) + 3", "NY + NU + 3"
ISOLATION = Layout(
    stem="isolation",
    struct="isolation_table",
    header="isolation.h",
    magic=0x4C505649,
    schema=1,
    dimensions=_ISOLATION_DIMENSIONS,
    words=(
        *head_fields("LPVG_ISOLATION", _ISOLATION_DIMENSIONS),
        Field("crc32", (), "", "CRC-32 over all words and numbers, as in coeff.h"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
        Field("window_us", (), "us", "length of a window", "[1000000, 600000001)"),
        Field("half", (), "samples", "length of half a block", "[1, 65536]"),
        Field("parameters", (), "", "number of model parameters that tyres and load change", "[0, 2]"),
        Field("parts", (), "", "number of parts that can be named", "[1, NY + NU + 2]"),
        Field(
            "part",
            (_PARTS,),
            "",
            "index of the part of each output, each input, the speed and each parameter",
            "[0, parts)",
        ),
    ),
    reals=(
        Field("period_s", (), "s", "Ts", "(0, inf)"),
        Field("lags", ("3", "NY", "NY"), "-", "autoregression coefficients of the residue"),
        Field(
            "white",
            ("NY", "NY"),
            "1/output unit",
            "matrix that gives the innovation of the residue unit covariance",
        ),
        Field("mean", (_COLUMNS,), "sizes", "mean of the healthy sizes"),
        Field("spread", (_COLUMNS,), "sizes", "standard deviation of the healthy sizes", "[0, inf)"),
        Field("fault", (_COLUMNS,), "sizes", "standard deviation of the faulty sizes", "[0, inf)"),
        Field("power", ("NY",), "-", "exponent of the measured speed in an output"),
        Field("base", ("2", "NENTRIES"), "", "`base` of coeff.h for a parameter that is 2 % larger"),
        Field("cell", ("2", "NCELLS", "NVARYING", "4"), "", "`cell` of coeff.h for that parameter"),
        Field("scale", (), "-", "divisor of the log-likelihoods", "[1, inf)"),
        Field("least", (), "-", "least log-odds of a differing window against a healthy vehicle", "[0, inf)"),
        Field("lack", (), "-", "largest misfit of the best part in a healthy window", "[0, inf)"),
    ),
)


LAYOUTS = (COEFF, CONTROL, DIAGNOSIS, ISOLATION)


BEGIN = "/* layout: generated by `python -m lpvguard.base.layout`, do not edit */\n/* clang-format off */"
END = "/* clang-format on */\n/* layout: end */"


def _struct(name: str, kind: str, fields: tuple[Field, ...]) -> list[str]:
    width = max(len(kind) + len(field.declarator) for field in fields) + 4
    lines = [f"typedef struct {name} {{"]
    for field in fields:
        notes = (
            field.meaning
            + (f" [{field.unit}]" if field.unit else "")
            + (f", within {field.within}" if field.within else "")
        )
        lines.append(f"    {f'{kind} {field.declarator};':<{width}}///< {notes}")
    return [*lines, f"}} {name};", ""]


def header_block(layout: Layout) -> str:
    """Generated part of the struct's header."""
    lines = [
        BEGIN,
        f"#define {layout.macro}_MAGIC 0x{layout.magic:08X}U",
        f"#define {layout.macro}_SCHEMA {layout.schema}U",
    ]
    for name, (expression, comment) in CONSTANTS.items():
        if layout is COEFF:
            lines += [f"/// {comment}", f"#define LPVG_{name} {macros(expression)}"]
    stem = f"lpvg_{layout.stem}"
    names = [f"{stem}_words_t", f"{stem}_reals_t", f"lpvg_{layout.struct}_t"]
    lines += ["", *(f"#define {name} LPVG_SYM({name.removeprefix('lpvg_')})" for name in names), ""]
    lines += _struct(names[0], "uint32_t", layout.words) + _struct(names[1], "lpvg_real_t", layout.reals)
    lines += [
        f"typedef struct {names[2]} {{",
        f"    {names[0]} words;",
        f"    {names[1]} reals;",
        f"}} {names[2]};",
        END,
    ]
    return "\n".join(lines)


POSITIVE = "is_positive"
POSITIVE_CONDITION = "[](lpvg_real_t x) { return x > lpvg_real_t(0); }"
"""The commonest condition, one object in C++: arrays of one type share its code."""


def _condition(field: Field, fields: tuple[Field, ...], kind: str) -> str:
    """C++ lambda that tells if a number of the type ``kind`` lies within the range of its field."""
    names = {other.name for other in fields}

    def literal(end: str) -> str:
        if end in names:
            return f"f.{end}"
        text = macros(end)
        return f"lpvg_real_t({text})" if kind == "lpvg_real_t" else f"{text}U" if text.isdigit() else text

    low, low_in, high, high_in = ends_of(field.within)
    tests = [f"x {'>=' if low_in else '>'} {literal(low)}"] if kind == "lpvg_real_t" or low != "0" else []
    tests += [f"x {'<=' if high_in else '<'} {literal(high)}"] if high != "inf" else []
    capture = "&f" if {low, high} & names else ""
    return f"[{capture}]({kind} x) {{ return {' && '.join(tests)}; }}"


def _checks(layout: Layout) -> list[str]:
    stem = f"lpvg_{layout.stem}"
    sizes = " &&\n           ".join(
        f"f.sizes[{i}] == LPVG_{name}" for i, name in enumerate(layout.dimensions)
    )
    lines = [f"inline bool sizes_match(const {stem}_words_t& f) {{", f"    return {sizes};", "}", ""]
    for part, kind, fields in (("words", "uint32_t", layout.words), ("reals", "lpvg_real_t", layout.reals)):
        conditions = {f.name: _condition(f, fields, kind) for f in fields if f.within}
        joined = " &&\n           ".join(
            f"every(f.{name}, {POSITIVE if condition == POSITIVE_CONDITION else condition})"
            for name, condition in conditions.items()
        )
        shared = f"    const auto {POSITIVE} = {POSITIVE_CONDITION};"
        lines += [
            f"inline bool items_in_range(const {stem}_{part}_t& f) {{",
            *[shared] * (POSITIVE_CONDITION in conditions.values()),
            f"    return {joined};",
            "}",
            "",
        ]
    return lines


CHECKS = {
    "monitor/coefficient_checks.hpp": COEFF,
    "guard/control_checks.hpp": CONTROL,
    "services/diagnosis_checks.hpp": DIAGNOSIS,
    "services/isolation_checks.hpp": ISOLATION,
}
"""File of lib/src with the checks of a struct."""


def checks_source(file: str) -> str:
    """Text of a file of CHECKS."""
    layout, (room, name) = CHECKS[file], file.split("/")
    checks = _checks(layout)
    if layout is CONTROL:
        checks = ["#if LPVG_NK > 0", *checks[:-1], "#endif", ""]
    return "\n".join(
        [
            f"// {name} -- sizes, and the ranges of single items, of the struct of {layout.header}.",
            "// Generated by `python -m lpvguard.base.layout`, do not edit.",
            "// clang-format off",
            "#pragma once",
            "",
            f'#include "lpvguard/{layout.header}"',
            f'#include "{"" if room == "monitor" else "monitor/"}acceptance.hpp"',
            "",
            "namespace lpvguard {",
            "",
            *checks,
            "}  // namespace lpvguard",
            "",
        ]
    )


def _escaped(text: str) -> str:
    """Escape text for a cell of a table."""
    return text.replace("|", "\\|")


def manual() -> str:
    """Text of lib/COEFFICIENTS.md."""
    lines = [
        "# Coefficients of a vehicle",
        "",
        "Generated by `python -m lpvguard.base.layout` from "
        "`tools/src/lpvguard/base/layout.py`; do not edit.",
        "",
        "A coefficient struct is 32-bit words, then numbers (`lpvg_real_t`), in the order "
        "of these tables, arrays row by row. The CRC-32",
        "(ISO-HDLC) runs over the words, `crc32` read as zero, then the numbers, each least significant "
        "byte first.",
        "`lpvg_coeff_check`, `lpvg_control_coeff_check`, `lpvg_diagnosis_table_check` and "
        "`lpvg_isolation_table_check` refuse sizes",
        "other than those compiled in, numbers that are not finite, and items out of the range stated.",
        "",
        "## Dimensions",
        "",
        "Each is the macro `LPVG_<name>` of the vehicle's `lpvguard_vehicle.h`.",
        "",
        "| name | meaning |",
        "| --- | --- |",
        *(f"| {name} | {meaning} |" for name, meaning in DIMENSIONS.items()),
    ]
    lines += [
        f"| {name} | {comment[:-1]}: `{expression}` |" for name, (expression, comment) in CONSTANTS.items()
    ]
    for layout in LAYOUTS:
        lines += ["", f"## `lpvg_{layout.struct}_t` ({layout.header}), schema {layout.schema}"]
        for part in ("words", "reals"):
            lines += [
                "",
                f"`{part}`",
                "",
                "| field | size | unit | range | meaning |",
                "| --- | --- | --- | --- | --- |",
            ]
            lines += [
                f"| {f.name} | {text_of_shape(f)} | {f.unit} | {f.within} | {_escaped(f.meaning)} |"
                for f in getattr(layout, part)
            ]
    return "\n".join([*lines, ""])


def generated(library: Path) -> dict[Path, str]:
    """Path -> text of every generated file below the core's folder ``library``.

    Raises InputError when a header has lost its marks.
    """
    files = {library / "src" / file: checks_source(file) for file in CHECKS}
    files[library / "COEFFICIENTS.md"] = manual()
    for layout in LAYOUTS:
        path = library / "include" / "lpvguard" / layout.header
        text = path.read_text(encoding="utf-8")
        before, begin, rest = text.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not (begin and end):
            raise InputError(path, "", "the marks of the generated part are missing", f"{BEGIN} ... {END}")
        files[path] = before + header_block(layout) + after
    return files


def main() -> None:
    """Write the generated files of the checkout."""
    for path, text in generated(Path(__file__).resolve().parents[4] / "lib").items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
