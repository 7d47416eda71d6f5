# SPDX-License-Identifier: Apache-2.0
"""A bag of XELA's messages becomes a recording that names its sensor, and everything that is made of one."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from every_case import every_case
from recording_builders import IDENTITY, QUICK
from sensor_builders import XELA_TYPES, sens_stream, xela_counts, xela_stream
from topic_builders import Faults, write_topics

from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.importing import BagTopics, WriteResult, import_samples
from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.sample_codec import SAMPLE_TYPE, encode_sample
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import SampleSet, describe
from foretouch.dataset.store import Store, content_sha256
from foretouch.errors import DatasetError, FileError, TactileError
from foretouch.tactile.description import load_sensor, packaged_sensor
from foretouch.tactile.messages.table import TactileConfig
from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import build_store

NAME = "xela_uskin_4x4"
AT = 1_700_000_003_000_000_000  # when contact began [ns]


def imported(folder: Path, message: Any = None, sensor: str = NAME, **config: str) -> tuple[WriteResult, SampleSet]:
    folder.mkdir(exist_ok=True)
    write_topics(folder / "bag", Faults(), message or xela_stream(), XELA_TYPES)
    topics = BagTopics(object="sponge", tactile_config=TactileConfig(sensor=sensor, **config))
    result = import_samples(folder / "bag", folder / "ds", identity=IDENTITY, topics=topics)
    return result, open_samples(folder / "ds")


def as_touch(level: int) -> np.ndarray:
    """As a touch holds them: X_TH (16), X_FF (16), Y_TH ..."""
    return xela_counts(level).transpose(2, 0, 1).ravel()


def labelled(samples: SampleSet) -> Sample:
    (found,) = (sample for sample in samples if sample.touch is not None)
    return found


def described(folder: Path, **changes: Any) -> str:
    """The description of the sensor, with some settings changed."""
    folder.mkdir(exist_ok=True)
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump({**packaged_sensor(NAME).to_mapping(), **changes}))
    return str(path)


def test_its_touch_has_all_values_by_channel_and_finger_and_the_recording_names_it(tmp_path: Path) -> None:
    result, samples = imported(tmp_path)
    assert (result.samples, result.labelled, sum(result.left_out.values())) == (2, 1, 0)
    assert (samples.sensor.config.name, samples.sensor.sha256) == (NAME, packaged_sensor(NAME).sha256)
    one = labelled(samples)
    assert one.touch.channels.modalities == ("X_TH", "X_FF", "Y_TH", "Y_FF", "Z_TH", "Z_FF")
    np.testing.assert_array_equal(one.touch.values, as_touch(100))
    np.testing.assert_array_equal(one.tare.values, as_touch(0))
    assert (one.series.counts.shape[1], one.flags, one.contact_ns) == (96, ("frozen_TH", "frozen_FF"), AT)
    assert [report.fault_lines() for report in verify_dataset(tmp_path / "ds")] == [[]]
    info = describe(open_samples(tmp_path / "ds", unfinished=True))
    assert info["sensor"] == f"{NAME} ({samples.sensor.sha256[:8]})"
    assert (info["ranges"]["Z_FF"], info["units"]["Z_FF"]) == ((30_600.0, 31_050.0), "counts")
    with Recording(next((tmp_path / "ds").glob("*.mcap"))) as bag:
        assert [topic.type for topic in bag.topics if topic.name == "/foretouch/samples"] == [SAMPLE_TYPE]


def test_it_is_built_and_exported_and_read_back(tmp_path: Path) -> None:
    _, samples = imported(tmp_path)
    build_store([tmp_path / "ds"], tmp_path / "store")
    store = Store(tmp_path / "store")
    assert content_sha256(store) == store.sha256
    assert store.sensor.sha256 == samples.sensor.sha256
    one = labelled(samples)

    def check(kind: str) -> None:
        out = tmp_path / kind
        assert export_samples(tmp_path / "ds", out, kind).samples >= 1
        again = open_samples(out) if kind != "rosbag2" else None
        if again is None:
            import_samples(out, tmp_path / "again")
            again = open_samples(tmp_path / "again")
        found = labelled(again)
        assert again.sensor.sha256 == samples.sensor.sha256
        assert encode_sample(found, IDENTITY, again.sensor) == encode_sample(one, IDENTITY, samples.sensor)

    every_case(["npz", "lerobot", "rosbag2"], check)
    features = json.loads((tmp_path / "lerobot/meta/info.json").read_text())["features"]
    assert features["observation.tactile.FF"]["names"][15:17] == ["taxel_x_16", "taxel_y_1"]
    with pytest.raises(TactileError, match=r"ds: is of xela_uskin_4x4 \(\w+\): not biotac_sp"):
        export_samples(tmp_path / "ds", tmp_path / "v2t", "vision2tactile")


def test_taxels_that_fail_are_replaced_and_counted_and_half_of_them_are_no_finger(tmp_path: Path) -> None:
    fingers = packaged_sensor(NAME).to_mapping()["fingers"]
    path = described(tmp_path, fingers=[{**fingers[0], "dead": [0, 5]}, fingers[1]])
    result, samples = imported(tmp_path / "dead", sensor=path)
    expected, z = xela_counts(100)[0, :, 2].astype(float), labelled(samples).touch["Z_TH"]
    expected[[0, 5]] = expected[[1, 4]].mean(), expected[[1, 4, 6, 9]].mean()
    np.testing.assert_array_equal(z, expected)
    assert +result.left_out == {"taxels_dead": 1000}
    assert describe(open_samples(tmp_path / "dead/ds", unfinished=True))["dead"] == {"TH": [0, 5]}
    path = described(tmp_path, fingers=[{**fingers[0], "dead": list(range(8))}, fingers[1]])
    result, samples = imported(tmp_path / "half", sensor=path)
    assert (result.labelled, result.left_out["not_read_TH"], result.left_out["no_tactile"]) == (0, 500, 1)


def test_what_is_not_of_the_sensor_is_refused_or_counted_by_name(tmp_path: Path) -> None:
    imported(tmp_path)
    values = packaged_sensor(NAME).to_mapping()["values"]
    changed = described(tmp_path, values=[*values[:2], {**values[2], "range": [0, 50_000]}])
    refused = r"sensor: xela_uskin_4x4 \(\w+\) there, "
    cases = {
        "another description": (load_sensor(changed), rf"{refused}xela_uskin_4x4 \(\w+\) here$"),
        "another sensor": (packaged_sensor("biotac_sp"), rf"{refused}biotac_sp \(\w+\) here$"),
    }

    def check(sensor: Any, rule: str) -> None:
        with pytest.raises(FileError, match=rule):
            RecordingWriter(tmp_path / "ds", IDENTITY, QUICK, sensor=sensor)

    every_case(cases, check)
    with pytest.raises(FileError, match=r"holds xela_server_ros2/SensStream; supported: foretouch_msgs/BiotacAll"):
        import_samples(tmp_path / "bag", tmp_path / "other")
    write_topics(tmp_path / "biotac")
    topics = BagTopics(tactile_config=TactileConfig(sensor=NAME))
    with pytest.raises(FileError, match=r"BiotacAll; supported: xela_server_ros2/SensStream"):
        import_samples(tmp_path / "biotac", tmp_path / "other", topics=topics)
    for name, change in (("taxels", lambda found: found[:, :8]), ("fingers", lambda found: found[:1])):
        short = xela_stream(change) if name == "taxels" else one_finger
        result, _ = imported(tmp_path / name, short)
        assert (result.labelled, result.left_out["unreadable /rh/tactile"]) == (0, 500), name
    one = labelled(open_samples(tmp_path / "ds"))
    with RecordingWriter(tmp_path / "biotac_ds", IDENTITY, QUICK) as writer:
        with pytest.raises(TactileError, match="touch: is of xela_uskin_4x4"):
            writer.append(replace(one, id=""))
        writer.append(replace(one, id="", touch=None, tare=None, series=None))
    with pytest.raises(DatasetError, match=r"series: 96 values, not 50"):
        encode_sample(replace(one, touch=None, tare=None), IDENTITY)
    assert one.readings is one.series


def one_finger(at_ns: int, level: int) -> tuple[str, Any]:
    return "xela_server_ros2/msg/SensStream", sens_stream(xela_counts(level)[:1], (1,), at_ns * 1e-9)
