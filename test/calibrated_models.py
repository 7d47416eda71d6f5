# SPDX-License-Identifier: Apache-2.0
"""Small calibrated models: their predictions are arbitrary, their adaptation to tare and touches is real."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.ensemble import ExtraTreesRegressor

from foretouch.models.calibration import GROUPS, Calibration, CalibrationGroup
from foretouch.models.contact.estimator import ContactEstimator, NoveltyDetector, save_contact
from foretouch.models.contact.features import CONDITIONS, FEATURES
from foretouch.models.contact.regressors import Forest, KernelRegression
from foretouch.models.novelty import standardisation
from foretouch.tactile import BIOTAC, P2_RANGES
from foretouch.types.channels import Channels

FACTS = {
    "level": 0.9,
    "regimes": {name: {"objects": 4, "samples": 40, "coverage": {"PDC_TH": {"mean": 0.91}}} for name in GROUPS},
}
REST = np.concatenate([[2600.0, 1700.0], np.full(24, 3100.0), np.full(24, 3300.0)])


def make_calibration(seed: int = 0, channels: Channels = BIOTAC, rest: np.ndarray = REST) -> Calibration:
    """A calibration whose groups differ, and in which all values are correlated."""
    rng = np.random.default_rng(seed)
    groups, factors = {}, rng.normal(size=(len(rest), 10))
    for k, name in enumerate(GROUPS, 1):
        between = 40.0 * k * (factors @ factors.T + np.eye(len(rest)))
        within = rng.uniform(300.0, 900.0, len(rest))
        spread = np.diag(between) + within
        shrinkage = rng.uniform(0.2, 1.0, len(rest))
        groups[name] = CalibrationGroup(channels, between, within, shrinkage, spread, (1.6 + 0.1 * k) * np.sqrt(spread))
    return Calibration(channels, rest, groups)


def make_tracked_calibration() -> Calibration:
    """The same with the parameters of a tracker, whose sensors drift by as much as objects differ."""
    calibration = make_calibration()
    parameters = calibration.tracker_parameters
    lasting = parameters.object[0] + parameters.slow
    objects = np.array([lasting, parameters.object[1]])
    tracker = replace(parameters, slow=lasting, fast=0.2 * lasting, object=objects, alarm=np.full((2, 2), 1e6))
    return replace(calibration, tracker=tracker)


def save_calibrated_network(folder: Path, calibration: Calibration | None = None) -> str:
    """A network with random weights and a calibration; path of its card."""
    return save_small_network(folder, "calibrated", REST, (calibration or make_calibration(), FACTS))


def save_small_network(
    folder: Path, name: str, mean: np.ndarray, calibration: Any = None, channels: str = "xyz"
) -> str:
    """A network with random weights whose predictions are around a mean; path of its card."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch_lab.learning.network.networks import TouchNet, save_network

    torch.manual_seed(0)
    widths = {"trunk_widths": (8, 16, 32), "tnet_widths": (8, 8, 16, 8, 8), "head_widths": (16, 8)}
    config = ModelConfig(n_points=64, channels=channels, **widths)
    net = TouchNet(config)
    net.set_scaling(torch.from_numpy(mean).float(), torch.linspace(20, 300, config.output_size))
    return str(save_network(folder, name, net.eval(), {}, calibration))


def save_calibrated_contact(folder: Path) -> str:
    """A contact model fitted to nothing, with a calibration; path of its card."""
    rng = np.random.default_rng(0)
    described, labels = rng.normal(size=(40, len(FEATURES))), rng.normal(size=(40, 50))
    rows = described[:, len(CONDITIONS) :]
    outputs = {"together": np.arange(50)} | BIOTAC.modality_columns
    forests = {}
    for name, index in outputs.items():
        target = labels[:, index] if len(index) > 1 else labels[:, index[0]]
        fitted = ExtraTreesRegressor(3, min_samples_leaf=3, random_state=0).fit(rows, target)
        forests[name] = Forest.from_trees([tree.tree_ for tree in fitted.estimators_])
    centre, scale = standardisation(rows)
    known = ((rows - centre) / scale).astype(np.float32)
    kernel = KernelRegression(centre, scale, known, 0.1 * labels.astype(np.float32), np.array(2.0))
    novelty = NoveltyDetector.fit(described, ["a", "b"] * 20)
    estimator = ContactEstimator(forests, kernel, novelty, REST, np.full(50, 60.0), np.ones(4), P2_RANGES.ranges)
    facts = {"summary": "fitted to nothing"}
    return str(save_contact(folder, "contact", estimator, facts, (make_calibration(), FACTS)))
