"""Global ICP and the pose graph of scans: laws, a scene whose truth is known, and the bunny."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import certpgo
from certpgo.cli import application
from certpgo.errors import GraphError, InputError, SpecError
from certpgo.graph import Estimate
from certpgo.io.surfaces import Surface, read_surface, write_surface
from certpgo.linalg import rotations as so
from certpgo.registration.dense import align, prepare
from certpgo.registration.scans import Scan, read_initial, read_scan

pytest.importorskip("small_gicp")

SCANS = 5


def bumpy(directions):
    """A star-shaped surface of about one metre, without symmetries."""
    x, y, z = directions.T
    radius = 1.0 + 0.2 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.15 * np.sin(5 * z + 2 * x)
    return radius[:, None] * directions


def scene(seed=0, noise=0.0):
    """Scans from around, each in its own frame, and their true poses."""
    rng = np.random.default_rng(seed)
    d = rng.standard_normal((12_000, 3))
    points = bumpy(d / np.linalg.norm(d, axis=1, keepdims=True))
    truth = Estimate(so.random(rng, SCANS, 3), rng.standard_normal((SCANS, 3)))
    scans = []
    for k in range(SCANS):
        angle = 2 * np.pi * k / SCANS
        seen = points[points @ [np.cos(angle), np.sin(angle), 0.0] > 0.0]
        seen = seen + noise * rng.standard_normal(seen.shape)
        local = (seen - truth.translations[k]) @ truth.rotations[k]
        scans.append(Scan(f"{k}", local))
    return scans, truth


def disturbed(scans, truth, degrees, seed=1):
    """Each scan but the first turned about its centre."""
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((len(scans), 3))
    axes *= np.radians(degrees) / np.linalg.norm(axes, axis=1, keepdims=True)
    axes[0] = 0.0
    R = truth.rotations @ so.exp(axes)
    centres = np.array([scan.points.mean(axis=0) for scan in scans])
    t = truth.translations + np.einsum("nab,nb->na", truth.rotations - R, centres)
    return Estimate(R, t)


def point_rms(scans, estimate, truth):
    """How far points are from where they should be, rms, up to a common motion."""
    there, here = (
        np.concatenate(
            [
                s.points[::20] @ R.T + t
                for s, R, t in zip(scans, e.rotations, e.translations, strict=True)
            ]
        )
        for e in (truth, estimate)
    )
    there, here = there - there.mean(axis=0), here - here.mean(axis=0)
    S = so.project((there.T @ here)[None])[0]
    return np.sqrt(np.mean(np.sum((here @ S.T - there) ** 2, axis=1)))


@pytest.mark.parametrize("method", ["pose_graph", "global_icp"])
def test_scans_without_noise_come_back(method):
    scans, truth = scene()
    found = certpgo.register(scans, disturbed(scans, truth, 10.0), method=method, voxel=0.03)
    assert found.coarse.converged
    # Normals of sampled points curve: a fraction of the 4 cm between them.
    assert point_rms(scans, found.estimate, truth) < (0.001 if method == "pose_graph" else 0.003)
    np.testing.assert_allclose(found.estimate.rotations[0], truth.rotations[0], atol=1e-12)
    if method == "pose_graph":
        assert found.solution.verdict.value == "CERTIFIED"
        assert len(found.pairs) >= SCANS
        assert found.disagreement.max() < 0.005


def test_a_moved_world_moves_the_answer():
    scans, truth = scene(noise=0.002)
    begin = disturbed(scans, truth, 5.0)
    S, s = so.exp(np.array([0.3, -0.7, 0.2])), np.array([1.0, 0.0, 2.0])
    here = certpgo.register(scans, begin, voxel=0.04).estimate.moved(S, s)
    there = certpgo.register(scans, begin.moved(S, s), voxel=0.04).estimate
    np.testing.assert_allclose(there.rotations, here.rotations, atol=2e-4)
    np.testing.assert_allclose(there.translations, here.translations, atol=5e-4)


def test_the_order_of_scans_does_not_matter():
    scans, truth = scene(noise=0.002)
    begin, order = disturbed(scans, truth, 5.0), np.array([0, 3, 1, 4, 2])
    here = certpgo.register(scans, begin, voxel=0.04).estimate
    there = certpgo.register([scans[k] for k in order], begin.subset(order), voxel=0.04).estimate
    assert point_rms(scans, there.subset(np.argsort(order)), here) < 5e-4


def hills(x, seed=21):
    """A piece of 4 x 4 m, at x, of one surface without symmetries, in a frame of its own."""
    rng = np.random.default_rng(seed)
    centres, heights = rng.uniform([-6.0, -3.0], [46.0, 3.0], (400, 2)), rng.uniform(-0.5, 0.5, 400)
    widths = rng.uniform(0.2, 0.8, 400)
    points = np.random.default_rng(round(10 * x)).uniform(-2.0, 2.0, (4000, 2))
    squares = ((points[:, None] + [x, 0.0] - centres) ** 2).sum(axis=2)
    return np.c_[points, np.exp(-0.5 * squares / widths**2) @ heights]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_scan_of_another_place_is_named_in_any_order(order):
    scans = [Scan(name, hills(x)) for name, x in (("0", 0.0), ("1", 1.0), ("2", 35.0))]
    with pytest.raises(GraphError, match=r"^2: overlaps with no other scan"):
        certpgo.register([scans[k] for k in order])


def test_pairs_bring_together_what_all_scans_at_once_do_not():
    places = np.array([0.0, 0.9, 1.7])
    scans = [Scan(f"{x}", hills(x, seed=20)) for x in places]
    found = [certpgo.register(scans), certpgo.register(scans[::-1])]
    for one, at in zip(found, (places, places[::-1]), strict=True):
        assert one.solution.verdict == "CERTIFIED"
        along = one.estimate.translations - [[1.0, 0.0, 0.0]] * (at - at[0])[:, None]
        assert np.abs(along).max() < 0.005


def test_a_scan_given_twice_tells_no_more_than_another_of_the_same_surface():
    rng = np.random.default_rng(0)
    first, second = (hills(x) + 0.01 * rng.standard_normal((4000, 3)) for x in (0.0, 0.1))
    scans = [Scan("a", first), Scan("a", first), Scan("b", second)]
    found = certpgo.register(scans)
    [copied] = [pair for pair in found.pairs if {pair.i, pair.j} == {0, 1}]
    others = [pair for pair in found.pairs if pair is not copied]
    most = max(np.linalg.eigvalsh(pair.found.information)[-1] for pair in others)
    assert copied.found.rmse < 1e-9
    assert np.linalg.eigvalsh(copied.found.information)[-1] < 3.0 * most


def test_exact_planes_tell_no_more_than_a_thousandth_of_the_reach():
    x, y = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 3000))
    floor = prepare(np.stack([x, y, np.zeros_like(x)], axis=1), voxel=0.1)
    found = align(floor, floor, (np.eye(3), np.zeros(3)), reach=0.2)
    assert found.information[5, 5] <= 1.001 * (found.inliers / 0.0002**2 + 0.2**-2)


def test_scans_apart_are_named():
    scans, truth = scene()
    far = truth.translations.copy()
    far[2] += 50.0
    with pytest.raises(GraphError, match="2: overlaps with no other scan"):
        certpgo.register(scans, Estimate(truth.rotations, far), voxel=0.05)
    far[4] -= 50.0
    with pytest.raises(GraphError, match="2, 4: overlap with no other scans"):
        certpgo.register(scans, Estimate(truth.rotations, far), voxel=0.05)


def test_unusable_requests_are_refused():
    scans, truth = scene()
    with pytest.raises(SpecError, match="pose_graph"):
        certpgo.register(scans, truth, method="posegraph")
    with pytest.raises(InputError, match="two or more"):
        certpgo.register(scans[:1])
    with pytest.raises(InputError, match="5 poses"):
        certpgo.register(scans, truth.subset(np.arange(3)))
    with pytest.raises(InputError, match="few: 4 voxels"):
        certpgo.register([scans[0], Scan("few", np.eye(4, 3))], voxel=0.05)


def test_the_command_writes_all_or_nothing(tmp_path):
    scans, truth = scene(noise=0.002)
    names = []
    for scan in scans:
        names.append(str(tmp_path / f"{scan.name}.ply"))
        write_surface(names[-1], Surface(scan.points))
    certpgo.write(tmp_path / "begin.tum", truth)
    outputs = [tmp_path / name for name in ("all.ply", "g.g2o", "t.tum")]
    out, graph, trajectory = map(str, outputs)
    run = CliRunner()
    begin = ["--initial", str(tmp_path / "begin.tum"), "--voxel", "0.04"]
    more = ["-o", out, "--graph", graph, "--trajectory", trajectory]
    done = run.invoke(application(["register"]), ["register", *names, *begin, *more])
    assert done.exit_code == 0, done.output
    for said in ("CERTIFIED", "overlap", "disagreement", "not that the right surfaces", "freedom"):
        assert said in done.output
    assert "chi^2 is" not in done.output
    assert len(read_surface(out).points) == sum(len(scan.points) for scan in scans)
    again = certpgo.solve(certpgo.read(graph))  # under the same cost
    poses = certpgo.read_estimate(trajectory)
    assert point_rms(scans, again.estimate, poses) < 1e-6
    for path in outputs:
        path.unlink()
    (tmp_path / "0.ply").write_text("ply\nnonsense\n")
    refused = run.invoke(application(["register"]), ["register", *names, *begin, *more])
    assert refused.exit_code != 0
    assert not any(path.exists() for path in outputs)


def test_pairs_that_contradict_one_another_are_warned_of(tmp_path, monkeypatch):
    from certpgo.registration import register

    measure = register.aligned_pairs

    def one_is_wrong(*given, **more):
        pairs, sliding = measure(*given, **more)
        found = pairs[0].found
        off = replace(found, R=found.R @ so.exp(np.array([[0.0, 0.0, 0.1]]))[0])
        return [replace(pairs[0], found=off), *pairs[1:]], sliding

    monkeypatch.setattr(register, "aligned_pairs", one_is_wrong)
    scans, truth = scene(noise=0.002)
    names = []
    for scan in scans:
        names.append(str(tmp_path / f"{scan.name}.ply"))
        write_surface(names[-1], Surface(scan.points))
    certpgo.write(tmp_path / "begin.tum", truth)
    begin = ["--initial", str(tmp_path / "begin.tum"), "--voxel", "0.06"]
    out = ["-o", str(tmp_path / "all.ply"), "--json"]
    done = CliRunner().invoke(application(["register"]), ["register", *names, *begin, *out])
    assert "times the stated noise; measurements may be wrong" in done.stderr
    found = json.loads(done.stdout)
    assert found["fit"]["degrees_of_freedom"] == 18
    assert found["fit"]["chi2"] == pytest.approx(found["cost"])
    assert found["cost"] > 1000.0
    assert "times the stated noise" in found["fit"]["warning"]


@pytest.fixture
def bunny():
    folder = Path(os.environ.get("CERTPGO_DATA", "")) / "scans" / "bunny"
    if not folder.is_dir():
        pytest.skip("scans/bunny: files not here")
    names = ["bun000.ply", "bun045.ply", "chin.ply", "top3.ply"]
    return [read_scan(folder / name) for name in names], read_initial(folder / "bun.conf", names)


def test_the_bunny_comes_together(bunny):
    scans, conf = bunny
    scans = [replace(scan, points=scan.points[::3]) for scan in scans]
    found = certpgo.register(scans, disturbed(scans, conf, 10.0), voxel=0.002)
    assert found.solution.verdict.value == "CERTIFIED"
    assert point_rms(scans, found.estimate, conf) < 0.3e-3
