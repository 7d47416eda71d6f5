# SPDX-License-Identifier: Apache-2.0
"""From a solved contact to what the fingertip reads: the one function for all contacts."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, TactileError
from foretouch.simulation.contact.pad import PadConfig, PadWindow
from foretouch.simulation.contact.problem import ContactSolution
from foretouch.simulation.fingertip.fingertip import (
    ElectrodeConfig,
    Finger,
    FluidConfig,
    displaced_volume,
    electrode_counts,
    electrode_weights,
    pdc_counts,
    skin_approach,
)
from foretouch.tactile import FULL_SCALE
from foretouch.types import Float64

_LOWEST_ELECTRODE: Final = 0


@dataclass(frozen=True, kw_only=True)
class FingertipConfig(Settings):
    """How a fingertip turns contact into counts.

    Raises:
        ConfigError: If the lowest PDC is not below the highest.
    """

    electrodes: ElectrodeConfig = ElectrodeConfig()
    fluid: FluidConfig = FluidConfig()
    pdc_lowest: int = setting(0, "Lowest PDC the converter gives", unit="counts", minimum=0, maximum=FULL_SCALE)
    pdc_highest: int = setting(
        FULL_SCALE, "Highest PDC the converter gives", unit="counts", minimum=0, maximum=FULL_SCALE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pdc_lowest >= self.pdc_highest:
            raise ConfigError(
                f"FingertipConfig.pdc_lowest: {self.pdc_lowest} is not below pdc_highest {self.pdc_highest}"
            )


@dataclass(frozen=True, eq=False)
class Reading:
    """One fingertip before noise and rounding.

    Attributes:
        pdc: Static pressure [counts].
        electrodes: (24,) float64 [counts].
    """

    pdc: float
    electrodes: Float64


def rest_reading(finger: Finger) -> Reading:
    """What the fingertip reads without contact."""
    return Reading(finger.pdc_rest, finger.electrode_rest.copy())


def read_contact(
    config: FingertipConfig, pad: PadConfig, finger: Finger, window: PadWindow, solution: ContactSolution
) -> Reading:
    """What the fingertip reads in contact; without force, its rest to the bit.

    Args:
        config: How contact becomes counts.
        pad: Shape of the pad and of the window.
        finger: Its rest and gain.
        window: Where it is touched.
        solution: Of the contact; the first of its layers is the skin.

    Raises:
        ContactError: If the solution is on another grid.
    """
    if solution.force_n == 0.0:
        return rest_reading(finger)
    skin = solution.displacement[0]
    volume = displaced_volume(config.fluid, skin, pad.step_m**2)
    weights = electrode_weights(config.electrodes, pad, window.frame, window.points)
    approach = skin_approach(config.electrodes, weights, skin, volume)
    electrodes = electrode_counts(config.electrodes, approach, finger.electrode_rest, finger.electrode_gain)
    return Reading(pdc_counts(config.fluid, window.frame, volume, finger.pdc_rest, finger.pdc_gain), electrodes)


def quantise(
    config: FingertipConfig, pdc: npt.ArrayLike, electrodes: npt.ArrayLike
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Round and clip as the 12-bit converter does: electrodes to 0..4095, PDC to its range.

    Args:
        config: The range of PDC.
        pdc: (...) counts.
        electrodes: (..., 24) counts.

    Raises:
        TactileError: If a value is not finite: a converter has no such count.
    """
    rounded = []
    limits = ((pdc, config.pdc_lowest, config.pdc_highest), (electrodes, _LOWEST_ELECTRODE, FULL_SCALE))
    for name, (values, low, high) in zip(("pdc", "electrodes"), limits, strict=True):
        counts = np.asarray(values, np.float64)
        if not np.isfinite(counts).all():
            raise TactileError(f"{name}: {np.count_nonzero(~np.isfinite(counts))} values are not finite")
        rounded.append(np.clip(np.rint(counts), low, high).astype(np.int64))
    return rounded[0], rounded[1]
