"""Plots: what they draw is what was computed, on the axes that were given."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")
from matplotlib.figure import Figure

import certpgo
from certpgo import plot
from certpgo.io.datasets import synthetic
from certpgo.io.surfaces import Surface
from certpgo.view import maps
from certpgo.view.load_scene import scene_of


@pytest.fixture(scope="module")
def answer():
    return certpgo.solve(synthetic.grid3d(3, np.random.default_rng(0)))


@pytest.fixture
def ax():
    return Figure().add_subplot()


@pytest.mark.parametrize("name", ["trajectory", "residuals", "spectrum", "bounds", "convergence"])
def test_every_plot_returns_the_axes_it_was_given(answer, ax, name):
    assert getattr(plot, name)(answer, ax=ax) is ax
    assert ax.has_data()


def test_without_axes_the_current_ones_are_drawn_on(answer):
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    try:
        assert plot.residuals(answer) is plt.gca()
    finally:
        plt.close("all")


def test_a_planar_trajectory_is_drawn_as_it_is(ax):
    t = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])
    estimate = certpgo.Estimate(np.array([np.eye(2)] * 3), t)
    plot.trajectory(estimate, truth=estimate, ax=ax, color="red")
    assert [line.get_label() for line in ax.lines] == ["truth", "estimate"]
    for line in ax.lines:
        assert np.allclose(line.get_xydata(), t, rtol=0.0, atol=1e-12)
    assert ax.lines[1].get_color() == "red"


def test_a_picture_of_a_scene_has_all_that_is_in_it(ax):
    instance = synthetic.grid3d(3, np.random.default_rng(0))
    cloud = Surface(np.random.default_rng(0).standard_normal((7, 3)))
    scene = scene_of(instance, ("before", instance.truth), instance.truth, cloud, rejected=[5])
    maps.draw(scene, ax, unit="metres")
    assert [line.get_label() for line in ax.lines[:3]] == ["truth", "before", "estimate"]
    loops = scene.are_loops.sum()
    lengths = [len(c.get_segments()) for c in ax.collections if hasattr(c, "get_segments")]
    assert lengths == [loops - 1, 1]
    assert len(ax.collections[0].get_offsets()) == 7


def test_graphs_without_positions_are_drawn_as_laid_out(ax):
    cycle, around = synthetic.winding_cycle(6, 0.3, 0)
    maps.draw(scene_of(cycle, around), ax)
    (edges,) = (c for c in ax.collections if hasattr(c, "get_segments"))
    lengths = [np.linalg.norm(b - a) for a, b in edges.get_segments()]
    assert np.allclose(lengths, 1.0)  # a regular hexagon, from straight above


def test_curves_are_those_of_the_answer(answer, ax):
    plot.convergence(answer, ax=ax)
    expected = [it.cost - answer.solution.lower_bound for it in answer.solution.trace]
    assert np.allclose(ax.lines[0].get_ydata(), expected, rtol=1e-12, atol=0.0)
    ax.clear()
    plot.bounds(answer, ax=ax)
    gaps, tolerance = ax.lines[0].get_xdata(), ax.lines[1].get_xdata()
    assert gaps[-1] == pytest.approx(answer.certificate.gap, rel=1e-12)
    assert [*gaps] == sorted(gaps, reverse=True)
    assert {*tolerance} == {answer.certificate.tolerance}
    ax.clear()
    plot.spectrum(answer, count=5, ax=ax)
    heights = [bar.get_height() for bar in ax.patches]
    assert np.abs(heights[:3]).max() < 1e-6 * heights[4]  # the gauge's


def test_the_cost_of_another_program_has_plots_too(tmp_path, ax):
    certpgo.write(tmp_path / "g.g2o", synthetic.grid3d(3, np.random.default_rng(0)))
    own = certpgo.solve(tmp_path / "g.g2o")
    assert plot.bounds(own, ax=ax).get_xlabel().startswith("g2o's chi2")
    assert len(plot.spectrum(own, count=4, ax=Figure().add_subplot()).patches) == 4


def test_what_cannot_be_drawn_is_refused(answer, ax):
    cycle = certpgo.solve(synthetic.winding_cycle(6, 0.3, 0)[0])
    for draw, match in (
        (lambda: plot.trajectory(cycle, ax=ax), "rotations alone"),
        (lambda: plot.trajectory(3, ax=ax), "not an int"),
        (lambda: plot.residuals(answer.problem, ax=ax), "a problem and an estimate"),
        (lambda: plot.bounds(answer.problem, ax=ax), "its certificate"),
        (lambda: plot.convergence([], ax=ax), "no iterations"),
    ):
        with pytest.raises(certpgo.InputError, match=match):
            draw()


def test_without_matplotlib_the_extra_is_named(answer, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.pyplot", None)
    with pytest.raises(certpgo.MissingDependency, match="pip install 'matplotlib"):
        plot.residuals(answer)
