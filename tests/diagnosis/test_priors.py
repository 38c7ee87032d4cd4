"""Priors and held nodes at wrong places."""

import numpy as np
import pytest
from strategies import rng_of

import certpgo
from certpgo.io.datasets.synthetic import helix

NODES = [0, 5, 10, 15, 20]


def with_fixes(seed, moved=(), turn=None):
    made = helix(5, rng_of(seed))
    t = made.truth.translations[NODES] + 0.05 * rng_of(seed + 1).standard_normal((5, 3))
    for k in moved:
        t[k] += 30.0
    if turn is not None:
        t = t @ turn
    return certpgo.with_priors(made.graph, NODES, translations=t, tau=400.0)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_of_right_priors(seed):
    graph = with_fixes(seed)
    diagnosis = certpgo.diagnose(graph)
    assert not diagnosis.findings
    assert not certpgo.diagnose(graph, certpgo.solve(graph).estimate).findings


def test_one_prior_at_a_wrong_place():
    graph = with_fixes(1, moved=(3,))
    [first, *_] = certpgo.diagnose(graph).findings
    m = helix(5, rng_of(1)).graph.num_edges
    assert (first.kind, first.edges) == ("prior-elsewhere", (m + 3,))
    assert "node 15" in first.said
    assert first.cost < 0.1 * first.cost_as_given


def test_priors_in_another_unit():
    graph = with_fixes(2, turn=100.0 * np.eye(3))
    [first, second, *_] = certpgo.diagnose(graph).findings
    assert first.kind == "positions-centimetres"
    assert (second.kind, len(second.edges)) == ("priors-elsewhere", 5)


def test_a_node_that_is_held_at_a_wrong_place(tmp_path):
    info = " ".join("1" if i == j else "0" for i in range(3) for j in range(i, 3))
    lines = [f"VERTEX_SE2 {k} {k + 40 * (k == 9)} 0 0" for k in range(10)] + ["FIX 0", "FIX 9"]
    steps = [(k, k + 1) for k in range(9)] + [(k, k + 2) for k in range(8)]
    rng = rng_of(0)
    for i, j in steps:
        x, y, a = np.array([j - i, 0.0, 0.0]) + 0.1 * rng.standard_normal(3)
        lines.append(f"EDGE_SE2 {i} {j} {x} {y} {a} {info.replace('1', '100')}")
    path = tmp_path / "held.g2o"
    path.write_text("\n".join(lines) + "\n")
    [first, *_] = certpgo.diagnose(certpgo.read(path, quiet=True)).findings
    assert first.kind == "held-elsewhere"
