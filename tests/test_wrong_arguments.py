"""Plausible wrong arguments of every public function work, or are refused in one clear line."""

import inspect
import warnings
from pathlib import Path

import numpy as np
import pytest

import certpgo
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Instance
from certpgo.io.datasets.synthetic import helix
from certpgo.objective.choose_cost import costs_of, objective_of
from certpgo.solve.comparison import compare
from certpgo.solve.metrics import trajectory_errors
from certpgo.solve.settings import SolveSettings

NODES = 9


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Things that a user has at hand, by name."""
    folder = tmp_path_factory.mktemp("files")
    made = helix(3, np.random.default_rng(0))
    certpgo.write(folder / "g.g2o", made)
    certpgo.write(folder / "e.tum", made.truth)
    read, answer = certpgo.read(folder / "g.g2o"), certpgo.solve(made)
    R, t = answer.estimate.rotations, answer.estimate.translations
    return {
        "folder": folder,
        "graph": made.graph,
        "rotations alone": made.graph.rotations_alone,
        "instance": made,
        "read": read,
        "answer": answer,
        "solution": answer.solution,
        "estimate": answer.estimate,
        "of four nodes": Estimate(R[:4], t[:4]),
        "without translations": Estimate(R),
        "certificate": answer.certificate,
        "problem": certpgo.Quadratic(made.graph),
        "path": folder / "g.g2o",
        "path in words": str(folder / "g.g2o"),
        "estimate's path": str(folder / "e.tum"),
        "no such file": "nowhere.g2o",
        "a cost": "g2o",
        "a list of graphs": [made.graph, made.graph],
        "a pair": (made.graph, answer.estimate),
        "lists of numbers": R.tolist(),
        "an array": R,
        "a number": 2500,
        "a fraction": 0.5,
        "true": True,
        "nothing": None,
        "an empty list": [],
        "a dictionary": {"a": 1},
        "bytes": b"g2o",
    }


def calls(of):
    """Public functions with arguments that they take, by name."""
    graph, read, estimate, folder = of["graph"], of["read"], of["estimate"], of["folder"]
    rotation, proof = graph.rotations_alone, folder / "p.cert"
    certpgo.write_proof(proof, of["path"], read, estimate, of["certificate"])
    under = objective_of(read, "g2o")
    newton, problem = certpgo.get_solver("newton")(), of["problem"]
    marginals = certpgo.Marginals(of["problem"], estimate)
    answer = of["answer"]
    return {
        "CertifiedSolution.region": (lambda *a: answer.region(*a[:2], level=a[2]), 1, 0, 0.9),
        "CertifiedSolution.regions": (lambda *a: answer.regions(a[0], excess=a[1]), 0, 1.0),
        "Region.holds": (answer.region(1, 0).holds, estimate),
        "Estimate": (certpgo.Estimate, estimate.rotations, estimate.translations),
        "Estimate.anchored": (estimate.anchored, 1, estimate),
        "Estimate.moved": (estimate.moved, np.eye(3), np.zeros(3)),
        "Estimate.subset": (estimate.subset, [0, 1]),
        "Estimate.with_translations": (estimate.with_translations, estimate.translations),
        "Instance.with_edges": (of["instance"].with_edges, [0, 1]),
        "Instance": (certpgo.Instance, "name", graph, np.arange(NODES), estimate, estimate),
        "Marginals": (certpgo.Marginals, of["problem"], estimate, 0),
        "Marginals.joint": (marginals.joint, 0, 1),
        "PoseGraph": (certpgo.PoseGraph, rotation, graph.translations, graph.tau),
        "Graph": (
            certpgo.Graph,
            graph.nodes,
            graph.edges,
            graph.rotations,
            graph.kappa,
            graph.translations,
            graph.tau,
        ),
        "Graph.reweighted": (graph.reweighted, np.ones(graph.num_edges)),
        "Graph.subgraph": (graph.subgraph, [0, 1]),
        "Graph.with_edges": (graph.with_edges, [0, 1]),
        "Graph.with_weights": (graph.with_weights, 1.0, 2.0),
        "Quadratic.gradient": (problem.gradient, estimate),
        "Quadratic.residual_angles": (problem.residual_angles, estimate),
        "Quadratic": (certpgo.Quadratic, graph),
        "Quadratic.cost": (of["problem"].cost, estimate),
        "Ranges": (certpgo.Ranges, NODES, [[0, 1]], [1.0], [1.0]),
        "RobustSession": (certpgo.RobustSession, None),
        "RobustSession.add": (lambda *a: certpgo.RobustSession().add(*a), graph, range(NODES)),
        "RotationGraph": (
            certpgo.RotationGraph,
            NODES,
            rotation.edges,
            rotation.rotations,
            rotation.kappa,
        ),
        "Session": (certpgo.Session, None),
        "Session.remove": (lambda *a: certpgo.Session().remove(*a), [0]),
        "Session.add": (lambda *a: certpgo.Session().add(*a), graph, range(NODES)),
        "SimilarityGraph": (certpgo.SimilarityGraph, rotation, graph.translations, graph.tau),
        "certify": (certpgo.certify, graph, estimate),
        "certify_many": (lambda *a: list(certpgo.certify_many(*a)), [(graph, estimate)]),
        "certify_values": (certpgo.certify_values, graph, {}),
        "comparison.compare": (lambda *a: list(compare(*a)), graph, []),
        "metrics.trajectory_errors": (trajectory_errors, estimate, estimate),
        "choose_cost.costs_of": (costs_of, read),
        "choose_cost.objective_of": (objective_of, read, "g2o"),
        "check": (certpgo.check, of["path"], proof),
        "diagnose": (certpgo.diagnose, graph, estimate),
        "fit_logarithms": (certpgo.fit_logarithms, graph),
        "from_gtsam": (certpgo.from_gtsam, graph, estimate),
        "get_solver": (certpgo.get_solver, "newton"),
        "get_solver().solve": (newton.solve, of["problem"]),
        "merge": (certpgo.merge, [graph, graph], read, None),
        "plot.bounds": (lambda *a: certpgo.plot.bounds(*a), of["answer"], None),
        "plot.convergence": (lambda *a: certpgo.plot.convergence(*a), of["answer"]),
        "plot.residuals": (lambda *a: certpgo.plot.residuals(*a), of["answer"], None),
        "plot.spectrum": (lambda *a: certpgo.plot.spectrum(*a), of["answer"], None),
        "plot.trajectory": (lambda *a: certpgo.plot.trajectory(*a), of["answer"]),
        "prove_many": (lambda *a: list(certpgo.prove_many(*a)), {of["path"]: "p.cert"}),
        "read": (certpgo.read, of["path"]),
        "read_estimate": (certpgo.read_estimate, of["estimate's path"], None),
        "read_sequence": (certpgo.read_sequence, folder),
        "reconstruct": (certpgo.reconstruct, folder, None),
        "register": (certpgo.register, [of["path"], of["path"]], None),
        "reweigh": (certpgo.reweigh, graph),
        "show": (certpgo.show, of["answer"]),
        "solve": (certpgo.solve, graph, None),
        "solve_many": (lambda *a: list(certpgo.solve_many(*a)), [graph], None),
        "solve_robustly": (certpgo.solve_robustly, graph, None),
        "sparsify": (certpgo.sparsify, graph, 0, None),
        "suggest_loops": (certpgo.suggest_loops, graph, 1),
        "to_gtsam": (certpgo.to_gtsam, under, estimate),
        "with_directions": (
            lambda *a: certpgo.with_directions(*a, kappa=10.0),
            graph,
            [0],
            [[0.0, 0.0, 1.0]],
        ),
        "with_preintegrated": (
            lambda *a: certpgo.with_preintegrated(
                *a, np.eye(3)[None], *np.zeros((2, 1, 3)), kappa=1.0, weights=np.ones((1, 2))
            ),
            graph,
            [[0, 1]],
            [0.1],
        ),
        "with_priors": (
            lambda *a: certpgo.with_priors(*a, tau=1.0),
            graph,
            [0],
            None,
            [[0.0, 0.0, 0.0]],
        ),
        "write": (certpgo.write, folder / "out.g2o", graph),
        "write_proof": (
            certpgo.write_proof,
            folder / "q.cert",
            of["path"],
            read,
            estimate,
            of["certificate"],
        ),
    }


#: Which are no functions of a user's own arguments.
OTHERS = {"SolveSettings", "NewtonSettings", "Solution", "Status", "Tier", "Verdict", "Iteration"}
OTHERS |= {"Certificate", "CertifiedSolution", "Disagreement", "LogarithmFit", "Merged", "Monitor"}
OTHERS |= {
    "Diagnosis",
    "Finding",
    "Preintegrated",
    "ProvenDistance",
    "Region",
    "Reweighed",
    "Sparsified",
    "Standing",
    "SuggestedLoops",
    "Suspicion",
    "WORLD",
}
NAMES = sorted(
    name
    for name in certpgo.__all__
    if name not in OTHERS
    and not (
        inspect.isclass(getattr(certpgo, name))
        and issubclass(getattr(certpgo, name), Exception | Warning)
    )
)
METHODS = ["CertifiedSolution.region", "CertifiedSolution.regions", "Region.holds"]
METHODS += ["Marginals.joint", "RobustSession.add", "Session.add", "Session.remove"]
METHODS += [f"Estimate.{name}" for name in ("anchored", "moved", "subset", "with_translations")]
METHODS += [f"Graph.{name}" for name in ("reweighted", "subgraph", "with_edges", "with_weights")]
METHODS += [f"Quadratic.{name}" for name in ("cost", "gradient", "residual_angles")]
METHODS += ["Instance.with_edges", "get_solver().solve", "comparison.compare"]
METHODS += [f"choose_cost.{name}" for name in ("costs_of", "objective_of")]
METHODS += ["metrics.trajectory_errors"]
METHODS += [f"plot.{name}" for name in ("bounds", "convergence", "residuals", "spectrum")]


@pytest.mark.parametrize("name", [*NAMES, *METHODS])
def test_wrong_arguments_work_or_are_refused_in_a_line(name, given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mpl = pytest.importorskip("matplotlib") if name.startswith("plot") else None
    if mpl is not None:
        mpl.use("Agg")
    if "gtsam" in name:
        pytest.importorskip("gtsam")
    function, *right = calls(given)[name]
    for place in range(len(right)):
        for called, thing in given.items():
            if name.startswith("write") and place == 0 and isinstance(thing, str | Path):
                continue  # a path: it would be written
            arguments = [*right]
            arguments[place] = thing
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    function(*arguments)
                except Exception as error:  # each is named
                    clear = isinstance(error, CertPGOError) and "\n" not in str(error)
                    if not clear:
                        pytest.fail(f"{name}, argument {place} is {called}: {error!r}")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda of: certpgo.merge(of["graph"], of["graph"]), "merge takes a list of maps"),
        (
            lambda of: certpgo.merge([of["graph"]] * 2, of["graph"]),
            "an instance of the measurements between maps expected, not a Graph",
        ),
        (lambda of: certpgo.solve(of["graph"], "g2o"), "not 'g2o': a cost is given as cost=..."),
        (
            lambda of: certpgo.solve(of["graph"], of["estimate"]),
            "SolveSettings expected, not an Estimate",
        ),
        (
            lambda of: certpgo.write(of["answer"], "a.g2o"),
            r"write\(path, what\): a path expected, not a CertifiedSolution",
        ),
        (
            lambda of: certpgo.Instance("a", of["instance"], np.arange(NODES)),
            "the graph of an instance expected, not an Instance",
        ),
        (
            lambda of: certpgo.PoseGraph(of["graph"].rotations_alone, "abc", [1.0]),
            "an array of numbers expected, not a str",
        ),
        (
            lambda of: certpgo.Quadratic(of["graph"]).cost(of["of four nodes"]),
            "the estimate has 4 nodes in 3D, the graph 9 in 3D",
        ),
        (
            lambda of: certpgo.get_solver("newton")().solve(of["graph"]),
            r"a Quadratic\(graph\) expected, not a Graph",
        ),
        (
            lambda of: certpgo.certify_values(of["graph"], of["estimate"]),
            "GTSAM's Values expected, not an Estimate: certify takes estimates",
        ),
        (
            lambda of: certpgo.certify(of["graph"], of["estimate"], rtol="small"),
            "a number as tolerance expected, not a str",
        ),
        (
            lambda of: certpgo.solve(of["graph"], tier=["proof"]),
            "unknown tier",
        ),
        (
            lambda of: certpgo.solve_robustly(of["graph"], trusted=of["estimate"]),
            "trusted measurements are given by their indices",
        ),
        (
            lambda of: certpgo.solve_many("g.g2o"),
            "a list or another iterable expected, not a str",
        ),
        (lambda of: certpgo.check(1, of["path"]), "the path of a graph expected, not an int"),
        (lambda of: certpgo.register("a.ply"), "a list of scans"),
        (lambda of: certpgo.sparsify(None, 0.5), "takes a graph, an instance or a path, not None"),
        (lambda of: certpgo.Session("g2o"), "a cost is given as cost="),
    ],
)
def test_what_was_expected_is_said(call, said, given):
    with pytest.raises(CertPGOError, match=said):
        call(given)


def test_paths_stand_for_what_is_in_them(given):
    graph, path = given["read"], given["path"]
    kept = [certpgo.sparsify(one, 6).kept.tolist() for one in (graph, path)]
    assert kept[0] == kept[1]
    found = [certpgo.suggest_loops(one, 1).named.tolist() for one in (graph, str(path))]
    assert found[0] == found[1]
    read = certpgo.read(path)
    first, second = read.graph.subgraph([0, 1, 2, 3, 4]), read.graph.subgraph([5, 6, 7, 8])
    halves = [Instance("a", first, np.arange(5)), Instance("b", second, np.arange(5, 9))]
    joints = read.with_edges(np.flatnonzero((read.graph.edges < 5).sum(axis=1) == 1))
    folder = given["folder"]
    for name, one in (("a.g2o", halves[0]), ("b.g2o", halves[1]), ("j.g2o", joints)):
        certpgo.write(folder / name, one)
    merged = certpgo.merge([folder / "a.g2o", folder / "b.g2o"], folder / "j.g2o")
    again = certpgo.solve(path, SolveSettings())
    assert merged.answer.cost == pytest.approx(again.cost)
