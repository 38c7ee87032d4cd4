"""Preintegrated inertial measurements: their cost, its form, and what goes with them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

import certpgo
from certpgo import Estimate, GraphError, InputError, Preintegrated, Ranges
from certpgo.graph.concatenate import joined
from certpgo.graph.inertial import GRAVITY
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.kernels import Kernel
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.descent import descend
from reports.studies.inertial import DT, POSITION, VELOCITY, flight

N = 7


@cache
def flown():
    """A flight, its estimate with velocities at the truth, and the best one."""
    graph, truth, v = flight(np.random.default_rng(0), N)
    return graph, truth, v, certpgo.solve(graph)


def at(graph, truth, v):
    """The estimate of true poses and velocities, with gravity's frame as the world."""
    T = graph.blocks[0].units[0]
    R = np.concatenate([truth.rotations, np.tile(np.eye(3), (N + 1, 1, 1))])
    t = np.concatenate([truth.translations, truth.translations + T * v, truth.translations[:1]])
    return Estimate(R, t)


def steps_by_hand(graph, x, lag=0.0):
    """The sum of w_v |e_v|^2 + w_p |e_p|^2, from the definitions."""
    block, total = graph.blocks[0], 0.0
    for k, (i, vi, j, vj, w) in enumerate(block.nodes):
        R, t, T, dt = x.rotations, x.translations, block.units[k], block.seconds[k]
        v_i, v_j, g = (t[vi] - t[i]) / T, (t[vj] - t[j]) / T, R[w] @ block.gravity[k]
        dp = block.position_steps[k] + lag * block.velocity_steps[k]
        e_v = v_j - v_i - g * dt - R[i] @ block.velocity_steps[k]
        e_p = t[j] - t[i] - v_i * dt - g * dt**2 / 2 - R[i] @ dp - lag * e_v
        total += block.weights[k] @ [e_v @ e_v, e_p @ e_p]
    return total


def anywhere(seed, n, size=10.0):
    rng = np.random.default_rng(seed)
    return Estimate(so.random(rng, n, 3), size * rng.standard_normal((n, 3)))


def with_lags(graph, lag):
    block = graph.blocks[0]
    steps = block.position_steps - lag * block.velocity_steps
    lagging = replace(block, lags=np.full(len(block.nodes), lag), position_steps=steps)
    return graph.with_blocks(lagging)


# --- The cost -------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag", [0.0, 0.2, DT])
def test_the_cost_is_that_of_the_definitions(lag):
    graph = with_lags(flown()[0], lag)
    problem, x = objective_of(graph), anywhere(1, graph.num_nodes)
    of_edges = objective_of(graph.with_edges(np.arange(graph.num_edges))).edge_costs(x)
    by_hand = of_edges[: graph.num_edges].sum() + steps_by_hand(graph, x, lag)
    assert problem.cost(x) == pytest.approx(by_hand, rel=1e-12)
    low, high = problem.enclosure(x)
    assert low <= by_hand * (1.0 + 1e-13)
    assert by_hand * (1.0 - 1e-13) <= high
    assert high - low < 1e-9 * high


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_the_form_is_the_cost_itself_everywhere(lag):
    problem = objective_of(with_lags(flown()[0], lag))
    surrogate = problem.surrogate(anywhere(2, problem.n))
    for seed in range(3, 6):
        x = anywhere(seed, problem.n)
        value = surrogate.problem.cost(x) + surrogate.constant
        assert value == pytest.approx(problem.cost(x), rel=1e-11)
        assert value <= problem.cost(x) * (1.0 + 1e-11)


def test_measurements_without_noise_cost_nothing():
    graph, truth, v = flight(np.random.default_rng(3), N, noise=0.0)
    problem, x = objective_of(graph), at(graph, truth, v)
    assert problem.cost(x) < 1e-18 * problem.scale
    answer = certpgo.solve(graph)
    assert answer.verdict.value == "CERTIFIED"
    there = answer.estimate.anchored(0)
    assert there.translations[:N] == pytest.approx(truth.translations, abs=1e-6)
    poses, found = graph.blocks[0].velocities(there)
    assert poses.tolist() == list(range(N))
    assert found == pytest.approx(v, abs=1e-6)
    down = there.rotations[-1] @ GRAVITY
    assert down == pytest.approx(GRAVITY, abs=1e-5)


def test_derivatives_are_those_of_the_cost():
    graph, *_ = flown()
    problem, x = objective_of(graph), anywhere(4, graph.num_nodes, 3.0)
    slopes = problem.tangent_layout.unpack(problem.normal_equations(x).gradient)
    for node in (0, 3, N + 2, 2 * N):
        for k in range(3 if graph.is_point[node] else 6):

            def cost(step, node=node, k=k):
                R, t = x.rotations.copy(), x.translations.copy()
                if k < 3:
                    t[node, k] += step
                else:
                    R[node] = R[node] @ so.exp(step * np.eye(3)[[k - 3]])[0]
                return problem.cost(Estimate(R, t))

            slope = (cost(1e-5) - cost(-1e-5)) / 4e-5
            assert slopes[node, k] == pytest.approx(slope, rel=1e-5, abs=1e-3)


# --- Certified ------------------------------------------------------------------------------------


def test_the_optimum_is_that_of_another_program():
    """SciPy's trust region method over rotation vectors, positions, velocities and gravity."""
    n = 4
    graph, truth, v = flight(np.random.default_rng(0), n)
    answer = certpgo.solve(graph)
    assert answer.verdict.value == "CERTIFIED"
    m, block = graph.num_edges - 1, graph.blocks[0]
    i, j = graph.edges[:m].T

    def residuals(z):
        turn, p, vel = np.split(z[:-3].reshape(-1, 3), [n, 2 * n])
        R = truth.rotations @ so.exp(turn)
        E = R[j] - R[i] @ graph.rotations[:m]
        r = p[j] - p[i] - (R[i] @ graph.translations[:m][:, :, None])[:, :, 0]
        g = np.linalg.norm(GRAVITY) * z[-3:] / np.linalg.norm(z[-3:])
        a, b = block.nodes[:, 0], block.nodes[:, 2]
        e_v = vel[b] - vel[a] - DT * g - (R[a] @ block.velocity_steps[:, :, None])[:, :, 0]
        e_p = p[b] - p[a] - DT * vel[a] - DT**2 / 2 * g
        e_p = e_p - (R[a] @ block.position_steps[:, :, None])[:, :, 0]
        parts = (np.sqrt(graph.kappa[:m])[:, None, None] * E, np.sqrt(graph.tau[:m])[:, None] * r)
        return np.concatenate([x.ravel() for x in (*parts, e_v / VELOCITY, e_p / POSITION)])

    start = np.concatenate([np.zeros(3 * n), truth.translations.ravel(), v.ravel(), GRAVITY])
    found = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert 2.0 * found.cost == pytest.approx(answer.cost, rel=1e-9)
    assert answer.certificate.lower_bound <= 2.0 * found.cost
    for seed in range(3):
        end = descend(answer.problem, anywhere(seed, graph.num_nodes))
        assert end.cost >= answer.certificate.lower_bound


def test_turning_relabelling_and_scaling_change_nothing():
    graph, _, _, answer = flown()
    perm = np.random.default_rng(1).permutation(graph.num_nodes)
    assert certpgo.solve(graph.subgraph(perm)).cost == pytest.approx(answer.cost, rel=1e-9)
    scaled = certpgo.solve(graph.scaled(1e6))
    assert scaled.verdict.value == "CERTIFIED"
    assert scaled.cost == pytest.approx(1e6 * answer.cost, rel=1e-9)
    Q = so.random(np.random.default_rng(2), 1, 3)[0]
    block = graph.blocks[0]
    turned = graph.with_blocks(replace(block, gravity=block.gravity @ Q.T))
    assert certpgo.solve(turned).cost == pytest.approx(answer.cost, rel=1e-9)


@pytest.mark.parametrize("world", [True, False])
def test_with_positions_in_the_world(world):
    """Of gravity, which then is known; or another one, towards which it is estimated."""
    graph, truth, v, answer = flown()
    nodes = np.arange(0, N, 2)
    own = 2 * N if world else None
    where = {"translations": truth.translations[nodes], "tau": 1e4, "world": own}
    whole = certpgo.with_priors(graph, nodes, **where)
    assert whole.num_nodes == graph.num_nodes + (not world)
    both = certpgo.solve(whole)
    assert both.verdict.value == "CERTIFIED"
    assert both.cost > answer.cost
    there = both.estimate.anchored(2 * N + (not world))
    assert whole.blocks[0].velocities(there)[1] == pytest.approx(v, abs=0.3)
    assert both.covariance(1).shape == (6, 6) if world else both.undetermined is not None


def test_with_what_else_is_measured():
    """Distances, speeds in frames of bodies, other costs of relative poses, and rejections."""
    graph, truth, v, answer = flown()
    n, m = graph.num_nodes, graph.num_edges
    apart = np.linalg.norm(truth.translations[[4]] - truth.translations[[1]], axis=1)
    ranged = graph.with_ranges(Ranges(n, np.array([[1, 4]]), apart, np.array([100.0])))
    assert certpgo.solve(ranged).verdict.value == "CERTIFIED"
    speeds = (np.swapaxes(truth.rotations, 1, 2) @ v[:, :, None])[:, :, 0]
    seen = certpgo.PoseGraph(
        certpgo.RotationGraph(
            n, np.column_stack([np.arange(N), N + np.arange(N)]), truth.rotations, np.zeros(N)
        ),
        graph.blocks[0].units[0] * speeds,
        np.full(N, 100.0),
        points=graph.is_point,
    )
    driven = certpgo.solve(joined([graph, seen], n, graph.is_point))
    assert driven.verdict.value == "CERTIFIED"
    assert driven.cost > answer.cost
    information = np.zeros((m, 6, 6))
    information[:, range(3), range(3)] = graph.tau[:, None]
    information[:, range(3, 6), range(3, 6)] = 2.0 * graph.kappa[:, None]
    stated = graph.with_information(information)
    for cost in ("g2o", "gtsam"):
        assert certpgo.solve(stated, cost=cost).verdict.value == "CERTIFIED"
    problem = objective_of(graph)
    wrong = certpgo.PoseGraph(
        certpgo.RotationGraph(n, [[1, 5]], so.random(np.random.default_rng(0), 1, 3), np.ones(1)),
        np.full((1, 3), 9.0),
        np.array([400.0]),
        points=graph.is_point,
    )
    problem = objective_of(joined([graph, wrong], n, graph.is_point))
    prices = np.where(np.arange(problem.graph.num_edges) == m, 20.0, np.inf)
    judged = certpgo.certify(TruncatedCost(problem, prices), answer.estimate)
    assert judged.verdict.value == "CERTIFIED"
    assert judged.cost_upper == pytest.approx(answer.cost + 20.0)
    scale = np.where(graph.measures_translation & graph.measures_rotation, 2.0, np.inf)
    robust = certpgo.solve(graph, kernel=Kernel("huber", scale))
    assert robust.cost <= answer.cost * (1.0 + 1e-12)
    assert robust.certificate.lower_bound <= robust.cost


def test_a_worse_estimate_is_not_certified():
    graph, _, _, answer = flown()
    x = answer.estimate
    turn = 0.02 * np.random.default_rng(5).standard_normal((graph.num_nodes, 3))
    judged = certpgo.certify(graph, Estimate(so.turned(x.rotations, turn), x.translations))
    assert judged.verdict.value != "CERTIFIED"
    assert judged.lower_bound <= answer.cost


# --- The block ------------------------------------------------------------------------------------


def test_blocks_of_parts_and_weights():
    graph, *_ = flown()
    block = graph.blocks[0]
    assert block.num_measurements == 2 * (N - 1)
    assert block.between(np.arange(N)) is None
    some = block.nodes[:2].ravel()
    assert len(block.between(np.unique(some)).nodes) == 2
    factors = np.ones(block.num_edges)
    factors[: block.num_edges // (N - 1)] = 0.0
    assert len(block.reweighted(factors).nodes) == N - 2
    assert block.subset(factors == 0.0).nodes.tolist() == block.nodes[:1].tolist()
    doubled = joined([graph, graph], graph.num_nodes, graph.is_point)
    assert certpgo.solve(doubled).cost == pytest.approx(2.0 * flown()[3].cost, rel=1e-8)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("seconds", 0.0, "seconds must be finite and positive"),
        ("lags", 9.0, "a lag is between 0 and the seconds"),
        ("units", 3.0, "a unit of time is a power of two"),
        ("weights", -1.0, "weight of e_v is -1.0; it must be positive"),
        ("gravity", np.nan, "gravity must be finite"),
    ],
)
def test_numbers_out_of_range_are_named(name, value, said):
    block = flown()[0].blocks[0]
    given = getattr(block, name).copy()
    given[1] = value
    with pytest.raises(GraphError, match=f"{said}"):
        replace(block, **{name: given})


def test_a_pose_has_one_velocity():
    nodes = flown()[0].blocks[0].nodes.copy()
    nodes[1, 1] = nodes[4, 1]
    with pytest.raises(GraphError, match="velocities"):
        replace(flown()[0].blocks[0], nodes=nodes)


def test_what_is_not_taken_is_said():
    graph, *_ = flown()
    with pytest.raises(InputError, match="given together"):
        added(graph)
    plane = certpgo.PoseGraph(
        certpgo.RotationGraph(2, [[0, 1]], np.eye(2)[None], np.ones(1)),
        np.zeros((1, 2)),
        np.ones(1),
    )
    with pytest.raises(InputError, match="in space"):
        added(plane)
    with pytest.raises(InputError, match="a session does not take preintegrated"):
        certpgo.Session().add(graph)
    with pytest.raises(InputError, match="proof tier"):
        certpgo.solve(graph, tier="proof")
    with pytest.raises(InputError, match="no format holds preintegrated"):
        certpgo.write("flight.npz", certpgo.Instance("x", graph, np.arange(graph.num_nodes)))
    assert isinstance(graph.blocks[0], Preintegrated)


def added(graph):
    none = np.zeros((1, 3))
    return certpgo.with_preintegrated(
        graph, [[0, 1]], [1.0], np.eye(3)[None], none, none, kappa=1.0, weights=[1.0, 1.0]
    )
