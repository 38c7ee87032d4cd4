"""JSON Robot Logs: .jrl with measurements of several robots, as of COSMO-Bench, and results, .jrr.

    {"name", "robots": ["a", ...], "measurements": {"a": [{"stamp", "measurements": [...]}, ...]},
     "groundtruth": {"a": [value, ...]}, "initialization", "outlier_factors": {"a": [[i, k], ...]}}
    {"type": "BetweenFactorPose3", "key1", "key2", "measurement": value, "covariance": [36]}
    {"type": "PriorFactorPose3", "key", "prior": value, "covariance": [36]}
    {"type": "Pose3", "translation": [x, y, z], "rotation": [w, x, y, z]}
    {"type": "Pose2", "x", "y", "theta"}

From format/*.md and src/Parser.cpp of https://github.com/DanMcGann/jrl; values under groundtruth,
initialization and solutions have a "key" too, or are listed by key. A .jrr file has "solutions" in
place of measurements. Keys are GTSAM's symbols: a robot's letter in the highest byte, then a
number. The covariances are GTSAM's, about the tangent space, in space with rotation before
translation. Other measurements are refused unless they are skipped by their type.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from certpgo.errors import InputError, NoMeasurements, in_file
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.edges import symmetric
from certpgo.graph.phrases import counted
from certpgo.io.build_graph import anchored
from certpgo.io.compressed import uncompressed_name
from certpgo.io.edge_weights import Weighing, weighed
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses, ReadOptions
from certpgo.io.json_files import read_json
from certpgo.io.nodes import Nodes, distinct
from certpgo.io.records import Rows
from certpgo.linalg.arrays import FloatArray, numbered

#: From rotation before translation to translation before rotation.
_ORDER = [3, 4, 5, 0, 1, 2]
_KEYS = (b'"measurements"', b'"solutions"')
_ROBOTS = b'"robots"'


class _Measured(NamedTuple):
    """A measurement: its place, keys, pose in numbers, covariance, and whether it is wrong."""

    place: str
    keys: tuple[int, ...]
    pose: list[float]
    covariance: FloatArray
    outlier: bool


class _Reader:
    """Reads values and measurements of one file; remembers the dimension of space."""

    def __init__(self, options: ReadOptions) -> None:
        self._options, self.d = options, 0
        self.skipped: Counter[str] = Counter()

    def content(self, path: Path) -> dict[str, Any]:
        """The object in the file."""
        return self._object(read_json(path), "the file")

    def _object(self, value: Any, place: str) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise InputError(f"{place}: an object expected")
        return value

    def _list(self, value: Any, place: str) -> list[Any]:
        if not isinstance(value, list):
            raise InputError(f"{place}: a list expected")
        return value

    def numbers(self, value: Any, size: int, place: str) -> list[float]:
        """So many finite numbers."""
        listed = value if isinstance(value, list) else [value]
        whole = all(type(one) in (int, float) and abs(one) < 1e300 for one in listed)
        if len(listed) != size or not whole:
            raise InputError(f"{place}: {counted(size, 'finite number{s}')} expected")
        return [float(one) for one in listed]

    def key(self, value: Any, place: str) -> int:
        """A node's key."""
        digits = isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 20
        number = int(value) if digits else value
        if type(number) is not int or not 0 <= number < 2**63:
            raise InputError(f"{place}: a key of 63 bits expected, not {str(value)[:40]!r}")
        return number

    def pose(self, value: Any, place: str) -> list[float]:
        """The numbers x y theta of a Pose2, or x y z qx qy qz qw of a Pose3."""
        given = self._object(value, place)
        d = {"Pose2": 2, "Pose3": 3}.get(str(given.get("type")), 0)
        if not d or self.d not in (0, d):
            expected = f"Pose{self.d}" if self.d else "Pose2 or Pose3"
            raise InputError(f"{place}: {expected} expected, not {str(given.get('type'))[:40]}")
        self.d = d
        if d == 2:
            return self.numbers([given.get(name) for name in ("x", "y", "theta")], 3, place)
        q = self.numbers(given.get("rotation"), 4, f"{place}.rotation")
        if not any(q):
            raise InputError(f"{place}.rotation: a quaternion expected, not zero")
        return [*self.numbers(given.get("translation"), 3, f"{place}.translation"), *q[1:], q[0]]

    def measurements(self, content: dict[str, Any]) -> Iterator[_Measured]:
        """All measurements of all robots, in the order of the file."""
        wrong = self._outliers(content)
        robots = self._object(content["measurements"], "measurements")
        for robot, entries in robots.items():
            for i, entry in enumerate(self._list(entries, f"measurements.{robot}")):
                place = f"measurements.{robot}[{i}]"
                listed = self._object(entry, place).get("measurements")
                for k, given in enumerate(self._list(listed, f"{place}.measurements")):
                    found = self._measured(given, f"{place}.measurements[{k}]")
                    if found is not None:
                        yield found._replace(outlier=(robot, i, k) in wrong)

    def _outliers(self, content: dict[str, Any]) -> set[tuple[str, int, int]]:
        found: set[tuple[str, int, int]] = set()
        given = self._object(content.get("outlier_factors") or {}, "outlier_factors")
        for robot, pairs in given.items():
            place = f"outlier_factors.{robot}"
            for pair in self._list(pairs, place):
                entry, number = self.numbers(pair, 2, place)
                found.add((robot, int(entry), int(number)))
        return found

    def _measured(self, value: Any, place: str) -> _Measured | None:
        given = self._object(value, place)
        kind = str(given.get("type"))
        prior = kind.startswith("PriorFactorPose")
        if kind in self._options.skip or (prior and self._options.skip_priors):
            self.skipped[kind] += 1
            return None
        if not prior and not kind.startswith("BetweenFactorPose"):
            said = f"BetweenFactorPose or PriorFactorPose expected, not {kind[:40]}"
            raise InputError(f"{place}: {said} (--skip {kind[:40]} leaves such measurements out)")
        names = ("key",) if prior else ("key1", "key2")
        keys = tuple(self.key(given.get(name), f"{place}.{name}") for name in names)
        if len(keys) != len(set(keys)):
            raise InputError(f"{place}: node {keys[0]} is measured from itself")
        what = "prior" if prior else "measurement"
        pose = self.pose(given.get(what), f"{place}.{what}")
        p = 3 * (self.d - 1)
        numbers = self.numbers(given.get("covariance"), p * p, f"{place}.covariance")
        return _Measured(place, keys, pose, np.array(numbers).reshape(p, p), False)

    def values(self, content: dict[str, Any], name: str) -> dict[int, list[float]]:
        """The poses of all robots under a name, by key; values of other types are left out."""
        found: dict[int, list[float]] = {}
        for robot, values in self._object(content.get(name) or {}, name).items():
            place = f"{name}.{robot}"
            by_key = values.items() if isinstance(values, dict) else ()
            listed = by_key or [(None, value) for value in self._list(values or [], place)]
            for word, value in listed:
                given = self._object(value, place)
                if str(given.get("type")).startswith("Pose"):
                    key = self.key(given.get("key", word), place)
                    found[key] = self.pose(given, f"{place}: {key}")
        return found

    def poses(self, numbers: list[list[float]]) -> tuple[FloatArray, FloatArray]:
        """Rotations (k, d, d) and translations (k, d)."""
        table = np.array(numbers).reshape(len(numbers), -1)
        if self.d == 2:
            return quaternion.planar_rotations(table[:, 2]), table[:, :2]
        return quaternion.rotations(table[:, 3:]), table[:, :3]


def _recognises(path: Path, head: bytes) -> bool:
    jrl = uncompressed_name(path).suffix in FORMAT.suffixes
    return head.lstrip().startswith(b"{") and (
        jrl or (_ROBOTS in head and any(key in head for key in _KEYS))
    )


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    with in_file(path):
        return _instance(path, options)


def _instance(path: Path, options: ReadOptions) -> Instance:
    reader = _Reader(options)
    content = reader.content(path)
    if "measurements" not in content:
        raise NoMeasurements(path, None, "no measurements: this is an estimate, not a graph")
    found = list(reader.measurements(content))
    between = [one for one in found if len(one.keys) == 2]
    if not between:
        raise NoMeasurements(path, None, "no measurements between poses")
    ids = distinct(np.array([one.keys for one in between], dtype=np.intp).ravel())
    R, t = reader.poses([one.pose for one in between])
    weighing = _weighed(path, between, R, options)
    edges = numbered(ids, np.array([one.keys for one in between], dtype=np.intp))
    wrong = np.array([one.outlier for one in between])
    notices = [
        counted(count, f"{kind} measurement{{s}} skipped") for kind, count in reader.skipped.items()
    ]
    if wrong.any():
        notices.append(counted(int(wrong.sum()), "known outlier{s} among the measurements"))
    rotation = RotationGraph(len(ids), edges, R, weighing.kappa)
    graph = PoseGraph(rotation, t, weighing.tau, information=weighing.information)
    instance = Instance(
        name=uncompressed_name(path).stem,
        graph=graph,
        ids=ids,
        source=str(path),
        options={"weights_are": "covariance"},
        notices=(*weighing.notices, *notices),
    )
    priors = [one for one in found if len(one.keys) == 1]
    if priors:
        instance = _with_priors(path, instance, priors, reader, options)
        wrong = np.append(wrong, [one.outlier for one in priors])
    values = {name: reader.values(content, name) for name in ("groundtruth", "initialization")}
    return replace(
        instance,
        truth=_all_of(instance, reader, values["groundtruth"]),
        initial=_all_of(instance, reader, values["initialization"]),
        outliers=wrong if "outlier_factors" in content else None,
    )


def _weighed(
    path: Path, measured: list[_Measured], R: FloatArray, options: ReadOptions
) -> Weighing:
    """The weights of measurements, from covariances in GTSAM's order."""
    C = symmetric(np.array([one.covariance for one in measured]))
    if R.shape[1] == 3:
        C = C[:, _ORDER][:, :, _ORDER]
    low = np.linalg.eigvalsh(C)[:, 0]
    if not options.ignore_information and not (low > 0.0).all():
        place = measured[int(np.argmin(low))].place
        raise InputError(f"{place}.covariance: a positive definite matrix expected")
    information = C if options.ignore_information else np.linalg.inv(C).astype(np.float64)
    found = weighed(path, symmetric(information), R, options, lambda k: measured[k].place)
    own = found.information and replace(found.information, residual="gtsam")
    return found._replace(information=own)


def _with_priors(
    path: Path, instance: Instance, priors: list[_Measured], reader: _Reader, options: ReadOptions
) -> Instance:
    """The instance with priors of its nodes, measured from the world."""
    nodes = numbered(instance.ids, np.array([one.keys[0] for one in priors], dtype=np.intp))
    if (nodes < 0).any():
        place = priors[int(np.argmin(nodes))].place
        raise InputError(f"{place}: a prior of a node that nothing else measures")
    R, t = reader.poses([one.pose for one in priors])
    weighing = _weighed(path, priors, R, options)
    if not instance.graph.has_positions:
        raise InputError("priors are of poses")
    rows = Rows(nodes[:, None], R, t, weighing.kappa, weighing.tau, weighing.information)
    graph, origin, notice = anchored(instance.graph, rows)
    return replace(
        instance,
        graph=graph,
        ids=Nodes(instance.ids, None, None).with_world(path).ids,
        world=len(instance.ids),
        origin=origin,
        notices=(*instance.notices, *weighing.notices, notice),
    )


def _all_of(instance: Instance, reader: _Reader, values: dict[int, list[float]]) -> Estimate | None:
    """The values of all nodes; None if some have none."""
    keys = instance.ids[: instance.world].tolist()
    if not keys or not all(key in values for key in keys):
        return None
    return instance.with_world(Estimate(*reader.poses([values[key] for key in keys])))


def _read_poses(path: Path) -> LabelledPoses:
    reader = _Reader(ReadOptions())
    with in_file(path):
        content = reader.content(path)
        kinds = ("solutions", "initialization", "groundtruth")
        name = next((k for k in kinds if content.get(k)), "")
        values = reader.values(content, name) if name else {}
        if not values:
            raise InputError("no poses under solutions, initialization or groundtruth")
        R, t = reader.poses(list(values.values()))
        return LabelledPoses(R, t, ids=np.array(list(values), dtype=np.intp))


FORMAT = Format(
    name="jrl",
    suffixes=(".jrl", ".jrr"),
    recognises=_recognises,
    holds="measurements of robots, or poses",
    read_graph=_read_graph,
    read_poses=_read_poses,
)
