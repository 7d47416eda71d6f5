# SPDX-License-Identifier: Apache-2.0
"""What each departure from a paper changes: short runs on simulated deformables, several seeds, one change at a time."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from foretouch.learning.data import Dataset, TrainingSet, load_dataset
from foretouch.learning.data.training_set import predict_set
from foretouch.learning.training import losses
from foretouch.learning.training.losses import SrganLossConfig
from foretouch.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch.learning.training.trainer import Trainer
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.networks import GeneratorConfig
from foretouch.tactile import columns

SLIM = ModelConfig(
    n_points=128,
    channels="xyz+normals",
    outputs=("PDC_TH",),
    tnet=False,
    trunk_widths=(16, 32, 64),
    head_widths=(64, 32),
)
OURS = TrainConfig(epochs=20, batch_size=10, device="cpu")
PAPER = OURS.replace(
    optimiser="adam", learning_rate=0.01, weight_decay=0.0, schedule="constant", loss="rmse", target_scaling="ranges"
)
SRGAN = SrganConfig(
    epochs=20,
    learning_rate=1e-3,
    target_scaling="standardised",
    points=125,
    generator=GeneratorConfig(noise_length=1),
    device="cpu",
)

SUPERVISED = {
    "P2's recipe": PAPER,
    "P2's, rate 0.001": PAPER.replace(learning_rate=1e-3),
    "P2's, mean squared error": PAPER.replace(loss="mse"),
    "P2's, standardised labels": PAPER.replace(target_scaling="standardised"),
    "P2's, AdamW and cosine": PAPER.replace(optimiser="adamw", weight_decay=1e-2, schedule="cosine"),
    "our defaults": OURS,
}
SEMI = {
    "contrast, frozen (default)": SRGAN,
    "contrast, per source": SRGAN.replace(batch_norm="per_source"),
    "as printed, frozen": SRGAN.replace(loss=SrganLossConfig(loss_variant="as_printed")),
    "as printed, per source": SRGAN.replace(loss=SrganLossConfig(loss_variant="as_printed"), batch_norm="per_source"),
    "srgan, frozen": SRGAN.replace(loss=SrganLossConfig(loss_variant="srgan")),
    "srgan, per source": SRGAN.replace(loss=SrganLossConfig(loss_variant="srgan"), batch_norm="per_source"),
    "srgan, frozen, penalty 10": SRGAN.replace(loss=SrganLossConfig(loss_variant="srgan", gradient_penalty=10.0)),
    "srgan, frozen, bfloat16 search": SRGAN.replace(loss=SrganLossConfig(loss_variant="srgan"), precision="bfloat16"),
    "labels alone, frozen": SRGAN.replace(loss=SrganLossConfig(weight_unlabeled=0.0, weight_fake=0.0)),
}


@contextmanager
def plain_root() -> Iterator[None]:
    """Eq. 2's own root, whose slope at zero is infinite."""
    safe = losses.safe_root
    losses.safe_root = torch.sqrt  # type: ignore[assignment]
    try:
        yield
    finally:
        losses.safe_root = safe


def trained(trainer: Trainer, test: np.ndarray) -> tuple[float, dict[str, Tensor]]:
    """Skill on the test samples, 1 - MSE / variance, and the weights."""
    while trainer.epoch < trainer.epochs:
        trainer.run_epoch()
    data = trainer.data
    actual = data.labels[np.ix_(test, columns(data.config.outputs))]
    error = predict_set(trainer.net.eval(), data, test) - actual
    return 1.0 - float((error**2).mean() / actual.var()), trainer.net.state_dict()


def report(name: str, skills: list[float], out: list[dict[str, object]]) -> None:
    out.append({"case": name, "skills": skills})
    print(
        f"{name:34} {np.mean(skills):7.3f} ± {np.std(skills, ddof=1):.3f}   {np.round(skills, 3).tolist()}", flush=True
    )


def run(dataset: Dataset, seeds: int) -> list[dict[str, object]]:
    """Every case and seed."""
    (part,) = dataset.parts("labels/T50")
    train, test, bare = (dataset.index(ids) for ids in (part.train, part.test, part.unlabelled))
    data = TrainingSet.build(dataset.samples, SLIM, unlabelled=True)
    rows: list[dict[str, object]] = []
    for name, how in SUPERVISED.items():
        report(
            f"supervised: {name}",
            [trained(SupervisedTrainer(data, train, how.replace(seed=k)), test)[0] for k in range(seeds)],
            rows,
        )
    for name, semi in SEMI.items():
        report(
            f"SR-GAN: {name}",
            [trained(SrganTrainer(data, train, bare, semi.replace(seed=k)), test)[0] for k in range(seeds)],
            rows,
        )
    safe = trained(SupervisedTrainer(data, train, PAPER), test)[1]
    with plain_root():
        bare_root = trained(SupervisedTrainer(data, train, PAPER), test)[1]
    same = all(torch.equal(safe[key], value) for key, value in bare_root.items())
    rows.append({"case": "finite slope of the root at zero", "weights_bit_equal": same})
    print(f"finite slope of the root at zero: weights {'bit-equal' if same else 'differ'}")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", help="store of foretouch simulate config/scenes/deformables.yaml -n 1000")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    dataset = load_dataset(arguments.data)
    rows = run(dataset, arguments.seeds)
    if arguments.out is not None:
        head = {"data_sha256": dataset.sha256, "model": dataclasses.asdict(SLIM)["trunk_widths"]}
        lines = [json.dumps(row) for row in (head, *rows)]
        arguments.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
