"""Comparisons under the costs of other programs, and the notes below their tables."""

import inspect
import re
from dataclasses import replace

import numpy as np
import pytest
from strategies import pose_graph, rng_of

from certpgo import Instance, certify, read, solve
from certpgo.certify.region import limits
from certpgo.certify.regions import Regions
from certpgo.certify.tolerances import ATOL, NEGLIGIBLE, RTOL
from certpgo.cli.certify import command
from certpgo.errors import InputError
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.comparison import (
    METHODS,
    Competitor,
    MethodResult,
    compare,
    methods_under,
    solution_of,
)
from certpgo.solve.comparison_table import COLUMNS, NOTES, captions, cells, columns, notes, title
from certpgo.solve.judging import Judge

NAMES = ("certified", "certified (F)", "spanning_tree")


def square(folder, diagonal):
    """A square that does not close, with a diagonal, and weights that differ by direction."""
    line = "EDGE_SE2 {} {} {} {} {} 900 3 0 2 1 50"
    turns = [(0, 1), (1, 2), (2, 3), (3, 0)]
    lines = [line.format(*edge, 1.1, 0.2, 1.5) for edge in turns] + [line.format(0, 2, *diagonal)]
    path = folder / "uneven.g2o"
    path.write_text("\n".join(lines) + "\n")
    return read(path, quiet=True)


@pytest.fixture
def uneven(tmp_path):
    return square(tmp_path, (1, 1, 3.1))


def named(*names, cost):
    return [method for method in methods_under(cost) if method.label in names]


def test_notes_about_gtsam_need_its_rows():
    def said(labels, objective="F"):
        return notes(MethodResult("g", method=one, objective=objective) for one in labels)

    labels = [method.label for method in METHODS]
    assert said(labels) == NOTES
    without_file = [label for label in labels if "(file)" not in label]
    assert said(without_file) == (*NOTES[:2], *NOTES[3:])
    assert NOTES[4].startswith("Ceres")
    assert said(["certified", "newton"]) == (NOTES[0], NOTES[3])
    first, *rest = said(labels, "g2o's chi2")
    assert first.startswith("The cost is that of each table's title")
    assert tuple(rest) == NOTES[2:]


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_estimates_are_judged_by_the_cost_whatever_they_minimise(uneven, cost):
    own, of_f, tree = compare(uneven, named(*NAMES, cost=cost), cost=cost)
    problem = objective_of(uneven, cost)
    assert {row.objective for row in (own, of_f, tree)} == {problem.title}
    assert [row.minimised for row in (own, of_f, tree)] == [cost, "chordal", "chordal"]
    chordal = solve(uneven, cost="chordal").estimate
    assert (own.verdict, own.cost) == ("CERTIFIED", solve(uneven, cost=cost).cost)
    assert of_f.cost == problem.cost(chordal)
    assert of_f.verdict == certify(problem, chordal).verdict.value == "BOUNDED"
    assert own.cost < of_f.cost < tree.cost
    assert own.cost >= of_f.lower_bound > 0.99 * own.cost
    assert title(own) == f"uneven (4 nodes, 5 edges, 2D): {problem.title}"
    assert columns(own)[1:5] == ("cost", "f_ML", "gap", "gap / cost")
    assert "Methods that minimise the cost: certified." in list(captions([own, of_f, tree]))


def test_the_default_cost_is_that_of_solve(uneven):
    assert methods_under("chordal") == METHODS
    [row] = compare(uneven, named("certified", cost="g2o"))
    assert (row.minimised, row.cost) == ("g2o", solve(uneven).cost)
    [chordal] = compare(uneven, named("certified", cost="chordal"), cost="chordal")
    assert (chordal.objective, chordal.minimised) == ("F", "chordal")
    assert title(chordal).endswith(", 2D): chordal cost F")
    assert chordal.cost == Quadratic(uneven.graph).cost(solve(uneven, cost="chordal").estimate)
    assert columns(chordal) == COLUMNS


def test_the_verdict_on_a_robust_method_is_about_what_it_keeps(tmp_path):
    wrong = square(tmp_path, (-9, 7, 1.0))
    [row] = compare(wrong, [Competitor("graduated_non_convexity")], cost="g2o")
    problem = objective_of(wrong, "g2o")
    estimate = solve(wrong.graph).estimate
    factors = np.array([1.0, 0.5, 1.0, 2.0, 0.0])
    kept = problem.reweighted(factors)
    assert kept.graph.num_edges == 4
    assert kept.cost(estimate) == pytest.approx(factors @ problem.edge_costs(estimate), rel=1e-12)
    assert row.kept == 0.8
    assert row.cost - row.lower_bound > 100.0 * row.gap  # the cost is that of all measurements


@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_distances_are_those_of_certificates(uneven, cost):
    rows = list(compare(uneven, named(*NAMES, "eigen_ma", cost=cost), cost=cost))
    posed, judge = objective_of(uneven, cost), None
    for row in rows:
        method = next(one for one in methods_under(cost) if one.label == row.method)
        estimate = solution_of(method, posed.chordal, uneven).estimate
        judge = judge or Judge(posed)
        distance = judge.certify(estimate).distance
        assert (row.distance_m, row.distance_deg) == limits(distance)
        # From a bound of its own, up to rounding.
        alone = certify(posed, estimate).distance
        assert row.distance_m == pytest.approx(alone.largest[0], rel=1e-2)
        assert cells(row)[columns(row).index("off by")].endswith(" m")
        assert float(cells(row)[6].removesuffix(" m")) >= row.distance_m
    best = rows[0].distance_m
    assert best == min(row.distance_m for row in rows)
    assert best < 1e-3 < rows[-1].distance_m


def test_one_inverse_serves_all_rows(uneven, monkeypatch):
    counted, found = [], Regions._inverse

    def inverse(self, *given):
        counted.append(given)
        return found(self, *given)

    monkeypatch.setattr(Regions, "_inverse", inverse)
    rows = list(compare(uneven, named(*NAMES, "eigen_ma", cost="g2o"), cost="g2o"))
    assert all(row.distance_m for row in rows)
    assert len(counted) == 1


def test_rotations_alone_are_off_by_an_angle_and_unproven_estimates_by_nothing():
    cycle, around = winding_cycle(9, 0.3, 1)
    [row] = compare(cycle, [Competitor("certified")])
    best = solve(cycle).estimate
    assert (row.distance_m, row.distance_deg) == limits(certify(cycle, best).distance)
    assert row.distance_m is None
    assert re.fullmatch(r"\S+ deg", cells(row)[6])
    assert cells(replace(row, distance_deg=None))[6] == ""
    # The other way around the cycle is as far from the best one, and that is near every optimum.
    assert limits(certify(cycle, around).distance) == (None, pytest.approx(160.0, abs=0.01))


@pytest.mark.gtsam
def test_gtsams_optimizers_minimise_its_cost(uneven):
    pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")
    names = ("certified", "gtsam_gauss_newton", "gtsam_levenberg_marquardt", "gtsam_fastsync")
    best, *searches, fast = compare(uneven, named(*names, cost="gtsam"), cost="gtsam")
    for row in searches:
        assert (row.minimised, row.note) == ("gtsam", "GTSAM with full information")
        assert row.cost == pytest.approx(best.cost, rel=1e-4)
    assert (fast.minimised, fast.verdict) == ("chordal", "BOUNDED")
    isotropic = next(compare(uneven, named("gtsam_gauss_newton", cost="g2o"), cost="g2o"))
    assert "isotropic" in isotropic.note


def test_graphs_without_the_cost_are_refused(uneven):
    poses = Instance("poses", pose_graph(rng_of(0), 5, 2)[0], np.arange(5))
    with pytest.raises(InputError, match="needs poses with information matrices"):
        next(compare(poses, cost="g2o"))
    [row] = compare(uneven, [Competitor("newton", cost="g2o")], cost="g2o")
    assert row.error == "newton does not minimise the cost g2o"


def test_the_tolerances_that_are_printed_are_those_of_verdicts():
    defaults = inspect.signature(command).parameters
    assert (defaults["rtol"].default, defaults["atol"].default) == (RTOL, ATOL)
    assert [float(number) for number in re.findall(r"\d+e-\d+", NOTES[0])] == [
        RTOL,
        ATOL,
        NEGLIGIBLE,
    ]
