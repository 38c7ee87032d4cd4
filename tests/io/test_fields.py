"""Lines that the kernel reads are those that Python reads, word by word."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import certpgo
from certpgo.io import fields
from certpgo.io.exact import weighing
from certpgo.io.fields import by_tag, distinct_texts, floats, integers, plain_fields
from certpgo.io.formats.g2o import DIALECT
from certpgo.linalg.compiled import AVAILABLE, kernel

TAGS = {name.encode(): DIALECT.tags[name.encode()] for name in ("EDGE_SE2", "VERTEX_SE2")}
compiled = pytest.mark.skipif(not AVAILABLE, reason="there is no compiled kernel")

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


@compiled
@given(words)
@example("9007199254740993")  # 2^53 + 1, halfway between two doubles
@example("9007199254740993.00000000000000000001")
@example("1.7976931348623159e308")
@example("4.9e-324")
@example("-0")
@settings(max_examples=400)
def test_numbers_are_rounded_as_python_rounds_them(word):
    value, length = np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
    if kernel.numbers([f" {word}\t".encode()], value, length):
        known = as_python(word)
        assert known is not None
        assert bits(value[0, 0]) == bits(known)
        assert length[0, 0] == len(word)


@compiled
def test_tags_may_have_no_ids_or_no_numbers():
    parts, rest = kernel.tagged_lines(b"A 7\nB 2.5\nA x", ((b"A", 1, 0), (b"B", 0, 1)), 1)
    (_, ids, none, _, _), (_, no_ids, numbers, _, _) = parts
    assert np.frombuffer(ids, np.int64) == [7]
    assert np.frombuffer(numbers) == [2.5]
    assert not none + no_ids
    assert rest == [(3, b"A x")]


@compiled
@given(st.floats(1e-20, 1e20), st.integers(1, 17))
def test_plain_numbers_are_read_by_the_kernel(x, significant):
    word = f"{x:.{significant}g}"
    value, length = np.empty((1, 1)), np.empty((1, 1), dtype=np.intp)
    assert kernel.numbers([word.encode()], value, length)
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


@compiled
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


@pytest.mark.parametrize("name", ["tinyGrid3D", "ring", "cityTrees10000"])
def test_files_read_the_same_without_the_kernel(dataset_path, monkeypatch, name):
    path = dataset_path(name)
    one = certpgo.read(path, quiet=True)
    for module in (fields, weighing):
        monkeypatch.setattr(module, "AVAILABLE", False)
    other = certpgo.read(path, quiet=True)
    assert np.array_equal(one.graph.edges, other.graph.edges)
    for a, b in ((one.graph, other.graph), (one.graph.rotation, other.graph.rotation)):
        for column in ("translations", "tau", "rotations", "kappa"):
            if hasattr(a, column):
                assert getattr(a, column).tobytes() == getattr(b, column).tobytes()
    assert one.information.matrices.tobytes() == other.information.matrices.tobytes()
    assert sorted(one.notices) == sorted(other.notices)


def test_lines_are_grouped_by_tag():
    groups = by_tag([(3, b"FIX 1"), (5, b" EDGE_SE2 0 1"), (6, b"FIX")])
    assert groups == {b"FIX": [(3, b"1"), (6, b"")], b"EDGE_SE2": [(5, b"0 1")]}


def test_distinct_texts_are_numbered_by_first_occurrence():
    texts, which = distinct_texts([b"b", b"a", b"b"])
    assert texts == [b"b", b"a"]
    assert which.tolist() == [0, 1, 0]
