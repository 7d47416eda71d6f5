# SPDX-License-Identifier: Apache-2.0
"""`--color`: it is drawn, and answers are those without it, to the bit."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_answer import Answer
from every_case import every_case
from numpy.testing import assert_array_equal
from PIL import Image

import foretouch as ft
from benchmarks.random_scenes import random_scene


def test_answers_are_the_same_to_the_bit_and_the_picture_shows_the_colours(
    tmp_path: Path, call: Callable[..., Answer]
) -> None:
    frame = random_scene(np.random.default_rng(3), width=320, height=240, n_objects=2).render()
    Image.fromarray(frame.depth_mm).save(tmp_path / "depth.png")
    Image.fromarray(frame.rgb).save(tmp_path / "c.png")
    words = [str(tmp_path / "depth.png"), "--intrinsics", ",".join(map(str, frame.K[[0, 1, 0, 1], [0, 1, 2, 2]]))]
    pictures = [tmp_path / "without.png", tmp_path / "with.png"]

    def check(command: str) -> None:
        without, coloured = (
            call(command, *words, *given, "--picture", str(picture), "--json")
            for given, picture in zip(([], ["--color", str(tmp_path / "c.png")]), pictures, strict=True)
        )
        assert without.status == coloured.status == 0, coloured
        assert re.sub(r'"ms": \{[^}]*\}', "", without.out) == re.sub(r'"ms": \{[^}]*\}', "", coloured.out)
        grey, shown = (np.asarray(Image.open(picture).convert("RGB"), int) for picture in pictures)
        assert np.ptp(shown[..., :3], axis=2).mean() > np.ptp(grey[..., :3], axis=2).mean()

    every_case(["segment", "predict"], check)
    assert call("segment", words[0], *words, "--color", "c.png").err.endswith("--color: requires one input, not 2\n")
    plain = ft.segment(ft.Cloud.from_depth(frame.depth_mm, frame.K))
    coloured = ft.segment(ft.Cloud.from_depth(frame.depth_mm, frame.K, rgb=frame.rgb))
    assert_array_equal(coloured.cloud.rgb, frame.rgb)
    assert_array_equal(plain.labels, coloured.labels)
    grasps = [ft.plan(scene.objects[0]) for scene in (plain, coloured)]
    assert_array_equal(grasps[0].pose, grasps[1].pose)
    touch = [
        ft.load_model().predict(scene.objects[0], one) for scene, one in zip((plain, coloured), grasps, strict=True)
    ]
    assert_array_equal(touch[0].value, touch[1].value)
