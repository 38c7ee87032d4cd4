import warnings

import pytest

import certpgo
from certpgo.optima.adding import add
from certpgo.optima.register import Register

#: A loop whose optimum is not the dead reckoning, with anisotropic information.
LOOP = """\
EDGE_SE2 0 1 1.1 0 1.5 90 3 0 100 0 110
EDGE_SE2 1 2 0.9 0 1.6 100 0 0 100 0 100
EDGE_SE2 2 3 1 0.2 1.5 100 0 1 80 0 100
EDGE_SE2 3 0 1 0 1.7 100 0 0 100 0 100
EDGE_SE2 0 2 1 1 3.0 50 0 0 50 0 60
"""


@pytest.fixture
def loop(tmp_path):
    """The path of a small g2o file."""
    path = tmp_path / "loop.g2o"
    path.write_text(LOOP)
    return path


@pytest.fixture
def register(tmp_path):
    """An empty register in a folder of its own."""
    folder = tmp_path / "register"
    folder.mkdir()
    return Register(folder)


@pytest.fixture
def read():
    def quietly(path, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return certpgo.read(path, quiet=True, **options)

    return quietly


@pytest.fixture
def filled(register, loop, read):
    """A register with the loop's optima, saved."""
    for cost in ("chordal", "g2o", "gtsam"):
        add(register, loop, read(loop), cost, source="o/r@c:loop.g2o")
    register.save()
    return register
