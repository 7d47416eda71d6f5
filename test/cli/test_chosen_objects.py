# SPDX-License-Identifier: Apache-2.0
"""`--mask`, `--pixel`, `--point` and `--picture` of `segment`, `grasp` and `predict`."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case
from PIL import Image

import foretouch as ft

TABLE = Path(__file__).parents[2] / "examples" / "data" / "table.npz"


@pytest.fixture(scope="module")
def scene() -> ft.Scene:
    return ft.segment(ft.read_cloud(TABLE))


def test_a_mask_of_any_file_is_used_as_it_is_and_its_objects_get_grasps(call, scene, tmp_path):
    labels = np.where(scene.labels == 2, 40, np.where(scene.labels == 4, 7, 0))
    Image.fromarray(labels.astype(np.uint8)).save(tmp_path / "8.png")
    Image.fromarray(labels.astype(np.uint16)).save(tmp_path / "16.png")
    palette = Image.fromarray(labels.astype(np.uint8), "P")
    palette.putpalette([k % 256 for k in range(768)])
    palette.save(tmp_path / "palette.png")
    np.save(tmp_path / "a.npy", labels)
    np.savez(tmp_path / "a.npz", depth=np.zeros(3), label=labels)

    def check(name: str) -> None:
        (record,) = call("segment", TABLE, "--mask", tmp_path / name, "--json").records
        assert sorted(one["id"] for one in record["objects"]) == [7, 40]
        records = call("grasp", TABLE, "--mask", tmp_path / name, "--target", "all", "--json").records
        assert sorted(one["object"] for one in records) == ["40", "7"]
        assert all(one["grasps"] for one in records)

    every_case([(name,) for name in ("8.png", "16.png", "palette.png", "a.npy", "a.npz")], check)


def test_an_object_is_chosen_by_pixel_or_point_and_the_answer_says_so(call, scene):
    one = scene.objects[2]
    v, u = np.divmod(one.pixels[len(one.pixels) // 2], scene.labels.shape[1])
    point = ",".join(map(str, one.centroid))
    for option, value, selected in (("--pixel", f"{u},{v}", "pixel"), (f"--point={point}", None, "point")):
        answer = call("grasp", TABLE, option, *([value] if value else []), "--json")
        assert [(each["object"], each["selected"]) for each in answer.records] == [("3", selected)]
    (record,) = call("predict", TABLE, "--pixel", f"{u},{v}", "--json").records
    assert (record["object"], record["selected"], len(record["predictions"])) == ("3", "pixel", 1)
    assert "selected" not in call("grasp", TABLE, "--json").records[0]


def test_bad_masks_and_clicks_are_refused_in_one_line(call, scene, tmp_path):
    Image.fromarray(np.zeros((*scene.labels.shape, 3), np.uint8)).save(tmp_path / "colours.png")
    Image.fromarray(np.zeros((5, 5), np.uint8)).save(tmp_path / "small.png")
    Image.fromarray(np.zeros(scene.labels.shape, np.uint8)).save(tmp_path / "empty.png")
    pixel = np.zeros(scene.labels.shape, np.uint8)
    pixel.flat[scene.objects[0].pixels[0]] = 255
    Image.fromarray(pixel).save(tmp_path / "pixel.png")
    (tmp_path / "text.png").write_text("no image")
    np.save(tmp_path / "objects.npy", np.array([{"mask": 1}], object), allow_pickle=True)
    np.savez(tmp_path / "other.npz", xyz=np.zeros(3))
    np.save(tmp_path / "float.npy", scene.labels.astype(float))
    cases = [
        (("--mask", tmp_path / "colours.png"), "mask: an image with colours"),
        (("--mask", tmp_path / "small.png"), "mask: shape (5, 5) is not (360, 480)"),
        (("--mask", tmp_path / "empty.png"), "mask: holds no label above 0"),
        (("--mask", tmp_path / "pixel.png"), "label 255 has 1 points above the table, fewer than 30"),
        (("--mask", tmp_path / "text.png"), "mask: cannot be read"),
        (("--mask", tmp_path / "objects.npy"), "mask: cannot be read"),
        (("--mask", tmp_path / "other.npz"), "holds xyz, none of mask, label, labels, segmap"),
        (("--mask", tmp_path / "float.npy"), "mask: dtype float64 is not of whole numbers or bool"),
        (("--mask", tmp_path / "absent.png"), "does not exist"),
        (("--mask", TABLE.with_suffix(".txt")), ""),
        (("--pixel", "5,5"), "pixel: (5, 5) is the table"),
        (("--pixel", "480,0"), "pixel: (480, 0) is outside of the image"),
        (("--pixel", "5.5,5"), "is not two whole numbers"),
        (("--point", "0,0,0.5"), "point: no object within 0.03 m of (0, 0, 0.5)"),
        (("--point", "nan,0,0.5"), "is not three finite numbers"),
        (("--pixel", "5,5", "--point", "0,0,1"), "--pixel, --point: select an object twice"),
        (("--pixel", "5,5", "--plane", "0,0,1,-1"), "--plane, --pixel: with --plane the cloud is the points of one"),
        (("--scene", "--plane", "0,0,1,-1"), "--plane, --scene: with --plane"),
        (("--picture", tmp_path / "a.xyz"), ".png"),
    ]

    def check(options, text) -> None:
        answer = call("grasp", TABLE, *options)
        answer.check_refused(text)

    every_case(cases, check)
    call("grasp", TABLE, TABLE, "--mask", tmp_path / "small.png").check_refused("--mask: requires one input, not 2")


def test_pictures_are_drawn_by_all_three(call, tmp_path):
    heights = []
    for command in ("segment", "grasp", "predict"):
        path = tmp_path / f"{command}.png"
        answer = call(command, TABLE, "--picture", path, "--json", *(["--target", "nearest"] * (command == "predict")))
        assert (answer.status, len(answer.records)) == (0, 1)
        with Image.open(path) as image:
            assert image.size[0] == 924  # of a page
            heights.append(image.size[1])
    assert heights[0] < heights[1]  # a row more
    some = tmp_path / "some.png"
    assert call("predict", TABLE, "--target", "nearest", "--picture", some, "--panels", "touch").status == 0
    with Image.open(some) as image:
        assert image.size[1] < heights[2] / 2
    call("grasp", TABLE, "--picture", some, "--panels", "image,bars").check_refused("panels: 'bars' is not one of")
    call("grasp", TABLE, "--panels", "image").check_refused("--panels: is for --picture")
    (tmp_path / "both").mkdir()
    for name in ("a.npz", "b.npz"):
        shutil.copy(TABLE, tmp_path / "both" / name)
    call("grasp", tmp_path / "both", "--picture", tmp_path / "two.png").check_refused(
        "--picture: requires one cloud, and"
    )
    assert not (tmp_path / "two.png").exists()
