# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from foretouch.dataset.messages import decode_cloud
from foretouch.errors import CloudError
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.clouds import cloud_to_msg, objects_from_msg, objects_to_msg
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud, Plane

PLANE = Plane.from_coefficients([0, 0, -1, 1.2])


def wire(message):
    return deserialize_message(serialize_message(message), PointCloud2)


def image(rng, *, rgb):
    xyz = rng.normal(size=(6, 8, 3)).astype(np.float32)
    xyz[2, 3] = np.nan
    colours = rng.integers(0, 256, (6, 8, 3), np.uint8) if rgb else None
    return Cloud(xyz, colours, "cam", 12_345_678_901)


def targets_of(cloud, *members):
    flat = cloud.xyz.reshape(-1, 3)
    finite = np.isfinite(flat).all(axis=1)
    shape = cloud.xyz.shape[:2]
    result = []
    for number, wanted in members:
        pixels = np.array([p for p in wanted if finite[p]])
        result.append(FoundObject(str(number), cloud.take(pixels), PLANE, pixels, shape))
    return tuple(result)


@pytest.mark.parametrize("rgb", [False, True])
def test_a_cloud_survives_the_wire(rng, rgb):
    cloud = image(rng, rgb=rgb)
    message = cloud_to_msg(cloud)
    assert message.point_step == (16 if rgb else 12)
    back = decode_cloud(wire(message))
    np.testing.assert_array_equal(back.xyz, cloud.xyz)
    assert (back.rgb is None) == (not rgb)
    if rgb:
        np.testing.assert_array_equal(back.rgb, cloud.rgb)
    assert (back.frame_id, back.stamp_ns) == ("cam", 12_345_678_901)


def test_reading_a_cloud_copies_nothing(rng):
    message = wire(cloud_to_msg(image(rng, rgb=True)))
    cloud = decode_cloud(message)
    memory = np.frombuffer(message.data, np.uint8)
    assert np.shares_memory(cloud.xyz, memory)
    assert np.shares_memory(cloud.rgb, memory)


@pytest.mark.parametrize("rgb", [False, True])
def test_objects_survive_in_order_with_their_pixels(rng, rgb):
    cloud = image(rng, rgb=rgb)
    targets = targets_of(cloud, (7, [4, 5, 12, 13]), (2, [30, 31, 47]))
    back = objects_from_msg(wire(objects_to_msg(targets, "cam", 99)), PLANE)
    assert [one.id for one in back] == ["7", "2"]
    for one, old in zip(back, targets, strict=True):
        np.testing.assert_array_equal(one.cloud.xyz, old.cloud.xyz)
        np.testing.assert_array_equal(np.divmod(one.pixels, one.image_shape[1]), np.divmod(old.pixels, 8))
        if rgb:
            np.testing.assert_array_equal(one.cloud.rgb, old.cloud.rgb)
        assert one.cloud.stamp_ns == 99


def test_no_object_is_a_cloud_without_points():
    message = wire(objects_to_msg((), "cam", 99))
    assert (message.header.frame_id, stamp_ns(message.header.stamp), message.width) == ("cam", 99, 0)
    assert objects_from_msg(message, PLANE) == ()


def test_a_cloud_of_others_is_one_nameless_object_of_finite_points(rng):
    cloud = image(rng, rgb=False)
    (only,) = objects_from_msg(cloud_to_msg(cloud), PLANE)
    assert only.id == ""
    assert only.pixels is None
    assert only.cloud.size == 47


def test_a_label_of_another_type_is_refused(rng):
    message = cloud_to_msg(Cloud(rng.normal(size=(5, 3)).astype(np.float32)))
    message.fields = [*message.fields[:2], PointField(name="z", offset=8, datatype=7, count=1)]
    message.point_step, message.row_step = 16, 80
    message.fields = [*message.fields, PointField(name="label", offset=12, datatype=PointField.FLOAT32, count=1)]
    message.data = b"\0" * 80
    with pytest.raises(CloudError, match="label: is not one UINT32"):
        objects_from_msg(message, PLANE)


def test_sizes_that_do_not_add_up_are_refused(rng):
    message = cloud_to_msg(image(rng, rgb=False))
    message.width += 1
    with pytest.raises(CloudError, match="row_step"):
        decode_cloud(message)
