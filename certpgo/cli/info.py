"""certpgo info: describe a graph without solving it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from certpgo.cli import _known
from certpgo.cli._cause import cause, cause_as_json
from certpgo.cli._options import GraphNames, Json
from certpgo.cli._reading import Components, Reading, takes_reading
from certpgo.cli._show import document, facts, working

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.solve.diagnostics import Spectrum, Structure, Symmetry


EXAMPLES = (
    "certpgo info graph.g2o",
    "certpgo info sphere2500 --json",
)


@takes_reading
def command(
    graphs: GraphNames,
    json: Json = False,
    *,
    reading: Reading,
) -> None:
    """Describe a graph: counts, connectivity, weights, eigenvalues, symmetry and notices."""
    from certpgo.diagnosis.standing import cause_in_structure
    from certpgo.solve import diagnostics

    graph, reading = reading.of_all(graphs)
    instance = reading.open(reading.resolve(graph), notices=False, operation=None)
    found = diagnostics.structure(instance)
    spectra: dict[str, dict[str, Spectrum]] = {}
    symmetries: dict[str, Symmetry | None] = {}
    with working("eigenvalues"):
        for part in _parts(reading, instance):
            spectra[part.name] = dict(diagnostics.spectra(part.graph))
            symmetries[part.name] = diagnostics.symmetry(part)
    engine = diagnostics.engines_in_words()
    left_open = diagnostics.open_in_words(instance)
    found_wrong = cause_in_structure(instance)
    if json:
        symmetric = {name: value and asdict(value) for name, value in symmetries.items()}
        more = {"symmetry": symmetric, "undetermined": left_open, **cause_as_json(found_wrong)}
        document({**_as_json(instance, found, spectra, engine), **more})
        return
    facts([*_lines(instance, found, engine, left_open), *cause(found_wrong)])
    scaled = instance.graph.has_scales
    for name, by_weights in spectra.items():
        for weights, spectrum in by_weights.items():
            rotations = ", rotations alone" if scaled else ""
            typer.echo(f"\n{name}{rotations}, {_WEIGHTS[weights]}")
            facts(_spectrum_lines(spectrum, scaled, alone=found.misclosure_degrees is not None))
        if (symmetry := symmetries[name]) is not None:
            facts(_symmetry_lines(symmetry))
    if not all(spectra.values()):
        skipping = [
            *(["--no-priors skips priors"] if found.priors else []),
            *(["--no-landmarks skips landmarks"] if found.points else []),
        ]
        said = "eigenvalues need edges that all measure rotations and connect the nodes"
        typer.echo(f"\n{said}{': ' * bool(skipping)}{', '.join(skipping)}")
    elif not spectra:
        typer.echo("\neigenvalues need a connected graph: use --components largest or each")


_WEIGHTS = {"unit": "all weights 1", "weighted": "weights kappa"}


def _parts(reading: Reading, instance: Instance) -> list[Instance]:
    if not instance.measurements.is_connected and reading.components is Components.REFUSE:
        return []
    return reading.parts(instance)


def _as_json(
    instance: Instance,
    found: Structure,
    spectra: dict[str, dict[str, Spectrum]],
    engine: str,
) -> dict[str, Any]:
    from certpgo.graph.phrases import shown_path
    from certpgo.objective.choose_cost import costs_of
    from certpgo.optima import recognise

    return {
        "name": instance.name,
        "source": shown_path(instance.source),
        **asdict(found),
        "options": dict(instance.options),
        "notices": list(instance.notices),
        "initial": instance.initial is not None,
        "truth": instance.truth is not None,
        "costs": list(costs_of(instance)),
        "world_id": None if instance.world is None else int(instance.ids[instance.world]),
        "fixed_ids": [int(instance.ids[node]) for node in instance.fixed],
        "spectra": {
            name: {weights: asdict(spectrum) for weights, spectrum in by_weights.items()}
            for name, by_weights in spectra.items()
        },
        "engine": engine,
        "register": [_known.in_short(known) for known in recognise(instance)],
    }


def _lines(
    instance: Instance, found: Structure, engine: str, left_open: str | None
) -> Iterable[tuple[str, str]]:
    from certpgo.graph.phrases import counted, reading_sentence, shown_path
    from certpgo.objective.choose_cost import costs_of
    from certpgo.optima import recognise

    yield "name", instance.name
    yield "source", shown_path(instance.source)
    yield "problem", f"{found.kind} in {found.d}D"
    gaps = "" if found.consecutive else " with gaps"
    yield "nodes", f"{found.nodes}, ids {found.first_id} to {found.last_id}{gaps}"
    yield "edges", f"{found.edges}, {found.parallel_edges} of them parallel to an earlier edge"
    scaled = instance.graph.has_scales
    if instance.graph.has_scales:
        unknown = counted(int(instance.graph.free.sum()), "node{s}")
        yield "scales", f"unknown of {unknown}: certpgo solve and certify know them, in the cost F"
    if found.points:
        yield "landmarks", f"{counted(found.points, 'point{s}')} among the nodes"
    yield "measurements", ", ".join(instance.measurements.in_words)
    yield "bridges", f"{found.bridges} (in no cycle: no other measurement checks them)"
    sizes = found.component_sizes
    shown = ", ".join(map(str, sizes[:8])) + (", ..." if len(sizes) > 8 else "")
    if found.misclosure_degrees is not None:
        yield "misclosure", f"{found.misclosure_degrees:.6g} degrees, of the only cycle"
    yield "components", f"{len(sizes)}" + ("" if len(sizes) == 1 else f" of {shown} nodes")
    if left_open is not None:
        yield "undetermined", left_open
    yield "kappa", f"{_range(found.kappa)} (rotational weights)"
    if found.tau is not None:
        unit = "square unit" if scaled else "m^2"
        yield "tau", f"{_range(found.tau)} per {unit} (translational weights)"
    yield "read as", reading_sentence(instance.options)
    own, *others = costs_of(instance)
    if scaled:
        yield (
            "costs",
            "F over similarities (default), of logarithms (certpgo solve --scales-within)",
        )
    else:
        yield "costs", ", ".join([f"{own} (default)", *others])
    if instance.world is not None:
        yield "world", f"node {instance.ids[instance.world]}, which priors are measured from"
    yield "initial values", "in the file" if instance.initial is not None else "none"
    yield "ground truth", "available" if instance.truth is not None else "none"
    for sentence in instance.notices:
        yield "notice", sentence
    for known in recognise(instance):
        yield "register", str(known)
    yield "engine", engine


def _range(ends: tuple[float, float]) -> str:
    low, high = (f"{end:.6g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def _spectrum_lines(spectrum: Spectrum, scaled: bool, *, alone: bool) -> Iterable[tuple[str, str]]:
    """The eigenvalues; of a graph with unknown scales without the bound on residual angles."""
    values = "  ".join(f"{value:.6g}" for value in spectrum.smallest)
    yield "smallest eigenvalues", f"{values}  (0 for perfect measurements)"
    in_space = len(spectrum.smallest) == 3
    yield "connectivity", f"{spectrum.fiedler:.6g}  (second eigenvalue of the graph Laplacian)"
    yield (
        "inconsistency",
        f"{spectrum.inconsistency:.3g}  (smallest eigenvalue over connectivity)"
        + "; 0 for any only cycle in space, which turns about an axis" * (alone and in_space),
    )
    if scaled:
        return
    yield (
        "residual-angle bound",
        f"{math.degrees(spectrum.alpha_max):.4g} degrees by the largest degree, "
        f"{math.degrees(spectrum.normalized_alpha_max):.4g} by the normalized Laplacian",
    )
    yield "", "(stationary rotations with all residuals below it are optimal)"


def _symmetry_lines(symmetry: Symmetry) -> Iterable[tuple[str, str]]:
    from certpgo.solve.diagnostics import SYMMETRIC

    i, j = symmetry.edge
    yield (
        "symmetry of edges",
        f"{symmetry.mean:.3f} in the mean, at least {SYMMETRIC:g} on {symmetry.share:.1%}; "
        f"least {symmetry.least:.3f}, of {i} to {j}",
    )
    yield "", "(near 1, averaging rotations before translations loses little)"
