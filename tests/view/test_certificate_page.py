"""Pages: whole, escaped, needing no network, the same bytes each time; and their scripts."""

import csv
import json
import math
import re
import shutil
import subprocess
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest
from strategies import point_graph

from certpgo import Ranges, certify
from certpgo.certify import Tier, Verdict
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.wording import meaning
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.phrases import rounded_down, rounded_up
from certpgo.io.datasets import synthetic
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.curvature import smallest_eigenvalues
from certpgo.optimize.solution import Status
from certpgo.solve.assessment import assess
from certpgo.solve.solving import solve
from certpgo.view.advice import advice as advice_on
from certpgo.view.certificate_page import Origin, certificate_page
from certpgo.view.load_scene import scene_of
from certpgo.view.page import embedded, numeric
from certpgo.view.page_scene import page_scene
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.rendering.render import Section
from reports.harness.rendering.report_page import (
    ClaimPart,
    FigurePart,
    SceneView,
    TablePart,
    inlined,
    report_page,
)

HOSTILE = "<b>&\"'</script><script>alert(1)</script>"
VOID = {"meta", "br", "input", "img", "link", "hr"}


class Reader(HTMLParser):
    """What a page is made of; refuses tags that do not match."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.scripts, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append("")

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, (tag, self.getpos())

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1] += data
        else:
            self.words.append(data)

    def values(self, name):
        return [attributes[name] for _, attributes in self.tags if attributes.get(name)]

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def read(page):
    """The parts of a page that fetches nothing and names no element twice."""
    reader = Reader(page)
    for name in ("src", "href", "xlink:href", "action", "data"):
        assert all(value.startswith(("#", "data:")) for value in reader.values(name)), name
    assert not {"link", "iframe", "object", "embed", "base"} & {tag for tag, _ in reader.tags}
    assert "@import" not in page
    assert not re.search(r"url\((?!#)", page)
    ids = reader.values("id")
    assert len(ids) == len(set(ids))
    for value in reader.values("aria-labelledby") + reader.values("aria-describedby"):
        assert value in ids
    for value in reader.values("href"):
        assert value.startswith("data:") or value[1:] in ids
    return reader


def winding(n, k):
    """The cycle of identity measurements, and its stationary point of winding k."""
    edges = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)
    graph = RotationGraph(n, edges, np.tile(np.eye(3), (n, 1, 1)), np.ones(n))
    angle = 2.0 * np.pi * k * np.arange(n) / n
    R = np.tile(np.eye(3), (n, 1, 1))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angle)
    R[:, 1, 0], R[:, 0, 1] = np.sin(angle), -np.sin(angle)
    return graph, R


@pytest.fixture(scope="module")
def solved():
    """A small grid of poses, its solution and its page."""
    instance = synthetic.grid3d(3, np.random.default_rng(0))
    instance = Instance(HOSTILE, instance.graph, instance.ids, options=instance.options)
    found = solve(instance.graph, cost="chordal")
    problem = Quadratic(instance.graph)
    assessment = assess(problem, found.estimate, found.certificate, instance=instance)
    return instance, problem, found, assessment


def page_of(solved, **origin):
    instance, problem, found, assessment = solved
    made = Origin(
        graph="a graph.g2o", method="certified", environment={"versions": HOSTILE}, **origin
    )
    trace = found.solution.trace
    return certificate_page(instance, problem, found.estimate, assessment, made, trace)


def test_a_certificate_page_is_whole(solved):
    page = page_of(solved)
    reader = read(page)
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", page)
    assert headings == [
        "Where the residuals are",
        "Numbers",
        "Costliest edges",
        "Bounds by eigenvalues and angles",
        "Smallest eigenvalues of the certificate matrix",
        "Cost and gap over iterations",
        "How to check this again",
    ]
    certificate = solved[2].certificate
    assert certificate.verdict.value == "CERTIFIED"
    upper, lower = rounded_up(certificate.cost_upper, 12), rounded_down(certificate.lower_bound, 12)
    for said in (certificate.verdict.value, upper, "Proven: at most", HOSTILE):
        assert said in reader.text
    assert f"{lower} (no estimate of this graph costs less)" in reader.text
    assert "certpgo certify 'a graph.g2o' best.g2o --proof estimate.cert" in reader.text
    assert len(re.findall(r"<polyline", page)) == 2


def test_names_cannot_leave_their_place(solved):
    page = page_of(solved, remarks=(HOSTILE,), estimate=HOSTILE)
    assert "alert(1)</script>" not in page
    assert len(read(page).scripts) == len(read(page_of(solved)).scripts) == 3


def test_the_same_input_gives_the_same_bytes(solved):
    assert page_of(solved) == page_of(solved)


def test_an_infinite_cost_is_shown():
    instance = synthetic.grid3d(2, np.random.default_rng(0))
    far = instance.truth.translations.copy()
    far[3, 0] = 1e200
    estimate, problem = instance.truth.with_translations(far), Quadratic(instance.graph)
    certificate = certify(problem, estimate)
    with np.errstate(over="ignore", invalid="ignore"):
        assessment = assess(problem, estimate, certificate)
    page = certificate_page(instance, problem, estimate, assessment, Origin("g", "e"))
    text = read(page).text
    assert "UNDECIDED" in text
    assert "No edge stands out" in text
    assert "Infinity" not in page.split("<script>")[0]


def test_a_proof_is_named(solved):
    text = read(page_of(solved, proof="the proof.cert")).text
    assert "certpgo check 'a graph.g2o' 'the proof.cert'" in text
    assert "No proof file" not in text


def test_data_cannot_end_its_script():
    assert "</" not in embedded({"a": "</script>"})
    assert json.loads(embedded({"a": "</script>", "b": math.inf})) == {"a": "</script>", "b": None}


def test_eigenvalues_of_a_winding_cycle():
    """Closed form: the certificate matrix of winding k has smallest 2 cos(2 pi k/n) - 2."""
    n, k = 12, 1
    graph, R = winding(n, k)
    problem = Quadratic(graph)
    multipliers = problem.multipliers(Estimate(R))
    values = smallest_eigenvalues(problem, multipliers, 8)
    assert values[0] == pytest.approx(2.0 * math.cos(2.0 * math.pi * k / n) - 2.0, rel=1e-6)
    assert np.sort(np.abs(values))[:3] == pytest.approx(0.0, abs=1e-9)
    dense = np.linalg.eigvalsh(problem.certificate_matrix(multipliers).toarray())
    assert values == pytest.approx(dense[:8], abs=1e-6)


def test_a_refuted_answer_shows_a_negative_eigenvalue_and_its_cycle_bounds():
    graph, R = winding(12, 1)
    estimate, problem = Estimate(R), Quadratic(graph)
    certificate = certify(problem, estimate)
    instance = Instance("cycle", graph, np.arange(12))
    assessment = assess(problem, estimate, certificate)
    page = certificate_page(instance, problem, estimate, assessment, Origin("c.g2o", "e.g2o"))
    text = read(page).text
    assert "REFUTED" in text
    assert "half a turn over the number of nodes 15 deg none: the largest residual is" in text
    assert "The estimate came from a file" in text
    assert "residual, m" not in text
    assert "What to do next" in text
    assert "certpgo certify c.g2o e.g2o --best better.g2o" in text
    # All twelve angles are 30 degrees.
    assert "30 to 35 degrees 12" in text


def test_three_figures_come_first(solved):
    certificate = solved[2].certificate
    page = page_of(solved)
    figures = re.search(r'<dl class="figures">(.*?)</dl>', page, re.DOTALL)[1]
    shown = re.findall(r"<dd>([^<]*)</dd>", figures)
    values = (certificate.cost_upper, certificate.lower_bound, certificate.gap)
    assert [float(text) for text in shown] == pytest.approx(values, rel=0.1)
    assert page.index("figures") < page.index("Numbers")
    assert "What to do next" not in page


def test_what_to_do_next_depends_on_the_verdict(solved):
    instance, certificate = solved[0], solved[2].certificate

    def advice(*about, cost="chordal", **more):
        return advice_on(about[0], instance, *about[1:], cost=cost, **more)

    said = {}
    for verdict in Verdict:
        for basin in (True, False):
            judged = replace(certificate, verdict=verdict, basin_is_global=basin)
            steps = advice(judged, "a graph.g2o", "mine.tum")
            said[verdict, basin] = " ".join(f"{sentence} {command}" for sentence, command in steps)
    assert said[Verdict.CERTIFIED, True] == ""
    assert "--best polished.g2o" in said[Verdict.BOUNDED, True]
    assert "certpgo diagnose 'a graph.g2o' mine.tum" in said[Verdict.BOUNDED, True]
    assert "certpgo solve 'a graph.g2o' --initial mine.tum" in said[Verdict.BOUNDED, False]
    assert "--best better.g2o" in said[Verdict.REFUTED, False]
    assert "certpgo bounds" in said[Verdict.UNDECIDED, False]
    judged = replace(certificate, verdict=Verdict.BOUNDED, basin_is_global=False)
    again = advice(replace(judged, obstacle=Obstacle(LimitedBy.ROUNDING)), "g.g2o", searched=True)
    commands = [command for _, command in again]
    assert "certpgo solve g.g2o --tier proof" in commands
    for tier, kind in ((Tier.PROOF, LimitedBy.ROUNDING), (Tier.STANDARD, LimitedBy.LOOSE)):
        limited = replace(judged, tier=tier, obstacle=Obstacle(kind))
        assert "--tier proof" not in str(advice(limited, "g.g2o", "e.tum"))
    found = replace(judged, better=judged.refined, better_cost=judged.lower_bound)
    assert [c for _, c in advice(found, "g.g2o", "e.tum")] == [
        "certpgo certify g.g2o e.tum --best better.g2o"
    ]
    unrefined = replace(certificate, verdict=Verdict.UNDECIDED, descended=False)
    # Weaker bounds are known for the chordal cost alone.
    assert "certpgo bounds" not in str(advice(unrefined, "g.g2o", "e.tum", cost="g2o"))
    assert advice(unrefined, "g.g2o", "e.tum")[0][1] == "certpgo certify g.g2o e.tum"
    refuted = replace(certificate, verdict=Verdict.REFUTED)
    chosen = advice(refuted, "g.g2o", "e.tum", reading=["--kappa", "3"], cost="gtsam")
    assert "certpgo solve g.g2o --cost gtsam --kappa 3 -o start.g2o" in dict(chosen).values()
    certified = replace(certificate, verdict=Verdict.CERTIFIED)
    assert [c for _, c in advice(certified, "g.g2o", disagreeing=True)] == [
        "certpgo solve g.g2o --robust",
        "certpgo diagnose g.g2o",
    ]


@pytest.mark.parametrize("has_arms", [True, False])
def test_the_proof_tier_is_advised(solved, has_arms):
    """With arms, too, which held points of a file become."""
    judged = replace(solved[2].certificate, verdict=Verdict.BOUNDED, basin_is_global=False)
    judged = replace(judged, obstacle=Obstacle(LimitedBy.ROUNDING))
    made = synthetic.grid3d(2, np.random.default_rng(0))
    graph, m = made.graph, made.graph.num_edges
    arms = np.full((m, 3), 0.5) if has_arms else None
    instance = replace(
        made, graph=PoseGraph(graph.rotations_alone, graph.translations, graph.tau, arms)
    )
    steps = advice_on(judged, instance, "g.g2o", cost="chordal", searched=True)
    assert "certpgo solve g.g2o --tier proof" in dict(steps).values()


@pytest.mark.parametrize("verdict", [Verdict.BOUNDED, Verdict.UNDECIDED])
def test_more_time_is_advised_only_where_the_search_was_stopped(solved, verdict):
    judged = replace(solved[2].certificate, verdict=verdict, basin_is_global=False)
    cut = replace(judged, obstacle=Obstacle(LimitedBy.STOPPED, stopped=Status.TIME_LIMIT))
    impatient = replace(judged, obstacle=Obstacle(LimitedBy.STOPPED, True, 4, patience=5.0))
    by_itself = replace(judged, obstacle=Obstacle(LimitedBy.LOOSE, True, 4))

    def steps(certificate, *estimate, searched=False):
        about = certificate, solved[0], "g.g2o", *estimate
        return dict(advice_on(*about, cost="chordal", searched=searched))

    longer = "certpgo solve g.g2o --time-limit 600"
    for stopped in (cut, impatient):
        assert longer in steps(stopped, searched=True).values()
    assert longer not in steps(by_itself, searched=True).values()
    assert "ended by itself" in " ".join(steps(by_itself, searched=True))
    bound, of_others = steps(cut, "e.tum"), steps(by_itself, "e.tum")
    more = "The search for a bound was stopped. Give it more time."
    assert (more in bound, more in of_others) == (verdict is Verdict.UNDECIDED, False)
    if verdict is Verdict.BOUNDED:  # of the estimate that the search has just given, too
        [further] = [said for said, command in of_others.items() if "--initial" in command]
        assert "unless certpgo solve found it" in further


def test_rejecting_is_advised_where_it_can_be_done(solved):
    judged = replace(solved[2].certificate, verdict=Verdict.BOUNDED, basin_is_global=False)
    ranges = Ranges(27, np.array([[0, 26]]), np.ones(1), np.ones(1))
    for instance, found in (
        (solved[0], True),
        (replace(solved[0], graph=solved[0].graph.with_ranges(ranges)), False),
    ):
        steps = advice_on(judged, instance, "g.pyfg", cost="chordal", disagreeing=True)
        assert any("--robust" in command for _, command in steps) is found


def test_the_bound_of_a_tier_that_proves_nothing_is_called_likely(solved):
    instance, problem, found, _ = solved
    for tier, said in (
        ("screen", "probably no estimate costs less"),
        ("standard", "no estimate of this graph costs less"),
    ):
        certificate = certify(problem, found.estimate, tier=tier)
        assessment = assess(problem, found.estimate, certificate, instance=instance)
        about = instance, problem, found.estimate, assessment, Origin("g", "e")
        page = certificate_page(*about)
        notes = re.findall(r'<dd class="note">([^<]*)</dd>', page)
        assert notes[1] == said


def test_what_cannot_be_closed_is_not_searched_further(solved):
    """The sentences and the advice follow from the same fields."""
    obstacle = Obstacle(LimitedBy.LOOSE, True, 6, Status.TIME_LIMIT, of_distances=True)
    judged = replace(solved[2].certificate, verdict=Verdict.BOUNDED, basin_is_global=False)
    judged = replace(judged, obstacle=obstacle)
    assert "this gap cannot be closed" in judged.reason
    assert "searches further" not in str(judged)
    ranges = Ranges(27, np.array([[0, 26]]), np.ones(1), np.ones(1))
    about = replace(solved[0], graph=solved[0].graph.with_ranges(ranges)), "g.pyfg"
    for searched in (True, False):
        [(sentence, command)] = advice_on(judged, *about, cost="chordal", searched=searched)
        assert ("more time would not raise the bound" in sentence, command) == (True, "")
    unsolved = replace(judged, obstacle=replace(obstacle, searched=False))
    longer = dict(advice_on(unsolved, *about, cost="chordal", searched=True))
    assert "certpgo solve g.pyfg --time-limit 600" in longer.values()


def test_undecided_says_whether_a_lower_cost_is_known(solved):
    judged = replace(solved[2].certificate, verdict=Verdict.UNDECIDED)
    judged = replace(judged, refined_cost=judged.cost_upper)
    assert "Nothing useful" in meaning(judged)
    for lower in ({"refined_cost": 0.01 * judged.cost_upper}, {"better_cost": 0.0}):
        assert meaning(replace(judged, **lower)).endswith("An estimate of lower cost is known")


@pytest.fixture(scope="module")
def weighed():
    """A noisy grid of poses with matrices that weigh directions and turns differently."""
    instance = synthetic.grid3d(2, np.random.default_rng(0))
    m = instance.graph.num_edges
    matrix = np.diag([40.0, 90, 60, 40, 35, 30]) + np.ones((6, 6))
    stated = Information(matrix[None], np.zeros(m, dtype=int))
    return replace(instance, graph=instance.graph.with_information(stated))


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_the_page_of_another_cost_is_about_that_cost(weighed, cost):
    problem = objective_of(weighed, cost)
    found = solve(weighed, cost=cost)
    assert found.verdict.value == "CERTIFIED"
    assessment = assess(problem, found.estimate, found.certificate)
    origin = Origin("g.g2o", "e.g2o", method="certified", reading=("--keep", "last"))
    trace = found.solution.trace
    page = certificate_page(weighed, problem, found.estimate, assessment, origin, trace)
    text = read(page).text
    assert f"The cost F is {problem.title} on this page." in text
    assert f"objective {problem.title}" in text
    assert "other tools" not in text
    assert "Bounds by eigenvalues and angles" not in text
    assert f"certpgo certify g.g2o e.g2o --cost {cost} --keep last" in text
    assert ("--proof" in text) is (cost == "g2o")
    terms = problem.edge_costs(found.estimate)
    assert f"{terms.max():.6g} {100.0 * terms.max() / terms.sum():.3g} %" in text
    below = problem.surrogate(found.estimate)
    spectrum = smallest_eigenvalues(
        below.problem,
        below.problem.multipliers(below.problem.with_optimal_translations(found.estimate)),
        8,
    )
    assert spectrum[3] > 1.0
    assert text.count("(gauge)") == 3
    assert f"4 {spectrum[3]:.3g} 5 " in text
    (shown,) = re.findall(r"never above F, and equal to it at this estimate: ([\d.]+)\. ", text)
    assert float(shown) == pytest.approx(found.cost, rel=1e-8)


def test_the_matrix_of_another_cost_is_negative_where_it_should_be(weighed):
    problem = objective_of(weighed, "g2o")
    wrong = weighed.truth.rotations.copy()
    wrong[0] = wrong[0] @ np.diag([-1.0, -1.0, 1.0])
    estimate = Estimate(wrong, weighed.truth.translations)
    certificate = certify(problem, estimate, refine=False)
    assert certificate.verdict.value in ("BOUNDED", "UNDECIDED")
    assessment = assess(problem, estimate, certificate)
    page = certificate_page(weighed, problem, estimate, assessment, Origin("g", "e"))
    text = read(page).text
    assert ("(gauge)" in text, "fewer than 3 are zero" in text) == (False, True)
    assert "at this estimate" in text
    assert re.search(r"certificate matrix .* 1 -\d", text)


def test_columns_of_numbers():
    rows = [("a", "1.5", "-", "2 %", ""), ("1", "-3e-05", "2", "1,000", "")]
    assert numeric(rows) == [False, True, False, True, True]


TABLE = Table(
    "t",
    f"A title {HOSTILE}",
    (Row("a", label=HOSTILE),),
    (Method("m"), Method("other")),
    (Column("cost", "F", ".3f"), Column("verdict", "verdict")),
    source="A paper",
    notes=(f"A note {HOSTILE}.",),
)
SVG = """<?xml version="1.0"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="9">
<metadata><a href="https://elsewhere.org"></a></metadata>
<defs><style type="text/css">*{stroke-linejoin: round}</style><path id="p"></path></defs>
<use xlink:href="#p"></use><g clip-path="url(#p)"></g></svg>"""
DOCUMENT = {"figure": "f", "title": "F <i>", "caption": "C <i>", "notes": ["N <i>"]}


def results(**more):
    records = [
        Record(
            *("t", HOSTILE, "m"),
            key="m",
            d=3,
            n=4,
            m=5,
            metrics={"cost": 1.5, "lower_bound": 1.0},
            trace=((0.0, 3.0), (0.1, 2.0), (0.2, 1.5)),
            provenance={"engine": "e"},
        ),
        Record(
            *("t", HOSTILE, "other"),
            key="other",
            d=3,
            n=4,
            m=5,
            absence=Absence.FAILED,
            error="it failed",
        ),
    ]
    return TablePart(TABLE, records, csv="row,F\na,1.5\n", bibtex="@book{a & b}", **more)


def test_a_report_is_whole(solved):
    instance, problem, found, _ = solved
    table = results(
        claims=[
            ClaimPart("It is <i>fast</i>", "holds", "holds in 2 of 2 rows", "page 3"),
            ClaimPart("So is that", "not run"),
        ],
        cells={"reproduced": 2, "differs": 1},
        findings=[Section("Cells that differ", "", ("row", "why"), (("a", "too <i>few</i>"),))],
    )
    costs = problem.edge_costs(found.estimate)
    view = SceneView("A view", page_scene(scene_of(instance, found), costs))
    figures = [FigurePart(DOCUMENT, SVG), FigurePart({**DOCUMENT, "figure": "g"}, SVG)]
    page = report_page([table], figures, summary=["Sentence <i>"], views=[view])
    reader = read(page)
    for said in (
        "Sentence <i>",
        "too <i>few</i>",
        "2 records, 1 not run or failed",
        "1.500",
        "it failed",
        "2 reproduced, 1 differs",
        "holds in 2 of 2 rows : It is <i>fast</i> (page 3)",
        "not run : So is that",
        f"A note {HOSTILE}.",
        "@book{a & b}",
        "C <i>",
        "N <i>",
        f"{HOSTILE}: cost F above the best proven bound",
    ):
        assert said in reader.text, said
    assert len(re.findall("<polyline", page)) == 2
    link = next(value for value in reader.values("href") if value.startswith("data:text/csv"))
    rows = list(csv.reader(b64decode(unquote(link).split(",", 1)[1]).decode().splitlines()))
    assert rows == [["row", "F"], ["a", "1.5"]]
    assert ("download", "t.csv") in [(k, v) for _, a in reader.tags for k, v in a.items()]
    assert page == report_page([table], figures, summary=["Sentence <i>"], views=[view])


def test_a_report_counts_its_claims_where_nothing_else_is_said():
    claims = [ClaimPart("A", "holds"), ClaimPart("B", "not run"), ClaimPart("C", "holds")]
    assert "Claims: holds: 2, not run: 1." in read(report_page([results(claims=claims)], [])).text


def test_a_report_of_nothing_and_of_a_table_that_was_not_run():
    assert "There is nothing to report." in read(report_page([], [])).text
    page = report_page([TablePart(TABLE, ())], [])
    assert "Not run." in read(page).text
    assert "Claims" not in page


def test_a_drawing_keeps_its_ids_and_style_to_itself():
    drawn = str(inlined(SVG, "f", 'a "title"'))
    assert "elsewhere" not in drawn
    assert "<?xml" not in drawn
    assert 'id="f-p"' in drawn
    assert 'xlink:href="#f-p"' in drawn
    assert "url(#f-p)" in drawn
    assert "#f-drawing *{" in drawn
    assert 'aria-label="a &#34;title&#34;"' in drawn


@pytest.fixture
def node():
    """The program of that name."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    return program


def test_every_script_parses(solved, node):
    for script in read(page_of(solved)).scripts:
        if not script.strip().startswith("{"):
            code = f"new Function({json.dumps(script)})"
            done = subprocess.run([node, "-e", code], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr


@pytest.fixture
def browser():
    """A page of headless Chromium that keeps what its console says."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        found = shutil.which("chromium") or shutil.which("google-chrome")
        try:
            chromium = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        except api.Error as error:
            pytest.skip(f"no Chromium: {str(error).splitlines()[0]}")
        page = chromium.new_page()
        page.said = []
        page.on("console", lambda message: page.said.append(message.text))
        page.on("pageerror", lambda error: page.said.append(str(error)))
        yield page
        chromium.close()


DRAWN = """() => {
  const canvas = document.querySelector(".scene > canvas");
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(new Uint32Array(pixels.buffer)).size;
}"""


def test_the_page_in_a_browser(solved, browser, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(page_of(solved), encoding="utf-8")
    browser.goto(path.as_uri())
    assert browser.evaluate(DRAWN) > 10
    browser.click(".next")
    assert re.match(r"Edge \d+, \d+ to \d+ ", browser.inner_text(".status"))
    before = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    for _ in range(2):
        browser.click("#theme")
    assert browser.inner_text("#theme") == "Theme: dark"
    assert browser.evaluate("getComputedStyle(document.body).backgroundColor") != before
    canvas = browser.locator(".scene > canvas")
    canvas.focus()
    for key in ("ArrowLeft", "+", "-", "0"):
        canvas.press(key)
    canvas.hover()
    assert browser.said == []


@pytest.mark.parametrize(("d", "poses", "points"), [(2, 4, 4), (3, 6, 3), (3, 5, 7)])
def test_a_page_of_landmarks(d, poses, points):
    """Also where matrices of rotations and of poses and points have the same size."""
    graph, _ = point_graph(np.random.default_rng(1), poses, points, d)
    problem = Quadratic(graph)
    answer = solve(graph)
    assessment = assess(problem, answer.estimate, answer.certificate)
    instance = Instance("map", graph, np.arange(graph.num_nodes))
    text = Reader(certificate_page(instance, problem, answer.estimate, assessment, Origin("map")))
    seen = graph.num_edges - poses + 1
    assert f"{points} landmarks, {seen} sightings" in text.text
    assert "some edges measure no rotation" in text.text
    assert "rotations cannot be averaged alone" in text.text
    assert problem.rotation.pattern.points is None


#: Switches to the estimate before and back, and says which pictures are the same. A changed theme
#: draws at once.
SWITCHING = """<script>(() => {
  const canvas = document.querySelector(".scene > canvas"), box = document.querySelector(".before");
  const drawn = () => {
    document.dispatchEvent(new Event("themechange"));
    return canvas.toDataURL();
  };
  const first = drawn();
  box.click();
  const second = drawn();
  box.click();
  console.log("pictures " + JSON.stringify([first === second, first === drawn()]));
})();</script>"""


def test_before_and_after_are_other_pictures_in_a_browser(solved, chromium, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(page_of(solved) + SWITCHING, encoding="utf-8")
    opened = chromium(path)
    assert any("pictures [false,true]" in line for line in opened.said), opened.log[-2000:]
    assert not opened.errors
