"""The certificate matrix whose eigenvalues are drawn."""

from __future__ import annotations

from typing import NamedTuple

from certpgo.certify import Certificate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.curvature import smallest_eigenvalues


class CertificateMatrix(NamedTuple):
    """The certificate matrix of a problem under F.

    Attributes
    ----------
    problem, multipliers : whose it is, and (n, d, d) its multipliers
    touches : the cost at which a surrogate touches that of another program; None if the matrix is
        that of the certificate
    """

    problem: Quadratic
    multipliers: FloatArray
    touches: float | None = None

    def eigenvalues(self, count: int) -> FloatArray:
        """The smallest ones, ascending; see `smallest_eigenvalues`."""
        return smallest_eigenvalues(self.problem, self.multipliers, count)


def certificate_matrix(problem: Certifiable, certificate: Certificate) -> CertificateMatrix | None:
    """The matrix of the certificate, or of a surrogate under another cost; None if there is none.

    Raises
    ------
    CertPGOError
        There is no surrogate.
    """
    if problem.is_lifted:
        return None
    if problem.is_chordal:
        if certificate.multipliers is None:
            return None
        return CertificateMatrix(problem.chordal, certificate.multipliers)
    below, constant = next(problem.surrogate(certificate.refined).at(certificate.refined))
    point = below.with_optimal_translations(certificate.refined)
    return CertificateMatrix(below, below.multipliers(point), below.cost(point) + constant)
