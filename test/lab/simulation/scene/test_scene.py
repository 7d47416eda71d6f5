# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import pytest
from every_case import every_case
from sim_builders import CAN, SPONGE, scene

from foretouch.errors import ConfigError
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.simulate import explain_scene

SCENES = {path.stem: path for path in sorted((Path(__file__).parents[4] / "config" / "scenes").glob("*.yaml"))}


def test_every_scene_of_the_repository_loads_and_can_be_explained() -> None:
    assert set(SCENES) >= {"deformables", "deformables_wide", "rigid", "clutter", "clean", "unseen_objects"}
    for path in SCENES.values():
        plans = {plan.name: plan for plan in explain_scene(load_scene(path))}
        assert plans["grasp"].runs
        assert plans["counts"].runs
        assert all(plan.reason for plan in plans.values())


def test_the_scene_that_models_are_trained_on_is_frozen_and_others_are_what_they_are_for() -> None:
    """Renew the hash, printed by `foretouch simulate SCENE --explain --json`, only together with every model."""
    path = SCENES["deformables"]
    assert load_scene(path).sha256() == path.with_suffix(".sha256").read_text().strip()
    unseen = load_scene(SCENES["unseen_objects"])
    assert len(unseen.objects) >= 90  # enough to calibrate and to judge on
    assert unseen.fingers.sessions is not None


def test_the_hash_covers_every_setting_and_a_scene_survives_the_way_through_plain_data() -> None:
    plain, random = scene(CAN), scene(CAN | {"shape": "random"})
    groups = {"fingers": {"sessions": {}}, "camera": {"holes": {}}, "campaign": {}, "seed": 1}
    groups["grasps"] = {"geograsp": {"method": "original"}}
    others = [scene(CAN, **{name: group}) for name, group in groups.items()]
    others.append(scene(CAN, fingers={"thumb": {"pdc_span": 620.0}}))
    others += [random, scene(CAN | {"shape": "random", "first_variant": 1})]
    assert len({one.sha256() for one in (plain, *others)}) == 1 + len(others)
    fingers = {"timeline": {"hold_s": 1.0}, "scan": {}, "thumb": {"electrode_rest": 3000}}
    config = scene(CAN, SPONGE, camera={"noise": {}}, fingers=fingers)
    again = SceneConfig.from_mapping(config.to_mapping())
    assert again == config
    assert again.sha256() == config.sha256()
    assert config.fingers.thumb.pdc_rest == scene().fingers.thumb.pdc_rest != scene().fingers.middle.pdc_rest


def test_contradictions_are_named() -> None:
    cases = [
        ({"objets": []}, r"objets: unknown setting; known: objects"),
        ({"camera": {"noise": {"subpixel": 1}}}, r"camera.noise.subpixel: unknown setting"),
        ({"camera": {"holes": {"share": 0.1}}}, r"camera.holes.share: unknown setting"),
        ({"objects": []}, r"objects: there is none"),
        ({"objects": [CAN, CAN]}, r"objects: two have the name can"),
        ({"objects": [CAN | {"shape": "cube"}]}, r"shape: 'cube' is not one of"),
        ({"objects": [CAN | {"thickness_m": 0.01}]}, r"can.thickness_m: 0.01 m of a rigid object; give young_pa"),
        ({"objects": [CAN | {"young_pa": 2e4}]}, r"can.young_pa: 20000 Pa of no layer; give thickness_m"),
        ({"objects": [CAN | {"variants": 3}]}, r"can.variants: 3, but the shape can has one"),
        ({"objects": [CAN | {"first_variant": 3}]}, r"can.first_variant: 3, but the shape can has one"),
        ({"objects": [CAN | {"colour": [1, 2]}]}, r"can.colour: \[1, 2\] is not red, green and blue"),
        ({"objects": [CAN | {"size_m": [0.1, 0.1]}]}, r"size_m: \[0.1, 0.1\] is not three lengths"),
        ({"objects": [CAN | {"size_m": [0.2, 0.3, 0.2]}]}, r"can.size_m: 0.2 m at its narrowest, the hand opens 0.13"),
        ({"objects": [CAN | {"pose": {"x_m": [0.6, 0.65]}}]}, r"objects\[0\] can.pose: may lie outside of the view"),
        ({"objects": [CAN | {"pose": {"x_m": [0.1, 0.0]}}]}, r"x_m: \[0.1, 0.0\] is not \[low, high\]"),
        (
            {"objects": [CAN | {"pose": {"x_m": [0.7, 0.8]}}], "camera": {"distance_m": 3}},
            r"can.pose: may lie beside the t",
        ),
        ({"camera": {"noise": {"sub_pixel": -0.1}}}, r"sub_pixel: -0.1 is below 0"),
        ({"gravity": {}}, r"mass_kg: absent, but the scene has gravity"),
        ({"fidelity": "exact"}, r"fidelity: 'exact' is not one of auto, winkler"),
        ({"fingers": {"creep": {}}}, r"creep: acts over time, but there is no timeline"),
        ({"fingers": {"noise": {"electrode_counts": -4}}}, r"electrode_counts: -4.0 is below 0"),
        ({"grasps": {"middle": {"force_n": [1, 2]}}}, r"middle: .*balanced fingers share one force"),
        ({"grasps": {"thumb": {"force_n": [-1, 2]}}}, r"force_n: -1.0 is below 0"),
        ({"campaign": {}, "fingers": {"drift": {}}}, r"fingers.drift: draws .* give campaign.warm_up in its place"),
        ({"campaign": {}, "fingers": {"sessions": {}}}, r"fingers.sessions: draws .* give campaign.drift in its place"),
        ({"campaign": {"days": [1, 2]}}, r"days: \[1.0, 2.0\] does not begin with 0"),
        ({"campaign": {"days": [0, 2, 1]}}, r"session 2 starts -1 days after session 1, which may take"),
        ({"campaign": {"days": [0, 0.01]}}, r"session 1 starts 0.01 days after session 0, which may take 0.0986 days"),
        ({"campaign": {"exchanges": [{"session": 3}]}}, r"exchanges\[0\].session: 3, but the last session is 0"),
        ({"campaign": {"days": [0, 1], "exchanges": [{}, {}]}}, r"exchanges\[1\]: the thumb is exchanged twice at s"),
        ({"campaign": {"exchanges": [{"finger": "ring"}]}}, r"finger: 'ring' is not one of thumb, middle"),
        ({"campaign": {"drift": [{"memory_days": 0}]}}, r"memory_days: 0.0 is below 0.05 days"),
        ({"campaign": {"drift": [{"counts": 1}]}}, r"campaign.drift\[0\].counts: unknown setting"),
        ({"campaign": {"tares": "often"}}, r"tares: 'often' is not one of grasp, object, session, none"),
        ({"families": [{"size_m": [0.1, 0.05]}]}, r"s.yaml: families\[0\].size_m: \[0.1, 0.05\] is not \[low, high\]"),
        ({"families": [{"young_pa": [1e5]}]}, r"young_pa: \[100000.0\] is not \[low, high\]"),
        ({"families": [{"shapes": []}]}, r"shapes: there is none"),
        ({"families": [{"shapes": ["cube"]}]}, r"shapes\[0\]: 'cube' is not one of"),
        ({"families": [{"number": 3}]}, r"families\[0\].number: unknown setting; known: name, count"),
    ]

    def check(mapping: dict[str, Any], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            SceneConfig.from_mapping({"objects": [CAN], **mapping}, "s.yaml")

    every_case(cases, check)
