"""Lines that the kernel reads are those that Python reads, word by word."""

import struct
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import certpgo
from certpgo.graph.information import Information
from certpgo.io.fields import by_tag, distinct_texts, floats, integers, plain_fields
from certpgo.io.formats.g2o import DIALECT
from certpgo.linalg import compiled

BAD = Path(__file__).parents[1] / "data" / "bad"
TAGS = {name.encode(): DIALECT.tags[name.encode()] for name in ("EDGE_SE2", "VERTEX_SE2")}
needs_the_kernel = pytest.mark.skipif(not compiled.AVAILABLE, reason="without a C compiler")

finite = st.floats(allow_nan=False, allow_infinity=False)
digits = st.text("0123456789", min_size=0, max_size=24)
decimals = st.builds(
    "{}{}.{}{}".format,
    st.sampled_from(["", "-", "+"]),
    digits,
    digits,
    st.sampled_from(["", "e5", "E-7", "e+22", "e-300", "e310", "e", "e-", "x"]),
)
words = (
    finite.map(repr)
    | decimals
    | st.sampled_from(
        ["1_0", "inf", "nan", "0x10", "1,5", "--1", ".", "", "1e400", "1e-400", "9" * 30, "\xb2"]
    )
)


def bits(x: float) -> bytes:
    return struct.pack("d", x)


def as_python(word: str) -> float | None:
    """The finite number that Python reads, as file formats mean it."""
    try:
        value = float(word.encode())
    except ValueError:
        return None
    return value if np.isfinite(value) and "_" not in word else None


@needs_the_kernel
@given(words)
@example("9007199254740993")  # 2^53 + 1, halfway between two doubles
@example("9007199254740993.00000000000000000001")
@example("1.7976931348623159e308")
@example("4.9e-324")
@example("-0")
@settings(max_examples=400)
def test_numbers_are_rounded_as_python_rounds_them(word):
    value, length = np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
    if compiled.kernel.numbers([f" {word}\t".encode()], value, length):
        known = as_python(word)
        assert known is not None
        assert bits(value[0, 0]) == bits(known)
        assert length[0, 0] == len(word)


@needs_the_kernel
@pytest.mark.parametrize("places", [*range(15, 30), 300, 999, 1000, 1001, 1010, 9999, 10**5, 10**6])
def test_numbers_of_many_places_are_what_python_reads(places):
    """Decimals and exponents that make up for each other, and digits that are too many."""
    zeros = "0" * places
    one = [f"0.{zeros}1e{places + 1}", f"1{zeros}e-{places}", f".{zeros}1E+{places + 1}"]
    for word in [
        *one,
        f"1.{zeros}",
        f"{zeros}1",
        f"-{zeros}.5",
        f"0e{places}",
        f"0.{zeros}e{places}",
        f"1.{zeros}1",
        f"0.{zeros}1e{places + 20}",
        f"0.{zeros}1e{places - 20}",
        f"9{zeros}e-{places}0",
        f"1e{zeros}5",
        f"1e-{zeros}22",
        f"1e1{zeros}",
        f"1e-1{zeros}",
        f"0.{zeros}1e1{zeros}",
        f"1{'2' * places}e-{places}",
        *(f"1e{2**k + change}" for k in (31, 32, 63, 64) for change in (-1, 0, 1, 5)),
        *(f"1e-{2**k + change}" for k in (31, 32, 63, 64) for change in (-1, 0, 1, 5)),
    ]:
        value, length = np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
        read = compiled.kernel.numbers([word.encode()], value, length)
        assert read == (as_python(word) is not None)
        assert not read or bits(value[0, 0]) == bits(float(word))
        assert not read or length[0, 0] == len(word)
        assert word not in one or value[0, 0] == 1.0


def test_a_number_of_many_decimals_in_a_file(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text(f"EDGE_SE2 0 1 0.{'0' * 1009}1e1010 0 0 1 0 0 1 0 1\n")
    assert certpgo.read(path).graph.translations.tolist() == [[1.0, 0.0]]


@needs_the_kernel
def test_tags_may_have_no_ids_or_no_numbers():
    parts, rest = compiled.kernel.tagged_lines(b"A 7\nB 2.5\nA x", ((b"A", 1, 0), (b"B", 0, 1)), 1)
    (_, ids, none, _, _), (_, no_ids, numbers, _, _) = parts
    assert np.frombuffer(ids, np.int64) == [7]
    assert np.frombuffer(numbers) == [2.5]
    assert not none + no_ids
    assert rest == [(3, b"A x")]


@needs_the_kernel
@given(st.floats(1e-20, 1e20), st.integers(1, 17))
def test_plain_numbers_are_read_by_the_kernel(x, significant):
    word = f"{x:.{significant}g}"
    value, length = np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
    assert compiled.kernel.numbers([word.encode()], value, length)
    assert bits(value[0, 0]) == bits(float(word))


edge_words = st.lists(words | st.integers(-3, 2**64).map(str), min_size=0, max_size=12)
lines = st.builds(
    lambda tag, rest: " ".join([tag, *rest]),
    st.sampled_from(["EDGE_SE2", " VERTEX_SE2", "FIX", "", "\tEDGE_SE2\t", "EDGE_SE22"]),
    edge_words
    | st.builds(
        lambda ids, numbers, rest: [*map(str, ids), *map(repr, numbers), *rest],
        st.lists(st.integers(0, 9), min_size=1, max_size=2),
        st.lists(finite, min_size=3, max_size=3),
        st.sampled_from([[], ["1", "0", "0", "1", "0", "1"], ["2 \r"]]),
    ),
)


@needs_the_kernel
@given(st.lists(lines, max_size=8), st.integers(1, 10**9))
@settings(max_examples=300)
def test_the_kernel_reads_what_python_reads(text, first):
    plain, rest = plain_fields("\n".join(text).encode(), TAGS, first)
    numbered = dict(enumerate((line.encode() for line in text), first))
    seen = [number for number, _ in rest]
    for name, found in plain.items():
        tag = TAGS[name]
        seen += found.lines.tolist()
        for k, number in enumerate(found.lines.tolist()):
            own, body = numbered[number].split(None, 1)
            assert own == name
            values = [*body.split(None, tag.ids + tag.numbers), b""]
            assert found.ids[k].tolist() == integers(values[: tag.ids])
            given_numbers = floats(values[tag.ids : tag.ids + tag.numbers], "ids")
            assert found.numbers[k].tobytes() == given_numbers.tobytes()
            assert found.texts[found.which[k]] == values[tag.ids + tag.numbers]
        assert len(set(found.texts)) == len(found.texts)
    assert sorted(seen) == [number for number, line in numbered.items() if line.strip()]
    assert all(line == numbered[number] for number, line in rest)


def contents(x):
    """Every array of an object by its bytes, every other thing by what it prints."""
    if isinstance(x, np.ndarray):
        return x.dtype.str, x.shape, x.tobytes()
    if isinstance(x, Information):  # equal ones are kept once, in any order
        return x.residual, contents(x.matrices)
    if is_dataclass(x):
        return type(x).__name__, [(f.name, contents(getattr(x, f.name))) for f in fields(x)]
    if isinstance(x, (list, tuple)):
        return list(map(contents, x))
    return [(k, contents(v)) for k, v in x.items()] if isinstance(x, dict) else repr(x)


def read_both_ways(path, **options):
    """What is read of a file, or why it is refused, with the kernel and without."""
    for available in (compiled.AVAILABLE, False):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(compiled, "AVAILABLE", available)
            try:
                yield contents(certpgo.read(path, quiet=True, **options))
            except certpgo.CertPGOError as error:
                yield str(error)


@needs_the_kernel
@pytest.mark.parametrize("name", ["tinyGrid3D", "ring", "cityTrees10000"])
def test_files_read_the_same_without_the_kernel(dataset_path, name):
    one, other = read_both_ways(dataset_path(name))
    assert one == other


@needs_the_kernel
@pytest.mark.parametrize("path", sorted(BAD.iterdir()), ids=lambda path: path.name)
def test_files_are_refused_the_same_without_the_kernel(path):
    one, other = read_both_ways(path)
    assert one == other


#: Edges, poses, priors and landmarks, some of whose lines are plain.
UNUSUAL = {
    "plane.g2o": """VERTEX_SE2 0 0 0 0
VERTEX_SE2\t1  1.0e0 +0.0 -0 # a comment
EDGE_SE2 0 1 1 0 0.1 4 0 0 4 0 9
EDGE_SE2 0 +1 1.00000000000000000000000000000001 0 .1 4 0 0 4 0 9
EDGE_SE2 1 00000000000000000000002 1. 0e0 1e-320 4 0 0 4 0 9.0

EDGE_SE2 1 2 .123456789012345678901234567890 0 0.1 4 1e-30 0 4 0 9
EDGE_SE2 2 0 -2 0 0 0.30000000000000004 0 0 0.1 0 1e2
EDGE_SE2_XY 2 7 1 2 4 0 4
EDGE_SE2_XY 1 7 2 2 4.0 1 4
FIX 0
""",
    "space.g2o": """VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0.1 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0.1 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 1 0 4 0 4
EDGE_SE3:QUAT 1 2 1 0 0 0 0 1e-400 1 3 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4
EDGE_SE3:QUAT 2 0 1.e1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 .1 0 0 .2 0 .3
""",
    "tree.graph": """VERTEX2 0 0 0 0
EDGE2 1 0 -1 0 0.1 4 0 4 9 0 0
EDGE2 1 0 -1.0000000000000000000000000000000001 0 0.1 4 0 4 9 0 0
""",
}


@needs_the_kernel
@pytest.mark.parametrize("name", UNUSUAL)
@pytest.mark.parametrize("wrong", ["", "EDGE_SE2 1 2 1 0\n", "EDGE2 1 2 1 0 1_0 4 0 4 9 0 0\n"])
def test_unusual_lines_read_the_same_without_the_kernel(name, wrong, tmp_path):
    path = tmp_path / name
    path.write_text(UNUSUAL[name] + wrong)
    one, other = read_both_ways(path)
    assert one == other
    assert isinstance(one, str) == bool(wrong)


def test_lines_are_grouped_by_tag():
    groups = by_tag([(3, b"FIX 1"), (5, b" EDGE_SE2 0 1"), (6, b"FIX")])
    assert groups == {b"FIX": [(3, b"1"), (6, b"")], b"EDGE_SE2": [(5, b"0 1")]}


def test_distinct_texts_are_numbered_by_first_occurrence():
    texts, which = distinct_texts([b"b", b"a", b"b"])
    assert texts == [b"b", b"a"]
    assert which.tolist() == [0, 1, 0]
