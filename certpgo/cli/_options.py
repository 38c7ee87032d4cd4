"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._completion import graphs, inputs, one_of
from certpgo.cli._help import JUDGING, MATCHING
from certpgo.cli._show import notice
from certpgo.errors import InputError, SpecError
from certpgo.objective.costs import CHORDAL, COSTS

if TYPE_CHECKING:
    from certpgo.graph import Instance


GraphName = Annotated[
    str,
    typer.Argument(
        metavar="GRAPH",
        autocompletion=graphs,
        help="Graph file, or dataset name (certpgo list datasets).",
    ),
]
GraphNames = Annotated[
    list[str],
    typer.Argument(
        metavar="GRAPH...",
        autocompletion=graphs,
        help="Graph file, or dataset name (certpgo list datasets); several files are one graph.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Data = Annotated[
    Path | None,
    typer.Option("--data", metavar="DIR", help="Folder in which to look for datasets first."),
]
ProofOut = Annotated[
    Path | None,
    typer.Option("--proof", metavar="OUT", help="Write a proof file for certpgo check."),
]
HtmlOut = Annotated[
    Path | None,
    typer.Option("--html", metavar="OUT", help="Write an HTML page with plots and a 3D view."),
]
Quantile = Annotated[
    float | None,
    typer.Option(
        "--quantile",
        metavar="P",
        rich_help_panel=JUDGING,
        show_default="1 - 0.01 / m",
        help="Price of rejecting a measurement: this quantile of a correct one's cost (chi^2).",
    ),
]
Reference = Annotated[
    int | None,
    typer.Option(
        "--reference",
        metavar="NODE",
        rich_help_panel=JUDGING,
        show_default="the pose whose measurements weigh most",
        help="Pose, by its id, from which proven distances and regions are seen.",
    ),
]
Timestamps = Annotated[
    str | None,
    typer.Option(
        "--timestamps",
        metavar="ids|index|FILE",
        autocompletion=one_of(("ids", "index")),
        rich_help_panel=MATCHING,
        show_default="node ids if they can be",
        help="How to match poses, and those of the truth, with nodes: timestamps are node ids "
        "(ids), poses are in the order of the nodes (index), or timestamps are times and FILE has "
        "those of the nodes, by line.",
    ),
]
MaxDifference = Annotated[
    float,
    typer.Option(
        "--max-difference",
        metavar="SECONDS",
        rich_help_panel=MATCHING,
        help="Largest difference in time between a node and its pose.",
    ),
]


def _known(cost: str) -> str:
    """The name of a cost, if there is such a cost."""
    if cost not in COSTS:
        raise typer.BadParameter(str(SpecError.unknown("cost", cost, list(COSTS))))
    return cost


CostOption = Annotated[
    str | None,
    typer.Option(
        "--cost",
        parser=_known,
        metavar="|".join(COSTS),
        autocompletion=one_of(COSTS),
        show_default="that of the file's program",
        help="Cost to minimise or to judge by: chordal (F, one weight for rotation, one for "
        "translation), g2o's or GTSAM's.",
    ),
]


def _kernel(text: str) -> str:
    """A kernel's name and scale, if there is such a kernel."""
    from certpgo.objective.kernels import Kernel

    try:
        Kernel.parse(text)
    except (InputError, SpecError) as error:
        raise typer.BadParameter(str(error)) from None
    return text


KernelOption = Annotated[
    str | None,
    typer.Option(
        "--kernel",
        parser=_kernel,
        metavar="NAME:SCALE",
        help="Robust kernel of the costs of measurements: huber, cauchy, geman-mcclure or "
        "truncated, from a residual of SCALE on (the square root of a cost); of rotations also "
        "from an angle, as in huber:5deg.",
    ),
]


def require_for(instance: Instance, **options: Any) -> None:
    """Refuse options that do not take what an instance has, see `certpgo.graph.capabilities`.

    Raises
    ------
    InputError
        One of the options is used, and does not.
    """
    from certpgo.graph.capabilities import require_capable

    for name, value in options.items():
        if value:
            require_capable(instance.graph, name, instance.name)


def note_distances_uncounted(instance: Instance) -> None:
    """Print a notice that connectivity does not count distances, if there are any."""
    from certpgo.graph.phrases import counted

    if instance.graph.ranges is not None:
        distances = counted(instance.graph.ranges.num_edges, "distance{s}")
        notice(f"{instance.name}: connectivity is that of relative poses, without {distances}")


def chosen_cost(cost: str | None, instance: Instance, **options: Any) -> str:
    """The cost that was asked for; else chordal with options that exist for it only, else the own.

    If that of the file's program has no certificate, a notice says so.
    """
    if cost is not None:
        return cost
    from certpgo.objective.choose_cost import own_cost

    own, information = own_cost(instance), instance.graph.information
    for name, value in options.items():
        if value:
            if own != CHORDAL:
                said = f"--{name} minimises the chordal cost F, not the default cost of {own}"
                notice(f"{said}{_read_otherwise(instance, own)}")
            return CHORDAL
    if own == CHORDAL and information is not None and information.residual is not None:
        bad = int((~information.is_definite).sum())
        if not bad:
            notice("there are no relative poses: the cost is F, with isotropic weights (chordal)")
            return own
        notice(
            f"{bad} of {len(information.index)} information matrices are {information.indefinite}: "
            "the cost is F, with isotropic weights (chordal)"
        )
    return own


def _read_otherwise(instance: Instance, own: str) -> str:
    """How F would read rotational information as a cost does, if it does not; or empty."""
    meant = COSTS[own].rotation_information
    if instance.graph.d == 2 or instance.options.get("rotation_information", "tangent") == meant:
        return ""
    return f"; --rotation-information {meant} reads the noise of turns as {own} does"


def tier_for(proof: Path | None, tier: str | None, cost: str | None) -> str | None:
    """The tier that is asked for; with a proof that of proofs, if none is.

    Raises
    ------
    InputError
        The tier ``screen``, or a proof about a cost that the checker does not know.
    """
    if tier == "screen":
        raise InputError("--tier screen proves nothing and is for Python only: use --tier standard")
    if proof is None:
        return tier
    if cost is not None and not COSTS[cost].provable:
        known = " and ".join(name for name in COSTS if COSTS[name].provable)
        raise InputError(f"--proof is for --cost {known}, not for --cost {cost}")
    return tier or "proof"


def estimate_argument(help: str) -> Any:
    """The argument ESTIMATE of a command, with what it is there."""
    return typer.Argument(metavar="ESTIMATE", autocompletion=inputs, help=help)


def tolerance_option(name: str, help: str) -> Any:
    """The option for a tolerance of verdicts."""
    return typer.Option(f"--{name}", metavar="R", rich_help_panel=JUDGING, help=help)


def time_limit_option(help: str, default: str | bool = True) -> Any:
    """The option --time-limit of a command, with what it means there."""
    return typer.Option("--time-limit", metavar="SECONDS", min=0.0, show_default=default, help=help)


def tier_option(default: str) -> Any:
    """The option --tier of a command with this default."""
    return typer.Option(
        "--tier",
        metavar="standard|proof",
        autocompletion=one_of(("standard", "proof")),
        rich_help_panel=JUDGING,
        show_default=default,
        help="What the verdict may rely on: the usual error bounds of linear algebra (standard), "
        "or IEEE 754 arithmetic alone (proof).",
    )
