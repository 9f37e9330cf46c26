"""The layout of the coefficients: what a vehicle's generated structs hold, stated here and nowhere else.

A coefficient struct of the core is 32-bit words, then numbers, under one CRC-32. From the tables COEFF
(model, estimator, monitor) and CONTROL (controller) come

    lib/include/lpvguard/coeff.h, controller.h   the structs, between the marks ``layout``
    lib/src/coefficient_checks.hpp               sizes and ranges that the core checks in ``lpvg_coeff_check``
    lib/COEFFICIENTS.md                          the tables for people
    core/seal.py, core/coefficients.py, core/control_coefficients.py
                                                 order, shapes and ranges of what is exported
    core/compiled.py                             names and shapes of what is read back

``python -m lpvguard.base.layout`` in a checkout writes the first three; tests/tools/base/test_layout.py fails
when they differ from the tables. What holds between items of arrays (stable sections, even frames) is checked
in coeff.cpp and said in a field's meaning. A change of the tables needs a higher ``schema`` of its struct,
and every vehicle exported again.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError

DIMENSIONS = {
    "NX": "states of the model",
    "NU": "inputs",
    "NY": "outputs",
    "DELAY": "whole samples of input delay",
    "NBINS": "frequency bins, DC first",
    "NCELLS": "speed cells of the model's table",
    "NVARYING": "entries of the model that vary with speed",
    "NWEIGHT": "sections of the filter W_delta",
    "NDIRECTIONS": "directions of the energy test's fan",
    "NBANDS": "bands of the energy test, one more than its corners",
    "NDELTA": "blocks Delta of the uncertainty: 1, common to all outputs, or NY, one an output",
    "NK": "states of one demand of the controller",
    "NM": "measurements: the reference, then the outputs",
    "NG": "nodes of the controller's speed grid",
}
"""Dimension -> meaning. LPVG_<name> in lpvguard_vehicle.h, in this order; the controller's are 0 without
one."""

CONSTANTS = {
    "NENTRIES": (
        "(NX * (NX + (2 * NU)))",
        "Entries of Ad (n x n), B_old (n x n_u) and B_new (n x n_u), row after row, one matrix after the "
        "other.",
    ),
    "NHISTORY": ("8", "Largest m of the k-of-m confirmation."),
    "NBLOCK": ("4", "Samples that a bin takes up at once, a power of two."),
    "NPARTS": (
        "(2 - (NDELTA / NY))",
        "Pushes over which the judgement of a frame is spread: 1 where every output has a Delta of its own, "
        "else 2.",
    ),
    "NLATENCY": (
        "(NBLOCK - 1 + (NBINS / 2) + (NPARTS * NBINS))",
        "Samples from the end of a frame to its judgement, at most: the block, the pushes that close several "
        "frames, and the queue.",
    ),
}
"""Sizes made of dimensions, and fixed ones: C macro LPVG_<name> of coeff.h, with its comment. Division is
that of whole numbers."""


@dataclass(frozen=True)
class Field:
    """A member of a coefficient struct.

    ``shape``: sizes, as expressions of the dimensions; () is a scalar. ``within``: the interval in which
    every item must lie, as "(0, 1]"; its ends are numbers, expressions of dimensions, or scalar fields of the
    same struct; "" allows any finite number.
    """

    name: str
    shape: tuple[str, ...]
    unit: str
    meaning: str
    within: str = ""

    @property
    def declarator(self) -> str:
        """C declarator: the name with its sizes."""
        return self.name + "".join(f"[{_macros(size)}]" for size in self.shape)


@dataclass(frozen=True)
class Layout:
    """A coefficient struct: C names ``lpvg_<stem>_words_t``, ``lpvg_<stem>_reals_t`` and ``lpvg_<struct>_t``;
    ``dimensions`` in the order of words.sizes."""

    stem: str
    struct: str
    header: str
    magic: int
    schema: int
    dimensions: tuple[str, ...]
    words: tuple[Field, ...]
    reals: tuple[Field, ...]

    def head(self, sizes: dict[str, int]) -> dict[str, Any]:
        """The words that every struct begins with, for ``sizes`` by dimension."""
        return {
            "magic": self.magic,
            "schema": self.schema,
            "real_bytes": 4,
            "sizes": [sizes[name] for name in self.dimensions],
            "crc32": 0,
        }

    def packed(
        self, part: str, values: dict[str, Any], sizes: dict[str, int], where: object
    ) -> dict[str, np.ndarray]:
        """``values`` of "words" or "reals" by field, each as an array in the shape of its field.

        The result is in the order of the struct. ``sizes``: by dimension. InputError names ``where`` and the
        field that is missing, unknown, of the wrong shape, not finite or out of its range.
        """
        fields: tuple[Field, ...] = getattr(self, part)
        names = [field.name for field in fields]
        if set(values) != set(names):
            odd = ", ".join(sorted(set(values) ^ set(names)))
            raise InputError(
                where, odd, "missing or unknown", f"the fields of {self.header}: {', '.join(names)}"
            )
        packed = {
            name: np.array(values[name]) if part == "words" else np.array(values[name], float)
            for name in names
        }
        for field in fields:
            value, shape = packed[field.name], tuple(_evaluated(size, sizes) for size in field.shape)
            if value.shape != shape:
                raise InputError(
                    where,
                    field.name,
                    f"shape {value.shape}",
                    f"{shape}, {_text_of_shape(field)} of {self.header}",
                )
            if not np.isfinite(value).all():
                raise InputError(where, field.name, "not finite", "finite numbers")
        for field in fields:
            value = packed[field.name]
            if field.within and not _within(value, field.within, sizes, packed):
                raise InputError(where, field.name, f"{value.tolist()}", f"every item within {field.within}")
        return packed

    def sizes_in(self, words: np.ndarray) -> dict[str, int]:
        """Sizes by dimension out of flat words (W,)."""
        at = next(
            i for i, field in enumerate(self.words) if field.name == "sizes"
        )  # what stands before it is scalar
        return dict(zip(self.dimensions, map(int, words[at : at + len(self.dimensions)]), strict=False))

    def split(self, part: str, flat: np.ndarray, sizes: dict[str, int]) -> dict[str, np.ndarray]:
        """Views of flat "words" or "reals" by field, each in its shape; a scalar as (1,)."""
        shapes = {
            field.name: tuple(_evaluated(size, sizes) for size in field.shape) or (1,)
            for field in getattr(self, part)
        }
        ends = np.cumsum([math.prod(shape) for shape in shapes.values()])
        assert ends[-1] == len(flat), f"{self.header}: {ends[-1]} items by the layout, {len(flat)} given"
        return {
            name: items.reshape(shape)
            for (name, shape), items in zip(shapes.items(), np.split(flat, ends[:-1]), strict=False)
        }

    @cached_property
    def macro(self) -> str:
        """Beginning of the names of the struct's C macros."""
        return f"LPVG_{self.stem.upper()}"


def _head(macro: str, dimensions: tuple[str, ...]) -> tuple[Field, ...]:
    return (
        Field("magic", (), "", f"{macro}_MAGIC"),
        Field("schema", (), "", f"{macro}_SCHEMA"),
        Field("real_bytes", (), "", "sizeof(lpvg_real_t)"),
        Field("sizes", (str(len(dimensions)),), "", "LPVG_" + ", ".join(dimensions)),
    )


_COEFF_DIMENSIONS = tuple(DIMENSIONS)[:11]
COEFF = Layout(
    stem="coeff",
    struct="coeff",
    header="coeff.h",
    magic=0x4C505647,
    schema=5,
    dimensions=_COEFF_DIMENSIONS,
    words=(
        *_head("LPVG_COEFF", _COEFF_DIMENSIONS),
        Field(
            "estimator_id", (), "", "LPVG_ESTIMATOR_ID: definition of the frames the bounds were made with"
        ),
        Field("crc32", (), "", "over all words and numbers"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
        Field("settle_samples", (), "samples", "time in range before frames may begin"),
        Field("confirm", (), "", "k of the k-of-m confirmation", "[1, of_last]"),
        Field("of_last", (), "", "m of the k-of-m confirmation", "[0, NHISTORY]"),
        Field(
            "energy_settle",
            (),
            "samples",
            "time in range before the left sum of the energy test grows",
            "[settle_samples, inf)",
        ),
        Field(
            "energy_rearm",
            (),
            "",
            "judgements without an exceedance after which the next one is an alarm anew",
            "[1, inf)",
        ),
        Field(
            "change_rearm",
            (),
            "",
            "judgements of the change test without an exceedance after which the next one is an alarm anew",
            "[1, inf)",
        ),
        Field(
            "frame_length",
            ("NBINS",),
            "samples",
            "length of a frame: even, none longer than DC's; half exceeds LPVG_NLATENCY",
        ),
        Field("cycles", ("NBINS",), "", "periods a frame, 0 at DC, fewer than half its samples"),
        Field(
            "varying_entry",
            ("NVARYING",),
            "",
            "which of the LPVG_NENTRIES entries move with speed",
            "[0, NENTRIES)",
        ),
    ),
    reals=(
        Field("speed_min", (), "m/s", "scheduling range", "(0, speed_max)"),
        Field("speed_max", (), "m/s", "scheduling range"),
        Field("speed_valid", ("2",), "m/s", "physical range of the signal"),
        Field("input_valid", ("NU", "2"), "input unit", "physical range"),
        Field("output_valid", ("NY", "2"), "output unit", "physical range"),
        Field("speed_tolerance", (), "-", "largest |v/mean - 1| in a frame", "(0, inf)"),
        Field("input_offset", ("NU",), "input unit", "subtracted from the input"),
        Field("output_offset", ("NY",), "output unit", "added to the output"),
        Field("base", ("NENTRIES",), "", "model entries that do not vary with speed"),
        Field("cell", ("NCELLS", "NVARYING", "4"), "", "cubic in the position 0..1 within a speed cell"),
        Field("C", ("NY", "NX"), "", "output matrix"),
        Field("C_pinv", ("NX", "NY"), "", "its pseudo-inverse: state of a measured output"),
        Field("turn", ("NBINS", "2"), "-", "cos - 1 and sin of the phase step 2 pi cycles / N"),
        Field("taper", ("NBINS", "2"), "-", "cos - 1 and sin of the window step 2 pi / N"),
        Field("scale", ("NBINS",), "-", "2 / sum(window), at DC 1 / sum(window)", "(0, inf)"),
        Field(
            "energy_corner",
            ("NBANDS - 1",),
            "-",
            "g of the low-pass g (z + 1) / (z - 1 + 2 g) at each corner, not falling",
            "(0, 1)",
        ),
        Field(
            "energy_W",
            ("NDELTA", "NWEIGHT", "5"),
            "-",
            "sections of W_delta on |z| = rho, b0 b1 b2 a1 a2, stable (energy.cpp)",
        ),
        Field("energy_above", ("NDELTA",), "-", "what stands for W_delta above the last corner", "(0, inf)"),
        Field("energy_scale", ("NBANDS", "NY"), "1/output unit", "1 / sigma_j of each band", "(0, inf)"),
        Field("energy_forget", ("NBANDS",), "-", "1 - rho^2, rho of the band", "(0, 1)"),
        Field("energy_start", ("NBANDS", "NY"), "output unit squared", "right sum at rest", "[0, inf)"),
        Field(
            "energy_direction",
            ("NDIRECTIONS", "NY"),
            "-",
            "a, in units of sigma, sum |a_j| = 1; of a single output where NDELTA > 1",
        ),
        Field("energy_threshold", (), "-", "calibrated threshold of the energy test's ratio", "[1, inf)"),
        Field("change_block_s", (), "s", "a block of LPVG_NBLOCK samples", "(0, inf)"),
        Field(
            "change_unit",
            ("NY", "2"),
            "1/output unit",
            "1 / rms of yhat_j, and of its change over a block, on the bound-setting drives",
            "(0, inf)",
        ),
        Field(
            "change_prior",
            ("NY", "6"),
            "-",
            "what is added to the sums of phi phi', the upper triangle row by row, positive definite",
        ),
        Field(
            "change_scale",
            ("NY", "3"),
            "1/output unit",
            "1 / largest |theta_i| on the bound-setting drives, theta by regressors over their sizes",
            "(0, inf)",
        ),
        Field("change_forget", (), "-", "share of the sums forgotten with a block", "(0, 1)"),
        Field("change_threshold", (), "-", "calibrated threshold of the change test's ratio", "(0, inf)"),
        Field("W_delta", ("NBINS", "NDELTA"), "-", "|W_delta| at the bin", "(0, inf)"),
        Field("B_w", ("NBINS", "NY"), "output unit", "disturbance bound at the bin", "(0, inf)"),
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
        *_head("LPVG_CONTROL", _CONTROL_DIMENSIONS),
        Field("crc32", (), "", "over all words and numbers, as in coeff.h"),
        Field("sample_period_us", (), "us", "Ts", "[1, inf)"),
    ),
    reals=(
        Field("speed_min", (), "m/s", "first node", "(0, speed_max)"),
        Field("speed_max", (), "m/s", "last node"),
        Field("u_max", ("NG", "NU"), "input unit", "largest |demand| at every node", "(0, inf)"),
        Field("rate_max", ("NU",), "input unit/s", "largest |change of demand|", "(0, inf)"),
        Field("A1", ("NK",), "-", "a, a' of every pair, a of a single state"),
        Field("engage", ("NK", "2"), "-", "change of x for what v misses, and for its drift"),
        Field("BL", ("NG", "NU", "NK", "NM + NU"), "", "rows of B, then of L"),
    ),
)


# --- expressions and intervals ---


def _macros(expression: str) -> str:
    """An expression of dimensions in C."""
    return re.sub(r"\b([A-Z]+)\b", r"LPVG_\1", expression)


def constant(name: str, sizes: dict[str, int]) -> int:
    """Value of one of CONSTANTS for the dimensions that it depends on."""
    return _evaluated(CONSTANTS[name][0], sizes)


def _evaluated(expression: str, sizes: dict[str, int]) -> int:
    known = dict(sizes)
    for name in CONSTANTS:
        if name in expression:
            known[name] = constant(name, sizes)
    return eval(expression.replace("/", "//"), {"__builtins__": {}}, known)


def _ends(interval: str) -> tuple[str, bool, str, bool]:
    """Lower end, whether it belongs to the interval, upper end, likewise."""
    low, high = (end.strip() for end in interval[1:-1].split(","))
    return low, interval[0] == "[", high, interval[-1] == "]"


def _within(value: np.ndarray, interval: str, sizes: dict[str, int], packed: dict[str, np.ndarray]) -> bool:
    def number(end: str) -> float:
        return float(packed[end]) if end in packed else math.inf if end == "inf" else _evaluated(end, sizes)

    low, low_in, high, high_in = _ends(interval)
    above = value >= number(low) if low_in else value > number(low)
    below = value <= number(high) if high_in else value < number(high)
    return bool((above & below).all())


def _text_of_shape(field: Field) -> str:
    return " × ".join(field.shape) or "scalar"


# --- what is generated ---

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
    """The generated part of the struct's header."""
    lines = [
        BEGIN,
        f"#define {layout.macro}_MAGIC 0x{layout.magic:08X}U",
        f"#define {layout.macro}_SCHEMA {layout.schema}U",
    ]
    for name, (expression, comment) in CONSTANTS.items():
        if layout is COEFF:
            lines += [f"/// {comment}", f"#define LPVG_{name} {_macros(expression)}"]
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


def _condition(field: Field, fields: tuple[Field, ...], kind: str) -> str:
    names = {other.name for other in fields}

    def literal(end: str) -> str:
        if end in names:
            return f"f.{end}"
        text = _macros(end)
        return f"lpvg_real_t({text})" if kind == "lpvg_real_t" else f"{text}U" if text.isdigit() else text

    low, low_in, high, high_in = _ends(field.within)
    tests = [f"x {'>=' if low_in else '>'} {literal(low)}"] if kind == "lpvg_real_t" or low != "0" else []
    tests += [f"x {'<=' if high_in else '<'} {literal(high)}"] if high != "inf" else []
    capture = "&f" if {low, high} & names else ""
    return f"every(f.{field.name}, [{capture}]({kind} x) {{ return {' && '.join(tests)}; }})"


def _checks(layout: Layout) -> list[str]:
    stem = f"lpvg_{layout.stem}"
    sizes = " &&\n           ".join(
        f"f.sizes[{i}] == LPVG_{name}" for i, name in enumerate(layout.dimensions)
    )
    lines = [f"inline bool sizes_match(const {stem}_words_t& f) {{", f"    return {sizes};", "}", ""]
    for part, kind, fields in (("words", "uint32_t", layout.words), ("reals", "lpvg_real_t", layout.reals)):
        conditions = [_condition(field, fields, kind) for field in fields if field.within]
        joined = " &&\n           ".join(conditions)
        lines += [
            f"inline bool items_in_range(const {stem}_{part}_t& f) {{",
            f"    return {joined};",
            "}",
            "",
        ]
    return lines


def checks_source() -> str:
    """Text of lib/src/coefficient_checks.hpp."""
    return "\n".join(
        [
            "// coefficient_checks.hpp -- sizes, and the ranges of single items, of the coefficient structs.",
            "// Generated by `python -m lpvguard.base.layout`, do not edit.",
            "// clang-format off",
            "#pragma once",
            "",
            '#include "acceptance.hpp"',
            '#include "lpvguard/coeff.h"',
            '#include "lpvguard/controller.h"',
            "",
            "namespace lpvguard {",
            "",
            *_checks(COEFF),
            "#if LPVG_NK > 0",
            *_checks(CONTROL)[:-1],
            "#endif",
            "",
            "}  // namespace lpvguard",
            "",
        ]
    )


def _escaped(text: str) -> str:
    """Text for a cell of a table."""
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
        "`lpvg_coeff_check` and `lpvg_control_coeff_check` refuse sizes other than those compiled in, "
        "numbers that are not finite, and items",
        "out of the range stated.",
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
    for layout in (COEFF, CONTROL):
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
                f"| {f.name} | {_text_of_shape(f)} | {f.unit} | {f.within} | {_escaped(f.meaning)} |"
                for f in getattr(layout, part)
            ]
    return "\n".join([*lines, ""])


def generated(library: Path) -> dict[Path, str]:
    """Path -> text of every file that follows from the tables, below the core's folder ``library``.
    InputError where a header has lost its marks."""
    files = {
        library / "src" / "coefficient_checks.hpp": checks_source(),
        library / "COEFFICIENTS.md": manual(),
    }
    for layout in (COEFF, CONTROL):
        path = library / "include" / "lpvguard" / layout.header
        text = path.read_text(encoding="utf-8")
        before, begin, rest = text.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not (begin and end):
            raise InputError(path, "", "the marks of the generated part are missing", f"{BEGIN} ... {END}")
        files[path] = before + header_block(layout) + after
    return files


def main() -> None:
    """Writes the generated files of the checkout."""
    for path, text in generated(Path(__file__).resolve().parents[4] / "lib").items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
