# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from sim_builders import CAN, SPONGE, scene

from foretouch.errors import ConfigError
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.scene.objects import ObjectConfig, draw_families
from foretouch_lab.simulation.simulate import explain_scene

SCENES = {path.stem: path for path in sorted((Path(__file__).parents[4] / "config" / "scenes").glob("*.yaml"))}
MIXED = {"shapes": ["random", "can", "ball"], "rests": ["upright", "side"], "young_pa": [1e4, 1e6], "count": 40}


def test_every_scene_of_the_repository_loads_and_can_be_explained() -> None:
    assert set(SCENES) >= {"deformables", "deformables_wide", "rigid", "clutter", "clean", "unseen_objects"}
    for path in SCENES.values():
        plans = {plan.name: plan for plan in explain_scene(load_scene(path))}
        assert plans["grasp"].runs
        assert all(plan.reason for plan in plans.values())
    path = SCENES[
        "deformables"
    ]  # frozen: renew the hash, of `foretouch simulate --explain --json`, only with every model
    assert load_scene(path).sha256() == path.with_suffix(".sha256").read_text().strip()
    assert len(load_scene(SCENES["unseen_objects"]).objects) >= 90  # enough to calibrate and to judge on


def test_the_hash_covers_every_setting_and_a_scene_survives_the_way_through_plain_data() -> None:
    plain, random = scene(CAN), scene(CAN | {"shape": "random"})
    groups = {"fingers": {"sessions": {}}, "camera": {"holes": {}}, "campaign": {}, "seed": 1}
    groups["grasps"] = {"geograsp": {"method": "original"}}
    others = [scene(CAN, **{name: group}) for name, group in groups.items()]
    others.append(scene(CAN, fingers={"thumb": {"pdc_span": 620.0}}))
    others += [random, scene(CAN | {"shape": "random", "first_variant": 1})]
    assert len({other.sha256() for other in (plain, *others)}) == 1 + len(others)
    fingers = {"timeline": {"hold_s": 1.0}, "scan": {}, "thumb": {"electrode_rest": 3000}}
    config = scene(CAN, SPONGE, camera={"noise": {}}, fingers=fingers)
    again = SceneConfig.from_mapping(config.to_mapping())
    assert (again, again.sha256()) == (config, config.sha256())


def drawn(**values: Any) -> list[ObjectConfig]:
    return draw_families([values], "")


def test_objects_of_a_family_draw_values_of_their_own_within_the_ranges_whatever_their_number() -> None:
    items = drawn(**MIXED, size_m=[0.04, 0.09], thickness_m=[0.01, 0.02])
    assert [item.name for item in items[:2]] == ["obj_000", "obj_001"]
    assert len({item.size_m for item in items}) == len({item.young_pa for item in items}) == 40
    assert all(0.04 <= edge <= 0.09 for item in items for edge in item.size_m)
    assert all(item.thickness_m is not None and 0.01 <= item.thickness_m <= 0.02 for item in items)
    assert {item.shape for item in items} == {"random", "can", "ball"}
    assert {item.pose.rest for item in items} == {"upright", "side"}
    members = [item.first_variant for item in items if item.shape == "random"]
    assert len(set(members)) == len(members)
    assert drawn(**MIXED | {"count": 60})[:40] == drawn(**MIXED) != drawn(**MIXED, seed=1)
    # The median of the draws from 10 kPa to 1 MPa is near 100 kPa; uniform in the modulus it would be 505 kPa.
    moduli = [item.young_pa for item in drawn(young_pa=[1e4, 1e6], count=400)]
    assert np.median(np.log10(np.array(moduli, np.float64))) == pytest.approx(5.0, abs=0.15)
    plain, heavy = drawn(count=8), drawn(count=8, mass_kg=[0.05, 0.2])
    assert all(0.05 <= one.mass_kg <= 0.2 for one in heavy if one.mass_kg)
    assert [one.replace(mass_kg=None) for one in heavy] == plain
    config = SceneConfig.from_mapping({"objects": [CAN], "families": [{"count": 3}, {"name": "pad", "count": 2}]})
    assert [item.name for item in config.objects] == ["can", "obj_000", "obj_001", "obj_002", "pad_000", "pad_001"]
    assert SceneConfig.from_mapping(config.to_mapping()) == config


def test_contradictions_are_named() -> None:
    cases = [
        ({"objets": []}, r"objets: unknown setting; known: objects"),
        ({"camera": {"noise": {"subpixel": 1}}}, r"camera.noise.subpixel: unknown setting"),
        ({"grasps": {"balanced": False}}, r"grasps.balanced: unknown setting"),
        ({"objects": []}, r"objects: there is none"),
        ({"objects": [CAN, CAN]}, r"objects: two have the name can"),
        ({"objects": [CAN | {"shape": "cube"}]}, r"shape: 'cube' is not one of"),
        ({"objects": [CAN | {"thickness_m": 0.01}]}, r"can.young_pa: needs thickness_m, and"),
        ({"objects": [CAN | {"variants": 3}]}, r"can.variants, first_variant: the shape can has one"),
        ({"objects": [CAN | {"colour": [1, 2]}]}, r"can.colour: \[1, 2\] is not red, green and blue"),
        ({"objects": [CAN | {"size_m": [0.1, 0.1]}]}, r"size_m: \[0.1, 0.1\] is not three lengths"),
        ({"objects": [CAN | {"pose": {"x_m": [0.6, 0.65]}}]}, r"objects\[0\] can.pose: may lie outside of the view"),
        ({"objects": [CAN | {"pose": {"x_m": [0.1, 0.0]}}]}, r"x_m: \[0.1, 0.0\] is not \[low, high\]"),
        ({"gravity": {}}, r"mass_kg: absent, but the scene has gravity"),
        ({"fidelity": "exact"}, r"fidelity: 'exact' is not one of auto, winkler"),
        ({"fingers": {"creep": {}}}, r"creep: acts over time, but there is no timeline"),
        ({"grasps": {"thumb": {"force_n": [-1, 2]}}}, r"force_n\[0\]: -1.0 is below 0"),
        ({"campaign": {}, "fingers": {"drift": {}}}, r"fingers.drift: draws .* give campaign.warm_up in its place"),
        ({"campaign": {"days": [1, 2]}}, r"days: \[1.0, 2.0\] does not begin with 0"),
        ({"campaign": {"days": [0, 0.01]}}, r"session 1 starts 0.01 days after session 0, which may take 0.0986 days"),
        ({"campaign": {"exchanges": [{"session": 3}]}}, r"exchanges\[0\].session: 3, but the last session is 0"),
        ({"campaign": {"days": [0, 1], "exchanges": [{}, {}]}}, r"exchanges\[1\]: the thumb is exchanged twice at s"),
        ({"campaign": {"drift": [{"counts": 1}]}}, r"campaign.drift\[0\].counts: unknown setting"),
        ({"families": [{"size_m": [0.1, 0.05]}]}, r"s.yaml: families\[0\]: size_m: \[0.1, 0.05\] is not \[low, high\]"),
        ({"families": [{"shapes": []}]}, r"shapes: there is none"),
        ({"families": [{"number": 3}]}, r"families\[0\]: number: unknown setting; known: name, count"),
    ]

    def check(mapping: dict[str, Any], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            SceneConfig.from_mapping({"objects": [CAN], **mapping}, "s.yaml")

    every_case(cases, check)
