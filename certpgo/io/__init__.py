"""Reading and writing graphs and estimates; all conversion of conventions is here."""

from certpgo.io.estimates import read_estimate, read_truth
from certpgo.io.reading import read
from certpgo.io.writing import write

__all__ = ["read", "read_estimate", "read_truth", "write"]
