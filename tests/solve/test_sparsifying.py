"""Loop closures chosen by connectivity: bounds against all choices, and what is lost."""

from itertools import combinations

import numpy as np
import pytest

import certpgo
from certpgo import GraphError, InputError, Instance, Verdict
from certpgo.graph import RotationGraph
from certpgo.graph.kinds import Kind
from certpgo.io.datasets.synthetic import helix, sphere, winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.connectivity import Connectivity, SpectralMargin, choose, relaxed


@pytest.fixture(scope="module")
def graph():
    return sphere(8, np.random.default_rng(0), rotation_noise=0.05).graph


@pytest.fixture(scope="module")
def sparse(graph):
    return certpgo.sparsify(graph, 0.2)


def small(seed):
    """A path of nine nodes with ten loop closures, and their flags."""
    rng = np.random.default_rng(seed)
    path = np.column_stack([np.arange(8), np.arange(1, 9)])
    pairs = np.array([(i, j) for i in range(9) for j in range(i + 2, 9)])
    edges = np.concatenate([path, pairs[rng.permutation(len(pairs))[:10]]])
    rotations = np.tile(np.eye(2), (len(edges), 1, 1))
    graph = RotationGraph(9, edges, rotations, rng.uniform(0.2, 5.0, len(edges)))
    return Quadratic(graph), np.arange(len(edges)) >= 8


def dense(problem, fractions):
    """lambda_2 by LAPACK."""
    L = np.zeros((problem.n, problem.n))
    weights = fractions * problem.graph.kappa
    for (i, j), weight in zip(problem.graph.edges, weights, strict=True):
        L[[i, j], [i, j]] += weight
        L[[i, j], [j, i]] -= weight
    return np.linalg.eigvalsh(L)[1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 4, 10])
def test_no_choice_exceeds_the_bound(seed, count):
    problem, loops = small(seed)
    choice = choose(Connectivity(problem), loops, count)
    values = []
    for chosen in combinations(np.flatnonzero(loops), count):
        flags = np.where(loops, 0.0, 1.0)
        flags[list(chosen)] = 1.0
        values.append(dense(problem, flags))
        if chosen == tuple(choice.chosen.tolist()):
            assert choice.connectivity == pytest.approx(values[-1], rel=1e-6)
    assert len(choice.chosen) == count
    assert max(values) <= choice.bound * (1 + 1e-9)
    assert choice.connectivity >= 0.85 * max(values)


@pytest.mark.parametrize("seed", range(4))
def test_the_supergradient_bounds_lambda_2_of_all_fractions(seed):
    problem, loops = small(seed)
    rng = np.random.default_rng(seed)
    _, gradient = Connectivity(problem)(np.ones(len(loops)))
    for _ in range(20):
        fractions = np.where(loops, rng.random(len(loops)), 1.0)
        assert dense(problem, fractions) <= (gradient @ fractions) * (1 + 1e-12)


def test_fractions_of_the_relaxation_are_feasible():
    problem, loops = small(0)
    fractions, bound = relaxed(Connectivity(problem), loops, 4)
    assert fractions[~loops] == pytest.approx(1.0)
    assert fractions[loops].sum() == pytest.approx(4.0)
    assert ((fractions >= 0.0) & (fractions <= 1.0 + 1e-12)).all()
    assert dense(problem, fractions) <= bound


@pytest.mark.parametrize(("n", "theta"), [(5, 0.3), (12, 2.0)])
def test_the_margin_of_a_cycle_is_known(n, theta):
    """A turn theta around it raises two of the three smallest eigenvalues to 2 - 2 cos(theta/n)."""
    problem = Quadratic(winding_cycle(n, theta, 0)[0].graph.rotations_alone)
    margin, gradient = SpectralMargin(Connectivity(problem))(np.ones(n))
    graph, measured = 2.0 - 2.0 * np.cos(2.0 * np.pi / n), 2.0 - 2.0 * np.cos(theta / n)
    assert margin == pytest.approx(graph - 2.0 / 3.0 * measured, rel=1e-6)
    assert gradient.sum() == pytest.approx(margin, rel=1e-3)


def test_the_margin_of_exact_measurements_is_the_connectivity():
    problem, loops = small(1)
    found, wanted = (
        measure(np.ones(len(loops)))
        for measure in (SpectralMargin(Connectivity(problem)), Connectivity(problem))
    )
    assert found[0] == pytest.approx(wanted[0], rel=1e-6)
    assert found[1] == pytest.approx(wanted[1], abs=1e-3 * wanted[1].max())


def test_the_margin_changes_as_its_gradient_says():
    problem, loops = small(2)
    graph = problem.graph
    turned = so.exp(np.random.default_rng(0).normal(0.0, 0.5, (len(loops), 1)))
    problem = Quadratic(
        RotationGraph(graph.num_nodes, graph.edges, turned @ graph.rotations, graph.kappa)
    )
    margin, step = SpectralMargin(Connectivity(problem)), 1e-3
    _, gradient = margin(np.ones(len(loops)))
    for edge in np.flatnonzero(loops):
        change = step * (np.arange(len(loops)) == edge)
        slope = (margin(1.0 + change)[0] - margin(1.0 - change)[0]) / (2.0 * step)
        assert slope == pytest.approx(gradient[edge], abs=5e-3 * np.abs(gradient).max())


def test_the_spectrum_leaves_out_wrong_loop_closures():
    graph = sphere(5, np.random.default_rng(0), rotation_noise=0.05).graph.rotations_alone
    rng = np.random.default_rng(1)
    loops = np.abs(np.diff(graph.edges, axis=1)[:, 0]) != 1
    wrong = rng.choice(np.flatnonzero(loops), 8, replace=False)
    measured = graph.rotations.copy()
    measured[wrong] = so.random(rng, len(wrong), 3)
    problem = Quadratic(RotationGraph(graph.num_nodes, graph.edges, measured, graph.kappa))
    connectivity, count = Connectivity(problem), int(0.7 * loops.sum())
    known = choose(connectivity, loops, count)
    measuring = choose(connectivity, loops, count, SpectralMargin(connectivity))
    kept = [int(np.isin(wrong, found.chosen).sum()) for found in (known, measuring)]
    assert kept[1] == 0 < kept[0]
    assert len(measuring.chosen) == count
    assert measuring.connectivity <= known.connectivity <= known.bound
    flags = ~loops | np.isin(np.arange(len(loops)), measuring.chosen)
    assert measuring.connectivity == pytest.approx(dense(problem, flags), rel=1e-6)


def test_what_to_choose_by_is_refused(graph):
    with pytest.raises(InputError, match="'connectivity' or 'spectrum', not 'colour'"):
        certpgo.sparsify(graph, 0.5, by="colour")


def test_scaling_the_weights_scales_connectivity(graph, sparse):
    again = certpgo.sparsify(graph.reweighted(np.full(graph.num_edges, 7.0)), 0.2)
    assert again.connectivity == pytest.approx(7.0 * sparse.connectivity, rel=1e-3)
    assert again.loss == pytest.approx(sparse.loss, rel=0.2)


def test_odometry_is_kept_and_the_rest_counted(graph, sparse):
    steps = np.flatnonzero(np.abs(np.diff(graph.edges, axis=1)[:, 0]) == 1)
    assert np.isin(steps, sparse.kept).all()
    assert sparse.loops == graph.num_edges - len(steps)
    assert len(sparse.chosen) == round(0.2 * sparse.loops)
    assert not np.isin(sparse.chosen, steps).any()
    assert len(sparse.kept) == len(steps) + len(sparse.chosen) == sparse.instance.graph.num_edges


def test_what_is_lost_is_computed(graph, sparse):
    problem = certpgo.Quadratic(graph)
    assert sparse.answer.verdict is sparse.whole.verdict is Verdict.CERTIFIED
    assert sparse.cost == pytest.approx(problem.cost(sparse.answer.estimate), rel=1e-12)
    assert sparse.whole.cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)
    assert sparse.loss == pytest.approx(sparse.cost / sparse.whole.cost - 1.0)
    assert sparse.loss > 0.0
    assert sparse.moved.ate_m > 0.0
    assert "% more" in str(sparse)


def test_all_loop_closures_lose_nothing(graph, sparse):
    whole = certpgo.sparsify(graph, 1.0)
    assert whole.kept.tolist() == list(range(graph.num_edges))
    assert whole.connectivity == pytest.approx(whole.full, rel=1e-6)
    assert abs(whole.loss) < 1e-9
    assert certpgo.sparsify(graph, sparse.loops).kept.tolist() == whole.kept.tolist()


def test_a_tree_completes_the_odometry(graph):
    odd = Instance("odd", graph, 2 * np.arange(graph.num_nodes))
    found = certpgo.sparsify(odd, 1)
    assert found.loops == graph.num_edges - (graph.num_nodes - 1)
    assert found.instance.graph.is_connected
    assert found.instance.graph.num_edges == graph.num_nodes


def test_information_and_labels_follow_their_edges(tmp_path, graph):
    certpgo.write(tmp_path / "some.g2o", graph)
    instance = certpgo.read(tmp_path / "some.g2o")
    outliers = np.arange(graph.num_edges) % 3 == 0
    labelled = Instance("some", graph, instance.ids, outliers=outliers)
    found = certpgo.sparsify(labelled, 5)
    assert found.instance.outliers.tolist() == outliers[found.kept].tolist()
    kept = instance.with_edges(found.kept)
    assert np.array_equal(
        kept.graph.information_matrices, instance.graph.information_matrices[found.kept]
    )


def test_a_rotation_graph_is_sparsified(graph):
    found = certpgo.sparsify(graph.rotations_alone, 10)
    assert found.moved.ate_m is None
    assert found.answer.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize(
    ("keep", "message"),
    [(0, "1 to"), (10**6, "1 to"), (0.0, "in"), (1.5, "in"), (float("nan"), "in"), (-3, "1 to")],
)
def test_amounts_out_of_range_are_refused(graph, keep, message):
    with pytest.raises(InputError, match=message):
        certpgo.sparsify(graph, keep)


def test_graphs_without_choice_are_refused(graph):
    path = winding_cycle(6, 0.0, 0)[0].graph.with_edges(range(5))
    with pytest.raises(InputError, match="no loop closures"):
        certpgo.sparsify(path, 0.5)
    with pytest.raises(GraphError, match="connected"):
        certpgo.sparsify(path.with_edges([0, 1]), 0.5)
    moved = certpgo.PoseGraph(path, np.ones((5, path.d)), np.ones(5))
    halved = moved.with_weights(np.r_[1.0, 1.0, 0.0, 1.0, 1.0])
    with pytest.raises(GraphError, match="rotations between poses do not connect them"):
        certpgo.sparsify(halved, 0.5)


def test_distances_sightings_and_priors_are_kept():
    rng = np.random.default_rng(2)
    made = sphere(4, rng, rotation_noise=0.02)
    n, truth = made.graph.num_nodes, made.truth.translations
    graph = certpgo.with_priors(made.graph, [0, 5, 9], translations=truth[[0, 5, 9]], tau=25.0)
    pairs = np.array([[0, 7], [2, 11], [n, 6]])
    ends = np.vstack([truth, np.zeros(3)])
    apart = np.linalg.norm(ends[pairs[:, 1]] - ends[pairs[:, 0]], axis=1)
    ranges = certpgo.Ranges(n + 1, pairs, apart + 0.05, np.full(3, 100.0))
    whole = Instance("whole", graph.with_ranges(ranges), np.arange(n + 1), world=n)
    all_kept, some = certpgo.sparsify(whole, 1.0), certpgo.sparsify(whole, 0.5)
    assert all_kept.cost == pytest.approx(certpgo.solve(whole).cost, rel=1e-9)
    assert all_kept.kept.tolist() == list(range(graph.num_edges))
    for found in (all_kept, some):
        counts = found.instance.measurements.counts
        assert (counts[Kind.RANGE], counts[Kind.POSITION]) == (3, 3)
        assert found.answer.certificate.lower_bound <= some.whole.cost  # of fewer terms
        assert found.cost >= some.whole.certificate.lower_bound
    assert len(some.chosen) == round(0.5 * some.loops)
    relaid = certpgo.sparsify(made.graph, 0.5)  # the choice is by rotations alone
    assert some.chosen.tolist() == relaid.chosen.tolist()
    assert n not in certpgo.suggest_loops(whole, 2).pairs


def test_a_path_is_closed_first():
    path = winding_cycle(12, 0.0, 0)[0].graph.with_edges(range(11))
    found = certpgo.suggest_loops(path, 1)
    assert found.pairs.tolist() == [[0, 11]]
    closed = 2.0 - 2.0 * np.cos(2.0 * np.pi / 12)
    assert found.connectivity[1] == pytest.approx(found.kappa * closed, rel=1e-6)


def test_suggestions_raise_connectivity_and_are_new():
    graph = helix(6, np.random.default_rng(0)).graph
    found = certpgo.suggest_loops(graph, 4)
    known = {tuple(sorted(pair)) for pair in graph.edges.tolist()}
    assert len({tuple(pair) for pair in found.pairs.tolist()} - known) == 4
    assert (np.diff(found.connectivity) > 0.0).all()
    assert str(found).startswith("4 loop closures would raise the connectivity from ")


def test_suggestions_are_near_each_other_if_asked():
    made = helix(6, np.random.default_rng(0))
    estimate = certpgo.solve(made.graph).estimate
    free = certpgo.suggest_loops(made.graph, 2)
    distance = np.linalg.norm(np.diff(estimate.translations[free.pairs], axis=1)[:, 0], axis=1)
    within = 0.9 * float(distance.min())
    near = certpgo.suggest_loops(made.graph, 2, within=within, estimate=estimate)
    distance = np.linalg.norm(np.diff(estimate.translations[near.pairs], axis=1)[:, 0], axis=1)
    assert (distance <= within).all()
    assert near.connectivity[-1] <= free.connectivity[-1]
    assert near.pairs.tolist() == certpgo.suggest_loops(made.graph, 2, within=within).pairs.tolist()
    with pytest.raises(InputError, match="no two nodes are within"):
        certpgo.suggest_loops(made.graph, 2, within=1e-9)
    with pytest.raises(InputError, match="have no distance"):
        certpgo.suggest_loops(made.graph.rotations_alone, 2, within=1.0)
    with pytest.raises(InputError, match="at least 1"):
        certpgo.suggest_loops(made.graph, 0)
