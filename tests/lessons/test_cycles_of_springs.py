"""What *Cycles of springs* says, and that its picture computes the same."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from certpgo.certify.cycles import prove


@pytest.fixture
def shown(lesson):
    return lesson("cycles_of_springs")


def test_springs_and_torques_are_the_cost(shown):
    assert shown["by_springs"] == pytest.approx(shown["by_cost"], rel=1e-12)
    c, phi = shown["springs_and_torques"](shown["problem"], shown["point"])
    assert np.hypot(c, phi) == pytest.approx(shown["kappa"])
    assert phi[[0, 2]] == pytest.approx(phi[[1, 3]], abs=1e-12)


def test_a_ring_holds_up_to_half_a_turn(shown):
    for closing, (ratio, left, proven) in shown["ratios"].items():
        formula = np.tan(np.radians(closing / 3.0)) / np.tan(np.pi / 3.0)
        assert ratio == pytest.approx(formula, rel=1e-6)
        assert (left >= 0.0) == proven == (closing < 180.0)
    assert shown["pairs"] == {170.0: True, 178.0: True, 182.0: False}


def test_the_chord_serves_both_triangles_exactly_where_the_dual_holds(shown):
    assert [proven for _, proven, *_ in shown["shown"]] == [True, True, True, False, True]
    for left, proven, ratio, least in shown["shown"]:
        assert (left >= 0.0) == (ratio <= 1.0) == (least > -1e-6) == proven


@pytest.mark.parametrize("seed", range(6))
def test_the_ratio_is_where_nothing_is_left(shown, seed):
    """With springs times the ratio the chord has nothing to spare: the split is the best."""
    rng = np.random.default_rng(seed)
    degrees = rng.uniform(-50.0, 50.0, 5)
    square, here = shown["stationary"](shown["SQUARE"], degrees, rng.uniform(0.5, 2.0, 5))
    c, phi = shown["springs_and_torques"](square, here)
    ratio = prove(square, here).ratio
    assert shown["chord_left"](1.0001 * ratio * c, phi) > 0.0
    assert shown["chord_left"](0.9999 * ratio * c, phi) < 0.0


def test_what_is_left_over_costs_second_order(shown):
    losses = [shown["losses"][size] for size in (0.1, 0.01, 0.001)]
    assert losses[1] / losses[2] == pytest.approx(100.0, rel=0.05)
    assert losses[0] > 50.0 * losses[1]


def test_exercises(shown):
    assert shown["same"] == {118.0: True, 122.0: False}
    assert shown["opposite"] == {150.0: True, 170.0: True}


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_picture_computes_what_cells_do(shown):
    rng = np.random.default_rng(1)
    given = [(np.degrees(rng.uniform(-1.2, 1.2, 5)), rng.uniform(0.5, 2.0, 5)) for _ in range(20)]
    given += [(np.array([a, 0.0, b, 0.0, 0.0]), np.ones(5)) for a, b in ((110, 110), (130, 130))]
    graphs = [[np.radians(degrees).tolist(), kappa.tolist()] for degrees, kappa in given]
    asked = f"""{shown["SCRIPT"]}
    const found = {json.dumps(graphs)}.map(([m, k]) => {{
      const g = {{...GRAPHS[1], k}};
      let x = [0, 0, 0, 0];
      for (let step = 1; step <= 20; step++) {{
        g.m = m.map((angle) => angle * step / 20);
        x = balanced(g, x);
      }}
      return judged(g, x);
    }});
    const first = GRAPHS.map((g) => [g.edges, judged(g, balanced(g, g.at.map(() => 0)))]);
    console.log(JSON.stringify([first, found]));"""
    done = subprocess.run(["node", "-e", asked], capture_output=True, text=True, check=True)
    drawn, found = json.loads(done.stdout)
    assert [edges for edges, _ in drawn] == [shown["TRIANGLE"].tolist(), shown["SQUARE"].tolist()]
    assert all(first["proven"] for _, first in drawn)
    verdicts = set()
    for (degrees, kappa), theirs in zip(given, found, strict=True):
        square, here = shown["stationary"](shown["SQUARE"], degrees, kappa)
        c, phi = shown["springs_and_torques"](square, here)
        assert theirs["c"] == pytest.approx(c, abs=1e-8)
        assert theirs["f"] == pytest.approx(phi, abs=1e-8)
        assert theirs["left"] == pytest.approx(shown["chord_left"](c, phi), abs=1e-7)
        assert theirs["proven"] == (shown["least_eigenvalue"](square, here) > -1e-8)
        verdicts.add(theirs["proven"])
    assert verdicts == {True, False}


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_drawing_parses_and_needs_no_network(shown):
    code = f"new Function({json.dumps(shown['SCRIPT'] + shown['DRAWING'])})"
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    page = shown["Picture"]()._repr_html_()
    assert page.count("http") == 1  # the name of SVG's elements
    assert page.startswith("<iframe")
