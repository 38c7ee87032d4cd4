"""Digits of files: told from their numbers, and rounding that agrees with writing and reading."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import pose_graph, rng_of, seeds

from certpgo import io
from certpgo.errors import FormatError, InputError
from certpgo.graph import Estimate
from certpgo.io.digits import Digits, Writing, digits_of, writing_of
from certpgo.io.format import formats, get_format
from certpgo.linalg import rotations as so

SPREAD = [0.012345678901, -0.00456789012, 0.05, 3.14159265358979, 1234.56789012345, 2e-3, 0.07, 0.0]


@pytest.mark.parametrize("count", [3, 6, 9])
def test_digits_are_told_from_numbers(count):
    significant = [f"{x:.{count}g}".encode() for x in SPREAD]
    assert digits_of(significant) == Digits(count, False)
    fixed = [f"{x:.{count}f}".encode() for x in SPREAD]
    assert digits_of(fixed) == Digits(count, True)
    dropped = [repr(round(x, count)).encode() for x in [*SPREAD, 0.031234567891, 0.02123456789]]
    assert digits_of(dropped) == Digits(count, True)
    powers = [f"{x:.{count - 1}e}".encode() for x in SPREAD]
    assert digits_of(powers) == Digits(count, False)


def test_all_digits_and_no_numbers_are_no_precision():
    assert digits_of([repr(x / 3.0).encode() for x in SPREAD]) is None
    assert digits_of([f"{x:.18e}".encode() for x in SPREAD]) is None
    assert digits_of([b"one", b"."]) is None
    assert digits_of([]) is None
    assert digits_of([b"0", b"1", b"0"]) == Digits(0, True)


@given(st.floats(-1e6, 1e6), st.integers(1, 12))
@example(0.0, 6)
@example(5e-324, 6)
def test_rounding_is_what_printing_does(x, count):
    for digits, text in (
        (Digits(count, False), f"{x:.{count}g}"),
        (Digits(count, True), f"{x:.{count}f}"),
    ):
        size = max(abs(x), 1e-250)
        unit = 10.0**-count if digits.decimals else 10.0 ** (np.floor(np.log10(size)) + 1 - count)
        rounded = float(digits.rounded(np.array([x]))[0])
        assert abs(rounded - x) <= 0.501 * unit + 1e-15 * abs(x)
        # Ties may fall to either side.
        assert abs(rounded - float(text)) <= 1.001 * unit + 1e-15 * abs(x)


def rounded_text(text, form, count):
    """The file with the numbers of its poses printed with so many decimals."""
    lines = []
    for line in text.splitlines():
        words = line.split()
        kept = form.chart.numbers([word.encode() for word in words])
        start = len(words) - len(kept)
        lines.append(" ".join(words[:start] + [f"{float(w):.{count}f}" for w in words[start:]]))
    return "\n".join(lines) + "\n"


@settings(max_examples=10)
@given(seeds, st.sampled_from([".g2o", ".tum", ".kitti", ".rots"]), st.sampled_from([2, 3]))
def test_rounding_an_estimate_is_writing_it_with_fewer_digits(tmp_path_factory, seed, suffix, d):
    _, R, t = pose_graph(rng_of(seed), 8, d)
    estimate = Estimate(R, None if suffix == ".rots" else t)
    form = get_format(suffix[1:])
    path = tmp_path_factory.mktemp("digits") / f"estimate{suffix}"
    io.write(path, estimate)
    assert writing_of(path) is None
    path.write_text(rounded_text(path.read_text(), form, 5))
    writing = writing_of(path)
    assert writing == Writing(form.chart, Digits(5, True))
    read = form.read_poses(path)
    expected = writing.rounded(estimate)
    assert np.abs(read.rotations[:, :d, :d] - expected.rotations).max() < 1e-13
    if suffix != ".rots":
        assert np.abs(read.translations[:, :d] - expected.translations).max() < 1e-13


def test_too_few_digits_for_rotations_are_refused():
    R = so.random(np.random.default_rng(0), 5, 3)
    with pytest.raises(InputError):
        Writing(get_format("kitti").chart, Digits(1, True)).rounded(Estimate(R))


def test_formats_of_binary_numbers_have_no_digits(tmp_path):
    _, R, t = pose_graph(np.random.default_rng(0), 4, 3)
    io.write(tmp_path / "estimate.npz", Estimate(R, t))
    assert writing_of(tmp_path / "estimate.npz") is None
    with pytest.raises(FormatError, match="no such file"):
        writing_of(tmp_path / "nowhere.g2o")


def test_every_text_format_with_poses_says_how_it_writes_them():
    without = {f.name for f in formats().values() if f.read_poses and f.chart is None}
    # Of these Open3D's, OpenMVG's and robot logs have no lines, and are written with all digits, as
    # logarithms of similarities are; bags, npz, databases, and files of COLMAP and Cartographer are
    # binary; where columns are is said by a first line.
    binary = {"colmap-model", "npz", "pbstream", "rosbag", "rtabmap"}
    text = {"bundler", "columns", "iterate", "jrl", "open3d", "openmvg", "sim3", "toro"}
    assert without == binary | text


def test_a_long_word_is_looked_at_once():
    # Two ways to split its digits would take the square of its length: hours.
    assert digits_of([b"9" * 1_000_000 + b"x", b"0.25"]) == Digits(2, True)
    assert digits_of([b"1e" + b"9" * 5000, b"0.25"]) == Digits(2, True)
