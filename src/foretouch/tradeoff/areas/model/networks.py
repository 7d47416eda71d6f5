# SPDX-License-Identifier: Apache-2.0
"""Networks of the area: how they are trained on a fold, and executed in other precisions and by other libraries."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from foretouch.learning.data import Fold
from foretouch.learning.data.training_set import TrainingSet
from foretouch.learning.training.contact import describe_objects
from foretouch.learning.training.learners import load_run_config
from foretouch.learning.training.supervised import train_network
from foretouch.models.calibration import load_calibration
from foretouch.models.card import read_card
from foretouch.models.network.checkpoint import Member, NetworkEstimator, load_network
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import Affine, FoldedNetwork, fold
from foretouch.models.network.networks import TouchNet
from foretouch.models.novelty import Fallback
from foretouch.models.registry import find_card
from foretouch.models.touch_model import Estimate, Estimator
from foretouch.tactile import MODALITIES, TactileRanges
from foretouch.tradeoff.area import Variant
from foretouch.tradeoff.areas.model.contact import Described
from foretouch.tradeoff.areas.model.variants import NETWORK, RECIPES
from foretouch.types import Cloud, Float64, Grasp

MEMBERS: Final = 2
"""Networks of the recipe of touchnet-v1 that are trained on each fold, of which an ensemble is made."""

PAPERS: Final = "papers"


def recipe_config(recipe: str) -> ModelConfig:
    """Architecture of one of `RECIPES`, or of `papers`: P2's width with all modalities at once."""
    run: Any = load_run_config(NETWORK)
    return ModelConfig() if recipe == PAPERS else run.model.updated(RECIPES[recipe])


def trained_rows(recipe: str, data: Described, one: Fold, variants: Sequence[Variant]) -> Iterator[tuple[str, Float64]]:
    """Train a recipe on a fold, and predict its test side by each variant of these networks.

    Yields:
        Name of a variant, and (T, 50) predictions [counts].
    """
    run: Any = load_run_config(NETWORK)
    config = recipe_config(recipe)
    train = [data.samples[k] for k in one.train]
    built = TrainingSet.build(train, config)
    count = MEMBERS if recipe == "touchnet" else 1
    nets = [train_network(built, np.arange(len(train)), run.train.replace(seed=seed)) for seed in range(count)]
    fallback = Fallback.fit(describe_objects(train), data.labels[one.train])
    for variant in variants:
        values = variant.values
        if values["kind"] != "network" or values.get("recipe", "touchnet") != recipe or values.get("separate"):
            continue
        if values.get("members", 1) > len(nets) or variant.missing:
            continue
        estimator = make_estimator(values, nets[: values.get("members", 1)], fallback)
        tested = [data.samples[k] for k in one.test]
        yield variant.name, np.concatenate([estimator.estimate(s.cloud, [s.grasp]).counts for s in tested])


def timed_estimator(values: Mapping[str, Any]) -> Estimator:
    """A network with the weights of touchnet-v1 if it has its shape, else with random ones, for its time."""
    recipe = values.get("recipe", "touchnet")
    path = find_card(NETWORK)
    _, fallback = load_calibration(path, read_card(path))
    assert fallback is not None  # noqa: S101  touchnet-v1 has one
    if values.get("separate"):
        config = recipe_config(recipe)
        nets = [_untrained(config.replace(outputs=(name,))) for name in MODALITIES]
        return NetworkEstimator([Member(net.config, fold(net)) for net in nets], fallback)
    if recipe != "touchnet":
        return make_estimator(values, [_untrained(recipe_config(recipe))], fallback)
    net, _ = load_network(path)
    return make_estimator(values, [net] * values.get("members", 1), fallback)


def _untrained(config: ModelConfig) -> TouchNet:
    torch.manual_seed(0)
    return TouchNet(config).eval()


def make_estimator(values: Mapping[str, Any], nets: Sequence[TouchNet], fallback: Fallback) -> Estimator:
    """The estimator of a variant from its trained networks."""
    changes = {key: values[name] for key, name in (("n_points", "points"), ("sampler", "sampler")) if name in values}
    parts: list[Estimator] = []
    for net in nets:
        config = net.config.replace(**changes)
        executed: Any = _executed(net, config, values.get("precision", "fp32"), values.get("backend", "torch"))
        parts.append(NetworkEstimator([Member(config, executed)], fallback))
    return parts[0] if len(parts) == 1 else _Mean(parts)


class _Mean:
    """The mean of several estimators."""

    def __init__(self, parts: Sequence[Estimator]) -> None:
        self._parts = list(parts)

    @property
    def ranges(self) -> TactileRanges:
        """Those of the first."""
        return self._parts[0].ranges

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`."""
        found = [part.estimate(cloud, grasps) for part in self._parts]
        return Estimate(np.mean([one.counts for one in found], axis=0), found[0].in_distribution)


def _executed(net: TouchNet, config: ModelConfig, precision: str, backend: str) -> Any:
    network = fold(net, "bfloat16" if precision == "bf16" else "float32")
    if backend != "torch":
        content = onnx_bytes(network, config)
        return _Onnx(content, precision) if backend == "ONNX Runtime" else _OpenVino(content)
    return _Int8(network) if precision == "int8" else network


class _Int8:
    """A folded network with dynamically quantised linear layers (torch); the last layer stays in float32."""

    def __init__(self, network: FoldedNetwork) -> None:
        import torch.ao.quantization

        quantised: Any = torch.ao.quantization.quantize_dynamic
        trunk = [part for layer in network.trunk for part in (_linear(layer), nn.ReLU())]
        first = Affine(torch.cat([network.first.weight, network.first_grasp], dim=1), network.first.bias)
        hidden = [part for layer in (first, *network.head[:-1]) for part in (_linear(layer), nn.ReLU())]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its end in a later torch
            self._trunk = quantised(nn.Sequential(*trunk), {nn.Linear}, torch.qint8)
            self._hidden = quantised(nn.Sequential(*hidden), {nn.Linear}, torch.qint8)
        self._last = network.head[-1]

    @torch.inference_mode()
    def features(self, points: Tensor) -> Tensor:
        features: Tensor = self._trunk(points).amax(dim=0)
        return features

    @torch.inference_mode()
    def regress(self, features: Tensor, grasps: Tensor) -> Tensor:
        inputs = torch.cat([features.expand(len(grasps), -1), grasps], dim=1)
        return self._last(self._hidden(inputs))


def _linear(layer: Affine) -> nn.Linear:
    made = nn.Linear(layer.weight.shape[1], layer.weight.shape[0])
    with torch.no_grad():
        made.weight.copy_(layer.weight)
        made.bias.copy_(layer.bias)
    return made


def onnx_bytes(network: FoldedNetwork, config: ModelConfig) -> bytes:
    """A folded network without T-Net as an ONNX model: (N, C) points and (K, G) grasps to (K, M) counts."""
    from onnx import TensorProto, checker, helper, numpy_helper

    nodes: list[Any] = []
    stored: list[Any] = []

    def constant(name: str, value: Tensor) -> str:
        stored.append(numpy_helper.from_array(np.ascontiguousarray(value.numpy()), name))
        return name

    def add(kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"{kind}_{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def affine(x: str, layer: Affine, name: str) -> str:
        return add("Add", add("MatMul", x, constant(f"{name}_w", layer.weight.T)), constant(f"{name}_b", layer.bias))

    x = "points"
    for k, layer in enumerate(network.trunk):
        x = add("Relu", affine(x, layer, f"trunk{k}"))
    stored.append(numpy_helper.from_array(np.zeros(1, np.int64), "rows"))
    pooled = add("ReduceMax", x, "rows", keepdims=1)
    shared = affine(pooled, network.first, "first")
    own = add("MatMul", "grasps", constant("first_grasp", network.first_grasp.T))
    x = add("Relu", add("Add", own, shared))
    for k, layer in enumerate(network.head):
        x = affine(x, layer, f"head{k}")
        if k + 1 < len(network.head):
            x = add("Relu", x)
    nodes.append(helper.make_node("Identity", [x], ["counts"]))
    float32 = TensorProto.FLOAT
    inputs = [
        helper.make_tensor_value_info("points", float32, ["N", config.channel_count]),
        helper.make_tensor_value_info("grasps", float32, ["K", config.grasp_size]),
    ]
    outputs = [helper.make_tensor_value_info("counts", float32, ["K", config.output_size])]
    graph = helper.make_graph(nodes, "touch", inputs, outputs, stored)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


class _Onnx:
    """An ONNX model in ONNX Runtime, on one thread."""

    def __init__(self, content: bytes, precision: str) -> None:
        import onnxruntime

        if precision == "int8":
            content = _quantised(content)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])

    def features(self, points: Tensor) -> Tensor:
        return points

    def regress(self, points: Tensor, grasps: Tensor) -> Tensor:
        (counts,) = self._session.run(None, {"points": points.numpy(), "grasps": grasps.numpy()})
        return torch.from_numpy(counts)


def _quantised(content: bytes) -> bytes:
    import tempfile
    from pathlib import Path

    from onnxruntime.quantization import QuantType, quantize_dynamic

    with tempfile.TemporaryDirectory() as folder:
        before, after = Path(folder) / "before.onnx", Path(folder) / "after.onnx"
        before.write_bytes(content)
        logging.getLogger().setLevel(logging.ERROR)  # it recommends a step for convolutions
        quantize_dynamic(before, after, weight_type=QuantType.QInt8)
        return after.read_bytes()


class _OpenVino:
    """An ONNX model in OpenVINO, in float32 on one thread."""

    def __init__(self, content: bytes) -> None:
        import openvino

        settings = {"INFERENCE_NUM_THREADS": 1, "INFERENCE_PRECISION_HINT": "f32", "PERFORMANCE_HINT": "LATENCY"}
        core = openvino.Core()
        self._request = core.compile_model(core.read_model(content), "CPU", settings).create_infer_request()

    def features(self, points: Tensor) -> Tensor:
        return points

    def regress(self, points: Tensor, grasps: Tensor) -> Tensor:
        found = self._request.infer({"points": points.numpy(), "grasps": grasps.numpy()})
        return torch.from_numpy(np.array(found["counts"]))
