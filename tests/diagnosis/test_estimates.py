"""Conventions of an estimate: each mistake is named, and none of a right one."""

import numpy as np
import pytest
from strategies import pose_graph, rng_of

import certpgo
from certpgo import Estimate
from certpgo.diagnosis import estimates
from certpgo.diagnosis.examined import Examined
from certpgo.io.exact import quaternion

N = 30


def walk(d, seed=0):
    """A graph of poses with loops, and its best estimate."""
    graph = pose_graph(rng_of(seed), N, d, extra=N, noise=0.03)[0]
    return graph, certpgo.solve(graph).estimate


def inverse(R, t):
    back = np.swapaxes(R, 1, 2)
    return back, -np.einsum("nab,nb->na", back, t)


def with_w_first(R, t):
    return quaternion.rotations(np.roll(quaternion.to_write(R), 1, axis=1)), t


def turned(R, t):
    return np.swapaxes(R, 1, 2), t


def mirrored(R, t):
    signs = np.where(np.arange(t.shape[1]) == 1, -1.0, 1.0)
    return R, signs * t


def of_other_hand(R, t):
    signs = np.where(np.arange(t.shape[1]) == 1, -1.0, 1.0)
    return signs[:, None] * R * signs, signs * t


def of_camera(R, t):
    C = np.eye(R.shape[1])[:, [1, 0]] * [1.0, -1.0] if R.shape[1] == 2 else None
    if C is None:
        C = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return R @ C, t


MISTAKES = {
    "inverse-poses": inverse,
    "inverse-rotations": turned,
    "mirrored": mirrored,
    "other-handedness": of_other_hand,
    "permuted-axes": of_camera,
    "millimetres": lambda R, t: (R, 1e3 * t),
    "feet": lambda R, t: (R, t / 0.3048),
    "scaled": lambda R, t: (R, 0.37 * t),
    "reordered": lambda R, t: (R[::-1], t[::-1]),
    "quaternion-w-first": with_w_first,
}
OF_SPACE = {"quaternion-w-first"}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", MISTAKES)
def test_each_mistake_is_named_first(kind, d):
    if d == 2 and kind in OF_SPACE:
        return
    graph, best = walk(d)
    R, t = MISTAKES[kind](best.rotations, best.translations)
    found = certpgo.diagnose(graph, Estimate(R, t)).findings
    assert found[0].kind == kind
    assert found[0].cost < 0.01 * found[0].cost_as_given
    assert "so read it costs" in found[0].said


@pytest.mark.parametrize("d", [2, 3])
def test_right_ones_and_others_have_no_convention(d):
    graph, best = walk(d)
    rng = rng_of(1)
    for size in (0.0, 1e-3, 0.3):
        t = best.translations + size * rng.standard_normal(best.translations.shape)
        [*found] = estimates.found(Examined(as_instance(graph), Estimate(best.rotations, t)))
        assert found == []


def as_instance(graph):
    return certpgo.Instance("graph", graph, np.arange(graph.num_nodes))


def test_two_mistakes_at_once():
    graph, best = walk(3)
    R, t = with_w_first(*inverse(best.rotations, 1e3 * best.translations))
    [found] = estimates.found(Examined(as_instance(graph), Estimate(R, t)))
    assert found.kind == "quaternion-w-first"
    assert "world to camera" in found.said
    assert "millimetres" in found.said


def test_poses_of_the_next_node():
    graph, best = walk(3)
    R, t = (np.roll(of, 1, axis=0) for of in (best.rotations, best.translations))
    [found] = estimates.found(Examined(as_instance(graph), Estimate(R, t)))
    assert found.kind == "reordered"
    assert "1 node too late" in found.said


def test_a_world_stays_where_it_is():
    graph, best = walk(3)
    fixed = certpgo.with_priors(graph, np.arange(N), translations=best.translations, tau=1.0)
    best = certpgo.solve(fixed).estimate
    R, t = inverse(best.rotations, best.translations)
    R, t = R.copy(), t.copy()
    R[N], t[N] = best.rotations[N], best.translations[N]
    instance = certpgo.Instance("fixed", fixed, np.arange(N + 1), world=N)
    assert instance.world == N
    [found] = estimates.found(Examined(instance, Estimate(R, t)))
    assert found.kind == "inverse-poses"
