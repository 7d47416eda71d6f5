# SPDX-License-Identifier: Apache-2.0
"""What is misspelled is refused in one line that names it and the nearest known name (options: `test_help`)."""

from pathlib import Path

import pytest
from every_case import every_case

CONFIG = Path(__file__).parents[2] / "config"
SCENE = "objects:\n  - {name: can, shape: can, size_m: [0.07, 0.07, 0.1]}\n"

FIELDS = (  # of a scene, of the pipeline, of a training
    ("simulate", "camera: {noize: {}}", "camera.noize", "noise"),
    ("segment", "segmentation: {crop: {max_rnage_m: 1.0}}", "segmentation.crop.max_rnage_m", "max_range_m"),
    ("train", "methd: contact", "methd", "method"),
)
NAMES = (  # recipes, experiments, areas, presets, models, splits
    (("train", "p3", "data=x", "-o", "y"), "p3: is neither a file nor one of", "p2"),
    (("experiment", "cross_validaton", "-o", "y"), "'cross_validaton'", "cross_validation"),
    (("experiment", "cross_validation", "-o", "y", "--preset", "smokee"), "'smokee'", "smoke"),
    (("tradeoff", "modle", "-o", "y"), "'modle'", "model"),
    (("predict", "x.pcd", "--model", "contact_v2"), "contact_v2", "contact-v2"),
)
NODES = (
    ("/foretouch/touch_predicter", "/foretouch/touch_predictor"),
    ("/foretuch/grasp", "/foretouch/grasp"),
    ("touch_predictor", "/foretouch/touch_predictor"),
    ("/left/touch_predicter", "/foretouch/touch_predictor"),
)
PARAMETERS = (
    ("/foretouch/touch_predictor", "use_tarre: false", "use_tarre", "use_tare"),
    ("/foretouch/segmentation", "target.mode_: all", "target.mode_", "target.mode"),
    ("/foretouch/grasp", "use_tare: false", "use_tare", None),  # a parameter of another node
    ("/**", "latency_budget: 5.0", "latency_budget", "latency_budget_ms"),
    ("/foretouch/*", "queue_deth: 3", "queue_deth", "queue_depth"),
)


def test_fields_of_files_and_of_words(call, files, tmp_path) -> None:
    def check(command: str, text: str, field: str, nearest: str) -> None:
        path = tmp_path / "own.yaml"
        path.write_text(SCENE * (command == "simulate") + text + "\n")
        words = {"simulate": (path, "--explain"), "segment": (files / "scene.npz", "--config", path)}
        answer = call(command, *words.get(command, (path, "data=x", "-o", "y")))
        answer.check_refused(f"{path}")
        answer.check_refused(f": {field}: unknown setting; known: ")
        answer.check_refused(f"; did you mean {nearest}?")

    every_case(FIELDS, check)
    scene = CONFIG / "scenes/clean.yaml"
    answer = call("simulate", scene, "--explain", "--set", "camera.noize={}")
    answer.check_refused("foretouch: --set: camera.noize: unknown setting")  # not in the file
    answer.check_refused("did you mean noise?")
    call("train", "contact-v2", "trees=3", "data=x", "-o", "y").check_refused("did you mean contact.trees?")


def test_names_of_recipes_experiments_and_models(call) -> None:
    def check(words: tuple[str, ...], name: str, nearest: str) -> None:
        answer = call(*words)
        answer.check_refused(name)
        answer.check_refused(f"; did you mean {nearest}?")

    every_case([(" ".join(words), words, *rest) for words, *rest in NAMES], lambda _, *case: check(*case))
    call("train", "p3", "data=x", "-o", "y").check_refused(
        "contact-v2, p1, p1_as_published, p2, p2_srgan, simulated, touchnet-v1"
    )


def test_nodes_and_parameters_in_files_and_on_the_command_line(call, tmp_path) -> None:
    pytest.importorskip("rclpy")
    from foretouch.errors import ConfigError
    from foretouch.ros.graph import NODES as KNOWN
    from foretouch.ros.runtime.parameter_files import check_parameters

    path = tmp_path / "robot.yaml"

    def refused(node: str, text: str, *wanted: str) -> None:
        path.write_text(f"{node}:\n  ros__parameters:\n    {text}\n")
        answer = call("record", "-o", tmp_path / "out", "--params", path)
        for one in (f"{path}: /{node.strip('/')}: ", *wanted):
            answer.check_refused(one)

    def check_node(node: str, nearest: str) -> None:
        refused(node, "autostart: true", "there is no such node", f"did you mean {nearest}?")

    def check_parameter(node: str, text: str, name: str, nearest: str | None) -> None:
        refused(node, text, f": {name}: unknown parameter", f"; did you mean {nearest}?" if nearest else "")

    every_case(NODES, check_node)
    every_case(PARAMETERS, check_parameter)
    refused("/foretouch/recorder", "points:", "points: is empty")

    def accepted(node: str, text: str, namespace: str = "/foretouch") -> None:
        path.write_text(f"{node}:\n  ros__parameters:\n    {text}\n")
        check_parameters(["--ros-args", "--params-file", str(path)], KNOWN, ["grasp"], namespace)

    correct = [
        ("/foretouch/touch_predictor", "{use_tare: false, use_sim_time: true}"),
        ("/foretouch:\n touch_predictor", "use_tare: false"),  # a namespace
        ("/**", "{use_tare: false, qos_overrides./foretouch/touch.publisher.depth: 3}"),
        ("/**/grasp", "grasp.count: 3"),
        ("/left/grasp", "grasp.count: 3"),
        ("/robot2/grasp", "grasp.count: 3", "/robot1"),
        ("/move_group", "anything: 3"),
        ("/foretouch_planner/planner", "anything: 3"),
    ]
    every_case(correct, accepted)
    for words, text in (
        (["-p", "use_tare:=false"], "-p use_tare:=false: use_tare: unknown parameter"),
        (["-p", "grasp.cont:=3"], "did you mean grasp.count?"),
        (["--param", "touch_predictor:use_tarre:=false"], "did you mean use_tare?"),
    ):
        with pytest.raises(ConfigError) as err:
            check_parameters(["--ros-args", *words], KNOWN, ["grasp"], "/foretouch")
        assert text in str(err.value)
    check_parameters(["--ros-args", "-p", "grasp.count:=3"], KNOWN, ["grasp"], "/foretouch")
