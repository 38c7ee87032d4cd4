"""certpgo follow: a stream from a file or a pipe, and a last line about the whole."""

import io
import re
import sys

import numpy as np
import pytest

import certpgo as package
from certpgo.cli._following import Newest
from certpgo.graph.phrases import rounded_up
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.synthetic import helix
from certpgo.io.datasets.thesis import langevin_graph
from certpgo.objective.choose_cost import objective_of


@pytest.fixture
def lines(tmp_path):
    """The g2o file of a helix."""
    path = tmp_path / "helix.g2o"
    package.write(path, helix(6, np.random.default_rng(0)))
    return path


def pipe(monkeypatch, data):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


def cost_of(line):
    return float(line.partition(" = ")[2].partition(",")[0])


def test_a_cost_without_matrices_is_refused_with_the_name_of_the_file(certpgo, tmp_path):
    path = tmp_path / "bare.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 2 1 0 0\n")
    done = certpgo("follow", path, "--cost", "g2o")
    needed = (
        "--cost g2o needs poses with information matrices on every edge; not all edges have one"
    )
    assert (done.code, done.out) == (1, "")
    assert done.err.splitlines()[-1] == f"certpgo: {path}: {needed}"


def test_a_file_ends_with_the_verdict_of_the_whole(certpgo, lines, tmp_path):
    read = package.read(lines)
    best = package.solve(read)
    done = certpgo("follow", lines, "--every", 20, "--trace", "-o", tmp_path / "last.g2o")
    assert done.code == 0
    last = done.out.splitlines()[-1]
    assert last.startswith("CERTIFIED: g2o's chi2 of ")
    assert cost_of(last) == pytest.approx(best.cost, rel=1e-9)
    assert f"{best.graph.num_nodes} nodes, {best.graph.num_edges} measurements" in last
    assert len(done.out.splitlines()) == best.graph.num_edges // 20 + 1
    assert ": g2o's chi2 of EdgeSE3:QUAT with full information = " in last
    assert "; chi^2 " in last
    assert last.endswith(f" at {6 * (best.graph.num_edges - 35)} degrees of freedom")
    again = package.read_estimate(tmp_path / "last.g2o", read)
    assert objective_of(read).cost(again) == pytest.approx(best.cost, rel=1e-9)


def test_the_chordal_cost_is_followed_if_asked(certpgo, lines):
    best = package.solve(package.read(lines), cost="chordal")
    said = certpgo("follow", lines, "--cost", "chordal").out
    assert ": chordal cost F = " in said
    assert "; chi^2 " in said
    assert cost_of(said) == pytest.approx(best.cost, rel=1e-9)


def test_a_pipe_is_read_as_its_lines_come(certpgo, lines, monkeypatch):
    best = package.solve(package.read(lines))
    pipe(monkeypatch, lines.read_bytes())
    report = certpgo("follow", "-", "--every", 20, "--json").json
    assert report["verdict"] == "CERTIFIED"
    assert report["cost"] == pytest.approx(best.cost, rel=1e-9)
    assert report["edges"] == best.graph.num_edges
    assert not report["interrupted"]


@pytest.mark.parametrize("cost", ["g2o", "chordal"])
def test_a_pipe_ends_with_the_chi_squared_of_the_file(certpgo, tmp_path, monkeypatch, cost):
    path = tmp_path / "graph.g2o"  # correlated: F averages these matrices
    ends = [(0, 1, 1.0), (1, 2, 1.1), (2, 3, 1.0), (3, 0, -3.0), (0, 2, 2.0)]
    path.write_text("".join(f"EDGE_SE2 {i} {j} {x} 0 0.1 90 0 30 200 0 400\n" for i, j, x in ends))
    file = certpgo("follow", path, "--cost", cost).out
    pipe(monkeypatch, path.read_bytes())
    piped = certpgo("follow", "-", "--every", 2, "--cost", cost).out
    assert "; chi^2 " in file
    assert file.partition("; chi^2 ")[2] == piped.partition("; chi^2 ")[2]


def test_an_error_in_a_pipe_names_its_line(certpgo, lines, monkeypatch):
    text = [line for line in lines.read_bytes().splitlines() if line.startswith(b"EDGE")]
    text[44] = b"EDGE_SE3:QUAT 1 2 x"
    pipe(monkeypatch, b"\n".join(text))
    done = certpgo("follow", "-", "--every", 20)
    assert done.code == 1
    assert "standard input:45: " in done.err


def test_landmarks_of_a_pipe_are_left_out_and_that_is_said(certpgo, monkeypatch):
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0 1 0 0 1 0 1" for k in range(4)]
    seen = [f"LANDMARK2 {k} 9 1 1 1 0 1" for k in range(4)]
    pipe(monkeypatch, "\n".join([*steps, *seen]).encode())
    done = certpgo("follow", "-", "--every", 3)
    assert done.code == 0
    assert "5 nodes, 4 measurements" in done.out
    assert "LANDMARK2" in done.err


def test_what_is_left_out_of_a_pipe_is_counted_to_its_end(certpgo, monkeypatch):
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0 1 0 0 1 0 1" for k in range(9)]
    seen = [f"EDGE_SE2_XY {k} 99 1 1 1 0 1" for k in range(4)]
    prior = "EDGE_PRIOR_SE2_XY 0 1 1 1 0 1"
    text = [*steps[:3], seen[0], *steps[3:], *seen[1:], prior, prior, ""]  # some pieces only skip
    pipe(monkeypatch, "\n".join(text).encode())
    done = certpgo("follow", "-", "--every", 2)
    assert done.code == 0
    assert done.err.splitlines() == [
        "note: standard input: EDGE_SE2_XY lines skipped: landmarks",
        "note: standard input: 4 EDGE_SE2_XY lines skipped: landmarks",
        "note: standard input: 2 EDGE_PRIOR_SE2_XY lines skipped: priors",
    ]


@pytest.mark.parametrize(
    ("last", "edges", "said"),
    [
        ("EDGE_SE2 3 4 1 0 0 1 0 0", 3, "is cut off, and left out"),
        ("EDGE_S", 3, "is cut off, and left out"),
        ("EDGE_SE2 3 4 1 0 0 1 0 0 1 0 1", 4, "has no end, and may be cut off"),
    ],
)
def test_a_line_cut_off_at_the_end(certpgo, tmp_path, monkeypatch, last, edges, said):
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0 1 0 0 1 0 1" for k in range(3)]
    pipe(monkeypatch, "\n".join([*steps, last]).encode())
    out = tmp_path / "stands.tum"
    done = certpgo("follow", "-", "-o", out)
    assert done.code == 0
    assert f"{edges + 1} nodes, {edges} measurements" in done.out
    assert done.err == f"note: standard input:4: the last line {said}\n"
    assert len(out.read_text().splitlines()) == edges + 1


def test_landmarks_of_a_file_come_with_the_poses_that_see_them(certpgo, tmp_path):
    path = tmp_path / "seen.g2o"
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0.1 100 0 0 100 0 100" for k in range(8)]
    seen = [f"EDGE_SE2_XY {k} {20 + k % 3} 1.0{k} 0.5 50 0 50" for k in range(9)]
    path.write_text("\n".join([*seen, *steps]))
    best = package.solve(package.read(path, quiet=True))
    done = certpgo("follow", path, "--every", 4, "--trace")
    assert done.out.splitlines()[0].count("EXACT FIT") == 1
    assert cost_of(done.out.splitlines()[-1]) == pytest.approx(best.cost)


def test_the_map_is_shown_as_it_grows(certpgo, lines, monkeypatch):
    pytest.importorskip("viser", reason="viser is not installed")
    scenes = []

    class Drawn:
        def __init__(self, server, scene, **options):
            scenes.append(scene)

    def interrupt(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr("certpgo.view.live.Drawing", Drawn)
    monkeypatch.setattr("certpgo.view.live.PAUSE", 0.0)
    monkeypatch.setattr("certpgo.cli.follow.time.sleep", interrupt)
    done = certpgo("follow", lines, "--view", "--every", 40, "--port", "8150")
    assert done.code == 0
    assert "shows the map; Ctrl-C ends" in done.err
    assert done.out.startswith("CERTIFIED")
    sizes = [len(scene.ids) for scene in scenes]
    assert sizes == sorted(sizes)
    assert sizes[0] < sizes[-1] == package.read(lines).graph.num_nodes


def test_an_empty_pipe_is_refused(certpgo, monkeypatch):
    pipe(monkeypatch, b"")
    done = certpgo("follow", "-")
    assert done.code == 1
    assert "no measurements" in done.err


def test_wrong_measurements_are_named_or_put_aside(certpgo, lines):
    with lines.open("a") as file:
        file.write(f"EDGE_SE3:QUAT 0 30 9 9 9 1 0 0 0 {WEIGHTS}\n")
    named = certpgo("follow", lines)
    assert "0-30)" in named.err
    assert "--robust" in named.err
    aside = certpgo("follow", lines, "--robust")
    assert aside.code == 0
    assert "CERTIFIED: g2o's chi2 of" in aside.out
    of_f = certpgo("follow", lines, "--robust", "--cost", "chordal")
    assert "CERTIFIED: chordal cost F = " in of_f.out
    assert " put aside" in aside.out


#: Of a measurement to a decimetre and a few degrees.
WEIGHTS = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"


def test_ctrl_c_ends_with_what_is_proven(certpgo, lines, monkeypatch, tmp_path):
    refresh, calls = package.Session.refresh, []

    def interrupted(session):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return refresh(session)

    monkeypatch.setattr(package.Session, "refresh", interrupted)
    done = certpgo("follow", lines, "--every", 20, "-o", tmp_path / "so_far.g2o")
    assert done.code == 130
    assert package.read_estimate(tmp_path / "so_far.g2o").num_nodes > 20
    assert done.out.startswith("interrupted; so far: CERTIFIED: g2o's chi2 of EdgeSE3:QUAT")
    assert "40 measurements" in done.out
    assert len(done.out.splitlines()) == 1


def test_priors_of_a_file_have_one_world_in_every_part(certpgo, tmp_path):
    path, out = tmp_path / "field.g2o", tmp_path / "last.g2o"
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0.05 100 0 0 100 0 100" for k in range(12)]
    # The first position is the world's origin: alone it tells nothing of where north is.
    fixes = [(0, 0.0, 0.0), (5, 4.9, 0.6), (9, 8.4, 2.1), (12, 10.9, 3.9)]
    for origin, cost in ((0.0, "chordal"), (500000.0, "chordal"), (500000.0, "g2o")):
        lines = [f"EDGE_PRIOR_SE2_XY {k} {x + origin} {y + origin} 4 0 4" for k, x, y in fixes]
        path.write_text("\n".join([*steps, *lines]) + "\n")
        read = package.read(path, quiet=True)
        best = package.solve(read, cost=cost)
        done = certpgo("follow", path, "--every", 2, "--cost", cost, "-o", out, "--json")
        assert done.json["verdict"] == best.verdict.value == "CERTIFIED"
        assert done.json["cost"] == pytest.approx(best.cost, rel=1e-6)
        written = package.read_estimate(out).translations
        assert written == pytest.approx(read.in_world(best.estimate).translations, abs=1e-3)


def test_an_interrupted_estimate_is_in_the_frame_of_the_priors(certpgo, monkeypatch, tmp_path):
    path, refresh, calls = tmp_path / "field.g2o", package.Session.refresh, []
    steps = [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 100" for k in range(12)]
    poses = [f"EDGE_PRIOR_SE2 {k} {500000 + k} 0 0 4 0 0 4 0 4" for k in range(13)]
    path.write_text("\n".join([*steps, *poses]) + "\n")

    def interrupted(session):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return refresh(session)

    monkeypatch.setattr(package.Session, "refresh", interrupted)
    assert certpgo("follow", path, "--every", 4, "-o", tmp_path / "so_far.g2o").code == 130
    written = package.read_estimate(tmp_path / "so_far.g2o")
    assert 2 < written.num_nodes < 13
    assert written.translations[:, 0] == pytest.approx(500000 + np.arange(written.num_nodes))


def test_the_merge_command_takes_maps_with_priors(certpgo, tmp_path):
    def file(name, *lines):
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return path

    step = "EDGE_SE2 {} {} {} 0 0 100 0 0 100 0 100".format
    prior = "EDGE_PRIOR_SE2 {} {} 0 0 100 0 0 100 0 100".format
    first = file("first.g2o", step(0, 1, 1), prior(0, 500000), prior(1, 500001))
    second = file("second.g2o", step(2, 3, 1), prior(2, 500002), prior(3, 500003))
    joints = file("joints.g2o", step(1, 2, 1.5))
    out = tmp_path / "both.g2o"
    done = certpgo("merge", first, second, "--between", joints, "-o", out, "--json")
    assert done.json["verdict"] == "CERTIFIED"
    assert done.json["between"][0]["ids"] == [1, 2]
    best = package.solve(package.read(out, quiet=True), cost="chordal")
    assert done.json["cost"] == pytest.approx(best.cost, rel=1e-6)
    assert package.read_estimate(out).translations[:, 0] == pytest.approx(
        500000.0 + np.arange(4), abs=0.5
    )


def test_a_bag_is_followed_without_ros(certpgo, lines, tmp_path):
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    import bags

    read = package.read(lines)
    graph, messages = read.graph, bags.Messages(2)
    information = [
        np.diag([2 * tau] * 3 + [4 * kappa] * 3)
        for kappa, tau in zip(graph.kappa, graph.tau, strict=True)
    ]
    links = [
        messages.link(int(i), int(j), R, t, matrix)
        for (i, j), R, t, matrix in zip(
            graph.edges, graph.rotations, graph.translations, information, strict=True
        )
    ]
    whole, first = (messages.graph([], [], some) for some in (links, links[:9]))
    path = messages.write(tmp_path / "run", {"/mapGraph": [(0, first), (1, whole)]})
    done = certpgo("follow", path, "--topic", "/mapGraph", "--every", 20, "--trace")
    assert done.code == 0
    *before, last = done.out.splitlines()
    assert len(before) == graph.num_edges // 20
    assert last.startswith("CERTIFIED")
    assert f"{graph.num_nodes} nodes, {graph.num_edges} measurements" in last


def within(line):
    """The newest pose of a line, its metres and degrees, and the pose that it is seen from."""
    found = re.search(r"; node (\d+) within (\S+) m and (\S+) degrees of every optimum, seen", line)
    return int(found[1]), float(found[2]), float(found[3]), int(line.split(" seen from node ")[1])


def test_printed_certificates_locate_the_newest_pose(certpgo, lines):
    done = certpgo("follow", lines, "--every", 20, "--trace")
    session, expected = package.Session(every=None), []
    for part, names in streamed(package.read(lines), 20):
        session.add(part, names)
        distance, node = session.certificate.distance, session.newest
        numbers = distance.metres[node], distance.degrees[node]
        expected.append((session.nodes[node], *numbers, session.nodes[distance.reference]))
        assert session.nodes[node] == max(session.nodes)
    printed = [line.partition("; chi^2")[0] for line in done.out.splitlines()]
    assert len(printed) == len(expected)
    for line, (node, metres, degrees, reference) in zip(printed, expected, strict=True):
        if node == reference:
            assert "of every optimum" not in line
            continue
        assert within(line) == (
            node,
            float(rounded_up(metres, 3)),
            float(rounded_up(degrees, 3)),
            reference,
        )
    report = certpgo("follow", lines, "--every", 20, "--json").json
    keys = ("distance_node", "distance_m", "distance_deg", "distance_reference")
    assert tuple(report[key] for key in keys) == expected[-1]


def test_the_newest_pose_is_near_that_of_the_batch(certpgo, lines):
    report = certpgo("follow", lines, "--json").json
    node, seen = report["distance_node"], report["distance_reference"]
    batch = package.solve(package.read(lines)).certificate.distance_from(seen)
    assert report["distance_m"] == pytest.approx(batch.metres[node], rel=0.5)
    assert report["distance_deg"] == pytest.approx(batch.degrees[node], rel=0.5)


def test_what_is_not_printed_takes_no_bound(certpgo, lines, monkeypatch):
    asked = []
    monkeypatch.setattr(Newest, "of", classmethod(lambda cls, session: asked.append(1) or cls()))
    report = certpgo("follow", lines, "--every", 20, "--json").json
    assert len(asked) == 1  # of the whole
    assert report["distance_m"] is report["distance_node"] is None
    assert "of every optimum" not in certpgo("follow", lines, "--every", 20, "--trace").out


def test_a_robust_stream_is_located_by_what_it_keeps(certpgo, tmp_path):
    path = tmp_path / "wrong.g2o"
    graph = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15).graph
    package.write(path, graph)
    report = certpgo("follow", path, "--robust", "--json").json
    assert report["rejected"] > 0
    assert 0.0 < report["distance_deg"] < 1.0
    last = certpgo("follow", path, "--robust").out
    assert " put aside; node 39 within " in last
