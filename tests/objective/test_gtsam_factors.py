"""Factor graphs of all kinds: their cost is GTSAM's, their optimum GTSAM's, and what is refused."""

import numpy as np
import pytest

import certpgo
from certpgo import InputError, Verdict
from certpgo.graph.kinds import Kind
from certpgo.io.gtsam_factors import KINDS

gtsam = pytest.importorskip("gtsam")
X = [gtsam.symbol("x", k) for k in range(6)]
L = [gtsam.symbol("l", k) for k in range(3)]
FAR = {2: np.array([4e5, 5e6]), 3: np.array([4e5, 5e6, 100.0])}


def noise(rng, p, sigma=0.05):
    B = np.linalg.qr(rng.standard_normal((p, p)))[0]
    return gtsam.noiseModel.Gaussian.Covariance((B * sigma**2 * rng.uniform(0.5, 2.0, p)) @ B.T)


def isotropic(p, sigma=0.05):
    return gtsam.noiseModel.Isotropic.Sigma(p, sigma)


def pose(d, R, t):
    turn = gtsam.Rot3(R) if d == 3 else gtsam.Rot2(np.arctan2(R[1, 0], R[0, 0]))
    return getattr(gtsam, f"Pose{d}")(turn, t)


def moved(rng, d, sigma=0.03):
    p = 3 * (d - 1)
    return getattr(gtsam, f"Pose{d}").Expmap(sigma * rng.standard_normal(p))


class World:
    """A ring of poses with chords, landmarks, and every kind of factor that is asked for."""

    def __init__(self, d, seed=0, shift=0.0):
        self.d, self.rng = d, np.random.default_rng(seed)
        turns = np.linspace(0.0, 2.0 * np.pi, len(X), endpoint=False)
        self.t = np.zeros((len(X), d))
        self.t[:, :2] = 3.0 * np.c_[np.cos(turns), np.sin(turns)]
        self.t[:, d - 1] += self.rng.standard_normal(len(X))
        self.t += shift
        c, s = np.cos(turns), np.sin(turns)
        R = np.tile(np.eye(d), (len(X), 1, 1))
        R[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
        self.poses = [pose(d, *both) for both in zip(R, self.t, strict=True)]
        self.points = self.rng.standard_normal((len(L), d)) + shift
        self.graph = gtsam.NonlinearFactorGraph()
        for k, step in ((k, step) for k in range(len(X)) for step in (1, 2)):
            i, j = k, (k + step) % len(X)
            between = self.poses[i].between(self.poses[j]).compose(moved(self.rng, d))
            self.add(f"BetweenFactorPose{d}", X[i], X[j], between, noise(self.rng, 3 * (d - 1)))

    def add(self, name, *args):
        self.graph.add(getattr(gtsam, name)(*args))

    def values(self, off=0.0):
        found = gtsam.Values()
        for key, one in zip(X, self.poses, strict=True):
            found.insert(key, one.compose(moved(self.rng, self.d, off)))
        if any(key in L for k in range(self.graph.size()) for key in self.graph.at(k).keys()):  # noqa: SIM118
            for key, one in zip(L, self.points, strict=True):
                found.insert(key, one + off * self.rng.standard_normal(self.d))
        return found

    def ranges(self):
        for k in range(3):
            apart = np.linalg.norm(self.t[k + 3] - self.t[k]) + 0.02
            self.add(f"RangeFactorPose{self.d}", X[k], X[k + 3], apart, isotropic(1))
        for k in range(len(X) * len(L)):
            i, j = k % len(X), k % len(L)
            apart = np.linalg.norm(self.points[j] - self.t[i]) + 0.01
            self.add(f"RangeFactor{self.d}D", X[i], L[j], apart, isotropic(1))
        for j in range(len(L)):
            where = self.points[j] + 0.02
            self.add(f"PriorFactorPoint{self.d}", L[j], where, noise(self.rng, self.d))

    def priors(self):
        for k in (0, 3):
            prior = self.poses[k].compose(moved(self.rng, self.d))
            self.add(f"PriorFactorPose{self.d}", X[k], prior, noise(self.rng, 3 * (self.d - 1)))

    def attitudes(self):
        for k in (1, 4):
            prior = self.poses[k].compose(moved(self.rng, self.d))
            q = 1 if self.d == 2 else 3
            self.add(f"PoseRotationPrior{self.d}D", X[k], prior, noise(self.rng, q))

    def positions(self):
        for k in (1, 2, 5):
            prior = self.poses[k].compose(moved(self.rng, self.d))
            self.add(f"PoseTranslationPrior{self.d}D", X[k], prior, noise(self.rng, self.d))
            if self.d == 3:
                self.add("GPSFactor", X[k], self.t[k] + 0.02, noise(self.rng, 3))


MIXTURES = {
    "relative poses": (),
    "priors": ("priors",),
    "attitudes": ("attitudes",),
    "positions": ("positions",),
    "all but distances": ("priors", "attitudes", "positions"),
}


def minimum(world, values):
    """Where GTSAM ends, and twice its error there."""
    graph = gtsam.NonlinearFactorGraph(world.graph)
    if all(len(graph.at(k).keys()) == 2 for k in range(graph.size())):
        hold = gtsam.noiseModel.Isotropic.Sigma(3 * (world.d - 1), 1e-4)
        graph.add(getattr(gtsam, f"PriorFactorPose{world.d}")(X[0], world.poses[0], hold))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-15)
    settings.setAbsoluteErrorTol(1e-15)
    settings.setMaxIterations(200)
    end = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    return end, 2.0 * graph.error(end)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("mixture", MIXTURES)
def test_the_optimum_is_gtsams_and_certified(d, mixture):
    world = World(d)
    for name in MIXTURES[mixture]:
        getattr(world, name)()
    values = world.values(0.1)
    problem, estimate = certpgo.from_gtsam(world.graph, values)
    assert problem.cost(estimate) == pytest.approx(2.0 * world.graph.error(values), rel=1e-9)
    end, least = minimum(world, values)
    answer = certpgo.solve(certpgo.from_gtsam(world.graph))
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.cost == pytest.approx(least, rel=1e-7)
    assert certpgo.certify_values(world.graph, end).verdict is Verdict.CERTIFIED
    robust = certpgo.solve_robustly(certpgo.from_gtsam(world.graph))
    assert robust.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("d", [2, 3])
def test_distances_and_points(d):
    world = World(d)
    world.ranges()
    values = world.values(0.05)
    problem, estimate = certpgo.from_gtsam(world.graph, values)
    assert problem.cost(estimate) == pytest.approx(2.0 * world.graph.error(values), rel=1e-9)
    instance = certpgo.from_gtsam(world.graph)
    assert instance.measurements.counts[Kind.RANGE] == 3 + len(X) * len(L)
    assert instance.graph.is_point.tolist() == [True] * 3 + [False] * 7
    end, least = minimum(world, values)
    answer = certpgo.solve(instance)
    assert answer.cost == pytest.approx(least, rel=1e-7)
    found = certpgo.certify_values(world.graph, end)
    assert found.verdict in (Verdict.CERTIFIED, Verdict.BOUNDED)
    assert 0.0 <= found.lower_bound <= least * (1.0 + 1e-9)


def test_every_type_that_is_known_is_one_of_gtsams():
    assert all(hasattr(gtsam, name) for name in KINDS)


@pytest.mark.parametrize("d", [2, 3])
def test_positions_far_from_the_origin_have_an_origin_of_their_own(d):
    world = World(d, shift=FAR[d])
    world.positions()
    world.priors()
    values = world.values(0.05)
    instance = certpgo.from_gtsam(world.graph)
    assert np.abs(instance.origin).max() > 1e5
    end, least = minimum(world, values)
    found = certpgo.certify_values(world.graph, end)
    assert (found.verdict, found.cost_upper) == (
        Verdict.CERTIFIED,
        pytest.approx(least, rel=1e-5),
    )


def test_nodes_have_the_names_of_symbols():
    world = World(3)
    world.priors()
    instance = certpgo.from_gtsam(world.graph)
    assert [instance.named(k) for k in (0, 5, 6)] == ["node x0", "node x5", "the world"]
    assert instance.known_numbers.tolist() == list(range(14))


@pytest.mark.parametrize("d", [2, 3])
def test_one_prior_chooses_the_frame(d):
    world = World(d)
    plain = certpgo.solve(certpgo.from_gtsam(world.graph)).cost
    world.add(f"PriorFactorPose{d}", X[2], world.poses[0], isotropic(3 * (d - 1)))
    instance = certpgo.from_gtsam(world.graph)
    assert (instance.world, instance.fixed) == (None, (2,))
    assert certpgo.solve(instance).cost == pytest.approx(plain, rel=1e-9)


def test_priors_with_constrained_noise_hold_poses():
    """The optimum among poses that are held: that of priors a million times as precise, nearly."""
    world = World(3)
    world.positions()
    world.add("PriorFactorPose3", X[0], world.poses[0], gtsam.noiseModel.Constrained.All(6))
    with pytest.raises(InputError, match="to hold x0 takes values of all nodes"):
        certpgo.from_gtsam(world.graph)
    _, least = minimum(world, world.values(0.02))
    problem, _ = certpgo.from_gtsam(world.graph, world.values(0.02))
    answer = certpgo.solve(problem)
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.cost == pytest.approx(least, rel=1e-6)


def test_what_has_no_term_is_named_with_its_count():
    world = World(2)
    for k in range(3):
        world.add("BearingFactor2D", X[k], L[0], gtsam.Rot2(0.3), isotropic(1))
    world.add("BetweenFactorPoint2", L[0], L[1], np.zeros(2), isotropic(2))
    said = r"4 factors of 16 without .*: 3 BearingFactor2D and 1 BetweenFactorPoint2"
    with pytest.raises(InputError, match=said):
        certpgo.from_gtsam(world.graph)


REFUSED = {
    "robust": r"1 factor with robust noise \(Huber\)",
    "constrained": "the BetweenFactorPose2 between x0 and x3 has Constrained noise",
    "held twice": "x0 held by several priors",
    "robust constraint": "the PriorFactorPose2 of x0 has Constrained noise in a robust one",
    "two dimensions": "a graph of BetweenFactorPose2 or of BetweenFactorPose3",
    "pose and point": "l0 is a pose and a point",
    "large key": "keys below 2",
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused(what):
    world = World(2)
    model = isotropic(3)
    if what == "robust":
        huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
        model = gtsam.noiseModel.Robust.Create(huber, model)
    if what == "constrained":
        model = gtsam.noiseModel.Constrained.All(3)
    if what == "held twice":
        for k in range(2):
            world.add("PriorFactorPose2", X[0], world.poses[k], gtsam.noiseModel.Constrained.All(3))
    if what == "robust constraint":
        huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
        hard = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Constrained.All(3))
        world.add("PriorFactorPose2", X[0], world.poses[0], hard)
    if what == "two dimensions":
        world.add("GPSFactor", X[0], np.zeros(3), isotropic(3))
    if what == "pose and point":
        world.add("PriorFactorPoint2", L[0], np.zeros(2), isotropic(2))
        world.add("BetweenFactorPose2", X[0], L[0], gtsam.Pose2(), model)
    last = 2**63 + 1 if what == "large key" else X[3]
    world.add("BetweenFactorPose2", X[0], last, gtsam.Pose2(), model)
    with pytest.raises(InputError, match=REFUSED[what]):
        certpgo.from_gtsam(world.graph)


def test_values_of_a_file_with_positions_have_no_key_for_the_world(tmp_path):
    """The world is ours: GTSAM's keys are those of poses and points."""
    world = World(3)
    world.positions()
    instance = certpgo.from_gtsam(world.graph)
    certpgo.write(tmp_path / "gps.g2o", instance)
    _, least = minimum(world, world.values(0.02))
    end, _ = minimum(world, world.values(0.02))
    with pytest.warns(certpgo.InputNotice, match="6 of them positions alone"):
        found = certpgo.certify_values(tmp_path / "gps.g2o", end, cost="gtsam")
    assert found.verdict is Verdict.CERTIFIED
    assert found.cost_upper == pytest.approx(least, rel=1e-6)
