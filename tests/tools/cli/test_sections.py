"""The verbs of `lpvguard --help`: each in one section, in the order of a user's work."""

import re

from typer.main import get_command

from lpvguard.cli import app
from lpvguard.cli.sections import SECTIONS


def test_every_verb_stands_in_one_section_and_help_lists_them_so(lpvguard):
    listed = [verb for verbs in SECTIONS.values() for verb in verbs]
    assert sorted(listed) == sorted(get_command(app).commands)
    text = lpvguard("--help").stdout.partition("\n\nStart:\n")[2]
    assert re.findall(r"^  (\w+) ", text, re.MULTILINE) == listed
    titles = re.findall(r"^(\w.*):$", text, re.MULTILINE)
    assert ["Start", *titles] == list(SECTIONS)
    assert "..." not in text, "no summary is cut"
