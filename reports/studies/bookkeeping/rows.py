"""One row of the covering array: a graph with these features, asked about, and judged."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import CertPGOError, Estimate
from reports.studies.bookkeeping import outputs, scenes
from reports.studies.bookkeeping.asking import Told, read_poses, told
from reports.studies.bookkeeping.covering import Rule
from reports.studies.bookkeeping.drawing import Array, Measurements, turns
from reports.studies.bookkeeping.factors import REFUSED
from reports.studies.bookkeeping.judging import (
    ATOL,
    ROUNDINGS,
    SAME,
    Claim,
    Findings,
    judge,
    poses_of,
    scale,
)
from reports.studies.bookkeeping.judging import tolerance as most_of
from reports.studies.bookkeeping.oracle import Cost, Poses
from reports.studies.bookkeeping.scenes import Scene

#: Relative difference of costs between a graph and the same one in other words.
ALIKE = 1e-6
#: How far held nodes may be from where they are held, over the extent of positions.
HELD = 1e-5
#: What is compared.
METHODS = "certified,newton,spanning_tree"
#: Price of a rejected measurement.
PRICE = 20.0
#: Limit of a search.
SECONDS = 0.3


def judge_row(
    rng: np.random.Generator, found: Findings, *, row: Mapping[str, str], rule: Rule | None = None
) -> None:
    """Ask what the row says, and judge the answer; with a rule, it must be refused as that says."""
    scene = scenes.drawn(row, rng)
    with tempfile.TemporaryDirectory() as folder:
        if row["file"] == "arrays":
            _judge_arrays(rng, found, scene, rule)
            return
        answer = Asking(rng, scene, Path(folder)).answer()
        said = answer.told.refusal
        # What is left open by what is rejected is judged as an answer.
        if rule is not None and said is not None and "no covariances" not in said:
            _judge_refusal(found, said, rule, answer.row)
            found.require(not answer.told.out, f"refused after {answer.told.out[:80]!r}")
            return
        answer.judge(found)
        if row["law"] != "none" and not found.false:
            _judge_law(rng, found, scene, answer, rule)


def _judge_refusal(found: Findings, said: str, rule: Rule, row: Mapping[str, str]) -> None:
    """A refusal is right where a rule about what was asked says it: mostly that of the row."""
    found.said["refused"] += 1
    ways = [rule, *(other for other in REFUSED if other.forbids(row))]
    documented = any(re.search(way.said, said) for way in ways if way.forbids(row))
    found.require(documented, f"{dict(rule.levels)}: {said}")


def _refusing(error: CertPGOError) -> Told:
    """An error of the library, as a command says it."""
    return Told(1, "", f"certpgo: {error}")


class Asking:
    """A question to a command, and its answer."""

    def __init__(self, rng: np.random.Generator, scene: Scene, folder: Path) -> None:
        self.rng, self.scene, self.row, self.folder = rng, scene, scene.row, folder
        self.given: Poses | None = None
        self.chosen: list[int] = []  # what is rejected
        suffix = str(rng.choice([".g2o", ".npz", ".pyfg"]))
        if scene.row["relative poses"] != "whole":
            suffix = str(rng.choice([".g2o", ".npz"]))
        self.out = folder / f"out{'.pyfg' if scene.row['file'] == 'pyfg' else suffix}"
        self.nodes = np.arange(scene.of.n)

    def answer(self) -> Asking:
        """Ask."""
        row, scene = self.row, self.scene
        try:
            paths = scene.written(self.folder)
        except CertPGOError as error:
            self.told = _refusing(error)
            return self
        begin: list[str | Path] = [row["command"]]
        if row["files"] == "also" or row["command"] != "solve":
            begin += [paths[0]]
            rest: list[str | Path] = []
            for path in paths[1:]:
                rest += ["--also", path]
        else:
            begin += paths
            rest = []
        if row["command"] == "certify":
            begin.append(self._estimate())
        elif row["command"] in ("solve", "follow"):
            rest += ["-o", self.out]
        elif row["command"] == "compare":
            rest += ["--methods", METHODS, "-o", self.folder / "compared"]
        rest += scene.options
        if row["cost"] != "own":
            rest += ["--cost", row["cost"]]
        if row["outliers"] == "robust":
            rest.append("--robust")
        if row["rejected"] == "listed":
            listed = self._listed()
            if self.rejected:
                rest += ["--rejected", listed]
            else:
                row = self.row = {**row, "rejected": "none"}
                self.scene = replace(scene, row=row)
        if row["times"] == "given":
            rest += ["--timestamps", self._times()]
        if row["truth"] == "given":
            rest += ["--truth", self._truth()]
        self.proof = self.folder / "proof.cert"
        if row["proof"] == "tier":
            rest += ["--tier", "proof"]
        if row["proof"] in ("file", "integers"):
            rest += ["--proof", self.proof]
        if row["covariances"] == "asked":
            rest += ["--covariances", self.folder / "covariances.csv"]
        if row["limit"] == "short":
            rest += ["--time-limit", repr(float(10.0 ** self.rng.uniform(-3.0, -1.5)))]
        elif row["command"] not in ("info", "compare"):
            rest += ["--time-limit", repr(SECONDS if row["law"] == "none" else 5.0 * SECONDS)]
        self.paths = paths
        self.arguments = [*begin, *rest, "--json"]
        self.told = told(self.arguments)
        return self

    @property
    def _known(self) -> Array:
        of = self.scene.of
        return np.arange(of.n - of.world)

    def _poses(self, name: str, poses: Poses, nodes: Array) -> Path:
        text, suffix = self.scene.values(poses, nodes.tolist())
        path = self.folder / f"{name}{suffix}"
        path.write_text(text)
        return path

    def _times(self) -> Path:
        """The nodes' times, a line each."""
        path = self.folder / "times.txt"
        path.write_text("".join(f"{self._time(k)}\n" for k in self._known.tolist()))
        return path

    def _time(self, node: int) -> str:
        return f"{1_700_000_000 + 3 * node}.{250_000_000 + node:09d}"

    def _truth(self) -> Path:
        """The truth of poses in another frame, by id or by time, and in another order."""
        of = self.scene.of
        Q, s = turns(self.rng, 1, of.d)[0], self.rng.standard_normal(of.d)
        poses = Q @ of.R, of.t @ Q.T + s
        nodes = self.rng.permutation(self._known[~of.points[self._known]])
        if self.row["times"] == "none":
            return self._poses("truth", poses, np.sort(nodes))
        path = self.folder / "truth.tum"
        times = [self._time(k) for k in np.sort(nodes).tolist()]
        chosen = poses[0][np.sort(nodes)], poses[1][np.sort(nodes)]
        path.write_text(outputs.stamped(times, chosen, of))
        return path

    def _estimate(self) -> Path:
        """The file that is to be certified."""
        of, scene = self.scene.of, self.scene
        kind = float(self.rng.random())
        cost = Cost(scene.judged(scene.cost), scene.cost)
        poses = (of.R, cost.of.t)
        if kind < 0.6:
            _, poses = cost.descent(poses)
        elif kind < 0.8 and not scene.constrained:
            n = int((~of.points).sum()) - of.world
            R, t = of.R.copy(), poses[1].copy()
            R[:n] = turns(self.rng, n, of.d)
            t[: of.n - of.world] += self.rng.standard_normal((of.n - of.world, of.d))
            poses = R, t
        if of.world:
            poses = _in_world(poses)
        nodes = self._known
        if self.row["estimate"] == "part":
            last = int((~of.points).sum()) - of.world - 1
            nodes = nodes[nodes != last]
            self.nodes = np.delete(np.arange(of.n), last)
        self.given = poses
        return self._poses("given", (poses[0], poses[1] + scene.origin), nodes)

    def _listed(self) -> Path:
        """The table of rejected measurements."""
        known = self.scene.judged_rows(self.nodes)
        chosen = [e for e in self.scene.wrong if e in known] or self._without(known)
        self.rejected = chosen
        path = self.folder / "rejected.csv"
        lines = ["edge,i,j,price"]
        for e in chosen:
            i, j = map(self.scene.called, self.scene.of.edges[e].tolist())
            lines.append(f"{e},{i},{j},{PRICE}")
        path.write_text("\n".join(lines) + "\n")
        return path

    def _without(self, known: list[int]) -> list[int]:
        """One of these without which the others determine the nodes, if there is one."""
        of = self.scene.of
        whole = [e for e in known if of.turned[e] and (of.moved is None or of.moved[e])]
        for e in whole:
            rest = of.subset(np.array([k for k in known if k != e], dtype=int))
            held = scenes.determined(rest, self.nodes, self.scene.constrained)
            if held:
                return [e]
        return []

    def judge(self, found: Findings) -> None:
        """Judge the answer."""
        said = self.told
        name = self.row["command"]
        if said.refusal is not None:
            found.said[f"{name} refused"] += 1
            # What is left open by what is rejected has no covariance.
            is_open = self.row["outliers"] == "robust" and "no covariances" in said.refusal
            found.require(is_open, f"refused: {said.refusal}")
            return
        found.require("Traceback" not in said.complaint, said.complaint[-300:])
        if said.code == 6 and "note: no proof was written" in said.complaint:
            found.said["proof refused"] += 1
        elif said.code not in (0, 3, 4, 5):
            found.false.append(f"exit {said.code}: {said.complaint[-300:]}")
            return
        document = said.json
        judges: dict[str, Callable[[Findings, Any], None]] = {
            "follow": self._judge_followed,
            "outliers": self._judge_outliers,
            "info": self._judge_info,
            "compare": self._judge_compared,
        }
        if name in judges:
            judges[name](found, document)
            return
        verdict = document["verdict"]
        self.limited = document.get("solution", {}).get("status") == "time limit"
        codes = {"CERTIFIED": 0, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}
        found.require(said.code in (codes[verdict], 6), f"{verdict}, but exit {said.code}")
        self.verdict, self.value = verdict, document["cost"]
        cost = self.cost
        poses = self.given
        if name == "solve":
            read = read_poses(self.out, self.scene.of)
            found.require(read is not None, f"{self.out.name}: nodes are missing")
            if read is None:
                return
            poses = self.scene.near(read)
        self._judge_name(found, document, cost)
        found.require(not document["certificate"]["broken"], "held poses are said to be moved")
        self._judge_held(found, poses)
        part = (poses[0][self.nodes], poses[1][self.nodes])
        self._judge_outputs(found, document, cost, part)
        if self.row["rejected"] != "none":
            self._judge_listed(found, document, cost, part)
            return
        if name == "solve" and self.row["outliers"] == "robust":
            self._judge_robust(found, document, poses)
            return
        best = judge(found, cost, [self._claim(name, document, cost, part)])
        self._judge_proof(found, cost, best)
        if self.row["covariances"] == "asked":
            self._judge_covariances(found, cost, poses)

    def _claim(self, name: str, document: dict[str, Any], cost: Cost, poses: Poses) -> Claim:
        """What is claimed. W counts constraints, and positions from an origin near them."""
        c, tolerance = document["certificate"], document["certificate"]["tolerance"]
        # Of an exact fit the whole cost is tolerated.
        if not c["is_exact_fit"] and (self.scene.constrained or self.row["positions"] == "far"):
            tolerance = min(tolerance, most_of(cost, c["cost_upper"]))
        bound, verdict = document["lower_bound"], document["verdict"]
        upper, exact = c["cost_upper"], c["is_exact_fit"]
        return Claim(name, poses, upper, bound, tolerance, verdict, exact)

    def _judge_outputs(
        self, found: Findings, document: dict[str, Any], cost: Cost, part: Poses
    ) -> None:
        of = cost.of
        if self.row["truth"] == "given" and cost.name != "rotations":
            inside = np.flatnonzero(~of.points[: of.n - of.world])
            outputs.judge_truth(found, document["accuracy"], part[1][inside], of.t[inside])

    def _judge_proof(self, found: Findings, cost: Cost, best: float | None) -> None:
        if self.row["proof"] in ("file", "integers") and self.proof.exists():
            exact = self.row["proof"] == "integers"
            outputs.judge_proof(found, self.paths[0], self.proof, cost, best, exact=exact)

    def _judge_covariances(self, found: Findings, cost: Cost, poses: Poses) -> None:
        of, scene = cost.of, self.scene
        anchors = scene.constrained or ((of.n - 1,) if of.world else (int(np.argmin(of.ids)),))
        path = self.folder / "covariances.csv"
        ids = [scene.called(k) for k in range(of.n - of.world)]
        outputs.judge_covariances(found, path, cost, poses, anchors, ids)

    def _judge_listed(
        self, found: Findings, document: dict[str, Any], cost: Cost, part: Poses
    ) -> None:
        """What is certified beside a list of rejected measurements with their prices."""
        c = document["certificate"]
        said = {**document, "tolerance": c["tolerance"], "cost": c["cost_upper"]}
        chosen = self._indices(cost.of, self.rejected)
        self._judge_proof(found, cost, None)
        if cost.name in ("chordal", "rotations"):
            prices = np.full(len(chosen), PRICE)
            outputs.judge_rejection(found, "rejected", cost, chosen, prices, part, said)
            return
        best, _ = cost.best([part, (cost.of.R, cost.of.t)])  # without rejecting any
        slack = 4.0 * cost.rounding(part)
        lower = document["lower_bound"]
        found.require(lower <= best + slack, f"rejected: bound {lower!r} above {best!r}")

    def _indices(self, of: Measurements, chosen: list[int]) -> list[int]:
        """Which of the judged measurements are these of the scene."""
        rows = self.scene.judged_rows(self.nodes)
        return [rows.index(e) for e in chosen if e in rows]

    def _judge_followed(self, found: Findings, document: dict[str, Any]) -> None:
        """The last line of a stream is about all measurements."""
        of, cost = self.scene.of, self.cost
        read = read_poses(self.out, of)
        found.require(read is not None, f"{self.out.name}: nodes are missing")
        if read is None or self.row["outliers"] == "robust":  # which are kept is not said
            return
        self._judge_name(found, document, cost)
        sizes = document["nodes"], document["edges"]
        own = of.n, int(self.scene.counts.sum()) + len(of.pairs)
        found.require(sizes == own, f"follow: {sizes} nodes and edges, not {own}")
        bound, verdict = document["lower_bound"], document["verdict"]
        upper, tolerance = document["cost"], document["tolerance"]
        poses = self.scene.near(read)
        if self.scene.constrained or self.row["positions"] == "far":
            tolerance = min(tolerance, most_of(cost, upper))
        exact = document["tolerance"] >= upper
        judge(found, cost, [Claim("follow", poses, upper, bound, tolerance, verdict, exact)])

    def _judge_outliers(self, found: Findings, document: dict[str, Any]) -> None:
        """Those that disagree, with the truncated cost against all choices."""
        whole, listed = self.cost, document["rejected"]
        if not listed:
            found.said["outliers: none"] += 1
            return
        prices = np.array([one["price"] for one in listed])
        chosen = self._indices(whole.of, [one["edge"] for one in listed])
        own = [list(map(self.scene.called, whole.of.edges[e].tolist())) for e in chosen]
        said = [[one["i"], one["j"]] for one in listed]
        found.require(own == said, f"outliers {said}, but these measurements are {own}")
        if len(listed) > outputs.MOST:
            return
        poses = (whole.of.R, whole.of.t)
        kept = Cost(whole.of.subset(np.delete(np.arange(whole.of.m), chosen)), whole.name)
        best = outputs.least(whole, chosen, prices, [poses, kept.descent(poses)[1]])
        slack = SAME * best + ROUNDINGS * whole.rounding(poses)
        lower, upper = document["lower_bound"], document["cost"]
        found.said[f"outliers: {document['verdict']}"] += 1
        found.require(lower <= best + slack, f"outliers: bound {lower!r} above {best!r}")
        below = f"outliers: cost {upper!r} below the least, {best!r}"
        found.require(upper >= best - slack, below)
        if document["verdict"] == "CERTIFIED":
            most = most_of(whole, upper) + slack
            found.require(upper - best <= most, f"outliers: CERTIFIED {upper!r}, not {best!r}")

    def _judge_info(self, found: Findings, document: dict[str, Any]) -> None:
        """Counts of nodes and measurements."""
        of = self.scene.of
        moved = np.ones(of.m, dtype=bool) if of.moved is None else of.moved
        prior = of.edges[:, 0] == (of.n - 1 if of.world else -1)
        seen = of.points[of.edges[:, 1]]
        counts = self.scene.counts
        own = {
            "nodes": of.n,
            "points": int(of.points.sum()),
            "sightings": int((seen & counts).sum()),
            "priors": int((prior & counts).sum()),
        }
        said = {name: document[name] for name in own}
        found.require(said == own, f"info: {said}, not {own}")
        kinds = {
            "between": ~prior & ~seen & of.turned & moved,
            "rotation": ~prior & ~seen & of.turned & ~moved,
            "translation": ~prior & ~seen & ~of.turned,
            "sighting": seen,
            "prior": prior & of.turned & moved,
            "position": prior & ~of.turned,
            "attitude": prior & ~moved,
        }
        true = {name: int((flags & counts).sum()) for name, flags in kinds.items()}
        apart = ("held", "assumed", "range")
        listed = {n: k for n, k in document["measurements"].items() if n not in apart}
        true = {name: count for name, count in true.items() if count}
        found.require(listed == true, f"info: {listed}, not {true}")

    def _judge_compared(self, found: Findings, document: list[dict[str, Any]]) -> None:
        """Costs and bounds of each method."""
        cost = self.cost
        for record in document:
            name = f"compare {record['method']}"
            if record["error"]:
                found.said[f"{name} refused"] += 1
                continue
            upper = record["certified_cost"]
            exact = record["verdict"] == "CERTIFIED" and upper <= ATOL * scale(cost)
            bound, most = record["lower_bound"], most_of(cost, upper)
            claim = Claim(name, None, upper, bound, most, record["verdict"], exact)
            judge(found, cost, [claim])

    @property
    def cost(self) -> Cost:
        """What is judged."""
        scene = self.scene
        of = scene.judged(scene.cost)
        if len(self.nodes) < of.n:
            of = of.induced(self.nodes)
        return Cost(of, scene.cost)

    def _judge_name(self, found: Findings, document: dict[str, Any], cost: Cost) -> None:
        words = {"g2o": "g2o", "gtsam": "twice GTSAM", "chordal": "F", "rotations": "F"}
        wanted, title = words[cost.name], document["objective"]
        found.require(
            title.removeprefix("truncated cost").removeprefix(", ").startswith(wanted)
            or title == "truncated cost",
            f"the cost is called {title!r}, not {wanted}",
        )

    def _judge_held(self, found: Findings, poses: Poses | None) -> None:
        """Held nodes are where the file has them, relative to the first of them."""
        held = list(self.scene.constrained)
        if poses is None or len(held) < 2:
            return
        of = self.scene.of
        there = self.scene.near((of.R, of.t))
        true, own = (_from_first(x, held) for x in (there, poses))
        size = float(np.abs(of.t[held]).max(initial=1.0))
        if self.row["relative poses"] != "whole":
            size = np.inf
        off = max(np.abs(true[0] - own[0]).max(), np.abs(true[1] - own[1]).max() / size)
        found.require(off <= HELD, f"held nodes are off by {off:.3g}")

    def _judge_robust(self, found: Findings, document: dict[str, Any], poses: Poses) -> None:
        """The kept measurements are solved, and the choice is the best of all."""
        scene = self.scene
        of, whole = scene.judged(scene.cost), self.cost
        rejected = self.chosen = [one["edge"] for one in document["solution"]["rejected"]]
        pairs = [one["ids"] for one in document["solution"]["rejected"]]
        edges, m = [*scene.of.edges.tolist(), *scene.of.pairs.tolist()], scene.of.m
        own = [list(map(scene.called, edges[e])) for e in rejected]
        found.require(own == pairs, f"rejected {pairs}, but measurements {rejected} are {own}")
        chosen = self._indices(of, rejected)
        near = np.delete(np.arange(len(of.pairs)), [e - m for e in rejected if e >= m])
        rest = of.subset(np.delete(np.arange(of.m), chosen))
        names = ("pairs", "distances", "precisions")
        rest = replace(rest, **{name: getattr(of, name)[near] for name in names})
        kept = Cost(rest, scene.cost)
        best = judge(found, kept, [self._claim("kept", document, kept, poses)])
        self._judge_proof(found, kept, best if not rejected else None)
        if self.row["covariances"] == "asked":
            self._judge_covariances(found, kept, poses)
        said = document["solution"]["rejection"]
        if rejected and said is not None:
            prices = np.array(said["prices"])
            said = {**said, "tolerance": most_of(whole, said["cost"])}
            outputs.judge_rejection(found, "robust", whole, chosen, prices, poses, said)


def _in_world(poses: Poses) -> Poses:
    """As seen from the last node."""
    R, t = poses
    return R[-1].T @ R, (t - t[-1]) @ R[-1]


def _from_first(poses: Poses, nodes: list[int]) -> Poses:
    R, t = poses[0][nodes], poses[1][nodes]
    return R[0].T @ R, (t - t[0]) @ R[0]


def _judge_arrays(
    rng: np.random.Generator, found: Findings, scene: Scene, rule: Rule | None
) -> None:
    """Judge the library's answers about arrays."""
    try:
        _answered(found, scene)
    except CertPGOError as error:
        if rule is None:
            found.false.append(f"refused: {error}")
        else:
            _judge_refusal(found, str(error), rule, scene.row)


def _answered(found: Findings, scene: Scene) -> None:
    row, instance = scene.row, scene.instance
    cost = Cost(scene.judged(scene.cost), scene.cost)
    how: dict[str, Any] = {"cost": None if row["cost"] == "own" else row["cost"]}
    if row["proof"] == "tier":
        how["tier"] = "proof"
    if row["command"] == "solve":
        asked = certpgo.solve_robustly if row["outliers"] == "robust" else certpgo.solve
        answer = asked(instance, time_limit=SECONDS, **how)
        kept = np.delete(np.arange(scene.of.m), answer.solution.rejected)
        known = cost if len(kept) == scene.of.m else Cost(cost.of.subset(kept), cost.name)
        judge(found, known, [Claim.of("arrays", answer.certificate, answer.estimate)])
        return
    _, poses = cost.descent((cost.of.R, cost.of.t))
    given = Estimate(*poses)
    if row["rejected"] == "listed":
        return
    certificate = certpgo.certify(instance, given, time_limit=SECONDS, **how)
    best = [poses_of(certificate.best)]
    judge(found, cost, [Claim.of("arrays", certificate, given)], best)


def _judge_law(
    rng: np.random.Generator, found: Findings, scene: Scene, answer: Asking, rule: Rule | None
) -> None:
    """The same in other words has the same cost and verdict; with a rule it may be refused."""
    law = scene.row["law"]
    if scene.row["command"] != "solve":
        return
    other = {
        "names": lambda: scenes.renamed(scene, rng),
        "unit": lambda: scenes.scaled(scene),
        "frame": lambda: scenes.turned(scene, rng),
    }[law]()
    with tempfile.TemporaryDirectory() as folder:
        again = Asking(rng, other, Path(folder)).answer()
        said = again.told.refusal
        if rule is not None and said is not None and "no covariances" not in said:
            _judge_refusal(found, said, rule, again.row)
            return
        again.judge(found)
        if found.false or {answer.told.refusal, again.told.refusal} != {None}:
            return
        if answer.chosen != again.chosen:  # robust choices are no optima of all
            return
        rounding = 8.0 * answer.cost.rounding((scene.of.R, scene.of.t))
        if max(answer.value, again.value) <= rounding + answer.cost.exact((scene.of.R, scene.of.t)):
            return
        slack = ALIKE * answer.value + rounding
        said = f"{law}: {answer.verdict} {answer.value!r}, then {again.verdict} {again.value!r}"
        # What a bound that proves no estimate reaches is not the same to rounding.
        loose = {answer.verdict, again.verdict} <= {"BOUNDED", "UNDECIDED"}
        alike = loose or answer.verdict == again.verdict
        same = abs(answer.value - again.value) <= slack and alike
        found.require(same or answer.limited or again.limited, said)
