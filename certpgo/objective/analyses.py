"""The orders and symbolic factorizations of a graph's matrices."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

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
        return self._of(A.shape[0], lambda: self.pattern.layout_of(A).sizes)

    def of_rows(self, b: int) -> Symbolic:
        """That of matrices whose nodes have b rows each."""
        n = self.pattern.num_nodes
        return self._of(n * b, lambda: np.full(n, b))

    def _of(self, size: int, sizes: Callable[[], IntArray]) -> Symbolic:
        known = self._by_size
        if size not in known:
            known[size] = self._analysis.blocks(sizes())
        return known[size]
