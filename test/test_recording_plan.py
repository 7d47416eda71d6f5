# SPDX-License-Identifier: Apache-2.0
"""A design keeps what it states of a large campaign; gains and half widths are those of its readings."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.recording_plan import EXPERIMENT, Design, thinned
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, GraspSample
from foretouch_lab.experiments import find_experiment, run_sweep
from foretouch_lab.experiments.framework import sweep
from foretouch_lab.experiments.shared.tables import select
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.world import object_index

PROTOCOL = Path(__file__).parents[1] / "config" / "scenes" / "campaign_protocol.yaml"
READING = biotac_touch(np.full(50, 2000.0))
CLOUD, GRASP = Cloud(np.zeros((1, 3), np.float32)), Grasp(np.zeros(3), np.ones(3), np.eye(3))


def visits() -> list[list[GraspSample]]:
    """Three visits to each of eight objects, two grasps each, all with a tare."""
    order = [k for turn in range(3) for k in (range(8) if turn < 2 else range(7, -1, -1))]
    return [
        [GraspSample(f"{visit}/{k}", f"o{name}", CLOUD, GRASP, READING, READING) for k in range(2)]
        for visit, name in enumerate(order)
    ]


def test_a_design_keeps_its_objects_visits_and_tares() -> None:
    kept = thinned(visits(), Design(4, 2))
    assert [sample.id for sample in kept] == [f"{visit}/{k}" for visit in (0, 1, 2, 3, 8, 9, 10, 11) for k in range(2)]
    assert [sample.tare is not None for sample in kept] == [True, False] * 8
    for tares, count in {"none": 0, "object": 8, "grasp": 16}.items():
        assert sum(sample.tare is not None for sample in thinned(visits(), Design(8, 1, tares))) == count
    spread = thinned(visits(), Design(4, 1, days="many"))
    assert [one.object for one in spread[::2]] == ["o0", "o2", "o4", "o6"]
    assert len(thinned(visits(), Design(8, 3))) == 48


def test_the_protocol_is_a_campaign_with_revisits_repeats_and_a_tare_before_each_object() -> None:
    scene = load_scene(PROTOCOL)
    campaign = scene.campaign
    assert campaign is not None
    assert (campaign.tares, campaign.repeat_every, campaign.size) == ("object", 10, 20 * len(scene.objects))
    assert [campaign.repeats(slot) for slot in range(20)].count(True) == 2
    visits = [(slot // 60, object_index(scene, slot)) for slot in range(0, campaign.size, 10)]
    assert len(set(visits)) == len(visits)  # on different days


@pytest.mark.slow
def test_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On six objects, whose mean reading is known to predict them better than that of others does."""
    monkeypatch.setattr(
        sweep, "in_processes", lambda job, cells, _workers: (sweep.run_cell(job, cell) for cell in cells)
    )
    experiment = find_experiment("benchmarks.recording_plan")
    assert experiment is EXPERIMENT
    settings = experiment.resolve("smoke", {"visits": [1, 2]})
    result = run_sweep(experiment, settings, tmp_path / "out", source=PROTOCOL)
    assert result.failures == {}
    assert {row["visits"] for row in result.rows} == {1, 2}
    gains = select(result.rows, known="object", regime="never touched", visits=2)
    assert np.mean([row["value"] for row in gains]) > 0.0
    assert all(row["half_width"] > 0.0 for row in gains)
    assert all(row["value"] > 0.5 for row in select(result.rows, known="a repeat", visits=2))
    tables = experiment.summarise(result.rows)
    assert len(tables[-1].notes) == 4
    assert {table.title.partition(":")[0] for table in tables} == {"never touched", "first three", "all"}
