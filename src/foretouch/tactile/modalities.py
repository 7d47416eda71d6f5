# SPDX-License-Identifier: Apache-2.0
"""The four modalities of the papers and their places in the vector of 50 counts.

P2 predicts PDC_TH, PDC_MF (one value each), E_TH and E_MF (24 electrodes each), in that order here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError
from foretouch.types import ELECTRODES

__all__ = ["MODALITIES", "columns", "modality_size"]

MODALITIES: Final = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")
_SLICES: Final = {
    "PDC_TH": slice(0, 1),
    "PDC_MF": slice(1, 2),
    "E_TH": slice(2, 2 + ELECTRODES),
    "E_MF": slice(2 + ELECTRODES, 2 + 2 * ELECTRODES),
}


def modality_size(modality: str) -> int:
    """Number of values of one modality: 1 or 24.

    Raises:
        TactileError: If there is no such modality.
    """
    place = _place(modality)
    return int(place.stop - place.start)


def columns(modalities: Sequence[str]) -> npt.NDArray[np.intp]:
    """Where the values of some modalities stand in `Touch.vector()`.

    Args:
        modalities: Names out of `MODALITIES`, in any order.

    Returns:
        (M,) indices below 50, in the order asked for.

    Raises:
        TactileError: If there is no such modality.
    """
    return np.concatenate(
        [np.arange(_place(name).start, _place(name).stop, dtype=np.intp) for name in modalities]
        or [np.empty(0, np.intp)]
    )


def _place(modality: str) -> slice:
    try:
        return _SLICES[modality]
    except KeyError:
        raise TactileError(f"modality: {modality!r} is none of {', '.join(MODALITIES)}") from None
