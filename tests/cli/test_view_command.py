"""certpgo view."""

import re
import sys
from contextlib import contextmanager

import pytest

from certpgo.errors import how_to_install
from certpgo.view.show import View

pytest.importorskip("viser", reason="viser is not installed")


def test_a_scene_is_written_as_one_page(certpgo, square, tmp_path):
    out = tmp_path / "scene.html"
    done = certpgo("view", square, "--solve", "-o", out, "--dark", "--play")
    assert done.code == 0
    assert done.out == ""
    said = done.err.splitlines()
    assert said[0].startswith("note: square: CERTIFIED, g2o's chi2 of EdgeSE2 with ")
    assert said[1] == f"note: scene written to {out}"
    page = out.read_text()
    assert "<title>square</title>" in page
    assert str(tmp_path) not in page.partition("__VISER_EMBED_DATA__")[0]


@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG"), (".PDF", b"%PDF"), (".svg", b"<?xml")]
)
def test_a_file_holds_what_its_suffix_says(certpgo, square, tmp_path, suffix, begins):
    pytest.importorskip("matplotlib")
    out = tmp_path / f"scene{suffix}"
    assert certpgo("view", square, "-o", out, "--dark").code == 0
    assert out.read_bytes().startswith(begins)


def test_the_live_view_prints_its_address_until_it_is_interrupted(certpgo, square, monkeypatch):
    def interrupt(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr("certpgo.cli.view.time.sleep", interrupt)
    done = certpgo("view", square, "--robust", "--port", "8140")
    assert done.code == 0
    assert re.match(r"http://127\.0\.0\.1:\d+ shows square; Ctrl-C ends\n", done.out)


def test_files_are_told_apart_by_what_they_hold(certpgo, square, tmp_path, monkeypatch):
    shown = []

    @contextmanager
    def serve(view, **options):
        shown.append(view)
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(View, "serve", serve)
    answer, track = tmp_path / "answer.g2o", tmp_path / "track.tum"
    assert certpgo("solve", square, "-o", answer).code == 0
    assert certpgo("convert", square, track, "--estimate").code == 0
    assert certpgo("view", square, answer, "--truth", track, "--colour", "metres").code == 130
    assert certpgo("view", track, answer).code == 130
    graph, tracks = (view.scene for view in shown)
    assert [p.name for p in graph.placements] == ["initial values", "answer"]
    assert graph.truth is not None
    assert shown[0].colour == "metres"
    assert [p.name for p in tracks.placements] == ["track", "answer"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("{graph}", "--play"), "--play is for pages"),
        (("{graph}", "-o", "{graph}"), "lost|overwritten"),
        (("{graph}", "{graph}.x"), "no such file"),
        (("{text}",), "text.txt: no known format"),
        (("{cloud}",), "cloud.ply: at least one vertex with x, y and z expected"),
        (("{graph}", "--colour", "rotation-weight", "-o", "{out}"), "not by rotation weight"),
        (("{graph}", "-o", "{out}.gif"), r"written as \.html, \.png, \.pdf or \.svg"),
        (("{graph}", "-o", "{out}.png", "--play"), "a picture cannot play"),
        (("{graph}", "-o", "{out}.png", "--colour", "rotation-weight"), "not by rotation weight"),
    ],
)
def test_refusals(certpgo, square, tmp_path, arguments, said):
    names = {"graph": square, "out": tmp_path / "out.html"}
    for name, text in (
        ("text.txt", "words\n"),
        ("cloud.ply", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"),
    ):
        names[name.partition(".")[0]] = tmp_path / name
        (tmp_path / name).write_text(text)
    before = square.read_text()
    done = certpgo("view", *(argument.format(**names) for argument in arguments))
    assert done.code == 1
    assert re.search(said, done.err)
    assert done.err.count("\n") == 1
    assert not list(tmp_path.glob("out.html*"))
    assert square.read_text() == before


def test_without_viser_the_extra_is_named(certpgo, square, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    done = certpgo("view", square, "-o", tmp_path / "out.html")
    assert done.code == 1
    assert done.err == f"certpgo: viser is not installed: {how_to_install('view')}\n"
