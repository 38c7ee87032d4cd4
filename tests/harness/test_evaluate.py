"""The judge of tables: which bounds it names."""

import numpy as np

from certpgo.certify import certify
from certpgo.datasets import synthetic
from certpgo.estimate import Estimate
from certpgo.harness.evaluate import certified_by
from certpgo.linalg import so
from certpgo.problem import RotationProblem, problem_of
from certpgo.solve import solve


def test_every_bound_that_holds_at_the_optimum_is_named():
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    problem = RotationProblem(instance.graph)
    named = certified_by(problem, certify(problem, point)).split(", ")
    assert {"Theorem 4.2", "cycle sum", "factorization"} <= set(named)


def test_angles_name_no_point_that_is_not_stationary():
    """K_4 with exact data has one with residuals below Theorem 4.1's angle, and F above 1."""
    instance = synthetic.complete(4, 0.0, np.random.default_rng(0))
    problem, rng = RotationProblem(instance.graph), np.random.default_rng(0)
    turned = (
        Estimate(so.exp(0.4 * rng.standard_normal((4, 3))) @ instance.truth.rotations)
        for _ in range(500)
    )
    near = next(
        x
        for x in turned
        if np.degrees(problem.residual_angles(x).max()) < 44.0 and problem.cost(x) > 1.0
    )
    assert certified_by(problem, certify(problem, near, refine=False)) == "none"
    assert "Theorem 4.1" in certified_by(problem, certify(problem, near))


def test_angles_say_nothing_of_poses():
    problem = problem_of(synthetic.grid3d(2, np.random.default_rng(0)).graph)
    found = certify(problem, solve(problem.graph).estimate)
    assert certified_by(problem, found) == "factorization"
