# SPDX-License-Identifier: Apache-2.0
"""`segment`, `grasp` and `predict` on files."""

import json
import shutil
from typing import Any

import numpy as np
import pytest

from foretouch.cli.main import main
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.models.registry import find_card
from foretouch.pipeline import Pipeline
from foretouch.types import ASSUMED_TABLE, Cloud


def test_segment_prints_plane_objects_times_and_labels(call, files, tmp_path) -> None:
    answer = call("segment", files / "scene.npz", "--json", "--labels-out", tmp_path / "l.npy")
    (record,) = answer.records
    assert (answer.status, record["input"], len(record["objects"])) == (0, str(files / "scene.npz"), 2)
    assert np.linalg.norm(record["plane"][:3]) == pytest.approx(1.0)
    assert record["ms"]["total"] > 0
    for one in record["objects"]:
        low, high = np.array(one["bounds"])
        assert ((low <= one["centroid"]) & (one["centroid"] <= high)).all()
        assert 0.5 < one["confidence"] < 1.0
    labels = np.load(tmp_path / "l.npy")
    assert (labels.shape, labels.dtype) == ((240, 424), np.int32)
    # Flying pixels bear the label of their object and are none of its points.
    assert np.count_nonzero(labels) == sum(one["n_points"] for one in record["objects"]) + record["counts"]["flying"]
    assert set(np.unique(labels)) == {0, *(one["id"] for one in record["objects"])}
    text = call("segment", files / "scene.npz").out
    assert "centroid [m]" in text
    assert f"{record['objects'][0]['confidence']:.2f}" in text


def test_every_input_has_its_line_in_order_and_a_bad_one_ends_nothing(call, files) -> None:
    names = [files / "scene.npz", files / "none.npz", files / "empty.npz", files / "scene.npz"]
    answer = call("segment", *names, "--json")
    assert answer.status == 1
    assert [record["input"] for record in answer.records] == [str(name) for name in names]
    assert [record["status"] for record in answer.records] == ["ok", "refused", "empty_cloud", "ok"]
    assert "does not exist" in answer.records[1]["reason"]
    assert "Traceback" not in answer.err


def test_an_input_without_clouds_is_refused(call, files, tmp_path) -> None:
    RecordingWriter(tmp_path / "none", Identity(hand={"name": "biotac_sp"}, camera={"name": "none"})).close()
    answer = call("predict", tmp_path / "none", files / "object.pcd", "--json")
    assert (answer.status, [record["status"] for record in answer.records]) == (1, ["refused", "ok"])
    assert answer.records[0]["reason"].endswith("none: holds no cloud and no sample")
    assert "without stamps" not in call("dataset", "info", tmp_path / "none").out


def test_grasp_of_an_object_equals_the_core_and_vary_is_repeated_by_its_seed(call, files) -> None:
    (record,) = call("grasp", files / "object.pcd", "--plane", "0,0,1,-1.27", "--json").records
    cloud = read_cloud(files / "object.pcd")
    (result,) = Pipeline().run(cloud, ASSUMED_TABLE).targets
    assert record["status"] == result.plan.status
    np.testing.assert_array_equal(record["grasps"][0]["g1"], result.plan.grasps[0].g1)
    np.testing.assert_array_equal(record["grasps"][0]["rotation"], result.plan.grasps[0].rotation.reshape(9))
    np.testing.assert_array_equal(record["initial_points"], result.plan.initial_points)

    def contact(*options: str) -> list[list[float]]:
        return call("grasp", files / "object.pcd", "--json", *options).records[0]["initial_points"]

    assert contact("--vary", "1") == contact("--vary", "1") != contact("--vary", "2")
    assert contact("--slide-m", "0.01") != contact()


def test_an_organised_cloud_is_segmented_and_its_targets_are_used(call, files) -> None:
    records = call("grasp", files / "scene.npz", "--target", "all", "--count", "3", "--json").records
    assert [record["object"] for record in records] == ["1", "2"]
    assert all(1 <= len(record["grasps"]) <= 3 for record in records)
    words = ("predict", files / "scene.npz", "--json")
    records = call(*words).records
    assert [record["object"] for record in records] == ["1", "2"]
    (nearest,) = call(*words, "--target", "nearest").records
    assert nearest["predictions"] == records[0]["predictions"]
    (limited,) = call(*words, "--set", "target.max_objects=1").records
    assert limited["object"] == "1"
    (tied,) = call(*words, "--target", "nearest", "--set", "target.margin_m=1").records
    flagged = ["ambiguous_target" in one["predictions"][0]["flags"] for one in (nearest, tied)]
    assert flagged == [False, True]


def fifty(one: dict[str, Any], key: str) -> list[float]:
    return [one["PDC_TH"][key], one["PDC_MF"][key], *one["E_TH"][key], *one["E_MF"][key]]


def test_predict_gives_50_values_within_their_bounds(call, files, tmp_path) -> None:
    (record,) = call("predict", files / "object.pcd", "--json").records
    (one,) = record["predictions"]
    values = fifty(one, "value")
    assert len(values) == 50
    assert np.isfinite(values).all()
    assert (np.less(fifty(one, "lower"), values) & np.less(values, fifty(one, "upper"))).all()
    assert (one["reference"], len(record["model"]["sha256"])) == ("none", 64)
    shipped = find_card("contact-v3")
    shutil.copy(shipped.with_suffix(".safetensors"), tmp_path)
    bare = tmp_path / shipped.name
    bare.write_text(json.dumps({**json.loads(shipped.read_text()), "calibration": None}))
    (record,) = call("predict", files / "object.pcd", "--json", "--model", bare).records
    (one,) = record["predictions"]
    assert np.isfinite(fifty(one, "value")).all()
    assert all(one[name][key] is None for name in ("PDC_TH", "E_MF") for key in ("lower", "upper"))


def test_predict_takes_given_grasps_in_their_order(call, files) -> None:
    xyz = read_cloud(files / "object.pcd").xyz.reshape(-1, 3)
    pairs = [(xyz[0], xyz[-1]), (xyz[5], xyz[-5])]
    options = ["--grasp=" + ",".join(f"{v:.6f}" for v in (*g1, *g2)) for g1, g2 in pairs]
    (record,) = call("predict", files / "object.pcd", "--json", *options).records
    given = [[*one["grasp"]["g1"], *one["grasp"]["g2"]] for one in record["predictions"]]
    np.testing.assert_allclose(given, [[*g1, *g2] for g1, g2 in pairs], atol=1e-6)
    refused = call("predict", files / "object.pcd", "--json", "--grasp", "0,0,1,0,0,1")
    refused.check_refused("both contacts")
    assert "both contacts" in refused.records[0]["reason"]


def test_a_config_file_and_set_change_the_pipeline(call, files, tmp_path) -> None:
    (tmp_path / "c.yaml").write_text("grasp: {method: original, tip_mm: 30, count: 2}\n")
    from_file = call("grasp", files / "object.pcd", "--json", "--config", tmp_path / "c.yaml").records[0]
    original = ("grasp", files / "object.pcd", "--json", "--set", "grasp.method=original")
    from_option = call(*original, "--tip-mm", "30", "--set", "grasp.count=2").records[0]
    assert from_file["counts"] == from_option["counts"]
    assert from_file["counts"] != call(*original).records[0]["counts"]
    call("grasp", files / "object.pcd", "--tip-mm", "20").check_refused("--tip-mm: is for --set grasp.method=original")
    call("grasp", files / "object.pcd", "--hand", "shadow").check_refused("--hand: hand.name: shadow: is neither")
    unknown = call("grasp", files / "object.pcd", "--set", "grasp.tipp_mm=3")
    unknown.check_refused("grasp.tipp_mm: unknown setting; known: tip_mm")
    assert main([]) == 2


@pytest.mark.real_data
def test_the_public_grasps_bring_their_own_grasp_and_name(call, real_data) -> None:
    folder = real_data / "vision2tactile" / "coffee"
    answer = call("predict", folder, "--json")
    assert (answer.status, len(answer.records)) == (0, 50)
    record = answer.records[0]
    sample = folder.parent / record["sample"]
    given = np.loadtxt(sample / "best-grasp.txt", delimiter=",")
    one = record["predictions"][0]["grasp"]
    np.testing.assert_allclose([*one["g1"], *one["g2"]], given)


def test_a_file_of_the_other_kind_names_the_command_that_reads_it(tmp_path, capsys, rng):
    """A list of the points of a scene given to `predict`, and one object given to `segment`."""
    table = np.column_stack([rng.uniform(-0.5, 0.5, (3000, 2)), np.full(3000, 0.9)])
    write_cloud(tmp_path / "scene.npy", Cloud(table))
    assert main(["predict", str(tmp_path / "scene.npy")]) == 1
    assert (
        "more than max_extent_m 0.6; a list of the points of a whole scene is segmented with --scene, an image without --plane"
        in capsys.readouterr().err
    )
    angle = rng.uniform(0.0, np.pi, 800)
    can = np.column_stack([0.03 * np.cos(angle), rng.uniform(-0.05, 0.05, 800), 0.6 - 0.03 * np.sin(angle)])
    write_cloud(tmp_path / "can.npy", Cloud(can))
    assert main(["segment", str(tmp_path / "can.npy"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["reason"].endswith("; a file of one object goes to `foretouch grasp`")
