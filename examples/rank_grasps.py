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
from foretouch_msgs.msg import Grasp, Status, TablePlane
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


def candidates(xyz: np.ndarray, name: str, rng: np.random.Generator) -> list[Grasp]:
    """Pairs of contacts left and right of the object [m]; the service computes the orientation as GeoGrasp does.

    Their ids begin with a name, since reports of executed grasps refer to them: no two grasps may have the same.
    """
    grasps = []
    for number, y in enumerate(rng.choice(xyz[:, 1], CANDIDATES)):
        band = xyz[np.abs(xyz[:, 1] - y) < BAND_M].astype(float)
        grasp = Grasp(id=f"{name}/{number}")
        grasp.pose.orientation.w = 0.0  # four zeros request its computation
        for contact, point in ((grasp.g1, band[band[:, 0].argmin()]), (grasp.g2, band[band[:, 0].argmax()])):
            contact.x, contact.y, contact.z = point
        grasps.append(grasp)
    return grasps


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
    grasps = candidates(xyz, name, np.random.default_rng())
    request = PredictTouch.Request(cloud=cloud, table=[table.plane], grasps=grasps)
    response = client.call_async(request)
    rclpy.spin_until_future_complete(node, response, timeout_sec=TIMEOUT_S)
    if not response.done():
        raise SystemExit(f"predict_touch: no response within {TIMEOUT_S} s")
    predicted = [p for p in response.result().touch.predictions if p.status == Status.OK]
    if not predicted:
        raise SystemExit(f"no prediction: {response.result().touch.reason}")
    best = min(predicted, key=lambda p: reading(p)["PDC"][0] + reading(p)["PDC"][1])
    number = best.grasp.id.rpartition("/")[2]
    print(f"{len(predicted)} of {CANDIDATES} grasps predicted; the gentlest is {number}:")
    print(
        f"PDC thumb {reading(best)['PDC'][0]:.0f}, middle finger {reading(best)['PDC'][1]:.0f} counts, flags {list(best.flags)}"
    )
    for name, point in (("g1", best.grasp.g1), ("g2", best.grasp.g2)):
        print(f"{name} = ({point.x:.3f}, {point.y:.3f}, {point.z:.3f}) m in {best.header.frame_id}")
    print(f"report its execution as grasp {best.grasp.id}")  # as examples/report_grasp.py does
    rclpy.shutdown()


if __name__ == "__main__":
    main()
