# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import pytest
from sim_builders import CAN, SPONGE, scene

from foretouch.errors import ConfigError
from foretouch.simulation.scene import SceneConfig, load_scene
from foretouch.simulation.simulate import explain_scene

SCENES = sorted((Path(__file__).parents[3] / "config" / "scenes").glob("*.yaml"))


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_every_scene_of_the_repository_loads_and_can_be_explained(path: Path) -> None:
    config = load_scene(path)
    told = {plan.name: plan for plan in explain_scene(config)}
    assert told["grasp"].runs
    assert told["counts"].runs
    assert all(plan.reason for plan in told.values())


def test_the_promised_scenes_are_there() -> None:
    assert {p.stem for p in SCENES} >= {"deformables", "rigid", "clutter", "lookalikes", "clean", "unseen_objects"}


def test_the_scene_that_models_are_trained_on_is_frozen() -> None:
    """Renew the hash, printed by `foretouch simulate SCENE --explain --json`, only together with every model."""
    path = next(p for p in SCENES if p.stem == "deformables")
    assert load_scene(path).sha256() == path.with_suffix(".sha256").read_text().strip()


def test_a_setting_younger_than_the_frozen_scenes_counts_where_it_is_given() -> None:
    plain = scene(CAN)
    assert "sessions" in plain.to_mapping()["fingers"]
    assert scene(CAN, fingers={"sessions": {}}).sha256() != plain.sha256()
    assert scene(CAN | {"shape": "random", "first_variant": 1}).sha256() != scene(CAN | {"shape": "random"}).sha256()


def test_the_unseen_objects_are_enough_to_calibrate_and_to_judge_on() -> None:
    config = load_scene(next(p for p in SCENES if p.stem == "unseen_objects"))
    assert len(config.objects) >= 90
    assert config.fingers.sessions is not None


def test_look_alikes_differ_in_stiffness_only() -> None:
    config = load_scene(next(p for p in SCENES if p.stem == "lookalikes"))
    first, second = (item.to_mapping() for item in config.objects)
    assert {key for key in first if first[key] != second[key]} <= {"name", "young_pa"}
    assert first["young_pa"] != second["young_pa"]


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"objets": []}, r"objets: unknown setting; known: objects"),
        ({"camera": {"noise": {"subpixel": 1}}}, r"camera.noise.subpixel: unknown setting"),
        ({"objects": []}, r"objects: there is none"),
        ({"objects": [CAN, CAN]}, r"objects: two have the name can"),
        ({"objects": [CAN | {"shape": "cube"}]}, r"shape: 'cube' is none of"),
        ({"objects": [CAN | {"thickness_m": 0.01}]}, r"can.thickness_m: 0.01 m of a rigid object; give young_pa"),
        ({"objects": [CAN | {"young_pa": 2e4}]}, r"can.young_pa: 20000 Pa of no layer; give thickness_m"),
        ({"objects": [CAN | {"variants": 3}]}, r"can.variants: 3, but the shape can has one"),
        ({"objects": [CAN | {"first_variant": 3}]}, r"can.first_variant: 3, but the shape can has one"),
        ({"objects": [CAN | {"size_m": [0.1, 0.1]}]}, r"size_m: \[0.1, 0.1\] is not three lengths"),
        ({"objects": [CAN | {"size_m": [0.2, 0.3, 0.2]}]}, r"can.size_m: 0.2 m at its narrowest, the hand opens 0.13"),
        ({"objects": [CAN | {"pose": {"x_m": [0.6, 0.65]}}]}, r"objects\[0\] can.pose: may lie outside of the view"),
        ({"objects": [CAN | {"pose": {"x_m": [0.1, 0.0]}}]}, r"PoseConfig.x_m: \[0.1, 0.0\] is not \[low, high\]"),
        ({"table": {"size_m": [0.04, 1.0]}}, r"objects\[0\] object.pose: may lie beside the table"),
        ({"camera": {"noise": {"sub_pixel": -0.1}}}, r"sub_pixel: -0.1 is below 0"),
        ({"gravity": {}}, r"mass_kg: absent, but the scene has gravity"),
        ({"fidelity": "exact"}, r"fidelity: 'exact' is none of auto, hertz"),
        ({"fingers": {"creep": {}}}, r"FingersConfig.creep: acts over time, but there is no timeline"),
        ({"fingers": {"noise": {"electrode_counts": -4}}}, r"electrode_counts: -4.0 is below 0"),
        ({"grasps": {"middle": {"force_n": [1, 2]}}}, r"GraspsConfig.middle: .*balanced fingers share one force"),
        ({"grasps": {"thumb": {"force_n": [-1, 2]}}}, r"TargetConfig.force_n: -1.0 is below 0"),
    ],
)
def test_contradictions_are_named(mapping: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SceneConfig.from_mapping(mapping, "s.yaml")


def test_a_scene_survives_the_way_through_plain_data() -> None:
    config = scene(CAN, SPONGE, camera={"noise": {}}, fingers={"timeline": {"hold_s": 1.0}, "scan": {}})
    again = SceneConfig.from_mapping(config.to_mapping())
    assert again == config
    assert again.sha256() == config.sha256()
    assert config.replace(seed=1).sha256() != config.sha256()


def test_a_thumb_that_is_changed_in_part_keeps_the_rest_of_a_thumb() -> None:
    config = scene(fingers={"thumb": {"pdc_gain": 1.2}})
    assert config.fingers.thumb.pdc_rest == scene().fingers.thumb.pdc_rest != config.fingers.middle.pdc_rest
