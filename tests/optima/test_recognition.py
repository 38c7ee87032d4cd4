"""A graph is recognised if its cost is the registered one, and only then."""

import numpy as np
import pytest

import certpgo
from certpgo.graph.components import rotations_alone
from certpgo.optima import known_optimum, recognise
from certpgo.optima.recognition import sizes_of


def costs(found):
    return {one.optimum.cost for one in found}


def test_the_same_measurements_are_recognised_in_any_file(filled, loop, read, tmp_path):
    instance = read(loop)
    assert costs(recognise(instance, filled)) == {"chordal", "g2o", "gtsam"}
    assert all(one.is_exact for one in recognise(instance, filled))
    lines = loop.read_text().splitlines(keepends=True)
    other = tmp_path / "renamed.g2o"
    other.write_text("VERTEX_SE2 0 5 5 1\n" + "".join(reversed(lines)))
    assert costs(recognise(read(other), filled)) == {"chordal", "g2o", "gtsam"}
    certpgo.write(tmp_path / "written.g2o", instance)
    assert "chordal" in costs(recognise(read(tmp_path / "written.g2o"), filled))


def test_a_bare_graph_is_recognised_under_f(filled, loop, read):
    graph = read(loop).graph.with_information(None)
    found = known_optimum(graph, register=filled)
    assert found.optimum.cost == "chordal"
    assert known_optimum(graph, "g2o", filled) is None


def test_the_default_cost_is_that_of_solve(filled, loop, read):
    assert known_optimum(read(loop), register=filled).optimum.cost == "g2o"


@pytest.mark.parametrize(
    "options",
    [
        {"unit_weights": True},
        {"kappa": 3.0},
        {"tau": 3.0},
        {"weights_are": "covariance"},
        {"weights_are": "sqrt-information"},
        {"mahalanobis": True},
    ],
    ids=str,
)
def test_chosen_weights_are_another_problem(filled, loop, read, options):
    assert recognise(read(loop, **options), filled) == ()


def test_units_are_other_problems(filled, loop, read):
    graph = read(loop).graph
    assert recognise(graph.with_weights(2.0 * graph.kappa, 2.0 * graph.tau), filled) == ()
    millimetres = certpgo.PoseGraph(
        graph.rotations_alone, 1e3 * graph.translations, 1e-6 * graph.tau
    )
    assert recognise(millimetres, filled) == ()


def test_fewer_and_more_measurements_are_other_problems(filled, loop, read, tmp_path):
    instance = read(loop)
    kept = np.ones(5, dtype=bool)
    kept[4] = False
    assert recognise(instance.with_edges(kept), filled) == ()
    assert recognise(instance.graph.reweighted(kept.astype(float)), filled) == ()
    more = tmp_path / "more.g2o"
    more.write_text("EDGE_SE2 1 3 0 1 3 1 0 0 1 0 1\n")
    together = certpgo.read([loop, more], quiet=True)
    assert recognise(together, filled) == ()
    assert recognise(rotations_alone(instance), filled) == ()


def test_parallel_edges_that_are_left_out_count(register, read, tmp_path):
    from certpgo.optima.adding import add

    path = tmp_path / "parallel.g2o"
    tail = "100 0 0 100 0 100\n"
    path.write_text(f"EDGE_SE2 0 1 1 0 1 {tail}EDGE_SE2 0 1 2 0 1 {tail}EDGE_SE2 1 2 1 0 1 {tail}")
    add(register, path, read(path), "chordal")
    assert len(recognise(read(path), register)) == 1
    assert recognise(read(path, keep="last"), register) == ()
    assert recognise(read(path, keep="first"), register) == ()


def test_held_nodes_and_priors_count(register, read, tmp_path):
    from certpgo.optima.adding import add

    path = tmp_path / "fixed.g2o"
    tail = "100 0 0 100 0 100\n"
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 2 0 0\nVERTEX_SE2 2 3 0 0\nFIX 0 2\n"
        f"EDGE_SE2 0 1 1 0 0 {tail}EDGE_SE2 1 2 1 0 0 {tail}"
    )
    add(register, path, read(path), "chordal")
    assert len(recognise(read(path), register)) == 1
    assert recognise(read(path, fixed=False), register) == ()


def test_rounding_is_said(filled, loop, read):
    graph = read(loop).graph
    instance = read(loop)
    moved = certpgo.PoseGraph(
        graph.rotations_alone,
        graph.translations * (1.0 + 2.0**-50),
        graph.tau,
        points=graph.is_point,
    )
    found = known_optimum(moved, register=filled)
    assert not found.is_exact
    assert "to nine digits" in str(found)
    assert "to nine digits" not in str(known_optimum(instance, "chordal", filled))


def test_an_estimate_is_judged_without_a_search(filled, loop, read):
    instance = read(loop)
    found = known_optimum(instance, "chordal", filled)
    poor = certpgo.get_solver("spanning_tree")().solve(certpgo.Quadratic(instance.graph))
    assert found.above(poor.cost) == pytest.approx(poor.cost - found.optimum.lower)
    proven = certpgo.certify(certpgo.Quadratic(instance.graph), poor.estimate)
    assert found.above(proven.cost_upper) == pytest.approx(proven.gap, rel=1e-6)


def test_unknown_sizes_need_no_digest(filled, loop, read, monkeypatch):
    from certpgo.optima import recognition

    monkeypatch.setattr(recognition, "fingerprint", None)
    instance = read(loop).with_edges([0, 1, 2, 3])
    assert (instance.graph.kind, sizes_of(instance)) not in filled.sizes
    assert recognise(instance, filled) == ()
