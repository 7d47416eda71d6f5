# SPDX-License-Identifier: Apache-2.0
"""What stands for where on an object is never from a later grasp; tables are made of the rows."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated_models import make_calibration
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.where_on_object import EXPERIMENT, Grasps, features_of, predicted, recorded
from foretouch.models.state_space import TrackerParameters
from foretouch.tactile import MODALITIES, biotac_touch
from foretouch_lab.experiments import find_experiment
from foretouch_lab.experiments.shared.tables import select
from foretouch_lab.learning.evaluation.metrics import MEAN

SAMPLES = make_samples(3, 8)
RECORDING, FEATURES_OF = recorded(SAMPLES), features_of(SAMPLES)


def parameters() -> TrackerParameters:
    deviation = np.maximum(FEATURES_OF.std(axis=0), 1e-3) * 4.0
    return replace(make_calibration().tracker_parameters, where_scale=deviation, where_ratio=np.full(4, 2.0))


def test_no_later_grasp_changes_an_earlier_prediction() -> None:
    target, own = SAMPLES[8].object, RECORDING.objects == SAMPLES[8].object
    whole = predicted(RECORDING, FEATURES_OF, target, parameters())
    assert np.isfinite(whole[own]).all()
    assert np.isnan(whole[~own]).all()
    later = np.arange(24) > 12
    changed = replace(RECORDING, readings=RECORDING.readings + 50.0 * later[:, None])
    other = predicted(changed, FEATURES_OF + 0.01 * later[:, None], target, parameters())
    assert_array_equal(other[8:13], whole[8:13])
    assert not np.array_equal(other[13:16], whole[13:16])


@pytest.mark.slow
def test_rows_and_tables_are_those_of_the_cells() -> None:
    samples = [
        replace(sample, touch=biotac_touch(sample.touch.values + 5.0 * np.sin(k + np.arange(50))))
        for k, sample in enumerate(make_samples(6, 6))
    ]
    data = Grasps(samples, "0" * 64)
    assert find_experiment("benchmarks.where_on_object") is EXPERIMENT
    settings = EXPERIMENT.resolve("smoke", {})
    cells = EXPERIMENT.cells(settings, data)
    assert len(cells) == 6
    rows = EXPERIMENT.tabulate(
        settings, [{**cell.values, **row} for cell in cells for row in EXPERIMENT.run(cell, settings, data)]
    )
    first, later = (
        select(rows, regime=regime, object="all", modality=MEAN, variant="where")[0]
        for regime in ("first three", "later")
    )
    assert (first["grasps"], later["grasps"]) == (15, 15)  # nothing was read before the first object
    assert first["gain"] == 0.0
    level = select(rows, regime="later", object="all", modality=MEAN, variant="level")[0]
    assert_allclose(later["gain"], later["skill"] - level["skill"])
    each = select(rows, regime="later", object="all", variant="where")
    assert [row["modality"] for row in each] == [*MODALITIES, MEAN]
    assert [table.title.partition(":")[0] for table in EXPERIMENT.summarise(rows)] == ["first three", "later"]
