"""The schemas describe what is written and read: real files, the examples, and a page that says the same."""

import copy
import json
import re

import jsonschema
import pytest

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.can.dbc import dbc_text
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.ingest import ingest
from lpvguard.evaluate.evaluation import evaluate
from lpvguard.extras.loop.sim import load_scenario
from lpvguard.extras.problems.solve import solve_problems
from lpvguard.identify import identification as identify
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import EvaluationSettings
from made import ROOT

ANNOTATIONS = {"unit", "shape"}
LOOSE = {"manifest", "problems", "answers"}
"""Formats with fields of others: hashes of folders; fields by kind of problem."""


def errors(name: str, value) -> list[str]:
    value = json.loads(artefacts.to_json(value))
    return [
        f"{list(e.absolute_path)}: {e.message}"
        for e in jsonschema.Draft202012Validator(schemas.schema(name)).iter_errors(value)
    ]


@pytest.mark.parametrize("name", schemas.names())
def test_a_schema_is_one_and_describes_every_field(name):
    schema = schemas.schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)

    def visit(node: dict, where: str) -> None:
        for field, value in node.get("properties", {}).items():
            assert "$ref" in value or value.get("description"), f"{where}.{field}"
            visit(value, f"{where}.{field}")
        for key in ("items", "additionalProperties"):
            if isinstance(node.get(key), dict):
                visit(node[key], where + "[]")

    for part, node in [("", schema), *schema.get("$defs", {}).items()]:
        visit(node, part)


@pytest.mark.parametrize("name", schemas.names())
def test_an_example_is_accepted_and_an_unknown_or_missing_field_is_not(name):
    example = schemas.example(name)
    assert errors(name, example) == []

    def item(value) -> dict:
        return value[0] if isinstance(value, list) else value

    if name not in LOOSE:
        unknown = copy.deepcopy(example)
        item(unknown)["no_such_field"] = 1
        assert any("no_such_field" in e for e in errors(name, unknown))
    schema = schemas.schema(name)
    for field in (schema.get("items", schema))["required"]:
        missing = copy.deepcopy(example)
        del item(missing)[field]
        assert any(f"'{field}' is a required property" in e for e in errors(name, missing)), field


@pytest.mark.parametrize(
    "file",
    [
        "bounds",
        "front",
        "model_error",
        "weights",
        "calibration",
        "energy",
        "change",
        "pools",
        "visibility",
        "MANIFEST",
    ],
)
def test_an_identification_is_as_described(identified, vehicle, file):
    assert errors(file.lower(), json.loads((identified / f"{file}.json").read_text())) == []
    if file == "MANIFEST":
        assert errors("manifest", json.loads((vehicle / "MANIFEST.json").read_text())) == []


@pytest.mark.long("10 s: an identification and its evaluation")
def test_a_replay_with_alarms_and_an_evaluation_are_as_described(
    g80, synthetic, identified, core, few_baselines
):
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    faulty = inject(drives.load("synthetic_06")[0], Fault("gain", 0.3), 60.0, g80.Ts_s)
    replayed = Replayer(g80, core).replay(faulty).to_dict()
    assert {a["test"] for a in replayed["alarms"]} == {"frame", "energy", "change"}
    assert errors("replay", [replayed]) == []
    once = EvaluationSettings(bias=0.05, starts=1)
    assert errors("evaluate", evaluate(identify.load(identified), drives, core, settings=once)) == []


def test_a_report_of_ingest_is_as_described(tmp_path):
    (tmp_path / "bus.dbc").write_text(dbc_text())
    (tmp_path / "map.toml").write_text(
        'schema = 1\nTs_s = 0.1\n[columns.v]\nunit = "m/s"\nsignal = "v"\nscale = 1.0\n'
    )
    (tmp_path / "log.csv").write_text("t,v\n" + "".join(f"{i / 10},{i}\n" for i in range(30)))
    for report in ingest(
        [tmp_path / "log.csv"],
        dbc=tmp_path / "bus.dbc",
        signals_map=tmp_path / "map.toml",
        out=tmp_path / "out",
    ).values():
        assert errors("ingest", report) == []
    assert errors("ingest", json.loads((tmp_path / "out" / "log.report.json").read_text())) == []


def test_answers_are_as_described():
    problems = schemas.example("problems")["problems"]
    answers = solve_problems([*problems, {"id": "bad", "kind": "mu"}], 1)
    assert (
        answers[-1]["status"] == "error"
        and errors("answers", {"schema": "lpvguard.answers/1", "answers": answers}) == []
    )


def test_what_a_scenario_expects_is_as_described():
    written = schemas.schema("sim")["items"]["properties"]["expected"]["properties"]
    assert set(load_scenario("nominal").expect.model_dump()) == set(written)


def test_the_page_of_the_formats_says_what_the_schemas_say():
    page = ROOT / "tools" / "FORMATS.md"
    assert page.read_text(encoding="utf-8") == schemas.markdown(), (
        "write lpvguard.schemas.markdown() to tools/FORMATS.md"
    )
    assert not re.search(r"DESIGN", page.read_text(encoding="utf-8"))
