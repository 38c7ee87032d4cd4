"""Proof files: a certificate for a graph file, verified by `certpgo.checker`.

An .npz archive without pickles. Its layout, with b = d for rotations alone and d + 1 for poses;
nodes are those of the edges, by ascending id:

    claim         JSON as bytes: the graph file and its reading options (see `claim_and_graph`)
    rotations     (n, 4) quaternions x y z w of any norm, or (n, 2) half-angle pairs cos sin
    translations  (n, d); absent for rotations alone
    multipliers   (n, d (d + 1) / 2) upper triangles of Lam', row by row
    order         (n,) int32, elimination order of the nodes
    delta         (n b,) float32, subtracted from the equilibrated diagonal before factorizing

Points have rotations, zero multipliers and delta like all nodes; the world is the last node.

That is version 1, about F. Version 2, about g2o's cost, also has the arrays of
``EdgeBounds`` in `certpgo.checker`, a row per edge. Version 3, about the truncated F, has a row per
rejected edge:

    rejected      (k,) int32, which edges, ascending
    rejections    (k, 2 + d^2) price, weight beta_R and centre; for poses also beta_t and its centre

Version 4 is about similarities, in a g2o file or an .npz file, and has the estimate's

    scales        (n,), 1 where known

Where an .npz file has distances, their tangents are those of ``with_tangents`` in the checker:

    tangents      (k, 2) weight and constant of each

The claim of any but version 4 may say how far optima are, as ``within``: then the pose that is
pinned is eliminated last.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from certpgo import checker
from certpgo.errors import FormatError, InputError, NumericalError, require_path
from certpgo.graph import Graph, Instance
from certpgo.graph.held import HELD
from certpgo.graph.kinds import places_world
from certpgo.graph.ranges import Ranges
from certpgo.io.compressed import is_compressed
from certpgo.io.format import format_of
from certpgo.io.pipes import readable
from certpgo.objective import choose_cost as costs

#: Formats that the checker can read, of poses and of similarities, and what they are called.
FORMATS = {False: ("g2o", "1dsfm", "npz"), True: ("sim3", "npz")}
CALLED = {False: "a g2o, .npz or 1DSfM file", True: "a g2o or .npz file"}


class RefusedProof(NumericalError, checker.Refused):  # noqa: N818 - the condition is the name
    """A proof is not valid for its file."""


class UnreadableProof(InputError, checker.Unreadable):  # noqa: N818 - the condition is the name
    """A proof or its graph file cannot be read."""


def check(graph_path: str | Path, proof_path: str | Path) -> checker.Answer:
    """Check a proof about a graph file, by `certpgo.checker`, which works without the package too.

    Parameters
    ----------
    graph_path : g2o or 1DSfM text, with the SHA-256 given in the proof
    proof_path : a file by `certpgo.write_proof`, or from any other source

    Raises
    ------
    NumericalError
        The proof is not valid for this file; it is also a ``certpgo.checker.Refused``.
    InputError
        One of the files cannot be read; it is also a ``certpgo.checker.Unreadable``.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> certpgo.write("helix.g2o", helix(3, np.random.default_rng(0)))
    >>> instance = certpgo.read("helix.g2o")
    >>> result = certpgo.solve(instance, cost="chordal")
    >>> proven = instance, result.estimate, result.certificate
    >>> _ = certpgo.write_proof("helix.cert", "helix.g2o", *proven)
    >>> print(certpgo.check("helix.g2o", "helix.cert"))
    PROVED: F(x) <= ..., F* >= ..., relative gap <= ...
    """
    require_path(graph_path, "a graph")
    require_path(proof_path, "a proof")
    try:
        return checker.check(graph_path, proof_path)
    except checker.Refused as reason:
        raise RefusedProof(str(reason)) from None
    except checker.Unreadable as reason:
        raise UnreadableProof(str(reason)) from None


def provable(source: str | Path, instance: Instance, cost: str | None = None) -> Path:
    """The path of a file from which the checker can read the instance, before any work.

    Parameters
    ----------
    source : the file that the instance was read from
    cost : the name of the cost that the proof is to be about; by default it is not tried

    Raises
    ------
    InputError
        The checker cannot read the file, or knows nothing of what is measured, or rotations alone
        have priors.
    """
    path = Path(source)
    form, similar = format_of(path).name, instance.graph.has_scales
    if form not in FORMATS[similar]:
        said = f"{path}: a proof is about {CALLED[similar]}, not {form}"
        raise InputError(f"{said}; convert it first (certpgo convert)")
    if not path.is_dir() and is_compressed(path):
        raise InputError(f"{path}: a proof is about a plain file: decompress it first (gunzip)")
    graph, chosen = instance.graph, {"fixed", "also", "weights_are"} & {*instance.options}
    unusual = graph.is_partial or bool(chosen or _map_of(instance))
    unusual |= graph.information is not None and bool(graph.information.is_partial.any())
    # Other files are read by both alike, and only once that is needed.
    if cost is not None and (unusual or form == "npz"):
        claim_and_graph(path, instance, None if cost == costs.CHORDAL else cost)
    return path


def claim_of(source: Path, instance: Instance, cost: str | None = None) -> dict[str, Any]:
    """What a proof about an instance claims to be about, without pin and exponent.

    Parameters
    ----------
    source, cost : as of `provable`; None for F

    Raises
    ------
    InputError
        A proof cannot be about it.
    """
    return claim_and_graph(source, instance, cost)[0]


def claim_and_graph(
    source: Path, instance: Instance, cost: str | None = None
) -> tuple[dict[str, Any], checker.Graph]:
    """The subject of the proof (hashes, kind, reading options), and the graph the checker reads."""
    similar = instance.graph.has_scales
    archived = format_of(source).name == "npz"
    if not instance.graph.has_positions and (archived or _map_of(instance)):
        said = "a proof about rotations alone is of a text file, without priors (--no-priors)"
        raise InputError(f"{instance.source}: {said}")
    for block in instance.graph.blocks:
        if similar or type(block) is not Ranges:
            raise InputError(f"{source}: a proof is not about measured {block.kind.plural}")
    # What an archive says of options is how its numbers came about: they are read as they are.
    options = {} if archived else instance.options
    if (stated := options.get("weights_are", "information")) != "information":
        said = f"a proof is about a file of information matrices, and {source} is read as {stated}"
        raise InputError(f"{said}: certpgo convert writes a g2o file with information matrices")
    if "also" in options:
        said = "a proof is about one file: certpgo convert with --also writes one of all"
        raise InputError(f"{source}: {said}")
    if options.get("fixed") == HELD or instance.released is not None:
        said = "the checker holds no nodes that a file fixes: certpgo convert --constraints writes"
        raise InputError(f"{said} an .npz file that does; certpgo solve --no-fixed releases them")
    file = source / "EGs.txt" if source.is_dir() else source
    component = file.with_name("cc.txt")
    restricted = file.name == "EGs.txt" and component.is_file()
    text, members = readable(file).read_bytes(), component.read_bytes() if restricted else None
    kappa, tau = _overridden(options.get("weights", "file"))
    posed = "similarities" if similar else "poses"
    claim = {
        "format": "certpgo proof",
        "version": 4 if similar else 1,
        "graph_sha256": hashlib.sha256(text).hexdigest(),
        "component_sha256": None if members is None else hashlib.sha256(members).hexdigest(),
        "kind": posed if instance.graph.has_positions else "rotations",
        "d": instance.graph.d,
        "keep": options.get("keep", "all"),
        "rotation_information": options.get("rotation_information", "tangent"),
        "kappa": kappa,
        "tau": tau,
        **({} if similar or archived else _map_of(instance)),
        **({} if archived else _placed(instance.graph)),
    }
    if cost is not None:
        meant = costs.COSTS[cost].rotation_information if instance.graph.d == 3 else "tangent"
        claim |= {"version": 2, "cost": cost, "rotation_information": meant}
    try:
        graph = checker.read_graph(text, claim, members)
    except checker.Unreadable as error:
        raise FormatError(file, None, f"the checker cannot read it: {error}") from None
    if graph.n != instance.graph.num_nodes:
        said = f"a proof is about a whole file: {source} connects {graph.n} nodes, the graph has"
        n = instance.graph.num_nodes
        raise InputError(f"{said} {n}; write that part to a file of its own")
    if len(graph.i) != instance.graph.num_edges:
        said = f"the checker reads {len(graph.i)} measurements, the graph has"
        raise InputError(f"{source}: {said} {instance.graph.num_edges}")
    if (similar or archived) and not _is_read(graph, instance.graph):
        said = "the graph is not that of the file: write it to an .npz file of its own"
        raise InputError(f"{source}: {said}")
    return claim, graph


def _is_read(exact: checker.Graph, graph: Graph) -> bool:
    """Whether the checker reads this graph, but for rounding."""
    m, R = graph.num_edges, np.ldexp(exact.R.astype(np.float64), -checker.POINT)
    scales = np.ones(m) if exact.scales is None else exact.scales
    free = np.zeros(graph.num_nodes, dtype=bool) if exact.free is None else exact.free
    arms = np.zeros_like(exact.t) if exact.arms is None else exact.arms
    measured = exact.t, scales, exact.tau, R, arms
    own = graph.translations, graph.scales, graph.tau, graph.rotations, graph.own_arms
    # Terms of couplings are 2 d kappa - 2 <N, Q> there.
    weights = exact.kappa, np.trace(graph.polar[1], axis1=1, axis2=2) / graph.d
    coupled: list[tuple[Any, Any]] = [] if exact.N is None else [(exact.N, graph.couplings)]
    if (ranges := graph.ranges) is not None and exact.ranges is not None:
        of = exact.ranges
        coupled += [(np.stack([of.i, of.j], axis=1), ranges.edges)]
        coupled += [(of.distances, ranges.distances), (of.weights, ranges.weights)]
    return (
        (exact.ranges is None) == (ranges is None)
        and np.array_equal(np.stack([exact.i, exact.j], axis=1), graph.edges)
        and np.array_equal(np.array([free, ~exact.poses]), np.array([graph.free, graph.is_point]))
        and (exact.N is None) == (graph.couplings is None)
        and all(
            np.allclose(*pair, 1e-12, 1e-12)
            for pair in [*zip(measured, own, strict=True), weights, *coupled]
        )
    )


def _map_of(instance: Instance) -> dict[str, Any]:
    """What the claim says of landmarks and priors; nothing if there are none."""
    said: dict[str, Any] = {}
    if instance.graph.is_point.any():
        said["landmarks"] = True
    if instance.world is not None:
        origin = instance.origin
        said |= {"priors": True, "origin": None if origin is None else origin.tolist()}
    return said


def _placed(graph: Graph) -> dict[str, float]:
    """The weight of the edge that puts a world somewhere; nothing without one."""
    placing = graph.tau[places_world(graph)]
    return {"placing": float(placing[0])} if len(placing) else {}


def _overridden(weights: str) -> tuple[float | None, float | None]:
    """Kappa and tau of the reading option ``weights``; None for the file's."""
    if weights == "mahalanobis":
        raise InputError("proof files are about kappa and tau, not about Mahalanobis weights")
    if weights in ("file", "unit"):
        return (None, None) if weights == "file" else (1.0, 1.0)
    if "=" not in weights:  # of a synthetic graph
        raise InputError("a proof is about the instance that was read from the file")
    said = dict(part.split("=") for part in weights.split(","))
    kappa, tau = (None if said[k] == "file" else float(said[k]) for k in ("kappa", "tau"))
    return kappa, tau


def arrays_of(proof: checker.Proof) -> dict[str, Any]:
    """The arrays of a proof file, but for the claim."""
    arrays = {
        "rotations": proof.q,
        "multipliers": proof.multipliers,
        "order": proof.order.astype("<i4"),
        "delta": proof.delta.astype("<f4"),
    }
    optional = {"translations": proof.t, "scales": proof.s, "tangents": proof.tangents}
    arrays |= {name: array for name, array in optional.items() if array is not None}
    if proof.minorants is not None:
        arrays |= proof.minorants._asdict()
    if (cut := proof.rejections) is not None:
        k = len(cut.prices)
        columns = [cut.prices, cut.kappa, cut.centres.reshape(k, -1)]
        if proof.t is not None:
            columns += [cut.tau, cut.arms]
        arrays |= {"rejected": cut.rejected.astype("<i4"), "rejections": np.column_stack(columns)}
    return arrays
