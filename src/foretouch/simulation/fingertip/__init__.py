# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP fingertip: from contact to counts, and what the sensor adds to them.

Each effect is a pure function of its settings, its input and, where it is random, a generator given as an argument.
"""

from foretouch.simulation.fingertip.ageing import (
    CreepConfig,
    SlipConfig,
    TemperatureConfig,
    creep,
    kill_electrodes,
    slip_path,
    temperature_drift,
    warming,
)
from foretouch.simulation.fingertip.fingertip import (
    MIDDLE_FINGER,
    THUMB,
    ElectrodeConfig,
    Finger,
    FingerConfig,
    FluidConfig,
    counts_at,
    displaced_volume,
    draw_finger,
    electrode_counts,
    electrode_weights,
    pdc_counts,
    skin_approach,
)
from foretouch.simulation.fingertip.noise import (
    NoiseConfig,
    ScanConfig,
    SteadyNoise,
    fresh_samples,
    hold,
    steady_noise,
    wander,
    white_noise,
)
from foretouch.simulation.fingertip.reading import FingertipConfig, Reading, quantise, read_contact, rest_reading

__all__ = [
    "MIDDLE_FINGER",
    "THUMB",
    "CreepConfig",
    "ElectrodeConfig",
    "Finger",
    "FingerConfig",
    "FingertipConfig",
    "FluidConfig",
    "NoiseConfig",
    "Reading",
    "ScanConfig",
    "SlipConfig",
    "SteadyNoise",
    "TemperatureConfig",
    "counts_at",
    "creep",
    "displaced_volume",
    "draw_finger",
    "electrode_counts",
    "electrode_weights",
    "fresh_samples",
    "hold",
    "kill_electrodes",
    "pdc_counts",
    "quantise",
    "read_contact",
    "rest_reading",
    "skin_approach",
    "slip_path",
    "steady_noise",
    "temperature_drift",
    "wander",
    "warming",
    "white_noise",
]
