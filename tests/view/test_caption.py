"""The caption of a scene: title, verdict and legend in view, light, dark and narrow."""

import html
import re

import numpy as np
import pytest

import certpgo
from certpgo.io.datasets import synthetic
from certpgo.view.caption import OUTLINES, legend, overlay
from certpgo.view.load_scene import scene_of
from certpgo.view.show import View


@pytest.fixture(scope="module")
def answered():
    instance = synthetic.grid3d(3, np.random.default_rng(0))
    answer = certpgo.solve(instance)
    return answer, scene_of(instance, answer, rejected=[5, 7])


def test_title_verdict_and_legend_are_there(answered):
    answer, scene = answered
    text = html.unescape(re.sub("<[^>]*>", " ", overlay(scene, "degrees", None)))
    assert scene.name in text
    assert answer.certificate.in_brief in text
    for said in ("degrees, 0 to", "2 measurements rejected", "truth", *OUTLINES):
        assert said.casefold() in text.casefold()
    # A scale of colours, and one for each of the others.
    assert [len(inks) for inks, _ in legend(scene, "degrees", None)] == [5, 1, 1, 1, 1]


def test_what_is_not_there_is_not_named(answered):
    answer, _ = answered
    bare = scene_of(answer.graph)
    assert bare.verdict == ""
    assert "rejected" not in overlay(bare, "degrees", None).partition("</style>")[2]


def test_dark_follows_the_system_unless_it_is_said(answered):
    _, scene = answered
    assert "prefers-color-scheme: dark" in overlay(scene, "degrees", None)
    dark, light = (overlay(scene, "degrees", which) for which in (True, False))
    assert "prefers-color-scheme" not in dark + light
    assert dark != light


def test_a_page_has_it_and_follows_the_system(answered):
    pytest.importorskip("viser", reason="viser is not installed")
    _, scene = answered
    pages = {dark: View(scene, dark) for dark in (None, False)}
    text = {dark: view._repr_html_() for dark, view in pages.items()}
    for page in text.values():
        assert page.count(html.escape('<div id="caption">')) == 1
    follows = html.escape('{darkMode:matchMedia("(prefers-color-scheme: dark)").matches}')
    assert follows in text[None]
    assert follows not in text[False]
    assert len(repr(pages[None])) < 200


def test_names_are_escaped():
    graph = synthetic.winding_cycle(5, 0.3, 0)[0].graph
    instance = certpgo.Instance("<b>&", graph, np.arange(5))
    assert "&lt;b&gt;&amp;" in overlay(scene_of(instance), "degrees", None)
