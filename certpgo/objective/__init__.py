"""Costs of graphs: residuals, derivatives, and the quadratic problems below them.

From a number in a file to the matrix of a certificate:

1. ``io.lines`` (tagged lines) or ``io.edge_weights`` (arrays) make information, kappa and tau;
2. the graph holds them: ``Graph.information``, ``kappa``, ``tau``;
3. a term (``term.Term``; of edges ``edge_cost.EdgeCost``) has minorants of them at a point, and
   ``Minorants.summed`` is the graph of a quadratic problem below the cost; of F, that is F itself;
4. ``operators.data_matrix`` assembles M, ``certificate_matrix`` subtracts the multipliers, and
   ``certify.dual`` factorizes it.

Distances are bounded at points of any rank: ``lifted_distances.LiftedDistances.tangents`` are edges
of signed weights, by ``families.distances.Distances.tangent_weights``. Where scales are unknown,
``similarity_sum.SimilaritySum`` has what is measured besides edges.
"""
