"""What objects print: at most a screen, no arrays, and the facts."""

import gzip
import html.parser
import json
import subprocess
import sys

import numpy as np
import pytest

import certpgo
from certpgo.graph.phrases import aligned, rounded_up, shown_path
from certpgo.io.datasets import synthetic
from certpgo.optimize.solution import Status

LINES, WIDTH = 24, 80


@pytest.fixture(scope="module")
def made():
    return synthetic.grid3d(3, np.random.default_rng(0))


@pytest.fixture(scope="module")
def answer(made):
    return certpgo.solve(made)


@pytest.fixture(scope="module")
def cycle():
    instance, around = synthetic.winding_cycle(9, 0.3, 1)
    return instance, certpgo.certify(instance, around)


@pytest.fixture
def objects(made, answer, cycle):
    of_poses = (made, made.graph, made.truth, answer, answer.certificate, answer.problem)
    return (*of_poses, cycle[0], cycle[0].graph, cycle[0].truth, cycle[1])


def test_every_object_is_a_screen_without_arrays(objects):
    for thing in objects:
        lines = str(thing).splitlines()
        assert (len(lines) <= LINES, max(map(len, lines)) <= WIDTH) == (True, True), thing
        assert "\nnext " in str(thing), thing
        assert "\n" not in repr(thing)
        assert "array" not in repr(thing) + str(thing)


def test_a_session_says_where_it_stands(cycle):
    session = certpgo.Session()
    assert repr(session) == "<Session, empty: no measurements yet>"
    session.add(cycle[0].graph)
    session.refresh()
    assert repr(session).startswith("<Session, CERTIFIED: 9 nodes, 9 measurements, F ")
    assert "\nlower bound" in str(session.standing)
    assert "\npending" in str(session)


def test_the_rest_shows_the_shape_of_arrays(answer, made):
    assert "estimate=<Estimate: 27 poses, 3D>" in repr(answer.solution)
    ranges = certpgo.Ranges(3, np.array([[0, 2]]), np.array([5.0]), np.ones(1))
    said = "Ranges(num_nodes=3, edges=array(1, 2), distances=array(1,), weights=array(1,))"
    assert repr(ranges) == said


def test_an_answer_says_the_numbers_and_what_is_proven(answer):
    said = str(answer)
    assert said.startswith("CERTIFIED. Proven: at most ")
    assert rounded_up(answer.certificate.cost_upper, 12) in said
    assert "27 poses, 51 edges, 3D" in said
    assert "certpgo.write(path, answer)" in said
    assert answer.summary() == said == repr(answer.summary())


def test_a_refuted_estimate_is_told_where_to_go(cycle):
    assert "take certificate.better" in str(cycle[1])


class Balanced(html.parser.HTMLParser):
    """Refuses elements that are not closed."""

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], set()

    def handle_starttag(self, tag, attributes):
        self.seen.add(tag)
        self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.seen.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_notebooks_show_a_table_and_a_picture(objects):
    for thing in objects:
        page = Balanced()
        page.feed(thing._repr_html_())
        assert (page.open, "table" in page.seen) == ([], True), thing
        # Rotations without their graph have no picture.
        best = getattr(thing, "best", thing)
        bare = isinstance(best, certpgo.Estimate) and best.translations is None
        assert ("svg" in page.seen) != bare, thing
        assert len(thing._repr_html_()) < 60_000


def test_verdicts_are_their_names(answer):
    assert (answer.verdict, f"{answer.verdict}") == ("CERTIFIED", "CERTIFIED")
    assert {"CERTIFIED": 1}[answer.verdict] == 1
    assert json.dumps(answer.verdict) == '"CERTIFIED"'
    assert (certpgo.Tier.PROOF, Status.TIME_LIMIT) == ("proof", "time limit")


def test_a_certificate_is_json(answer):
    data = json.loads(answer.certificate.to_json())
    assert (data["verdict"], data["tier"]) == ("CERTIFIED", "standard")
    assert data["lower_bound"] == answer.certificate.lower_bound
    assert not data.keys() & {"multipliers", "refined", "better"}


def test_completion_shows_every_public_name_and_nothing_else():
    names = set(dir(certpgo))
    assert names == {*certpgo.__all__, "plot", "__version__", "__doc__"}
    assert all(getattr(certpgo, name) is not None for name in names)


def test_plots_are_imported_on_first_use():
    code = "import sys, certpgo; dir(certpgo); print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_words_wrap_and_numbers_do_not():
    lines = list(aligned([("a", "one two 3.14159265358979323846"), ("long name", "x")], 30))
    assert lines == ["a          one two", "           3.14159265358979323846", "long name  x"]
    assert list(aligned([("a", "one two three")])) == ["a  one two three"]


def test_no_path_is_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shown_path(tmp_path / "a" / "b.g2o") == "a/b.g2o"
    assert shown_path("/elsewhere/b.g2o") == "b.g2o"
    assert shown_path("../b.g2o") == "../b.g2o"


def test_functions_take_paths_and_answers(tmp_path, made, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ids = 10 * np.arange(27) + 3
    certpgo.write("graph.g2o", made.graph, ids=ids)
    answer = certpgo.solve("graph.g2o")
    certpgo.write("answer.g2o", answer)
    assert "VERTEX_SE3:QUAT 263 " in (tmp_path / "answer.g2o").read_text()
    assert certpgo.certify("graph.g2o", "answer.g2o").verdict == "CERTIFIED"
    instance = certpgo.read("graph.g2o")
    assert certpgo.certify(instance, answer).objective == answer.certificate.objective
    assert certpgo.certify(instance, answer, cost="chordal").objective == "F"
    assert certpgo.certify(instance.graph, answer).objective == answer.certificate.objective
    again = certpgo.solve(instance, initial="answer.g2o")
    assert again.cost == pytest.approx(answer.cost, rel=1e-9)
    assert certpgo.solve_robustly("graph.g2o").verdict == "CERTIFIED"


def test_compressed_files_are_read_by_their_content(tmp_path, made):
    plain = tmp_path / "graph.g2o"
    certpgo.write(plain, made)
    content = gzip.compress(b"\xef\xbb\xbf" + plain.read_bytes())
    for name in ("graph.g2o.gz", "same.g2o", "same"):
        (tmp_path / name).write_bytes(content)
        read = certpgo.read(tmp_path / name)
        assert (read.name, read.graph.num_edges) == (name.partition(".")[0], 51)
        assert np.array_equal(read.graph.translations, certpgo.read(plain).graph.translations)
    (tmp_path / "cut.g2o.gz").write_bytes(content[:900])
    with pytest.raises(certpgo.FormatError, match=r"cut\.g2o\.gz: .* damaged or incomplete"):
        certpgo.read(tmp_path / "cut.g2o.gz")
    answer = certpgo.solve(made)
    proven = certpgo.read(tmp_path / "same.g2o", quiet=True), answer.estimate, answer.certificate
    with pytest.raises(certpgo.InputError, match="decompress it first"):
        certpgo.write_proof(tmp_path / "p.cert", tmp_path / "same.g2o", *proven)


def test_unknown_lines_that_measure_nothing_are_skipped_and_named(tmp_path):
    path = tmp_path / "graph.g2o"
    edge = "EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n"
    path.write_text(f"VERTEX_CAM 7 a b\nPARAMS_CAM 0 1\nROBOTLASER1 0 1\n{edge}")
    with pytest.warns(certpgo.InputNotice):
        notices = certpgo.read(path).notices
    assert [sentence.split()[1] for sentence in notices] == [
        "VERTEX_CAM",
        "PARAMS_CAM",
        "ROBOTLASER1",
    ]
    path.write_text(f"EDGE_CAM 0 1 2\n{edge}")
    with pytest.raises(certpgo.FormatError, match="no tag 'EDGE_CAM'"):
        certpgo.read(path)


def test_values_are_sent_to_where_they_are_certified(made):
    with pytest.raises(certpgo.InputError, match="certify_values takes GTSAM's Values"):
        certpgo.read_estimate({}, made)


def test_the_next_step_is_one_that_is_taken(tmp_path):
    edges, R = np.array([[0, 1], [2, 3], [3, 4]]), np.array([np.eye(2)] * 3)
    rotation = certpgo.RotationGraph(5, edges, R, np.ones(3))
    for graph in (rotation, certpgo.PoseGraph(rotation, np.ones((3, 2)), np.ones(3))):
        step = str(graph).partition("\nnext")[2].strip()
        found = eval(step, {"certpgo": certpgo, "graph": graph})
        assert (found.verdict.value, found.estimate.num_nodes) == ("CERTIFIED", 3)
    path = tmp_path / "two.g2o"
    path.write_text("".join(f"EDGE_SE2 {i} {j} 1 0 0 1 0 0 1 0 1\n" for i, j in edges))
    instance = certpgo.read(path, quiet=True)
    step = str(instance).partition("\nnext")[2].split("\n")[0].strip()
    parts = eval(step, {"certpgo": certpgo, "instance": instance})
    assert [certpgo.solve(part).estimate.num_nodes for part in parts] == [3, 2]
