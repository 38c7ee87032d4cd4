"""Former names of modules, which import the modules of today with a DeprecationWarning."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, spec_from_loader
from types import ModuleType
from typing import Any

#: Packages, and where their modules are now.
_ROOMS = {
    "assess": "solve",
    "costs": "objective",
    "datasets": "io.datasets",
    "solvers": "optimize.methods",
    "solvers.certified": "solve",
}
#: Modules that have another name since, and packages that were modules too.
_MODULES = {
    "assess.ladder": "solve.bounds_table",
    "assess.wording": "solve.accuracy_wording",
    "certify.case": "certify.chordal_case",
    "certify.climb": "certify.staircase_bound",
    "certify.own_cost": "certify.surrogate_case",
    "certify.parts": "certify.bridge_blocks",
    "certify.ranged": "certify.range_case",
    "certify.shifted": "certify.multipliers",
    "costs": "objective.choose_cost",
    "costs.descent": "optimize.levenberg_marquardt",
    "costs.edge_costs": "objective.costs",
    "costs.edge_costs.g2o": "objective.costs.g2o",
    "costs.edge_costs.gtsam": "objective.costs.gtsam",
    "costs.fit": "solve.fit",
    "costs.g2o": "objective.costs.g2o",
    "costs.gtsam": "objective.costs.gtsam",
    "costs.positions": "objective.position_costs",
    "costs.problem": "objective.information_problem",
    "costs.range_descent": "optimize.range_saddles",
    "costs.ranges": "objective.range_problem",
    "costs.schur": "objective.marginalized",
    "costs.signed": "objective.signed_weights",
    "graph.instance": "graph.dataset",
    "graph.joining": "graph.concatenate",
    "graph.lift": "graph.relaxed_point",
    "graph.speaking": "graph.display",
    "graph.wording": "graph.phrases",
    "io.assemble": "io.build_graph",
    "io.contents": "io.records",
    "io.informed": "io.edge_weights",
    "io.opening": "io.accept_paths",
    "io.piped": "io.stream",
    "io.plain": "io.json_values",
    "io.stated": "io.precision_kind",
    "linalg.balls": "linalg.ball_arithmetic",
    "linalg.network": "linalg.scalar_least_squares",
    "linalg.so": "linalg.rotations",
    "optimize.averaging": "optimize.laplacian_averaging",
    "optimize.chord": "optimize.chord_method",
    "optimize.low_rank": "optimize.low_rank_descent",
    "optimize.newton": "optimize.riemannian_newton",
    "optimize.roundings": "optimize.randomized_rounding",
    "optimize.starts": "optimize.initialization",
    "optimize.undetermined": "optimize.unobservable",
    "solvers.certified.disagreement": "solve.outliers",
    "solvers.certified.interface": "solve.solving",
    "solvers.certified.own_cost": "solve.surrogates",
    "solvers.certified.pipeline": "solve.result",
    "solvers.certified.ranged": "solve.range_search",
    "solvers.certified.rejecting": "solve.robust_session",
    "solvers.certified.renewal": "solve.warm_start",
    "solvers.certified.standing": "solve.session_status",
    "solvers.certified.suspicion": "solve.session_outliers",
    "solvers.certified.track": "solve.odometry",
    "view.gather": "view.load_scene",
    "view.growing": "view.live",
    "view.placing": "view.placements",
    "view.plots": "view.charts",
}


def name_today(former: str) -> str | None:
    """The name of today of a module ``certpgo.former``, without ``certpgo``; None if unchanged."""
    if former in _MODULES or former in _ROOMS:
        return _MODULES.get(former) or _ROOMS[former]
    room, _, module = former.rpartition(".")
    return f"{_ROOMS[room]}.{module}" if room in _ROOMS else None


class _FormerNames(MetaPathFinder, Loader):
    """Finds modules by their former names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of a module with a former name."""
        package, _, rest = fullname.partition(".")
        if package != "certpgo" or name_today(rest) is None:
            return None
        return spec_from_loader(fullname, self, is_package=True)

    def exec_module(self, module: ModuleType) -> None:
        """Give a module all that the one of today has."""
        former = module.__name__
        today = f"certpgo.{name_today(former.removeprefix('certpgo.'))}"
        found = importlib.import_module(today)
        warnings.warn(f"{former} is now {today}", DeprecationWarning, stacklevel=2)
        module.__doc__ = f"The former name of `{today}`."
        module.__getattr__ = partial(_attribute, former, found)  # type: ignore[method-assign]


def _attribute(former: str, found: ModuleType, name: str) -> Any:
    """What a module of today has, or a module that was within the former one."""
    within = f"{former}.{name}"
    today = name_today(within.removeprefix("certpgo."))
    if not hasattr(found, name) and today is not None and find_spec(f"certpgo.{today}"):
        return importlib.import_module(within)
    return getattr(found, name)


sys.meta_path.insert(0, _FormerNames())
