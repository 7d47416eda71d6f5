# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from foretouch.camera.stream import DepthFrame
from foretouch.cloud.io.depth_messages import decode_depth
from foretouch.cloud.messages import decode_cloud, decode_objects
from foretouch.errors import CloudError
from foretouch.ros.messages.clouds import cloud_to_msg, depth_to_msgs, objects_to_msg
from foretouch.types import CameraModel, Cloud, Plane, stamp_ns
from foretouch.types.scene import Object

PLANE = Plane.from_coefficients([0, 0, -1, 1.2])


def sent(message):
    return deserialize_message(serialize_message(message), PointCloud2)


def image(rng, *, rgb):
    xyz = rng.normal(size=(6, 8, 3)).astype(np.float32)
    xyz[2, 3] = np.nan
    return Cloud(xyz, rng.integers(0, 256, (6, 8, 3), np.uint8) if rgb else None, "cam", 12_345_678_901)


@pytest.mark.parametrize("rgb", [False, True])
def test_a_cloud_and_objects_with_their_pixels_are_received_as_they_were_and_read_without_a_copy(rng, rgb):
    cloud = image(rng, rgb=rgb)
    message = sent(cloud_to_msg(cloud))
    assert message.point_step == (16 if rgb else 12)
    back, memory = decode_cloud(message), np.frombuffer(message.data, np.uint8)
    np.testing.assert_array_equal(back.xyz, cloud.xyz)
    assert np.shares_memory(back.xyz, memory)
    assert (back.rgb is not None) == rgb
    if rgb:
        np.testing.assert_array_equal(back.rgb, cloud.rgb)
        assert np.shares_memory(back.rgb, memory)
    assert (back.frame_id, back.stamp_ns) == ("cam", 12_345_678_901)
    members = ((7, np.array([4, 5, 12, 13])), (2, np.array([30, 31, 47])))
    targets = [
        Object.of(str(number), cloud.take(pixels), PLANE, pixels=pixels, image_shape=(6, 8))
        for number, pixels in members
    ]
    back = decode_objects(sent(objects_to_msg(targets, "cam", 99)), PLANE)
    assert [one.id for one in back] == ["7", "2"]
    for one, old in zip(back, targets, strict=True):
        np.testing.assert_array_equal(one.cloud.xyz, old.cloud.xyz)
        np.testing.assert_array_equal(np.divmod(one.pixels, one.image_shape[1]), np.divmod(old.pixels, 8))
        if rgb:
            np.testing.assert_array_equal(one.cloud.rgb, old.cloud.rgb)
        assert one.cloud.stamp_ns == 99


def test_a_pixel_without_depth_is_0_in_millimetres_and_nan_in_metres():
    camera = CameraModel.of((2.0, 2.0, 1.0, 0.5), 3, 2)
    depth = np.array([[0, 1000, 2500], [0, 1, 65535]], np.uint16)
    for scale, encoding, expected in (
        (0.001, "16UC1", depth),
        (0.0001, "32FC1", [[np.nan, 0.1, 0.25], [np.nan, 0.0001, 6.5535]]),  # REP 118
    ):
        message, _ = depth_to_msgs(DepthFrame(depth, scale, camera, "cam", 7))
        assert (message.encoding, message.step) == (encoding, 3 * (2 if encoding == "16UC1" else 4))
        np.testing.assert_allclose(decode_depth(message), expected, rtol=1e-6)


def test_no_object_is_a_cloud_without_points_a_cloud_of_others_one_object_and_a_strange_label_refused(rng):
    message = sent(objects_to_msg((), "cam", 99))
    assert (message.header.frame_id, stamp_ns(message.header.stamp), message.width) == ("cam", 99, 0)
    assert decode_objects(message, PLANE) == ()
    (only,) = decode_objects(cloud_to_msg(image(rng, rgb=False)), PLANE)
    assert (only.id, only.image_shape, only.cloud.size) == ("", None, 47)  # its finite points
    message = cloud_to_msg(Cloud(rng.normal(size=(5, 3)).astype(np.float32)))
    label = PointField(name="label", offset=12, datatype=PointField.FLOAT32, count=1)
    message.fields, message.point_step, message.row_step = [*message.fields, label], 16, 80
    message.data = b"\0" * 80
    with pytest.raises(CloudError, match="label: is not one UINT32"):
        decode_objects(message, PLANE)
    message.width += 1
    with pytest.raises(CloudError, match="row_step"):
        decode_cloud(message)
