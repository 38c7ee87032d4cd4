"""Every bad input is one line on stderr and exit code 1; nothing half-written stays behind."""

import os

import numpy as np
import pytest

from certpgo import InputError, certify, read_estimate, registry
from certpgo.cli import BENCHMARKS
from certpgo.io.datasets import entry
from certpgo.io.datasets.synthetic import cycle
from certpgo.objective.quadratic import Quadratic
from certpgo.solve import diagnostics

EDGE = "EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1"
EDGE3 = "EDGE_SE3:QUAT 0 1 1 0 0 {q} " + "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"

BAD = {
    "empty file": ("", "empty"),
    "too few numbers": ("EDGE_SE2 0 1 1 0\n", ":1:"),
    "letters": (f"{EDGE}\nEDGE_SE2 1 2 one 0 0 1 0 0 1 0 1\n", ":2:"),
    "nan": ("EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1\n", ":1:"),
    "zero quaternion": (EDGE3.format(q="0 0 0 0") + "\n", ":1:"),
    "self-loop": (f"{EDGE}\nEDGE_SE2 1 1 1 0 0 1 0 0 1 0 1\n", ""),
    "negative weight": ("EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\n", ":1:"),
    "wrong format": ("<?xml version='1.0'?>\n<poses/>\n", ""),
}


def fails_in_one_line(done, said=""):
    assert done.code == 1, done.err
    assert done.out == ""
    assert done.err.count("\n") == 1, done.err
    assert done.err.startswith("certpgo: ")
    assert said in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("what", BAD)
@pytest.mark.parametrize("command", ["info", "solve", "convert"])
def test_an_unusable_graph(certpgo, tmp_path, command, what):
    text, said = BAD[what]
    graph = tmp_path / "bad.g2o"
    graph.write_text(text)
    out = {"info": (), "solve": ("-o", tmp_path / "o.g2o"), "convert": (tmp_path / "o.npz",)}
    done = certpgo(command, graph, *out[command])
    fails_in_one_line(done, said)
    assert "bad.g2o" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.g2o"]


@pytest.mark.parametrize("command", ["info", "solve"])
def test_a_missing_file(certpgo, command):
    fails_in_one_line(certpgo(command, "folder/nowhere.g2o"), "folder/nowhere.g2o")


@pytest.fixture
def beacon(tmp_path):
    """A step of odometry, and distances of both poses to a point."""
    graph = tmp_path / "beacon.pyfg"
    step = "0.01 0 0 0.01 0 0.0001"
    graph.write_text(
        "VERTEX_SE2 0 A0 0 0 0\nVERTEX_SE2 1 A1 6 0 0\nVERTEX_XY L0 3 4\n"
        f"EDGE_SE2 1 A0 A1 6 0 0 {step}\n"
        "EDGE_RANGE 0 A0 L0 4.9 0.01\nEDGE_RANGE 1 A1 L0 4.8 0.01\n"
    )
    return graph


def test_a_node_with_distances_alone_does_not_come(certpgo, beacon):
    done = certpgo("follow", beacon)
    assert done.code == 1
    assert done.err.endswith("node 2 has distances alone, which are not streamed\n")
    assert not done.out


def test_bounds_and_comparisons_say_what_they_make_of_distances(certpgo, beacon, tmp_path):
    whole = ("--components", "largest")
    bounds = certpgo("bounds", beacon, *whole)
    assert "the bounds are about F without distances" in bounds.err
    methods = ("--methods", "certified,spanning_tree", "--out", tmp_path / "out")
    compared = certpgo("compare", beacon, *whole, *methods)
    assert "beacon: certified: CERTIFIED" in compared.err
    assert "spanning_tree: the graph has 2 components" in compared.err


def test_a_proof_about_distances_is_about_an_archive(certpgo, beacon):
    done = certpgo("prove", beacon)
    said = "a proof is about a g2o, .npz or 1DSfM file, not pyfg"
    assert (done.code, said in done.out) == (1, True)


def test_a_translation_beyond_doubles_names_its_edge(certpgo, tmp_path):
    graph = tmp_path / "far.g2o"
    rest = "0 0.1 1 0 0 1 0 1"
    graph.write_text("".join(f"EDGE_SE2 {i} {i + 1} {x} {rest}\n" for i, x in ((7, 1), (8, 1e308))))
    fails_in_one_line(certpgo("solve", graph), "edge 8 to 9: translations up to 1e+90 expected")


@pytest.mark.parametrize("command", ["solve", "info", "compare", "convert"])
def test_an_empty_name(certpgo, command):
    done = certpgo(command, "", *["out.g2o"] * (command == "convert"))
    fails_in_one_line(done, "a file or dataset expected, not an empty name")


def test_a_file_that_hides_a_dataset_is_noted(certpgo, square, monkeypatch):
    monkeypatch.chdir(square.parent)
    square.rename("MIT")
    done = certpgo("info", "MIT")
    assert done.code == 0
    assert "note: MIT is a file here; the dataset of that name is not used" in done.err


def test_the_usual_datasets_are_never_files_here(certpgo, square, monkeypatch):
    monkeypatch.chdir(square.parent)
    monkeypatch.delenv("CERTPGO_DATA", raising=False)
    monkeypatch.setattr("certpgo.io.datasets.lookup.places", lambda data: {"here": square.parent})
    square.rename("sphere2500.txt")
    fails_in_one_line(certpgo("compare"), "none of the usual datasets is available")


def test_what_is_far_from_any_name_is_not_guessed(certpgo, square):
    done = certpgo("solve", square, "--method", "magic")
    fails_in_one_line(done, "unknown method 'magic'; known: ")
    assert "did you mean" not in done.err


def test_a_trace_of_a_method_without_iterations_is_noted(certpgo, square):
    done = certpgo("solve", square, "--method", "eigen_ma", "--trace")
    assert "note: eigen_ma reports no iterations to --trace" in done.err


def test_a_name_that_nearly_is_a_dataset(certpgo):
    fails_in_one_line(certpgo("info", "sphere250"), "did you mean sphere2500")


def test_a_disconnected_graph(certpgo, tmp_path):
    graph = tmp_path / "two.g2o"
    graph.write_text(f"{EDGE}\n{EDGE.replace('0 1 1', '5 6 1', 1)}\n")
    done = certpgo("solve", graph)
    fails_in_one_line(done, "2 components of 2, 2 nodes")
    assert str(graph) in done.err


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 2 1 0 0\n", "2 of 4 nodes, and no measurements between"),
        ("VERTEX_SE2 10 0 0 0\n", "0"),
        ("VERTEX_SE3:QUAT 0 0 0 1 0 0 0 1\n", "3D poses, but the graph is 2D"),
        ("", "empty"),
    ],
)
def test_an_estimate_for_another_graph(certpgo, square, tmp_path, estimate, said):
    path = tmp_path / "other.g2o"
    path.write_text(estimate)
    fails_in_one_line(certpgo("certify", square, path), said)


@pytest.mark.parametrize("option", ["--trajectory", "--graph"])
def test_frames_are_not_read_for_outputs_of_no_format(certpgo, option):
    done = certpgo("reconstruct", "nowhere", option, "poses.docx")
    fails_in_one_line(done, "poses.docx: unknown suffix")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--method", "eigenma"), "did you mean eigen_ma"),
        (("--method", "eigen_ra"), "takes rotation graphs only"),
        (("--method", "eigen_ma", "--set", "tol"), "key=value"),
        (("--method", "eigen_ma", "--set", "translation=ml"), "did you mean translations"),
        (("--method", "eigen_ma", "--set", "translations=best"), "translations"),
        (("--set", "tol=1"), "--set needs --method"),
        (("--no-certify",), "--no-certify needs --method"),
        (("--method", "eigen_ma", "--time-limit", "1"), "cannot be combined with --method"),
        (("--method", "eigen_ma", "--no-file-start"), "cannot be combined with --method"),
        (("--robust", "--no-file-start"), "cannot be combined with --method or --robust"),
        (("--method", "eigen_ma", "--initial", "square.g2o"), "eigen_ma takes no initial estimate"),
        (
            ("--robust", "--cost", "g2o", "--proof", "out.cert"),
            "--robust --proof is for --cost chord",
        ),
        (("--kappa", "-1"), "kappa"),
        (("--unit-weights", "--tau", "2"), "unit weights"),
        (("-o", "out.docx"), "out.docx"),
        (("-o", "no/such/folder/out.g2o"), "no/such/folder"),
        (("--initial", "nowhere.g2o"), "nowhere.g2o"),
        (("--data", "no/such/folder"), ""),
    ],
)
def test_an_unusable_argument(certpgo, square, monkeypatch, arguments, said):
    monkeypatch.chdir(square.parent)
    graph = "MIT" if "--data" in arguments else square
    fails_in_one_line(certpgo("solve", graph, *arguments), said)


@pytest.mark.parametrize(("option", "value"), [("--tier", "gold"), ("--rtol", "-1")])
def test_an_unusable_tolerance_or_tier(certpgo, square, option, value):
    fails_in_one_line(certpgo("certify", square, square, option, value))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("certify", "g.g2o", "e.g2o", "--best", "no/such/o.g2o"), "no/such/o.g2o: cannot be"),
        (("certify", "g.g2o", "e.g2o", "--csv", "no/such/o.csv"), "no/such/o.csv: cannot be"),
        (("convert", "g.g2o", "no/such/o.g2o"), "no/such/o.g2o: cannot be"),
        (("certify", "g.g2o", "e.g2o", "--best", "o.docx"), "o.docx"),
        (("certify", "g.g2o", "a.g2o", "b.g2o"), "several estimates need --csv"),
        (("certify", "g.g2o", "e.g2o", "--csv", "o.csv", "--best", "o.g2o"), "--best"),
    ],
)
def test_what_cannot_end_well_is_refused_before_anything_is_read(certpgo, arguments, said):
    # None of the inputs is there, and that is not what is said.
    fails_in_one_line(certpgo(*arguments), said)


def test_a_table_or_method_that_is_unknown(certpgo, square, tmp_path):
    fails_in_one_line(certpgo("reproduce", "moreira2020_table5"), "did you mean")
    done = certpgo("compare", square, "--methods", "eigenma", "--out", tmp_path / "r")
    fails_in_one_line(done, "did you mean eigen_ma")
    assert not (tmp_path / "r").exists()


def test_files_that_are_not_there_are_named(certpgo, square, tmp_path):
    missing = tmp_path / "missing"
    done = certpgo("check", square, missing)
    assert (done.code, "no such file" in done.err + done.out) == (1, True)
    estimate = tmp_path / "e.tum"
    estimate.write_text("0 0 0 0 0 0 0 1\n")
    done = certpgo("certify", square, estimate, "--timestamps", missing)
    said = f"certpgo: {missing}: no such file; ids, index or a file of times expected"
    fails_in_one_line(done, said)


def test_what_is_no_estimate_is_told_where_to_go():
    problem = Quadratic(cycle(5, 0.1, np.random.default_rng(0)).graph)
    with pytest.raises(InputError, match="not an int: certify_values takes GTSAM's Values"):
        certify(problem, 5)
    with pytest.raises(InputError, match="not an object: certify_values takes GTSAM's Values"):
        read_estimate(object())


def test_without_a_checkout_reproduce_says_so(certpgo, tmp_path, monkeypatch):
    monkeypatch.setenv("CERTPGO_REPOSITORY", str(tmp_path))
    fails_in_one_line(certpgo("reproduce", "compare"), "needs a checkout of certpgo")


@pytest.fixture
def wheel(monkeypatch):
    """The package without a checkout."""
    monkeypatch.setattr("certpgo.registry.command_names", lambda: ())
    monkeypatch.setattr("certpgo.registry.checkout", lambda: None)


@pytest.mark.parametrize("name", BENCHMARKS)
def test_commands_of_the_checkout_are_named_as_such(certpgo, wheel, name):
    done = certpgo(name, "--all")
    fails_in_one_line(done, f"{name} is a command of the benchmarks; this needs a checkout")


def test_the_commands_of_the_checkout_are_all_named():
    assert registry.command_names() == BENCHMARKS


def test_what_only_a_checkout_has_is_listed_as_such(certpgo, wheel):
    done = certpgo("list", "tables", "figures")
    line = "in a checkout only, and this is none\n"
    assert (done.code, done.out) == (0, f"tables: {line}\nfigures: {line}\n")


def test_compare_needs_no_checkout(certpgo, square, tmp_path, monkeypatch):
    monkeypatch.setenv("CERTPGO_REPOSITORY", str(tmp_path))
    done = certpgo("compare", square, "--methods", "newton", "--out", tmp_path / "r")
    assert (done.code, "CERTIFIED" in done.out) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("inof",), "info"),
        (("solve",), "graph"),
        (("solve", "x.g2o", "--keep", "most"), "most"),
        (("info", "x.g2o", "--no-such-option"), "--no-such-option"),
        (("reproduce", "certified", "--seeds", "0"), "--seeds"),
    ],
)
def test_usage_is_exit_code_2(certpgo, arguments, said):
    done = certpgo(*arguments)
    assert done.code == 2
    assert done.out == ""
    assert said in done.err.lower()


def test_an_interrupt_is_exit_code_130(certpgo, square, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnostics, "structure", interrupted)
    done = certpgo("info", square)
    assert done.code == 130
    assert done.err == "certpgo: interrupted\n"


def test_notices_are_on_stderr_and_stdout_stays_clean(certpgo, tmp_path):
    graph = tmp_path / "bare.g2o"
    graph.write_text("EDGE_SE2 0 1 1 0 0.1\nEDGE_SE2 1 2 1 0 0.1\n")
    done = certpgo("solve", graph, "--json")
    assert done.code == 0
    assert "note: " in done.err
    assert done.json["solution"]["status"] == "converged"


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "g.g2o", "-o", "g.g2o"),
        ("solve", "g.g2o", "-o", "link.g2o"),
        ("solve", "g.g2o", "-o", "e.g2o", "--initial", "e.g2o"),
        ("solve", "g.g2o", "-o", "folder/../g.g2o", "--components", "each"),
        ("convert", "g.g2o", "g.g2o"),
        ("convert", "g.g2o", "g.g2o", "--estimate"),
        ("convert", "e.g2o", "g.g2o", "--graph", "g.g2o", "--estimate"),
        ("certify", "g.g2o", "e.g2o", "--best", "g.g2o"),
        ("certify", "g.g2o", "e.g2o", "--best", "e.g2o"),
        ("certify", "g.g2o", "e.g2o", "--csv", "e.g2o"),
    ],
)
def test_an_input_is_never_overwritten(certpgo, square, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    text = square.read_text()
    for name in ("g.g2o", "e.g2o"):
        (tmp_path / name).write_text(text)
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.g2o").symlink_to("g.g2o")
    fails_in_one_line(certpgo(*arguments), "would be overwritten")
    assert all((tmp_path / name).read_text() == text for name in ("g.g2o", "e.g2o", "link.g2o"))


@pytest.mark.parametrize("option", ["--initial", "--truth"])
def test_the_file_of_a_dataset_that_an_option_names_is_not_overwritten(
    certpgo, square, tmp_path, monkeypatch, option
):
    monkeypatch.setattr("certpgo.io.datasets.lookup.places", lambda data: {"here": tmp_path})
    monkeypatch.setattr("certpgo.io.datasets.catalogue.Entry.agrees", lambda entry, path: True)
    held = tmp_path / "data" / entry("intel").filename
    held.parent.mkdir()
    held.write_text(square.read_text())
    done = certpgo("solve", square, option, "intel", "-o", held)
    fails_in_one_line(done, "would be overwritten")
    assert held.read_text() == square.read_text()


def test_the_truth_is_resolved_once_for_all_components(certpgo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nodes = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in (0, 1, 5, 6))
    text = f"{nodes}{EDGE}\n{EDGE.replace('0 1 1', '5 6 1', 1)}\n"
    for name in ("two.g2o", "MIT"):
        (tmp_path / name).write_text(text)
    done = certpgo("solve", "two.g2o", "--components", "each", "--truth", "MIT")
    assert done.code == 0
    assert done.err.count("the dataset of that name is not used") == 1


def test_the_file_of_a_component_is_no_input_either(certpgo, tmp_path):
    text = f"{EDGE}\n{EDGE.replace('0 1 1', '5 6 1', 1)}\n"
    graph = tmp_path / "two-5.g2o"
    graph.write_text(text)
    out = tmp_path / "two.g2o"
    fails_in_one_line(certpgo("solve", graph, "--components", "each", "-o", out), "two-5.g2o")
    assert graph.read_text() == text
    assert not out.exists()


def test_a_data_folder_that_is_not_there(certpgo, monkeypatch):
    monkeypatch.setenv("CERTPGO_DATA", "no/such/folder")
    fails_in_one_line(certpgo("info", "MIT"), "no/such/folder: no such folder (CERTPGO_DATA)")


def test_an_unknown_dataset_names_the_nearest_or_where_to_look(certpgo):
    fails_in_one_line(certpgo("fetch", "sphere250"), "did you mean sphere2500")
    done = certpgo("fetch", "nosuch")
    fails_in_one_line(done, "see certpgo list datasets")
    assert len(done.err) < 100


def test_an_unknown_benchmark_or_family(certpgo):
    fails_in_one_line(certpgo("bench", "scales"), "known: scale")
    fails_in_one_line(certpgo("bench", "scale", "--family", "helx"), "did you mean helix")
    fails_in_one_line(certpgo("bench", "speed", "--section", "reeding"), "did you mean reading")


def test_what_is_gone_says_so(certpgo, square):
    fails_in_one_line(certpgo("solve", square, "--scheduler", "threads"), "--scheduler is gone")


@pytest.mark.parametrize("option", ["-o", "--proof", "--html", "--covariances"])
def test_an_output_below_a_file_is_refused_before_any_work(certpgo, square, option):
    done = certpgo("solve", square, option, square / "out.g2o")
    fails_in_one_line(done, f"cannot be written: {square} is a file, not a folder")
    assert [path.name for path in square.parent.iterdir()] == [square.name]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
@pytest.mark.parametrize(
    ("options", "name"),
    [
        ((), "s.g2o"),
        (("--proof",), "s.cert"),
        (("--html",), "s.html"),
        (("--covariances",), "s.csv"),
    ],
)
def test_a_full_disk_is_one_line(certpgo, square, options, name):
    full = square.with_name(name)
    full.symlink_to("/dev/full")
    done = certpgo("solve", square, *(options or ("-o",)), full)
    assert done.code == 1
    said = done.err.splitlines()[-1]
    assert said == f"certpgo: {full}: cannot be written: No space left on device"
    assert "Traceback" not in done.err
    assert sorted(path.name for path in square.parent.iterdir()) == sorted([name, square.name])
