"""Findings of a graph and its weights as they stand, without a search."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.meanings import orders
from certpgo.graph import Graph, Instance
from certpgo.graph.phrases import counted, few
from certpgo.linalg.arrays import BoolArray, FloatArray

#: A weight is stiff that is this many times the next smaller one.
STIFF = 1e6
#: Strength of an order with which all matrices are definite.
STRONG = 2.0


def cause_in_structure(instance: Instance) -> Finding | None:
    """The strongest finding of the graph and its weights; None if there is none."""
    order = undefined(instance.graph)
    found = [*apart(instance), *stiff(instance), *([] if order is None else [order])]
    return max(found, key=lambda one: one.strength, default=None)


def apart(instance: Instance) -> Iterator[Finding]:
    """That no measurement joins some nodes to the others, or that all are held."""
    measured = instance.measurements
    sizes = sorted(measured.component_sizes, reverse=True)
    alone = np.flatnonzero(np.bincount(measured.edges.ravel(), minlength=len(instance.ids)) == 0)
    if len(alone):
        nodes = counted(len(alone), "node{s}")
        named = few(instance.ids[alone].tolist())
        yield Finding(
            "unmeasured-nodes",
            f"nothing measures {nodes} ({named})",
            "leave them out, or add what measures them",
            strength=1.0,
            proven=True,
        )
    fixed = len(instance.fixed) > 1 and not instance.held
    if fixed and np.isin(measured.edges, instance.fixed).all():
        nodes = few(instance.ids[list(instance.fixed)].tolist())
        yield Finding(
            "all-held",
            f"the file fixes nodes {nodes}, and all measurements are between them: held, they "
            "leave nothing to be estimated",
            "fix one node alone, or release all: --no-fixed",
            strength=2.0,
            proven=True,
        )
    parts = [size for size in sizes if size > 1]
    if len(parts) > 1:
        yield Finding(
            "components",
            f"the graph is in {len(parts)} parts that no measurement joins, of {few(parts)} nodes",
            "add measurements between them, or take each alone: --components each, or largest",
            strength=1.5,
            proven=True,
        )


def stiff(instance: Instance) -> Iterator[Finding]:
    """Measurements whose weights are beyond all others by many orders."""
    graph, measured = instance.graph, instance.is_measured
    for weights, of in ((graph.tau, "1/m^2"), (graph.kappa, "1/rad^2")):
        rows = np.flatnonzero((weights > 0.0) & measured)
        rows = rows[np.argsort(weights[rows], kind="stable")]
        steps = weights[rows[1:]] / weights[rows[:-1]]
        if not len(steps) or not steps.max() > STIFF:
            continue
        first = int(np.argmax(steps)) + 1
        if len(rows) - first > first:
            continue
        heavy, others = rows[first:], rows[:first]
        names = ", ".join(f"{i}-{j}" for i, j in instance.pairs[heavy[:4]].tolist())
        most, rest = weights[heavy].max(), weights[others].max()
        verb = "weighs" if len(heavy) == 1 else "weigh"
        said = (
            f"{counted(len(heavy), 'measurement{s}')} ({names}{', ...' if len(heavy) > 4 else ''}) "
            f"{verb} up to {most:.3g} {of}, all others at most {rest:.3g}: rounding of "
            "such weights hides errors of the others"
        )
        edges = tuple(instance.known_numbers[heavy].tolist())
        next = f"use weights of at most {rest * STIFF:.1g}, or hold the nodes fixed"
        yield Finding("stiff-edge", said, next, strength=0.5, edges=edges)
        return


def undefined(graph: Graph, trying: Callable[[str], None] = lambda _: None) -> Finding | None:
    """An order with which all matrices are definite, where some are not as they are read.

    Parameters
    ----------
    trying : is called with the kind of each order that is tried
    """
    if graph.information is None:
        return None
    rows = np.flatnonzero(whole_poses(graph) | _of_poses(graph))
    used, index = np.unique(graph.information.index[rows], return_inverse=True)
    distinct = graph.information.distinct[used]
    given = _positive(distinct)
    if given.all():
        return None
    for order in orders(graph.d):
        trying(order.kind)
        if _positive(order.read(distinct)).all():
            bad = int((~given)[index].sum())
            what = "information matrix" if bad == 1 else "information matrices"
            said = (
                f"{bad} {what} of {len(rows)} are not positive definite as read; all are if they "
                f"{order.said}"
            )
            return Finding(order.kind, said, order.next, strength=STRONG)
    return None


def whole_poses(graph: Graph) -> BoolArray:
    """(m,) which edges measure a pose relative to another one."""
    found = graph.measures_rotation & graph.is_measured[: graph.num_edges]
    if graph.has_positions:
        found = found & graph.measures_translation
    return np.asarray(found if graph.absolute is None else found & ~graph.absolute)


def _of_poses(graph: Graph) -> BoolArray:
    """(m,) which edges were read with matrices of poses, also if a block of these is zero."""
    seen = graph.is_point[graph.edges].any(axis=1) | graph.from_world
    return np.asarray(~seen & graph.is_measured)


def _positive(M: FloatArray) -> BoolArray:
    """(k,) which matrices have positive eigenvalues, whatever the units of their entries."""
    scale = np.sqrt(np.abs(np.einsum("kaa->ka", M)))
    unit = np.where(scale > 0.0, scale, 1.0)
    values = np.linalg.eigvalsh(M / (unit[:, :, None] * unit[:, None, :]))
    return np.asarray((values[:, 0] > 1e-9) & (scale > 0.0).all(axis=1))
