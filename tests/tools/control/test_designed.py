"""The generated folder and the controller.json that it was exported with: one names the other by its hash."""

import json

import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.control.controller_file import require_exported_with


def test_a_folder_is_that_of_one_controller_file_byte_for_byte(tmp_path):
    controller = tmp_path / "controller.json"
    controller.write_text(json.dumps({"certificates": {"gamma": 1.0}}))
    stated = {"controller": {"sha256": artefacts.file_hash(controller)}}
    for name, content in (("with", stated), ("without", {})):
        with artefacts.new_folder(tmp_path / name, "vehicle", "truck") as folder:
            artefacts.write_files(folder, {artefacts.MANIFEST: artefacts.manifest("vehicle", **content)})
    require_exported_with(controller, tmp_path / "with")
    with pytest.raises(InputError, match=r"controller\.sha256: belongs to another controller"):
        require_exported_with(controller, tmp_path / "without")
    controller.write_text(json.dumps({"certificates": {"gamma": 1.01}}))
    with pytest.raises(InputError, match=r"controller\.sha256: belongs to another controller"):
        require_exported_with(controller, tmp_path / "with")
