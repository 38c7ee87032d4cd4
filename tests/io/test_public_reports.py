"""Small files of public reports, with values that other programs found."""

import numpy as np
import pytest

import certpgo
from certpgo import io
from certpgo.cli import main

ROTATED = "300 0 0 0 0 0 300 0 0 0 0 300 0 0 0 300 0 0 300 0 300"
#: A cycle of three measurements that contradict one another (gtsam, issue 1593).
TOY = "".join(
    f"EDGE_SE3:QUAT {line} {ROTATED}\n"
    for line in (
        "0 1 0.9 -0.1 0.05 0.1175925 -0.3414281 -0.7976288 0.4831016",
        "1 2 0.4 0.2 -0.3 0.6 0.1 -0.3 0.734846922834953",
        "0 2 -0.5 0.8 0.1 -0.2 0.7 0.5 0.469041575982343",
    )
)
STEP = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"
#: A camera that is turned and moved on its robot sees a landmark (rtabmap, pull request 319).
SEEN = f"""PARAMS_SE3OFFSET 0 0.2 0 0.5 0 0 0.7071067811865476 0.7071067811865476
EDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 {STEP}
EDGE_SE3:QUAT 2 3 1 0.5 0 0 0 0 1 {STEP}
EDGE_SE3_TRACKXYZ 1 9 0 2 -0.8 -0.5 30 5 1 20 2 10
EDGE_SE3_TRACKXYZ 2 9 0 2.1 0.2 -0.5 30 5 1 20 2 10
EDGE_SE3_TRACKXYZ 3 9 0 1.4 1.2 -0.6 30 5 1 20 2 10
"""
#: Poses with ids from 2, as an export has them (hdl_graph_slam, issues 122 and 215).
STATED = (
    "2 2.462285 -0.082414",
    "3 3.106445 -1.027296",
    "4 4.555094 -0.520270",
    "5 5.366926 -0.443983",
    "6 6.290252 -0.784520",
)
CHAIN = (
    "0 1 1.011822 -0.181602",
    "1 2 1.450464 0.099187",
    "2 3 0.644160 -0.944882",
    "3 4 1.448649 0.507026",
    "4 5 0.811831 0.076287",
    "5 6 0.923326 -0.340537",
    "2 6 3.827967 -0.702105",
)


@pytest.mark.parametrize(
    ("cost", "optimum"),
    [("g2o", 333.338690448), ("gtsam", 537.654080780), ("chordal", 528.357016285)],
)
def test_three_costs_of_a_contradiction(file, cost, optimum):
    """The least of scipy's twelve random starts; each is proven."""
    answer = certpgo.solve(io.read(file(TOY), quiet=True), cost=cost)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(optimum, rel=1e-10)


def test_a_landmark_seen_by_a_mounted_camera(file):
    """The optimum is scipy's."""
    answer = certpgo.solve(io.read(file(SEEN), quiet=True))
    assert answer.cost == pytest.approx(0.556568036697, abs=1e-11)


@pytest.mark.parametrize("suffix", ["g2o", "tum", "npz"])
def test_a_truth_stays_that_of_its_nodes_in_other_formats(file, tmp_path, suffix):
    """In an earlier version ids became 0, 1, 2, and errors half a metre."""
    graph = "".join(f"EDGE_SE3:QUAT {step} 0 0 0 0 1 {STEP}\n" for step in CHAIN)
    truth = file("".join(f"VERTEX_SE3:QUAT {line} 0 0 0 0 1\n" for line in STATED), "truth.g2o")
    other = tmp_path / f"other.{suffix}"
    assert main(["convert", str(truth), str(other)]) == 0
    instance = io.read(file(graph, "graph.g2o"), quiet=True)
    answer = certpgo.solve(instance)
    nodes, known = io.read_truth(other, instance)
    assert instance.ids[nodes].tolist() == [2, 3, 4, 5, 6]
    found = answer.estimate.subset(nodes).anchored(0, known)
    np.testing.assert_allclose(found.translations, known.translations, atol=1e-5)


def test_older_names_of_toro(file):
    """Steps of 1, 1 and 2.1 m leave 3 (100 / 30^2), as of the same file with newer names."""
    text = """VERTEX 0 0 0 0
VERTEX 1 1 0 0
VERTEX 2 2 0 0
EDGE 0 1 1 0 0 100 0 100 400 0 0
EDGE 1 2 1 0 0 100 0 100 400 0 0
EDGE 0 2 2.1 0 0 100 0 100 400 0 0
"""
    newer = text.replace("VERTEX", "VERTEX2").replace("EDGE", "EDGE2")
    for lines in (text, newer):
        answer = certpgo.solve(io.read(file(lines, "old.graph"), quiet=True))
        assert answer.cost == pytest.approx(1.0 / 3.0, rel=1e-9)


PLANE = "{0}VERTEX_SE2 0 0 0 0\n{0}VERTEX_SE2 1 1 0 0\nFIX 0\n"
STEPS = "{0}EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n{0}EDGE_SE2 0 1 1.1 0 0 100 0 0 100 0 400\n"


@pytest.mark.parametrize("prefix", ["", "ONLINE_", "TUTORIAL_"])
def test_files_of_g2os_examples(file, prefix):
    """g2o, issues 45 and 358: two steps of 1 and 1.1 m leave 2 (100 / 20^2)."""
    text = (PLANE + STEPS).format(prefix)
    answer = certpgo.solve(io.read(file(text), quiet=True))
    assert answer.cost == pytest.approx(0.5, rel=1e-9)


def test_edges_may_come_before_their_vertices(file):
    """g2o, issue 762, where it could not find the vertices of an edge."""
    text = "".join(reversed((PLANE + STEPS).format("").splitlines(keepends=True)))
    answer = certpgo.solve(io.read(file(text), quiet=True))
    assert answer.cost == pytest.approx(0.5, rel=1e-9)


def test_edges_without_information_weigh_one(file):
    """SC-LIO-SAM, issue 22, where GTSAM read no edge: steps of 1 and 1.1 m leave 2 / 20^2."""
    step = "EDGE_SE3:QUAT 0 1 {} 0 0 0 0 0 1\n"
    answer = certpgo.solve(io.read(file(step.format(1) + step.format(1.1)), quiet=True))
    assert answer.cost == pytest.approx(0.005, rel=1e-9)


def test_two_robots_that_both_have_the_edges_between_them(file):
    """distributed-mapper, issue 8: ids go through, the edges 3-5 and 3-6 are in both files."""
    weight = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
    own = ((1, 2), (2, 3), (3, 4), (1, 3)), ((5, 6), (6, 7), (7, 8), (5, 7))
    paths = [
        file("".join(f"EDGE_SE3:QUAT {i} {j} 0 0 0 0 0 0 1 {weight}\n" for i, j in edges), name)
        for edges, name in (
            ((*own[0], (3, 6), (3, 5)), "0.g2o"),
            ((*own[1], (3, 6), (3, 5)), "1.g2o"),
        )
    ]
    instance = io.read(paths, quiet=True)
    assert (instance.ids.tolist(), instance.graph.num_edges) == ([*range(1, 9)], 10)
    assert certpgo.solve(instance).verdict.value == "CERTIFIED"


def test_cross_terms_of_information_stay_with_their_axes(file):
    """gtsam, pull request 1310: the order of g2o is x, y, z, then the rotation's axes."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    information = np.round(A @ A.T + 6.0 * np.eye(6), 3)
    numbers = " ".join(map(str, information[np.triu_indices(6)].tolist()))
    line = f"EDGE_SE3:QUAT 0 1 0.25 0.06 0.02 -0.0167946 -0.0087881 -0.0277189 0.999436 {numbers}\n"
    instance = io.read(file(line), quiet=True)
    assert instance.graph.information_matrices[0].tolist() == information.tolist()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        # g2o, issue 311: a prior whose sensor nothing describes; and decimal commas.
        (
            f"EDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 {STEP}\nEDGE_SE3_PRIOR 1 1 0 0 0 0 0 0 1 {STEP}\n",
            "sensor 1, which is unknown: a line PARAMS_SE3OFFSET 1 0 0 0 0 0 0 1 puts it",
        ),
        ("VERTEX_SE3:QUAT 1 0,000000 0 0 0 0 0 1\n", "a decimal comma: decimal points expected"),
        # g2o, issue 358: a blank in the tag.
        (f"EDGE_SE3 : QUAT 0 1 1 0 0 0 0 0 1 {STEP}\n", "did you mean .*EDGE_SE3:QUAT"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(file, text, said):
    with pytest.raises(certpgo.FormatError, match=said):
        io.read(file(text))
