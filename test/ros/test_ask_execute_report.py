# SPDX-License-Identifier: Apache-2.0
"""Rank, execute, report, adapted: through the running graph, for each way of asking that docs/planners.md describes."""

import itertools
import re
import select
import time
from pathlib import Path

import numpy as np
import pytest
from calibrated_models import make_tracked_calibration, save_calibrated_network
from geometry_msgs.msg import Quaternion
from pair_builders import REST, level
from robot_builders import FRAME, MS, QUICK, Robot
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from foretouch import reading
from foretouch.cloud.messages import decode_cloud
from foretouch.grasp.messages import decode_grasp
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.types import stamp_ns
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TablePlane, TouchPrediction, TouchPredictionArray
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

HEARD = {"object_cloud": PointCloud2, "table": TablePlane, "grasps": GraspArray, "touch": TouchPredictionArray}


class Planner(Robot):
    """A camera, a hand and a planner beside the whole graph, of which the planner knows what it receives."""

    def __init__(self, graph, scene_cloud, **parameters):
        (self.node,) = graph.add("perception", **parameters)
        self.graph, self.scene_cloud, self.numbers = graph, scene_cloud, itertools.count()
        self.points = graph.talk(PointCloud2, "points")
        self.heard = {topic: graph.listen(kind, topic) for topic, kind in HEARD.items()}
        super().__init__(graph)
        graph.matched("points", *HEARD)
        self.feel(REST, 5)  # from then on clouds are kept
        graph.until(lambda: self.node.reported().values["tactile.received"] == "5")

    def see(self, _name):
        """The grasp is executed on the cloud that was seen when it was asked for."""

    def look(self):
        """A cloud of now, which all nodes answer; the answer on the topic."""
        self.now = max(self.now, time.time_ns() - 700 * MS) + MS
        self.points.publish(cloud_to_msg(self.scene_cloud(stamp_ns=self.now, n_objects=1)))
        for heard in self.heard.values():
            self.graph.until(lambda heard=heard: heard and stamp_ns(heard[-1].header.stamp) == self.now)
        return self.heard["touch"][-1].predictions[0]

    def candidates(self):
        """Contacts left and right of the object, as in examples/rank_grasps.py, and one far from it."""
        xyz = decode_cloud(self.heard["object_cloud"][-1]).xyz.reshape(-1, 3).astype(float)
        made = []
        for y in (*self._rng.choice(xyz[:, 1], 3), None):
            band = xyz[np.abs(xyz[:, 1] - y) < 0.005] if y is not None else np.array([[5.0, 5.0, 5.0], [5.1, 5.0, 5.0]])
            grasp = Grasp(id=f"mine {next(self.numbers)}")
            grasp.pose.orientation = Quaternion(w=0.0)
            for contact, point in ((grasp.g1, band[band[:, 0].argmin()]), (grasp.g2, band[band[:, 0].argmax()])):
                contact.x, contact.y, contact.z = point
            made.append(grasp)
        return made

    def service(self, cloud, *table):
        request = PredictTouch.Request(cloud=cloud, table=table, grasps=self.candidates())
        *answered, far = self.graph.call(PredictTouch, "predict_touch", request).touch.predictions
        assert [one.status for one in (*answered, far)] == [Status.OK] * 3 + [Status.BAD_GRASP]
        best = min(answered, key=lambda one: reading(one)["PDC"].value[0]).grasp
        decoded = decode_grasp(best)  # has the pose that was computed
        along = (decoded.g1 - decoded.g2) / np.linalg.norm(decoded.g1 - decoded.g2)
        np.testing.assert_allclose(decoded.rotation[:, 2], along, atol=1e-9)
        return best.id

    def service_with_the_received_cloud(self):
        return self.service(self.heard["object_cloud"][-1], self.heard["table"][-1].plane)

    def service_with_a_header(self):
        return self.service(PointCloud2(header=Header(frame_id=FRAME)))

    def service_with_arrays(self):
        grasps = self.candidates()[:3]
        contacts = [value for grasp in grasps for p in (grasp.g1, grasp.g2) for value in (p.x, p.y, p.z)]
        name, table = f"mine {next(self.numbers)}", [self.heard["table"][-1].plane]
        cloud = self.heard["object_cloud"][-1]
        request = PredictTouch.Request(cloud=cloud, table=table, contacts=contacts, id=name)
        batch = self.graph.call(PredictTouch, "predict_touch", request).batch
        assert list(batch.statuses) == [Status.OK] * 3
        return f"{name}/{reading(batch)['PDC'].value[:, 0].argmin()}"

    def action(self, **fields):
        _, result, _ = self.graph.goal(SampleGrasps, "sample_grasps", SampleGrasps.Goal(count=3, **fields))
        planned = {grasp.id for array in self.heard["grasps"] for grasp in array.grasps}
        assert not planned & {grasp.id for grasp in result.grasps}
        return result.grasps[0].id

    def action_with_the_received_cloud(self):
        return self.action(cloud=self.heard["object_cloud"][-1], table=[self.heard["table"][-1].plane])

    def topic(self):
        """The graph's own grasp, on a cloud that was sent back too."""
        self.service_with_the_received_cloud()
        self.action()
        return self.heard["touch"][-1].predictions[0].grasp.id

    def counts(self):
        notes = self.node.reported().values
        return {key: int(count) for key, count in notes.items() if key.startswith("touches.") and count.isdigit()}


WAYS = (
    Planner.service_with_the_received_cloud,
    Planner.service_with_a_header,
    Planner.service_with_arrays,
    Planner.action,
    Planner.action_with_the_received_cloud,
    Planner.topic,
)


@pytest.mark.parametrize("rounds", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_every_executed_grasp_of_every_way_of_asking_is_adapted_to(graph, scene_cloud, tmp_path, rounds):
    card = save_calibrated_network(tmp_path, make_tracked_calibration())
    kept = {"hand_name": "right", "history_folder": str(tmp_path)}
    planner = Planner(graph, scene_cloud, model=card, forget_after_s=1e6, use_tare=False, **kept, **QUICK)
    assert planner.look().reference == TouchPrediction.NONE
    for number, way in enumerate(WAYS * rounds, 1):
        planner.look()
        planner.grasp(way(planner), number % 3)
        graph.until(lambda number=number: sum(planner.counts().values()) == number)
        graph.until(
            lambda: planner.look().reference == TouchPrediction.TOUCHES and not planner.counts()["touches.waiting"]
        )
        assert planner.counts() == {"touches.waiting": 0, "touches.taken_in": number}, way.__name__
        assert planner.look().touches == number
    graph.set(planner.node, use_touches=False)
    assert planner.look().reference == TouchPrediction.NONE
    graph.set(planner.node, use_touches=True)
    assert graph.change("perception", "deactivate", "cleanup", "configure", "activate")  # as after a restart
    graph.matched("object_cloud", "grasps", "touch")
    found = planner.look()
    assert (found.reference, found.touches, found.readings) == (TouchPrediction.TOUCHES, number, number)
    for service, text, reference in (
        ("forget_touches", f"{number} touches forgotten", TouchPrediction.HISTORY),
        ("forget_history", f"{number} readings forgotten", TouchPrediction.NONE),
    ):
        answer = graph.call(Trigger, service)
        assert (answer.success, answer.message) == (True, text)
        assert planner.look().reference == reference


@pytest.mark.slow
@pytest.mark.parametrize("read", [True, False])
def test_the_example_reports_a_grasp_and_says_whether_it_is_adapted_to(lone_graph, scene_cloud, tmp_path, read):
    graph, card = lone_graph, save_calibrated_network(tmp_path, make_tracked_calibration())
    planner = Planner(graph, scene_cloud, model=card, **QUICK | {"pairing__wait_s": 10.0})
    planner.look()
    planner.grasp(planner.topic(), 1)  # an earlier touch of the object, which says nothing about the report
    graph.until(lambda: planner.look().touches == 1)
    path = Path(__file__).parents[2] / "examples" / "report_grasp.py"
    process = graph.start(f"import runpy; runpy.run_path({str(path)!r}, run_name='__main__')")

    def feel(counts, seconds):
        end = time.time() + seconds
        while time.time() < end:
            planner.now = time.time_ns()
            planner.feel(counts, 1)
            time.sleep(0.009)

    graph.matched("touch", subscribers=2)
    while not select.select([process.stdout], [], [], 0.2)[0]:
        planner.look()
    assert process.stdout.readline().startswith("grasp at (")
    feel(REST, 1.0)
    for counts, seconds in ((REST, 0.2), (level(1) if read else None, 0.5), (REST, 0.5)):
        process.stdin.write("\n")
        process.stdin.flush()
        time.sleep(seconds) if counts is None else feel(counts, seconds)
    while process.poll() is None:
        feel(REST, 0.1)
        planner.look()
    printed, logged = process.communicate()
    if not read:
        assert process.returncode == 1
        assert f"refused: grasp {re.search('reported grasp (.*)', printed)[1]}: " in logged
    else:
        assert process.returncode == 0, logged
        assert "the predictions are adapted to 2 touches of this object" in printed
