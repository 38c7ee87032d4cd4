"""The package's reader against the checker's own, on the same mutated g2o files."""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo import CertPGOError, Instance, checker
from reports.studies.bookkeeping.drawing import draw, read_bytes
from reports.studies.bookkeeping.judging import Findings
from reports.studies.fuzz_readers import MUTATIONS

#: Entries of rotations: both are within rounding of the same.
SAME = 1e-14
#: What may stand for a word, a tag, after a line, or between two.
SPELLINGS = tuple(b"%e0|+%|%.0|0%|%0|-%|%\t| %|%E-3|.%|%f|%_0".split(b"|"))
TAGS = (
    b"EDGE_SE2 EDGE_SE3:QUAT EDGE_PRIOR_SE2 EDGE_SE2_PRIOR EDGE_PRIOR_SE2_XY EDGE_SE2_GPS "
    b"EDGE_SE3_PRIOR EDGE_SE3_XYZPRIOR EDGE_SE2_XY LANDMARK2 EDGE_SE3_TRACKXYZ VERTEX_SE2 "
    b"VERTEX_XY VERTEX_SE3:QUAT VERTEX_TRACKXYZ FIX # PARAMS_SE3OFFSET edge_se2"
).split()
ENDS = (b"# said", b"#", b"0", b"1 2", b"\r", b"\t")
LINES = b"""
FIX 0
FIX 0 1
# EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1
PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
PARAMS_SE3OFFSET 0 1 0 0 0 0 0 1
PARAMS_SE3OFFSET 1 0 0 0 0 0 0 -2
VERTEX_SE2 0 0 0 0
VERTEX_XY 7 0 0
VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1
LANDMARK2 0 0 1 2 1 0 1
LANDMARK2 0 9 1 2 1 0 1
EDGE_SE2 0 9 1 2 3
EDGE_SE2 0 0 1 2 3 1 0 0 1 0 1
EDGE_SE3:QUAT 0 9 1 2 3 0 0 0 2
EDGE_BEARING_SE2_XY 0 1 2 3
EDGE_SE2_GPS 0 1 2""".split(b"\n")


def judge(rng: np.random.Generator, found: Findings) -> None:
    """Both read the same measurements, or one refuses."""
    text = draw(rng, nodes=(2, 5)).text.encode()
    for _ in range(int(rng.integers(0, 4))):
        text = respelled(rng, text)
    if rng.random() < 0.4:
        choices = MUTATIONS["text"]
        text = choices[int(rng.integers(len(choices)))](rng, text)
    options: dict[str, Any] = {"keep": str(rng.choice(["all", "all", "first", "last"]))}
    if rng.random() < 0.2:
        options["rotation_information"] = "quaternion"
    if rng.random() < 0.1:
        options["kappa"] = 2.0
    if rng.random() < 0.1:
        options["tau"] = 3.0
    try:
        instance = read_bytes(text, **options)
    except CertPGOError as error:
        found.said[f"read refused: {type(error).__name__}"] += 1
        found.require("\n" not in str(error), f"read: a message of several lines: {error}")
        return
    if not instance.graph.is_connected:  # the checker knows no nodes without measurements
        found.said["not connected"] += 1
        return
    for cost in (None, "g2o"):
        compare(found, text, instance, options, cost)


def respelled(rng: np.random.Generator, text: bytes) -> bytes:
    """Another text that may mean the same, or other measurements of the same form."""
    lines = text.split(b"\n")
    place = int(rng.integers(len(lines)))
    words = lines[place].split(b" ")
    word = int(rng.integers(len(words)))
    choice = int(rng.integers(8))
    if choice == 0:
        words[word] = bytes(rng.choice(SPELLINGS)).replace(b"%", words[word])
    elif choice == 1:
        other = lines[int(rng.integers(len(lines)))].split(b" ")
        words[word] = other[word % len(other)]
    elif choice == 2:
        words = words[: int(rng.choice([5, 6, 9, 10, 11]))]  # without information, perhaps
    elif choice == 3:
        words[0] = bytes(rng.choice(TAGS))
    elif choice == 4:
        words += [bytes(rng.choice(ENDS))]
    elif choice == 5:
        lines.insert(place, lines[int(rng.integers(len(lines)))])
    elif choice == 6:
        lines.insert(place, bytes(rng.choice(LINES)))
    else:
        return text.replace(b"\n", bytes(rng.choice([b"\r\n", b"\n\n", b" \n", b"\t\n"])))
    lines[place] = b" ".join(words) if choice < 5 else lines[place]
    return b"\n".join(lines)


def compare(
    found: Findings, text: bytes, instance: Instance, options: dict[str, Any], cost: str | None
) -> None:
    """Compare what was read with what the checker reads for a proof about it."""
    graph = instance.graph
    poses = graph.has_positions
    rotation = graph.rotations_alone if graph.has_positions else graph
    if cost is not None and (instance.graph.information is None or not poses):
        return
    claim = {
        "d": graph.d,
        "keep": options["keep"],
        "rotation_information": options.get("rotation_information", "tangent"),
        "kappa": options.get("kappa"),
        "tau": options.get("tau"),
        "landmarks": poses and bool(graph.is_point.any()),
        "priors": instance.world is not None,
        "origin": None if instance.origin is None else instance.origin.tolist(),
    }
    if cost is not None:
        claim |= {"cost": cost, "rotation_information": "quaternion" if graph.d == 3 else "tangent"}
    name = f"checker, {cost or 'chordal'}"
    try:
        other = checker.read_graph(text, claim, None)
    except (checker.Unreadable, checker.Refused) as error:
        found.said[f"{name} refused"] += 1
        found.require("\n" not in str(error), f"{name}: a message of several lines")
        return
    found.said[f"{name}: both read it"] += 1
    pairs = np.stack([other.i, other.j], axis=1)
    if (other.n, pairs.tolist()) != (graph.num_nodes, graph.edges.tolist()):
        found.false.append(f"{name}: {other.n} nodes, edges {pairs.tolist()}")
        return
    seen = graph.is_point if graph.has_positions else None
    seen = np.zeros(other.n, bool) if seen is None else seen
    theirs = np.zeros(other.n, bool) if other.points is None else other.points
    found.require((seen == theirs).all(), f"{name}: other points")
    if graph.has_positions:
        found.require((other.t == graph.translations).all(), f"{name}: other translations")
        if cost is None:
            found.require((other.tau == graph.tau).all(), f"{name}: other tau")
    if cost is None:
        found.require((other.kappa == rotation.kappa).all(), f"{name}: other kappa")
        R = (np.array(other.R, dtype=object) / 2**checker.POINT).astype(float)
        off = np.abs(R - rotation.rotations).max()
        found.require(off <= SAME, f"{name}: rotations differ by {off:.3g}")
    elif graph.information is not None:
        same = (other.information == graph.information_matrices).all()
        found.require(same, f"{name}: other information")
