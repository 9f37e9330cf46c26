"""What a shell's completion script offers: verbs, options, and nothing while a command runs as usual."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def on_path(tmp_path):
    """Environment in which `lpvguard` is this package."""
    program = tmp_path / "lpvguard"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m lpvguard.cli "$@"\n')
    program.chmod(0o755)
    return {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}


@pytest.mark.slow("3 s: a shell starts the command")
def test_bash_completes_verbs_and_options_with_the_printed_script(lpvguard, on_path):
    script = lpvguard("completion", "bash")
    assert script.returncode == 0

    def offered(*words: str) -> list[str]:
        line = f"{script.stdout}\nCOMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
        line += "_lpvguard_completion lpvguard; printf '%s\\n' \"${COMPREPLY[@]}\""
        done = subprocess.run(
            ["bash", "-c", line],
            env=on_path,
            capture_output=True,
            text=True,
            check=True,
            stdin=subprocess.DEVNULL,
        )
        return done.stdout.split()

    assert offered("lpvguard", "id") == ["identify"]
    assert offered("lpvguard", "replay", "--coef") == ["--coefficients"]
    assert "complete -o default -F _lpvguard_completion lpvguard" in script.stdout


@pytest.mark.slow("2 s: a shell starts the command")
def test_zsh_is_offered_verbs_with_what_they_do(lpvguard, on_path):
    script = lpvguard("completion", "zsh").stdout
    assert script.startswith("#compdef lpvguard\n") and "_LPVGUARD_COMPLETE=complete_zsh" in script
    asked = {"_TYPER_COMPLETE_ARGS": "lpvguard ident", "_LPVGUARD_COMPLETE": "complete_zsh"}
    program = Path(on_path["PATH"].partition(os.pathsep)[0]) / "lpvguard"
    done = subprocess.run([program], env=on_path | asked, capture_output=True, text=True, check=True)
    assert '"identify":"Find the unfalsified bounds' in done.stdout


@pytest.mark.slow("6 s: a shell starts the command")
def test_fish_asks_the_program_that_answers_it(lpvguard, on_path):
    script = lpvguard("completion", "fish").stdout
    assert script.startswith("complete --command lpvguard ") and "_LPVGUARD_COMPLETE=complete_fish" in script
    program = Path(on_path["PATH"].partition(os.pathsep)[0]) / "lpvguard"

    def asked(action: str, words: str) -> subprocess.CompletedProcess[str]:
        words_of_fish = {"_TYPER_COMPLETE_FISH_ACTION": action, "_TYPER_COMPLETE_ARGS": words}
        environment = on_path | words_of_fish | {"_LPVGUARD_COMPLETE": "complete_fish"}
        return subprocess.run([program], env=environment, capture_output=True, text=True, check=False)

    assert asked("get-args", "lpvguard ident").stdout.startswith("identify\tFind the unfalsified bounds")
    assert asked("is-args", "lpvguard ident").returncode == 0
    assert asked("is-args", "lpvguard fit ").returncode == 1, "files are the shell's own to complete"


def test_another_shell_is_refused(lpvguard):
    done = lpvguard("completion", "tcsh")
    assert done.returncode == 2 and "tcsh" in done.stderr
