"""Sessions fed with a graph in random cuts, with removal, against batch and the oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from certpgo import CertPGOError, Instance, Session, solve
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import Claim, Findings, judge, standing
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Seconds for an answer, of those that climb.
LIMIT = 5.0


def judge_poses(rng: np.random.Generator, found: Findings) -> None:
    """Of poses and points."""
    _judge(rng, found, draw(rng, priors=0.0))


def judge_priors(rng: np.random.Generator, found: Findings) -> None:
    """With priors, that may be far from the origin; parts are read from files."""
    of = draw(rng, priors=1.0)
    if rng.random() < 0.3:
        far = of.edges[:, 0] == of.n - 1
        shift = np.round(10.0 ** rng.uniform(1, 4) * rng.standard_normal(of.d))
        known = np.arange(of.n) < of.n - 1
        of = replace(of, steps=of.steps + far[:, None] * shift, t=of.t + known[:, None] * shift)
    _judge(rng, found, of)


def judge_landmarks(rng: np.random.Generator, found: Findings) -> None:
    """With points whose numbers are also those of poses; parts are read from files."""
    of = draw(rng, d=2, points=1.0, priors=0.3)
    first = int(of.points.argmax())
    ids = np.r_[np.arange(first), 10**6 + np.arange(of.n - first)]
    _judge(rng, found, replace(of, ids=ids, apart=10**6))


def _judge(rng: np.random.Generator, found: Findings, of: Measurements) -> None:
    of = of.subset(growing(rng, of))
    cost = Cost(of, str(rng.choice(["chordal", "g2o", "gtsam"])))
    session = Session(cost=cost.name, every=int(rng.integers(1, 20)), time_limit=LIMIT)
    came: list[int] = []  # measurements by the session's numbers
    kept: list[int] = []  # numbers
    with found.refusals("session"):
        cuts = np.unique(rng.integers(1, of.m + 1, int(rng.integers(0, 5))))
        for part in np.split(np.arange(of.m), cuts[cuts < of.m]):
            session.add(part_of(rng, of, part))
            kept += range(len(came), len(came) + len(part))
            came += part.tolist()
            if rng.random() < 0.4:
                kept = _removed(rng, found, session, kept)
            if rng.random() < 0.3:
                judge_session(found, session, of_known(cost, [came[k] for k in kept]), "on the way")
        if rng.random() < 0.8:
            session.refresh()
        rest = of_known(cost, [came[k] for k in kept])
        judge_session(found, session, rest, "session")
        _judge_beside_batch(found, session, rest)


def _judge_beside_batch(found: Findings, session: Session, kept: Cost) -> None:
    """Judge the session's certificate, and `solve` of the same measurements."""
    batch = solve(kept.of.instance, cost=kept.name, time_limit=LIMIT)
    ours = Claim.of("certificate", session.certificate, poses_in(session, kept.of))
    theirs = Claim.of("batch", batch.certificate, batch.estimate)
    judge(found, kept, [ours, theirs])
    found.said[f"{ours.verdict} in a session, in batch {theirs.verdict}"] += 1
    if ours.verdict == theirs.verdict == "CERTIFIED":
        off = abs(ours.upper - theirs.upper)
        differ = f"session {ours.upper!r} and batch {theirs.upper!r} differ"
        found.require(off <= ours.tolerance + theirs.tolerance, differ)


def judge_session(found: Findings, session: Session, cost: Cost, name: str) -> None:
    """Judge where it stands on the measurements that it has."""
    s, of = session.standing, cost.of
    found.require(
        (s.nodes, s.edges) == (of.n, of.m),
        f"{name}: {s.nodes} nodes and {s.edges} measurements, but {of.n} and {of.m} were given",
    )
    x = poses_in(session, of)
    judge(found, cost, [standing(name, s, x)])


def of_known(cost: Cost, fed: Sequence[int]) -> Cost:
    """The cost of some measurements, of the nodes that they have."""
    part = cost.of.subset(np.array(fed))
    return Cost(part.induced(np.unique(part.edges)), cost.name)


def poses_in(session: Session, of: Measurements) -> Poses | None:
    """The session's estimate in the order of the measurements' nodes.

    None where its nodes are not those, or positions were moved to another origin.
    """
    places = {k: node for node, k in enumerate(of.ids[: of.n - of.world].tolist())}
    last = of.n - 1 if of.world else None
    nodes = [places.get(_id(label, of), last) for label in session.nodes]
    if sorted(nodes, key=str) != sorted(range(of.n), key=str) or _is_far(of):
        return None
    x, order = session.estimate, np.argsort(nodes)
    return x.rotations[order], x.translations[order]


def _id(label: object, of: Measurements) -> object:
    """Of a node; landmarks that are numbered apart have labels with a number."""
    number = getattr(label, "number", None)
    return label if number is None else of.apart + number


def _is_far(of: Measurements) -> bool:
    priors = of.world & (of.edges[:, 0] == of.n - 1)
    return bool(np.abs(of.steps[priors]).max(initial=0.0) > 8.0)


def growing(rng: np.random.Generator, of: Measurements) -> Array:
    """A random order in which each measurement has a node of those before it.

    Points and the world come when something else has determined the pose that knows of them.
    """
    left, order = list(rng.permutation(of.m)), []
    leaf = of.points.copy()
    leaf[of.n - of.world :] = True
    known: set[int] = set()
    while left:
        for edge in left:
            i, j = of.edges[edge].tolist()
            poses = [k for k in (i, j) if not leaf[k]]
            if not known or any(k in known for k in poses):
                break
        if not known and len(poses) < 2:
            left.append(left.pop(0))
            continue
        known |= {i, j}
        order.append(edge)
        left.remove(edge)
    return np.array(order)


def part_of(rng: np.random.Generator, of: Measurements, part: Array) -> Instance:
    """Some measurements on their own nodes; ``part`` takes the order that the reader gives them."""
    part[:] = sorted(part.tolist(), key=lambda e: _rank(of, e))
    sub = of.subset(part)
    sub = sub.induced(np.unique(sub.edges))
    prior = sub.world & (sub.edges[:, 0] == sub.n - 1)
    # A file has more than priors, and says which points are numbered apart.
    from_file = sub.apart or (not prior.all() and (sub.world or rng.random() < 0.3))
    return sub.read() if from_file else sub.instance


def _rank(of: Measurements, e: int) -> tuple[bool, bool]:
    return of.world and of.edges[e, 0] == of.n - 1, bool(of.points[of.edges[e, 1]])


def _removed(
    rng: np.random.Generator, found: Findings, session: Session, kept: list[int]
) -> list[int]:
    """The numbers that are left; a refusal leaves the session as it was."""
    before = session.standing, session.edges.tolist(), session.nodes
    gone = rng.choice(kept, min(len(kept), int(rng.integers(1, 3))), replace=False).tolist()
    try:
        session.remove(gone)
    except CertPGOError as error:
        found.said[f"remove refused: {type(error).__name__}"] += 1
        after = session.standing, session.edges.tolist(), session.nodes
        found.require(before == after, "a refused removal changed the session")
        return kept
    left = [number for number in kept if number not in gone]
    found.require(session.edges.tolist() == left, f"{left} are left, not {session.edges}")
    return left
