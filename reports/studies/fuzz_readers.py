"""Damaged files through every reader.

    python -m reports.studies.fuzz_readers --files 100000 --seed 0

Small valid files of every format are mutated and read. Counted are exceptions that are not
documented, signals (a process dies), and calls above 2 s of processor time or 500 MB. Each file
follows from the seed and its number: ``--only NUMBER`` reads that one again, here.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy import io as matlab
from scipy import sparse

from certpgo import checker, io
from certpgo.errors import CertPGOError, InputNotice
from certpgo.graph import Estimate, Instance
from certpgo.io.datasets.synthetic import helix
from certpgo.io.digits import writing_of
from certpgo.io.exact import quaternion
from certpgo.io.format import formats
from certpgo.registration.scans import read_scan
from certpgo.solve.proving import write_proof
from certpgo.solve.solving import solve
from reports.studies import _containers as containers

SECONDS, MEGABYTES = 2.0, 500
#: Seconds after which a call is taken for one that never ends.
FOREVER = 20
DOCUMENTED = (CertPGOError, checker.Refused, checker.Unreadable)
#: What numbers are replaced by.
NUMBERS = b"nan inf -inf 1e400 -1e308 1e300 1e-320 0 -0 -1 1 2 1.5 1e17 0x10 1_0 +3 1e .".split()
NUMBERS += [b"1e999999999", b"9" * 5000, b"0." + b"0" * 400 + b"1", b"9223372036854775807"]
NUMBERS += [b"-9223372036854775808", b"18446744073709551616", b"\xb2", b"\xc2\xa0"]
INTEGERS = (-(2**63), -(2**31), -2, -1, 0, 1, 2, 3, 127, 255, 2**15, 2**31 - 1, 2**32, 2**63 - 1)
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e308, 1e-308, 5e-324, 1e17, 0.5)
TEXT = (b"\r", b"\n", b"\r\n", b"\0", b"\x0b", b"\x85", b"#", b" ", b"\t", b"_", b"\xff", b"\x1a")
DTYPES = ("|O", "<f4", "<i2", "<u8", "<c16", "<U3", "|S8", "<M8[s]", "|V16", "|b1", "<f8", ">f8")


@dataclass(frozen=True)
class Sample:
    """Valid files, one of which a reader is given.

    Attributes
    ----------
    files : contents by name
    main : the file that is read, or "." for the folder
    kind : how contents are mutated: "text", "zip", "mat", "json", "database" or "records"
    role : what it is read as: a file by every reader, a "proof", "timestamps" or a "scan"
    """

    files: dict[str, bytes]
    main: str
    kind: str = "text"
    role: str = "file"


# --- Valid files ----------------------------------------------------------------------------------


def samples() -> dict[str, Sample]:
    """One or more of every format."""
    rng, found = np.random.default_rng(0), {}
    space = helix(3, rng)
    space = replace(space, initial=space.truth)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def written(suffix: str, what: Instance | Estimate, of: Instance = space) -> bytes:
            path = folder / f"sample{suffix}"
            instance = None if isinstance(what, Instance) else of
            anchor = None if instance is None else "none"
            io.write(path, what, instance=instance, anchor=anchor)
            return path.read_bytes()

        truth = space.truth
        for suffix in (".tum", ".kitti", ".rots"):
            what = Estimate(truth.rotations) if suffix == ".rots" else truth
            found[suffix[1:]] = Sample({f"e{suffix}": written(suffix, what)}, f"e{suffix}")
        graph, estimate = written(".g2o", space), written(".npz", truth)
        found["g2o"] = Sample({"g.g2o": graph}, "g.g2o")
        open3d = written(".json", space)
        found["open3d"] = Sample({"g.json": open3d}, "g.json", "json")
        found["pyfg"] = Sample({"g.pyfg": written(".pyfg", space)}, "g.pyfg")
        found["npz"] = Sample({"g.npz": written(".npz", space)}, "g.npz", "zip")
        found["npz estimate"] = Sample({"e.npz": estimate}, "e.npz", "zip")
        (folder / "g.g2o").write_bytes(graph)
        best = solve(io.read(folder / "g.g2o", quiet=True).graph)
        instance = io.read(folder / "g.g2o", quiet=True)
        write_proof(folder / "g.cert", folder / "g.g2o", instance, best.estimate, best.certificate)
        proof = (folder / "g.cert").read_bytes()
        found["proof"] = Sample({"g.cert": proof, "g.g2o": graph}, "g.cert", "zip", "proof")
    found |= _texts(rng, truth.rotations, truth.translations)
    found |= _others(json.loads(open3d))
    A = sparse.csc_matrix(np.triu(np.ones((7, 7)), 1))
    for name, options in (("mat", {}), ("mat compressed", {"do_compression": True})):
        stream = BytesIO()
        matlab.savemat(stream, {"A": A + A.T}, **options)
        found[name] = Sample({"g.mat": stream.getvalue()}, "g.mat", "mat")
    return found


def _others(open3d: dict[str, Any]) -> dict[str, Sample]:
    """JSON that is not written, databases, states of Cartographer, and scans."""
    eye = np.eye(3).tolist()
    views = [
        {"key": k, "value": {"ptr_wrapper": {"data": {"filename": f"{k}.jpg", "id_pose": k}}}}
        for k in range(3)
    ]
    openmvg = {
        "sfm_data_version": "0.3",
        "views": views,
        "extrinsics": [
            {"key": k, "value": {"rotation": eye, "center": [k, 0, 0]}} for k in range(3)
        ],
    }
    pose = {"type": "Pose2", "x": 1.0, "y": 0.0, "theta": 0.1}
    weighed = {"covariance": np.eye(3).ravel().tolist()}
    between = [
        {"type": "BetweenFactorPose2", "key1": i, "key2": j, "measurement": pose, **weighed}
        for i, j in ((0, 1), (1, 2), (0, 2))
    ]
    prior = {"type": "PriorFactorPose2", "key": 0, "prior": pose, **weighed}
    jrl = {
        "name": "sample",
        "robots": ["a"],
        "measurements": {"a": [{"stamp": 0, "measurements": [*between, prior]}]},
        "groundtruth": {"a": [{**pose, "key": k} for k in range(3)]},
        "outlier_factors": {"a": [[0, 2]]},
    }
    texts = {"sfm_data.json": openmvg, "g.jrl": jrl}
    found = {
        name: Sample({name: json.dumps(content).encode()}, name, "json")
        for name, content in texts.items()
    }
    for name, content in containers.databases().items():
        found[name] = Sample({"g.db": content}, "g.db", "database")
    cycle = [((0, 0), (0, 0)), ((0, 0), (0, 1)), ((0, 1), (0, 1)), ((0, 1), (0, 0))]
    measured = [containers.constraint(*ends, 0.5) for ends in cycle]
    found["pbstream"] = Sample({"g.pbstream": containers.state(measured)}, "g.pbstream", "records")
    for name, content in containers.scans().items():
        file = f"scan.{name.split()[0]}"
        found[f"scan {name}"] = Sample({file: content}, file, role="scan")
    return found


def _texts(rng: Generator, R: np.ndarray, t: np.ndarray) -> dict[str, Sample]:
    """Formats that are read and not written."""
    n, pairs = len(R), [(k, k + 1) for k in range(len(R) - 1)] + [(0, len(R) - 1)]

    def numbers(count: int) -> str:
        return " ".join(f"{x:.6g}" for x in rng.normal(0.0, 0.3, count))

    def flat(M: np.ndarray) -> str:
        return " ".join(f"{x:.12g}" for x in M.ravel())

    def tagged(vertex: str, edge: str, d: int, size: int) -> str:
        upper = np.eye(size)[np.triu_indices(size)] * 2.0
        if vertex == "VERTEX2":
            upper = np.array([2.0, 0.0, 2.0, 2.0, 0.0, 0.0])  # TORO's own order
        said = [f"{vertex} {k} {numbers(d)}" for k in range(n) if vertex]
        said += [f"{edge} {i} {j} {numbers(d)} {flat(upper)}" for i, j in pairs]
        return "\n".join([*said, ""])

    q = [f"{w} {x} {y} {z}" for x, y, z, w in quaternion.to_write(R)]
    relative = [R[i].T @ R[j] for i, j in pairs]
    lifted = np.concatenate([np.concatenate([R, t[:, :, None]], axis=2)[k] for k in range(n)], 1)
    texts = {
        "toro 2D": ("g.graph", tagged("VERTEX2", "EDGE2", 3, 3)),
        "toro 3D": ("g.graph", tagged("VERTEX3", "EDGE3", 6, 6)),
        "isam 2D": ("g.txt", tagged("", "EDGE2", 3, 3)),
        "isam 3D": ("g.txt", tagged("", "EDGE3", 6, 6)),
        "g2o 2D": ("g.g2o", tagged("VERTEX_SE2", "EDGE_SE2", 3, 3) + "FIX 0\n"),
        "colmap": (
            "images.txt",
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
            + "".join(f"{k + 1} {q[k]} {flat(t[k])} 1 im_{k}.jpg\n1.5 2.5 -1\n" for k in range(n)),
        ),
        "glomap": (
            "pairs.txt",
            "".join(f"im_{i}.jpg im_{j}.jpg {q[i]} {flat(t[i])}\n" for i, j in pairs),
        ),
        "glomap rotations": ("r.txt", "".join(f"im_{k}.jpg {q[k]}\n" for k in range(n))),
        "bundler": (
            "b.out",
            f"# Bundle file v0.3\n{n} 1\n"
            + "".join(
                "1.5 0 0\n" + "".join(f"{flat(row)}\n" for row in [*R[k], t[k]]) for k in range(n)
            ),
        ),
        "sim3": ("g.g2o", tagged("VERTEX_SIM3:EXPMAP", "EDGE_SIM3:EXPMAP", 7, 7)),
        "planar": ("e.txt", "".join(f"{k} {flat(t[k, :2])} 0.{k}\n" for k in range(n))),
        "columns": (
            "e.csv",
            "#sec,nsec,x,y,z,qx,qy,qz,qw\n"
            + "".join(f"{k},5,{x[0]},{x[1]},{x[2]},0,0,0,1\n" for k, x in enumerate(t)),
        ),
        "euroc": ("e.csv", "".join(f"{k},{x[0]},{x[1]},0,1,0,0,0\n" for k, x in enumerate(t))),
        "iterate": (
            "Y.txt",
            f"3 {4 * n}\n" + "".join(f"{flat(row)}\n" for row in lifted),
        ),
    }
    found = {name: Sample({file: text.encode()}, file) for name, (file, text) in texts.items()}
    scene = {
        "EGs.txt": "".join(
            f"{i} {j} {flat(M)} 0 0 1\n" for (i, j), M in zip(pairs, relative, strict=True)
        ),
        "cc.txt": "".join(f"{k}\n" for k in range(n)),
        "gt_rots.txt": "".join(f"{k} {flat(R[k].T)}\n" for k in range(n)),
    }
    found["1dsfm"] = Sample({name: text.encode() for name, text in scene.items()}, ".")
    found["1dsfm, bundled"] = Sample(
        {"EGs.txt": scene["EGs.txt"].encode(), "gt_bundle.out": found["bundler"].files["b.out"]},
        "EGs.txt",
    )
    stamps = "".join(f"{k} # node\n" for k in range(n)).encode()
    found["timestamps"] = Sample({"times.txt": stamps}, "times.txt", role="timestamps")
    return found


# --- Mutations ------------------------------------------------------------------------------------

Mutation = Callable[[Generator, bytes], bytes]


def _span(rng: Generator, size: int) -> slice:
    start = int(rng.integers(0, size + 1))
    return slice(start, start + int(rng.integers(1, 40)))


def _flip(rng: Generator, data: bytes) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(0, max(len(data), 1), int(rng.integers(1, 5))) if data else ():
        changed[place] ^= 1 << int(rng.integers(0, 8))
    return bytes(changed)


def _truncate(rng: Generator, data: bytes) -> bytes:
    return data[: int(rng.integers(0, len(data) + 1))]


def _delete(rng: Generator, data: bytes) -> bytes:
    gone = _span(rng, len(data))
    return data[: gone.start] + data[gone.stop :]


def _duplicate(rng: Generator, data: bytes) -> bytes:
    twice = _span(rng, len(data))
    return data[: twice.stop] + data[twice] + data[twice.stop :]


def _insert(rng: Generator, data: bytes) -> bytes:
    place = int(rng.integers(0, len(data) + 1))
    new = rng.integers(0, 256, int(rng.integers(1, 9)), np.uint8).tobytes()
    return data[:place] + new + data[place:]


def _of_words(rng: Generator, data: bytes) -> bytes:
    """A word replaced by a number that is unusual, by another word, or nothing."""
    lines = data.split(b"\n")
    line = int(rng.integers(0, len(lines)))
    words = lines[line].split(b" ")
    word, choice = int(rng.integers(0, len(words))), rng.random()
    if choice < 0.7:
        words[word] = NUMBERS[int(rng.integers(0, len(NUMBERS)))]
    elif choice < 0.8:
        words[word] = words[int(rng.integers(0, len(words)))]
    elif choice < 0.9:
        del words[word]
    else:
        words.insert(word, NUMBERS[int(rng.integers(0, len(NUMBERS)))])
    lines[line] = b" ".join(words)
    return b"\n".join(lines)


def _of_lines(rng: Generator, data: bytes) -> bytes:
    """A line deleted, said twice or moved; or a separator that is unusual."""
    lines = data.split(b"\n")
    line, choice = int(rng.integers(0, len(lines))), int(rng.integers(0, 4))
    if choice == 0:
        del lines[line]
    elif choice == 1:
        lines.insert(line, lines[line])
    elif choice == 2:
        lines.insert(int(rng.integers(0, len(lines))), lines.pop(line))
    else:
        place = int(rng.integers(0, len(data) + 1))
        return data[:place] + TEXT[int(rng.integers(0, len(TEXT)))] + data[place:]
    return b"\n".join(lines)


def _of_integers(rng: Generator, data: bytes) -> bytes:
    """Four or eight bytes replaced by an integer that is unusual."""
    size = 4 if rng.random() < 0.8 else 8
    value = INTEGERS[int(rng.integers(0, len(INTEGERS)))] % (1 << 8 * size)
    place = int(rng.integers(0, len(data) // 4 + 1)) * 4
    return data[:place] + value.to_bytes(size, "little") + data[place + size :]


def _of_matrix(rng: Generator, data: bytes) -> bytes:
    """The inside of a compressed matrix, which then is valid again."""
    if data[128:132] != struct.pack("<I", 15):
        return _of_integers(rng, data)
    try:
        inside = zlib.decompress(data[136:])
    except zlib.error:
        return _flip(rng, data)
    inside = _of_integers(rng, inside)
    if rng.random() < 0.02:  # a bomb
        inside += bytes(1 << 23)
    packed = zlib.compress(inside, 1)
    return data[:128] + struct.pack("<II", 15, len(packed)) + packed


def _of_archive(rng: Generator, data: bytes) -> bytes:
    """The archive with one of its arrays changed, valid again as an archive."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            compression = archive.infolist()[0].compress_type
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # mutated before
        return _flip(rng, data)
    name = list(members)[int(rng.integers(0, len(members)))]
    choice = rng.random()
    if choice < 0.05:
        del members[name]
    elif choice < 0.1:
        members[list(members)[int(rng.integers(0, len(members)))]] = members[name]
    elif choice < 0.4:
        members[name] = _of_header(rng, members[name])
    elif choice < 0.9:
        members[name] = _of_values(rng, members[name])
    elif choice < 0.95:
        members[name] = _flip(rng, members[name])
    else:
        members[name] += bytes(int(rng.integers(1, 1 << 23 if rng.random() < 0.1 else 1 << 10)))
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", compression, compresslevel=1) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return stream.getvalue()


def _of_header(rng: Generator, array: bytes) -> bytes:
    """A shape, a type of numbers or the order of an array's header changed."""
    head, brace, rest = array.partition(b"}")
    if not brace:
        return _flip(rng, array)
    size = str(INTEGERS[int(rng.integers(0, len(INTEGERS)))]).encode()
    before, shape, after = head.partition(b"'shape': (")
    choice = int(rng.integers(0, 4))
    if choice == 0:
        head = before + shape + size + b", " + after
    elif choice == 1:
        head = before + shape + size + b"," + after[after.find(b")") :]
    elif choice == 2:
        dtype = DTYPES[int(rng.integers(0, len(DTYPES)))].encode()
        if rng.random() < 0.2:
            dtype = b"['a', '<f8')"
        start = head.find(b"'descr': '") + 10
        head = head[:start] + dtype + head[head.find(b"'", start) :]
    else:
        head = head.replace(b"False", b"True ")
    padding = len(array) - len(head) - 1 - len(rest)
    return head + b"}" + (b" " * padding + rest if padding >= 0 else rest[-padding:])


def _of_values(rng: Generator, array: bytes) -> bytes:
    """One entry, or the type of all, changed."""
    try:
        values = np.load(BytesIO(array))
    except Exception:  # mutated before
        return _flip(rng, array)
    choice, stream = rng.random(), BytesIO()
    if choice < 0.15:
        types = [t for t in DTYPES if t not in ("|O", "|V16")]
        values = np.zeros(values.shape, types[int(rng.integers(0, len(types)))])
    elif choice < 0.25:
        values = values.ravel() if rng.random() < 0.5 else values[None]
    elif values.dtype.kind == "U":
        text = _of_words(rng, str(values.ravel()[0]).encode() if values.size else b"")
        values = np.full(values.shape, text.decode("latin-1"))
    elif values.size:
        values = values.copy()
        pool = FLOATS if values.dtype.kind == "f" else INTEGERS
        new = pool[int(rng.integers(0, len(pool)))]
        if values.dtype.kind == "f":
            with np.errstate(over="ignore"):
                values.flat[int(rng.integers(0, values.size))] = np.float64(new)
        elif values.dtype.kind in "iu":
            bits = 8 * values.dtype.itemsize
            low = -(1 << (bits - 1)) if values.dtype.kind == "i" else 0
            values.flat[int(rng.integers(0, values.size))] = (new - low) % (1 << bits) + low
    np.save(stream, values)
    return stream.getvalue()


_ANY: tuple[Mutation, ...] = (_flip, _truncate, _delete, _duplicate, _insert)
MUTATIONS: dict[str, tuple[Mutation, ...]] = {
    "text": (*_ANY, *[_of_words] * 5, *[_of_lines] * 3),
    "zip": (*_ANY, _of_integers, *[_of_archive] * 10),
    "mat": (*_ANY, *[_of_integers] * 4, *[_of_matrix] * 6),
    "json": (*_ANY, *[containers.of_json] * 10),
    "database": (*_ANY, _of_integers, *[containers.of_database] * 10),
    "records": (*_ANY, *map(containers.of_records, (*_ANY, *_ANY))),
}


# --- One file -------------------------------------------------------------------------------------


@dataclass
class Tally:
    """What became of files: how many by sample and outcome, and what failed in words."""

    files: Counter[tuple[str, str]] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest: tuple[float, str] = (0.0, "")
    largest: int = 0
    last: int = -1

    def add(self, other: Tally) -> int:
        """Count the other's files too; returns the last of them."""
        self.files += other.files
        self.failures += other.failures
        self.slowest = max(self.slowest, other.slowest)
        self.largest = max(self.largest, other.largest)
        return other.last


class Fuzzer:
    """Makes the files of a seed, and reads them."""

    def __init__(self, seed: int, files: dict[str, Sample], folder: Path) -> None:
        self._seed, self._folder, self._samples = seed, folder, files
        self._names = list(self._samples)
        graph = folder / "reference.g2o"
        graph.write_bytes(self._samples["g2o"].files["g.g2o"])
        self._instance = io.read(graph, quiet=True)
        self._tum = folder / "reference.tum"
        self._tum.write_bytes(self._samples["tum"].files["e.tum"])

    def judge(self, number: int, tally: Tally) -> None:
        """Make file ``number``, give it to the readers, and count."""
        rng = np.random.default_rng([self._seed, number])
        name = self._names[number % len(self._names)]
        sample, folder = self._samples[name], self._folder / name
        folder.mkdir(exist_ok=True)
        changed = list(sample.files)[int(rng.integers(0, len(sample.files)))]
        for file, content in sample.files.items():
            (folder / file).write_bytes(
                self._mutated(rng, sample.kind, content) if file == changed else content
            )
        read = 0
        for call, function in self._calls(rng, sample, folder / sample.main):
            start = time.process_time()
            failure = ""
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    warnings.simplefilter("ignore", InputNotice)
                    function()
                read += call.startswith("read") or sample.role != "file"
            except DOCUMENTED as error:
                if "\n" in str(error):
                    failure = "a message of several lines"
            except (Exception, SystemExit) as error:
                frame = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(frame.filename).name}:{frame.lineno}"
                failure = f"{type(error).__name__}: {str(error)[:100]} ({place})"
            seconds = time.process_time() - start
            tally.slowest = max(tally.slowest, (seconds, f"{number} {name}, {call}"))
            if seconds > SECONDS:
                failure = f"{seconds:.1f} s"
            if failure:
                tally.failures.append(f"{number} {name}, {call}: {failure}")
        tally.files[name, "read" if read else "refused"] += 1

    @staticmethod
    def _mutated(rng: Generator, kind: str, content: bytes) -> bytes:
        choices = MUTATIONS[kind]
        for _ in range((1, 1, 1, 2, 3)[int(rng.integers(0, 5))]):
            content = choices[int(rng.integers(0, len(choices)))](rng, content)
        return content

    def _calls(
        self, rng: Generator, sample: Sample, path: Path
    ) -> Iterator[tuple[str, Callable[[], object]]]:
        instance = self._instance
        if sample.role == "proof":
            yield "check", lambda: checker.check(path.with_name("g.g2o"), path)
            return
        if sample.role == "timestamps":
            yield "times", lambda: io.read_estimate(self._tum, instance, timestamps=path)
            return
        if sample.role == "scan":
            yield "scan", lambda: read_scan(path)
            return
        form = None
        if rng.random() < 0.1:
            form = str(rng.choice(list(formats())))
        options: dict[str, object] = {}
        if rng.random() < 0.2:
            options = [{"keep": "first"}, {"keep": "last"}, {"unit_weights": True}, {"kappa": 2.0}][
                int(rng.integers(0, 4))
            ]
        yield "read", lambda: io.read(path, quiet=True, format=form, **options)
        yield "read_estimate", lambda: io.read_estimate(path, format=form)
        yield "read_estimate of a graph", lambda: io.read_estimate(path, instance, format=form)
        yield "read_truth", lambda: io.read_truth(path, instance, format=form)
        yield "writing_of", lambda: self._as_written(path)
        if path.suffix == ".g2o" or path.name == "EGs.txt":
            claim = {"d": 3, "keep": "all", "kappa": None, "tau": None}
            claim |= {"rotation_information": "tangent"}
            yield "checker", lambda: checker.read_graph(path.read_bytes(), claim, None)

    def _as_written(self, path: Path) -> None:
        writing = writing_of(path)
        if writing is not None and self._instance.initial is not None:
            writing.rounded(self._instance.initial)


# --- Many files -----------------------------------------------------------------------------------


def _work(
    seed: int, files: dict[str, Sample], numbers: list[int], current: Any, results: Any
) -> None:
    """Judge files until all are done or one took too much memory; send what was found."""
    with tempfile.TemporaryDirectory() as folder:
        fuzzer, tally = Fuzzer(seed, files, Path(folder)), Tally()
        base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        limit = (MEGABYTES << 20) * 2 + int(Path("/proc/self/statm").read_text().split()[0]) * 4096
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
        for place, number in enumerate(numbers):
            current.value = number
            signal.setitimer(signal.ITIMER_PROF, FOREVER)
            fuzzer.judge(number, tally)
            taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base >> 10
            tally.largest, tally.last = max(tally.largest, taken), number
            if taken > MEGABYTES:
                tally.failures.append(f"{number}: {taken} MB")
                break  # the largest size of a process never shrinks
            if place % 200 == 199:
                results.send(tally)
                tally = Tally(last=number)
        results.send(tally)


def campaign(files: int, seed: int, processes: int) -> Tally:
    """Judge files 0 ... files-1 in processes of their own; those that die are counted."""
    context, total, valid = multiprocessing.get_context("spawn"), Tally(), samples()
    jobs = {first: first for first in range(min(processes, files))}
    running: dict[int, tuple[Any, Any, Any]] = {}
    deadly: set[int] = set()
    while jobs:
        for first in jobs.keys() - running.keys():
            rest = [k for k in range(jobs[first], files, processes) if k not in deadly]
            if not rest:
                del jobs[first]
                continue
            current = context.Value("q", rest[0])
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=_work, args=(seed, valid, rest, current, theirs))
            process.start()
            theirs.close()
            running[first] = process, current, ours
        time.sleep(0.2)
        for first, (process, current, ours) in list(running.items()):
            alive = process.is_alive()
            with suppress(EOFError):
                while ours.poll():
                    jobs[first] = total.add(ours.recv()) + processes
                    print(f"\r{total.files.total()} files", end="", file=sys.stderr)
            if alive:
                continue
            process.join()
            del running[first]
            if process.exitcode > 0:
                raise RuntimeError(f"file {current.value} could not be made")
            if process.exitcode < 0:
                name = signal.Signals(-process.exitcode).name
                total.failures.append(f"{current.value}: {name}")
                deadly.add(current.value)  # what it had not reported is judged again
    return total


def main() -> int:
    """Print what became of the files; exit code 1 if any failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", type=int, metavar="NUMBER")
    wanted = parser.parse_args()
    if wanted.only is None:
        total = campaign(wanted.files, wanted.seed, wanted.processes)
    else:
        total = Tally()
        with tempfile.TemporaryDirectory() as folder:
            Fuzzer(wanted.seed, samples(), Path(folder)).judge(wanted.only, total)
    names = sorted({name for name, _ in total.files})
    for name in names:
        counts = (f"{total.files[name, what]:7} {what}" for what in ("read", "refused"))
        print(f"{name:<20}", *counts)
    print(*total.failures, sep="\n")
    print(
        f"{total.files.total()} files, {len(total.failures)} failures; "
        f"slowest call {total.slowest[0]:.2f} s ({total.slowest[1]}), "
        f"largest process {total.largest} MB above its start"
    )
    return int(bool(total.failures))


if __name__ == "__main__":
    sys.exit(main())
