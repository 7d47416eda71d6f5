# SPDX-License-Identifier: Apache-2.0
"""Eight slim runs trained together against one after the other, on a CPU."""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch
from bench import SLIM, made_data

from foretouch.learning.training.supervised import TrainConfig, train_network
from foretouch.learning.training.vectorised import train_many
from foretouch.models.network.config import ModelConfig

SHAPES: dict[str, ModelConfig] = {
    "128 points, 32-64-128": SLIM,
    "64 points, 16-32": SLIM.replace(n_points=64, trunk_widths=(16, 32), head_widths=(32, 16)),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    for name, shape in SHAPES.items():
        data, index = made_data(shape, 200), np.arange(200)
        configs = [TrainConfig(epochs=2, batch_size=10, device="cpu", seed=seed) for seed in range(arguments.runs)]
        times: dict[str, list[float]] = {"together": [], "alone": []}
        for _ in range(3):
            began = time.process_time()
            train_many([data] * len(configs), [index] * len(configs), configs)
            times["together"].append(time.process_time() - began)
            began = time.process_time()
            for config in configs:
                train_network(data, index, config)
            times["alone"].append(time.process_time() - began)
        together, alone = (sorted(times[key])[1] * 1e3 / (40 * len(configs)) for key in ("together", "alone"))
        print(f"{name}: {together:.2f} ms a step and run together, {alone:.2f} ms alone: {alone / together:.2f} x")


if __name__ == "__main__":
    main()
