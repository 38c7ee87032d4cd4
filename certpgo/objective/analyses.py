"""The orders and symbolic factorizations of a graph's matrices."""

from __future__ import annotations

from functools import cached_property

from certpgo.linalg import factor
from certpgo.linalg.arrays import CSC, IntArray
from certpgo.linalg.blocks import BlockPattern
from certpgo.linalg.factor import Analysis, Symbolic


class Analyses:
    """What all problems of the same edges share.

    Parameters
    ----------
    pattern : of all matrices of the graph
    engine : factorization engine
    """

    def __init__(self, pattern: BlockPattern, engine: str) -> None:
        self.pattern, self.engine = pattern, engine
        self._by_size: dict[int, Symbolic] = {}

    @cached_property
    def order(self) -> IntArray:
        """(n,) fill-reducing order of the nodes."""
        return factor.fill_reducing_order(self.pattern.indptr, self.pattern.indices)

    @cached_property
    def _analysis(self) -> Analysis:
        pattern = self.pattern.indptr, self.pattern.indices
        return factor.analyze(*pattern, order=self.order, engine=self.engine)

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a matrix of the pattern; computed once per size."""
        known, size = self._by_size, A.shape[0]
        if size not in known:
            known[size] = self._analysis.blocks(self.pattern.layout_of(A).sizes)
        return known[size]
