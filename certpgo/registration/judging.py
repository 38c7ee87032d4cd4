"""Signs of a wrong camera or depth scale, in depths and in steps between neighbouring frames."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import InputError, InputNotice
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.pairs import FramePair

#: Share of inliers, and residuals of keypoints and of edges over their noise, that are suspicious.
FEW_INLIERS, LOUD = 0.65, 1.5
#: Squared disagreement of keypoints and clouds over what both state, of half the steps, that is
#: suspicious: 1 with the right camera, 5 to 16 with a focal length 1.2 times too long.
DISAGREEING = 4.0
#: Shares of depths past the cutoff at which to warn, and to refuse.
MUCH_PAST, ALL_PAST = 0.5, 0.9
#: Median depths below this are suspicious, metres.
CLOSE = 0.25


def about_depths(depth: NDArray[np.float32], cutoff: float) -> FloatArray:
    """The share of depths past the cutoff, and the median depth."""
    known = depth[depth > 0.0]
    if not len(known):
        return np.zeros(2)
    return np.array([np.mean(known > cutoff), np.median(known)])


def judge_depths(name: str, about: Sequence[FloatArray], cutoff: float) -> None:
    """Refuse, or warn of, depths that a wrong scale explains.

    Parameters
    ----------
    name : of the frames
    about : of each frame, `about_depths`
    cutoff : largest depth, metres

    Raises
    ------
    InputError
        Nearly all depths are past the cutoff.
    """
    if not about:
        return
    past, middle = np.median(about, axis=0)
    said = f"{name}: {100.0 * past:.0f} % of the depths are past the cutoff of "
    said += f"{cutoff:g} m: is the depth scale right?"
    if past > ALL_PAST:
        raise InputError(said)
    if past > MUCH_PAST:
        warnings.warn(said, InputNotice, stacklevel=4)
    if 0.0 < middle < CLOSE:
        said = f"{name}: half of the depths are below {middle:.2g} m"
        warnings.warn(f"{said}: is the depth scale right?", InputNotice, stacklevel=4)


def judge_steps(
    name: str, steps: Sequence[FramePair], missing: int, *, scaled: bool = False
) -> None:
    """Warn of what a wrong camera or depth scale explains, and of frames that nothing joins.

    Parameters
    ----------
    name : of the frames
    steps : the pairs of odometry
    missing : how many usable frames are joined to no others
    scaled : whether depths have an unknown factor
    """
    if missing:
        few = counted(missing, "frame{s}")
        said = f"{name}: {few} could not be joined to the others, and are left out"
        warnings.warn(said, InputNotice, stacklevel=3)
    shares = np.median([pair.share for pair in steps])
    noise = np.median([pair.chi2 for pair in steps])
    if shares < FEW_INLIERS or noise > LOUD:
        said = f"{100.0 * shares:.0f} % of the matches of neighbouring frames agree"
        said = f"{name}: only {said}, with {np.sqrt(noise):.2g} times the noise of depth cameras"
        asked = "is the camera right, and are depths right but for a factor"
        asked = asked if scaled else "are camera and depth scale right"
        warnings.warn(f"{said}: {asked}?", InputNotice, stacklevel=3)
    excess = np.median([pair.excess for pair in steps])
    if excess > DISAGREEING:
        said = f"{name}: colour and depth disagree on the motion between neighbouring frames, by"
        said = f"{said} {np.sqrt(excess):.2g} times what they state: is the camera right, and are"
        warnings.warn(f"{said} both images of one camera and time?", InputNotice, stacklevel=3)
