"""Single wrong measurements, and the noise: by how much of it is stated, per kind."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.planted import N, changed, inverted, walk, weighed
from strategies import rng_of

import certpgo
from certpgo.diagnosis import noise
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.likelihood import Likelihood
from certpgo.diagnosis.study import studied_problem, study
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so

LOOP = N + 3  # a loop closure


def found_in(instance):
    return certpgo.diagnose(instance).findings


def wrong(instance, row=LOOP):
    d = instance.graph.d
    R, t = instance.graph.rotations.copy(), instance.graph.translations.copy()
    R[row] = so.project(rng_of(5).standard_normal((1, d, d)))[0]
    t[row] += 3.0
    return changed(instance, rotations=R, translations=t)


def off_by_one(instance):
    edges = instance.graph.edges.copy()
    edges[LOOP, 1] += 1 if edges[LOOP, 1] + 1 not in (N, edges[LOOP, 0]) else -1
    return changed(instance, edges=edges)


def copied(instance):
    R, t = instance.graph.rotations.copy(), instance.graph.translations.copy()
    R[LOOP], t[LOOP] = R[LOOP + 2], t[LOOP + 2]
    return changed(instance, rotations=R, translations=t)


def with_w_first(instance):
    R = instance.graph.rotations.copy()
    q = np.roll(quaternion.to_write(R[LOOP : LOOP + 1]), 1, axis=1)
    R[LOOP : LOOP + 1] = quaternion.rotations(q)
    return changed(instance, rotations=R)


MISTAKES = {
    "wrong-measurement": wrong,
    "inverted-edge": lambda one: inverted(one, [LOOP]),
    "wrong-node": off_by_one,
    "copied-edge": copied,
    "edge-w-first": with_w_first,
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", MISTAKES)
def test_wrong_measurements_are_named(kind, d):
    if d == 2 and kind == "edge-w-first":
        pytest.skip("of space")
    [found] = found_in(MISTAKES[kind](walk(d)))
    assert found.kind == kind
    assert found.edges == (LOOP,)
    assert found.proven
    assert found.cost < found.cost_as_given


def test_a_wrong_step_is_blamed_and_not_the_loops_over_it():
    [found] = found_in(wrong(walk(3), 11))
    assert (found.kind, found.edges) == ("wrong-measurement", (11,))


def test_of_a_chain_any_may_be_the_wrong_one():
    [found] = found_in(wrong(walk(3), 11))
    assert "or instead 12-13: nothing tells which" in found.said
    assert not found.proven


def test_a_short_motion_is_not_said_to_be_between_neighbours():
    short = walk(2, seed=3)
    t = short.graph.translations.copy()
    t[N + 2] *= 0.02 / np.linalg.norm(t[N + 2])
    R = short.graph.rotations.copy()
    R[N + 2] = np.eye(2)
    [found, *_] = found_in(changed(short, rotations=R, translations=t))
    assert found.kind == "wrong-measurement"


def test_what_explains_little_is_said_to():
    """All loop closures in the frame of a sensor that is mounted askew."""
    graph, turn = walk(2).graph, np.array([[0.0, -1.0], [1.0, 0.0]])
    R, t = graph.rotations.copy(), graph.translations.copy()
    lever = np.array([0.25, 0.1])
    R[N - 1 :] = turn.T @ R[N - 1 :] @ turn
    moved = t[N - 1 :] + graph.rotations[N - 1 :] @ lever - lever
    t[N - 1 :] = moved @ turn
    for found in found_in(changed(walk(2), rotations=R, translations=t)):
        assert "correct" not in found.next.lower()


def test_many_wrong_ones_are_one_finding():
    instance = walk(3)
    for row in (N, N + 4, N + 7, N + 9, N + 12):
        instance = wrong(instance, row)
    [found] = found_in(instance)
    assert found.edges == (N, N + 4, N + 7, N + 9, N + 12)
    assert found.said.startswith("5 measurements are")
    assert ", ...; without them the map costs " in found.said


# --- Noise ----------------------------------------------------------------------------------------


def stated(instance, factor, rows=slice(None)):
    """The same measurements whose information is stated too large by a factor."""
    M = instance.graph.information_matrices.copy()
    M[rows] *= factor
    return weighed(instance, M)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("factor", [9.0, 1.0 / 9.0])
def test_noise_of_all(factor, d):
    [found] = found_in(stated(walk(d), factor))
    assert found.kind == ("noise-too-small" if factor > 1.0 else "noise-too-large")
    assert "all measurements" in found.said
    ratio = float(found.said.split(" times")[0].split()[-1])
    assert ratio == pytest.approx(factor**0.5, rel=0.2)


@pytest.mark.parametrize("d", [2, 3])
def test_noise_of_a_kind(d):
    [found] = found_in(stated(walk(d), 16.0, slice(N - 1)))
    assert found.kind == "noise-too-small"
    assert "odometry" in found.said


def test_identity_information_states_nothing():
    instance = walk(3)
    M = np.tile(np.eye(6), (len(instance.graph.edges), 1, 1))
    [found] = found_in(weighed(instance, M))
    assert found.kind == "identity-information"


def test_one_stiff_edge():
    [found] = found_in(stated(walk(3), 1e10, [LOOP]))[:1]
    assert (found.kind, found.edges) == ("stiff-edge", (LOOP,))


# --- What fits leave ------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [2, 3])
def test_what_is_left_is_what_dense_algebra_leaves(d):
    examined = Examined(walk(d))
    problem = studied_problem(examined.problem)
    found = study(problem, examined.answer.estimate, examined.anchor)
    n, m, p = N, len(found.edges), d * (d + 1) // 2
    [part] = found.parts
    A = np.zeros((m, p, n, p))
    for e, (i, j) in enumerate(found.edges):
        A[e, :, i], A[e, :, j] = part.slopes[e, :, :p], part.slopes[e, :, p:]
    A = np.delete(A, found.anchor, axis=2).reshape(m * p, -1)
    H = A.T @ A
    left = np.eye(m * p) - A @ np.linalg.solve(H, A.T)
    blocks = np.einsum("eaeb->eab", left.reshape(m, p, m, p))
    expected = np.einsum("ea,eab,eb->e", part.residuals, np.linalg.inv(blocks), part.residuals)
    np.testing.assert_allclose(found.surprises, expected, rtol=1e-6)
    assert found.fit.freedom == round(np.trace(left))
    kinds = [*examined.kinds.values()]
    of_rows = np.repeat(kinds, p, axis=1)
    B = [[(left[np.ix_(one, other)] ** 2).sum() for other in of_rows] for one in of_rows]
    np.testing.assert_allclose(found.coupling(kinds).B, B, rtol=0.1, atol=0.5)
    whole = found.fit.chi2 + np.linalg.slogdet(H)[1] - part.logs.sum()
    assert found.surprise == pytest.approx(whole, rel=1e-9)
    _same_likelihoods(Likelihood(found, kinds), A, part.residuals.reshape(-1), of_rows)


def _same_likelihoods(of, A, e, of_rows):
    """-2 log L, its slopes and what variances gain, by dense algebra and differences."""

    def surprise(logs):
        v = np.exp(logs) @ of_rows
        H = A.T @ (A / v[:, None])
        left = e - A @ np.linalg.solve(H, A.T @ (e / v))
        return float((left**2 / v).sum() + np.log(v).sum() + np.linalg.slogdet(H)[1])

    logs, step = np.array([1.2, -0.4]), 1e-4 * np.eye(2)
    at, stated = of.at(np.exp(logs)), of.at(np.ones(2))
    assert at.surprise == pytest.approx(surprise(logs), rel=1e-9)
    slopes = [(surprise(logs + by) - surprise(logs - by)) / 2e-4 for by in step]
    np.testing.assert_allclose(at.left - at.squares, slopes, rtol=1e-4, atol=1e-4)
    for v in (np.exp(logs), np.array([1e-12, 1.0]), np.full(2, 4.0)):
        gain = stated.surprise - of.at(v).surprise
        most = noise._gained_at_most(of.fit.coupling(of.kinds), v)
        assert gain <= most + 1e-6 * abs(most)
    assert gain == pytest.approx(most)  # of all together


def test_what_does_not_count_is_compared_with_what_the_others_say():
    instance = wrong(walk(3))
    examined = Examined(instance)
    problem = studied_problem(examined.problem)
    counts = np.arange(len(instance.graph.edges)) != LOOP
    again = certpgo.solve(replace(instance, graph=instance.graph.with_edges(counts)))
    without = study(problem, again.estimate, examined.anchor, counts=counts)
    assert without.fit.chi2 == pytest.approx(again.cost, rel=1e-6)
    assert without.surprises[LOOP] > 100.0 * without.surprises[counts].max()
    assert without.checked[LOOP] == 6
