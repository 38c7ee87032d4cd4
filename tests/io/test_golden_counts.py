"""Counts and weights of the benchmark files, as their manifest and SE-Sync's paper state them."""

import numpy as np
import pytest

from certpgo import io
from certpgo.linalg import rotations as so

POSES = {
    "collections/pudq/pudq_Grid1000_5.g2o": (1000, 1250),
    "collections/pudq/pudq_M3500_4.g2o": (3500, 5598),
    "outliers/grid1000_10p_measurements.g2o": (1000, 1488),
    "outliers/grid1000_30p_measurements.g2o": (1000, 1501),
    "outliers/grid1000_50p_measurements.g2o": (1000, 1519),
    "outliers/inputGrid3D-noOutliers.g2o": (125, 299),
    "outliers/inputGrid3D-withOutliers.g2o": (125, 299),
    "slam2d/M3500a.g2o": (3500, 5453),
    "slam2d/M3500b.g2o": (3500, 5453),
    "slam2d/M3500c.g2o": (3500, 5453),
    "slam2d/MIT.g2o": (808, 827),
    "slam2d/ais2klinik.g2o": (15115, 16727),
    "slam2d/city10000.g2o": (10000, 20687),
    "slam2d/city10000_groundtruth.txt": (10000, 20687),
    "slam2d/cityTrees10000.g2o": (10100, 14442),
    "slam2d/intel.g2o": (1728, 2512),
    "slam2d/kitti_00.g2o": (4541, 4677),
    "slam2d/kitti_05.g2o": (2761, 2826),
    "slam2d/manhattan.g2o": (3500, 5453),
    "slam2d/ring.g2o": (434, 459),
    "slam2d/ring_groundtruth.g2o": (434, 459),
    "slam3d/Klaus3.g2o": (3, 3),
    "slam3d/burghers.g2o": (1124, 4118),
    "slam3d/cubicle.g2o": (5750, 16869),
    "slam3d/drone.g2o": (2206, 2646),
    "slam3d/parking-garage.g2o": (1661, 6275),
    "slam3d/smallGrid3D.g2o": (125, 297),
    "slam3d/sphere2500.g2o": (2500, 4949),
    "slam3d/sphere2500.txt": (2500, 4949),
    "slam3d/sphere2500_groundtruth.txt": (2500, 4949),
    "slam3d/sphere400.txt": (400, 779),
    "slam3d/sphere_bignoise_vertex3.g2o": (2200, 8647),
    "slam3d/stonewall.g2o": (271, 888),
    "slam3d/tinyGrid3D.g2o": (9, 11),
    "slam3d/torus10000.txt": (10000, 22280),
    "slam3d/torus3D.g2o": (5000, 9048),
    "slam3d/toyExample.g2o": (5, 6),
}
ROTATIONS = {
    "rotation/parking-garage_SO3.g2o": (1661, 6275),
    "rotation/smallGrid3D_SO3.g2o": (125, 297),
    "rotation/cycles/cycle20_0.5_SO3.g2o": (20, 20),
    "rotation/cycles/cycle50_0.5_SO3.g2o": (50, 50),
    "rotation/cycles/cycle100_0.5_SO3.g2o": (100, 100),
    "rotation/cycles/cycle200_0.5_SO3.g2o": (200, 200),
    "rotation/lund/sphinx_SO3.g2o": (70, 1207),
    "rotation/1dsfm/Ellis_Island": (247, 20297),
    "rotation/1dsfm/Madrid_Metropolis": (394, 23784),
    "rotation/1dsfm/Montreal_Notre_Dame": (474, 52424),
    "rotation/1dsfm/NYC_Library": (376, 20680),
    "rotation/1dsfm/Piazza_del_Popolo": (354, 24710),
    "rotation/1dsfm/Tower_of_London": (508, 23863),
    "rotation/1dsfm/Union_Square": (930, 25561),
    "rotation/1dsfm/Yorkminster": (458, 27729),
    "rotation/viewing_graphs/Alamo.mat": (627, 97206),
    "rotation/viewing_graphs/Ellis_Island.mat": (247, 20297),
    "rotation/viewing_graphs/Gendarmenmarkt.mat": (742, 48144),
    "rotation/viewing_graphs/Madrid_Metropolis.mat": (394, 23784),
    "rotation/viewing_graphs/Montreal_Notre_Dame.mat": (474, 52424),
    "rotation/viewing_graphs/NYC_Library.mat": (376, 20680),
    "rotation/viewing_graphs/Notre_Dame.mat": (553, 103932),
    "rotation/viewing_graphs/Piazza_del_Popolo.mat": (354, 24710),
    "rotation/viewing_graphs/Piccadilly.mat": (2508, 319257),
    "rotation/viewing_graphs/Quad.mat": (5530, 222044),
    "rotation/viewing_graphs/Roman_Forum.mat": (1134, 70187),
    "rotation/viewing_graphs/Tower_of_London.mat": (508, 23863),
    "rotation/viewing_graphs/Trafalgar.mat": (5433, 680012),
    "rotation/viewing_graphs/Union_Square.mat": (930, 25561),
    "rotation/viewing_graphs/Vienna_Cathedral.mat": (918, 103550),
    "rotation/viewing_graphs/Yorkminster.mat": (458, 27729),
}


@pytest.mark.parametrize(("name", "counts"), POSES.items())
def test_pose_graphs_have_the_manifests_counts(data, name, counts):
    graph = io.read(data(name), quiet=True).graph
    assert graph.has_positions
    assert (graph.num_nodes, graph.num_edges) == counts


@pytest.mark.parametrize(("name", "counts"), ROTATIONS.items())
def test_rotation_graphs_have_the_manifests_counts(data, name, counts):
    graph = io.read(data(name), quiet=True).graph
    assert not graph.has_positions
    assert (graph.num_nodes, graph.num_edges, graph.d) == (*counts, 3)


@pytest.mark.parametrize(
    ("name", "fragment"),
    [
        ("slam3d/cubicle.g2o", "5021 edges with information indefinite"),
        ("slam3d/burghers.g2o", "4118 edges without information"),
        ("slam3d/stonewall.g2o", "888 edges without information"),
        ("slam3d/drone.g2o", "2646 edges without information"),
        ("slam2d/cityTrees10000.g2o", "100 points, 4443 sightings; point k has the id k + 10000"),
        ("rotation/smallGrid3D_SO3.g2o", "read as a rotation graph"),
        ("rotation/1dsfm/Ellis_Island", "truth for 227 of 247 nodes"),
        ("rotation/viewing_graphs/Ellis_Island.mat", "only the topology"),
    ],
)
def test_quirks_are_noticed(data, name, fragment):
    assert any(fragment in notice for notice in io.read(data(name), quiet=True).notices)


def test_cubicle_has_4383_parallel_edges(data):
    path = data("slam3d/cubicle.g2o")
    for keep in ("first", "last"):
        instance = io.read(path, keep=keep, quiet=True)
        assert instance.graph.num_edges == 16869 - 4383
        assert instance.options["keep"] == keep


def test_sphere2500_states_its_weights_in_two_ways(data):
    g2o = io.read(data("slam3d/sphere2500.g2o")).graph
    isam = io.read(data("slam3d/sphere2500.txt"))
    np.testing.assert_allclose(g2o.kappa, 99.5, rtol=1e-2)
    np.testing.assert_array_equal(isam.graph.kappa, 25.0)
    assert isam.options["rotation_information"] == "rpy"
    quarter = io.read(data("slam3d/sphere2500.g2o"), rotation_information="quaternion")
    np.testing.assert_array_equal(quarter.graph.kappa, g2o.kappa / 4)


def test_isam_and_g2o_state_the_same_measurements_of_sphere2500(data):
    # Fixes the convention R = Rz(yaw) Ry(pitch) Rx(roll) and the direction of EDGE3.
    g2o, isam = (io.read(data(f"slam3d/sphere2500.{s}")).graph for s in ("g2o", "txt"))
    a, b = (np.lexsort(graph.edges.T[::-1]) for graph in (g2o, isam))
    np.testing.assert_array_equal(g2o.edges[a], isam.edges[b])
    np.testing.assert_allclose(g2o.translations[a], isam.translations[b], rtol=0, atol=1e-6)
    R, S = g2o.rotations[a], isam.rotations[b]
    np.testing.assert_allclose(R, S, rtol=0, atol=5e-6)


@pytest.mark.parametrize(
    ("name", "truth", "translation", "rotation"),
    [
        ("slam3d/sphere2500.g2o", "slam3d/sphere2500_groundtruth.txt", 0.5, 0.2),
        ("slam2d/city10000.g2o", "slam2d/city10000_groundtruth.txt", 0.2, 0.1),
        ("slam2d/ring.g2o", "slam2d/ring_groundtruth.g2o", 0.4, 0.1),
    ],
)
def test_measurements_are_near_their_ground_truth(data, name, truth, translation, rotation):
    instance = io.read(data(name), truth=data(truth))
    i, j = instance.graph.edges.T
    R, t = instance.truth.rotations, instance.truth.translations
    step = np.einsum("nji,nj->ni", R[i], t[j] - t[i]) - instance.graph.translations
    assert np.linalg.norm(step, axis=1).max() < translation
    turned = np.swapaxes(R[i] @ instance.graph.rotations, 1, 2) @ R[j]
    assert np.median(so.angle(turned)) < rotation


def test_ellis_island_truth_agrees_as_its_manifest_says(data):
    instance = io.read(data("rotation/1dsfm/Ellis_Island"), quiet=True)
    nodes, truth = io.read_truth(data("rotation/1dsfm/Ellis_Island/gt_rots.txt"), instance)
    assert len(nodes) == truth.num_nodes == 227
    place = np.full(instance.graph.num_nodes, -1)
    place[nodes] = np.arange(len(nodes))
    covered = (place[instance.graph.edges] >= 0).all(axis=1)
    i, j = place[instance.graph.edges[covered]].T
    R = truth.rotations
    turned = np.swapaxes(R[i] @ instance.graph.rotations[covered], 1, 2) @ R[j]
    angle = np.degrees(so.angle(turned))
    assert (round(float(np.median(angle)), 1), round(float(angle.mean()), 1)) == (2.9, 12.5)


@pytest.mark.gtsam
@pytest.mark.parametrize(
    ("name", "counts", "notice"),
    [
        ("w100.graph", (100, 300), "40 EQUIV lines skipped"),
        ("w10000.graph", (10000, 64311), "5875 EQUIV lines skipped"),
        ("example.graph", (95, 94), "422 BR lines skipped"),
        ("sphere_smallnoise.graph", (2200, 8647), "8647 edges without information"),
    ],
)
def test_toro_files_agree_with_their_vertices(name, counts, notice):
    gtsam = pytest.importorskip("gtsam")
    instance = io.read(gtsam.findExampleDataFile(name), quiet=True)
    graph = instance.graph
    assert (graph.num_nodes, graph.num_edges) == counts
    assert any(notice in n for n in instance.notices)

    def residual(i, j):
        R, t = instance.initial.rotations, instance.initial.translations
        predicted = np.einsum("nij,nj->ni", R[i], graph.translations)
        return float(np.median(np.linalg.norm(t[j] - t[i] - predicted, axis=1)))

    # The vertices are rough odometry, yet the edges fit them in the stated direction only.
    i, j = graph.edges.T
    assert residual(i, j) < 0.85 * residual(j, i)
