"""Commands on graphs with nodes of unknown scale: solve and certify; others refuse in a line."""

from dataclasses import replace

import numpy as np
import pytest

import certpgo as library
from certpgo import InputError, Instance
from certpgo.io.datasets.monocular import random_maps


@pytest.fixture
def essential(tmp_path):
    graph, truth = random_maps(np.random.default_rng(0), 3, known=(), turn=0.1)
    path = tmp_path / "essential.g2o"
    library.write(path, Instance("essential", graph, np.arange(8), initial=truth))
    return path


def test_an_essential_graph_is_solved_and_its_answer_certified(certpgo, essential, tmp_path):
    out = tmp_path / "solved.g2o"
    done = certpgo("solve", essential, "-o", out)
    assert done.code == 0
    assert done.out.startswith("CERTIFIED")
    assert "F over similarities, in the unit of the poses of known scale" in done.out
    assert certpgo("certify", essential, out).code == 0
    assert certpgo("certify", essential, out, "--json").json["verdict"] == "CERTIFIED"
    said = certpgo("info", essential).out
    assert "unknown of 7 nodes" in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "{}", "--robust"),
        ("solve", "{}", "--cost", "g2o"),
        ("solve", "{}", "--cost", "gtsam"),
        ("solve", "{}", "--tier", "proof"),
        ("solve", "{}", "--proof", "p.cert"),
        ("solve", "{}", "--method", "eigen_ma"),
        ("solve", "{}", "--covariances", "c.csv"),
        ("outliers", "{}"),
        ("bounds", "{}"),
        ("sparsify", "{}", "--keep", "50%", "-o", "s.g2o"),
        ("suggest", "{}"),
        ("follow", "{}"),
        ("convert", "{}", "c.pyfg"),
        ("certify", "{}", "{}", "--tier", "proof"),
        ("certify", "{}", "{}", "--cost", "g2o"),
    ],
    ids=lambda given: " ".join(given).replace("{} ", ""),
)
def test_what_cannot_treat_scales_says_so(certpgo, essential, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    done = certpgo(*(word.format(essential) for word in arguments))
    assert done.code == 1, done.out
    assert "Traceback" not in done.err
    [line] = [line for line in done.err.splitlines() if line.startswith("certpgo: ")]
    assert any(word in line for word in ("scale", "similarities")), line
    assert sorted(tmp_path.iterdir()) == before


def test_the_cost_of_logarithms_has_a_bound_near_its_scales(certpgo, essential, tmp_path):
    out = tmp_path / "solved.g2o"
    done = certpgo("solve", essential, "--scales-within", "1.05", "-o", out)
    assert done.code == 0
    assert "of logarithms; no certificate is about it" in done.out
    assert "within a factor 1.05 of their root mean square" in done.out
    assert "CERTIFIED" not in done.out
    assert out.read_text().count("VERTEX_SIM3:EXPMAP") == 8
    found = certpgo("solve", essential, "--scales-within", "1.05", "--json").json
    assert 0.8 * found["cost"] < found["lower_bound"] < found["cost"]
    for more, said in (
        (("--html", tmp_path / "p.html"), "not --html"),
        (("--cost", "chordal"), "not --cost"),
        (("--robust",), "--robust is not for"),
    ):
        refused = certpgo("solve", essential, "--scales-within", "1.05", *more)
        assert refused.code == 1
        assert said in refused.err
    assert "at least 1" in certpgo("solve", essential, "--scales-within", "0.5").err


def test_functions_refuse_too():
    graph, truth = random_maps(np.random.default_rng(0), 3)
    instance = Instance("map", graph, np.arange(8), truth=truth)
    there = np.zeros((1, 3))
    for call in (
        lambda: library.with_priors(graph, [1], translations=there, tau=1.0),
        lambda: library.with_directions(graph, [1], there + 1.0, kappa=1.0),
        lambda: library.solve_robustly(instance),
        lambda: library.sparsify(instance, 0.5),
        lambda: library.suggest_loops(graph),
        lambda: library.certify(graph, truth, rejected=np.array([0])),
        lambda: library.Session().add(graph),
        lambda: library.RobustSession().add(graph),
        lambda: library.merge([graph, graph], graph, offset=100),
        lambda: library.solve(instance).covariance(1),
        lambda: library.solve(graph, tier="proof"),
        lambda: library.solve(replace(instance, ranges=library.Ranges(8, [[0, 1]], [1.0], [1.0]))),
    ):
        with pytest.raises(InputError, match=r"scale|similarities"):
            call()


def test_g2o_holds_no_map_without_any_known_scale(tmp_path):
    graph, _ = random_maps(np.random.default_rng(0), 3)
    with pytest.raises(InputError, match=r"one known scale: \.npz"):
        library.write(tmp_path / "map.g2o", replace(graph, free=np.ones(8, dtype=bool)))
    assert not list(tmp_path.iterdir())
