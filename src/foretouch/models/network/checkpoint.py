# SPDX-License-Identifier: Apache-2.0
"""Files of networks, and prediction by a network with all four modalities.

cloud ─ sample, unit sphere ─ features (once) ─┐
K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► fallback on novel objects
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import card_sensor, load_calibration, read_card
from foretouch.models.files import read_tensors
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import FoldedNetwork, fold, tensor_shapes
from foretouch.models.network.preparation import LengthRangeCheck, grasp_lengths, prepare_cloud, prepare_grasps
from foretouch.models.novelty import Fallback, object_sizes
from foretouch.models.predictor import Estimate
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import BIOTAC, MODALITIES, TOUCH_SIZE, Ranges
from foretouch.types import AnyArray, Cloud, Grasp, Plane

_FORMER: Final = ("sampler", "precision")  # settings in cards of earlier versions, of which a prediction never depended


@dataclass(frozen=True, eq=False)
class NetworkEstimator:
    """A network that predicts all four modalities; immutable, so threads may share it.

    Raises:
        ModelError: If a modality is not predicted.
    """

    config: ModelConfig
    network: FoldedNetwork
    lengths: LengthRangeCheck | None = None  # ranges over its training samples; None if its card holds none
    fallback: Fallback | None = None  # for objects unlike the training objects; None if it was not stored

    def __post_init__(self) -> None:
        missing = [name for name in MODALITIES if name not in self.config.outputs]
        if missing:
            raise ModelError(f"outputs: {', '.join(missing)}: not predicted by this network")

    @property
    def ranges(self) -> Ranges:
        """Ranges outside which a predicted value is flagged."""
        return self.config.ranges.ranges

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict (K, D) counts of grasps on a cloud, and whether they are in the distribution of training.

        Out of distribution where a length leaves its range or the object's sizes are novel.
        """
        del table  # networks look at the cloud as the camera does
        counts, familiar = np.empty((len(grasps), TOUCH_SIZE)), np.ones(len(grasps), np.bool_)
        prepared = prepare_cloud(cloud, self.config)
        features = self.network.features(prepared.points)
        inputs = prepare_grasps(grasps, prepared.frame, self.config)
        counts[:, BIOTAC.columns(self.config.outputs)] = self.network.regress(features, inputs)
        if self.lengths is not None:
            familiar &= self.lengths.within(grasp_lengths(prepared, grasps))
        if self.fallback is not None:
            counts, inside = self.fallback.fade(counts, object_sizes(cloud.xyz)[None])
            familiar &= inside
        return Estimate(counts, familiar)


def load_model(card_path: Path, card: Mapping[str, Any]) -> TouchModel:
    """Return the model of one network, with its calibration.

    Raises:
        ModelError: As `load_network`; if a file of the calibration is damaged, a modality is not predicted, or the
            card is of another sensor than the BioTac SP.
    """
    if (sensor := card_sensor(card, card_path)).channels != BIOTAC:
        raise ModelError(f"{card_path}: sensor: networks are for {BIOTAC.sensor}, not {sensor.config.name}")
    calibration, fallback = load_calibration(card_path, card, BIOTAC)
    config, tensors, card = load_network(card_path)
    try:
        lengths = None if card["familiar"] is None else LengthRangeCheck.from_card(card["familiar"])
        return TouchModel(NetworkEstimator(config, fold(config, tensors), lengths, fallback), card, calibration)
    except ModelError as err:
        raise ModelError(f"{card_path}: {err}") from err


def load_network(card_path: str | Path) -> tuple[ModelConfig, dict[str, AnyArray], dict[str, Any]]:
    """Return the architecture of a card's network, its checked weights by name, and the card.

    Raises:
        ModelError: Names the file and the field: a card of another kind, or weights that are absent, damaged, with
            another hash than the card's, of another architecture, or not finite.
    """
    card_path = Path(card_path)
    card = read_card(card_path)
    if card["kind"] != "network":
        raise ModelError(f"{card_path}: kind: {card['kind']!r} is not network")
    try:
        settings = {name: value for name, value in card["config"].items() if name not in _FORMER}
        config = ModelConfig.from_mapping(settings, f"{card_path}: config")
    except ConfigError as err:
        raise ModelError(str(err)) from err
    weights, tensors = read_tensors(card_path, card)
    _check_tensors(weights, tensor_shapes(config), tensors)
    return config, tensors, card


def _check_tensors(path: Path, shapes: Mapping[str, tuple[int, ...]], tensors: Mapping[str, AnyArray]) -> None:
    """Check names, shapes, dtypes and finiteness, so that an error names the field."""
    for key in sorted(shapes.keys() | tensors.keys()):
        if key not in tensors:
            raise ModelError(f"{path}: {key}: is missing; the card describes another architecture")
        if key not in shapes:
            raise ModelError(f"{path}: {key}: is not part of the card's architecture")
        own, dtype = tensors[key], np.dtype(np.int64 if key.endswith("num_batches_tracked") else np.float32)
        if own.shape != shapes[key] or own.dtype != dtype:
            raise ModelError(
                f"{path}: {key}: {own.dtype} {tuple(own.shape)} is not {dtype} {shapes[key]} of the card's architecture"
            )
        if not np.isfinite(own).all():
            raise ModelError(f"{path}: {key}: holds a value that is not finite")
