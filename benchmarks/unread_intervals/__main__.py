# SPDX-License-Identifier: Apache-2.0
"""Do intervals before any reading hold nine in ten readings? See README.md."""

from argparse import ArgumentParser
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from benchmarks.common import print_rows, read_csv, write_csv
from foretouch import load_model
from foretouch.tactile import BIOTAC
from foretouch.types import Bool, Float64, Grasps
from foretouch_lab.learning.data import Dataset, labels_of, load_dataset, make_folds
from foretouch_lab.learning.data.folds import Fold, predict_folds
from foretouch_lab.learning.prequential import TimedReadings
from foretouch_lab.learning.training.calibration import calibration_folds
from foretouch_lab.learning.training.learners import ContactLearner
from foretouch_lab.learning.training.run_config import load_run_config
from foretouch_lab.learning.training.tracker import fit_tracker

RESULTS: Final = Path(__file__).parent / "results.csv"


def part_rows(data: Dataset, split: str, fold: Fold) -> Iterator[dict[str, Any]]:
    """Yield coverages and widths on the test side of a fold, by a model that was trained and calibrated without it."""
    learner = ContactLearner(load_run_config("contact-v3"), data, fold)
    calibration, facts = learner.calibrate()
    folds, _ = calibration_folds(learner.samples, 0)["new"]
    held_out = predict_folds({"new": (learner.predict_fold, folds)})["new"]
    recording = TimedReadings.of_samples(learner.samples, learner.labels, held_out, calibration.rest)
    groups = calibration.groups["new"], calibration.groups["known"]
    tracker = fit_tracker(replace(recording, where=learner.where).ordered(), *groups)
    learner.fit()
    test = [data.filled[k] for k in fold.test]
    with TemporaryDirectory() as folder:
        model = load_model(learner.save(Path(folder), "model", {}, (calibration, facts)))
        estimates = [model.estimate(sample.cloud, Grasps.of([sample.grasp])) for sample in test]
    counts, known = (np.concatenate([getattr(one, name) for one in estimates]) for name in ("counts", "known"))
    errors = np.abs(labels_of(test) - counts)
    for name, own in (("served", calibration), ("tracker alone", replace(calibration, tracker=tracker))):
        yield from coverage_rows(
            {"split": split, "part": fold.name, "intervals": name}, errors, known, own.unread_half_widths
        )


def coverage_rows(
    head: Mapping[str, Any], errors: Float64, known: Bool, half: Mapping[str, Float64]
) -> Iterator[dict[str, Any]]:
    """Yield by modality the share of (S, D) errors within the half widths, and their mean [counts]."""
    widths = np.where(known[:, None], half["known"], half["new"])
    for modality, own in BIOTAC.modality_columns.items():
        inside = float((errors <= widths)[:, own].mean())
        yield {**head, "modality": modality, "inside": round(inside, 4), "half": round(float(widths[:, own].mean()), 1)}


def summary(rows: list[dict[str, str]]) -> Iterator[dict[str, Any]]:
    """Yield means over the parts of a split, with the least."""
    for key in dict.fromkeys((row["split"], row["intervals"], row["modality"]) for row in rows):
        own = [row for row in rows if (row["split"], row["intervals"], row["modality"]) == key]
        inside = [float(row["inside"]) for row in own]
        half = float(np.mean([float(row["half"]) for row in own]))
        facts = {"parts": len(own), "inside": float(np.mean(inside)), "least": min(inside), "half": half}
        yield dict(zip(("split", "intervals", "modality"), key, strict=True)) | facts


def main() -> None:
    """Measure the parts that `results.csv` lacks, and print the means."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of vision2tactile")
    data = load_dataset(parser.parse_args().data)
    rows = read_csv(RESULTS)
    for split in ("object", "time"):
        for fold in make_folds(data.filled, split, 0):
            if not any((row["split"], row["part"]) == (split, fold.name) for row in rows):
                rows += part_rows(data, split, fold)
                write_csv(RESULTS, rows)
    print_rows(list(summary(rows)))


if __name__ == "__main__":
    main()
