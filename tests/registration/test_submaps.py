"""Sub-maps of unknown scale: exact factors without noise, laws, wrong matches, the command."""

from itertools import combinations

import numpy as np
import pytest

from certpgo.cli import main
from certpgo.errors import FormatError, GraphError
from certpgo.graph import Estimate
from certpgo.io.surfaces import Surface, read_surface, write_surface
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.registration.moments import Matches, condensed, matched_graph
from certpgo.registration.scans import Scan
from certpgo.registration.submaps import ScanMatches, read_matches, register_submaps

FACTORS = np.array([1.0, 0.5, 2.0, 1.3])


def submaps(noise=0.0, wrong=0.0, factors=FACTORS):
    """Scans of the same 60 points, each in its own frame and unit, matches, and truth."""
    rng = np.random.default_rng(0)
    n, points = len(factors), rng.uniform(-1.0, 1.0, (60, 3))
    R, t = so.random(rng, n, 3), rng.standard_normal((n, 3))
    R[0], t[0] = np.eye(3), 0.0
    scans = [
        Scan(f"{k}.ply", f * ((points + noise * rng.standard_normal((60, 3)) - t[k]) @ R[k]))
        for k, f in enumerate(factors)
    ]
    matches = []
    for i, j in combinations(range(n), 2):
        rows = np.repeat(np.arange(60)[:, None], 2, axis=1)
        rows[: int(wrong * 60), 1] = rng.permutation(60)[: int(wrong * 60)]
        matches.append(ScanMatches(i, j, rows))
    return scans, matches, Estimate(R, t, scales=1.0 / np.asarray(factors))


def test_factors_are_exact_without_noise():
    scans, matches, truth = submaps()
    found = register_submaps(scans, matches)
    assert found.solution.verdict.value == "CERTIFIED"
    assert np.abs(found.estimate.scales - truth.scales).max() < 1e-6
    assert np.abs(found.estimate.rotations - truth.rotations).max() < 1e-6
    assert np.abs(found.estimate.translations - truth.translations).max() < 1e-6


def test_wrong_matches_are_left_out():
    scans, matches, truth = submaps(noise=0.002, wrong=0.4)
    found = register_submaps(scans, matches)
    assert found.solution.verdict.value == "CERTIFIED"
    assert np.abs(np.log(found.estimate.scales / truth.scales)).max() < 0.005
    assert all(30 <= len(pair.p) <= 45 for pair in found.pairs)
    assert found.residuals.max() < 1.5


def test_a_scan_that_is_c_times_as_large_has_a_scale_1_c_times_as_large():
    scans, matches, _ = submaps(noise=0.01)
    first = register_submaps(scans, matches).estimate
    scans[2] = Scan("2.ply", 3.0 * scans[2].points)
    again = register_submaps(scans, matches).estimate
    assert np.abs(again.scales * [1.0, 1.0, 3.0, 1.0] / first.scales - 1.0).max() < 1e-6
    assert np.abs(again.translations - first.translations).max() < 1e-6


@pytest.mark.parametrize("count", [1, 3, 7, 50])
def test_few_matches_cost_what_all_cost(count):
    """For any A and t, by the graph with points at their best places."""
    rng = np.random.default_rng(count)
    p, q = rng.standard_normal((2, count, 3))
    few, others, weight = condensed(p, q)
    assert len(few) == min(count, 7)
    assert len(few) * weight == pytest.approx(count)
    s, R, t = np.array([0.7, 1.8]), so.random(rng, 2, 3), rng.standard_normal((2, 3))

    def squares(p, q):
        off = s[0] * p @ R[0].T + t[0] - s[1] * q @ R[1].T - t[1]
        return (off**2).sum()

    assert weight * squares(few, others) == pytest.approx(squares(p, q))
    problem = Quadratic(matched_graph(2, [Matches(0, 1, p, q, (0.3, 0.4))]))
    eye = np.tile(np.eye(3), (len(few), 1, 1))
    estimate = Estimate(
        np.concatenate([R, eye]),
        np.concatenate([t, np.zeros((len(few), 3))]),
        scales=np.r_[s, np.ones(len(few))],
    )
    cost = problem.cost(problem.with_optimal_translations(estimate)) * np.mean(s**2)
    free = p @ (s[0] * R[0].T) - q @ (s[1] * R[1].T)
    # The best translations are those of the nodes as well.
    assert cost == pytest.approx(((free - free.mean(axis=0)) ** 2).sum() / 0.25, abs=1e-9)


def test_a_scan_without_matches_is_named():
    scans, matches, _ = submaps()
    with pytest.raises(GraphError, match=r"3\.ply: no matches join it to 0\.ply"):
        register_submaps(scans, matches[:2])


@pytest.mark.parametrize("count", [1, 5])
def test_too_few_matches_are_counted(count):
    scans, matches, _ = submaps(factors=FACTORS[:2])
    few = ScanMatches(0, 1, matches[0].rows[:count])
    said = r"1\.ply: {} matched points? of 0\.ply and 1\.ply are too few, 6 that agree are needed"
    with pytest.raises(GraphError, match=said.format(count)):
        register_submaps(scans, [few])
    six = ScanMatches(0, 1, matches[0].rows[:6])
    assert register_submaps(scans, [six]).solution.verdict == "CERTIFIED"


def test_matches_that_do_not_agree_are_said_not_to():
    scans, matches, _ = submaps(factors=FACTORS[:2], wrong=1.0)
    with pytest.raises(GraphError, match=r"1\.ply: no 6 matches that agree join it to 0\.ply"):
        register_submaps(scans, matches)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("0.ply 1 1.ply", "SCAN POINT SCAN POINT"),
        ("0.ply 1 1.ply -2", "SCAN POINT SCAN POINT"),
        ("0.ply 1 9.ply 2", "no scan 9.ply"),
        ("0.ply 1 1.ply 60", "1.ply has points 0 to 59, no 60"),
        ("0.ply 1 0.ply 2", "points of two scans"),
    ],
)
def test_wrong_lines_of_matches_are_named(tmp_path, line, said):
    path = tmp_path / "matches.txt"
    path.write_text(f"# two scans\n{line}\n")
    with pytest.raises(FormatError, match=said) as error:
        read_matches(path, submaps()[0])
    assert error.value.line == 2


@pytest.fixture
def files(tmp_path):
    """The scans and their matches as files."""
    scans, matches, _ = submaps(noise=0.002, wrong=0.2)
    grey = np.full((60, 3), 128, np.uint8)
    for scan in scans:
        write_surface(tmp_path / scan.name, Surface(scan.points, grey))
    lines = [f"{m.i}.ply {a} {m.j}.ply {b}\n" for m in matches for a, b in m.rows.tolist()]
    (tmp_path / "matches.txt").write_text("".join(lines))
    return [*(str(tmp_path / scan.name) for scan in scans), "-o", str(tmp_path / "all.ply")]


def test_the_command_brings_scans_into_one_unit(files, tmp_path, capsys):
    out = {name: str(tmp_path / name) for name in ("scales.csv", "t.tum", "g.npz")}
    line = ["--scale", "--matches", str(tmp_path / "matches.txt"), "--scales", out["scales.csv"]]
    line += ["--trajectory", out["t.tum"], "--graph", out["g.npz"]]
    assert main(["register", *files, *line]) == 0
    said = capsys.readouterr().out
    assert said.startswith("CERTIFIED")
    assert "F over similarities" in said
    [header, *rows] = (tmp_path / "scales.csv").read_text().splitlines()
    assert header == "scan,scale"
    scales = np.array([float(row.split(",")[1]) for row in rows])
    assert np.abs(scales * FACTORS - 1.0).max() < 0.01
    points = read_surface(tmp_path / "all.ply").points.reshape(4, 60, 3)
    assert np.abs(points - points[0]).max() < 0.02
    proof = str(tmp_path / "p.cert")
    assert main(["solve", out["g.npz"], "--proof", proof]) == 0
    assert main(["check", out["g.npz"], proof, "--exact"]) == 0
    assert "4 scales unknown, in the unit of the root mean square" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scale"], "--scale needs --matches"),
        (["--matches", "m.txt"], "--matches needs --scale"),
        (["--scales", "s.csv"], "--scales needs --scale"),
        (["--scale", "--matches", "m", "--initial", "bun.conf"], "--initial is for scans in one"),
        (["--scale", "--matches", "m", "--voxel", "0.1"], "--voxel is for scans in one unit"),
        (["--scale", "--matches", "m", "--reach", "0.1"], "--reach is for scans in one unit"),
        (["--scale", "--matches", "m", "--method", "global_icp"], "global_icp takes scans in one"),
        (["--scale", "--matches", "m", "--graph", "g.g2o"], "only .npz files hold a graph without"),
        (["--scale", "--matches", "nowhere"], "nowhere: cannot be read"),
        (["-o", "all.xyz"], "the points are written as .ply"),
    ],
)
def test_what_cannot_be_combined_is_refused(files, tmp_path, monkeypatch, capsys, options, said):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(["register", *files, *options]) == 1
    [line] = [row for row in capsys.readouterr().err.splitlines() if row.startswith("certpgo: ")]
    assert said in line
    assert sorted(tmp_path.iterdir()) == before
