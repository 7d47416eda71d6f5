# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal

from foretouch.config import Settings, load_yaml, parse_overrides, setting, setting_infos
from foretouch.errors import ConfigError
from foretouch.pipeline import PipelineConfig


@dataclass(frozen=True, kw_only=True)
class Inner(Settings):
    range_m: float = setting(2.0, "How far", bounds=(0.1, 16.0))
    mode: str = setting("near", "Which", choices=("near", "far"))


@dataclass(frozen=True, kw_only=True)
class Outer(Settings):
    inner: Inner = Inner()
    count: int = setting(3, "How many", unit="grasps", minimum=1, read_only=True)
    point: tuple[float, ...] | None = setting(None, "Where")


def test_plain_data_with_nested_or_dotted_keys_reads_back() -> None:
    assert Outer.from_mapping({"inner": {"range_m": 3}}) == Outer.from_mapping({"inner.range_m": 3.0})
    made = Outer.from_mapping({"inner.mode": "far", "point": [1, 2.5], "count": 5})
    assert Outer.from_mapping(made.to_mapping()) == made
    assert made.point == (1.0, 2.5)
    changed = made.updated({"inner.range_m": 1})
    assert (changed.count, changed.inner.range_m, changed.inner.mode) == (5, 1.0, "far")


def test_dotted_and_nested_keys_together_lose_no_setting_in_either_order() -> None:
    dotted, nested = {"segmentation.crop.min_range_m": 0.4}, {"segmentation": {"crop": {"max_range_m": 1.5}}}
    for given in ({**dotted, **nested}, {**nested, **dotted}):
        crop = PipelineConfig.from_mapping(given).segmentation.crop
        assert (crop.min_range_m, crop.max_range_m) == (0.4, 1.5)
    for both in ({"segmentation.crop": 1, **dotted}, {**dotted, "segmentation.crop": 1}):
        with pytest.raises(ConfigError, match="crop is a value and a group at once"):
            PipelineConfig.from_mapping(both)


def test_refusals_name_field_value_and_rule() -> None:
    cases = [
        (r"f\.yaml: inner\.rnage_m: unknown setting; known: range_m, mode", {"inner": {"rnage_m": 3}}),
        (r"range_m: 17.0 is above 16.0 m", {"inner.range_m": 17}),
        (r"range_m: 0.0 is below 0.1 m", {"inner.range_m": 0}),
        (r"range_m: a whole number of 1329 bits", {"inner.range_m": 10**400}),
        ("'near' is not a number", {"inner.range_m": "near"}),
        ("nan is not finite", {"inner.range_m": float("nan")}),
        ("'middle' is not one of near, far", {"inner.mode": "middle"}),
        ("2.0 is not a whole number", {"count": 2.0}),
        ("True is not a whole number", {"count": True}),
        ("count: is empty", {"count": None}),
        ("1.0 is not a list", {"point": 1.0}),
        (r"point\[1\]: 'x' is not a number", {"point": [1, "x"]}),
        ("inner: 5 is not a group", {"inner": 5}),
        ("inner is a value and a group at once", {"inner": 5, "inner.range_m": 1}),
        ("inner is a value and a group at once", {"inner": 5} | {"inner.mode": {"a": 1}}),
    ]
    every_refusal(ConfigError, cases, lambda mapping: Outer.from_mapping(mapping, "f.yaml"))


@dataclass(frozen=True, kw_only=True)
class Scene(Settings):
    items: tuple[Inner, ...] = ()
    light: Inner | None = None
    sun: Inner = Inner()
    limit: int | None = setting(None, "How many")


def test_a_group_is_on_with_braces_off_with_null_and_refused_with_nothing_after_its_colon(tmp_path) -> None:
    path = tmp_path / "scene.yaml"

    def read(text: str) -> Scene:
        path.write_text(text)
        return Scene.from_mapping(load_yaml(path), "scene.yaml")

    assert read("light: {}").light == Inner()
    assert read("light: null") == read("light: ~") == read("{}") == Scene()
    assert Scene.from_mapping(Scene().to_mapping()) == Scene()  # as stored, with null
    cases = (
        (r"scene\.yaml: light: is empty; write {} for a group with its defaults, null for none", "light:"),
        (r"light: is empty", "{light: }"),
        (r"items\[1\]\.range_m: is empty", "items: [{}, {range_m: }]"),
        (r"limit: is empty", "limit: # none yet"),
        (r"sun: null is not a group of settings; {} is one", "sun: null"),
        (r"items\[0\]: .* is not a group", "items:\n-\n"),
        (r"items: is empty", "items:"),
    )
    every_refusal(ConfigError, cases, read)
    for text in ("light=", "light= "):
        with pytest.raises(ConfigError, match="--set: light: is empty"):
            Scene().updated(parse_overrides([text]), "--set")
    assert Scene(light=Inner()).updated(parse_overrides(["light=null"]), "--set") == Scene()


def test_groups_of_plain_data_numbers_of_numpy_and_paths_are_settings_as_in_a_mapping() -> None:
    config = PipelineConfig.from_mapping({"grasp.count": 3, "model": "mine.json"})
    assert PipelineConfig(grasp={"count": np.int64(3)}, model=Path("mine.json")) == config
    assert PipelineConfig().replace(grasp={"count": 3}).grasp == config.grasp


def test_lists_of_groups_absent_groups_and_a_field_without_setting() -> None:
    made = Scene.from_mapping({"items": [{"range_m": 1}, {"mode": "far"}]})
    assert [(item.range_m, item.mode) for item in made.items] == [(1.0, "near"), (2.0, "far")]
    assert made.light is None
    assert Scene.from_mapping(made.to_mapping()) == made
    assert Scene.from_mapping({"light": {}}).light == Inner()
    assert [info.name for info in setting_infos(Scene)] == ["sun.range_m", "sun.mode", "limit"]

    cases = [
        ("items: .* is not a list", {"items": {"range_m": 1}}),
        (r"items\[1\]: 3 is not a group", {"items": [{"range_m": 1}, 3]}),
        (r"items\[0\]\.rnage: unknown setting", {"items": [{"rnage": 1}]}),
        ("99.0 is above", {"light": {"range_m": 99}}),
    ]
    every_refusal(ConfigError, cases, Scene.from_mapping)

    @dataclass(frozen=True, kw_only=True)
    class Bare(Settings):
        width: float = 1.0

    with pytest.raises(TypeError, match=r"Bare\.width: declare it with setting"):
        Bare()


def test_overrides_and_files_are_yaml_and_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"

    def check(message: str, text: str) -> None:
        path.write_text(text)
        with pytest.raises(ConfigError, match=message) as caught:
            load_yaml(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)

    cases = [("holds a list", "- 1\n"), ("not YAML", "a: ["), ("not YAML", "!!python/object/apply:os.getcwd []")]
    every_case(cases, check)
    with pytest.raises(ConfigError, match=r"none\.yaml: No such file"):
        load_yaml(tmp_path / "none.yaml")
    assert parse_overrides(["a.b=1", "c=[1, 2]", "d=x=y"]) == {"a.b": 1, "c": [1, 2], "d": "x=y"}
    with pytest.raises(ConfigError, match="is not key=value"):
        parse_overrides(["a"])
