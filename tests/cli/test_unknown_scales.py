"""Commands on graphs with nodes of unknown scale: solve and certify; others refuse in a line."""

import re
from dataclasses import replace

import numpy as np
import pytest

import certpgo as library
from certpgo import InputError, Instance
from certpgo.graph.held import with_held
from certpgo.io.datasets.monocular import in_one_unit, random_maps
from certpgo.io.stream import piped


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
    assert re.search(r"largest residual .* degrees, [\d.]+ units\n", done.out)
    assert re.search(r"costliest edges .* [\d.e-]+ units\n", done.out)
    assert certpgo("certify", essential, out).code == 0
    assert certpgo("certify", essential, out, "--json").json["verdict"] == "CERTIFIED"
    said = certpgo("info", essential).out
    assert "unknown of 7 nodes" in said
    assert "rotations alone, all weights 1" in said
    assert "F over similarities (default)" in said
    assert not {"residual-angle", "chordal", "m^2"} & set(said.replace(",", " ").split())
    shown = str(library.read(essential, quiet=True)).splitlines()
    assert [line.split()[0] for line in shown].count("connected") == 1


def test_a_page_states_commands_that_work(certpgo, essential, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert certpgo("solve", essential.name, "--html", "page.html").code == 0
    page = (tmp_path / "page.html").read_text()
    stated = re.findall(r"certpgo ((?:solve|certify|check) essential\.g2o[^<\n]*)", page)
    assert [command.split()[0] for command in stated] == ["solve", "certify", "check"]
    for command in stated:
        assert certpgo(*command.split()).code == 0, command


def test_a_map_without_a_unit_is_compared_with_truth_after_a_similarity(certpgo, tmp_path):
    graph, truth = random_maps(np.random.default_rng(0), 3)
    path, scale = tmp_path / "map.npz", 20.0
    library.write(path, graph.with_unknown_scales(~graph.is_point))
    found = []
    for factor in (1.0, scale):
        t = tmp_path / f"{factor:g}.tum"
        library.write(t, library.Estimate(truth.rotations, factor * truth.translations))
        found.append(certpgo("solve", path, "--truth", t, "--json").json["accuracy"])
        assert "after the best similarity" in certpgo("solve", path, "--truth", t).out
    assert all(one["scaled"] for one in found)
    for name in ("ate_m", "rpe_m"):
        assert found[1][name] == pytest.approx(scale * found[0][name], rel=1e-6)


def test_proofs_are_written_and_checked(certpgo, essential, tmp_path):
    proof, out = tmp_path / "p.cert", tmp_path / "out.g2o"
    assert certpgo("solve", essential, "-o", out, "--proof", proof).code == 0
    assert certpgo("certify", essential, out, "--tier", "proof", "--proof", proof).code == 0
    done = certpgo("check", essential, proof)
    assert (done.code, done.out[:6]) == (0, "PROVED")
    assert "7 scales unknown, in the unit of the poses of known scale" in done.out
    exact = certpgo("check", essential, proof, "--exact").out
    # Upper bounds in integers and in doubles differ by a last digit on some machines.
    numbers = re.compile(r"<= ([0-9.e+-]+)")
    assert numbers.sub("<=", exact) == numbers.sub("<=", done.out)
    ours, theirs = (list(map(float, numbers.findall(said))) for said in (exact, done.out))
    assert ours == pytest.approx(theirs, rel=1e-12)
    assert certpgo("prove", essential, "--json").json[str(essential)]["proved"]
    whole = tmp_path / "whole.npz"
    assert certpgo("convert", essential, whole).code == 0
    assert certpgo("prove", whole).out.startswith(f"{whole}: PROVED")
    said = certpgo("check", whole, proof)
    assert (said.code, "SHA-256" in said.out) == (6, True)


def test_the_register_tells_them_from_poses(certpgo, essential, tmp_path):
    register = tmp_path / "register"
    register.mkdir()
    added = certpgo("optima", essential, "--add", "--register", register)
    assert (added.code, added.out[:4]) == (0, "new:")
    said = certpgo("optima", essential, "--register", register)
    assert "the optimum of F is proven" in said.out
    instance = library.read(essential, quiet=True)
    others = (
        in_one_unit(instance.graph),
        instance.graph.with_unknown_scales(~instance.graph.is_point),
    )
    for graph in others:
        path = tmp_path / "other.npz"
        library.write(path, replace(instance, graph=graph, initial=None))
        assert "not in the register" in certpgo("optima", path, "--register", register).out


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "{}", "--robust"),
        ("solve", "{}", "--cost", "g2o"),
        ("solve", "{}", "--cost", "gtsam"),
        ("solve", "{}", "--robust", "--proof", "p.cert"),
        ("solve", "{}", "--method", "eigen_ma"),
        ("solve", "{}", "--covariances", "c.csv"),
        ("outliers", "{}"),
        ("bounds", "{}"),
        ("convert", "{}", "c.pyfg"),
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


def test_no_fixed_releases_the_unit(certpgo, essential):
    done = certpgo("solve", essential, "--no-fixed")
    assert done.code == 0
    assert "in the unit of the root mean square scale" in done.out
    assert "no scale is held" in done.err
    free = library.read(essential, fixed=False, quiet=True)
    assert free.graph.in_mean_unit
    two = replace(free, graph=free.graph.with_unknown_scales(np.arange(8) > 1))
    kept = with_held(two, hold=False)
    assert not kept.graph.free[:2].any()
    assert "2 scales are known" in kept.notices[-1]


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
    assert found["verdict"] is None
    assert found["relative_gap"] == pytest.approx(1.0 - found["lower_bound"] / found["cost"])
    assert "up to the rounding of measurements" in done.out
    for more, said in (
        (
            ("--html", tmp_path / "p.html"),
            "certifies nothing that a page or proof could state: not with --html",
        ),
        (("--cost", "chordal"), "not with --cost"),
        (("--robust",), "--robust does not take"),
    ):
        refused = certpgo("solve", essential, "--scales-within", "1.05", *more)
        assert refused.code == 1
        assert said in refused.err
    assert "at least 1" in certpgo("solve", essential, "--scales-within", "0.5").err


def test_the_cost_of_logarithms_beside_the_truth_and_with_a_time_limit(
    certpgo, essential, tmp_path
):
    out, asked = tmp_path / "solved.g2o", ("solve", essential, "--scales-within", "1.05")
    assert certpgo(*asked, "-o", out).code == 0
    found = certpgo(*asked, "--truth", out, "--initial", out, "--json").json
    assert (found["iterations"], found["accuracy"]["poses"]) == (0, 8)
    assert found["accuracy"]["ate_m"] < 1e-6
    ended = certpgo(*asked, "--time-limit", "0", "--json").json
    assert (ended["status"], ended["iterations"], ended["lower_bound"]) == ("time limit", 0, 0.0)
    assert "the cost of logarithms\n" in certpgo(*asked, "--trace").err


def test_each_component_has_its_own_unit(certpgo, essential, tmp_path):
    lines = [line.split() for line in essential.read_text().splitlines()]
    edges = [w for w in lines if w[0].startswith("EDGE")]
    moved = [[w[0], *(str(int(k) + 50) for k in w[1:3]), *w[3:]] for w in edges]
    path = tmp_path / "two.g2o"
    path.write_text("".join(f"{' '.join(w)}\n" for w in [*edges, *moved]))
    first, second = certpgo("solve", path, "--components", "each", "--json").json
    assert first["cost"] > second["cost"]  # of the mean unit
    both = certpgo("solve", path, "--components", "each", "--scales-within", "1.1", "--json").json
    assert both[0]["cost"] == pytest.approx(both[1]["cost"], rel=1e-9)
    refused = certpgo("solve", path, "--components", "each", "--proof", tmp_path / "p.cert")
    assert (refused.code, "connected" in refused.err) == (1, True)


def test_archives_are_proven_however_they_came_about(certpgo, essential, tmp_path):
    text = essential.read_text().splitlines(keepends=True)
    edges = [line for line in text if line.startswith("EDGE")]
    first, second = tmp_path / "1.g2o", tmp_path / "2.g2o"
    first.write_text("".join(line for line in text if line not in edges[4:]))
    second.write_text("".join(edges[4:]))
    joined, proof = tmp_path / "joined.npz", tmp_path / "p.cert"
    options = "--also", second, "--keep", "last", "--unit-weights"
    assert certpgo("convert", first, *options, joined).code == 0
    assert certpgo("solve", joined, "--proof", proof).code == 0
    assert "kappa of the file" in certpgo("check", joined, proof, "--exact").out
    assert certpgo("check", essential, proof).code == 6


def test_numbers_of_similarities_are_information(certpgo, essential):
    for kind in ("covariance", "sqrt-information"):
        done = certpgo("info", essential, "--weights-are", kind)
        assert (done.code, f"not as {kind}" in done.err) == (1, True)


def test_commands_take_distances_with_scales(certpgo, tmp_path):
    """Between nodes of unknown scale, beside points: what describes, solves, judges and draws."""
    graph, truth = random_maps(np.random.default_rng(1), 3, 8, 16, points=2, turn=0.05)
    t = truth.translations
    apart = np.linalg.norm(t[[7, 6]] - t[[1, 2]], axis=1)
    mixed = graph.with_ranges(library.Ranges(graph.num_nodes, [[1, 7], [2, 6]], apart, np.ones(2)))
    path, answer = tmp_path / "map.npz", tmp_path / "answer.npz"
    library.write(path, Instance("map", mixed, np.arange(graph.num_nodes)))
    assert certpgo("info", path).code == 0
    solved = certpgo("solve", path, "--out", answer, "--html", tmp_path / "page.html")
    assert solved.code == 0
    assert solved.out.startswith("CERTIFIED")
    assert certpgo("certify", path, answer).code == 0
    for refused in (("--scales-within", "2"), ("--robust",), ("--no-fixed",), ("--cost", "g2o")):
        done = certpgo("solve", path, *refused)
        assert done.code == 1
        assert len(done.err.strip().splitlines()) <= 2  # a note, and the reason


def test_functions_refuse_too():
    graph, truth = random_maps(np.random.default_rng(0), 3)
    instance = Instance("map", graph, np.arange(8), truth=truth)
    there = np.zeros((1, 3))
    for call in (
        lambda: library.with_directions(graph, [1], there + 1.0, kappa=1.0),
        lambda: library.solve_robustly(instance),
        lambda: library.certify(graph, truth, rejected=np.array([0])),
        lambda: library.RobustSession().add(graph),
        lambda: library.solve(instance).covariance(1),
        lambda: library.reweigh(
            replace(
                instance,
                graph=instance.graph.with_ranges(library.Ranges(8, [[0, 1]], [1.0], [1.0])),
            )
        ),
    ):
        with pytest.raises(InputError, match=r"scale|similarities"):
            call()


def test_g2o_holds_no_map_without_any_known_scale(tmp_path):
    graph, _ = random_maps(np.random.default_rng(0), 3)
    with pytest.raises(InputError, match=r"one known scale: \.npz"):
        library.write(tmp_path / "map.g2o", graph.with_unknown_scales(np.ones(8, dtype=bool)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("released", [(), ("--no-fixed",)])
def test_they_are_followed_to_the_answer_of_solve(certpgo, essential, tmp_path, released):
    out = tmp_path / "followed.g2o"
    done = certpgo("follow", essential, "--every", "4", "--trace", "-o", out, *released)
    assert done.code == 0, done.err
    unit = "root mean square scale" if released else "poses of known scale"
    last = done.out.splitlines()[-1]
    assert f"CERTIFIED: F over similarities, in the unit of the {unit}" in last
    solved = certpgo("solve", essential, "--json", *released).json
    followed = certpgo("follow", essential, "--json", *released).json
    assert followed["cost"] == pytest.approx(solved["cost"], rel=1e-9)
    assert certpgo("certify", essential, out, *released).code == 0


def test_pipes_of_them_are_refused(essential):
    """Each piece would choose a unit of its own."""
    with essential.open("rb") as pipe, pytest.raises(InputError, match="a file of similarities"):
        list(piped(pipe, 4))


def test_positions_in_a_world_are_the_unit_of_commands(certpgo, tmp_path):
    graph, truth = random_maps(np.random.default_rng(0), 3, points=1)
    graph = graph.with_unknown_scales(~graph.is_point)
    graph = library.with_priors(graph, np.arange(5), translations=truth.translations[:5], tau=100.0)
    path, out, proof = (tmp_path / name for name in ("map.npz", "out.npz", "map.cert"))
    library.write(path, Instance("map", graph, np.arange(9), world=8))
    assert "unknown of 7 nodes" in certpgo("info", path).out
    solved = certpgo("solve", path, "-o", out, "--proof", proof)
    assert solved.out.startswith("CERTIFIED")
    assert "in the unit of the poses of known scale" in solved.out
    assert certpgo("check", path, proof, "--exact").code == 0
    assert certpgo("certify", path, out).code == 0
    found = library.read_estimate(out)
    assert found.translations[:5] == pytest.approx(truth.translations[:5], abs=0.2)
    released = certpgo("solve", path, "--no-fixed")
    assert "in the unit of the poses of known scale" in released.out
    assert "the world, which is not released" in released.err
