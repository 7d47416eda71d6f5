# SPDX-License-Identifier: Apache-2.0
"""Fit the model `touch-hold` to the public grasps, and write it with its card: `python -m benchmarks.other_recordings DATASET RESULTS -o FOLDER`.

DATASET is what `examples/import_biotac_sp_stability.py` wrote, RESULTS the `results.csv` of this benchmark on it.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.common import read_csv
from benchmarks.other_recordings import CONFIG, FINGERS, electrodes, fit, folds_of
from foretouch.dataset.formats import open_samples
from foretouch.dataset.store import content_sha256
from foretouch.models.card import save_model
from foretouch.models.touch_hold import OUTSIDE, TouchHold
from foretouch.types import AnyArray, Bool, Float64

_FOLDS: Final = 10  # of objects, for the calibration
_LIMITS: Final = (
    "one hand with three BioTac SP, which all touched the object; other sensors have other offsets between their electrodes",
    "one reading before the lift, of grasps that were made to hold or to slip: 51 objects, three postures of the palm",
    "in a posture of the palm that was left out the AUC falls and the probabilities are off: see auc and calibration_error in skill",
)


def calibrated(readings: Float64, held: Bool, folds: AnyArray, seed: int) -> tuple[TouchHold, float]:
    """Return the model of all grasps, calibrated on those left out by folds; and the share of those that it would refuse."""
    from sklearn.linear_model import LogisticRegression

    logits, outside = np.zeros(len(held)), np.zeros(len(held))
    for k in np.unique(folds):
        fitted, test = fit(readings[folds != k], held[folds != k], seed), folds == k
        logits[test], outside[test] = fitted.logits(readings[test]), fitted.outside(readings[test])
    scale = LogisticRegression(C=1e6).fit(logits[:, None], held)
    numbers = np.array([scale.coef_[0, 0], scale.intercept_[0]])
    return replace(fit(readings, held, seed), calibration=numbers), float((outside > OUTSIDE).mean())


def _skill(rows: list[dict[str, str]]) -> dict[str, Any]:
    keys = {"auc": "score", "auc_low": "score_low", "auc_high": "score_high", "auc_slip_first": "slip_first",
            "auc_slip_first_low": "slip_first_low", "auc_slip_first_high": "slip_first_high", "calibration_error": "calibration_error"}  # fmt: skip
    return {row["left_out"]: {"hold": {key: round(float(row[name]), 4) for key, name in keys.items()}} for row in rows}


def main() -> None:
    """Fit, write and print what was written."""
    parser = argparse.ArgumentParser(description="Fit the model touch-hold to an imported dataset.")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("results", type=Path, help="results.csv of benchmarks.other_recordings on the dataset")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the model")
    arguments = parser.parse_args()
    samples = open_samples(arguments.dataset)
    labelled = [sample for sample in samples if sample.touch is not None]
    touches = np.array([sample.touch.values for sample in labelled if sample.touch is not None])
    readings = electrodes(touches, samples.sensor.channels)
    if readings is None:
        raise SystemExit(f"{arguments.dataset}: holds no electrodes of {', '.join(FINGERS)}")
    held = np.array([record.outcome == "success" for record in labelled])
    objects = np.array([sample.object for sample in labelled])
    model, refused = calibrated(readings, held, folds_of(objects, _FOLDS, 0), 0)
    # Tables of before 0.3.1 hold other rows, too.
    rows = [row for row in read_csv(arguments.results) if row.get("what", "hold") == "hold"]
    facts = {
        "summary": "whether a grasp of three BioTac SP holds when it is lifted, from one reading; read skill and limits first",
        "config": {**CONFIG, "fingers": list(FINGERS)},
        "data": {
            "name": "biotacsp-stability-set-v2", "samples": len(labelled), "objects": len(set(objects)),
            "sha256": content_sha256(labelled),
            "source": "github.com/3dperceptionlab/biotacsp-stability-set-v2", "licence": "MIT",
        },
        "skill": _skill([row for row in rows if row["method"] == "patterns"]),
        "baselines": {
            row["method"]: {"auc": round(float(row["score"]), 4)}
            for row in rows if row["left_out"] == "objects" and row["method"] != "patterns"
        },
        "limits": [*_LIMITS, f"{refused:.1%} of grasps on objects left out are refused: more than {OUTSIDE:.0%} of the pattern is out of range"],
    }  # fmt: skip
    print(save_model(arguments.out / "touch-hold.json", "hold", model.to_tensors(), facts))
    print({"refused": refused, "calibration": model.calibration.tolist()})


if __name__ == "__main__":
    main()
