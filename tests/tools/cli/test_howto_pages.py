"""Blocks of the how-to pages: commands are those of this version, others are read by their readers."""

import re
import shlex
import tomllib

import pytest
from click import Context
from typer.main import get_command

from lpvguard.cli.shared import app
from made import ROOT

PAGES = sorted((ROOT / "tools" / "site" / "pages" / "howto").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ENDS = ("&&", "|")
"""Words between two calls of a line."""
PROGRAM = re.compile(r"(?:^|/)lpvguard$")


def blocks(text: str, language: str) -> list[str]:
    return [block for name, block in BLOCK.findall(text) if name == language]


def commands(text: str) -> list[list[str]]:
    """Words behind the program's name of every call in the shell blocks of a page."""
    calls = []
    for block in blocks(text, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            for k, word in enumerate(words):
                if PROGRAM.search(word) and (k == 0 or words[k - 1] in (*ENDS, "tools/with-vcan")):
                    rest = words[k + 1 :]
                    ends = [i for i, w in enumerate(rest) if w in ENDS]
                    calls.append(rest[: ends[0]] if ends else rest)
    return calls


def require_parsed(words: list[str]) -> None:
    """Raise what the command line raises for an unknown verb or option, or an option without its value."""
    command = get_command(app)
    while words and hasattr(command, "commands"):
        verb = command.get_command(Context(command), words[0])
        if verb is None:
            raise LookupError(words[0])
        command, words = verb, words[1:]
    command.make_parser(Context(command)).parse_args(list(words))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_blocks_of_a_page_are_read_by_their_readers(page):
    text = page.read_text(encoding="utf-8")
    for words in commands(text):
        require_parsed(words)
    for block in blocks(text, "toml"):
        tomllib.loads(block)
    for block in blocks(text, "python"):
        compile(block, str(page), "exec")


def test_most_pages_show_a_command_and_a_wrong_one_is_found():
    assert sum(bool(commands(page.read_text(encoding="utf-8"))) for page in PAGES) > 15
    for wrong in (["fitt"], ["fit", "--vehicles", "x"], ["fit", "--vehicle"]):
        with pytest.raises(Exception, match=r"fitt|No such option|requires an argument"):
            require_parsed(wrong)
