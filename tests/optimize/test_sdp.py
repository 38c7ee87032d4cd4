"""(D) and (DD): closed forms, agreement with the certified optimum, laws, refusals."""

import importlib.util
import itertools
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import certify, solve
from certpgo.errors import InputError, MissingDependency, NumericalError, SpecError
from certpgo.graph import Estimate, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods import _memory, _sdp
from certpgo.optimize.methods._relaxed import (
    ALONE,
    Scaled,
    leading_rows,
    made_feasible,
    null_space_rotations,
)
from certpgo.optimize.methods.fixed_point import FixedPoint
from certpgo.optimize.methods.sdp_dual import DualSDP
from certpgo.optimize.methods.sdp_primal import PrimalSDP
from certpgo.optimize.solution import Status
from certpgo.registry import build, parse_settings

BOTH = pytest.mark.parametrize("method", [DualSDP, PrimalSDP])
#: Complete graphs of random measurements whose relaxation is loose: d, n, seed.
LOOSE = [(2, 5, 46), (3, 6, 4)]


def dense_certificate(problem, multipliers):
    S = problem.matrix.toarray()
    d = problem.d
    for i, block in enumerate(multipliers):
        S[d * i : d * i + d, d * i : d * i + d] -= block
    return S


def gram(rows):
    """Y (dn, dn) from rows (n, r, d)."""
    X = np.swapaxes(rows, 1, 2).reshape(-1, rows.shape[1])
    return X @ X.T


def tight(seed, n, d):
    graph, _ = rotation_graph(np.random.default_rng(seed), n, d, noise=0.3)
    problem = Quadratic(graph)
    certified = solve(graph)
    assert certified.certificate.verdict.value == "CERTIFIED"
    return problem, certified


@BOTH
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("theta", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("n", [3, 4, 9])
def test_a_cycle_distributes_its_angle(method, n, theta, d):
    instance, _ = synthetic.winding_cycle(n, theta, 0, d)
    problem = Quadratic(instance.graph)
    solution = method().solve(problem)
    optimum = 8.0 * n * np.sin(theta / (2.0 * n)) ** 2
    assert solution.status is Status.CONVERGED
    assert solution.relaxation.value == pytest.approx(optimum, rel=1e-6, abs=1e-8)
    assert solution.relaxation.rank == d
    assert solution.lower_bound == pytest.approx(optimum, rel=1e-6, abs=1e-8)
    assert solution.lower_bound <= optimum * (1.0 + 1e-12)
    assert solution.cost == pytest.approx(optimum, rel=1e-6, abs=1e-12)


@BOTH
def test_no_winding_of_a_cycle_is_taken_for_the_optimum(method):
    instance, wound = synthetic.winding_cycle(12, 0.4, 1)
    problem = Quadratic(instance.graph)
    solution = method().solve(problem, initial=wound)
    assert problem.cost(wound) == pytest.approx(96.0 * np.sin((0.4 + 2.0 * np.pi) / 24.0) ** 2)
    assert solution.cost == pytest.approx(96.0 * np.sin(0.4 / 24.0) ** 2, rel=1e-6)
    np.testing.assert_allclose(problem.residual_angles(solution.estimate), 0.4 / 12, rtol=1e-3)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_where_it_is_tight_both_are_the_certified_optimum(seed, d):
    problem, certified = tight(seed, 7, d)
    for method in (DualSDP, PrimalSDP):
        solution = method().solve(problem)
        relaxation = solution.relaxation
        assert relaxation.value == pytest.approx(certified.cost, rel=1e-6)
        assert solution.lower_bound == pytest.approx(certified.cost, rel=1e-6)
        assert solution.lower_bound <= certified.cost * (1.0 + 1e-12)
        assert solution.cost == pytest.approx(certified.cost, rel=1e-6)
        assert relaxation.rank == d
        assert relaxation.status == "optimal"
        assert certify(problem, solution.estimate).verdict.value == "CERTIFIED"


@BOTH
@pytest.mark.parametrize("d", [2, 3])
def test_lambda_and_y_satisfy_the_optimality_conditions(method, d):
    problem, _ = tight(11, 8, d)
    found = method().solve(problem).relaxation
    S, Y = dense_certificate(problem, found.multipliers), gram(found.rows)
    weight = problem.node_weights.max()
    assert np.linalg.eigvalsh(S)[0] >= -1e-7 * weight
    assert np.trace(found.multipliers, axis1=1, axis2=2).sum() == pytest.approx(
        found.value, rel=1e-6
    )
    assert np.vdot(problem.matrix.toarray(), Y) == pytest.approx(found.value, rel=1e-4)
    assert found.rows.shape == (8, found.rank, d)
    np.testing.assert_allclose(
        np.swapaxes(found.rows, 1, 2) @ found.rows, np.tile(np.eye(d), (8, 1, 1)), atol=1e-5
    )
    assert np.abs(S @ Y).max() <= 1e-4 * weight
    stationary = problem.multipliers(FixedPoint(tolerance=1e-12).solve(problem).estimate)
    np.testing.assert_allclose(found.multipliers, stationary, atol=1e-4 * weight)


@pytest.mark.parametrize(("d", "n", "seed"), LOOSE)
def test_where_it_is_loose_they_agree_with_each_other_below_the_optimum(d, n, seed):
    graph = synthetic.complete(n, 3.0, np.random.default_rng(seed), d).graph
    problem = Quadratic(graph)
    dual, primal = DualSDP().solve(problem), PrimalSDP().solve(problem)
    assert dual.relaxation.value == pytest.approx(primal.relaxation.value, rel=1e-6)
    assert dual.lower_bound == pytest.approx(dual.relaxation.value, rel=1e-5)
    assert dual.relaxation.rank == primal.relaxation.rank > d
    for solution in (dual, primal):
        assert solution.relaxation.value < 0.98 * solution.cost
        assert certify(problem, solution.estimate).verdict.value == "BOUNDED"


def test_the_loose_planar_value_is_below_every_estimate():
    d, n, seed = LOOSE[0]
    graph = synthetic.complete(n, 3.0, np.random.default_rng(seed), d).graph
    problem = Quadratic(graph)
    i, j = graph.edges.T
    grid = np.array(list(itertools.product(np.linspace(0.0, 2.0 * np.pi, 20, False), repeat=n - 1)))
    angles = np.c_[np.zeros(len(grid)), grid]
    measured = so.log(graph.rotations)[:, 0]
    costs = (4.0 * (1.0 - np.cos(angles[:, j] - angles[:, i] - measured))).sum(axis=1)
    best = Estimate(so.exp(angles[costs.argmin()][:, None]))
    assert problem.cost(best) == pytest.approx(costs.min())
    optimum = FixedPoint().solve(problem, initial=best).cost
    value = DualSDP().solve(problem).relaxation.value
    assert value < 0.98 * optimum


@BOTH
def test_weights_times_a_power_of_two_change_no_digit(method):
    problem, _ = tight(3, 6, 3)
    solution = method().solve(problem)
    scaled = method().solve(problem.scaled(2.0**40))
    np.testing.assert_array_equal(scaled.estimate.rotations, solution.estimate.rotations)
    assert scaled.relaxation.value == 2.0**40 * solution.relaxation.value
    assert scaled.lower_bound == 2.0**40 * solution.lower_bound
    assert scaled.iterations == solution.iterations
    other = method().solve(problem.scaled(1e-9))
    assert other.relaxation.value == pytest.approx(1e-9 * solution.relaxation.value, rel=1e-8)


@BOTH
@pytest.mark.parametrize("d", [2, 3])
def test_names_frames_and_directions_change_nothing(method, d):
    rng = np.random.default_rng(5)
    graph, _ = rotation_graph(rng, 7, d)
    gauge, name = so.random(rng, 7, d), rng.permutation(7)
    i, j = graph.edges.T
    measured = np.swapaxes(gauge[i], 1, 2) @ graph.rotations @ gauge[j]
    turned = np.arange(len(i)) % 2 == 0
    edges = name[np.where(turned[:, None], graph.edges[:, ::-1], graph.edges)]
    measured[turned] = np.swapaxes(measured[turned], 1, 2)
    other = RotationGraph(7, edges, measured, graph.kappa)
    one, two = (method().solve(Quadratic(g)) for g in (graph, other))
    assert two.relaxation.value == pytest.approx(one.relaxation.value, rel=1e-7)
    assert two.cost == pytest.approx(one.cost, rel=1e-7)
    assert two.relaxation.rank == one.relaxation.rank


@BOTH
def test_parallel_edges_add(method):
    graph, _ = rotation_graph(np.random.default_rng(8), 6, 3, extra=8)
    twice = RotationGraph(
        6,
        np.concatenate([graph.edges, graph.edges[:, ::-1]]),
        np.concatenate([graph.rotations, np.swapaxes(graph.rotations, 1, 2)]),
        np.concatenate([0.25 * graph.kappa, 0.75 * graph.kappa]),
    )
    one, two = (method().solve(Quadratic(g)) for g in (graph, twice))
    assert two.relaxation.value == pytest.approx(one.relaxation.value, rel=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_weights_of_many_sizes_are_no_obstacle(d):
    rng = np.random.default_rng(d)
    graph, _ = rotation_graph(rng, 9, d, noise=0.5)
    graph = graph.with_weights(10.0 ** rng.uniform(-4.0, 4.0, graph.num_edges))
    best = solve(graph)
    for method in (DualSDP, PrimalSDP):
        solution = method().solve(Quadratic(graph))
        assert solution.relaxation.value == pytest.approx(best.cost, rel=1e-5)
        assert solution.lower_bound == pytest.approx(best.cost, rel=1e-5)
        assert solution.cost == pytest.approx(best.cost, rel=1e-5)


@pytest.mark.parametrize("kind", ["cycle", "random"])
def test_chordal_decomposition_changes_the_work_alone(kind):
    rng = np.random.default_rng(2)
    cycle, random = synthetic.cycle(10, 0.3, rng), synthetic.random_graph(10, 4.0, 0.3, rng)
    problem = Quadratic((cycle if kind == "cycle" else random).graph)
    on, off = DualSDP(chordal=True).solve(problem), DualSDP(chordal=False).solve(problem)
    assert on.relaxation.value == pytest.approx(off.relaxation.value, rel=1e-7)
    assert on.cost == pytest.approx(off.cost, rel=1e-7)
    assert on.relaxation.rank == off.relaxation.rank == 3
    # Y is completed where the decomposition left it open.
    Y = gram(on.relaxation.rows)
    np.testing.assert_allclose(Y, gram(off.relaxation.rows), atol=1e-3)
    assert DualSDP(chordal=True).options() != DualSDP(chordal=False).options()


@hypothesis_settings(max_examples=15)
@given(seeds, dimensions)
def test_the_lower_bound_is_one(seed, d):
    rng = rng_of(seed)
    noise = rng.choice([0.0, 0.1, 2.0])
    graph, truth = rotation_graph(rng, int(rng.integers(2, 7)), d, noise=noise)
    problem, best = Quadratic(graph), solve(graph)
    for method in (DualSDP, PrimalSDP):
        solution = method(max_iterations=int(rng.integers(2, 50))).solve(problem)
        assert 0.0 <= solution.lower_bound <= best.cost * (1.0 + 1e-12)
        assert solution.cost >= best.certificate.lower_bound
    data = Scaled(problem)
    for wrong in (problem.multipliers(Estimate(truth)), rng.standard_normal((problem.n, d, d))):
        found = made_feasible(data, wrong + np.swapaxes(wrong, 1, 2))
        assert 0.0 <= found.value <= best.cost * (1.0 + 1e-12)
        assert np.linalg.eigvalsh(found.matrix.toarray())[0] >= -1e-12 * problem.scale


def test_the_shift_is_hardly_larger_than_the_eigenvalue_asks():
    problem, certified = tight(4, 7, 3)
    data = Scaled(problem)
    s = data.weights
    wrong = problem.multipliers(certified.estimate) + 1e-3 * s[:, None, None] * np.eye(3)
    found = made_feasible(data, wrong)
    assert 1e-3 <= found.shift <= 1.08e-3
    assert found.value == pytest.approx(certified.cost, abs=0.1e-3 * 3 * s.sum())


@pytest.mark.parametrize("d", [2, 3])
def test_without_y_the_null_space_is_rounded(d, monkeypatch):
    problem, certified = tight(6, 7, d)
    pose = DualSDP.pose

    def without_y(*args):
        posed = pose(*args)
        return _sdp.Posed(posed.problem, lambda: _sdp.ConicSolution(posed.read().multipliers, None))

    monkeypatch.setattr(DualSDP, "pose", without_y)
    solution = DualSDP().solve(problem)
    assert (solution.relaxation.rows, solution.relaxation.rank) == (None, None)
    assert solution.cost == pytest.approx(certified.cost, rel=1e-6)
    feasible = made_feasible(Scaled(problem), solution.relaxation.multipliers)
    R = null_space_rotations(problem, feasible)
    np.testing.assert_array_equal(R, solution.estimate.rotations)
    nothing = _sdp.ConicSolution(None, None)
    monkeypatch.setattr(
        DualSDP, "pose", lambda *args: _sdp.Posed(pose(*args).problem, lambda: nothing)
    )
    with pytest.raises(NumericalError, match="neither Lambda nor Y"):
        DualSDP().solve(problem)


@pytest.mark.parametrize("rank", [3, 5, 20])
def test_rows_are_what_counts_of_y(rank):
    rng = np.random.default_rng(rank)
    X = rng.standard_normal((30, rank))
    Y = X @ X.T + 1e-8 * np.eye(30)
    rows = leading_rows(Y, 3)
    assert rows.shape == (10, rank, 3)
    np.testing.assert_allclose(gram(rows), Y, atol=1e-6)
    assert leading_rows(np.ones((6, 6)), 3).shape == (2, 3, 3)  # never fewer than d


@pytest.mark.parametrize("program", ["SCS", "CVXOPT"])
@BOTH
def test_other_programs_solve_it(method, program):
    if importlib.util.find_spec(_sdp.PROGRAMS[program].module) is None:
        pytest.skip(f"{program} is not installed")
    problem, certified = tight(7, 6, 3)
    solution = method(program=program, tolerance=1e-7, max_iterations=10_000).solve(problem)
    assert solution.status is Status.CONVERGED
    assert solution.relaxation.value == pytest.approx(certified.cost, rel=1e-5)
    assert solution.cost == pytest.approx(certified.cost, rel=1e-6)
    assert certified.cost * (1.0 - 1e-4) <= solution.lower_bound <= certified.cost
    assert solution.note.startswith(f"{program}: optimal")


@BOTH
def test_poses_get_the_translations_that_suit_the_rotations(method):
    graph, _, _ = pose_graph(np.random.default_rng(9), 6, 3)
    problem = Quadratic(graph)
    solution = method().solve(problem)
    alone = method().solve(problem.rotation)
    np.testing.assert_allclose(
        solution.estimate.rotations, alone.estimate.rotations, rtol=0, atol=1e-12
    )
    assert problem.with_optimal_translations(solution.estimate).translations == pytest.approx(
        solution.estimate.translations, abs=1e-9
    )
    assert solution.relaxation.value == pytest.approx(alone.cost, rel=1e-6)
    assert solution.lower_bound <= solve(graph).cost <= solution.cost
    assert solution.note.endswith(ALONE)
    assert "alone" not in alone.note
    assert len(repr(solution.relaxation)) < 200
    with pytest.raises(InputError, match="the estimate has 5 nodes"):
        method().solve(problem, initial=solution.estimate.subset(np.arange(5)))


@pytest.mark.parametrize(
    ("settings", "status", "said"),
    [
        ({"max_iterations": 2}, Status.ITERATION_LIMIT, "user_limit"),
        ({"max_iterations": 5}, Status.STALLED, "optimal_inaccurate"),
        ({"program": "SCS", "max_iterations": 8}, Status.STALLED, "optimal_inaccurate"),
        ({"program": "SCS"}, Status.CONVERGED, "optimal"),
        ({}, Status.CONVERGED, "optimal"),
    ],
)
def test_however_it_ends_nothing_is_printed(settings, status, said, capfd):
    problem, _ = tight(0, 7, 3)
    solution = DualSDP(**settings).solve(problem)
    assert (solution.status, solution.relaxation.status) == (status, said)
    assert said in solution.note
    assert capfd.readouterr() == ("", "")


def test_no_answer_is_one_line(monkeypatch):
    import cvxpy

    problem, _ = tight(0, 5, 2)

    def failing(*args, **kwargs):
        raise cvxpy.SolverError("Solver 'CLARABEL' failed. Try another.\nMore lines.")

    monkeypatch.setattr(cvxpy.Problem, "solve", failing)
    with pytest.raises(NumericalError) as caught:
        DualSDP().solve(problem)
    assert str(caught.value) == "CLARABEL gave up: Solver 'CLARABEL' failed"
    monkeypatch.setattr(cvxpy.Problem, "solve", lambda *args, **kwargs: None)
    monkeypatch.setattr(cvxpy.Problem, "status", "infeasible")
    with pytest.raises(NumericalError, match=r"^CLARABEL found no solution: infeasible$"):
        PrimalSDP().solve(problem)


@BOTH
def test_settings_are_checked_at_construction(method):
    for settings, message in (
        ({"program": "CLARABELL"}, "unknown program 'CLARABELL'; did you mean CLARABEL"),
        ({"program": "GLPK"}, "unknown program 'GLPK'; known: CLARABEL, COPT, CVXOPT"),
        ({"program": "NOPE"}, r"'NOPE'; known: CLARABEL, COPT, CVXOPT"),
        ({"tolerance": 0.0}, "tolerance must lie"),
        ({"max_iterations": 0}, "at least 1"),
        ({"program": "COPT", "tolerance": 1e-6}, "tolerance cannot be set for COPT"),
        ({"program": "COPT", "max_iterations": 5}, "max_iterations cannot be set for COPT"),
    ):
        with pytest.raises(SpecError, match=message):
            method(**settings)
    given = parse_settings("sdp_dual", ["chordal=false", "force=true", "tolerance=1e-6"])
    assert build("sdp_dual", given) == DualSDP(chordal=False, force=True, tolerance=1e-6)
    assert DualSDP(program="MOSEK", max_iterations=9).options() == {
        "mosek_params": {"MSK_IPAR_INTPNT_MAX_ITERATIONS": 9}
    }


@pytest.mark.parametrize("program", _sdp.PROGRAMS)
def test_a_program_that_is_not_installed_is_said(program, monkeypatch):
    problem, _ = tight(0, 5, 2)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    package = _sdp.PROGRAMS[program].package
    with pytest.raises(
        MissingDependency, match=f"^{program} is not installed: pip install {package}$"
    ):
        DualSDP(program=program).solve(problem)


@BOTH
def test_what_does_not_fit_is_refused_unless_forced(method, monkeypatch):
    problem, _ = tight(0, 7, 3)
    needed = method().bytes_needed(problem)
    monkeypatch.setattr(_memory, "available_bytes", lambda: 1.01 * needed)
    method().solve(problem)
    for available in (0.99 * needed, 1000.0):
        monkeypatch.setattr(_memory, "available_bytes", lambda available=available: available)
        with pytest.raises(InputError) as caught:
            method().solve(problem)
        assert "GB" in str(caught.value)
        assert "force=True, solve --set force=true, bounds --force" in str(caught.value)
        assert "\n" not in str(caught.value)
        assert method(force=True).solve(problem).status is Status.CONVERGED
    monkeypatch.setattr(_memory, "available_bytes", lambda: None)
    method().solve(problem)


def test_a_refusal_names_a_program_that_would_fit(monkeypatch):
    problem = Quadratic(synthetic.complete(30, 0.1, np.random.default_rng(0)).graph)
    monkeypatch.setattr(_memory, "available_bytes", lambda: 1e8)
    with pytest.raises(InputError, match=r"free; program=SCS would take 0\.0 GB; to try anyway"):
        DualSDP().solve(problem)
    monkeypatch.setattr(_memory, "available_bytes", lambda: 1e3)
    with pytest.raises(InputError, match="free; to try anyway"):
        DualSDP().solve(problem)


def test_the_guard_knows_what_decides():
    rng = np.random.default_rng(0)

    def gigabytes(method, graph):
        return method.bytes_needed(Quadratic(graph)) / 1e9

    cycle = synthetic.cycle(1000, 0.1, rng).graph
    random = synthetic.random_graph(75, 8.0, 0.2, rng).graph
    # Measured: 1.6, 2.9 (both the dense cone of 40 nodes) and 4.4.
    assert 1.2 < gigabytes(DualSDP(), cycle) < 2.5
    forty = synthetic.cycle(40, 0.1, rng).graph
    assert 2.0 < gigabytes(PrimalSDP(), forty) < 4.5
    assert gigabytes(DualSDP(chordal=False), forty) == gigabytes(PrimalSDP(), forty)
    assert 3.0 < gigabytes(DualSDP(), random) < 9.0
    assert gigabytes(DualSDP(chordal=False), cycle) > 1000.0
    assert gigabytes(DualSDP(program="SCS"), random) < 0.1
    assert gigabytes(DualSDP(program="CVXOPT"), random) < 0.5
    large = synthetic.cycle(200_000, 0.1, rng).graph
    with pytest.raises(InputError, match="sdp_dual with CLARABEL would take about"):
        DualSDP().solve(Quadratic(large))
    assert _memory.available_bytes() > 1e6


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Writes the files by which Linux tells of memory."""
    monkeypatch.setattr(_memory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(_memory, "CGROUP", tmp_path / "cgroup")

    def write(**texts):
        for name, text in texts.items():
            path = tmp_path / name.replace("__", "/").replace("_dot_", ".")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    write(proc__meminfo="MemTotal: 9000 kB\nMemAvailable:  4000 kB\n")
    return write


def test_memory_is_the_machines_where_no_group_limits_it(machine):
    assert _memory.available_bytes() == 4000 * 1024
    machine(proc__self__cgroup="1:cpu:/\n0::/\n")
    assert _memory.available_bytes() == 4000 * 1024
    machine(cgroup__memory_dot_max="max\n", cgroup__memory_dot_current="5\n")
    assert _memory.available_bytes() == 4000 * 1024


def test_memory_is_what_the_control_group_leaves(machine):
    machine(
        proc__self__cgroup="0::/job/step\n",
        cgroup__job__memory_dot_max="1000000\n",
        cgroup__job__memory_dot_current="400000\n",
        cgroup__job__memory_dot_stat="anon 7\ninactive_file 50000\n",
    )
    assert _memory.available_bytes() == 650_000
    machine(
        cgroup__job__step__memory_dot_max="100000\n",
        cgroup__job__step__memory_dot_current="100001\n",
        cgroup__job__step__memory_dot_stat="",
    )
    assert _memory.available_bytes() == 0.0


def test_memory_is_what_a_group_of_version_1_leaves(machine):
    machine(
        proc__self__cgroup="4:cpuset,memory:/docker/abc\n",
        cgroup__memory__memory_dot_limit_in_bytes="1000000\n",
        cgroup__memory__memory_dot_usage_in_bytes="400000\n",
        cgroup__memory__memory_dot_stat="inactive_file 1\ntotal_inactive_file 50000\n",
    )
    assert _memory.available_bytes() == 650_000


def test_cliques_of_known_graphs():
    rng = np.random.default_rng(1)

    def sizes(graph):
        return sorted(_memory.clique_sizes(Quadratic(graph)))

    assert sizes(synthetic.cycle(9, 0.1, rng).graph) == [3] * 7
    assert sizes(synthetic.complete(6, 0.1, rng).graph) == [6]
    tree, _ = rotation_graph(rng, 8, 3, extra=0)
    assert sizes(tree) == [2] * 7
    doubled, _ = rotation_graph(rng, 2, 3, extra=3)
    assert sizes(doubled) == [2]


def test_cvxpy_is_loaded_by_solving_alone():
    code = (
        "import sys\n"
        "from certpgo import registry\n"
        "for name in ('sdp_dual', 'sdp_primal'): registry.get_solver(name)(program='SCS')\n"
        "print('cvxpy' in sys.modules, 'clarabel' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
