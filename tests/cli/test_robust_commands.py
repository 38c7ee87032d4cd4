"""What the command line says of methods that reject measurements."""

import re

import numpy as np
import pytest
from scipy import optimize
from scipy.stats import chi2

from certpgo import Disagreement, certify, solve_robustly
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.io import read, write
from certpgo.io.datasets import thesis
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.objective.chi_squared import exceeded_by
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.accuracy_wording import disagreeing


@pytest.fixture
def wrong(tmp_path):
    instance = thesis.langevin_graph(40, 8.0, 1.0, np.random.default_rng(1), outliers=0.1)
    path = tmp_path / "wrong.g2o"
    write(path, instance.graph)
    return path


def flat(text):
    """The text with its lines joined."""
    return " ".join(text.split())


def test_a_verdict_is_said_to_be_of_what_was_kept(certpgo, wrong):
    done = certpgo("solve", wrong, "--method", "adaptive_trimming")
    assert done.code == 0
    assert "measurements" in flat(done.out)
    assert "the verdict is about these, with their final weights" in flat(done.out)
    assert "without --method" not in done.err
    report = certpgo("solve", wrong, "--method", "adaptive_trimming", "--json").json
    assert report["solution"]["kept"] > 200
    assert report["cost"] < 0.5 * report["solution"]["cost"]  # of those kept, and of all
    assert report["gap"] >= report["cost"] - report["lower_bound"]
    other = certpgo("solve", wrong, "--method", "eigen_ra", "--json").json
    assert other["solution"]["kept"] is None
    assert other["cost"] == other["solution"]["cost"]


def test_no_proof_is_written_of_a_part_of_the_measurements(certpgo, wrong, tmp_path):
    proof = tmp_path / "p.npz"
    done = certpgo("solve", wrong, "--method", "adaptive_trimming", "--proof", proof)
    assert done.code == 6
    assert "no proof is written" in flat(done.err)
    assert not proof.exists()


def test_a_threshold_that_rejects_nothing_is_said(certpgo, wrong):
    done = certpgo("solve", wrong, "--method", "graduated_non_convexity", "--set", "scale=100")
    assert "set scale" in flat(done.out)
    assert "no measurement was rejected" in flat(done.out)


def test_solve_robust_names_what_it_rejects(certpgo, wrong):
    done = certpgo("solve", wrong, "--robust")
    assert done.code == 0
    assert "rejected" in done.out
    assert "more" in done.out
    assert "the cost, its bound and the gap are of these, with their" in flat(done.out)
    report = certpgo("solve", wrong, "--robust", "--json").json
    assert report["solution"]["method"] == "robust"
    assert report["solution"]["kept"] is not None
    assert report["verdict"] == "CERTIFIED"
    edges = certpgo("info", wrong, "--json").json["edges"]
    assert len(report["solution"]["rejected"]) == edges - report["solution"]["kept"]
    assert report["solution"]["rejected"][0].keys() == {"edge", "ids"}


def test_text_and_page_state_one_gap_once(certpgo, wrong, tmp_path):
    page = tmp_path / "page.html"
    done = certpgo("solve", wrong, "--robust", "--html", page)
    [headline] = [line for line in done.out.split("\n\n") if line.startswith("CERTIFIED")]
    said = flat(headline).removeprefix("CERTIFIED. ")
    assert "of the truncated cost) above the optimum" in said
    assert flat(done.out).count("costs less; ") == 1
    text = page.read_text()
    assert f"<strong>CERTIFIED</strong>: {said} Within " in text
    assert "F of the kept measurements" in text
    assert "truncated cost</dt>" in text or "truncated cost</th>" in text


@pytest.mark.filterwarnings("ignore:.*all translations are zero")
def test_an_interrupted_choice_has_one_verdict(wrong):
    seen = []

    def stop(iteration):
        seen.append(iteration)
        return len(seen) > 6

    found = solve_robustly(read(wrong), monitor=stop)
    assert found.solution.status.value == "interrupted"
    assert len(found.rejected)
    assert found.rejection is None
    assert "CERTIFIED" not in str(found) or found.verdict == "CERTIFIED"
    assert "rejections are not certified: interrupted" in found.solution.note


@pytest.fixture
def doubtful(tmp_path):
    """Twenty measurements of one rotation, and one that is half a turn off: certified as it is."""
    path = tmp_path / "doubtful.g2o"
    lines = [f"EDGE_SE2 5 7 1 0 {angle} 100 0 0 100 0 400" for angle in [0] * 20 + [3.1]]
    path.write_text("\n".join(lines) + "\n")
    return path


HINT = "1 of 21 measurements disagrees with the rest"


def test_the_angle_of_another_fit_is_not_that_of_the_estimate():
    instance, wound = winding_cycle(9, 0.3, 1)
    found = certify(instance.graph, wound, refine=False)
    for angle, elsewhere in ((found.max_residual_angle, False), (3.0, True)):
        said = disagreeing(Disagreement(np.array([0]), 9, angle), found)
        assert said.endswith(" at another fit") is elsewhere


def test_solve_hints_at_measurements_that_disagree(certpgo, doubtful, tmp_path):
    page = tmp_path / "page.html"
    done = certpgo("solve", doubtful, "--html", page)
    assert done.code == 0
    assert HINT in flat(done.err)
    assert HINT in flat(done.out)
    assert "certpgo solve --robust" in flat(done.out)
    assert HINT in flat(page.read_text())
    report = certpgo("solve", doubtful, "--json").json
    assert report["disagreement"]["edges"] == [{"edge": 20, "ids": [5, 7]}]
    assert report["disagreement"]["worst_angle"] == pytest.approx(3.1 * 20 / 21, rel=1e-6)
    robust = certpgo("solve", doubtful, "--robust", "--json").json
    assert robust["solution"]["rejected"] == [{"edge": 20, "ids": [5, 7]}]
    assert robust["disagreement"] is None


def test_certify_hints_at_measurements_that_disagree(certpgo, doubtful, tmp_path):
    answer, page = tmp_path / "answer.g2o", tmp_path / "page.html"
    certpgo("solve", doubtful, "-o", answer)
    done = certpgo("certify", doubtful, answer, "--html", page)
    assert done.code == 0
    assert HINT in flat(done.out)
    assert HINT in flat(page.read_text())
    report = certpgo("certify", doubtful, answer, "--json").json
    assert report["disagreement"]["sentence"].startswith(HINT)
    assert report["disagreement"]["edges"] == [{"edge": 20, "ids": [5, 7]}]


def test_robust_is_no_method(certpgo, wrong):
    done = certpgo("solve", wrong, "--robust", "--method", "eigen_ra")
    assert done.code != 0
    assert "not with --method" in flat(done.err)


def test_one_rejected_measurement_is_one(certpgo, doubtful):
    said = flat(certpgo("solve", doubtful, "--robust").out)
    assert "(the kept, and the rejected one up to its price)" in said


def test_the_page_of_a_robust_answer_says_how_to_repeat_it(certpgo, doubtful, tmp_path):
    page = tmp_path / "page.html"
    certpgo("solve", doubtful, "--robust", "--html", page)
    text = flat(page.read_text())
    assert "The method kept 20 of 21 measurements" in text
    assert "--robust" in text


def test_rejections_are_listed_written_and_certified_again(certpgo, wrong, tmp_path):
    csv, estimate = tmp_path / "rejected.csv", tmp_path / "estimate.g2o"
    done = certpgo("outliers", wrong, "--csv", csv)
    assert done.code == 0
    assert "no choice among the 40 rejected measurements" in flat(done.out)
    assert "wrong at least" in done.out
    report = certpgo("outliers", wrong, "--json").json
    assert len(report["rejected"]) == len(csv.read_text().splitlines()) - 1 == 40
    assert report["wrong_at_least"] <= 40
    solved = certpgo("solve", wrong, "--robust", "-o", estimate, "--json").json
    assert solved["solution"]["rejection"]["verdict"] == "CERTIFIED"
    again = certpgo("certify", wrong, estimate, "--rejected", csv, "--json").json
    assert again["verdict"] == "CERTIFIED"
    assert again["objective"] == "truncated cost"
    assert again["lower_bound"] == pytest.approx(report["lower_bound"])
    # Of all choices among the rejected, as solve and certify --rejected say.
    assert re.search(r"proven distance +within \d\S* degrees of every optimum", done.out)
    assert report["distance_deg"] == pytest.approx(solved["distance_deg"], rel=0.5)
    assert report["distance_deg"] == pytest.approx(again["distance_deg"], rel=0.5)
    assert report["distance_m"] is None


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_rejections_are_certified_again_under_other_costs(certpgo, tmp_path, cost):
    graph, found = tmp_path / "doubtful.g2o", tmp_path / "found.g2o"
    instance = helix(12, np.random.default_rng(2))
    wrong = pose_graph_with_a_wrong_loop(instance.graph)
    write(graph, wrong)
    csv = tmp_path / "rejected.csv"
    csv.write_text(f"edge,i,j,price\n{wrong.num_edges - 1},2,8,25.0\n")
    certpgo("solve", graph, "--robust", "--cost", cost, "-o", found)
    done = certpgo("certify", graph, found, "--rejected", csv, "--cost", cost)
    assert done.code == 0
    assert "neither taking the rejected measurement back" in flat(done.out)
    assert "are of F" in flat(done.err)
    other = tmp_path / "other.g2o"
    write(other, instance.truth)
    worse = certpgo("certify", graph, other, "--rejected", csv, "--cost", cost)
    assert worse.code == 3
    judged = "" if cost == "g2o" else f" --cost {cost}"  # the file's own is the default
    assert f"{judged} --rejected {csv} --best " in flat(worse.out)
    refused = certpgo("certify", graph, found, "--rejected", csv, "--cost", cost, "--proof", "x")
    assert refused.code == 1
    assert "--rejected --proof is for --cost chordal" in flat(refused.err)


def pose_graph_with_a_wrong_loop(graph):
    """The graph three times, and one more edge from node 2 to 8 that is wrong."""
    edges = np.concatenate([np.tile(graph.edges, (3, 1)), [[2, 8]]])
    R = np.concatenate([np.tile(graph.rotations, (3, 1, 1)), np.diag([-1.0, -1, 1])[None]])
    t = np.concatenate([np.tile(graph.translations, (3, 1)), [[9.0, 9.0, 9.0]]])
    kappa, tau = (np.r_[np.tile(w, 3), np.median(w)] for w in (graph.kappa, graph.tau))
    return PoseGraph(RotationGraph(graph.num_nodes, edges, R, kappa), t, tau)


def test_rejections_have_a_proof_that_both_checkers_accept(certpgo, wrong, tmp_path):
    csv, estimate, proof = tmp_path / "rejected.csv", tmp_path / "estimate.g2o", tmp_path / "p.cert"
    done = certpgo("solve", wrong, "--robust", "-o", estimate, "--proof", proof)
    assert done.code == 0
    assert "truncated: 40 rejected ones cost" in flat(done.out)
    for exact in ((), ("--exact",)):
        assert "PROVED" in certpgo("check", wrong, proof, *exact).out
    certpgo("outliers", wrong, "--csv", csv)
    again = tmp_path / "again.cert"
    done = certpgo("certify", wrong, estimate, "--rejected", csv, "--proof", again)
    assert done.code == 0
    first, second = (certpgo("check", wrong, one).out.splitlines() for one in (proof, again))
    assert first[1] == second[1]  # what the cost is
    assert first[0][:40] == second[0][:40]  # and its first digits


@pytest.mark.parametrize(
    ("line", "said"),
    [("0,0", "expected integers"), ("1,998,999", "edge 1"), ("x,0,1", "expected integers")],
)
def test_a_list_of_other_measurements_is_refused(certpgo, wrong, tmp_path, line, said):
    csv, estimate = tmp_path / "rejected.csv", tmp_path / "estimate.g2o"
    csv.write_text(f"edge,i,j\n{line}\n")
    certpgo("solve", wrong, "-o", estimate)
    done = certpgo("certify", wrong, estimate, "--rejected", csv)
    assert done.code == 1
    assert f"{csv}:2" in flat(done.err)
    assert said in flat(done.err)


def test_a_quantile_is_for_rejections(certpgo, wrong):
    done = certpgo("solve", wrong, "--quantile", "0.99")
    assert done.code == 1
    assert "--quantile needs --robust" in flat(done.err)


def test_lists_of_no_rejected_measurements_are_written(certpgo, tmp_path):
    clean, csv = tmp_path / "clean.g2o", tmp_path / "rejected.csv"
    write(clean, thesis.langevin_graph(12, 8.0, 1.0, np.random.default_rng(1)).graph)
    csv.write_text("of another graph")
    done = certpgo("outliers", clean, "--csv", csv, "--json")
    assert done.json["rejected"] == []
    assert "none of the" in done.json["sentence"]
    [header] = csv.read_text().splitlines()
    assert header.startswith("edge,i,j,")


def test_kept_measurements_that_are_not_proven_are_named_by_nodes(certpgo, tmp_path):
    path = tmp_path / "far.g2o"
    ends = [(10, 11, 0)] * 3 + [(11, 12, 0)] * 3 + [(10, 12, 3.1)]
    path.write_text(
        "".join(f"EDGE_SE2 {i} {j} {j - i} 0 {a} 100 0 0 100 0 400\n" for i, j, a in ends)
    )
    said = flat(certpgo("outliers", path, "--cost", "chordal", "--time-limit", 0).out)
    assert "0 of 6 kept ones" in said
    assert "not proven of 10-11, 10-11, 10-11, 11-12, 11-12, 11-12 level" in said


def test_a_list_of_rejected_measurements_is_of_one_component(certpgo, wrong, tmp_path):
    two, csv = tmp_path / "two.g2o", tmp_path / "rejected.csv"
    csv.write_text("edge,i,j\n0,0,1\n")
    text = "".join(f"EDGE_SE2 {i} {i + 1} 1 0 0 100 0 0 100 0 400\n" for i in (0, 1, 7, 8))
    poses = "".join(f"VERTEX_SE2 {i} {i} 0 0\n" for i in (0, 1, 2, 7, 8, 9))
    two.write_text(poses + text)
    done = certpgo("certify", two, two, "--components", "each", "--rejected", csv)
    assert done.code == 1
    assert "--rejected lists measurements of one component: --components largest" in flat(done.err)


def test_rejected_measurements_of_one_component_are_listed(certpgo, wrong, tmp_path):
    two = tmp_path / "two.g2o"
    edge = next(line for line in wrong.read_text().splitlines() if line.startswith("EDGE")).split()
    two.write_text(wrong.read_text() + " ".join([edge[0], "98", "99", *edge[3:]]) + "\n")
    assert "--components largest" in flat(certpgo("outliers", two).err)
    assert certpgo("outliers", two, "--components", "each").code != 0
    report = certpgo("outliers", two, "--components", "largest", "--json").json
    assert len(report["rejected"]) == 40


#: A loop of three nodes with a wrong measurement beside the right one, its price 40, and two tails.
LOOP = [(8, 9, 1, 0, 0), (8, 1, 1, 0, 0), (1, 2, 1, 0, 0), (1, 2, 5, 0, 1.5), (2, 3, 1, 0, 0)]
LOOP += [(3, 1, -2, 0, 0)]
LISTED = "edge,i,j,price\n2,1,2,40\n"


def loop_files(tmp_path, covered):
    """The graph, poses of some nodes at their places without the wrong one, and the list."""
    graph, poses, csv = (tmp_path / name for name in ("loop.g2o", "poses.g2o", "rejected.csv"))
    line = "EDGE_SE2 {} {} {} {} {} 100 0 0 100 0 100\n"
    graph.write_text("".join(line.format(*edge) for edge in LOOP))
    at = {1: 0, 2: 1, 3: 2, 8: -1, 9: 0}
    poses.write_text("".join(f"VERTEX_SE2 {k} {at[k]} 0 0\n" for k in covered))
    csv.write_text(LISTED)
    return graph, poses, csv


def least_truncated_cost(rejected, price):
    """F of `LOOP` by SciPy, with one measurement up to its price, from several starts."""

    def residuals(x, edges):
        t, a = np.split(x.reshape(-1, 3), [2], axis=1)
        place = {1: 0, 2: 1, 3: 2, 8: 3, 9: 4}
        for i, j, *moved, turn in edges:
            i, j = place[i], place[j]
            c, s = np.cos(a[i, 0]), np.sin(a[i, 0])
            yield 10.0 * (t[j] - t[i] - [c * moved[0] - s * moved[1], s * moved[0] + c * moved[1]])
            off = 0.5 * (a[j, 0] - a[i, 0] - turn)
            yield [10.0 * np.sqrt(8.0) * np.sin(off)]

    def least(edges):
        starts = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 15))
        one = lambda x: np.concatenate(list(residuals(x, edges)))  # noqa: E731
        return min(2.0 * optimize.least_squares(one, x, xtol=1e-15).cost for x in starts)

    return min(least(LOOP), price + least([e for k, e in enumerate(LOOP) if k != rejected]))


@pytest.mark.parametrize("covered", [(1, 2, 3, 8, 9), (1, 2, 3, 8)])
def test_rejections_name_measurements_of_the_file_for_estimates_of_a_part(
    certpgo, tmp_path, covered
):
    graph, poses, csv = loop_files(tmp_path, covered)
    found = certpgo("certify", graph, poses, "--cost", "chordal", "--rejected", csv, "--json").json
    assert found["verdict"] == "BOUNDED"
    assert found["lower_bound"] == pytest.approx(least_truncated_cost(2, 40.0), rel=1e-6)
    assert found["lower_bound"] == pytest.approx(622.8986, abs=1e-3)


def test_rejections_of_what_an_estimate_lacks_do_not_count_and_are_counted(certpgo, tmp_path):
    graph, poses, csv = loop_files(tmp_path, (1, 2, 3, 8))
    csv.write_text("edge,i,j,price\n0,8,9,40\n3,1,2,40\n")
    done = certpgo("certify", graph, poses, "--cost", "chordal", "--rejected", csv, "--json")
    assert done.json["verdict"] == "CERTIFIED"
    assert done.json["cost"] == pytest.approx(40.0)
    assert "1 rejected measurement of 2 not between its nodes" in flat(done.err)


def test_without_any_rejected_measurement_a_part_is_judged_as_it_is(certpgo, tmp_path):
    graph, poses, csv = loop_files(tmp_path, (1, 2, 3))
    csv.write_text("edge,i,j,price\n0,8,9,40\n")
    done = certpgo("certify", graph, poses, "--cost", "chordal", "--rejected", csv, "--json")
    assert done.json["certificate"]["rejected"] == 0
    # The wrong one misses by 4 m and 1.5 radians: 100 (16 + 8 sin^2(.75)).
    assert done.json["cost"] == pytest.approx(1600 + 800 * np.sin(0.75) ** 2)
    csv.write_text("edge,i,j,price\n7,8,9,40\n")
    done = certpgo("certify", graph, poses, "--cost", "chordal", "--rejected", csv)
    assert "edge 7 of loop is not one of its measurements" in flat(done.err)


def test_tables_and_json_name_measurements_of_a_component_by_their_number_in_the_file(
    certpgo, tmp_path
):
    rng = np.random.default_rng(3)
    exact = [(k, (k + 1) % 6, 1.0, 0.0, np.pi / 3) for k in range(6)]
    noisy = [(*e[:2], *(np.array(e[2:]) + 0.01 * rng.standard_normal(3))) for e in 4 * exact]
    loops = [(50, 51, 1, 0, 0), *noisy, (0, 3, 5.0, 1.0, 1.0), *noisy]
    path = tmp_path / "graph.g2o"
    line = "EDGE_SE2 {} {} {} {} {} 10000 0 0 10000 0 10000\n"
    path.write_text("".join(line.format(*edge) for edge in loops))
    expected = [{"edge": 25, "ids": [0, 3]}]
    chosen = (path, "--components", "largest")
    assert certpgo("solve", *chosen, "--robust", "--json").json["solution"]["rejected"] == expected
    report = certpgo("outliers", *chosen, "--json", "--csv", tmp_path / "out.csv").json
    assert [(e["edge"], e["i"], e["j"]) for e in report["rejected"]] == [(25, 0, 3)]
    assert {25} <= {e for core in report["cores"] for e in core} <= set(range(1, len(loops)))
    assert (tmp_path / "out.csv").read_text().splitlines()[1].startswith("25,0,3,")
    doubted = certpgo("solve", *chosen, "--json").json["disagreement"]
    assert doubted["edges"] == expected


def test_what_holds_fixed_nodes_is_in_no_count(certpgo, tmp_path):
    """Of seven measurements beside those between held nodes, one is wrong."""
    ends = [
        (0, 1, 1.1),
        (1, 2, 1),
        (2, 3, 1),
        (0, 3, 1),
        (0, 2, 2),
        (0, 2, 7),
        (0, 2, 2),
        (1, 3, 2),
    ]
    lines = [f"EDGE_SE2 {i} {j} {x} 0.1 0 100 0 0 100 0 100" for i, j, x in ends]
    poses = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(4)]
    path, price = tmp_path / "held.g2o", tmp_path / "price.csv"
    path.write_text("\n".join([*poses, "FIX 0 3", *lines]) + "\n")
    info = certpgo("info", path, "--json").json
    assert (info["edges"], info["bridges"], info["parallel_edges"]) == (7, 0, 2)
    assert info["measurements"] == {"between": 7, "held": 1}
    solved = certpgo("solve", path, "--robust", "--cost", "chordal", "--json").json
    assert solved["solution"]["kept"] == 6
    assert solved["solution"]["rejected"] == [{"edge": 5, "ids": [0, 2]}]
    assert solved["fit"]["degrees_of_freedom"] == 3 * 6 - 3 * 2
    assert solved["solution"]["rejection"]["quantile"] == pytest.approx(1.0 - 0.01 / 7, rel=1e-15)
    said = flat(certpgo("outliers", path, "--cost", "chordal", "--csv", price).out)
    assert "6 of 6 kept ones" in said
    assert price.read_text().splitlines()[1].startswith("5,0,2,")
    chosen = ("--methods", "newton", "--out", tmp_path / "compared", "--json")
    assert {row["edges"] for row in certpgo("compare", path, *chosen).json} == {7}


@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_a_changed_noise_is_said_first_and_the_stated_one_judged_too(certpgo, tmp_path, cost):
    """Loop closures of a circle that are written as their inverses; its steps are exact."""
    path, csv, n, loops = tmp_path / "inverses.g2o", tmp_path / "rejected.csv", 40, 8
    angle = 2.0 * np.pi / n
    place = np.exp(1j * angle * np.arange(n))

    def line(i, j, k, turn):
        step = (place[k] - place[i]) * np.exp(-1j * angle * i)
        numbers = f"{float(step.real)!r} {float(step.imag)!r} {float(turn)!r}"
        return f"EDGE_SE2 {i} {j} {numbers} 4e4 0 0 4e4 0 4e4\n"

    steps = [line(i, i + 1, i + 1, angle) for i in range(n - 1)]
    # Seen from i, node i - 6 is where i + 6 should be.
    wrong = [line(i, i + 6, i - 6, -6.0 * angle) for i in range(6, 6 + 3 * loops, 3)]
    path.write_text("".join([*steps, *wrong]))
    found = certpgo("outliers", path, "--cost", cost, "--csv", csv, "--json").json
    m = n - 1 + loops
    exact = exceeded_by(Quadratic(read(path).graph), 0.01 / m)[0]
    price = chi2.isf(0.01 / m, 3) if cost == "g2o" else exact
    stated = found["at_stated_noise"]
    assert next(iter(found)) == "noise_scale"
    assert found["noise_scale"] > 2.0
    assert [one["edge"] for one in sorted(stated["rejected"], key=lambda e: e["edge"])] == list(
        range(n - 1, m)
    )
    assert stated["cost"] == pytest.approx(loops * price, rel=1e-9)
    if not found["rejected"]:
        assert len(csv.read_text().splitlines()) == 1 + loops
    said = certpgo("outliers", path, "--cost", cost).out
    assert said.splitlines()[0].startswith(f"noise  taken as {found['noise_scale']:.3g} times")
    assert f"at the stated noise {loops} rejected, truncated cost" in flat(said)
    assert "assuming noise as stated" in flat(said)
    report = certpgo("solve", path, "--cost", cost, "--robust", "--json").json["solution"]
    assert report["noise_scale"] == found["noise_scale"]
    assert [one["edge"] for one in report["at_stated_noise"]["rejected"]] == list(range(n - 1, m))
    robust = flat(certpgo("solve", path, "--cost", cost, "--robust").out)
    assert "noise taken as" in robust
    assert ("with those rejected" in robust) == bool(len(report["rejected"]))


def test_a_robust_stream_is_judged_by_the_cost_of_its_file(certpgo, tmp_path):
    path = tmp_path / "spatial.g2o"
    upper = " ".join("100" if i == j else "0" for i in range(6) for j in range(i, 6))
    lines = [f"EDGE_SE3:QUAT {i} {i + 1} 1 0 0 0 0 0 1 {upper}\n" for i in range(3)]
    path.write_text("".join(lines))
    assert "g2o's chi2 of EdgeSE3:QUAT" in flat(certpgo("follow", path, "--robust").out)
    of_f = certpgo("follow", path, "--robust", "--cost", "chordal")
    assert "chordal cost F" in flat(of_f.out)
