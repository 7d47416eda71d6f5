# SPDX-License-Identifier: Apache-2.0
"""A grasp planner: generate 50 candidates, predict the contact of each, and select the gentlest.

Run it with the graph and a camera or a replay: python examples/rank_grasps.py
"""

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import PointCloud2

from foretouch import reading
from foretouch_msgs.msg import Status, TablePlane
from foretouch_msgs.srv import PredictTouch

CANDIDATES = 50
BAND_M = 0.005  # both contacts at the same height in the image
TIMEOUT_S = 20.0


def receive(node: Node, topic: str, message_type: type) -> object:
    """The next message of a topic."""
    received, message = wait_for_message(
        message_type, node, topic, qos_profile=qos_profile_sensor_data, time_to_wait=TIMEOUT_S
    )
    if not received:
        raise SystemExit(f"{topic}: no message within {TIMEOUT_S} s; is the graph running?")
    return message


def candidates(xyz: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(K, 6) pairs of contacts left and right of the object [m]; the service computes the orientations as GeoGrasp does."""
    pairs = []
    for y in rng.choice(xyz[:, 1], CANDIDATES):
        band = xyz[np.abs(xyz[:, 1] - y) < BAND_M].astype(float)
        pairs.append([*band[band[:, 0].argmin()], *band[band[:, 0].argmax()]])
    return np.array(pairs)


def main() -> None:
    """Receive the table and the object, request predictions, and print the best grasp."""
    rclpy.init()
    node = Node("rank_grasps", namespace="/foretouch")
    table, cloud = receive(node, "table", TablePlane), receive(node, "object_cloud", PointCloud2)
    layout = np.dtype(
        {"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": cloud.point_step}
    )
    points = np.frombuffer(cloud.data, layout)
    xyz = np.stack([points["x"], points["y"], points["z"]], axis=1)
    if not len(xyz):
        raise SystemExit(f"no object: {table.reason}")
    client = node.create_client(PredictTouch, "predict_touch")
    client.wait_for_service(TIMEOUT_S)
    name = f"rank_grasps/{node.get_clock().now().nanoseconds}"
    contacts = candidates(xyz, np.random.default_rng())
    # Reports of executed grasps refer to their ids, `name/0` and so on: no two grasps may have the same.
    request = PredictTouch.Request(cloud=cloud, table=[table.plane], contacts=contacts.ravel(), id=name)
    response = client.call_async(request)
    rclpy.spin_until_future_complete(node, response, timeout_sec=TIMEOUT_S)
    if not response.done():
        raise SystemExit(f"predict_touch: no response within {TIMEOUT_S} s")
    batch = response.result().batch
    if batch.status != Status.OK:
        raise SystemExit(f"no prediction: {batch.reason}")
    pdc = reading(batch)["PDC"].value  # (K, fingers), NaN without a prediction
    best = int(np.nanargmin(pdc.sum(axis=1)))
    print(f"{np.isfinite(pdc).all(axis=1).sum()} of {CANDIDATES} grasps predicted; the gentlest is {best}:")
    flagged = dict(zip(batch.flags, np.reshape(batch.flagged, (CANDIDATES, -1)).T.astype(bool), strict=True))
    flags = [flag for flag, has in flagged.items() if has[best]]
    print(f"PDC thumb {pdc[best, 0]:.0f}, middle finger {pdc[best, 1]:.0f} counts, flags {flags}")
    if "equal_pressure" in flags:
        others = flagged["equal_pressure"].sum() - 1
        print(f"{others} others are as gentle within its interval: select among them by another rule")
    for name_of, point in (("g1", contacts[best, :3]), ("g2", contacts[best, 3:])):
        print(f"{name_of} = ({', '.join(f'{value:.3f}' for value in point)}) m in {batch.header.frame_id}")
    print(f"report its execution as grasp {name}/{best}")  # as examples/report_grasp.py does
    rclpy.shutdown()


if __name__ == "__main__":
    main()
