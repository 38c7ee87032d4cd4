"""Proofs may claim how far every optimum is: what checkers accept is true, and not too little."""

import math
import os
from dataclasses import replace
from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import definite, point_graph, pose_graph, rng_of, rotation_graph, seeds
from test_checker_map import map_text

import certpgo
from certpgo import InputError, NumericalError, checker, integer_checker
from certpgo.certify.dual import Attempts
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.solve.proving import write_proof

BOTH = (checker, integer_checker)
KINDS = ("rotations", "poses", "points", "world", "g2o", "truncated")
#: How many proofs are damaged; more on demand.
MUTATIONS = int(os.environ.get("CERTPGO_MUTATIONS", "200"))


def moved(rng, x, size):
    """The estimate with every pose moved by as much."""
    n, d, _ = x.rotations.shape
    R = x.rotations @ so.exp(size * rng.standard_normal((n, so.tangent_dim(d))))
    if x.translations is None:
        return Estimate(R)
    return Estimate(R, x.translations + size * rng.standard_normal((n, d)))


class Posed:
    """A file, the best answer for it, and an estimate that costs more."""

    def __init__(self, folder, kind, d, seed=0, size=0.02):
        rng, self.path, self.proof = rng_of(seed), folder / "graph.g2o", folder / "graph.cert"
        self.prices, self.kind, cost = None, kind, "g2o" if kind == "g2o" else "chordal"
        if kind == "world":
            self.path.write_text(map_text(seed, d, priors=4))
        elif kind == "points":
            certpgo.write(self.path, point_graph(rng, 5, 3, d, noise=0.05)[0])
        elif kind == "rotations":
            certpgo.write(self.path, rotation_graph(rng, 6, d, noise=0.1)[0])
        else:
            graph = pose_graph(rng, 6, d, noise=0.03)[0]
            if kind == "g2o":
                W = definite(rng, graph.num_edges, d + so.tangent_dim(d))
                graph = graph.with_information(W)
            certpgo.write(self.path, graph)
        self.instance = certpgo.read(self.path, quiet=True)
        if kind == "truncated":
            rejected = np.arange(self.instance.graph.num_edges) < 2
            self.problem = TruncatedCost(
                Quadratic(self.instance.graph), np.where(rejected, 1e-3, np.inf)
            )
            self.prices = self.problem.prices
            best = certpgo.solve(self.problem.kept).estimate
        else:
            self.problem = objective_of(self.instance, cost)
            best = certpgo.solve(self.instance, cost=cost).estimate
        self.certificate = certpgo.certify(self.problem, best)
        self.best = self.certificate.best
        self.worse = moved(rng, self.best, size)
        world = self.instance.world
        self.anchor = self.problem.chordal.anchor if world is None else world

    def write(self, within, estimate=None, reference=None):
        x = self.worse if estimate is None else estimate
        given = self.path, self.instance, x, self.certificate
        seen = self.anchor if reference is None else reference
        kind = {"prices": self.prices, "within": within, "reference": seen}
        return write_proof(self.proof, *given, **kind)

    def arrays(self, reference=None):
        """Those of a proof that claims what every proof may."""
        self.write((None, 180.0), reference=reference)
        return proofs.arrays_of(self.proof)

    def tried(self, of, arrays, *claims):
        """What is proven with such claims, each a node, metres and degrees."""
        if claims:
            given = [dict(zip(("node", "metres", "degrees"), one, strict=True)) for one in claims]
            arrays = proofs.with_claim(arrays, within=given)
        self.proof.write_bytes(proofs.repacked(arrays))
        return of.check(self.path, self.proof)

    def least(self, of, arrays, unit, node=None):
        """The least of metres (0) or degrees (1) that is proven, to 1e-4."""
        low, high = 1e-9, 1e3 if unit == 0 else 180.0
        while high > (1.0 + 1e-4) * low:
            middle = math.sqrt(low * high)
            try:
                self.tried(of, arrays, (node, *((middle, None) if unit == 0 else (None, middle))))
            except of.Refused:
                low = middle
            else:
                high = middle
        return high


@pytest.fixture(params=KINDS, scope="module")
def kind(request):
    return request.param


@pytest.fixture(params=[2, 3], scope="module")
def case(request, kind, tmp_path_factory):
    return Posed(tmp_path_factory.mktemp("claims"), kind, request.param)


# --- What is accepted


def test_both_prove_what_regions_know_and_one_percent_less_is_refused(case):
    arrays = case.arrays()
    for unit in (0, 1):
        if unit == 0 and case.kind == "rotations":
            continue
        found = [case.least(of, arrays, unit) for of in BOTH]
        assert found[-1] == pytest.approx(found[0], rel=3e-4)
        for of in BOTH:
            claim = [None, None, None]
            claim[1 + unit] = 0.99 * found[0]
            with pytest.raises(of.Refused, match="within"):
                case.tried(of, arrays, claim)
        regions = case.certificate.regions
        if regions is None or case.kind == "truncated":  # other multipliers
            continue
        said, v = case.tried(checker, arrays), regions.bound.value
        assert v > (1.0 - 1e-6) * regions.known, "not loose: one matrix"
        regions = replace(regions, best=regions.estimate)  # claims are by themselves
        region, most = regions.distance(case.anchor), np.full(regions.form.n, regions.known)
        rho = 2.0 * math.sqrt((said.upper - said.lower) / regions.unit)
        by = rho / regions.apart(regions.cost, most, v).max()
        if unit == 0:
            assert found[0] == pytest.approx(by * region.metres.max(), rel=2e-3)
        else:
            share = by * np.sin(np.radians(0.5 * region.degrees.max()))
            assert found[0] == pytest.approx(2.0 * np.degrees(np.arcsin(share)), rel=2e-3)


def test_named_nodes_are_no_further_than_all(case):
    arrays, unit = case.arrays(), int(case.kind == "rotations")
    ids = [int(k) for node, k in enumerate(case.instance.ids) if node != case.anchor]
    for of in BOTH[-1:]:
        each = [case.least(of, arrays, unit, k) for k in ids]
        assert max(each) == pytest.approx(case.least(of, arrays, unit), rel=3e-4)
        assert min(each) < 0.99 * max(each)


def apart(x, other, i):
    """(n,) metres and degrees between the poses of two estimates in the frame of node i."""
    V = x.rotations[i].T @ x.rotations - other.rotations[i].T @ other.rotations
    squares = np.minimum(np.einsum("nab,nab->n", V, V) / 8.0, 1.0)
    if x.translations is None:
        return np.zeros(len(V)), np.degrees(2.0 * np.arcsin(np.sqrt(squares)))
    u = (x.translations - x.translations[i]) @ x.rotations[i]
    u -= (other.translations - other.translations[i]) @ other.rotations[i]
    return np.linalg.norm(u, axis=1), np.degrees(2.0 * np.arcsin(np.sqrt(squares)))


def refuses_less(case, arrays, x, other, is_pose):
    """That no claim is accepted which another estimate of as little cost contradicts."""
    metres, degrees = apart(x, other, case.anchor)
    degrees[~is_pose] = 0.0
    for of in BOTH:
        for claim in ((None, metres.max(), None), (None, None, degrees.max())):
            if max(claim[1:], key=lambda y: y or 0.0) > 0.0:
                with pytest.raises(of.Refused, match="within"):
                    case.tried(of, arrays, tuple(y and 0.999 * float(y) for y in claim))
    return metres


def test_no_estimate_at_random_that_costs_as_little_is_outside(case):
    rng, nodes = rng_of(3), np.arange(len(case.best.rotations))
    is_pose = np.isin(nodes, case.problem.chordal.poses)
    for size in (0.003, 0.03, 0.3):
        x = moved(rng, case.best, size)
        case.write((None, 180.0), x)
        arrays = proofs.arrays_of(case.proof)
        upper = case.tried(checker, arrays).upper
        for _ in range(5):
            trials = (moved(rng, case.best, size * 0.8**k) for k in range(60))
            other = next(y for y in trials if case.problem.cost(y) < upper)
            refuses_less(case, arrays, x, other, is_pose)


def test_no_estimate_that_costs_as_little_is_outside(case):
    """Two estimates on either side of the optimum, in the worst direction of each node."""
    if case.kind in ("rotations", "truncated"):
        pytest.skip("without positions, or with other multipliers than the certificate's")
    regions, best, anchor = case.certificate.regions, case.best, case.anchor
    attempts = Attempts(regions.form, regions.point, True, -np.inf, False)
    A = attempts.matrix(regions.bound.multipliers, np.zeros(0), attempts.rows_of(anchor))
    inverse, layout = np.linalg.inv(A.toarray()), regions.form.pattern.layout_of(A)
    v, sharp = rng_of(1).standard_normal(best.d), 0
    nodes = np.arange(len(best.rotations))
    is_pose = np.isin(nodes, case.problem.chordal.poses)
    for node in nodes[nodes != anchor]:
        row = layout.first_row(node)
        step = 0.02 * layout.unpack(inverse[:, row] / np.sqrt(inverse[row, row]))

        def at(by, step=step):
            R = so.project(best.rotations + by * v[:, None] * step[:, None, -best.d :])
            t = best.translations + by * step[:, :1] * v
            t[anchor], R[anchor] = best.translations[anchor], best.rotations[anchor]
            return Estimate(R, t)

        case.write((None, 180.0), at(1.0))
        arrays = proofs.arrays_of(case.proof)
        upper = case.tried(checker, arrays).upper
        other = next(x for by in np.arange(-1.2, 0, 0.01) if case.problem.cost(x := at(by)) < upper)
        metres = refuses_less(case, arrays, at(1.0), other, is_pose)
        name = case.instance.ids[node]
        try:
            # Rotations turn back to be such, and minorants are some way below other costs.
            known = metres[node] / (0.3 if case.kind in ("g2o", "world") else 0.65)
            case.tried(checker, arrays, (int(name), known, None))
            sharp += 1
        except checker.Refused:
            pass
    assert sharp > 0


def test_seen_from_another_pose_it_is_another_distance(tmp_path):
    case = Posed(tmp_path, "poses", 3)
    other = (case.anchor + 1) % 6
    found = [case.least(checker, case.arrays(seen), 0) for seen in (case.anchor, other)]
    assert abs(found[0] / found[1] - 1.0) > 0.01
    case.write((1e3, None), reference=other)
    for of in BOTH:
        [said] = of.check(case.path, case.proof).within
        assert (said.reference, said.node, float(said.metres)) == (other, None, 1e3)
        assert str(said) == f"within 1000.0 m of every optimum: every node, seen from node {other}"


def test_absolute_positions_are_seen_from_the_world(tmp_path):
    case = Posed(tmp_path, "world", 2)
    case.write((7.5, 90.0))
    line = "within 7.5 m and 90.0 degrees of every optimum: every node, seen from the world"
    for of in BOTH:
        assert [str(one) for one in of.check(case.path, case.proof).within] == [line]


# --- Closed forms


def of_text(folder, text, t, q, kind="poses"):
    """A case of a file whose measurements agree, and of an estimate that does not."""
    path, proof = folder / "graph.g2o", folder / "graph.cert"
    path.write_text(text)
    instance = certpgo.read(path, quiet=True)
    case = Posed.__new__(Posed)
    case.path, case.proof, case.instance, case.kind = path, proof, instance, kind
    case.problem, case.prices = objective_of(instance, "chordal"), None
    best, case.anchor = certpgo.solve(instance, cost="chordal").estimate, None
    case.certificate, case.best = certpgo.certify(case.problem, best), best
    R = best.rotations.copy()
    R[-1] = R[-1] @ so.exp(np.atleast_2d(q))[0]
    T = None if best.translations is None else best.translations.copy()
    if T is not None:
        T[-1] += t
    case.worse = Estimate(R, T)
    return case


@pytest.mark.parametrize("of", BOTH)
@pytest.mark.parametrize("d", [2, 3])
def test_two_poses_by_hand(tmp_path, of, d):
    """tau = 4, kappa = 9, the estimate 0.1 m off: rho = 2 sqrt(4) 0.1, whatever x' is."""
    if d == 2:
        text, off = "EDGE_SE2 0 1 3 0 0.5 4 0 0 4 0 9\n", [0.1, 0.0]
    else:
        text = "EDGE_SE3:QUAT 0 1 3 0 0 0 0 0.6 0.8 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 18 0 0 18 0 18\n"
        off = [0.1, 0.0, 0.0]
    case = of_text(tmp_path, text, off, np.zeros(so.tangent_dim(d)))
    rho = 2.0 * math.sqrt(4.0) * 0.1
    turned = 2.0 * math.degrees(math.asin(math.sqrt(rho**2 / 9.0 / 8.0)))
    seen = {0: rho / 2.0, 1: rho * math.sqrt(1 / 4.0 + 3.0**2 / 9.0)}
    for reference, metres in seen.items():
        arrays = case.arrays(reference)
        assert case.least(of, arrays, 0) == pytest.approx(metres, rel=2e-4)
        assert case.least(of, arrays, 1) == pytest.approx(turned, rel=2e-4)


@pytest.mark.parametrize("of", BOTH)
def test_three_cameras_by_hand(tmp_path, of):
    """Equal weights on a triangle: between two of its nodes, two thirds of an edge's resistance."""
    edges = "\n".join(f"EDGE_SE3:QUAT {i} {j} 0 0 0 0 0 0 1" for i, j in ((0, 1), (1, 2), (2, 0)))
    case = of_text(tmp_path, edges, None, np.array([0.3, 0.0, 0.0]))
    square, G = 4.0 * 2.0 * 8.0 * math.sin(0.15) ** 2, 2.0 / 3.0
    turned = 2.0 * math.degrees(math.asin(math.sqrt(square * G / 8.0)))
    assert case.least(of, case.arrays(0), 1) == pytest.approx(turned, rel=2e-4)


# --- Blocks of inverses, and angles


def blocks_of(of, case, arrays):
    """The nodes' blocks of the inverse that a checker works with, in fractions; and rho^2."""
    kept, refuse = {}, of.refuse_farther

    def seen(graph, *given):
        if of is checker:
            pin, G, unit, square, _ = given
            blocks = {k: G[k] * unit for k in range(graph.n) if k != pin}
        else:
            _, G, square, _ = given
            blocks = {k: np.array(block, dtype=object) for k, block in G.items()}
        kept.update(blocks=blocks, square=Fraction(square), graph=graph)

    of.refuse_farther = seen
    try:
        case.tried(of, arrays)
    finally:
        of.refuse_farther = refuse
    return kept


def inverse_of(A):
    """In fractions."""
    n = len(A)
    rows = [[*row, *(Fraction(int(r == c)) for c in range(n))] for r, row in enumerate(A)]
    for k in range(n):
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for r in range(n):
            if r != k and rows[r][k]:
                rows[r] = [a - rows[r][k] * b for a, b in zip(rows[r], rows[k], strict=True)]
    return [row[n:] for row in rows]


@given(seeds, st.booleans(), st.booleans())
@settings(max_examples=8, deadline=None)
def test_blocks_are_above_those_in_fractions(tmp_path_factory, seed, spatial, poses):
    kind = "poses" if poses else "rotations"
    case = Posed(tmp_path_factory.mktemp("blocks"), kind, 3 if spatial else 2, seed)
    arrays = case.arrays()
    read = checker.read_graph(case.path.read_bytes(), proofs.claim_of(arrays), None)
    given = read, proofs.measured_by(case.path), arrays["multipliers"], poses
    exact = inverse_of(proofs.exact_matrix(*given, without=case.anchor))
    b, others = read.t.shape[1] + poses, [k for k in range(read.n) if k != case.anchor]
    for of in BOTH:
        blocks, square = (blocks_of(of, case, arrays)[k] for k in ("blocks", "square"))
        said = of.check(case.path, case.proof)
        unit = 1 if of is checker else square / (4 * (said.upper - said.lower))
        for place, k in enumerate(others):
            rows = range(b * place, b * (place + 1))
            own = np.array([[exact[r][s] for s in rows] for r in rows], dtype=object)
            excess = blocks[k] * unit - own
            assert proofs.is_positive_semidefinite(excess.tolist())
            limit = 1e-8 * abs(own.astype(float)).max()
            assert abs(excess.astype(float)).max() <= limit


@given(seeds, st.sampled_from([2, 3]), st.floats(-4.0, 2.0))
def test_angles_are_those_of_two_eigenvalues(seed, d, decade):
    rng = rng_of(seed)
    B = rng.standard_normal((d, d))
    G = np.rint(2.0**30 * (B @ B.T + 0.1 * np.eye(d)))
    g = np.linalg.eigvalsh(G)
    square = 10.0**decade / 2.0**30
    share = square * g[-1] * g[-2] / (g[-1] + g[-2]) / 4.0
    whole = [[int(x) for x in row] for row in G]
    for more in (0.999, 1.001):
        degrees = more * 2.0 * math.degrees(math.asin(math.sqrt(min(share, 1.0))))
        if share < 0.999 and degrees <= 180.0:
            many = np.array([whole], dtype=object)
            assert checker.turns_less(many, Fraction(square), degrees)[0] == (more > 1.0)
            found = integer_checker.turns_less(whole, Fraction(square), Fraction(degrees))
            assert found == (more > 1.0)


def test_half_a_turn_is_never_claimed_of_what_may_turn_freely():
    for degrees in (1e-200, 1e-40, 90.0, 179.9):
        G, square = np.array([[[1, 0], [0, 1]]], dtype=object), Fraction(10**6)
        assert not checker.turns_less(G, square, degrees).any()
        assert not integer_checker.turns_less([[1, 0], [0, 1]], square, Fraction(degrees))


@pytest.mark.parametrize("of", BOTH)
def test_half_a_turn_is_always_true(tmp_path, of):
    case = Posed(tmp_path, "poses", 3, size=3.0)
    arrays = case.arrays()
    assert len(case.tried(of, arrays, (None, None, 180.0)).within) == 1
    with pytest.raises(of.Refused, match="within"):
        case.tried(of, arrays, (None, None, 179.9))


# --- Damaged proofs


def largest_of(case, arrays, upper, trace):
    """Metres and degrees of each node, computed in doubles from what a proof holds."""
    read = checker.read_graph(case.path.read_bytes(), proofs.claim_of(arrays), None)
    pin, d = proofs.claim_of(arrays)["pin"], read.t.shape[1]
    given = read, proofs.measured_by(case.path), arrays["multipliers"], True
    A = np.array(proofs.exact_matrix(*given, without=pin), dtype=float)
    G, square, b = np.linalg.inv(A), 4.0 * (upper - trace), d + 1
    far = {}
    for place, k in enumerate(k for k in range(read.n) if k != pin):
        own = G[b * place : b * (place + 1)][:, b * place : b * (place + 1)]
        g = np.linalg.eigvalsh(own[1:, 1:])
        share = square * g[-1] * g[-2] / (g[-1] + g[-2]) / 4.0
        turned = 2.0 * math.degrees(math.asin(math.sqrt(share))) if share < 1.0 else 180.0
        far[k] = math.sqrt(square * own[0, 0]), turned
    return far


def damage(rng, arrays, n):
    """The arrays with one thing changed: the claim, its header, or numbers."""
    arrays = {name: array.copy() for name, array in arrays.items()}
    claim = proofs.claim_of(arrays)
    what, [one] = rng.integers(8), claim["within"]
    if what == 0:
        one["metres"] *= float(np.exp(rng.normal()))
    elif what == 1:
        one["degrees"] = float(min(180.0, one["degrees"] * np.exp(rng.normal())))
    elif what == 2:
        one["node"] = int(rng.integers(-1, n + 1))
    elif what == 3:
        claim["pin"] = int(rng.integers(n))
    elif what == 4:
        arrays["order"] = arrays["order"][rng.permutation(n)]
        claim["pin"] = int(rng.choice([claim["pin"], arrays["order"][-1]]))
    elif what == 5:
        k = tuple(rng.integers(arrays["multipliers"].shape))
        arrays["multipliers"][k] += 10.0 ** rng.uniform(-12, 0) * rng.choice([-1.0, 1.0])
    elif what == 6:
        name = rng.choice(["translations", "rotations"])
        arrays[name][tuple(rng.integers(arrays[name].shape))] += 10.0 ** rng.uniform(-8, 0)
    else:
        arrays["delta"] *= np.float32(10.0 ** rng.uniform(-2, 4))
    return proofs.with_claim(arrays, **claim)


@pytest.mark.parametrize("d", [2, 3])
def test_damaged_proofs_are_refused_or_true(tmp_path, d):
    case, rng = Posed(tmp_path, "poses", d), rng_of(d)
    arrays = case.arrays()
    least = [case.least(checker, arrays, unit) for unit in (0, 1)]
    claim = {"node": None, "metres": 1.02 * least[0], "degrees": 1.02 * least[1]}
    arrays, accepted = proofs.with_claim(arrays, within=[claim]), 0
    diagonal = np.equal(*np.triu_indices(d))
    for _ in range(MUTATIONS // 2):
        damaged = damage(rng, arrays, 6)
        for of in BOTH:
            try:
                said = case.tried(of, damaged)
            except (of.Refused, of.Unreadable):
                continue
            accepted += 1
            trace = math.fsum(damaged["multipliers"][:, diagonal].ravel())
            far = largest_of(case, damaged, float(said.upper), trace)
            [one] = said.within
            for k, (metres, degrees) in far.items():
                if one.node in (None, k):
                    assert metres <= float(one.metres) * (1.0 + 1e-6)
                    assert degrees <= float(one.degrees) * (1.0 + 1e-6)
    assert MUTATIONS / 10 < accepted < MUTATIONS


@pytest.mark.parametrize("of", BOTH)
def test_claims_of_nothing_and_of_too_much_are_unreadable(tmp_path, of):
    case = Posed(tmp_path, "poses", 2)
    arrays = case.arrays()
    for claim in (
        (None, None, None),
        (None, 0.0, None),
        (None, -1.0, 2.0),
        (None, math.inf, None),
        (None, math.nan, None),
        (None, None, 180.5),
        (None, "1", None),
        (None, True, None),
        (0.5, 1.0, None),
        (True, 1.0, None),
    ):
        with pytest.raises(of.Unreadable):
            case.tried(of, arrays, claim)
    header = bytes(arrays["claim"]).decode().replace("180.0", "1e-5000")
    for text in (header, header.replace('"metres": null', '"metres": 1e-5000')):
        tiny = {**arrays, "claim": np.frombuffer(text.encode(), dtype=np.uint8)}
        with pytest.raises((of.Refused, of.Unreadable)):
            case.tried(of, tiny)
    more = {"node": None, "metres": 1e3, "degrees": None, "reference": 3}
    for wrong in ([more], [{**more, "other": 1}], None, 5, "all", more):
        with pytest.raises(of.Unreadable):
            case.tried(of, proofs.with_claim(arrays, within=wrong))
    with pytest.raises(of.Refused, match="no node 77"):
        case.tried(of, arrays, (77, 1e3, None))
    with pytest.raises(of.Unreadable):
        case.tried(of, proofs.with_claim(arrays, within=[{"node": None, "metres": 1.0}]))
    order = arrays["order"]
    other = {**arrays, "order": np.roll(order, 1)}
    with pytest.raises(of.Refused, match="the last of the order"):
        case.tried(of, other, (None, 1e3, None))
    case.tried(of, proofs.with_claim(other, within=[]))


@pytest.mark.parametrize("of", BOTH)
def test_rotations_have_no_metres(tmp_path, of):
    case = Posed(tmp_path, "rotations", 3)
    with pytest.raises(of.Unreadable, match="metres"):
        case.tried(of, case.arrays(), (None, 1.0, None))


@pytest.mark.parametrize("of", BOTH)
def test_nothing_is_claimed_of_similarities(tmp_path, of):
    path, proof = tmp_path / "scaled.g2o", tmp_path / "scaled.cert"
    edges = [(0, 1, 0.1), (1, 2, 0.1), (0, 2, 0.2)]
    path.write_text("".join(f"EDGE_SIM3:EXPMAP {i} {j} 0 0 {w} 1 0 0 {w}\n" for i, j, w in edges))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    given = proof, path, instance, answer.estimate, answer.certificate
    write_proof(*given)
    with pytest.raises(InputError, match="unknown scale"):
        write_proof(*given, within=(1.0, None))
    claim = [{"node": None, "metres": 1e3, "degrees": None}]
    arrays = proofs.with_claim(proofs.arrays_of(proof), within=claim)
    proof.write_bytes(proofs.repacked(arrays))
    with pytest.raises(of.Unreadable, match="similarities"):
        of.check(path, proof)


@pytest.mark.parametrize("of", BOTH)
def test_points_are_no_references(tmp_path, of):
    """Even where one is pinned and last: it has no frame."""
    case = Posed(tmp_path, "points", 2)
    arrays = case.arrays()
    [point, *_] = np.flatnonzero(case.instance.graph.is_point)
    order = arrays["order"]
    arrays["order"] = np.append(order[order != point], point).astype("<i4")
    with pytest.raises(of.Refused):
        case.tried(of, proofs.with_claim(arrays, pin=int(point)), (None, 1e3, None))


# --- Writing


def test_what_is_not_proven_is_said_with_what_is(tmp_path):
    case = Posed(tmp_path, "poses", 2)
    for within, unit in (((1e-9, None), "m"), ((None, 1e-9), "degrees")):
        with pytest.raises(
            NumericalError, match=rf"within \S+ {unit} of every optimum \(node"
        ) as no:
            case.write(within)
        assert not case.proof.exists()
        proven = float(str(no.value).split()[1])
        case.write((proven, None) if unit == "m" else (None, proven))
        case.proof.unlink()


def test_distances_that_cannot_be_claimed_are_refused(tmp_path):
    case = Posed(tmp_path, "poses", 2)
    for within in ((None, None), (0.0, None), (None, 181.0), (-1.0, None)):
        with pytest.raises(InputError):
            case.write(within)
    for reference in (-1, 6, 1.5):
        with pytest.raises(InputError):
            case.write((1.0, None), reference=reference)
    with pytest.raises(InputError, match="not metres"):
        Posed(tmp_path, "rotations", 2).write((1.0, None))


def test_a_proof_without_a_claim_is_the_same_as_ever(tmp_path):
    case = Posed(tmp_path, "poses", 2)
    case.write(None)
    assert "within" not in proofs.claim_of(proofs.arrays_of(case.proof))
    assert checker.check(case.path, case.proof).within == ()


def test_claims_are_printed_and_documented(tmp_path, capsys):
    case = Posed(tmp_path, "poses", 2)
    case.tried(checker, case.arrays(), (None, 1e3, None), (4, 1e2, 120.0))
    for of in BOTH:
        assert of.main([str(case.path), str(case.proof)]) == 0
        first, second = capsys.readouterr().out.splitlines()[2:]
        seen = f"seen from node {case.anchor}"
        assert first == f"within 1000.0 m of every optimum: every node, {seen}"
        assert second == f"within 100.0 m and 120.0 degrees of every optimum: node 4, {seen}"
