"""Information matrices with rows and columns of zeros: directions that are not measured."""

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, InputError, io
from certpgo.graph.kinds import Kind
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import costs_of

FULL = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"
#: Of x, y and the heading; of a turn alone; of a step alone.
PLANE = "100 0 0 0 0 0 100 0 0 0 0 0 0 0 0 0 0 0 0 0 400"
TURN = "0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 400 0 0 400 0 400"
STEP = "100 0 0 0 0 0 100 0 0 0 0 50 0 0 0 0 0 0 0 0 0"
QUARTER = "0 0 0.7071067811865476 0.7071067811865476"


def edge(i, j, pose, information):
    return f"EDGE_SE3:QUAT {i} {j} {pose} {information}\n"


def read(file, *edges, **options):
    return io.read(file("".join(edge(*given) for given in edges)), quiet=True, **options)


def test_planar_robots_in_space(file):
    """g2o345: three steps of 1, 1 and 2.1 m leave 3 (100 / 30^2); z, roll and pitch are open."""
    steps = [(0, 1, f"1 0 0 {TO}", PLANE), (1, 2, f"1 0 0 {TO}", PLANE)]
    instance = read(file, *steps, (0, 2, f"2.1 0 0 {TO}", PLANE))
    assert instance.graph.kappa.tolist() == [200.0] * 3
    assert instance.graph.tau.tolist() == [100.0] * 3
    assert any("3 measurements with information on some axes" in s for s in instance.notices)
    answer = certpgo.solve(instance)
    assert answer.cost == pytest.approx(1 / 3, rel=1e-9)
    assert answer.certificate.objective.startswith("g2o")
    assert answer.certificate.lower_bound <= 1 / 3


TO = "0 0 0 1"
CHAIN = [(0, 1, f"1 0 0 {QUARTER}", FULL), (1, 2, f"1 0 0 {QUARTER}", FULL)]


def test_rotations_alone_are_certified(file):
    """The chain keeps its steps, and a turn of 180 + 6 degrees is shared by three."""
    half = np.radians(186.0) / 2
    turn = f"9 9 9 0 0 {float(np.sin(half))!r} {float(np.cos(half))!r}"
    instance = read(file, *CHAIN, (0, 2, turn, TURN))
    assert instance.graph.kinds.tolist() == [Kind.BETWEEN, Kind.BETWEEN, Kind.ROTATION]
    for cost, share in (("g2o", np.sin(np.radians(1.0)) ** 2), ("gtsam", np.radians(2.0) ** 2)):
        answer = certpgo.solve(instance, cost=cost)
        assert answer.verdict.value == "CERTIFIED", cost
        assert answer.cost == pytest.approx(3 * 400 * share, rel=1e-6)
    chordal = certpgo.solve(instance, cost="chordal")
    assert chordal.verdict.value == "CERTIFIED"
    # kappa |R - R'|_F^2 = 8 kappa sin^2(angle/2), three times; kappa = 200.
    assert chordal.cost == pytest.approx(3 * 1600 * np.sin(np.radians(1.0)) ** 2, rel=1e-6)


def test_steps_alone_are_weighed_in_the_measured_frame(file):
    """An edge of a quarter turn has its x across: what is off by 0.3 m there weighs 50."""
    step = "50 0 0 0 0 0 100 0 0 0 0 100 0 0 0 0 0 0 0 0 0"
    instance = read(file, *CHAIN, (0, 2, f"1 1 0 {QUARTER}", step), (0, 2, f"1 1.3 0 {TO}", STEP))
    assert instance.graph.kinds[2:].tolist() == [Kind.TRANSLATION] * 2
    first = instance.graph.information_matrices[2][:3, :3]
    np.testing.assert_allclose(first, np.diag([100.0, 50, 100]), atol=1e-12)
    answer = certpgo.solve(instance)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.certificate.objective.startswith("g2o")
    poses = answer.estimate
    turns = np.swapaxes(poses.rotations[[0, 1, 0]], 1, 2)
    t = poses.translations
    seen = (turns @ (t[[1, 2, 2]] - t[[0, 1, 0]])[:, :, None])[:, :, 0]
    relative = so.log(np.swapaxes(turns[:2], 1, 2).swapaxes(1, 2) @ poses.rotations[[1, 2]])[:, 2]
    half = np.sin((relative - np.pi / 2) / 2)
    chain = 100 * ((seen[:2] - [1, 0, 0]) ** 2).sum() + 400 * (half**2).sum()
    along = seen[2] - [[1, 1, 0], [1, 1.3, 0]]
    steps = (along**2 * [[100, 50, 100], [100, 100, 50]]).sum()
    assert answer.cost == pytest.approx(chain + steps, rel=1e-9)
    assert costs_of(instance) == ("g2o", "chordal", "gtsam")


def test_steps_alone_are_proven(file, tmp_path):
    instance = read(file, *CHAIN, (0, 2, f"1 1.3 0 {QUARTER}", STEP))
    answer = certpgo.solve(instance, cost="g2o", tier="proof")
    given = instance.source, instance, answer.estimate, answer.certificate
    said = certpgo.write_proof(tmp_path / "p.cert", *given)
    assert said.lower <= answer.cost * (1.0 + 1e-9) <= said.upper * (1.0 + 2e-9)


@pytest.mark.parametrize(
    ("chosen", "kappa", "tau"),
    [({"unit_weights": True}, 1.0, 1.0), ({"kappa": 5.0, "tau": 3.0}, 5.0, 3.0)],
)
def test_chosen_weights_are_of_what_is_measured(file, chosen, kappa, tau):
    """The lines that state one block alone have numbers in place of the other, which mean nothing.

    All steps and turns agree, so that the least cost is zero.
    """
    prior = f"EDGE_SE3_PRIOR 2 0 7 8 9 {TO} {TURN}\nEDGE_SE3_PRIOR 0 0 3 4 5 {TO} {FULL}\n"
    lines = [*CHAIN, (0, 2, "9 9 9 0 0 1 0", TURN), (0, 2, f"1 1 0 {TO}", STEP)]
    text = "".join(edge(*line) for line in lines) + prior.replace(TO, "0 0 1 0", 1)
    instance = io.read(file("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + text), quiet=True, **chosen)
    assert instance.graph.kappa.tolist() == [kappa, kappa, kappa, 0.0, kappa, kappa]
    assert instance.graph.tau.tolist() == [tau, tau, 0.0, tau, 0.0, tau]
    assert certpgo.solve(instance).cost == pytest.approx(0.0, abs=1e-18)


def test_chosen_weights_of_poses_leave_those_of_distances(file):
    """With weights 1 they are 1, too."""
    text = "VERTEX_SE2 0 A0 0 0 0\nVERTEX_SE2 0 A1 0 0 0\n"
    text += "EDGE_SE2 0 A0 A1 1 0 0 0.01 0 0 0.01 0 0.01\nEDGE_RANGE 0 A0 A1 1.1 0.25\n"
    for chosen, weight in (
        ({}, 4.0),
        ({"kappa": 2.0, "tau": 3.0}, 4.0),
        ({"unit_weights": True}, 1),
    ):
        instance = io.read(file(text, "ranges.pyfg"), quiet=True, **chosen)
        assert instance.graph.ranges.weights.tolist() == [weight]


@pytest.mark.parametrize("shift", [0.0, 100.0])
def test_attitudes_alone_do_not_place_an_estimate(file, shift):
    """Wherever the map is: 3 * 8 * 200 sin^2(half of 2 degrees)."""
    half = np.radians(6.0) / 2
    turn = f"0 0 {float(np.sin(half))!r} {float(np.cos(half))!r}"
    prior = f"EDGE_SE3_PRIOR {{}} 0 0 0 0 {{}} {TURN}\n".format
    text = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + edge(0, 1, f"1 0 0 {TO}", FULL)
    instance = io.read(file(text + prior(0, TO) + prior(1, turn)), quiet=True)
    first = np.radians(1.0)
    turned = [
        f"0 0 {float(np.sin(a / 2))!r} {float(np.cos(a / 2))!r}" for a in (2 * first, 4 * first)
    ]
    x, y = float(shift + np.cos(2 * first)), float(np.sin(2 * first))
    values = (
        f"VERTEX_SE3:QUAT 0 {shift} 0 0 {turned[0]}\nVERTEX_SE3:QUAT 1 {x!r} {y!r} 0 {turned[1]}\n"
    )
    estimate = io.read_estimate(file(values, "given.g2o"), instance)
    certificate = certpgo.certify(instance, estimate, cost="chordal")
    assert certificate.cost_upper == pytest.approx(4800 * np.sin(first) ** 2, rel=1e-9)
    assert certificate.verdict.value == "CERTIFIED"


def test_what_is_not_measured_has_no_covariance(file, tmp_path):
    """Full information on x, z and turns: an eigenvalue is zero up to its rounding."""
    M = np.random.default_rng(3).standard_normal((6, 6))
    M = M @ M.T
    M[1], M[:, 1] = 0.0, 0.0
    numbers = " ".join(map(repr, M[np.triu_indices(6)].tolist()))
    instance = read(file, (0, 1, f"1 0 0 {TO}", numbers), (0, 1, f"1 0 0 {TO}", FULL))
    with pytest.raises(InputError, match="pyfg holds covariances"):
        certpgo.write(tmp_path / "out.pyfg", instance)


def test_flat_landmarks(file):
    """Points without a height are seen by poses that have one."""
    seen = "EDGE_SE3_TRACKXYZ {} 9 0 {} 0 30 0 0 20 0 0\n"
    text = edge(0, 1, f"1 0 0 {TO}", FULL) + seen.format(0, "1 2") + seen.format(1, "0 2.1")
    instance = io.read(file("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + text), quiet=True)
    assert instance.graph.tau[1:].tolist() == [24.0, 24.0]  # 2 / (1/30 + 1/20)
    problem = certpgo.solve(instance).problem
    assert problem.terms[1].term.weights[0].tolist() == np.diag([30.0, 20, 0]).tolist()


@pytest.mark.parametrize(
    ("information", "said"),
    [
        (" ".join(["0"] * 21), "information is zero: nothing is measured"),
        (PLANE.replace("0 400", "1 400"), "a row and a column of zeros"),
        (PLANE.replace("400", "-400"), "rotation block of the information is not positive"),
    ],
)
def test_what_is_no_information(file, information, said):
    with pytest.raises(FormatError, match=said):
        read(file, (0, 1, f"1 0 0 {TO}", information))
