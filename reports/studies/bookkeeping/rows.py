"""One row of the covering array: a graph with these features, asked about, and judged."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import CertPGOError, Estimate
from reports.studies.bookkeeping import scenes
from reports.studies.bookkeeping.asking import Told, read_poses, told
from reports.studies.bookkeeping.covering import Rule
from reports.studies.bookkeeping.drawing import Array, turns
from reports.studies.bookkeeping.judging import (
    ATOL,
    RTOL,
    Claim,
    Findings,
    judge,
    poses_of,
    scale,
)
from reports.studies.bookkeeping.oracle import Cost, Poses
from reports.studies.bookkeeping.scenes import Scene

#: Relative difference of costs between a graph and the same one in other words.
ALIKE = 1e-6
#: How far held nodes may be from where they are held, over the extent of positions.
HELD = 1e-7
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
        if rule is not None and said is not None:
            _judge_refusal(found, said, rule)
            return
        answer.judge(found)
        if row["law"] != "none" and not found.false:
            _judge_law(rng, found, scene, answer)


def _judge_refusal(found: Findings, said: str, rule: Rule) -> None:
    found.said["refused"] += 1
    found.require(re.search(rule.said, said), f"{dict(rule.levels)}: {said}")


def _refusing(error: CertPGOError) -> Told:
    """An error of the library, as a command says it."""
    return Told(1, "", f"certpgo: {error}")


class Asking:
    """A question to a command, and its answer."""

    def __init__(self, rng: np.random.Generator, scene: Scene, folder: Path) -> None:
        self.rng, self.scene, self.row, self.folder = rng, scene, scene.row, folder
        self.given: Poses | None = None
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
        if row["files"] == "also" or (row["command"] == "certify" and len(paths) > 1):
            begin += [paths[0]]
            rest: list[str | Path] = []
            for path in paths[1:]:
                rest += ["--also", path]
        else:
            begin += paths
            rest = []
        if row["command"] == "certify":
            begin.append(self._estimate())
        else:
            rest += ["-o", self.out]
        rest += scene.options
        if row["cost"] != "own":
            rest += ["--cost", row["cost"]]
        if row["outliers"] == "robust":
            rest.append("--robust")
        if row["rejected"] == "listed":
            rest += ["--rejected", self._listed()]
        if row["truth"] == "given":
            rest += ["--truth", self._poses("truth", self._moved(), self._known)]
        if row["times"] == "given":
            pass
        self.proof = self.folder / "proof.cert"
        if row["proof"] == "tier":
            rest += ["--tier", "proof"]
        if row["proof"] in ("file", "integers"):
            rest += ["--proof", self.proof]
        if row["covariances"] == "asked":
            rest += ["--covariances", self.folder / "covariances.csv"]
        if row["limit"] == "short":
            rest += ["--time-limit", repr(float(10.0 ** self.rng.uniform(-3.0, -1.5)))]
        else:
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

    def _moved(self) -> Poses:
        """The truth in another frame."""
        return self.scene.of.R, self.scene.of.t

    def _estimate(self) -> Path:
        """The file that is to be certified."""
        of, scene = self.scene.of, self.scene
        kind = float(self.rng.random())
        poses = (of.R, of.t)
        cost = Cost(scene.judged(scene.cost), scene.cost)
        if kind < 0.6:
            _, poses = cost.descent(poses)
        elif kind < 0.8 and not scene.constrained:
            n = int((~of.points).sum()) - of.world
            R, t = of.R.copy(), of.t.copy()
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
        return self._poses("given", poses, nodes)

    def _listed(self) -> Path:
        """The table of rejected measurements."""
        chosen = list(self.scene.wrong) or [self.scene.of.m - 1]
        self.rejected = chosen
        path = self.folder / "rejected.csv"
        lines = ["edge,i,j,price"]
        for e in chosen:
            i, j = map(self.scene.called, self.scene.of.edges[e].tolist())
            lines.append(f"{e},{i},{j},20.0")
        path.write_text("\n".join(lines) + "\n")
        return path

    def judge(self, found: Findings) -> None:
        """Judge the answer."""
        said = self.told
        name = self.row["command"]
        if said.refusal is not None:
            found.said[f"{name} refused"] += 1
            found.false.append(f"refused: {said.refusal}")
            return
        found.require("Traceback" not in said.complaint, said.complaint[-300:])
        if said.code == 6 and "note: no proof was written" in said.complaint:
            found.said["proof refused"] += 1
        elif said.code not in (0, 3, 4, 5):
            found.false.append(f"exit {said.code}: {said.complaint[-300:]}")
            return
        document = said.json
        verdict = document["verdict"]
        self.limited = document.get("solution", {}).get("status") == "time limit"
        codes = {"CERTIFIED": 0, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}
        found.require(said.code in (codes[verdict], 6), f"{verdict}, but exit {said.code}")
        self.verdict, self.value = verdict, document["cost"]
        cost = self.cost
        poses = self.given
        if name == "solve":
            poses = read_poses(self.out, self.scene.of)
            found.require(poses is not None, f"{self.out.name}: nodes are missing")
            if poses is None:
                return
        self._judge_name(found, document, cost)
        if document["certificate"]["broken"]:  # a search that was stopped moves what is held
            found.said["held poses are not held"] += 1
            return
        self._judge_held(found, poses)
        if self.row["rejected"] != "none":
            return
        if name == "solve" and self.row["outliers"] == "robust":
            self._judge_robust(found, document, poses)
            return
        part = (poses[0][self.nodes], poses[1][self.nodes])
        claim = _claim(name, document, part)
        if self.scene.constrained:  # W counts constraints, too
            claim = replace(
                claim, tolerance=min(claim.tolerance, RTOL * claim.upper + ATOL * scale(cost))
            )
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
        true, own = (_from_first(x, held) for x in ((of.R, of.t), poses))
        size = float(np.abs(of.t[held]).max(initial=1.0))
        if self.row["relative poses"] != "whole":
            size = np.inf
        off = max(np.abs(true[0] - own[0]).max(), np.abs(true[1] - own[1]).max() / size)
        found.require(off <= HELD, f"held nodes are off by {off:.3g}")

    def _judge_robust(self, found: Findings, document: dict[str, Any], poses: Poses) -> None:
        """The kept measurements are solved, and the wrong one is not among them."""
        of, scene = self.scene.judged(self.scene.cost), self.scene
        rejected = [one["edge"] for one in document["solution"]["rejected"]]
        pairs = [one["ids"] for one in document["solution"]["rejected"]]
        if scene.constrained:
            return
        own = [list(map(scene.called, of.edges[e].tolist())) for e in rejected]
        found.require(own == pairs, f"rejected {pairs}, but measurements {rejected} are {own}")
        kept = of.subset(np.delete(np.arange(of.m), rejected))
        judge(found, Cost(kept, scene.cost), [_claim("kept", document, poses)])


def _claim(name: str, document: dict[str, Any], poses: Poses | None) -> Claim:
    c = document["certificate"]
    return Claim(
        name, poses, c["cost_upper"], document["lower_bound"], c["tolerance"], document["verdict"]
    )


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
            _judge_refusal(found, str(error), rule)


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
    _, poses = cost.descent((scene.of.R, scene.of.t))
    given = Estimate(*poses)
    if row["rejected"] == "listed":
        return
    certificate = certpgo.certify(instance, given, time_limit=SECONDS, **how)
    best = [poses_of(certificate.best)]
    judge(found, cost, [Claim.of("arrays", certificate, given)], best)


def _judge_law(rng: np.random.Generator, found: Findings, scene: Scene, answer: Asking) -> None:
    """The same in other words has the same cost and verdict."""
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
        again.judge(found)
        if found.false:
            return
        slack = ALIKE * answer.value + 8.0 * answer.cost.rounding((scene.of.R, scene.of.t))
        said = f"{law}: {answer.verdict} {answer.value!r}, then {again.verdict} {again.value!r}"
        same = abs(answer.value - again.value) <= slack and answer.verdict == again.verdict
        found.require(same or answer.limited or again.limited, said)
