"""Lessons run whole, once a session."""

import runpy
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

LESSONS = Path(__file__).parents[2] / "reports" / "lessons"


@cache
def run(name: str) -> Mapping[str, Any]:
    mpl.use("Agg")
    try:
        return runpy.run_path(str(LESSONS / f"{name}.py"))
    finally:
        plt.close("all")


@pytest.fixture
def lesson() -> Callable[[str], Mapping[str, Any]]:
    """The names that a lesson leaves behind."""
    return run
