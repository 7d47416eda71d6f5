# SPDX-License-Identifier: Apache-2.0
"""Readings by description: XELA's messages as rosbags reads them, BioTac as its own decoder does, and every fault."""

from types import SimpleNamespace as Message

import numpy as np
import pytest
from every_case import every_refusal
from numpy.testing import assert_array_equal
from sensor_builders import SMALL, write_sensor, xela_message

from foretouch.errors import ConfigError, FileError, TactileError
from foretouch.tactile.description import load_sensor, sensor_of
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileConfig, TactileReading


def header() -> Message:
    return Message(stamp=Message(sec=1_700_000_000, nanosec=5))


def read(sensor: object, message: object, **fingers: str) -> TactileReading:
    return make_reader(TactileConfig(sensor=str(sensor), **fingers)).read(message)


def by_channel(values: np.ndarray) -> np.ndarray:
    """Values of (fingers, taxels, channels) in the order of a touch."""
    return values.transpose(2, 0, 1).ravel()


def test_sensors_of_others_by_file_alone(rng: np.random.Generator) -> None:
    counts = rng.integers(0, 2**16, (3, 16, 3))
    reading = read("xela_uskin_4x4", xela_message(counts, (2, 3, 1)))
    assert_array_equal(reading.counts, by_channel(counts[[2, 0]]))  # thumb: position 1
    assert (reading.counts.dtype, reading.others.size, reading.invalid) == (np.float32, 0, {})
    assert reading.stamp_ns == 1_700_000_000_250_000_000
    field = rng.standard_normal((500, 3)).astype(np.float32)
    channels = [Message(name=name, values=field.ravel()) for name in ("right", "left")]
    reading = read("tacsl_20x25", Message(header=header(), sensors=channels))
    assert_array_equal(reading.counts, by_channel(np.stack([field, field])))
    names = [*(f"magnetic_induction_{axis}" for axis in "xyz"), "temperature"]
    counts = rng.integers(-2048, 2048, (5, 7, 4))
    counts[..., 3] = 300
    fingers = [Message(sensors=[Message(**dict(zip(names, row, strict=True))) for row in count]) for count in counts]
    reading = read("shadow_mst", Message(header=header(), fingers=fingers))
    assert_array_equal(reading.counts, by_channel(counts[[4, 1], :, :3]))


def test_places_without_a_taxel_are_no_taxels_and_never_count_as_failed(tmp_path) -> None:
    """A matrix of 2 x 3 of which the outline covers four places; the others are NaN, 0 or anything."""
    values = {"values": [{**SMALL["values"][0], "range": [-100, 100]}]}
    path = write_sensor(tmp_path, {**values, "absent": [0, 4]})
    sent = np.array([[np.nan, 1.0, 2.0, 3.0, np.nan, 5.0], [-1e9, 11.0, 12.0, 13.0, 0.0, np.nan]])
    reading = read(path, Message(pads=[Message(pressures=row) for row in sent]))
    assert reading.invalid == {"out_of_range": 1}  # the last place of the right finger holds a taxel
    assert_array_equal(reading.counts[[0, 1, 2, 3, 4, 5, 6]], [1, 2, 3, 5, 11, 12, 13])
    sensor = load_sensor(path)
    assert_array_equal(sensor.layout.positions[:, :2], [[0.0, 0.002], [0.0, 0.004], [0.004, 0.0], [0.004, 0.004]])
    again = sensor_of(sensor.to_mapping(), "card")
    assert (again.sha256, again.places.tolist()) == (sensor.sha256, [1, 2, 3, 5])
    assert sensor.sha256 != load_sensor(write_sensor(tmp_path, values)).sha256
    places = sensor.layout.positions
    lines = "".join(f"{k},{x},{y},0,0,0,1\n" for k, (x, y, _) in zip((1, 2, 3, 5), places, strict=True))
    csv = write_sensor(
        tmp_path, {**values, "absent": [0, 4], "array": None, "taxels": "taxels.csv"}, "index,x,y,z,nx,ny,nz\n" + lines
    )
    assert_array_equal(read(csv, Message(pads=[Message(pressures=row) for row in sent])).counts, reading.counts)
    with pytest.raises(TactileError, match="pressures: 4 numbers, not 6"):
        read(csv, Message(pads=[Message(pressures=row[:4]) for row in sent]))
    for absent, rule in (
        ([6], "must hold a taxel"),
        (range(6), "must hold a taxel"),
        ([1, 1], "are not different places"),
    ):
        with pytest.raises(ConfigError, match=f"absent: .*{rule}"):
            load_sensor(write_sensor(tmp_path, {"absent": list(absent)}))
    with pytest.raises(FileError, match="index: not each of 0 to 5 once, without those absent"):
        load_sensor(
            write_sensor(
                tmp_path, {"absent": [1, 4], "array": None, "taxels": "taxels.csv"}, "index,x,y,z,nx,ny,nz\n" + lines
            )
        )


def test_biotac_by_its_description_as_by_its_own_decoder(rng: np.random.Generator) -> None:
    counts = rng.integers(1, 4095, (5, 29))
    names = ("pdc", "pac0", "pac1", "tac", "tdc")
    message = Message(
        header=header(),
        tactiles=[Message(electrodes=row[5:], **dict(zip(names, row[:5].tolist(), strict=True))) for row in counts],
    )
    own, other = (make_reader(TactileConfig(sensor=sensor)) for sensor in ("", "biotac_sp"))
    one, two = own.read(message), other.read(message)
    assert one.stamp_ns == two.stamp_ns
    assert_array_equal(one.counts, two.counts)
    assert_array_equal(one.others, two.others)
    assert (own.others, own.flags, own.channels.sha256) == (other.others, other.flags, other.channels.sha256)
    unread = message.tactiles[4]
    unread.electrodes, unread.pdc, unread.tac = np.zeros(24, np.int16), -9784, 32518
    message.tactiles[1].electrodes[7] = 0
    message.tactiles[1].tdc = 0  # of a driver without it
    reading = other.read(message)
    assert reading.invalid == {"not_read": 24, "out_of_range": 1}
    assert_array_equal(np.isnan(reading.counts), [1, 0, *[1] * 24, *[0] * 24])
    assert dict(zip(other.others, reading.others, strict=True))["TDC_MF"] == 0.0  # as sent


def test_stamps_of_every_kind(tmp_path) -> None:
    def stamp(value: object, unit: str = "s") -> int | None:
        source = {"type": "a/B", "stamp": "time", "stamp_unit": unit}
        values = [{**SMALL["values"][0], "range": [0, 9]}]
        sensor = write_sensor(tmp_path, {"source": source, "values": values})
        return read(sensor, Message(time=value, pads=[Message(pressures=[0.0] * 6)] * 2)).stamp_ns

    assert stamp(Message(sec=3, nanosec=7)) == 3_000_000_007
    assert stamp(1.5) == 1_500_000_000
    assert stamp(np.int32(1_700_000_000)) == 1_700_000_000 * 10**9
    assert stamp(1_700_000_000_000_000_001, "ns") == 1_700_000_000_000_000_001
    assert stamp(2500, "us") == 2_500_000
    every_refusal(
        TactileError,
        [
            ("time: nan is not a time", float("nan")),
            ("is not a time", 1e300),
            ("is not a time", -1),
            ("is not a time", "noon"),
        ],
        stamp,
    )


def test_messages_that_lack_something_are_refused_by_name() -> None:
    full = np.zeros((2, 16, 3), int)
    cases = (
        ("xela_uskin_4x4: TH: taxels\\[\\].x: 8 numbers, not 16", xela_message(full[:, :8])),  # half the taxels
        ("xela_uskin_4x4: TH: taxels\\[\\].x: 0 numbers", xela_message(full[:, :0])),
        ("xela_uskin_4x4: FF: sensors\\[sensor_pos=2\\]: no element .*; known: 1, 3", xela_message(full, (1, 3))),
        ("TH: sensors.*: SimpleNamespace: field 'sensors' is not one of tactiles", Message(tactiles=[])),
        ("TH: taxels\\[\\].x: holds no numbers",
         Message(sensors=[Message(sensor_pos=1, taxels=[Message(x="a", y=0, z=0)])])),
        ("TH: taxels\\[\\].y: .* field 'y' is not one of x",
         Message(sensors=[Message(sensor_pos=1, taxels=[Message(x=0)] * 16)])),
    )  # fmt: skip
    every_refusal(TactileError, cases, lambda message: read("xela_uskin_4x4", message))


def test_a_reading_for_a_touch_is_ordered_by_channel_and_finger_with_temperatures_beside_it(tmp_path) -> None:
    scalars = [
        {"name": "T", "field": "celsius", "unit": "degC", "contact": "none", "rest": "none"},
        {"name": "P", "field": "air", "unit": "Pa", "noise": 2.0, "contact": "rise"},
    ]
    changes = {"scalars": scalars, "values": [{**SMALL["values"][0], "range": [0, 9]}]}
    reader = make_reader(TactileConfig(sensor=str(write_sensor(tmp_path, changes)), thumb="right", middle="left"))
    assert (reader.others, reader.flags) == (("T_left", "T_right"), ("arrival_stamped",))
    assert reader.temperatures == {"T_left", "T_right"}
    left = Message(pressures=[0, 99, 2, 3, 4, np.nan], celsius=20.5, air=7.0)
    right = Message(pressures=[1, 1, 1, 1, 1, 1], celsius=21.0, air=8.0)
    found = reader.read(Message(pads=[left, right]))
    assert found.counts.dtype == np.float32
    # Taxels 4 mm apart along x, 2 mm along y, three in a row: the nearest valid ones of 1 are 0 and 2, of 5 is 4.
    assert_array_equal(found.counts, [8, 7, 1, 1, 1, 1, 1, 1, 0, 1, 2, 3, 4, 4])
    assert_array_equal(found.others, [21.0, 20.5])
    assert (found.stamp_ns, found.invalid) == (None, {"out_of_range": 2})
    left.pressures[0] = -1
    found = reader.read(Message(pads=[left, right]))  # half of its taxels are not valid
    assert_array_equal(np.isnan(found.counts), [0, 1, *[0] * 6, *[1] * 6])
    left.celsius = np.nan
    with pytest.raises(TactileError, match="small: a scalar is not finite"):
        reader.read(Message(pads=[left, right]))
    own = TactileConfig(sensor=str(write_sensor(tmp_path, {**changes, "grasp": ["right", "left"]})))
    assert (own.fingers, own.message_type) == (("right", "left"), "lab_msgs/Pads")
    every_refusal(
        ConfigError,
        [
            ("sensor: small: p: state its noise or its range", {}),
            ("sensor: small has one finger", {"fingers": SMALL["fingers"][:1]}),
        ],
        lambda faulty: make_reader(TactileConfig(sensor=str(write_sensor(tmp_path, faulty)))),
    )
    with pytest.raises(ConfigError, match="'left' is the thumb already"):
        make_reader(TactileConfig(sensor=str(write_sensor(tmp_path, changes)), thumb="left", middle="left"))
    with pytest.raises(ConfigError, match="fingers: 'MF' is not one of left, right"):
        make_reader(TactileConfig(sensor=str(write_sensor(tmp_path, changes)), middle="MF"))
