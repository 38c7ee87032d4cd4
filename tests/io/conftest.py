import os
from pathlib import Path

import pytest


@pytest.fixture
def data():
    """A benchmark file by its path under CERTPGO_DATA; skips when it is not there."""

    def locate(name):
        root = os.environ.get("CERTPGO_DATA")
        if root is None:
            pytest.skip("CERTPGO_DATA is not set")
        path = Path(root) / name
        if not path.exists():
            pytest.skip(f"{name}: file not here")
        return path

    return locate


@pytest.fixture
def file(tmp_path):
    """Writes a small text file and returns its path."""

    def write(text, name="graph.g2o"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write
