import json

import pytest

from certpgo.cli import main

SQUARE = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5707963267948966
VERTEX_SE2 2 1 1 3.1415926535897932
VERTEX_SE2 3 0 1 -1.5707963267948966
EDGE_SE2 0 1 1.01 0 1.57 100 0 0 100 0 100
EDGE_SE2 1 2 0.99 0 1.58 100 0 0 100 0 100
EDGE_SE2 2 3 1 0.01 1.56 100 0 0 100 0 100
EDGE_SE2 3 0 1 0 1.57 100 0 0 100 0 100
"""


class Done:
    """What a command left behind."""

    def __init__(self, code, out, err):
        self.code, self.out, self.err = code, out, err

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture
def certpgo(capsys, monkeypatch):
    """Runs a command line in this process; whoever runs the tests does not choose the width."""
    monkeypatch.delenv("COLUMNS", raising=False)

    def run(*arguments):
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        return Done(code, *capsys.readouterr())

    return run


@pytest.fixture
def square(tmp_path):
    """A loop of four planar poses, with initial values, in a g2o file."""
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path
