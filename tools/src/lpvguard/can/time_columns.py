"""Find a table's time column by its name and values: s, ms, us, ns, since an epoch, or date and time."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from ..base.errors import InputError, InputWarning
from .text_tables import STRAY

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_STATED_NS = {**UNITS_NS, "min": 60 * 10**9, "h": 3600 * 10**9}
"""Units that a name or the log states."""
_SPELLED = {
    "s": "s sec secs second seconds sek sekunden",
    "ms": "ms msec millis millisecond milliseconds millisekunden",
    "us": "us µs μs usec micros microsecond microseconds mikrosekunden",
    "ns": "ns nsec nanos nanosecond nanoseconds nanosekunden",
    "min": "min minute minutes minuten",
    "h": "h hour hours stunden",
}
_UNIT_OF = {word: unit for unit, words in _SPELLED.items() for word in words.split()}
_NAMES = (
    r"^(t|times?|timestamps?|time_stamp|zeit|ts|zeitstempel|temps|tiempo|tempo|tijd|czas|tid|时间)$",
    r"(^|_)(times?|timestamps?|stamp|zeit|zeitstempel|epoch|datetime|date_time|datum|uhrzeit|elapsed|t|temps|"
    r"tiempo|tempo|tijd|czas|时间)(_|$)",
)
_SECONDS, _NANOSECONDS = r"(^|_)(secs?|seconds)$", r"(^|_)(nsecs?|nanosecs?|nanoseconds)$"
_CLOCKS = ("gmt", "utc", "unix", "posix")
_EPOCH_S = (9.0e8, 4.0e9)
"""Range of seconds since 1970 for the years 1998 to 2096."""
_STEP_S = (2e-4, 0.6)
"""Range of the steps [s] from sample to sample of a driving log."""
_LATEST_S = 9_000_000_000
_DAYS = ((3.0e4, 6.0e4, 25_569), (7.0e5, 8.0e5, 719_529))
"""Day counts of spreadsheets and of MATLAB: the range for the years 1982 to 2064, and the count of 1970."""
_LEAP = 39.0
"""Digits of a clock jump by more than this value from minute to minute."""
_BACK = 0.2
"""Largest share of steps between rows that may go back in a time column."""
_MONTHS = ("jan", "feb", "m[aä]r", "apr", "ma[iy]", "jun", "jul", "aug", "sep", "o[ck]t", "nov", "de[cz]")
_DATE = (
    r"(?P<y>\d{4})([-/.]?)(?P<m>\d{2})\2(?P<d>\d{2})|"
    r"(?P<d2>\d{1,2})[-/. ](?P<m2>\d{1,2}|[^\W\d]{3,9})[-/. ](?P<y2>(?:20)?\d{2})"
)
_CLOCK = (
    r"(?P<h>\d{1,2})(?P<by>[:-]?)(?P<min>\d{2})(?P=by)(?P<s>\d{2})(?:(?:[.,:-]|(?<=\d{6}))(?P<rest>\d+))?"
)
_DATE_ONLY = re.compile(_DATE)
_DATE_AND_CLOCK = re.compile(
    rf"(?:{_DATE})[T _-]+{_CLOCK}\s*(?P<half>[AP]M)?\s*(?P<zone>[A-Z]{{1,5}}|[+-]\d{{2}}:?\d{{2}})?",
    re.IGNORECASE,
)
_TIME_OF_DAY = re.compile(r"(?:(\d{1,5}) days?,? )?(\d{1,2}):(\d{1,2}):(\d{1,2})(?:[.,:](\d+))?")
_ELAPSED = re.compile(r"(\d{1,3}):(\d{2})[.,](\d+)")
"""Minutes, seconds and parts of a second."""
_OF_LOGGER = re.compile(r"(?:\d{2})?(\d{2})?T(\d{2})(\d{2})(\d{2})(\d+)")
"""Month, day, and the digits of a clock to ms, as a logger of CSS writes them."""


def time_of(
    table: pa.Table, units: Mapping[str, str], path: Path, first_line: int, named: str | None
) -> tuple[np.ndarray, np.ndarray, set[str]]:
    """Times (K,) [ns] of the rows, mask (N,) of the rows with a time, and names of the time columns.

    ``named`` is the column that the user named. ``units`` holds the unit by column if the log states units.
    Raises InputError if there is no time column, if its unit is unknown, or if too many rows (STRAY) have no
    time.
    """
    names = table.column_names
    if named is None and (pair := _pair(names)):
        seconds, nanoseconds = (_plain(table, n) for n in pair)
        bad = ~np.isfinite(seconds) | ~np.isfinite(nanoseconds) | (np.abs(seconds) > _LATEST_S)
        keep = _usable(bad, seconds, path, pair[0], first_line)
        t_ns = seconds[keep].astype(np.int64) * 10**9 + np.rint(nanoseconds[keep]).astype(np.int64)
        return t_ns, keep, set(pair)
    column = named or _by_name(table) or _by_values(table, path)
    if column is None or column not in names:
        raise InputError(
            path,
            "header",
            f"no time column{f' {column}' if column else ''}",
            "one of t, time, timestamp, or --time NAME, or --rate HZ where rows come at one rate (`time` and "
            "`rate_hz` in the signal map); there are " + ", ".join(names),
        )
    values = table.column(column)
    if pa.types.is_duration(values.type):
        whole = values.cast(pa.duration("ns")).cast(pa.int64())
        table = table.set_column(names.index(column), column, whole)
        values, units = table.column(column), {**units, column: "ns"}
    if pa.types.is_timestamp(values.type) or pa.types.is_time(values.type):
        values = values.cast(pa.string())
    if pa.types.is_string(values.type) or pa.types.is_large_string(values.type):
        texts, clock = values.to_pylist(), None
        if _DATE_ONLY.fullmatch(next((text.strip() for text in texts if text), "")):
            clock = next((n for n in names if _is_text(table, n) and _is_clock(table, n)), None)
            if clock:
                texts = [
                    f"{day} {time}" for day, time in zip(texts, table.column(clock).to_pylist(), strict=True)
                ]
        t_ns, bad = times_of_texts(texts)
        keep = _usable(bad, texts, path, column, first_line)
        return _growing(t_ns[keep], path, column), keep, {column, clock or column}
    t = _plain(table, column)
    made = _since_1970(t, path, column) or _of_clock(t, path, column)
    t, unit = made or (t, unit_of_time(column, units) or _by_shape(t, path, column))
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(t) <= _LATEST_S * 1e9 / _STATED_NS[unit])
    keep = _usable(bad, t, path, column, first_line)
    kind = table.schema.field(column).type
    if pa.types.is_integer(kind) and made is None:
        t_ns = table.column(column).filter(keep).cast(pa.int64()).to_numpy() * _STATED_NS[unit]
    else:
        t_ns = np.rint(t[keep] * _STATED_NS[unit]).astype(np.int64)
    return _growing(t_ns, path, column), keep, {column}


def _growing(t_ns: np.ndarray, path: Path, column: str) -> np.ndarray:
    """Return the times; raise InputError if they do not increase from row to row."""
    step = np.diff(t_ns)
    if len(step) > 2 and (np.mean(step < 0) > _BACK or not (step > 0).any()):
        what = f"{np.mean(step < 0):.0%} of its steps go back" if (step < 0).any() else "it never grows"
        expected = "the time of each row, or --time NAME, or --rate HZ where rows come at one rate"
        raise InputError(path, f"column {column}", what, expected)
    return t_ns


def _since_1970(t: np.ndarray, path: Path, column: str) -> tuple[np.ndarray, str] | None:
    """Convert the day counts of spreadsheets and MATLAB to times [s]; None for other values."""
    known = t[np.isfinite(t)]
    size, step = (float(np.median(np.abs(x))) if len(x) else 0.0 for x in (known, np.diff(known)))
    for least, most, epoch in _DAYS:
        if least <= size <= most and _STEP_S[0] <= step * 86_400 <= _STEP_S[1]:
            what = f"taken to be in days, of which 1970 begins with {epoch}: its size says so"
            warnings.warn(f"{path}: column {column} is {what}", InputWarning, stacklevel=1)
            return (t - epoch) * 86_400, "s"
    return None


def _of_clock(t: np.ndarray, path: Path, column: str) -> tuple[np.ndarray, str] | None:
    """Convert the digits of a clock, 125959.98 for 12:59:59.98, to times [s]; None for other values.

    Within a minute, digits and seconds increase equally. From minute to minute, the digits increase by 40
    more.
    """
    for scale in (1.0, 1e-3):
        digits = t[np.isfinite(t)] * scale
        seconds, minutes = digits % 100, digits // 100 % 100
        leaps = np.abs(np.diff(digits)) > _LEAP
        if not leaps.any() or digits.min() < 0 or digits.max() >= 240_000:
            continue
        if (seconds >= 60).any() or (minutes >= 60).any():
            continue
        read = np.full(len(t), np.nan)
        read[np.isfinite(t)] = _seconds_of_day(digits)
        steps = np.diff(read[np.isfinite(t)])
        if np.median(steps[leaps]) <= max(1.0, 5 * float(np.median(steps))):
            what = f"taken to be the digits of a clock, HHMMSS{'' if scale == 1.0 else 'mmm'}"
            why = "they leap from minute to minute"
            warnings.warn(f"{path}: column {column} is {what}: {why}", InputWarning, stacklevel=1)
            return read, "s"
    return None


def _seconds_of_day(digits: np.ndarray) -> np.ndarray:
    """Convert HHMMSS to times [s]; a new day begins at midnight."""
    read = digits // 10_000 * 3600 + digits // 100 % 100 * 60 + digits % 100
    return read + 86_400 * np.cumsum(np.diff(read, prepend=read[0]) < -12 * 3600)


def _is_clock(table: pa.Table, name: str) -> bool:
    """Tell if a text column begins with a time of day."""
    return (
        _TIME_OF_DAY.fullmatch(next((t.strip() for t in table.column(name).to_pylist() if t), "")) is not None
    )


def _usable(
    bad: np.ndarray, t: Sequence[object] | np.ndarray, path: Path, column: str, first_line: int
) -> np.ndarray:
    """Mask (N,) of the rows with a time; raise InputError if a share of more than STRAY has none."""
    at = np.flatnonzero(bad)
    if len(at) == 0:
        return ~bad
    value = t[at[0]]
    what = "no time"
    if isinstance(value, str):
        what = f"{value!r} is no time"
    elif isinstance(value, float) and not np.isnan(value):
        what = f"a time of {value:g} s"
    where = f"line {at[0] + first_line}, column {column}"
    if len(at) > STRAY * len(bad):
        raise InputError(
            path,
            where,
            what,
            f"a time with seconds in every line, at most {_LATEST_S:g} s, as 2026-04-22T03:45:00.123 or "
            "03:45:00.123",
        )
    warnings.warn(f"{path}: {where}: {what}; {len(at)} such row(s) left out", InputWarning, stacklevel=1)
    return ~bad


def _plain(table: pa.Table, column: str) -> np.ndarray:
    try:
        return table.column(column).cast(pa.float64()).fill_null(np.nan).to_numpy()
    except pa.ArrowException:
        return np.full(table.num_rows, np.nan)


def _low(name: str) -> str:
    """Name in lower case, without brackets, with words joined by _."""
    plain = re.sub(r"[\[({].*?[\])}]", "", name)
    return re.sub(r"[\W_]+", "_", re.sub(r"([a-z])([A-Z])", r"\1_\2", plain).lower()).strip("_")


def _pair(names: list[str]) -> tuple[str, str] | None:
    """Columns of seconds and nanoseconds of a ROS time stamp."""
    low = {name: _low(name) for name in names}
    for name in names:
        if re.search(_SECONDS, low[name]) and not re.search(_NANOSECONDS, low[name]):
            stem = re.sub(_SECONDS, "", low[name])
            for other in names:
                if re.search(_NANOSECONDS, low[other]) and re.sub(_NANOSECONDS, "", low[other]) == stem:
                    return name, other
    return None


def _by_name(table: pa.Table) -> str | None:
    """Column with a name for time; if there are several, one whose values increase."""
    names = table.column_names
    without_unit = {n: "_".join(w for w in _low(n).split("_") if w not in _UNIT_OF) for n in names}
    for pattern in _NAMES:
        matches = [n for n in names if re.search(pattern, without_unit[n])]
        grows = [n for n in matches if _tells_time(table, n) or _grows(_plain(table, n))]
        if matches:
            return (grows or matches)[0]
    bare = [n for n in names if _low(n) in (*_UNIT_OF, "interval") or without_unit[n] in _CLOCKS]
    return next((n for n in bare if _tells_time(table, n) or _grows(_plain(table, n))), None)


def _by_values(table: pa.Table, path: Path) -> str | None:
    """The one column, by whatever name, whose texts are dates with time or whose numbers count from 1970."""
    telling = [n for n in table.column_names if _tells_time(table, n) or _is_epoch(_plain(table, n))]
    if len(telling) != 1:
        return None
    what = f"column {telling[0]} is taken for the time: its values say so"
    warnings.warn(f"{path}: {what}", InputWarning, stacklevel=1)
    return telling[0]


def _is_epoch(t: np.ndarray) -> bool:
    """Tell if numbers grow and are as large as the time since 1970 in one of the units."""
    size = float(np.nanmedian(t)) if np.isfinite(t).any() else 0.0
    return _grows(t) and any(_EPOCH_S[0] <= size * ns / 1e9 <= _EPOCH_S[1] for ns in UNITS_NS.values())


def _tells_time(table: pa.Table, name: str) -> bool:
    """Return whether a column is of times, or its first text is a time or a date."""
    kind = table.schema.field(name).type
    if pa.types.is_temporal(kind) or not _is_text(table, name):
        return pa.types.is_temporal(kind)
    first = next((text.strip() for text in table.column(name).to_pylist() if text), "")
    try:
        return _DATE_ONLY.fullmatch(first) is not None or _parsed(first) is not None
    except ValueError:
        return False


def _is_text(table: pa.Table, name: str) -> bool:
    kind = table.schema.field(name).type
    return not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))


def _grows(t: np.ndarray) -> bool:
    step = np.diff(t[np.isfinite(t)])
    return len(step) > 0 and bool(np.mean(step >= 0) > 0.9 and step.max() > 0)


def unit_of_time(name: str, units: Mapping[str, str]) -> str | None:
    """Find the unit of times that the log or the name states: in brackets, or as the last word.

    ``units`` holds the units that the log states, by name.
    """
    texts = [units.get(name, ""), *re.findall(r"[\[({](.*?)[\])}]", name)]
    for text in texts:
        if unit := _UNIT_OF.get(text.strip().lower()):
            return unit
    words = _low(name.replace("µ", "u").replace("μ", "u")).split("_")
    return _UNIT_OF.get(words[-1]) if words and (len(words) > 1 or words[-1] != "s") else None


def _by_shape(t: np.ndarray, path: Path, column: str) -> str:
    """Unit of times without a stated unit: found from the size of epoch times, otherwise from the step."""
    t = t[np.isfinite(t)]
    if len(t) < 3:
        return "s"
    size, step = float(np.median(np.abs(t))), float(np.median(np.abs(np.diff(t))))
    since = [u for u, ns in UNITS_NS.items() if _EPOCH_S[0] <= size * ns / 1e9 <= _EPOCH_S[1]]
    fitting = [u for u, ns in UNITS_NS.items() if _STEP_S[0] <= step * ns / 1e9 <= _STEP_S[1]]
    whole = bool(np.all(t == np.rint(t)))
    if since and since[0] != "s" and (since[0] in fitting or step == 0):
        unit = since[0]
    elif not whole or "s" in fitting or step < 1:
        return "s"
    elif step <= 1.5:
        raise InputError(
            path,
            f"column {column}",
            f"its steps of {step:g} are a second, or a thousandth",
            "its unit in its name or in a row of units, as time [ms]",
        )
    elif fitting:
        unit = fitting[0]
    else:
        return "s"
    why = "its size is that of a date" if since else f"its steps are {step:g}"
    warnings.warn(f"{path}: column {column} is taken to be in {unit}: {why}", InputWarning, stacklevel=1)
    return unit


def times_of_texts(texts: list[str | None]) -> tuple[np.ndarray, np.ndarray]:
    """Read dates with time of day, or times of day, of which midnight begins another day.

    Returns the times (N,) [ns], and which of the texts (N,) are none.
    """
    times, bad = np.zeros(len(texts), np.int64), np.zeros(len(texts), bool)
    day, before = 0, -1
    for row, text in enumerate(texts):
        try:
            ns, of_day = _parsed(text or "")
        except ValueError:
            bad[row] = True
            continue
        if of_day and before - ns > 12 * 3600 * 10**9:
            day += 1
        before = ns
        times[row] = ns + day * 86_400 * 10**9
    return times, bad


def _parsed(text: str) -> tuple[int, bool]:
    """Time [ns] of a text (UTC without a zone), and if it is a time of day; ValueError without a time."""
    text = text.strip()
    if match := _TIME_OF_DAY.fullmatch(text):
        days, *clock = match.groups()
        return int(days or 0) * 86_400 * 10**9 + _clock_ns(*clock), days is None
    if match := _OF_LOGGER.fullmatch(text):
        days, *clock = match.groups()
        return int(days or 0) * 86_400 * 10**9 + _clock_ns(*clock), days is None
    if match := _ELAPSED.fullmatch(text):
        minutes, seconds, rest = match.groups()
        return int(minutes) * 60 * 10**9 + _clock_ns("0", "0", seconds, rest), False
    match = _DATE_AND_CLOCK.fullmatch(text)
    if match is None:
        raise ValueError(text)
    part = match.groupdict()
    days = np.datetime64(_iso_date(part), "D").astype(np.int64)
    ns = int(days) * 86_400 * 10**9 + _clock_ns(part["h"], part["min"], part["s"], part["rest"])
    if half := (part["half"] or "").upper():
        ns += 12 * 3600 * 10**9 * ((half == "PM") - (int(part["h"]) == 12))
    zone = part["zone"] or ""
    if zone[:1] in ("+", "-"):
        offset = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        ns -= (offset if zone[0] == "+" else -offset) * 10**9
    return ns, False


def _iso_date(part: Mapping[str, str | None]) -> str:
    """The date of a text in ISO 8601; of 04/22/2026 the month is the part that may be one."""
    year = f"20{part['y'] or part['y2']}"[-4:]
    month, day = part["m"] or part["m2"] or "", part["d"] or part["d2"]
    if not month.isdigit():
        month = next((str(k) for k, name in enumerate(_MONTHS, 1) if re.match(name, month.lower())), "")
    if month.isdigit() and int(month) > 12:
        month, day = day or "", month
    return f"{year}-{int(month):02d}-{int(day or 0):02d}"


def _clock_ns(hours: str, minutes: str, seconds: str, rest: str | None) -> int:
    if int(hours) > 24 or int(minutes) > 59 or int(seconds) > 60:
        raise ValueError(f"{hours}:{minutes}:{seconds}")
    whole = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
    return whole * 10**9 + int((rest or "0")[:9].ljust(9, "0"))
