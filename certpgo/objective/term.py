"""A term of an objective: residuals of measurements of one kind, and minorants of their squares.

A measurement sees two nodes only through v = R_i^T (t_j + R_j a - t_i), for its arm a if it has
one, and Q = R_i^T R_j. So does everything here: a term knows no estimate and no other term.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Graph
from certpgo.graph.estimate import Estimate
from certpgo.graph.information import unmeasured
from certpgo.graph.observations import Observations
from certpgo.graph.relaxed_point import Point
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.minorants import Minorants

#: Where kinds of the package are, and their terms.
_OWN, _FAMILIES = "certpgo.graph.", "certpgo.objective.families."
#: The term of each class of blocks that is defined by now.
_TAKING: dict[type[Observations], type[Term]] = {}


class Term(ABC):
    """Residuals e(v, Q) of k measurements, each with the cost e^T W e.

    A subclass with ``takes`` is the term of the blocks of that class, from whose one block it is
    made: defining it is all that a new kind of measurement takes.
    """

    #: What is measured, where that is a `certpgo.graph.observations.Observations` of a graph.
    takes: ClassVar[type[Observations] | None] = None
    #: What is measured, in the plural, for titles.
    plural: ClassVar[str] = ""
    #: Units of rounding of minorants' coefficients, over their sizes; 0 where constants make up.
    roundings: ClassVar[float] = 0.0
    #: Whether residuals are lengths, so that their rounding is that of positions.
    in_metres: ClassVar[bool] = False
    #: Whether the cost has a value at points of any rank, see `certpgo.graph.relaxed_point.Lift`.
    lifts: ClassVar[bool] = False
    #: Whether the arms of its minorants have those of the measurements in them already.
    has_whole_arms: ClassVar[bool] = False
    #: What its residual is called in the compiled kernel, for this class alone; "" if it has none.
    compiled_residual: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        if cls.takes is not None:
            _TAKING[cls.takes] = cls

    @property
    @abstractmethod
    def edges(self) -> IntArray:
        """(k, 2) the nodes of each measurement."""

    @property
    def arms(self) -> FloatArray | None:
        """(k, d) arms a at the second nodes; None for zeros."""
        return None

    @property
    @abstractmethod
    def weights(self) -> FloatArray:
        """(k, r, r) weights W of the residuals."""

    def informed(self, information: FloatArray) -> FloatArray:
        """(k, r, r) weights W if these were the information matrices (k, p, p) of its edges."""
        return self.weights

    @property
    @abstractmethod
    def scale(self) -> Scale:
        """What W of the verdicts counts of them."""

    @property
    def turning(self) -> FloatArray:
        """(k,) rotational weights of the edges that stand for rows: 0 where none is measured."""
        return np.zeros(len(self.edges))

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(k,) how many numbers each measures of a rotation, and (k,) of anything else."""
        stated = ~unmeasured(self.weights)
        return np.zeros(len(stated), dtype=np.intp), stated.sum(axis=1)

    @property
    def double(self) -> IntArray:
        """(k,) how often the square of a turn counts in the cost."""
        return np.ones(len(self.edges), dtype=np.intp)

    @property
    def sizes(self) -> FloatArray:
        """(k,) what is measured: residuals are differences of such numbers, in the same unit."""
        return np.zeros(len(self.edges))

    def relative(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """(k, d) vectors v and (k, d, d) rotations Q of the measurements at a point."""
        return relative(self.edges, self.arms, point)

    @abstractmethod
    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, r) residuals."""

    @abstractmethod
    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (k, r) with their derivatives in v, (k, r, d), and in w, (k, r, q).

        Q moves to Q exp(w), as in `certpgo.linalg.rotations`.
        """

    @abstractmethod
    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(k,) balls that contain the costs of all of these (v, Q)."""

    @abstractmethod
    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding; a is besides the arms."""

    def whole_minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """The minorants with all of their arms, those of the measurements among them."""
        found, arms = self.minorants(v, Q), self.arms
        if arms is None or self.has_whole_arms:
            return found
        return replace(found, a=found.a + arms)

    def bend(self, v: FloatArray) -> FloatArray:
        """(k,) the quadratic part of the costs in moves v (k, d); by default none."""
        return np.zeros(len(v))

    def weighed(
        self, e: FloatArray, *, exact: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Costs (k,) of residuals e, and derivatives of half of them in e: (k, r) and (k, r, r).

        Parameters
        ----------
        exact : whether second derivatives may be indefinite
        """
        We = (self.weights @ e[:, :, None])[:, :, 0]
        return (e * We).sum(axis=1), We, self.weights

    def idle_turns(self, measured: Graph) -> tuple[IntArray, IntArray]:
        """(q,) nodes and axes of their frames about which turns change no cost, with those alone.

        Parameters
        ----------
        measured : all measurements
        """
        none = np.zeros(0, dtype=np.intp)
        return none, none

    def equations(self, n: int) -> Any:
        """Its derivatives at an estimate of n nodes, if residuals are of more than two each.

        With what `certpgo.objective.edge_equations` has of others; None for these.
        """
        return None

    @property
    def has_more(self) -> bool:
        """Whether second derivatives beyond those of Gauss and Newton are known."""
        return type(self).curved is not Term.curved

    def curved(self, v: FloatArray) -> FloatArray | None:
        """(k, d, d) second derivatives of half the costs in v, beyond those of Gauss and Newton.

        Of residuals that no turn of a frame changes; None where they are not known.
        """
        return None

    def costs(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k,) costs."""
        e = self.residuals(v, Q)
        return np.asarray(np.einsum("ma,mab,mb->m", e, self.weights, e))

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(k,) lower and upper bounds on the costs, with translations taken as stored."""
        i, j = self.edges.T
        R = Ball.within(estimate.rotations, rotation_defect(estimate.rotations))
        Q, at = R.T[i] @ R[j], estimate.translations
        t = Ball.exact(np.zeros((R.mid.shape[0], R.mid.shape[1])) if at is None else at)
        v = R.T[i].apply(t[j] - t[i])
        if (arms := self.arms) is not None:
            v = v + Q.apply(Ball.exact(arms))
        found = self.enclosures(v, Q)
        return found.lower, found.upper


@dataclass(frozen=True, eq=False)
class EdgeTerm(Term):
    """A term of the edges of a graph, weighed by their information.

    Attributes
    ----------
    graph : the measurements
    """

    graph: Graph
    has_whole_arms: ClassVar[bool] = True

    @property
    def edges(self) -> IntArray:
        """(m, 2) the nodes of each edge."""
        return self.graph.edges

    @property
    def arms(self) -> FloatArray | None:
        """(m, d) arms of the edges; None for zeros."""
        return self.graph.arms

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them."""
        return Scale.informed(self.graph)


def relative(
    edges: IntArray, arms: FloatArray | None, point: Point
) -> tuple[FloatArray, FloatArray]:
    """(m, d) vectors v = R_i^T (t_j + R_j a - t_i) and (m, d, d) rotations Q = R_i^T R_j.

    Of these edges (m, 2), with arms (m, d) at their second nodes or None for zeros. Without
    translations, v is zero.
    """
    i, j = edges.T
    R, t = point.rotations, point.translations
    back = np.swapaxes(R[i], 1, 2)
    if t is None:
        return np.zeros((len(i), R.shape[2])), back @ R[j]
    v, Q = (back @ (t[j] - t[i])[:, :, None])[:, :, 0], back @ R[j]
    return v if arms is None else v + (Q @ arms[:, :, None])[:, :, 0], Q


def term_of(block: Observations) -> Term:
    """The term of a block; of a kind of the package, it is in the family of the same name.

    Raises
    ------
    InputError
        No term takes its class.
    """
    made = type(block)
    if made not in _TAKING and made.__module__.startswith(_OWN):
        importlib.import_module(_FAMILIES + made.__module__.removeprefix(_OWN))
    taking = _TAKING.get(made)
    if taking is None:
        raise InputError(f"no term takes {type(block).__name__}: what they cost is not known")
    return taking(block)  # type: ignore[call-arg]
