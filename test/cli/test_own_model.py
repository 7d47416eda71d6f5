# SPDX-License-Identifier: Apache-2.0
"""A model of one's own: what the commands say where grasps are missing (docs/tutorials/own_model.md runs them all)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from every_case import every_case
from experiment_samples import make_samples
from recording_builders import IDENTITY, QUICK

from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.grasp.pose import hand_rotation
from foretouch.models.predictor import UNFAMILIAR_CURE
from foretouch.models.registry import load_model

QUICKLY = "contact.trees=3"


def write_recording(path: Path, counts: tuple[int, ...], identity: Identity = IDENTITY, seed: int = 0) -> None:
    """So many grasps of each object, in one session each."""
    samples = make_samples(len(counts), max(counts), seed)
    for k, count in enumerate(counts):
        with RecordingWriter(path, identity, QUICK) as writer:
            for sample in samples[k * max(counts) :][:count]:
                rotation = hand_rotation(sample.grasp.g1, sample.grasp.g2, np.array([0.0, 1.0, 0.0]))
                sample.grasp.__dict__["rotation"] = rotation
                writer.append(sample)


def test_a_model_of_too_few_grasps_has_a_card_that_says_how_many_are_missing(tmp_path: Path, call) -> None:
    def check(counts: tuple[int, ...], sentence: str) -> None:
        folder = tmp_path / "-".join(map(str, counts))
        write_recording(folder / "grasps", counts)
        done = call("train", "contact-v3", f"data={folder / 'grasps'}", QUICKLY, "-o", folder / "model", "--json")
        assert (done.status, done.records[-1]["calibrated"]) == (0, False)
        assert done.records[-1]["limits"][0] == f"No calibration: {sentence} more of other objects are needed."
        card = load_model(str(folder / "model")).card
        assert card["limits"][0] == done.records[-1]["limits"][0]

    every_case(
        [
            ((12,), "12 of 12 grasps are of campbells; at least 5"),
            ((6, 1, 1), "6 of 8 grasps are of campbells; at least 3"),
        ],
        check,
    )
    write_recording(tmp_path / "few", (3,))
    done = call("train", "contact-v3", f"data={tmp_path / 'few'}", QUICKLY, "-o", tmp_path / "none", "--json")
    assert done.status == 1
    assert "3 samples are fewer than 5: 2 more grasps are needed" in done.err


def test_datasets_of_two_hands_are_joined_with_a_warning(tmp_path: Path, call) -> None:
    write_recording(tmp_path / "one", (2,))
    write_recording(tmp_path / "other", (2, 2), replace(IDENTITY, hand={**IDENTITY.hand, "serial": "99"}), seed=1)
    done = call("dataset", "build", tmp_path / "one", tmp_path / "other", "-o", tmp_path / "store")
    assert done.status == 0
    assert f"{tmp_path / 'other'}: is of another hand than {tmp_path / 'one'}" in done.err
    assert "serial 99, not 1234" in done.err
    assert "another hand" not in call("dataset", "build", tmp_path / "one", "-o", tmp_path / "again").err


def test_an_unfamiliar_object_is_told_with_what_to_do_once_after_all_tables(call) -> None:
    data = Path(__file__).parents[2] / "examples" / "data"
    strange = call("predict", data / "table.npz").out
    *_, last = strange.splitlines()
    assert last == UNFAMILIAR_CURE
    assert strange.count(UNFAMILIAR_CURE) == 1 < strange.count("smaller")
    assert (Path(__file__).parents[2] / UNFAMILIAR_CURE.rpartition(" ")[2]).is_file()
    known = call("predict", data / "can.ply").out
    assert "unfamiliar" not in known
    assert "cloud only" in known
