"""Points of the relaxation: lifting adds empty dimensions, rounding takes any gauge off again."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, lifted, rounded
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic


def some_estimate(rng, n, d):
    return Estimate(so.random(rng, n, d), 3.0 * rng.standard_normal((n, d)))


def orthogonal(rng, rank, determinant):
    """A random orthogonal matrix of that determinant."""
    Q = np.linalg.qr(rng.standard_normal((rank, rank)))[0]
    Q[:, 0] *= determinant * np.sign(np.linalg.det(Q))
    return Q


def moved(point, Q, offset=None):
    """A point after its world, of any rank, is turned or reflected by Q and shifted."""
    t = point.translations
    if t is not None:
        t = t @ Q.T + (0.0 if offset is None else offset)
    return Lift(Q @ point.rotations, t)


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_lifting_adds_zeros_and_changes_no_cost(d, poses):
    graph, R, t = pose_graph(np.random.default_rng(d), 6, d)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    x = Estimate(R, t if poses else None)
    for rank in (d, d + 1, d + 4):
        up = lifted(x, rank)
        assert (up.num_nodes, up.rank, up.d) == (6, rank, d)
        np.testing.assert_array_equal(up.rotations[:, :d], R)
        assert not up.rotations[:, d:].any()
        if poses:
            np.testing.assert_array_equal(up.translations, np.pad(t, ((0, 0), (0, rank - d))))
        else:
            assert up.translations is None
        assert problem.cost(up) == pytest.approx(problem.cost(x), rel=1e-14)
        np.testing.assert_allclose(
            problem.multipliers(up), problem.multipliers(x), rtol=0, atol=1e-12
        )
        np.testing.assert_array_equal(lifted(up, d + 5).rotations, lifted(x, d + 5).rotations)


@given(seeds, dimensions, st.integers(0, 4), st.sampled_from([-1.0, 1.0]))
def test_rounding_undoes_lifting_turning_reflecting_and_shifting(seed, d, more, determinant):
    rng = rng_of(seed)
    x, rank = some_estimate(rng, 7, d), d + more
    point = moved(
        lifted(x, rank), orthogonal(rng, rank, determinant), 5.0 * rng.standard_normal(rank)
    )
    back = rounded(point)
    for ours, theirs in (
        (back.anchored(3).rotations, x.anchored(3).rotations),
        (back.anchored(3).translations, x.anchored(3).translations),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)
    alone = rounded(point.with_translations(None))
    np.testing.assert_array_equal(alone.rotations, back.rotations)
    assert alone.translations is None


@given(seeds, dimensions, st.integers(0, 3))
def test_rounding_any_point_gives_rotations_and_knows_no_gauge(seed, d, more):
    """The world of a point far from every estimate may be turned or reflected all the same."""
    rng = rng_of(seed)
    rank = d + more
    Y = np.linalg.qr(rng.standard_normal((9, rank, d)))[0]
    graph, _, _ = pose_graph(rng, 9, d)
    problem = Quadratic(graph)
    point = problem.with_optimal_translations(Lift(Y, np.zeros((9, rank))))
    R = rounded(point).rotations
    assert R.shape == (9, d, d)
    assert so.worst_defect(R)[1] < 1e-13
    values, basis = np.linalg.eigh(np.einsum("nra,nsa->rs", Y, Y))
    assume(not more or values[more] - values[more - 1] > 1e-3)  # else any subspace is as good
    handed = np.linalg.det(basis[:, -d:].T @ Y)
    assume(np.abs(handed).min() > 1e-3)  # else rounding decides which mirror image
    again = rounded(moved(point, orthogonal(rng, rank, -1.0)))
    cost = problem.cost(problem.complete(R))
    assert problem.cost(problem.complete(again.rotations)) == pytest.approx(cost, rel=1e-6)


def test_the_best_subspace_wins_over_junk_in_other_dimensions():
    rng = np.random.default_rng(0)
    x = some_estimate(rng, 30, 3)
    Y = np.concatenate([0.05 * rng.standard_normal((30, 2, 3)), x.rotations], axis=1)
    t = np.concatenate([100.0 * rng.standard_normal((30, 2)), x.translations], axis=1)
    back = rounded(Lift(Y, t)).anchored(0)
    off = so.angle(np.swapaxes(back.rotations, 1, 2) @ x.anchored(0).rotations)
    assert off.max() < 0.05


def test_a_mirror_image_is_rounded_to_what_it_mirrors():
    """Half of the blocks of a point need not have one sign: the majority decides."""
    rng = np.random.default_rng(1)
    x = some_estimate(rng, 5, 3)
    Y = np.diag([-1.0, 1.0, 1.0]) @ x.rotations
    Y[4] = so.random(rng, 1, 3)[0]  # proper, against four that are reflected
    back = rounded(Lift(Y))
    np.testing.assert_allclose(
        back.anchored(0).rotations[:4], Estimate(x.rotations).anchored(0).rotations[:4], atol=1e-12
    )
    assert np.linalg.det(back.rotations).min() > 0.0
