"""Other programs, by their Python packages."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from certpgo.errors import CertPGOError, MissingDependency, NumericalError


@dataclass(frozen=True)
class Program:
    """A program and the package that binds it to Python.

    Attributes
    ----------
    name : in messages
    package : to import, and to install
    """

    name: str
    package: str

    def library(self) -> Any:
        """The package, imported on first use; or MissingDependency."""
        try:
            return importlib.import_module(self.package)
        except ImportError:
            raise MissingDependency(self.name, "baselines", package=self.package) from None

    @contextmanager
    def translated(self) -> Iterator[None]:
        """Turn the program's exceptions into NumericalError with the first sentence of its text."""
        try:
            yield
        except CertPGOError:
            raise
        except (RuntimeError, ValueError, IndexError) as error:
            raise NumericalError(f"{self.name}: {sentence(error)}") from error


GTSAM = Program("GTSAM", "gtsam")
G2O = Program("g2o", "g2opy")
CERES = Program("Ceres", "pyceres")


def sentence(error: Exception) -> str:
    """The first paragraph of an error's text in one line, or its type."""
    paragraph = str(error).strip().partition("\n\n")[0]
    return " ".join(paragraph.split()) or type(error).__name__
