"""One formula bounds every cost: that of a pose graph below it, plus a constant."""

import pytest

import certpgo
from certpgo.certify.bound import lower_bound


@pytest.mark.parametrize(
    ("name", "cost"),
    [
        ("intel", "chordal"),
        ("intel", "g2o"),
        ("intel", "gtsam"),
        ("smallGrid3D", "chordal"),
        ("smallGrid3D", "g2o"),
    ],
)
def test_it_reproduces_the_bounds_of_the_search(dataset, name, cost):
    answer = certpgo.solve(dataset(name), cost=cost)
    found = answer.certificate
    assert found.verdict is certpgo.Verdict.CERTIFIED
    bound = lower_bound(answer.problem, answer.estimate)
    assert bound <= answer.cost
    assert bound == pytest.approx(found.lower_bound, rel=1e-6)
