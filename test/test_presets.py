# SPDX-License-Identifier: Apache-2.0
"""Presets are valid, what is set besides counts, and `default` changes nothing."""

import json
from pathlib import Path

import pytest
from every_case import every_case

from foretouch.cli.main import main
from foretouch.config import flattened
from foretouch.errors import ConfigError
from foretouch.pipeline import PipelineConfig, preset_files, preset_settings

ROOT = Path(__file__).parents[1]


def test_presets_are_valid_and_the_default_one_is_equal_to_the_defaults() -> None:
    assert set(preset_files()) == {"fast", "default", "exact"}
    default = PipelineConfig()
    assert default.updated({"preset": "default"}) == default
    assert PipelineConfig.from_mapping({"preset": "default"}) == default

    def check(name: str) -> None:
        stated = preset_settings(name)
        assert stated.keys() == preset_settings("default").keys()  # so that any preset takes another one's place
        changed = default.updated({"preset": name})
        assert {key: value for key, value in flattened(changed.to_mapping()).items() if key in stated} == stated
        assert changed.updated({"preset": "default"}) == default
        assert (changed == default) == (name == "default")
        assert (ROOT / "config/presets" / f"{name}.yaml").read_text() == preset_files()[name].read_text()

    every_case(list(preset_files()), check)


def test_what_is_set_beside_a_preset_counts_and_wrong_presets_are_named(tmp_path: Path) -> None:
    for values in ({"grasp.max_points": 77, "preset": "fast"}, {"preset": "fast", "grasp": {"max_points": 77}}):
        config = PipelineConfig().updated(values)
        assert (config.grasp.max_points, config.segmentation.grid_rows) == (77, 60)
    own = tmp_path / "own.yaml"
    own.write_text("grasp: {count: 3}\n")
    assert PipelineConfig().updated({"preset": str(own)}).grasp.count == 3
    texts = {
        "slow": "preset: slow: is neither a file nor one of default, exact, fast",
        str(own): r"own.yaml: grasp.points: unknown setting",
    }
    own.write_text("grasp: {points: 3}\n")
    for name, text in texts.items():
        with pytest.raises(ConfigError, match=text):
            PipelineConfig().updated({"preset": name})
    own.write_text("preset: fast\n")
    with pytest.raises(ConfigError, match="a preset holds no other one"):
        PipelineConfig().updated({"preset": str(own)})


def test_a_preset_is_one_word_of_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def printed(*words: str) -> object:
        assert main(["segment", str(ROOT / "examples/data/table.npz"), "--json", *words]) == 0
        return json.loads(capsys.readouterr().out)["objects"]

    config = tmp_path / "mine.yaml"
    config.write_text("preset: fast\n")
    by_name = printed("--set", "preset=fast")
    assert by_name == printed("--config", str(config)) == printed("--set", "segmentation.grid_rows=60")
    assert printed("--set", "preset=default") == printed() != by_name
