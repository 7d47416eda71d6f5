# SPDX-License-Identifier: Apache-2.0
"""Label images of scenes: the truth, and what each method finds, in the colour of the true object that it is paired with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.clutter.metrics import pairs
from foretouch.types import Float64, Int32

_COLOURS: Final = np.array([
    [0.93, 0.93, 0.93], [0.20, 0.47, 0.71], [0.89, 0.47, 0.20], [0.30, 0.62, 0.35], [0.78, 0.25, 0.30], [0.55, 0.42, 0.70],
    [0.58, 0.42, 0.35], [0.85, 0.55, 0.75], [0.45, 0.45, 0.45], [0.72, 0.70, 0.20], [0.25, 0.70, 0.75],
])  # fmt: skip
_MARGIN_PX: Final = 12


@dataclass(frozen=True, eq=False)
class Shown:
    """One row of the picture."""

    title: str  # of the scene
    true: Int32  # (H, W) int32
    found: dict[str, Int32]  # (H, W) int32 by method


def draw(rows: Sequence[Shown], path: Path) -> None:
    """Draw a row for each scene."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    methods = list(rows[0].found)
    figure, axes = plt.subplots(
        len(rows), 1 + len(methods), figsize=(2.4 * (1 + len(methods)), 1.8 * len(rows)), squeeze=False
    )
    for row, line in zip(rows, axes, strict=True):
        window = _window(row.true)
        images = {"true": row.true, **row.found}
        for (name, labels), axis in zip(images.items(), line, strict=True):
            coloured = labels if name == "true" else renamed(labels, row.true)
            axis.imshow(coloured_image(coloured)[window], interpolation="nearest")
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_title(row.title if name == "true" else name, fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def renamed(found: Int32, true: Int32) -> Int32:
    """The labels of the true objects that predictions are paired with, and further numbers for those without."""
    result = np.zeros(found.shape, np.int32)
    partner = pairs(found, true)
    spare = int(true.max(initial=0)) + 1
    for label in np.unique(found[found > 0]):
        if int(label) not in partner:
            partner[int(label)], spare = spare, spare + 1
        result[found == label] = partner[int(label)]
    return result


def coloured_image(labels: Int32) -> Float64:
    """(H, W, 3) float64: grey where there is no object."""
    index = np.where(labels > 0, 1 + (labels - 1) % (len(_COLOURS) - 1), 0)
    return np.asarray(_COLOURS[index], np.float64)


def _window(labels: Int32) -> tuple[slice, slice]:
    v, u = np.nonzero(labels)
    return tuple(slice(max(0, int(one.min()) - _MARGIN_PX), int(one.max()) + _MARGIN_PX) for one in (v, u))  # type: ignore[return-value]
