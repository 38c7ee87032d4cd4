"""Information matrices as files state them: themselves, their square roots or their inverses."""

from __future__ import annotations

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.edges import FAR, in_range, symmetric
from certpgo.io.exact.information import InformationLayout, position_weight
from certpgo.io.format import WeightsAre
from certpgo.linalg.arrays import FloatArray

#: Of positions: the upper triangle row by row.
POSITIONS = {
    2: InformationLayout(((0, 1), (1, 2))),
    3: InformationLayout(((0, 1, 2), (1, 3, 4), (2, 4, 5))),
}


def as_information(
    texts: list[bytes], layout: InformationLayout, weights_are: WeightsAre
) -> list[bytes]:
    """The numbers of information matrices, from those of what a file states instead.

    Parameters
    ----------
    texts : the numbers of each matrix, separated by blanks; square roots are upper triangular, with
        Omega = S^T S

    Raises
    ------
    InputError
        Numbers that are none, or too few or many; a covariance that is not positive definite; or
        a larger matrix, of similarities.
    """
    if weights_are == "information":
        return texts
    if layout.count:
        raise InputError(f"of similarities, numbers are read as information, not as {weights_are}")
    place, known = np.array(layout.positions), dict.fromkeys(texts, b"")
    first = [divmod(int(np.flatnonzero(place == k)[0]), len(place)) for k in range(layout.size)]
    for text in known:
        stated = _numbers(text, layout)[place]
        if weights_are == "covariance":
            if not np.linalg.eigvalsh(stated)[0] > 0.0:
                raise InputError("a covariance is not positive definite")
            information = symmetric(np.linalg.inv(stated)[None])[0]
        else:
            root = np.triu(stated)
            information = root.T @ root
        known[text] = b" ".join(repr(float(information[at])).encode() for at in first)
    return [known[text] for text in texts]


def position_weights(
    d: int, texts: list[bytes], weights_are: WeightsAre
) -> tuple[FloatArray, FloatArray]:
    """Weights tau = d / tr(Omega^-1) (k,) of positions and their matrices (k, d, d).

    Parameters
    ----------
    texts : as of `as_information`; 1 and the identity for those that are empty

    Raises
    ------
    InputError
        As `as_information`; information that is not positive definite, or a weight out of range.
    """
    layout = POSITIONS[d]
    distinct = list(dict.fromkeys(texts))
    stated = as_information([text for text in distinct if text], layout, weights_are)
    matrices = [_numbers(text, layout)[np.array(layout.positions)] for text in stated]
    of_text = dict(zip([text for text in distinct if text], matrices, strict=True))
    of_text[b""] = np.eye(d)
    weights = {b"": 1.0}
    for text, said in zip([text for text in distinct if text], stated, strict=True):
        weights[text] = _weight(said, layout)
    tau = np.array([weights[text] for text in texts])
    return tau, np.array([of_text[text] for text in texts])


def _weight(text: bytes, layout: InformationLayout) -> float:
    tau = position_weight(text.decode("ascii", "replace"), layout)
    if not in_range(np.array(tau)):
        raise InputError(f"information must give weights between {1.0 / FAR:.2g} and {FAR:.2g}")
    return tau


def _numbers(text: bytes, layout: InformationLayout) -> FloatArray:
    words = text.split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise InputError("information must be decimal numbers") from None
    if len(values) != layout.size:
        raise InputError(f"{layout.size} numbers of information expected, not {len(words)}")
    if not np.isfinite(values).all() or b"_" in text:
        found = next(word for word in words if b"_" in word or not np.isfinite(float(word)))
        raise InputError(f"finite numbers of information expected, not {found.decode()}")
    return values
