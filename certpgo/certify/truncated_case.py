"""Certificates of rejections: bounds on the truncated cost by edges of negative weight.

A rejected measurement is an edge of negative weight, see `certpgo.objective.truncated`. Where the
certificate matrix S_K of the kept measurements minus all of these edges is positive semidefinite,
the estimate is optimal over all poses and over all choices of rejected measurements.

Where it is not, some measurements are ambiguous: their residuals are not large against the
uncertainty of the estimate in their direction. S_K >= beta B B^T, for the block column B of an edge,
if and only if beta times the largest eigenvalue of B^T S_K^+ B, an effective resistance, is at most
one. These loads, of rotations and translations of each edge, say how its weight is split best, and
which edges to leave at zero, where min(f, c) >= 0 bounds their terms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.resistances import loads_of
from certpgo.certify.surrogate_bound import bound_below
from certpgo.certify.tolerances import DESCENT, Case, LocalMinimum
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.truncated_problem import TruncatedProblem
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution

#: Descents, each with the measurements that the last one takes back.
ROUNDS = 20
