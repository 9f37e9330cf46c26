"""Run public packages for comparison ("peers") in a separate virtual environment, with binary wheels only.

The environment is made on demand. The package's own environment does not change. The calling bench judges the
answers of the peers.
"""

import json
import os
import subprocess
import tempfile
import venv
from pathlib import Path

PACKAGES = ("slycot", "control", "dkpy", "clarabel==0.9.0")  # dkpy 0.1.9 panics with clarabel 0.11


class Peers:
    """Virtual environment of the peers in ``folder``, made if it is missing.

    ``note`` gives the reason if there is no environment, and is otherwise empty.
    """

    def __init__(self, folder: Path | None):
        self.note = "not asked for"
        if folder is None:
            return
        self.note = ""
        self._python = Path(folder) / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
        if not self._python.exists():
            venv.create(folder, with_pip=True)
            made = subprocess.run(
                [self._python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *PACKAGES],
                capture_output=True,
                text=True,
                check=False,
            )
            if made.returncode:
                self._python.unlink()
                self.note = f"could not be installed: {made.stderr.strip().splitlines()[-1:]}"

    def ask(self, script: str, question: dict, limit_s: float) -> dict:
        """Run a script of a peer and return its answer, or {"note": reason} without an answer.

        The arguments of ``script`` are the JSON files of the question and of the answer.
        """
        if self.note:
            return {"note": self.note}
        return ask(self._python, script, question, limit_s)


def ask(python: Path | str, script: str, question: dict, limit_s: float) -> dict:
    """Run ``script`` with the interpreter ``python``; see :meth:`Peers.ask`."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as folder:
        question_file, answer_file = Path(folder) / "question.json", Path(folder) / "answer.json"
        question_file.write_text(json.dumps(question))
        try:
            done = subprocess.run(
                [python, "-c", script, question_file, answer_file],
                capture_output=True,
                text=True,
                timeout=limit_s,
                env=environment,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return {"note": f"no answer in {limit_s:g} s"}
        if done.returncode or not answer_file.exists():
            return {"note": f"failed: {(done.stderr.strip().splitlines() or ['no message'])[-1][:80]}"}
        return json.loads(answer_file.read_text())
