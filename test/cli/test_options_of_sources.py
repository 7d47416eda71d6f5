# SPDX-License-Identifier: Apache-2.0
"""Every option with every kind of source: it changes something, or it is refused by its name."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from command_answer import Answer
from depth_builders import STAMP_NS, image, info, write_bag
from every_case import every_case
from PIL import Image
from recording_builders import write_dataset

from benchmarks.random_scenes import random_scene
from foretouch.cli.main import command_parser
from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.formats.rosbag2 import BagWriter
from foretouch.types import Cloud

SOURCES = ("depth.png", "folder", "depth.npz", "scene.npz", "object.pcd", "recording", "clouds", "dataset")
CAMERA = {  # what is stated otherwise than in the files
    "--intrinsics": "190,190,150,118",
    "--camera-info": "{folder}/other.yaml",
    "--info-topic": "/other/info",
    "--rectified": "yes",
    "--depth-scale": "0.0009",
}
OTHERS = {
    "--topic": "/depth/second", "--mask": "{folder}/mask.png", "--plane": "0,0,1,-2", "--scene": None, "--target": "largest",
    "--hand": "franka_hand", "--pixel": "{pixel}", "--point": "{point}",
}  # fmt: skip
BY_ALL = {"inputs", "--config", "--set", "--json", "--picture", "--labels-out", "--all", "--model", "--tare", "--touched", "--history", "--grasp", "--prequential"} | {
    "--tip-mm", "--count", "--slide-m", "--vary", "--color", "--panels",
}  # fmt: skip
"""Options that do not depend on the kind of source, and --color, which changes no answer; other tests have what they change."""

ALREADY = {("--scene", source) for source in ("depth.png", "folder", "depth.npz", "scene.npz", "recording", "clouds")} | {
    ("--rectified", source) for source in ("depth.npz",)
}  # fmt: skip
"""What such a source is without the option."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("sources")
    seen = random_scene(np.random.default_rng(3), width=320, height=240, n_objects=2).render()
    mm, k = seen.depth_mm, np.ravel(seen.K)
    fx, fy, cx, cy = k[[0, 4, 2, 5]]
    cloud = seen.cloud()
    one = cloud.xyz[seen.labels == 2]
    sent = info(height=240, width=320, k=k, p=np.insert(k * [0.9, 1, 1, 1, 0.9, 1, 1, 1, 1], [3, 6, 9], 0.0))
    own, other = f"K: [{fx}, {fy}, {cx}, {cy}]", f"K: [{fx * 0.9}, {fy * 0.9}, {cx}, {cy}]"
    p = f"projection_matrix: {{data: [{fx * 0.8}, 0, {cx}, 0, 0, {fy * 0.8}, {cy}, 0, 0, 0, 1, 0]}}"
    (folder / "other.yaml").write_text(other + "\n")
    (folder / "folder").mkdir()
    for path in (folder / "depth.png", folder / "folder" / "a-depth.png"):
        Image.fromarray(mm).save(path)
    (folder / "folder" / "a-info.yaml").write_text(f"{own}\n{p}\n")
    (folder / "own.yaml").write_text(f"{own}\n{p}\n")
    Image.fromarray((seen.labels == 2).astype(np.uint8)).save(folder / "mask.png")
    np.savez(folder / "depth.npz", depth=mm, K=seen.K)
    write_cloud(folder / "scene.npz", cloud)
    write_cloud(folder / "object.pcd", Cloud(one))
    second = image((mm * 0.99).astype(np.uint16), "16UC1")
    infos = [(name, STAMP_NS, sent) for name in ("/depth/camera_info", "/second/camera_info")]
    changed = info(height=240, width=320, k=k * [0.9, 1, 1, 1, 0.9, 1, 1, 1, 1], p=np.zeros(12))
    write_bag(
        folder / "recording",
        [
            *infos,
            ("/other/info", STAMP_NS, changed),
            ("/depth/first", STAMP_NS, image(mm, "16UC1")),
            ("/depth/second", STAMP_NS, second),
        ],
    )
    with BagWriter(folder / "clouds") as writer:
        writer.write_cloud(cloud, "/points", bag_time_ns=1)
    write_dataset(folder / "dataset", 1)
    v, u = np.argwhere(seen.labels == 2).mean(axis=0).round().astype(int)
    return {"folder": folder, "pixel": f"{u},{v}", "point": ",".join(f"{x:.3f}" for x in np.nanmean(one, axis=0))}


def words_of(source: str, made: dict[str, Any]) -> list[str]:
    path = str(made["folder"] / source)
    needed = {
        "depth.png": ["--camera-info", str(made["folder"] / "own.yaml"), "--rectified", "no"],
        "folder": ["--rectified", "no"],
    }
    return [path, *needed.get(source, []), *(["--topic", "/depth/first"] if source == "recording" else [])]


def answered(answer: Answer) -> tuple[Any, ...]:
    """What does not change from run to run."""
    return answer.status, re.sub(r'"ms": \{[^}]*\}', "", answer.out), answer.err


@pytest.mark.parametrize("command", ["segment", pytest.param("grasp", marks=pytest.mark.slow)])
def test_an_option_changes_the_answer_or_is_refused_by_its_name(
    command: str, made, call: Callable[..., Answer]
) -> None:
    declared = {
        action.option_strings[-1]
        for action in command_parser(command).commands[command].declared
        if action.option_strings
    }
    assert declared - BY_ALL - CAMERA.keys() - OTHERS.keys() == set()
    plain = {source: answered(call(command, *words_of(source, made), "--json")) for source in SOURCES}

    def check(option: str, value: str | None, source: str) -> None:
        words = words_of(source, made)
        given = [option] if value is None else [option, value.format(**made)]
        if option in words:
            words[words.index(option) + 1] = given[1]
            given = []
        if option in ("--intrinsics", "--info-topic") and "--camera-info" in words:
            at = words.index("--camera-info")
            del words[at : at + 2]
        if option == "--intrinsics" and "--rectified" in words:
            at = words.index("--rectified")
            del words[at : at + 2]
        answer = call(command, *words, *given, "--json")
        if (option, source) in ALREADY:
            return
        refused = answer.status == 1 and f"{option}" in answer.err
        told = (
            answer.status == 1
            and {"--topic": "is not a recording", "--mask": "mask: "}.get(option, option) in answer.err
        )
        assert refused or told or answered(answer) != plain[source], answer

    options = {**CAMERA, **{name: value for name, value in OTHERS.items() if name in declared}}
    every_case([(option, value, source) for option, value in options.items() for source in SOURCES], check)
