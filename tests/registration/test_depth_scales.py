"""Frames whose depths have an unknown factor each: exact factors, laws, the command."""

import numpy as np
import pytest

import certpgo
from certpgo.cli import main
from certpgo.errors import FormatError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.procrustes import procrustes
from certpgo.registration.averaging import averaged_scales
from certpgo.registration.depth_scales import (
    agreed_scales,
    of_one_median,
    with_factors,
    with_factors_of,
)
from certpgo.registration.pairs import FramePair, in_units_of
from certpgo.registration.reconstruct import ReconstructSettings
from certpgo.registration.synthetic import synthetic_sequence

cv2 = pytest.importorskip("cv2")

HIDDEN = np.array([0.5, 2.0, 1.3, 0.8, 1.7, 0.6])
COVARIANCE = np.diag([1e-6] * 3 + [1e-5] * 3 + [1e-6])


def exact_pairs(factors, covariance=COVARIANCE):
    """Exact pairs of frames in whose units lengths are ``factors`` times those in metres."""
    rng, n = np.random.default_rng(0), len(factors)
    R, t = so.random(rng, n, 3), rng.standard_normal((n, 3))
    pairs = []
    for i in range(n):
        for j in range(i + 1, n):
            turn, shift = R[i].T @ R[j], R[i].T @ (t[j] - t[i])
            numbers = (100, 90, 1.0, False, 1.0, factors[i] / factors[j])
            pairs.append(FramePair(i, j, turn, factors[i] * shift, covariance, *numbers))
    return pairs, Estimate(R, t)


def even(factors):
    """Factors over their geometric mean."""
    return factors / np.exp(np.log(factors).mean())


def test_scales_are_exact_without_noise():
    pairs, truth = exact_pairs(HIDDEN)
    scales = agreed_scales(pairs, 6)
    assert np.abs(scales * even(HIDDEN) - 1.0).max() < 1e-9
    found = averaged_scales(in_units_of(scales, pairs), [f"{k}" for k in range(6)], "exact")
    assert found.answer.verdict.value == "CERTIFIED"
    assert np.abs(found.scales - 1.0).max() < 1e-6
    # Lengths are metres over the geometric mean of the hidden units.
    moved = truth.anchored(0)
    assert np.abs(found.poses.rotations - moved.rotations).max() < 1e-6
    unit = np.exp(np.log(HIDDEN).mean())
    assert np.abs(found.poses.translations - unit * moved.translations).max() < 1e-6


def test_scales_that_are_off_are_put_right():
    """The robust fit and the solution begin at scales with errors of 0.1 %."""
    pairs, _ = exact_pairs(HIDDEN)
    off = np.exp(0.001 * np.random.default_rng(1).standard_normal(6)) / HIDDEN
    found = averaged_scales(in_units_of(off, pairs), [f"{k}" for k in range(6)], "exact")
    assert found.kept.all()
    assert np.abs(even(found.scales * off * HIDDEN) - 1.0).max() < 1e-6


def test_wrong_ratios_pull_no_harder_than_others():
    pairs, _ = exact_pairs(HIDDEN)
    wrong = pairs[4].in_units_of(np.array([3.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    scales = agreed_scales([*pairs[:4], wrong, *pairs[5:]], 6)
    assert np.abs(np.log(even(scales * HIDDEN))).max() < 0.002


def test_frames_that_nothing_joins_keep_their_unit():
    pairs, _ = exact_pairs(HIDDEN[:3])
    scales = agreed_scales(pairs, 5)
    assert scales[3:].tolist() == [1.0, 1.0]
    assert np.abs(scales[:3] * even(HIDDEN[:3]) - 1.0).max() < 1e-9


@pytest.fixture(scope="module")
def frames():
    return synthetic_sequence(30).chosen(range(6))


@pytest.fixture(scope="module")
def found(frames):
    return certpgo.reconstruct(with_factors(frames, HIDDEN), ReconstructSettings(scales=True))


def test_factors_and_trajectory_are_recovered(frames, found):
    assert found.answer.verdict.value == "CERTIFIED"
    assert found.answer.certificate.objective.startswith("F over similarities")
    assert np.abs(np.log(even(found.factors * HIDDEN))).max() < 0.005
    t, truth = found.estimate.translations, frames.truth.translations
    [R], [shift], [s] = procrustes(truth[None], t[None], scaled=True)
    assert np.sqrt(((s * t @ R.T + shift - truth) ** 2).sum(axis=1).mean()) < 0.003
    medians = [
        np.median(depth[depth > 0]) for depth in (found.frames.frame(k).depth for k in range(6))
    ]
    assert np.exp(np.log(medians).mean()) == pytest.approx(2.0, rel=1e-3)


def test_c_times_the_depth_has_a_factor_1_c_times_as_large(frames, found):
    """The map's unit is made of medians, so that nothing else changes."""
    more = np.array([1.0, 1.0, 3.0, 1.0, 1.0, 1.0])
    again = certpgo.reconstruct(
        with_factors(frames, HIDDEN * more), ReconstructSettings(scales=True)
    )
    assert np.abs(again.factors * more / found.factors - 1.0).max() < 1e-4
    assert np.abs(again.estimate.translations - found.estimate.translations).max() < 1e-4


def test_a_frame_without_depth_keeps_its_unit(frames):
    nothing = with_factors(frames, np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    assert of_one_median(nothing).factors[0] == 1.0


def test_the_command_writes_factors(frames, tmp_path, capsys):
    folder, scaled = tmp_path / "frames", with_factors(frames, HIDDEN)
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for k in range(3):
        frame = scaled.frame(k)
        cv2.imwrite(str(folder / f"color/{k}.png"), frame.colour[:, :, ::-1])
        cv2.imwrite(str(folder / f"depth/{k}.png"), np.rint(5000 * frame.depth).astype(np.uint16))
    c = frames.camera
    (folder / "camera.param").write_text(f"{c.fx} {c.fy} {c.cx} {c.cy}\n")
    factors, graph, page = (str(tmp_path / name) for name in ("f.csv", "g.npz", "p.html"))
    line = ["reconstruct", str(folder), "--unknown-depth-scale", "--factors", factors, "--no-cache"]
    assert main([*line, "--graph", graph, "--html", page]) == 0
    said = capsys.readouterr().out
    assert "F over similarities" in said
    assert "depth factors" in said
    [header, *rows] = (tmp_path / "f.csv").read_text().splitlines()
    assert header == "frame,name,factor"
    assert [row.split(",")[1] for row in rows] == ["0.png", "1.png", "2.png"]
    found = np.array([float(row.split(",")[2]) for row in rows])
    assert np.abs(np.log(even(found * HIDDEN[:3]))).max() < 0.005
    proof = str(tmp_path / "p.cert")
    assert main(["solve", graph, "--proof", proof]) == 0
    assert main(["check", graph, proof, "--exact"]) == 0
    assert "F over similarities" in (tmp_path / "p.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--factors", "f.csv"], "--factors needs --unknown-depth-scale"),
        (["--unknown-depth-scale", "--depth-scale", "1000"], "--depth-scale says what"),
        (["--unknown-depth-scale", "--frames", "x"], "--frames takes the poses of a graph"),
        (["--unknown-depth-scale", "--graph", "g.g2o"], "only .npz files hold a graph without"),
    ],
)
def test_what_cannot_be_combined_is_refused(tmp_path, monkeypatch, capsys, options, said):
    monkeypatch.chdir(tmp_path)
    assert main(["reconstruct", ".", *options]) == 1
    [line] = [row for row in capsys.readouterr().err.splitlines() if row.startswith("certpgo: ")]
    assert said in line
    assert not list(tmp_path.iterdir())


def test_factors_of_a_file_are_of_the_frames_that_it_names(tmp_path):
    frames, path = synthetic_sequence(3, size=(64, 48)), tmp_path / "factors.csv"
    path.write_text(f"frame,name,factor\n2,{frames.names[2]},0.5\n0,{frames.names[0]},3\n")
    found = with_factors_of(path, frames)
    assert found.names == (frames.names[0], frames.names[2])
    assert (found.frame(1).depth == 0.5 * frames.frame(2).depth).all()
    for line, said in (
        ("frame 1", ":2: columns name and factor expected"),
        (f"0,{frames.names[0]},-1", "a positive number"),
        (f"0,{frames.names[0]},nan", "a positive number"),
        (f"0,{frames.names[0]},1\n0,{frames.names[0]},1", ":3: columns"),
        ("0,other,1", "names no frame of"),
        ("", "names no frame of"),
    ):
        path.write_text(f"frame,name,factor\n{line}\n")
        with pytest.raises(FormatError, match=said):
            with_factors_of(path, frames)
    with pytest.raises(FormatError, match="cannot be read"):
        with_factors_of(tmp_path / "nowhere.csv", frames)
