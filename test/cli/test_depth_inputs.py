# SPDX-License-Identifier: Apache-2.0
"""The commands on recordings of depth images: the same answers as on the arrays."""

import json
from pathlib import Path

import numpy as np
import pytest
from depth_builders import STAMP_NS, compressed, info, rvl, write_bag

from benchmarks.random_scenes import random_scene
from foretouch.cli.main import main
from foretouch.pipeline import Pipeline
from foretouch.types import Cloud


def test_a_recorded_depth_image_has_the_answer_of_the_array(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    seen = random_scene(rng, 424, 240, n_objects=2).render(rng, 0.001)
    k = np.ravel(seen.K)
    sent_info = info(height=240, width=424, k=k, p=np.insert(k, [3, 6, 9], 0.0))
    topic = "/camera/camera/depth/image_rect_raw/compressedDepth"
    message = compressed(rvl(seen.depth_mm), "16UC1; compressedDepth rvl")
    info_topic = "/camera/camera/depth/camera_info"
    bag = write_bag(tmp_path / "bag", [(info_topic, STAMP_NS, sent_info), (topic, STAMP_NS, message)])
    expected = Pipeline().run(Cloud.from_depth(seen.depth_mm, seen.K))
    assert expected.scene is not None
    labels = tmp_path / "labels.npy"
    assert main(["segment", str(bag), "--json", "--labels-out", str(labels)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["plane"] == expected.scene.table.coefficients.tolist()
    np.testing.assert_array_equal(np.load(labels), expected.scene.labels)
    assert main(["predict", str(bag), "--topic", topic, "--target", "nearest", "--json"]) == 0
    predicted = json.loads(capsys.readouterr().out)["predictions"][0]
    first = expected.targets[0].predictions[0]
    assert predicted["grasp"]["g1"] == first.grasp.g1.tolist()
    assert predicted["E_MF"]["value"] == first.value["E_MF"].tolist()


def test_the_recorded_image_of_the_examples_has_its_three_objects(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(__file__).parents[2] / "examples" / "data" / "bottles"
    assert main(["segment", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["objects"]
    heights = {
        "detergent": (0.65, 0.21),
        "bleach": (0.69, 0.25),
        "milk": (0.77, 0.22),
    }  # from the camera; of the object [m]
    sure = sorted((one for one in found if one["confidence"] > 0.9), key=lambda one: one["centroid"][2])
    for object_, (away, height) in zip(sure, heights.values(), strict=True):
        assert object_["centroid"][2] == pytest.approx(away, abs=0.03)
        low, high = object_["bounds"]
        assert high[1] - low[1] == pytest.approx(height, abs=0.05)
    assert "Redistributions of source code must retain" in (folder / "LICENSE").read_text(encoding="utf-8")


@pytest.mark.parametrize("in_folder", [False, True])
def test_an_image_that_was_cropped_and_kept_its_camera_is_remarked(tmp_path, capsys, in_folder: bool) -> None:
    seen = np.load(Path(__file__).parents[2] / "examples" / "data" / "table_depth.npz")
    height, width = (int(0.83 * side) for side in seen["depth"].shape)
    np.savez(tmp_path / "crop.npz", depth=seen["depth"][:height, :width], K=seen["K"])
    main(["segment", str(tmp_path if in_folder else tmp_path / "crop.npz"), "--json"])
    assert "crop: K: cx, cy" in (text := capsys.readouterr().err)
    assert text.count("subtract the first column and row from cx and cy") == 1
    main(["segment", str(Path(__file__).parents[2] / "examples" / "data" / "table_depth.npz"), "--json"])
    assert "K:" not in capsys.readouterr().err
