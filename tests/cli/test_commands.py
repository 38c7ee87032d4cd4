import json
import os
import subprocess
import sys
from itertools import islice

import numpy as np
import pytest
import threadpoolctl
from strategies import pose_graph, rng_of

import certpgo as package
from certpgo.cli import command_names
from certpgo.errors import how_to_install


def test_help_lists_every_command(certpgo):
    done = certpgo("--help")
    assert done.code == 0
    assert all(name in done.out for name in command_names())
    assert "BOUNDED" in done.out


def test_version(certpgo):
    assert certpgo("--version").out == f"certpgo {package.__version__}\n"


@pytest.mark.parametrize("name", command_names())
def test_every_command_explains_itself(certpgo, name):
    done = certpgo(name, "--help")
    assert done.code == 0
    assert "Usage" in done.out


def test_info_in_words(certpgo, square):
    done = certpgo("info", square)
    assert done.code == 0
    assert "poses in 2D" in done.out
    assert "4, ids 0 to 3" in done.out
    assert "inconsistency" in done.out
    assert "symmetry of edges" in done.out


def test_info_is_one_json_document(certpgo, square):
    found = certpgo("info", square, "--json").json
    assert (found["nodes"], found["edges"], found["d"], found["bridges"]) == (4, 4, 2, 0)
    spectrum = found["spectra"]["square"]["unit"]
    assert spectrum["fiedler"] == pytest.approx(2.0, rel=1e-9)  # lambda_2 of a 4-cycle
    assert len(spectrum["smallest"]) == 2
    assert spectrum["inconsistency"] == pytest.approx(spectrum["smallest"][0] / 2.0, rel=1e-9)
    assert (
        -1.0 <= found["symmetry"]["square"]["least"] <= found["symmetry"]["square"]["mean"] <= 1.0
    )


def test_list_is_one_json_document(certpgo):
    listed = certpgo("list", "methods", "engines", "formats", "--json").json
    assert {"eigen_ma", "newton"} <= {row["name"] for row in listed["methods"]}
    assert {"g2o", "npz"} <= {row["name"] for row in listed["formats"]}
    assert [row["name"] for row in listed["engines"] if row["in use"]]


def test_list_in_words(certpgo):
    done = certpgo("list")
    assert done.code == 0
    for word in ("methods", "datasets", "tables", "formats", "engines", "eigen_ma", "sphere2500"):
        assert word in done.out


@pytest.mark.parametrize(
    ("module", "method", "wanted"),
    [
        ("gtsam", "gtsam_chordal", how_to_install("baselines", "gtsam")),
        ("g2opy", "g2o_gauss_newton", how_to_install("baselines", "g2opy")),
        ("pyceres", "ceres_levenberg_marquardt", how_to_install("baselines", "pyceres")),
        ("pymanopt", "pymanopt_trust_region", how_to_install("test", "pymanopt")),
        ("cvxpy", "sdp_dual", "pip install --force-reinstall --no-deps cvxpy-base"),
    ],
)
def test_list_says_why_a_method_is_not_here(certpgo, monkeypatch, module, method, wanted):
    from importlib import util

    find = util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name: None if name == module else find(name)
    )
    rows = certpgo("list", "methods", "--json").json["methods"]
    here = {row["name"]: row["here"] for row in rows}
    assert here[method] == f"no: {wanted}"
    assert here["eigen_ra"] == "yes"


def test_without_cvxpy_the_programs_say_what_to_install(certpgo, square, monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    reason = "CVXPY is not installed: pip install --force-reinstall --no-deps cvxpy-base"
    done = certpgo("solve", square, "--method", "sdp_dual")
    assert done.code == 1
    assert done.err.strip().endswith(reason)
    rungs = certpgo("bounds", square, "--sdp", "--json").json["bounds"]
    [says] = [rung["says"] for rung in rungs if rung["key"] == "sdp"]
    assert says == f"not solved: {reason}"


def test_fetch_prints_the_path(certpgo, dataset_path):
    path = dataset_path("tinyGrid3D")
    assert certpgo("fetch", "tinyGrid3D").out == f"{path}\n"
    assert certpgo("fetch", "tinyGrid3D", "--json").json == {"tinyGrid3D": str(path)}


def test_a_dataset_is_a_graph_by_name(certpgo, dataset_path):
    dataset_path("tinyGrid3D")
    assert certpgo("info", "tinyGrid3D", "--json").json["nodes"] == 9


def test_solve_writes_and_certifies(certpgo, square, tmp_path):
    out = tmp_path / "out.g2o"
    done = certpgo("solve", square, "--method", "newton", "-o", out, "--certify", "--json")
    assert done.code == 0
    assert done.json["verdict"] == "CERTIFIED"
    assert done.json["solution"]["written"] == str(out)
    judged = certpgo("certify", square, out, "--cost", "chordal", "--json")
    assert judged.code == 0
    assert judged.json["cost"] == pytest.approx(done.json["cost"], rel=1e-9)


def test_documents_of_solve_and_certify_have_one_shape(certpgo, square, tmp_path):
    out = tmp_path / "out.g2o"
    solved = certpgo("solve", square, "-o", out, "--json").json
    certified = certpgo("certify", square, out, "--json").json
    shared = solved.keys() & certified.keys()
    assert list(solved)[:5] == ["schema", "graph", "reading", "objective", "verdict"]
    assert solved.keys() - shared == {"solution"}
    assert certified.keys() - shared == {"best", "costliest_edges", "digits"}
    assert {"distance_m", "distance_deg", "distance_node", "distance_reference"} <= shared
    assert solved["certificate"].keys() == certified["certificate"].keys()
    # What is rounded up says so.
    for found in (solved, certified):
        assert "cost" not in found["certificate"]
        assert found["cost"] <= found["certificate"]["cost_upper"]
        assert found["gap"] >= found["cost"] - found["lower_bound"]


def test_solve_certifies_and_says_where_it_started(certpgo, square):
    done = certpgo("solve", square, "--cost", "chordal")
    assert done.code == 0
    assert "CERTIFIED" in done.out
    assert "initialized by laplacian_gauss_newton" in done.out
    report = certpgo("solve", square, "--cost", "chordal", "--json").json
    assert report["solution"]["start"] == "laplacian_gauss_newton"
    assert [level["rank"] for level in report["solution"]["levels"]] == [2]
    assert report["solution"]["counts"]["factorizations"] >= 1
    assert report["verdict"] == "CERTIFIED"


def test_solve_shows_every_iteration_when_asked(certpgo, square):
    done = certpgo("solve", square, "--trace", "--max-rank", "3")
    lines = done.err.splitlines()
    assert lines[0].startswith("g2o's chi2")
    assert "gradient" in lines[1]
    assert len(lines) >= 3


@pytest.mark.parametrize("cost", ["chordal", "g2o", "gtsam"])
def test_a_time_limit_ends_the_search_honestly(certpgo, square, cost):
    done = certpgo("solve", square, "--time-limit", "0", "--cost", cost)
    assert done.code == 5
    assert "time limit" in done.out
    assert "stopped before a useful bound was found" in done.out


def test_a_methods_own_bound_is_told_where_nothing_is_judged(certpgo, square):
    judged = ("solve", square, "--method", "block_coordinate_descent", "--no-certify")
    done = certpgo(*judged)
    assert "the method's own lower bound, which ignores rounding" in done.err
    found = certpgo(*judged, "--json").json
    assert 0.0 <= found["solution"]["own_bound"] <= found["cost"]
    assert found["verdict"] is found["certificate"] is None
    done = certpgo("solve", square, "--method", "spanning_tree", "--no-certify")
    assert "is not known; --certify certifies the estimate" in done.err


def test_solve_by_a_method_without_a_judge_says_so(certpgo, square):
    done = certpgo("solve", square, "--method", "eigen_ma", "--no-certify")
    assert done.code == 0
    assert "eigen_ma" in done.out
    assert "--certify" in done.err


def test_an_answer_that_is_not_certified_says_what_to_try(certpgo, square):
    done = certpgo("solve", square, "--method", "spanning_tree")
    assert done.code == 3
    assert "without --method" in done.err
    assert "objective" in done.out
    assert "weights from the file" in done.out
    chordal = certpgo("solve", square, "--method", "newton", "--cost", "chordal")
    assert "note" not in chordal.err
    default = certpgo("solve", square, "--method", "newton")
    assert "--method minimises the chordal cost F, not the default cost of g2o" in default.err


def test_list_shows_settings_as_they_are_given(certpgo):
    rows = certpgo("list", "methods", "--json").json["methods"]
    settings = {row["name"]: row["settings"] for row in rows}
    assert settings["newton"].startswith("tolerance=1e-12, max_iterations=100, ")
    assert "patience=30.0" in settings["certified"]
    assert "anchor=none" in settings["eigen_ra"]
    assert not any("`" in row["what"] for row in rows)


def test_a_reader_that_has_gone_gets_no_traceback_and_no_verdict():
    code = "from certpgo.cli import main; raise SystemExit(main(['list']))"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


def test_solve_starts_where_it_is_told_and_obeys_settings(certpgo, square):
    settings = ("--method", "newton", "--set", "max_iterations=1", "--initial", square)
    done = certpgo("solve", square, *settings, "--json")
    assert done.json["solution"]["iterations"] == 1
    assert done.json["solution"]["status"] == "iteration limit"


def test_certify_polishes(certpgo, square, tmp_path):
    best = tmp_path / "best.g2o"
    poor = certpgo("certify", square, square, "--best", best, "--json")
    assert poor.code == 3
    assert poor.json["verdict"] == "BOUNDED"
    assert poor.json["certificate"]["basin_is_global"]
    assert certpgo("certify", square, best).code == 0


def test_a_wrong_winding_is_refuted(certpgo, tmp_path):
    from certpgo.io.datasets.synthetic import winding_cycle

    instance, wound = winding_cycle(60, 0.0, 1)
    graph, estimate = tmp_path / "cycle.npz", tmp_path / "wound.npz"
    package.write(graph, instance)
    package.write(estimate, wound)
    done = certpgo("certify", graph, estimate)
    assert done.code == 4
    assert done.out.startswith("REFUTED")
    assert "lower cost" in done.out


@pytest.mark.parametrize(
    ("old", "new"), [(("--tier", "screen"), "--tier standard"), (("--mahalanobis",), "--cost g2o")]
)
def test_an_option_of_earlier_versions_names_its_successor(certpgo, square, old, new):
    done = certpgo("solve", square, *old)
    assert (done.code, done.out) == (1, "")
    assert new in done.err
    assert len(done.err.splitlines()) == 1
    assert "screen" not in certpgo("certify", "--help").out


def test_convert_a_graph_there_and_back(certpgo, square, tmp_path):
    there, back = tmp_path / "a.npz", tmp_path / "b.g2o"
    assert certpgo("convert", square, there).code == 0
    assert certpgo("convert", there, back).code == 0
    first, second = (package.read(path, quiet=True).graph for path in (square, back))
    np.testing.assert_array_equal(first.kappa, second.kappa)
    np.testing.assert_array_equal(first.translations, second.translations)
    costs = [certpgo("solve", p, "--cost", "g2o", "--json").json["cost"] for p in (square, there)]
    assert costs[0] == costs[1]


def test_convert_to_the_weights_of_f(certpgo, tmp_path):
    """The optimum of F stays, that of g2o's cost does not."""
    names = ("uneven", "full", "isotropic")
    uneven, full, isotropic = (tmp_path / f"{name}.g2o" for name in names)
    turns = (1.57, 1.6, 1.5, 1.57)
    lines = [
        f"EDGE_SE2 {k} {(k + 1) % 4} 1.{k} 0.{k} {turn} {10**k} 0 0 100 0 50"
        for k, turn in enumerate(turns)
    ]
    uneven.write_text("\n".join(lines))
    certpgo("convert", uneven, full)
    certpgo("convert", uneven, isotropic, "--isotropic")
    costs = {
        (path, cost): certpgo("solve", path, "--cost", cost, "--json").json["cost"]
        for path in (uneven, full, isotropic)
        for cost in ("chordal", "g2o")
    }
    assert costs[full, "g2o"] == costs[uneven, "g2o"]
    assert costs[isotropic, "chordal"] == pytest.approx(costs[uneven, "chordal"], rel=1e-9)
    assert costs[isotropic, "g2o"] != pytest.approx(costs[uneven, "g2o"], rel=1e-2)
    done = certpgo("convert", uneven, isotropic, "--estimate", "--isotropic")
    assert done.code == 1


def test_convert_the_poses_alone(certpgo, square, tmp_path):
    poses = tmp_path / "poses.npz"
    done = certpgo(
        "convert", square, poses, "--estimate", "--graph", square, "--anchor", "identity"
    )
    assert done.code == 0
    np.testing.assert_allclose(
        package.read_estimate(poses).translations[2], [1.0, 1.0], atol=1e-12, rtol=0
    )


@pytest.mark.parametrize("suffix", [".g2o", ".npz"])
def test_a_file_that_holds_an_estimate_alone_is_converted_as_one(certpgo, square, tmp_path, suffix):
    estimate, out = tmp_path / f"solved{suffix}", tmp_path / f"out{suffix}"
    certpgo("convert", square, estimate, "--estimate")
    assert certpgo("convert", estimate, out, "--anchor", "identity").code == 0
    assert package.read_estimate(out).num_nodes == 4


@pytest.mark.parametrize("option", [("--graph", "square.g2o"), ("--anchor", "identity")])
def test_options_for_estimates_are_refused_for_a_graph(
    certpgo, square, tmp_path, option, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    done = certpgo("convert", square, "out.g2o", *option)
    assert done.code == 1
    assert f"{option[0]} is about estimates" in done.err
    assert not (tmp_path / "out.g2o").exists()


def test_convert_a_dataset_by_name(certpgo, tmp_path, dataset_path):
    dataset_path("tinyGrid3D")
    assert certpgo("convert", "tinyGrid3D", tmp_path / "graph.npz").code == 0
    assert certpgo("convert", "tinyGrid3D", tmp_path / "poses.g2o", "--estimate").code == 0
    assert package.read_estimate(tmp_path / "poses.g2o").num_nodes == 9


@pytest.mark.parametrize("choice", ["refuse", "largest", "each"])
def test_components_are_refused_or_chosen(certpgo, tmp_path, choice):
    path = tmp_path / "two.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in (0, 1, 5)]
    path.write_text("\n".join(lines) + "\n")
    out = tmp_path / "out.g2o"
    done = certpgo("solve", path, "--components", choice, "-o", out, "--json")
    written = sorted(p.name for p in tmp_path.glob("out*"))
    if choice == "refuse":
        assert done.code == 1
        assert "2 components of 3, 2 nodes" in done.err
        assert written == []
    elif choice == "largest":
        assert done.json["graph"].endswith("[3 nodes from id 0]")
        assert written == ["out.g2o"]
    else:
        assert len(done.json) == 2
        assert written == ["out-0.g2o", "out-5.g2o"]


def test_info_of_a_disconnected_graph_is_no_error(certpgo, tmp_path):
    path = tmp_path / "two.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n")
    found = certpgo("info", path, "--json").json
    assert found["component_sizes"] == [2, 2]
    assert found["spectra"] == {}
    assert len(certpgo("info", path, "--components", "each", "--json").json["spectra"]) == 2


def results(folder):
    return [json.loads(line) for line in (folder / "compare.jsonl").read_text().splitlines()]


def test_compare_prints_and_writes(certpgo, square, tmp_path):
    out = tmp_path / "results"
    methods = ("--methods", "spanning_tree,eigen_ma + newton")
    done = certpgo("compare", square, *methods, "--out", out)
    assert done.code == 0
    assert "CERTIFIED" in done.out
    assert sorted(path.name for path in out.iterdir()) == [
        "compare.jsonl",
        "compare.md",
        "compare.tex",
    ]
    assert [found["method"] for found in results(out)] == ["spanning_tree", "eigen_ma + newton"]
    assert "| spanning_tree |" in (out / "compare.md").read_text()
    again = tmp_path / "again"
    assert certpgo("report", "--results", out, "--out", again).out.startswith("square (4 nodes")
    for name in ("compare.md", "compare.tex"):
        assert (again / name).read_text() == (out / name).read_text()
    assert len((again / "compare.csv").read_text().splitlines()) == 3
    said = certpgo("report", "--results", out, "--html", tmp_path / "page.html").err
    assert "--html is a page of papers' tables" in said
    tex = (out / "compare.tex").read_text()
    assert "\nspanning\\_tree & " in tex
    assert tex.count("\\begin{tabular}") == tex.count("\\end{tabular}") > 0


def test_compare_shows_columns_and_notes_that_say_something(certpgo, square, tmp_path):
    out = tmp_path / "results"
    plain = certpgo("compare", square, "--methods", "spanning_tree", "--out", out).out
    assert "kept, %" not in plain
    assert "GTSAM" not in plain
    robust = "graduated_non_convexity"
    assert "kept, %" in certpgo("compare", square, "--methods", robust, "--out", out).out
    assert "kept, %" in (out / "compare.md").read_text()


def test_compare_names_the_cost_it_judges_by(certpgo, square, tmp_path):
    common = ("compare", square, "--methods", "certified,certified (F),newton", "--cost", "g2o")
    done = certpgo(*common, "--out", tmp_path / "r")
    assert done.code == 0
    name = "g2o's chi2 of EdgeSE2 with full information"
    assert f"square (4 nodes, 4 edges, 2D): {name}" in done.out
    assert f"2D): {name}" in (tmp_path / "r" / "compare.md").read_text()
    assert "gap / cost" in done.out
    assert "1e-5 of the cost" in done.out
    rows = results(tmp_path / "r")
    assert [row["minimised"] for row in rows] == ["g2o", "chordal", "chordal"]
    assert {row["objective"] for row in rows} == {name}


def test_a_graph_without_the_cost_fails_the_comparison_or_is_a_row(certpgo, square, tmp_path):
    path, out = tmp_path / "poses.npz", tmp_path / "r"
    package.write(path, package.Instance("poses", pose_graph(rng_of(0), 5, 2)[0], np.arange(5)))
    common = ("--methods", "certified", "--cost", "gtsam", "--out", out, "--json")
    alone = certpgo("compare", path, *common)
    assert (alone.code, alone.out, alone.err.count("\n")) == (1, "", 1)
    assert "--cost gtsam needs poses with information matrices" in alone.err
    assert not out.exists()
    mixed = certpgo("compare", path, square, *common)
    assert mixed.code == 1
    left_out, fine = mixed.json
    assert left_out["error"].startswith("not compared: ")
    assert fine["verdict"] == "CERTIFIED"


def test_compare_writes_through_a_link(certpgo, square, tmp_path):
    out, elsewhere = tmp_path / "results", tmp_path / "elsewhere.jsonl"
    out.mkdir()
    (out / "compare.jsonl").symlink_to(elsewhere)
    assert certpgo("compare", square, "--methods", "spanning_tree", "--out", out).code == 0
    assert (out / "compare.jsonl").is_symlink()
    assert len(elsewhere.read_text().splitlines()) == 1
    assert sorted(path.name for path in out.iterdir()) == [
        "compare.jsonl",
        "compare.md",
        "compare.tex",
    ]


def test_compare_reads_as_it_is_told(certpgo, square, tmp_path):
    common = ("compare", square, "--methods", "newton", "--out", tmp_path / "r", "--json")
    [file], [unit] = certpgo(*common).json, certpgo(*common, "--unit-weights").json
    assert (file["reading"]["weights"], unit["reading"]["weights"]) == ("file", "unit")
    assert file["cost"] != unit["cost"]


def test_compare_takes_components_one_by_one(certpgo, tmp_path):
    path = tmp_path / "two.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in (0, 1, 5)]
    path.write_text("\n".join(lines) + "\n")
    common = ("compare", path, "--methods", "newton", "--out", tmp_path / "r", "--json")
    refused = certpgo(*common)
    assert (refused.code, refused.out) == (1, "")
    assert "2 components of 3, 2 nodes" in refused.err
    parts = certpgo(*common, "--components", "each").json
    assert [found["nodes"] for found in parts] == [3, 2]
    assert len({found["graph"] for found in parts}) == 2
    assert all(found["verdict"] == "CERTIFIED" for found in parts)


def test_compare_leaves_out_methods_for_other_graphs_unless_asked(certpgo, tmp_path):
    from certpgo.io.datasets.synthetic import winding_cycle

    path = tmp_path / "cycle.npz"
    package.write(path, winding_cycle(5, 0.1, 0)[0])
    common = ("compare", path, "--out", tmp_path / "r", "--json")
    methods = [found["method"] for found in certpgo(*common).json]
    assert "eigen_ra" in methods
    assert "eigen_ma" not in methods
    [asked] = certpgo(*common, "--methods", "eigen_ma").json
    assert "takes pose graphs only" in asked["error"]


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
@pytest.mark.parametrize("count", [0, 1])
def test_a_comparison_that_is_cut_short_keeps_what_is_done(
    certpgo, square, tmp_path, monkeypatch, count, error
):
    from certpgo.solve import comparison

    common = ("compare", square, "--methods", "newton,eigen_ma", "--out", tmp_path / "r")
    certpgo(*common)
    before = files(tmp_path / "r")
    whole = comparison.compare

    def cut_short(*args, **kwargs):
        yield from islice(whole(*args, **kwargs), count)
        raise error

    monkeypatch.setattr(comparison, "compare", cut_short)
    if error is RuntimeError:
        with pytest.raises(RuntimeError):
            certpgo(*common)
    else:
        done = certpgo(*common)
        assert done.code == 130
        assert "interrupted" in done.err
        assert (
            f"1 result so far kept in {tmp_path / 'r' / 'compare.jsonl.partial'}" in done.err
        ) == count
        assert ("newton" in done.out) == count
    after = files(tmp_path / "r")
    partial = after.pop("compare.jsonl.partial", b"")
    assert after == before
    assert [json.loads(line)["method"] for line in partial.splitlines()] == ["newton"][:count]
    monkeypatch.undo()
    certpgo(*common)
    assert files(tmp_path / "r").keys() == before.keys()


def test_rows_of_a_comparison_are_written_as_they_come(certpgo, square, tmp_path, monkeypatch):
    from certpgo.solve import comparison

    solved, written = comparison.solution_of, []

    def noted(*args, **options):
        path = tmp_path / "r" / "compare.jsonl.partial"
        written.append(len(path.read_text().splitlines()) if path.exists() else 0)
        return solved(*args, **options)

    monkeypatch.setattr(comparison, "solution_of", noted)
    certpgo("compare", square, "--methods", "newton,eigen_q,certified", "--out", tmp_path / "r")
    assert written == [0, 1, 2]


def test_rows_of_a_comparison_state_their_shape(certpgo, square, tmp_path):
    done = certpgo("compare", square, "--methods", "newton", "--out", tmp_path / "r", "--json")
    assert [row["schema"] for row in (*done.json, *results(tmp_path / "r"))] == [2, 2]


def test_without_a_checkout_the_default_methods_are_those_of_the_wheel(
    certpgo, square, tmp_path, monkeypatch
):
    monkeypatch.setenv("CERTPGO_REPOSITORY", str(tmp_path))
    done = certpgo("compare", square, "--out", tmp_path / "r", "--json")
    assert [row["error"] for row in done.json] == [""] * len(done.json)
    [line] = [line for line in done.err.splitlines() if "gtsam_chordal" in line]
    assert line.startswith("note: not compared, as these are in a checkout only: gtsam_chordal, ")
    asked = certpgo("compare", square, "--methods", "gtsam_chordal", "--out", tmp_path / "s")
    assert (asked.code, "unknown method" in asked.err) == (1, True)


def test_methods_are_compared_on_one_thread(certpgo, square, tmp_path, monkeypatch):
    from certpgo.optimize.methods.spanning_tree import SpanningTree

    solve, threads = SpanningTree.solve, []

    def noted(self, problem, **more):
        threads.extend(pool["num_threads"] for pool in threadpoolctl.threadpool_info())
        return solve(self, problem, **more)

    monkeypatch.setattr(SpanningTree, "solve", noted)
    with threadpoolctl.threadpool_limits(limits=2):
        if all(pool["num_threads"] == 1 for pool in threadpoolctl.threadpool_info()):
            pytest.skip("this machine has one thread")
        certpgo("compare", square, "--methods", "spanning_tree", "--out", tmp_path / "r")
    assert set(threads) == {1}


def test_a_method_that_breaks_is_a_row_with_the_reason(certpgo, square, tmp_path, monkeypatch):
    from certpgo.optimize.methods.spanning_tree import SpanningTree

    def breaks(self, problem, **more):
        raise ZeroDivisionError("by design\nand more")

    monkeypatch.setattr(SpanningTree, "solve", breaks)
    methods = ("--methods", "spanning_tree,newton", "--cost", "chordal")
    broken, fine = certpgo("compare", square, *methods, "--out", tmp_path / "r", "--json").json
    assert (broken["error"], broken["cost"]) == ("ZeroDivisionError: by design", None)
    assert fine["verdict"] == "CERTIFIED"


def test_a_named_graph_that_cannot_be_read_fails_the_comparison(certpgo, square, tmp_path):
    bad = tmp_path / "bad.g2o"
    bad.write_text("EDGE_SE2 0 1 1 0\n")
    common = ("--methods", "newton", "--out", tmp_path / "r")
    done = certpgo("compare", bad, *common)
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert "bad.g2o:1" in done.err
    assert not (tmp_path / "r").exists()
    mixed = certpgo("compare", square, bad, *common)
    assert mixed.code == 1
    assert "bad.g2o:1" in mixed.err
    fine, unread = results(tmp_path / "r")
    assert (fine["method"], fine["error"]) == ("newton", "")
    assert (unread["graph"], unread["method"], unread["nodes"]) == (str(bad), "", None)
    assert "bad.g2o:1" in unread["error"]
    assert f"## {bad}\n\nnot compared: " in (tmp_path / "r" / "compare.md").read_text()
    first = certpgo("compare", bad, square, *common)
    assert (first.code, "Methods side by side" in first.out) == (1, True)


def test_a_graph_in_pieces_is_a_row_with_the_reason(certpgo, square, tmp_path):
    path = tmp_path / "two.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in (0, 1, 5)]
    path.write_text("\n".join(lines) + "\n")
    common = ("--methods", "certified", "--out", tmp_path / "r", "--json")
    done = certpgo("compare", path, square, *common)
    assert done.code == 1
    assert "2 components" in done.err
    apart, fine = done.json
    assert "2 components" in apart["error"]
    assert fine["verdict"] == "CERTIFIED"


def test_reproduce_quick_writes_elsewhere(certpgo, tmp_path):
    name = "moreira2020_table5_6"
    done = certpgo("reproduce", name, "--quick", "--out", tmp_path, "--json")
    assert done.code == 0
    assert [record["table"] for record in json.loads(done.out)] == [name]
    assert [path.name for path in tmp_path.iterdir()] == ["quick"]


def test_bench_scale_measures_growth_and_goes_on(certpgo, tmp_path):
    arguments = ("bench", "scale", "--family", "grid", "--size", "3", "--size", "4")
    done = certpgo(*arguments, "--out", tmp_path)
    assert done.code == 0
    assert "CERTIFIED" in done.out
    assert "power of the nodes" in done.out
    before = (tmp_path / "scale_grid.jsonl").read_text()
    again = certpgo(*arguments, "--out", tmp_path, "--json")
    assert [record["n"] for record in again.json] == [27, 64]
    assert (tmp_path / "scale_grid.jsonl").read_text() == before


@pytest.fixture
def answers(certpgo, square, tmp_path):
    """The best answer, the same with three decimals, a poor one, and a file that is broken."""
    best, rounded = tmp_path / "best.g2o", tmp_path / "rounded.g2o"
    certpgo("solve", square, "-o", best)
    lines = [line.split() for line in best.read_text().splitlines()]
    rounded.write_text(
        "".join(" ".join([*w[:2], *(f"{float(x):.3f}" for x in w[2:])]) + "\n" for w in lines)
    )
    broken = tmp_path / "broken.g2o"
    broken.write_text("VERTEX_SE2 0 0 0 x\n")
    return best, rounded, square, broken


def test_certify_says_how_far_the_best_answer_is_and_where_the_cost_sits(certpgo, answers):
    _, rounded, square, _ = answers
    done = certpgo("certify", square, rounded, "--cost", "chordal")
    assert done.code == 3
    assert done.out.startswith("BOUNDED. Right basin. ")
    assert "to the optimum: " in done.out
    assert "rounding to the file's 3 decimals raises even the lowest cost by" in done.out
    assert done.out.count("% of the cost, residual") == 3
    assert "Take the estimate that descent ends at, which is optimal: certpgo certify" in done.out
    report = certpgo("certify", square, rounded, "--cost", "chordal", "--json").json
    assert report["objective"].startswith("F with weights from the file")
    assert report["best"]["is_optimal"]
    assert report["best"]["cost_upper"] == report["certificate"]["refined_cost"]
    assert 0.0 < report["best"]["mean_m"] <= report["best"]["worst_m"] < 1e-2
    assert report["digits"]["count"] == 3
    assert 0.1 < report["digits"]["cost"] / report["best"]["excess"] < 10.0
    assert [set(edge["ids"]) <= {0, 1, 2, 3} for edge in report["costliest_edges"]] == [True] * 4


def test_certify_polishes_to_the_better_answer(certpgo, tmp_path):
    from certpgo.io.datasets.synthetic import winding_cycle

    instance, wound = winding_cycle(60, 0.0, 1)
    graph, estimate, best = (tmp_path / name for name in ("cycle.npz", "wound.npz", "best.npz"))
    package.write(graph, instance)
    package.write(estimate, wound)
    done = certpgo("certify", graph, estimate, "--best", best)
    assert done.code == 4
    assert "Local descent from this one does not reach it" in done.out
    assert certpgo("certify", graph, best).code == 0


def test_many_estimates_make_a_csv(certpgo, answers, tmp_path):
    best, rounded, square, broken = answers
    out = tmp_path / "out.csv"
    done = certpgo("certify", square, best, rounded, broken, "--csv", out, "--json")
    assert done.code == 3  # the weakest verdict
    assert [row["verdict"] for row in done.json] == ["CERTIFIED", "BOUNDED", "ERROR"]
    assert [line.split()[:2] for line in done.err.splitlines()] == [
        ["1/3", "CERTIFIED"],
        ["2/3", "BOUNDED"],
        ["3/3", "ERROR"],
    ]
    header, *rows = out.read_text().splitlines()
    assert len(rows) == 3
    assert header.startswith("estimate,graph,verdict,cost,lower_bound,gap")
    assert rows[0].startswith(f"{best},square,CERTIFIED,")
    assert "broken.g2o:1: numbers expected" in rows[2]
    assert header.endswith(",distance_m,distance_deg,objective,reason")
    near, far, none = ((row["distance_m"], row["distance_deg"]) for row in done.json)
    alone = certpgo("certify", square, best, "--json").json
    assert near == pytest.approx((alone["distance_m"], alone["distance_deg"]), rel=1e-6)
    assert far > near
    assert none == (None, None)
    assert ",g2o's chi2 of EdgeSE2 with full information," in rows[0]
    assert certpgo("certify", square, best, broken, "--csv", out).code == 1
    assert certpgo("certify", square, best, "--csv", out).code == 0
    assert len(out.read_text().splitlines()) == 2


def test_an_estimate_of_the_largest_component_alone(certpgo, tmp_path):
    graph, out = tmp_path / "two.g2o", tmp_path / "out.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in (0, 1, 5)]
    graph.write_text("\n".join(lines) + "\n")
    assert certpgo("solve", graph, "--components", "largest", "-o", out).code == 0
    assert certpgo("certify", graph, out, "--components", "largest").code == 0
    for option in ((), ("--components", "each")):
        done = certpgo("certify", graph, out, *option)
        assert (done.code, done.out.splitlines()[0]) == (0, "two [3 of 5 nodes]")
        assert "poses of 3 of 5 nodes" in done.err


def test_what_an_output_has_no_room_for_is_said(certpgo, square, tmp_path):
    said = "hold rotations only: translations are not written"
    assert said in certpgo("solve", square, "-o", tmp_path / "a.rots").err
    assert said in certpgo("convert", square, tmp_path / "b.rots").err
    assert said in certpgo("certify", square, square, "--best", tmp_path / "c.rots").err
    assert said not in certpgo("convert", square, tmp_path / "d.tum").err


def test_how_poses_were_matched_is_said(certpgo, square, tmp_path):
    times = tmp_path / "a.tum"
    times.write_text("".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(4)))
    done = certpgo("certify", square, times, "--cost", "chordal")
    assert done.code == 3
    assert "matched in ascending order" in done.err
