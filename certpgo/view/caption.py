"""The caption of a scene: its title, the verdict, and what its colours mean."""

from __future__ import annotations

import html
from collections.abc import Iterator

import numpy as np

from certpgo.graph.kinds import PRIORS
from certpgo.graph.phrases import counted
from certpgo.view.scene import Rgb, Scene, colours
from certpgo.view.sureness import COVARIANCES, REGIONS

#: Of rejected measurements, landmarks and priors.
REJECTED, LANDMARKS, PRIOR_DOTS = (220, 50, 47), (213, 94, 0), (204, 121, 167)
#: Of what surrounds nodes.
OUTLINES = {REGIONS: (26, 140, 70), COVARIANCES: (160, 67, 138)}
#: Colours of the scale of a measure.
SHADES = 5

_STYLE = """<style>
#caption { position: fixed; left: .6rem; top: .6rem; z-index: 10; max-width: min(24rem, 62vw);
  padding: .45rem .6rem; border-radius: .4rem; pointer-events: none; color: #1b1f24;
  background: rgb(255 255 255 / .82); font: 13px/1.4 system-ui, sans-serif;
  overflow-wrap: anywhere }
#caption b { font-size: 1.1em } #caption p { margin: .15rem 0 }
#caption i { display: inline-block; width: 1.4em; height: .6em; margin-right: .4em }
@media (max-width: 480px) { #caption { font-size: 11px; padding: .3rem .4rem } }
%s
</style>"""
_DARK = "#caption { color: #e6e9ed; background: rgb(20 23 27 / .82) }"


def truth_ink(dark: bool | None) -> Rgb:
    """The colour of the ground truth; None is a background that may be either."""
    return (60, 200, 150) if dark else (0, 130, 95)


def legend(scene: Scene, unit: str, dark: bool | None) -> Iterator[tuple[list[Rgb], str]]:
    """Colours and what they mean, of all that is drawn."""
    answer = scene.placements[-1] if scene.placements else None
    measure = None if answer is None else scene.measure(answer, unit)
    if measure is not None and measure.top > 0.0:
        shades = colours(np.linspace(0.0, 1.0, SHADES), dark=dark).tolist()
        scale = [(r, g, b) for r, g, b in shades]
        yield scale, f"measurements: {unit}, 0 to {measure.top:.3g} or more"
    if rejected := int(scene.rejected.sum()):
        yield [REJECTED], f"{counted(rejected, 'measurement{s}')} rejected"
    if scene.truth is not None:
        yield [truth_ink(dark)], "truth"
    if scene.landmarks.any():
        yield [LANDMARKS], counted(int(scene.landmarks.sum()), "landmark{s}")
    for outlines in scene.outlines:
        yield (
            [OUTLINES[outlines.name]],
            f"{outlines.sentence} Hidden at first: a layer of the scene's tree",
        )
    if priors := int(scene.are(*PRIORS).sum()):
        yield [PRIOR_DOTS], counted(priors, "prior{s}")


def overlay(scene: Scene, unit: str, dark: bool | None) -> str:
    """The caption as HTML above a page's scene; ``dark`` None follows the reader's system."""
    follows = f"@media (prefers-color-scheme: dark) {{ {_DARK} }}"
    style = _STYLE % (follows if dark is None else _DARK if dark else "")
    said = "".join(
        f'<p><i style="background:{_background(inks)}"></i>{html.escape(text)}</p>'
        for inks, text in legend(scene, unit, dark)
    )
    verdict = f"<p>{html.escape(scene.verdict)}</p>" if scene.verdict else ""
    return f'{style}<div id="caption"><b>{html.escape(scene.name)}</b>{verdict}{said}</div>'


def _background(inks: list[Rgb]) -> str:
    shown = [f"rgb({r} {g} {b})" for r, g, b in inks]
    return shown[0] if len(shown) == 1 else f"linear-gradient(90deg, {', '.join(shown)})"
