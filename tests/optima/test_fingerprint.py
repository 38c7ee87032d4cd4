"""Digests of measurements: what they depend on, and what they do not."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import pose_graph, rng_of

import certpgo
from certpgo.graph.components import rotations_alone
from certpgo.optima import fingerprint

COSTS = ("chordal", "g2o", "gtsam")


def prints(instance):
    return {cost: fingerprint(instance, cost) for cost in COSTS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("graphs")


def lines_of(seed, d):
    """The lines of a g2o file: nodes and edges with information."""
    rng = rng_of(seed)
    graph = pose_graph(rng, 6, d)[0]
    lines = []
    for (i, j), R, t in zip(graph.edges, graph.rotations, graph.translations, strict=True):
        p = d * (d + 1) // 2
        A = rng.normal(size=(p, p))
        Omega = A @ A.T + 5.0 * np.eye(p)
        upper = Omega[np.triu_indices(p)]
        if d == 2:
            pose, tag = [*t, np.arctan2(R[1, 0], R[0, 0])], "EDGE_SE2"
        else:
            q = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            w = 0.5 * np.sqrt(1.0 + np.trace(R))
            pose, tag = [*t, *(q / (4.0 * w)), w], "EDGE_SE3:QUAT"
        lines.append((tag, int(i), int(j), [float(f"{x:.9g}") for x in [*pose, *upper]]))
    return lines


def read(folder, lines, shown=repr, comments=False, vertices=(), shift=0):
    text = [f"{v}\n" for v in vertices]
    for tag, i, j, numbers in lines:
        if comments:
            text.append("# a comment\n\n")
        text.append(f"{tag} {i + shift} {j + shift} {' '.join(map(shown, numbers))}\n")
    path = folder / "graph.g2o"
    path.write_text("".join(text))
    return certpgo.read(path, quiet=True)


SHOWN = (repr, "{:.12e}".format, "{:+.17g}".format, lambda x: f"  {x!r}")


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), d=st.sampled_from([2, 3]), shown=st.sampled_from(SHOWN))
def test_how_a_file_is_written_does_not_count(folder, seed, d, shown):
    lines = lines_of(seed, d)
    before = prints(read(folder, lines))
    shuffled = random.Random(seed).sample(lines, len(lines))
    # Another start, order, format, comments, and ids that begin elsewhere.
    start = [f"VERTEX_SE2 {k + 3} {k} 1 0.5" for k in range(6)] if d == 2 else []
    after = prints(read(folder, shuffled, shown, comments=True, vertices=start, shift=3))
    assert after == before


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), d=st.sampled_from([2, 3]), data=st.data())
def test_every_number_counts(folder, seed, d, data):
    lines = lines_of(seed, d)
    before = read(folder, lines)
    k = data.draw(st.integers(0, len(lines) - 1))
    place = data.draw(st.integers(0, len(lines[k][3]) - 1))
    tag, i, j, numbers = lines[k]
    changed = list(numbers)
    changed[place] += 1e-4 * (1.0 + abs(changed[place]))
    lines[k] = (tag, i, j, changed)
    after = read(folder, lines)
    for cost in ("g2o", "gtsam"):
        assert fingerprint(before, cost).digest != fingerprint(after, cost).digest
    # F does not know some numbers, such as the covariance of an angle with a position.
    pairs = [
        (before.graph.tau, after.graph.tau),
        (before.graph.kappa, after.graph.kappa),
        (before.graph.rotations, after.graph.rotations),
        (before.graph.translations, after.graph.translations),
    ]
    same = all(np.allclose(a, b, rtol=1e-12, atol=1e-13) for a, b in pairs)
    assert (fingerprint(before).digest == fingerprint(after).digest) == same
    assert fingerprint(before).exact != fingerprint(after).exact


@given(seed=st.integers(0, 10**6), d=st.sampled_from([2, 3]))
def test_rounding_leaves_the_digest_and_changes_the_exact_one(seed, d):
    graph = pose_graph(rng_of(seed), 5, d)[0]
    moved = certpgo.PoseGraph(
        graph.rotations_alone,
        graph.translations * (1.0 + 2.0**-51),
        graph.tau,
        points=graph.is_point,
    )
    one, other = fingerprint(graph), fingerprint(moved)
    assert one.exact != other.exact
    # Of 20 numbers, hardly ever one is at the edge of a cell of 2^-33.
    assert one.digest == other.digest


def test_pairs_directions_and_copies_count(folder):
    lines = lines_of(0, 2)
    known = fingerprint(read(folder, lines)).digest
    tag, i, j, numbers = lines[-1]
    for changed in (
        [*lines[:-1], (tag, j, i, numbers)],
        [*lines, lines[-1]],
        lines[:-1],
        [*lines[:-1], (tag, i, (j + 1) % 6 if (j + 1) % 6 != i else (j + 2) % 6, numbers)],
    ):
        assert fingerprint(read(folder, changed)).digest != known


def test_zeros_have_no_sign(folder):
    lines = [("EDGE_SE2", 0, 1, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0])]
    minus = [("EDGE_SE2", 0, 1, [1.0, -0.0, -0.0, 1.0, -0.0, 0.0, 1.0, 0.0, 1.0])]
    assert prints(read(folder, lines)) == prints(read(folder, minus))


def test_a_quaternion_and_its_negative_are_one_rotation(folder):
    lines = lines_of(3, 3)
    turned = [(tag, i, j, [*n[:3], *(-x for x in n[3:7]), *n[7:]]) for tag, i, j, n in lines]
    assert prints(read(folder, lines)) == prints(read(folder, turned))


def test_other_formats_and_rotations_alone(folder, tmp_path):
    instance = read(folder, lines_of(5, 3))
    certpgo.write(tmp_path / "graph.json", instance)
    again = certpgo.read(tmp_path / "graph.json", quiet=True)
    assert fingerprint(again, "g2o").digest == fingerprint(instance, "g2o").digest
    alone = rotations_alone(instance)
    assert fingerprint(alone).digest != fingerprint(instance).digest
    assert fingerprint(alone, "g2o") is None
    assert fingerprint(instance.graph, "g2o").digest == fingerprint(instance, "g2o").digest
    assert fingerprint(instance.graph.with_information(None), "g2o") is None


def test_distances_have_no_direction():
    rng = rng_of(0)
    graph = pose_graph(rng, 4, 2)[0]
    found = set()
    for pairs in ([[0, 2], [1, 3]], [[3, 1], [2, 0]]):
        lengths = [1.0, 2.0] if pairs[0] == [0, 2] else [2.0, 1.0]
        ranges = certpgo.Ranges(4, np.array(pairs), np.array(lengths), np.ones(2))
        instance = certpgo.Instance("ranged", graph.with_ranges(ranges), np.arange(4))
        found.add(fingerprint(instance))
    assert len(found) == 1
    assert found != {fingerprint(graph)}


@pytest.mark.parametrize("name", ["sphere2500", "victoria_park", "goats_16"])
def test_digests_do_not_depend_on_the_order_of_real_files(name, dataset):
    instance = dataset(name)
    order = rng_of(1).permutation(instance.graph.num_edges)
    shuffled = instance.with_edges(order)
    for cost in COSTS:
        assert fingerprint(instance, cost) == fingerprint(shuffled, cost)
