"""Spreadsheets are read as text tables: header, row of units, times and numbers."""

import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.logs import logs_among, read_log

ROWS = [
    ["Zeit", "Geschwindigkeit", "Lenkradwinkel", "Gierrate"],
    ["s", "km/h", "Grad", "Grad/s"],
    *([0.02 * k, 50.0 + k, -3.5, 0.25] for k in range(30)),
]


def write_sheet(path: Path, sheets: list[list[list[str | float]]]) -> Path:
    """A workbook in the least form of Office Open XML."""
    head, names = '<?xml version="1.0"?>', [f"s{k + 1}" for k in range(len(sheets))]
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    links = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    word = "application/vnd.openxmlformats-officedocument.spreadsheetml"

    def cell(value: str | float) -> str:
        text = isinstance(value, str)
        return f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>' if text else f"<c><v>{value:g}</v></c>"

    def sheet(rows: list[list[str | float]]) -> str:
        lines = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
        return f'{head}<worksheet xmlns="{main}"><sheetData>{lines}</sheetData></worksheet>'

    def related(entries: str) -> str:
        return f'{head}<Relationships xmlns="{package}/relationships">{entries}</Relationships>'

    parts = {
        "[Content_Types].xml": f'{head}<Types xmlns="{package}/content-types">'
        f'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Default Extension="xml" ContentType="{word}.worksheet+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{word}.sheet.main+xml"/></Types>',
        "_rels/.rels": related(
            f'<Relationship Id="b" Type="{links}/officeDocument" Target="xl/workbook.xml"/>'
        ),
        "xl/workbook.xml": f'{head}<workbook xmlns="{main}" xmlns:r="{links}"><sheets>'
        + "".join(f'<sheet name="{n}" sheetId="{k + 1}" r:id="{n}"/>' for k, n in enumerate(names))
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": related(
            "".join(f'<Relationship Id="{n}" Type="{links}/worksheet" Target="{n}.xml"/>' for n in names)
        ),
        **{f"xl/{n}.xml": sheet(rows) for n, rows in zip(names, sheets, strict=True)},
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return path


def test_the_longest_sheet_is_the_table(tmp_path):
    path = write_sheet(tmp_path / "a.xlsx", [[["a note", 1.0]], ROWS])
    assert logs_among([tmp_path]) == [path]
    table = read_log(path)
    assert {n: s.unit for n, s in table.series.items()} == dict(zip(ROWS[0][1:], ROWS[1][1:], strict=True))
    speed = table.series["Geschwindigkeit"]
    assert speed.value[3] == 53.0 and np.array_equal(np.diff(speed.t_ns), np.full(29, 20_000_000))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no zip", b"time,speed\n0,1\n"])
def test_what_is_no_spreadsheet_is_refused(tmp_path, content):
    (tmp_path / "a.xlsx").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.xlsx: cannot be read .*; expected a whole spreadsheet"):
        read_log(tmp_path / "a.xlsx")
