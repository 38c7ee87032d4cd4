"""Lessons run where their page says to open them: in their folder, of an installed checkout."""

import os
import subprocess
import sys

from tests.lessons.conftest import LESSONS

#: Runs the first cell of code of each lesson, its imports.
FIRST_CELLS = """
from pathlib import Path

for path in sorted(Path().glob("*.py")):
    cells = path.read_text(encoding="utf-8").split("\\n# %%")
    cell = next(cell for cell in cells[1:] if not cell.startswith(" [markdown]"))
    exec(compile(cell, path.name, "exec"), {"__name__": "__main__"})
    print(path.stem)
"""


def test_the_first_cells_run_in_their_folder():
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_CELLS],
        cwd=LESSONS,
        env={**own, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.stem for path in LESSONS.glob("*.py")} <= set(done.stdout.split())
