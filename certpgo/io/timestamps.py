"""Timestamps in files: decimals of seconds, or whole nanoseconds, read exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal, DecimalException
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError, in_file
from certpgo.graph import Estimate, Instance
from certpgo.graph.keys import NO_TIME, ROUNDED, SECOND
from certpgo.graph.phrases import counted
from certpgo.io.compressed import opened
from certpgo.linalg.arrays import IntArray

#: Larger numbers of seconds, after the year 2262, are read as nanoseconds.
_LAST_SECOND = np.iinfo(np.int64).max // SECOND
#: What is possible where timestamps occur twice.
IGNORED = "--timestamps index ignores timestamps"
#: Larger numbers than have so many digits are beyond 64 bits.
_DIGITS = 20


def decimals(words: Sequence[bytes]) -> IntArray:
    """Numbers (k, 2) as an integer and billionths, exact to nine decimals.

    Raises
    ------
    InputError
        A word is no number, or beyond 64 bits.
    """
    try:
        numbers = [_billionths(word.decode()) for word in words]
        parts = [divmod(number, SECOND) for number in numbers]
        return np.array(parts, dtype=np.int64).reshape(-1, 2)
    except (DecimalException, UnicodeDecodeError, ValueError, OverflowError):
        raise InputError("timestamps in seconds expected") from None


def _billionths(word: str) -> int:
    number = Decimal(word)
    if number.adjusted() > _DIGITS:  # whose digits would fill the memory
        raise ValueError
    return int(number.scaleb(9).to_integral_value())


def times_and_ids(parts: IntArray, unit: int = 0) -> tuple[IntArray, IntArray | None]:
    """Times (k,) in nanoseconds, and the numbers as integers, which may be ids, if all are whole.

    Parameters
    ----------
    unit : of the numbers, nanoseconds. Where the file does not say it (0) they are seconds, or
        nanoseconds if they are too large for seconds and all are whole.

    Raises
    ------
    InputError
        They are neither, or beyond 64 bits.
    """
    whole, rest = parts.T
    if unit not in (0, SECOND):
        if (np.abs(whole) > np.iinfo(np.int64).max // unit - 1).any():
            raise InputError("timestamps expected of the years 1678 to 2261")
        distinct = not rest.any() and len(np.unique(whole)) == len(whole)
        return whole * unit + rest * unit // SECOND, whole if distinct else None
    near = bool((np.minimum(rest, SECOND - rest) <= ROUNDED).all())
    ids = whole + (rest > SECOND // 2)
    if not near or len(np.unique(ids)) < len(ids):
        ids = None
    if ((whole >= -_LAST_SECOND) & (whole < _LAST_SECOND)).all():
        return whole * SECOND + rest, ids
    if rest.any():
        raise InputError("timestamps in seconds, or in whole nanoseconds, expected")
    return whole, ids


def node_times(path: Path, *sizes: int) -> IntArray:
    """The times (k,) of nodes in a file, nanoseconds: the first number of each line.

    Blank lines and comments are skipped.

    Parameters
    ----------
    sizes : how many are expected, the usual number last; by default any

    Raises
    ------
    FormatError
        With path and line; or there is no such file, or there are others than so many.
    """
    try:
        with opened(path) as file:
            lines = file.read().decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        expected = "ids, index or a file of times expected for the timestamps"
        raise FormatError(path, None, f"no such file; {expected}") from None
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FormatError(path, None, "a text file of timestamps expected") from None
    parts = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        try:
            parts.append(decimals([word.encode() for word in words[:1]]))
        except InputError:
            raise FormatError(path, number, "a timestamp in seconds expected") from None
    with in_file(path):
        times, _ = times_and_ids(np.concatenate([np.empty((0, 2), np.int64), *parts]))
        refuse_repeats(times, "a time of its own for each node expected")
    if sizes and len(times) not in sizes:
        said = f"{counted(len(times), 'timestamp{s}')} for {counted(sizes[-1], 'node{s}')}"
        raise FormatError(path, None, said)
    return times


def file_of_times(timestamps: str | Path | None) -> Path | None:
    """The file with times; None, ``"ids"`` and ``"index"`` are none."""
    return None if timestamps in (None, "ids", "index") else Path(str(timestamps))


def timed(instance: Instance, timestamps: str | Path | None) -> Instance:
    """The instance with the times of its nodes from a file, one a line; otherwise as it is.

    Parameters
    ----------
    timestamps : see `file_of_times`

    Raises
    ------
    InputError
        There are neither as many as nodes nor as poses.
    """
    if (path := file_of_times(timestamps)) is None:
        return instance
    times = np.full(len(instance.ids[: instance.world]), NO_TIME)
    found = node_times(path, len(times), len(instance.poses))
    times[slice(None) if len(found) == len(times) else instance.poses] = found
    return replace(instance, times_ns=times)


def timed_by(estimate: Estimate, instance: Instance) -> Instance:
    """The instance with the times of an estimate of it, if it has none of its own."""
    keys = estimate.keys
    if instance.times_ns is not None or keys.times_ns is None:
        return instance
    if keys.subset(instance.poses).ids_are_times:
        return instance
    return replace(instance, times_ns=keys.times_ns[: len(instance.ids[: instance.world])])


def refuse_repeats(times: IntArray, instead: str) -> None:
    """Refuse a time that occurs twice by an InputError, which says what is possible instead."""
    order = np.argsort(times, kind="stable")
    again = (times[order[1:]] == times[order[:-1]]) & (times[order[1:]] != NO_TIME)
    if again.any():
        first, second = order[np.argmax(again) :][:2].tolist()
        said = f"timestamp {int(times[first]) / SECOND!r} appears twice"
        raise InputError(f"{said}, as numbers {first + 1} and {second + 1} of the file: {instead}")
