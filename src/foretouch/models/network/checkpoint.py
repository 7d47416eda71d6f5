# SPDX-License-Identifier: Apache-2.0
"""Files of networks, and prediction of all four modalities by one network or by several.

cloud ─ sample, unit sphere ─ features (once) ─┐
K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► fallback on novel objects

Networks that sample a cloud in the same way share the sample.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ModelError
from foretouch.models.card import NETWORKS, card_sensor, load_calibration, read_card, save_model
from foretouch.models.files import read_tensors, under
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import FoldedNetwork, fold, tensor_shapes
from foretouch.models.network.preparation import (
    LengthRangeCheck,
    PreparedCloud,
    grasp_lengths,
    prepare_cloud,
    prepare_grasps,
)
from foretouch.models.novelty import Fallback, object_sizes
from foretouch.models.predictor import Estimate
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import BIOTAC, MODALITIES, TOUCH_SIZE, Ranges
from foretouch.types import AnyArray, Cloud, Grasp, Plane

_FORMER: Final = ("sampler", "precision")  # settings in cards of earlier versions, of which a prediction never depended


@dataclass(frozen=True, eq=False)
class Network:
    """One network, which predicts some of the modalities."""

    config: ModelConfig
    folded: FoldedNetwork
    lengths: LengthRangeCheck | None = None  # ranges over its training samples; None if its card holds none


@dataclass(frozen=True, eq=False)
class NetworkPredictor:
    """Networks that predict all four modalities together; immutable, so threads may share it.

    Raises:
        ModelError: If a modality is predicted by none of them, or by two.
    """

    networks: Sequence[Network]
    fallback: Fallback | None = None  # for objects unlike the training objects; None if it was not stored

    def __post_init__(self) -> None:
        outputs = [name for network in self.networks for name in network.config.outputs]
        if missing := [name for name in MODALITIES if name not in outputs]:
            cure = "train with model.outputs=each, or join networks: --model a,b,c,d"
            raise ModelError(f"outputs: {', '.join(missing)}: not predicted by this network; {cure}")
        if twice := [name for name in MODALITIES if outputs.count(name) > 1]:
            raise ModelError(f"outputs: {', '.join(twice)}: predicted by two networks; leave one out")

    @property
    def uses_colours(self) -> bool:
        """Whether a network takes the colours of the points."""
        return any(network.config.channels == "xyz+rgb" for network in self.networks)

    @cached_property
    def ranges(self) -> Ranges:
        """Ranges outside which a predicted value is flagged."""
        limits = {name: one.config.ranges.ranges.of(name) for one in self.networks for name in one.config.outputs}
        return Ranges(BIOTAC, tuple(limits[name] for name in MODALITIES))

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp], table: Plane | None = None) -> Estimate:
        """Predict (K, D) counts of grasps on a cloud, and whether they resemble the training.

        They are unfamiliar where a length leaves its range or the object's sizes are novel.
        """
        del table  # networks look at the cloud as the camera does
        counts, familiar = np.empty((len(grasps), TOUCH_SIZE)), np.ones(len(grasps), np.bool_)
        sampled: dict[tuple[int, str], PreparedCloud] = {}
        for network in self.networks:
            config = network.config
            sampling = config.n_points, config.channels
            if sampling not in sampled:
                sampled[sampling] = prepare_cloud(cloud, config)
            prepared = sampled[sampling]
            inputs = prepare_grasps(grasps, prepared.frame, config)
            features = network.folded.features(prepared.points)
            counts[:, BIOTAC.columns(config.outputs)] = network.folded.regress(features, inputs)
            if network.lengths is not None:
                familiar &= network.lengths.within(grasp_lengths(prepared, grasps))
        if self.fallback is not None:
            counts, inside = self.fallback.fade(counts, object_sizes(cloud.xyz)[None])
            familiar &= inside
        return Estimate(counts, familiar)


def network_key(config: ModelConfig) -> str:
    """Return the name of a network in the files of a model of several."""
    return "+".join(config.outputs)


def load_model(card_path: Path, card: Mapping[str, Any]) -> TouchModel:
    """Return the model of one network or of several, with its calibration.

    Raises:
        ModelError: As `load_network`; if a file of the calibration is damaged, a modality is not predicted, or the
            card is of another sensor than the BioTac SP.
    """
    if (sensor := card_sensor(card, card_path)).channels != BIOTAC:
        raise ModelError(f"{card_path}: sensor: networks are for {BIOTAC.sensor}, not {sensor.config.name}")
    calibration, fallback = load_calibration(card_path, card, BIOTAC)
    try:
        networks = [_folded(*parts) for parts in _networks(card_path, card)]
        return TouchModel(NetworkPredictor(networks, fallback), card, calibration)
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
    ((config, tensors, _),) = _networks(card_path, card)
    return config, tensors, card


def join(card_paths: Sequence[Path], folder: Path) -> Path:
    """Write networks for different modalities as one model without a calibration, and return the path of its card.

    Args:
        card_paths: Cards of networks, which predict each modality once.
        folder: Where the files are written.

    Raises:
        ModelError: As `load_model`, or names a card of another kind.
    """
    cards = [read_card(path) for path in card_paths]
    for path, card in zip(card_paths, cards, strict=True):
        if card["kind"] not in ("network", NETWORKS):
            raise ModelError(f"{path}: kind: {card['kind']} cannot be joined, as networks for different modalities can")
    parts = [part for path, card in zip(card_paths, cards, strict=True) for part in _networks(path, card)]
    NetworkPredictor([_folded(*part) for part in parts])  # which refuses a modality that is missing or twice
    keys = [network_key(config) for config, _, _ in parts]
    tensors = {f"{key}/{name}": value for key, part in zip(keys, parts, strict=True) for name, value in part[1].items()}
    data: dict[str, Any] = {}
    hashes = [card["data"].get("sample_hashes") for card in cards]
    if all(hashes):
        trained = {text[k : k + 16] for text in hashes for k in range(0, len(text), 16)}
        data = {"sample_hashes": "".join(sorted(trained)), "samples": len(trained)}
    names = [card["name"] for card in cards]
    facts = {
        "summary": f"joined of {', '.join(names)}",
        "config": {key: config.to_mapping() for key, (config, _, _) in zip(keys, parts, strict=True)},
        "familiar": {key: lengths for key, (_, _, lengths) in zip(keys, parts, strict=True)},
        "data": data,
        "limits": ["Joined of networks, so that their errors together are not known; foretouch.calibrate finds them."],
        "joined": {card["name"]: card["sha256"] for card in cards},
    }
    short = hashlib.sha256("".join(card["sha256"] for card in cards).encode()).hexdigest()[:8]
    return save_model(folder / f"joined-{short}.json", NETWORKS, tensors, facts)


_Parts = tuple[ModelConfig, dict[str, AnyArray], Mapping[str, Any] | None]
"""Of a network: its architecture, its checked weights by name, and the ranges of its lengths as in a card."""


def _networks(card_path: Path, card: Mapping[str, Any]) -> list[_Parts]:
    """Return the networks of a card, whose weights are checked."""
    weights, tensors = read_tensors(card_path, card)
    if card["kind"] != NETWORKS:
        return [(_config(card["config"], f"{card_path}: config", weights, tensors), tensors, card["familiar"])]
    found = []
    for key, settings in card["config"].items():
        own = under(f"{key}/", tensors)
        config = _config(settings, f"{card_path}: config: {key}", weights, own)
        found.append((config, own, card["familiar"].get(key)))
    return found


def _config(settings: Any, where: str, weights: Path, tensors: Mapping[str, AnyArray]) -> ModelConfig:
    """Return the architecture of a network whose weights fit it."""
    try:
        mapping = {name: value for name, value in settings.items() if name not in _FORMER}
        config = ModelConfig.from_mapping(mapping, where)
        shapes = tensor_shapes(config)
    except (ConfigError, AttributeError) as err:
        raise ModelError(str(err)) from err
    _check_tensors(weights, shapes, tensors)
    return config


def _folded(config: ModelConfig, tensors: Mapping[str, AnyArray], lengths: Mapping[str, Any] | None) -> Network:
    return Network(config, fold(config, tensors), None if lengths is None else LengthRangeCheck.from_card(lengths))


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
