"""Whether a measurement of huge weight makes verdicts empty, or bounds weaker.

    python -m reports.studies.stiff_edges --rows 300 --seed 0

Small graphs get one stiff measurement, of weight 1e6 to 1e30: a leaf, a bridge between two cycles,
a measurement of a cycle, one given twice, or the positions of two poses. They are judged under
every cost: the answer of a search, and an estimate that is far off, with and without descent. False
is

- CERTIFIED where the gap is more than a thousandth of the cost, unless every residual is rounding;
- a lower bound above a cost that SciPy's least squares, on formulas of its own, attains;
- under a leaf or a bridge up to 1e15, a weaker verdict or bound than without its weight.
"""

import itertools
import tempfile
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import certpgo
from certpgo import Certificate, Estimate, Instance, Verdict
from certpgo.linalg.arrays import FloatArray
from reports.studies._printing import options, print_table

KINDS = ("leaf", "bridge", "cycle", "twice", "positions")
WEIGHTS = (1e6, 1e9, 1e12, 1e15, 1e20, 1e30)
COSTS = ("chordal", "g2o", "gtsam")
#: Up to this weight a bridge must not be felt: beyond, rounding of its own residual costs.
UNFELT = 1e15
#: Residuals of an exact fit, relative to lengths of order one, at most.
ROUNDING = 1e-9
ORDER = ["UNDECIDED", "REFUTED", "BOUNDED", "CERTIFIED"]


@dataclass(frozen=True)
class Drawn:
    """A graph with a stiff measurement as g2o text, the same with a usual one, and what is far off.

    ``far`` are positions (n, d) and headings, (n,) or rotation vectors (n, 3), by node.
    """

    kind: str
    d: int
    weight: float
    text: str
    usual: str
    far: tuple[FloatArray, FloatArray]


def drawn(rng: np.random.Generator, kind: str, weight: float) -> Drawn:
    """A random graph with one stiff measurement of a kind."""
    d, n = int(rng.integers(2, 4)), int(rng.integers(5, 9))
    noise = float(rng.choice([0.01, 0.1, 1.0]))
    pairs = [(k, (k + 1) % n) for k in range(n)]
    pairs += [(int(a), int(b)) for a, b in rng.integers(0, n, (3, 2)) if a != b]
    if kind == "bridge":
        pairs += [(n + a, n + b) for a, b in pairs[:n]]
    size = 2 * n if kind == "bridge" else n
    t, turns = 3.0 * rng.standard_normal((size + 1, d)), _turns(rng, size + 1, d, 1.0)
    lines = []
    for i, j in pairs:
        step, turn = _between(t, turns, i, j, d)
        step = step + 0.3 * noise * rng.standard_normal(d)
        lines.append(_edge(i, j, step, _composed(turn, _turns(rng, 1, d, noise)[0], d), 1.0))
    stiff = {"leaf": (0, size), "bridge": (0, n), "cycle": pairs[0], "twice": pairs[0]}
    if kind == "positions":
        if d == 3:
            lines.insert(0, "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1")
        at = [_position(k, t[k] + noise * rng.standard_normal(d)) for k in (0, n // 2)]
        made = ["\n".join(of % ((w,) * d) for of in at) for w in (weight, 1.0)]
    else:
        i, j = stiff[kind]
        step, turn = _between(t, turns, i, j, d)
        made = [_edge(i, j, step, turn, w) for w in (weight, 1.0)]
        if kind == "cycle":
            lines = lines[1:]
    far = t + 3.0 * rng.standard_normal(t.shape), _turns(rng, size + 1, d, 2.0)
    texts = ["\n".join([*lines, of, ""]) for of in made]
    return Drawn(kind, d, weight, *texts, far)


def _turns(rng: np.random.Generator, n: int, d: int, size: float) -> FloatArray:
    return np.asarray(size * rng.standard_normal(n if d == 2 else (n, 3)))


def _matrix(turn: FloatArray, d: int) -> FloatArray:
    """Matrices (..., d, d) of headings (...) or rotation vectors (..., 3)."""
    if d == 3:
        return np.asarray(Rotation.from_rotvec(turn).as_matrix())
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def _between(
    t: FloatArray, turns: FloatArray, i: int, j: int, d: int
) -> tuple[FloatArray, FloatArray]:
    step = _matrix(turns[i], d).T @ (t[j] - t[i])
    if d == 2:
        return step, turns[j] - turns[i]
    a, b = (Rotation.from_rotvec(turns[k]) for k in (i, j))
    return step, np.asarray((a.inv() * b).as_rotvec())


def _composed(a: FloatArray, b: FloatArray, d: int) -> FloatArray:
    if d == 2:
        return np.asarray(a + b)
    return np.asarray((Rotation.from_rotvec(a) * Rotation.from_rotvec(b)).as_rotvec())


def _edge(i: int, j: int, step: FloatArray, turn: FloatArray, weight: float) -> str:
    d = len(step)
    turned = [float(turn)] if d == 2 else Rotation.from_rotvec(turn).as_quat().tolist()
    p = 3 if d == 2 else 6
    upper = [weight if a == b else 0 for a in range(p) for b in range(a, p)]
    tag = "EDGE_SE2" if d == 2 else "EDGE_SE3:QUAT"
    return " ".join([tag, str(i), str(j), *map(repr, [*step.tolist(), *turned, *upper])])


def _position(node: int, at: FloatArray) -> str:
    """A prior of a position, with places for its information's diagonal."""
    numbers = " ".join(map(repr, at.tolist()))
    if len(at) == 2:
        return f"EDGE_PRIOR_SE2_XY {node} {numbers} %r 0 %r"
    return f"EDGE_SE3_XYZPRIOR {node} 0 {numbers} %r 0 0 %r 0 %r"


def _read(text: str) -> Instance:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.g2o"
        path.write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", certpgo.InputNotice)
            return certpgo.read(path)


def _far_off(instance: Instance, made: Drawn) -> Estimate:
    """The estimate that is far off, for the instance's nodes; the world is at rest."""
    t, turns = made.far
    own = [min(int(k), len(t) - 1) for k in instance.ids]
    R, p = _matrix(turns[own], made.d), t[own].copy()
    if instance.world is not None:
        R[instance.world], p[instance.world] = np.eye(made.d), 0.0
    return Estimate(R, p)


def attained(instance: Instance, cost: str, start: Estimate) -> float:
    """The cost where SciPy's least squares ends, by formulas of this module; infinite for GTSAM."""
    graph, d = instance.graph, instance.graph.d
    if cost == "gtsam" or not isinstance(graph, certpgo.Graph) or start.translations is None:
        return np.inf
    i, j = graph.edges.T
    n, q = graph.num_nodes, 1 if d == 2 else 3
    weights = np.zeros((len(i), d + q))
    if graph.information is not None:  # all are diagonal here
        weights = np.sqrt(np.diagonal(graph.information.matrices, axis1=1, axis2=2))

    def residuals(x: FloatArray) -> FloatArray:
        moved, turned = x[: n * d].reshape(n, d), x[n * d :].reshape(n, q)
        turn = _matrix(turned[:, 0] if d == 2 else turned, d)
        R, t = start.rotations @ turn, start.translations + moved
        y = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) - graph.translations
        if cost == "chordal":
            E = R[j] - R[i] @ graph.rotations
            scaled = np.sqrt(graph.kappa)[:, None] * E.reshape(len(E), -1)
            return np.concatenate([scaled.ravel(), (np.sqrt(graph.tau)[:, None] * y).ravel()])
        M = graph.rotations
        E = np.swapaxes(R[i] @ M, 1, 2) @ R[j]
        has_turn = graph.kappa > 0.0
        if d == 2:
            e = np.arctan2(E[:, 1, 0], E[:, 0, 0])[:, None]
        else:
            quaternion = Rotation.from_matrix(E).as_quat()
            e = quaternion[:, :3] * np.where(quaternion[:, 3:] < 0.0, -1.0, 1.0)
        y = np.where(has_turn[:, None], np.einsum("mba,mb->ma", M, y), y)
        return np.asarray((weights * np.concatenate([y, e], axis=1)).ravel())

    found = least_squares(residuals, np.zeros(n * (d + q)), x_scale="jac", max_nfev=30)
    return float(2.0 * found.cost)


def is_empty(found: Certificate, instance: Instance, estimate: Estimate) -> bool:
    """Whether it is CERTIFIED though the gap is large, and residuals are more than rounding."""
    if found.verdict is not Verdict.CERTIFIED or found.gap <= 1.02e-3 * found.cost_upper:
        return False
    graph, (i, j) = instance.graph, instance.graph.edges.T
    turned = estimate.rotations[j] - estimate.rotations[i] @ graph.rotations
    off = np.abs(turned[graph.kappa > 0.0]).max(initial=0.0)
    if isinstance(graph, certpgo.Graph) and estimate.translations is not None:
        t = estimate.translations
        steps = np.einsum("mab,mb->ma", estimate.rotations[i], graph.translations)
        off = max(off, np.abs(t[j] - t[i] - steps).max())
    return bool(off > ROUNDING)


def judged(made: Drawn, cost: str) -> list[str]:
    """What is false about the verdicts of one graph under one cost, then the search's verdict."""
    instance, false = _read(made.text), []
    answer = certpgo.solve(instance, cost=cost)
    far, found = _far_off(instance, made), [answer.certificate]
    for refine in (True, False):
        found.append(certpgo.certify(instance, far, cost=cost, refine=refine))
        if is_empty(found[-1], instance, far):
            false.append(f"empty, far off, refine={refine}")
    if is_empty(answer.certificate, instance, answer.estimate):
        false.append("empty, of the search")
    least = min(attained(instance, cost, start) for start in (answer.estimate, far))
    if max(c.lower_bound for c in found) > least * (1.0 + 1e-9):
        false.append("bound above an attained cost")
    if made.kind in ("leaf", "bridge") and made.weight <= UNFELT:
        usual = certpgo.solve(_read(made.usual), cost=cost).certificate
        if ORDER.index(answer.verdict) < ORDER.index(usual.verdict):
            false.append(f"{usual.verdict} without the weight")
        elif answer.certificate.lower_bound < (1.0 - 1e-3) * usual.lower_bound - 1e-12:
            false.append(f"bound {usual.lower_bound:.6g} without the weight")
    return [*false, str(answer.verdict)]


def run(rows: int, seed: int) -> tuple[list[dict[str, object]], list[str]]:
    """Verdicts by kind and weight, and what is false."""
    rng, counts, false = np.random.default_rng(seed), Counter[tuple[str, float, str]](), []
    every = itertools.cycle(itertools.product(WEIGHTS, KINDS, COSTS))
    for number, (weight, kind, cost) in enumerate(itertools.islice(every, rows)):
        *wrong, verdict = judged(drawn(rng, kind, weight), cost)
        counts[kind, weight, verdict] += 1
        false += [f"{number}: {kind}, {weight:g}, {cost}: {what}" for what in wrong]
    table = [
        {"kind": kind, "weight": f"{weight:g}", **{v: counts[kind, weight, v] for v in ORDER}}
        for kind, weight in itertools.product(KINDS, WEIGHTS)
    ]
    return table, false


def main() -> None:
    """Print the table, and what is false."""
    asked = options(__doc__, rows=300, seed=0, out=None)
    table, false = run(asked.rows, asked.seed)
    print_table(table, asked.out)
    print("\n".join([*false, f"{asked.rows} rows, {len(false)} false"]))


if __name__ == "__main__":
    main()
