"""Graphs from their arrays: of rotations, of poses and points, of similarities."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral

import numpy as np

from certpgo.errors import InputError, require
from certpgo.graph.edges import flags_of_nodes, polar_factors
from certpgo.graph.graph import Graph
from certpgo.graph.information import Information
from certpgo.graph.kinds import Node
from certpgo.graph.observations import Observations
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: By default all measured scales are 1.
NONE = np.ones(0)


def RotationGraph(  # noqa: N802
    num_nodes: int,
    edges: IntArray,
    rotations: FloatArray,
    kappa: FloatArray,
    couplings: FloatArray | None = None,
) -> Graph:
    """A graph of relative rotations between nodes that have rotations alone.

    Parameters
    ----------
    num_nodes : number n of nodes, numbered 0 ... n-1
    edges, rotations, kappa, couplings : see `certpgo.Graph`

    Raises
    ------
    GraphError
        As `certpgo.Graph`.

    Examples
    --------
    Three nodes, each measured a quarter turn from the one before:

    >>> import numpy as np
    >>> from certpgo import RotationGraph
    >>> turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> edges = np.array([[0, 1], [1, 2], [2, 0]])
    >>> graph = RotationGraph(3, edges, np.array([turn] * 3), kappa=np.ones(3))
    >>> graph.num_edges, graph.d, graph.is_connected
    (3, 2, True)
    """
    require(num_nodes, Integral, "a number of nodes")
    nodes = np.full(max(int(num_nodes), 0), Node.ROTATION)
    shape = np.shape(rotations)
    m, d = (shape[0], shape[-1]) if len(shape) == 3 else (0, 0)
    return Graph(nodes, edges, rotations, kappa, np.zeros((m, d)), np.zeros(m), couplings)


def of_couplings(
    num_nodes: int, edges: IntArray, rotations: FloatArray, couplings: FloatArray
) -> Graph:
    """The graph of general edges; kappa is tr(K) / d, for methods that weigh by a number."""
    polar = polar_factors(np.asarray(couplings, dtype=np.float64))
    kappa = np.trace(polar[1], axis1=1, axis2=2) / couplings.shape[-1]
    graph = RotationGraph(num_nodes, edges, rotations, kappa, couplings)
    graph.__dict__["polar"] = polar
    return graph


def PoseGraph(  # noqa: N802
    rotation: Graph,
    translations: FloatArray,
    tau: FloatArray,
    arms: FloatArray | None = None,
    points: BoolArray | None = None,
    assumed: BoolArray | None = None,
    absolute: BoolArray | None = None,
    information: Information | None = None,
    blocks: tuple[Observations, ...] = (),
    *,
    is_signed: bool = False,
) -> Graph:
    """A graph of relative poses, and of points that poses see.

    Parameters
    ----------
    rotation : the graph of relative rotations
    points : (n,) which nodes are points, such as landmarks, rather than poses; None for none. Edges
        lead to points, have kappa = 0, and measure where the point is in the frame of node i
    translations, tau, arms, assumed, absolute, information, blocks, is_signed : see `certpgo.Graph`

    Raises
    ------
    GraphError
        As `certpgo.Graph`.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import PoseGraph, RotationGraph
    >>> turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> rotation = RotationGraph(4, edges, np.array([turn] * 4), kappa=np.ones(4))
    >>> graph = PoseGraph(rotation, np.array([[1.0, 0.0]] * 4), tau=np.full(4, 25.0))
    >>> graph.num_nodes, graph.translations.shape
    (4, (4, 2))
    """
    _require_rotations(rotation)
    given = None if points is None else flags_of_nodes("points", points, rotation.num_nodes)
    nodes = np.full(rotation.num_nodes, Node.POSE)
    if given is not None:
        nodes[given] = Node.POINT
    graph = Graph(
        nodes,
        rotation.edges,
        rotation.rotations,
        rotation.kappa,
        translations,
        tau,
        rotation.couplings,
        arms,
        NONE,
        assumed,
        absolute,
        information,
        blocks,
        is_signed=is_signed,
    )
    return rotation.sharing(graph, "polar", "components")


def SimilarityGraph(  # noqa: N802
    rotation: Graph,
    translations: FloatArray,
    tau: FloatArray,
    *,
    points: BoolArray | None = None,
    assumed: BoolArray | None = None,
    absolute: BoolArray | None = None,
    scales: FloatArray = NONE,
    free: BoolArray | None = None,
) -> Graph:
    """A graph of similarities: poses whose unit of length is unknown, as in monocular maps.

    A node's transform to the world is x -> A_i x + t_i, A_i = s_i R_i, and s_i is how many units of
    the world one of its own is: 1 for ordinary poses. An edge measures s_ij ~ s_j / s_i with R_ij,
    and t_ij in the unit of node i. Its term of the cost is

        kappa |A_j - s_ij A_i R_ij|_F^2 + tau |t_j - t_i - A_i t_ij|^2,

    in the world's unit; see docs/concepts/similarities.md. Points measure no scale.

    Parameters
    ----------
    points, translations, tau, assumed, absolute : as of `PoseGraph`
    scales : (m,) measured s_ij, positive; by default ones
    free : (n,) which poses have an unknown scale; by default all. Then the unit of the map is the
        root mean square of the scales, and the cost is divided by its square: it is that of maps
        in any unit

    Raises
    ------
    GraphError
        As `certpgo.Graph`; or scales that are not (m,) and positive, or a point with a scale.

    Examples
    --------
    Three maps in a row, each with a unit twice as long as the last one's:

    >>> import numpy as np
    >>> import certpgo
    >>> rotation = certpgo.RotationGraph(3, [[0, 1], [1, 2]], [np.eye(3)] * 2, kappa=np.ones(2))
    >>> steps = np.array([[4.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    >>> graph = certpgo.SimilarityGraph(rotation, steps, np.ones(2), scales=np.array([2.0, 2.0]))
    >>> answer = certpgo.solve(graph)
    >>> answer.verdict.value, answer.estimate.scales.round(6).tolist()
    ('CERTIFIED', [1.0, 2.0, 4.0])
    """
    graph = PoseGraph(rotation, translations, tau, None, points, assumed, absolute)
    free = ~graph.is_point if free is None else free
    return replace(graph.with_unknown_scales(free), scales=scales)


def _require_rotations(rotation: Graph) -> None:
    require(rotation, Graph, "a RotationGraph of the relative rotations")
    if rotation.has_positions:
        raise InputError("a RotationGraph of the relative rotations expected, not one of poses")
