"""Lifted iterates: rounding, public solver output, and malformed files."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, rng_of, seeds

from certpgo import certify
from certpgo.certify import Verdict
from certpgo.errors import FormatError
from certpgo.graph.relaxed_point import Lift, rounded
from certpgo.io import read_estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton

#: F of the optimum; the files hold about five digits.
OPTIMA = {
    "sphere2500": 1687.005814,
    "parking-garage": 1.262524428,
    "cubicle": 717.125990742,
}


@given(seeds, dimensions)
def test_an_iterate_of_rank_d_is_rounded_to_itself_up_to_gauge(seed, d):
    rng = rng_of(seed)
    R, t = so.random(rng, 6, d), rng.standard_normal((6, d))
    basis = np.linalg.qr(rng.standard_normal((5, d)))[0]
    back = rounded(Lift(basis @ R, t @ basis.T))
    S, s = back.rotations, back.translations
    gauge = S[0] @ R[0].T
    np.testing.assert_allclose(S, gauge @ R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(s, t @ gauge.T, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", OPTIMA)
def test_public_iterates_lie_beside_the_optimum(name, dataset, dataset_path):
    instance = dataset(name)
    problem = Quadratic(instance.graph)
    estimate = read_estimate(dataset_path(f"{name}_Yopt"), instance)
    assert newton(problem, estimate).cost == pytest.approx(OPTIMA[name], rel=1e-6)
    certificate = certify(problem, estimate)
    assert certificate.verdict in (Verdict.CERTIFIED, Verdict.BOUNDED)
    assert certificate.basin_is_global


def written(tmp_path, text):
    path = tmp_path / "Y.txt"
    path.write_text(text)
    return path


ROW = " ".join(["1.0"] + 7 * ["0.0"] + ["1.0"] + 7 * ["0.0"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"3 16\n{ROW}\n", r"Y.txt: expected 3 rows after the first line, not 1"),
        (f"2 16\n{ROW}\n{ROW} 5\n", r"Y.txt:3: expected 16 numbers, not 17"),
        (f"2 16\n{ROW}\n{ROW.replace('1.0', 'x')}\n", r"Y.txt:3: expected numbers"),
        (f"2 16\n{ROW}\n{ROW.replace('1.0', 'nan')}\n", r"Y.txt:3: numbers must be finite"),
        (f"3 16\n{ROW}\n{ROW}\n{ROW}\n", "orthonormal rotations"),
    ],
)
def test_malformed_iterates(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read_estimate(written(tmp_path, text))
