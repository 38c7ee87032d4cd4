"""What is solved is the graph: the instance around it changes neither cost nor verdict."""

from pathlib import Path

import pytest

import certpgo
from certpgo.errors import InputError
from certpgo.objective.choose_cost import costs_of, own_cost

HERE = Path(__file__).parents[1] / "data"
#: Own costs of small graphs that are here.
FILES = {
    "scan_given_twice.g2o": "g2o",
    "proofs/version2_plane.g2o": "g2o",
    "proofs/version2_space.g2o": "g2o",
}
#: And of public ones, of every kind of file.
PUBLIC = {
    "Klaus3": "g2o",
    "tinyGrid3D": "g2o",
    "smallGrid3D": "g2o",
    "ring": "g2o",
    "sphere400": "chordal",
    "stonewall": "chordal",
    "cityTrees_reduced_1k": "g2o",
    "pyfg_se2_test_data": "chordal",
    "cycle20_0.5_SO3": "chordal",
}


def solved_as_its_graph(instance, own):
    """The instance is solved as its graph is, under each cost, or refused as that is."""
    assert own_cost(instance.graph) == own_cost(instance) == own
    takes = costs_of(instance)
    for cost in (None, "chordal", "g2o", "gtsam"):
        if cost not in (None, *takes):
            for posed in (instance, instance.graph):
                with pytest.raises(InputError):
                    certpgo.solve(posed, cost=cost)
            continue
        of_instance, of_graph = (
            # The file's initial values, which a graph has not, are another start.
            certpgo.solve(posed, cost=cost, try_file_start=False).certificate
            for posed in (instance, instance.graph)
        )
        for name in ("verdict", "cost_upper", "lower_bound", "scale", "objective"):
            assert getattr(of_graph, name) == getattr(of_instance, name), (cost, name)


@pytest.mark.parametrize("name", FILES)
def test_a_graph_is_solved_as_its_instance_is(name):
    solved_as_its_graph(certpgo.read(HERE / name, quiet=True), FILES[name])


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_graph_is_solved_as_its_instance_is(dataset, name):
    solved_as_its_graph(dataset(name), PUBLIC[name])


def test_distances_are_of_the_graph(tmp_path):
    path = tmp_path / "ranges.pyfg"
    lines = [f"VERTEX_SE2 0 A{k} {k} {k * k} 0" for k in range(3)]
    lines += ["VERTEX_XY L0 2 1", "EDGE_SE2 0 A0 A1 1 1 0.1 0.01 0 0 0.01 0 0.01"]
    lines += ["EDGE_SE2 0 A1 A2 1 3 0 0.01 0 0 0.01 0 0.01"]
    lines += [f"EDGE_RANGE 0 A{k} L0 {r} 0.01" for k, r in enumerate((2.3, 1.1, 2.9))]
    path.write_text("\n".join(lines) + "\n")
    instance = certpgo.read(path, quiet=True)
    assert instance.graph.ranges.num_edges == 3
    solved_as_its_graph(instance, "chordal")
