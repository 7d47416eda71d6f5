# SPDX-License-Identifier: Apache-2.0
"""The touch predictor beside a hand, over real DDS: readings move its predictions as they move those of the core."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from calibrated_models import REST as TOUCH_REST
from calibrated_models import make_tracked_calibration, save_calibrated_network
from pair_builders import REST, level
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from robot_builders import FRAME, MS, QUICK, Robot
from std_msgs.msg import String
from std_srvs.srv import Trigger

from foretouch.dataset.messages import decode_grasp
from foretouch.dataset.pairing import Interval, PairingConfig, TouchBuffer, TouchReading, cut_touch
from foretouch.models import load_model
from foretouch.models.hand_history import HandHistory
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, stamp_to_msg
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.history_keeper import HistoryKeeper
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.tactile.messages import TactileConfig, make_reader
from foretouch.tactile.messages.biotac_all import finger_counts
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Touch
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray, Status, TouchPredictionArray
from foretouch_msgs.msg import TouchPrediction as TouchPredictionMsg
from foretouch_msgs.srv import PredictTouch

pytestmark = pytest.mark.ros

NAMES = {getattr(TouchPredictionMsg, name.upper()): name for name in ("none", "tare", "touches", "history")}


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> str:
    return save_calibrated_network(tmp_path_factory.mktemp("model"))


class Hand(Robot):
    """A robot whose camera sees one can that lies still, and who keeps what its hand has sent."""

    def __init__(self, graph: Any, node: Any) -> None:
        self.graph, self.node = graph, node
        self.heard = graph.listen(TouchPredictionArray, "touch")
        self.felt = graph.listen(BiotacAll, "/rh/tactile")
        self.shift = np.zeros(3, np.float32)
        super().__init__(graph)
        graph.matched("touch")
        rng = np.random.default_rng(5)
        angle, along = rng.uniform(0, np.pi, 600), rng.uniform(-0.05, 0.05, 600)
        can = np.column_stack([0.033 * np.cos(angle), along, 0.8 - 0.033 * np.sin(angle)])
        self.can = can.astype(np.float32)

    def wake(self) -> None:
        """The first readings: from then on clouds are kept."""
        self.feel(REST, 5)
        self.graph.until(lambda: self.notes()["tactile.received"] == "5")

    def see(self, name: str) -> None:
        self.cloud = Cloud(self.can + self.shift, None, FRAME, self.now)
        self.clouds.publish(objects_to_msg([FoundObject("7", self.cloud, ASSUMED_TABLE)], FRAME, self.now))
        self.planned = [
            Grasp(np.array([0.033, y, 0.8]), np.array([-0.033, y, 0.8]), np.eye(3), 1.0 - k, f"{name}/{k}", "7")
            for k, y in enumerate((0.0, 0.02))
        ]
        messages = [grasp_to_msg(grasp) for grasp in self.planned]
        self.grasps.publish(GraspArray(header=header_to_msg(FRAME, self.now), grasps=messages))

    def ask(self) -> TouchPredictionArray:
        """The answer to a cloud of now."""
        self.now = max(self.now + MS, time.time_ns())
        count = len(self.heard)
        self.see(f"ask {self.now}")
        self.graph.until(lambda: len(self.heard) > count)
        self.now += MS
        return self.heard[-1]

    def touch(self, name: str, number: int, **faults: Any) -> dict[str, Any]:
        """Execute the first grasp of a cloud; all its messages have arrived when this returns."""
        times = self.grasp(name, number, **faults)
        received = self.sent["/rh/tactile"]
        self.graph.until(lambda: int(self.notes()["tactile.received"]) == len(self.felt) == received)
        return times

    def grasp(self, name: str, number: int, *, tell: bool = True) -> dict[str, Any]:
        times = super().grasp(name, number, tell=False)
        if tell:
            known = self.told_of()
            done = ExecutedGrasp(header=header_to_msg(FRAME, self.now), grasp_id=f"{name}/0", success=True, **times)
            self.told.publish(done)
            self.graph.until(lambda: self.told_of() > known)
        return times

    def notes(self) -> dict[str, str]:
        return self.node.notes()

    def outcomes(self) -> dict[str, int]:
        found = {key: value for key, value in self.notes().items() if key.startswith("touches.")}
        counts = {key.removeprefix("touches."): int(value) for key, value in found.items() if value.isdecimal()}
        return {key: count for key, count in counts.items() if key != "waiting"}

    def told_of(self) -> int:
        """Executed grasps that the node knows of."""
        return sum(self.outcomes().values()) + int(self.notes()["touches.waiting"])

    def cut(self, times: dict[str, Any]) -> Any:
        """What the recorder would cut out of the messages of this hand."""
        buffer = TouchBuffer()
        for message in self.felt:
            thumb, middle = (finger_counts(message, name) for name in ("TH", "MF"))
            counts = np.concatenate([thumb[:1], middle[:1], thumb[1:], middle[1:]])
            stamp = stamp_ns(message.header.stamp)
            buffer.add(TouchReading(stamp, counts, np.empty(0, np.float32), stamp))
        config = PairingConfig(guard_s=QUICK["pairing__guard_s"], tare_s=QUICK["pairing__tare_s"])
        return cut_touch(buffer, Interval(**{name: stamp_ns(stamp) for name, stamp in times.items()}), config)


def start(graph: Any, card: str, **parameters: Any) -> Hand:
    (node,) = graph.add("touch_predictor", model=card, **{**QUICK, **parameters})
    assert node.state_name == "active"
    return Hand(graph, node)


def start_awake(graph: Any, card: str, **parameters: Any) -> Hand:
    hand = start(graph, card, **parameters)
    hand.wake()
    return hand


def assert_answer(
    answer: TouchPredictionArray, hand: Hand, read: HandHistory | None = None, *, tare: bool = False
) -> None:
    """All 150 numbers are those of the core after the same readings, up to the drift within some seconds."""
    history = None if read is None else read.snapshot(time.time_ns(), same_object=True, tare=tare)
    model = load_model(hand.node.config.model) if read is None else read.model
    wanted = model.predict(hand.cloud, hand.planned, history=history)
    for message, one in zip(answer.predictions, wanted, strict=True):
        rows = [message.pdc_th, message.pdc_mf, *message.e_th, *message.e_mf]
        for field in ("value", "lower", "upper"):
            found = np.array([getattr(row, field) for row in rows], np.float32)
            exact = getattr(one, field).vector().astype(np.float32)
            np.testing.assert_allclose(found, exact, rtol=0.0, atol=0.0 if read is None else 0.02)
        assert NAMES[message.reference] == one.reference


def test_predictions_shift_as_those_of_the_core_and_forgetting_undoes_it(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    assert_answer(hand.ask(), hand)
    history = HandHistory(load_model(card))
    for number in range(3):
        times = hand.touch(f"g-{number}", number)
        history.add_touch(time.time_ns(), hand.cloud, hand.planned[0], hand.cut(times).touch)
        assert_answer(hand.ask(), hand, history)
    assert (hand.notes()["touches"], hand.outcomes()) == ("3", {"taken_in": 3})
    assert hand.notes()["regime"].startswith("touches (")

    answer = graph.call(Trigger, "forget_touches", Trigger.Request())
    assert (answer.success, answer.message) == (True, "3 touches forgotten")
    assert NAMES[hand.ask().predictions[0].reference] == "history"
    assert hand.notes()["touches"] == "0"
    graph.call(Trigger, "forget_history", Trigger.Request())
    assert_answer(hand.ask(), hand)


def test_a_touch_brings_the_tare_before_it(graph: Any, card: str) -> None:
    hand = start_awake(graph, card)
    cut = hand.cut(hand.touch("g", 0))
    history = HandHistory(load_model(card))
    history.add_tare(time.time_ns(), cut.tare)
    history.add_touch(time.time_ns(), hand.cloud, hand.planned[0], cut.touch)
    assert_answer(hand.ask(), hand, history)


def test_a_hand_at_rest_gives_a_tare_and_one_in_contact_none(graph: Any, card: str) -> None:
    hand = start(graph, card, tare_max_age_s=3.0)
    assert hand.ask().predictions[0].reference == TouchPredictionMsg.NONE
    hand.now = time.time_ns() - 3000 * MS
    hand.feel(REST, 250)
    graph.until(lambda: int(hand.notes()["tactile.received"]) == 250)
    rest = hand.ask().predictions[0]
    assert rest.reference == TouchPredictionMsg.TARE
    counts = np.array([m.tactiles[4].pdc for m in hand.felt], float)
    window = [k for k in range(250) if 250 - 1 - 9 - 30 - 50 <= k <= 250 - 1 - 30]
    tare = hand.node._adapter._recent_tare(hand.node.config)
    assert tare.pdc_th == pytest.approx(np.median(counts[window]), abs=0.6)
    history = HandHistory(load_model(card))
    history.add_tare(time.time_ns(), tare)
    assert_answer(hand.ask(), hand, history, tare=True)
    hand.feel(level(3), 60)
    graph.until(lambda: int(hand.notes()["tactile.received"]) == 310)
    held = hand.ask().predictions[0]
    assert held.pdc_th.value == pytest.approx(rest.pdc_th.value, abs=1.0)  # that from before the contact
    graph.until(lambda: float(hand.notes()["tare_age_s"]) > 3.0)
    assert hand.ask().predictions[0].reference == TouchPredictionMsg.HISTORY


def test_a_dead_sensor_is_refused_counted_and_named(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    hand.touch("good", 0)
    before = hand.ask()
    honest, hand.feel = hand.feel, lambda counts, readings: honest(np.r_[-22072.0, counts[1:]], readings)
    hand.touch("dead", 1)
    after = [p.pdc_th.value for p in hand.ask().predictions]
    assert after == pytest.approx([p.pdc_th.value for p in before.predictions], abs=0.01)  # but for the drift meanwhile
    assert (hand.notes()["touches"], hand.outcomes()) == ("1", {"taken_in": 1, "refused.sensor_fault": 1})
    assert "grasp dead/0: contact: pdc_th: -22072 is not between 0 and 4095" in hand.notes()["touches.last_refusal"]


def test_a_dead_sensor_at_rest_makes_no_tare(graph: Any, card: str) -> None:
    hand = start(graph, card)
    hand.now = time.time_ns()
    hand.feel(np.r_[REST[:2], np.zeros(24), REST[26:]], 250)
    graph.until(lambda: int(hand.notes()["tactile.received"]) == 250)
    assert hand.ask().predictions[0].reference == TouchPredictionMsg.NONE
    assert "e_th" in hand.notes()["tare.fault"]


def test_what_cannot_be_paired_is_counted_and_changes_nothing(graph: Any, card: str) -> None:
    hand = start(graph, card, use_tare=False, pairing__wait_s=0.2)
    before = hand.ask()
    hand.wake()
    times = hand.grasp("told too early", 0)  # nothing of it was lost, so it counts
    hand.feel = lambda counts, readings: setattr(hand, "now", hand.now + 10 * MS * readings)
    hand.grasp("unfelt", 1)
    failed = ExecutedGrasp(header=header_to_msg(FRAME, hand.now), grasp_id="unfelt/1", success=False, **times)
    hand.told.publish(failed)
    stranger = ExecutedGrasp(header=header_to_msg(FRAME, hand.now), grasp_id="who?", success=True, **times)
    hand.told.publish(stranger)
    wanted = {"taken_in": 1, "refused.no_tactile": 1, "refused.grasp_failed": 1, "refused.grasp_unknown": 1}

    def settled() -> bool:
        time.sleep(0.1)
        hand.ask()
        return hand.outcomes() == wanted

    graph.until(settled)
    assert len(before.predictions) == len(hand.ask().predictions)
    assert hand.notes()["touches"] == "1"


def test_another_object_is_told_by_its_place_and_an_old_touch_by_its_age(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    hand.touch("g", 0)
    references = []
    for shift in (0.0, 0.015, 0.05):
        hand.shift = np.array([shift, 0.0, 0.0], np.float32)
        references.append(NAMES[hand.ask().predictions[0].reference])
    assert references == ["touches", "touches", "history"]
    hand.touch("elsewhere", 1)  # memory begins with the object that was touched last
    assert NAMES[hand.ask().predictions[0].reference] == "touches"
    assert hand.notes()["touches"] == "1"
    change = SetParameters.Request(parameters=[Parameter("forget_after_s", value=0.0).to_parameter_msg()])
    assert graph.call(SetParameters, "touch_predictor/set_parameters", change).results[0].successful
    assert NAMES[hand.ask().predictions[0].reference] == "history"
    assert hand.notes()["touches"] == "0"


def test_the_service_leans_on_touches_too(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    times = hand.touch("g", 0)
    graph.until(lambda: hand.heard)  # else the service may come before the cloud
    history = HandHistory(load_model(card))
    history.add_touch(time.time_ns(), hand.cloud, hand.planned[0], hand.cut(times).touch)
    request = PredictTouch.Request(
        cloud=objects_to_msg([FoundObject("7", hand.cloud, ASSUMED_TABLE)], FRAME, hand.now),
        grasps=[grasp_to_msg(grasp) for grasp in hand.planned],
    )
    answer = graph.call(PredictTouch, "predict_touch", request).touch
    assert_answer(answer, hand, history)
    assert decode_grasp(answer.predictions[0].grasp).id == "g/0"


def test_a_grasp_that_a_planner_asked_about_teaches_as_a_planned_one(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    hand.ask()
    mine = Grasp(np.array([0.033, 0.01, 0.8]), np.array([-0.033, 0.01, 0.8]), np.eye(3), id="mine/0", object_id="7")
    request = PredictTouch.Request(
        cloud=objects_to_msg([FoundObject("7", hand.cloud, ASSUMED_TABLE)], FRAME, hand.cloud.stamp_ns),
        grasps=[grasp_to_msg(mine)],
    )
    assert graph.call(PredictTouch, "predict_touch", request).touch.status == Status.OK
    asked, hand.see = hand.cloud, lambda _: None  # the planner has its own plan
    cut = hand.cut(hand.touch("mine", 2))
    del hand.see
    history = HandHistory(load_model(card))
    history.add_touch(time.time_ns(), asked, mine, cut.touch)
    assert_answer(hand.ask(), hand, history)


def test_a_change_of_use_tare_forgets_and_use_touches_ignores(graph: Any, card: str) -> None:
    hand = start_awake(graph, card, use_tare=False)
    hand.touch("g", 0)

    def turn(name: str, *, on: bool) -> str:
        change = SetParameters.Request(parameters=[Parameter(name, value=on).to_parameter_msg()])
        assert graph.call(SetParameters, "touch_predictor/set_parameters", change).results[0].successful
        return NAMES[hand.ask().predictions[0].reference]

    assert turn("use_touches", on=False) == "none"
    assert turn("use_touches", on=True) == "touches"
    assert turn("use_tare", on=True) != "touches"


def test_a_hand_that_sends_no_readings_harms_nobody(graph: Any, card: str, scene_cloud: Any) -> None:
    (node,) = graph.add("touch_predictor", model=card, tactile__type="std_msgs/String")
    lines = graph.talk(String, "/rh/tactile")
    graph.matched("/rh/tactile")
    lines.publish(String(data="not,a,reading"))
    graph.until(lambda: node.notes()["tactile.unreadable"] == "1")
    assert "CSV: 3 fields" in node.notes()["tactile.last_unreadable"]
    target = Pipeline().segment(scene_cloud()).targets[0]
    grasps = [grasp_to_msg(grasp) for grasp in Pipeline().plan(target).grasps]
    request = PredictTouch.Request(cloud=objects_to_msg([target], FRAME, 5), grasps=grasps)
    answer = graph.call(PredictTouch, "predict_touch", request).touch
    assert (answer.status, answer.predictions[0].reference) == (Status.OK, TouchPredictionMsg.NONE)


def test_a_model_without_calibration_neither_listens_nor_minds(graph: Any, model_card: str) -> None:
    (node,) = graph.add("touch_predictor", model=model_card)
    assert graph.probe.count_subscribers("/rh/tactile") == 0
    assert "no calibration" in node.notes()["regime"]
    assert graph.call(Trigger, "forget_touches", Trigger.Request()).message == "0 touches forgotten"


class DirectHand(Robot):
    """Sends its messages straight to an adapter, without DDS and without waiting."""

    def __init__(self, adapter: OnlineAdapter) -> None:
        self.adapter, self.now = adapter, START
        self._rng = np.random.default_rng(0)
        self.sent = {"/rh/tactile": 0}
        self.hand = SimpleNamespace(publish=adapter.add_tactile)
        self.feel(REST, 5)

    def see(self, name: str, shift: float = 0.0, *, requested: bool = False) -> None:
        cloud = Cloud(
            (0.03 * np.random.default_rng(5).normal(size=(300, 3)) + [shift, shift, 1.0 + shift]).astype(np.float32),
            None,
            FRAME,
        )
        found = objects_to_msg([FoundObject("7", cloud, ASSUMED_TABLE)], FRAME, self.now)
        one = Grasp(np.array([0.0, 0.03, 0.5]), np.array([0.0, -0.03, 0.5]), np.eye(3), 1.0, name, "7")
        self.adapter.add_grasps(found, [grasp_to_msg(one)], requested=requested)

    def execute(self, name: str, *, success: bool = True) -> dict[str, Any]:
        self.now += MS
        self.feel(REST, 100)
        times = {"start": stamp_to_msg(self.now)}
        self.feel(REST, 10)
        times["contact"] = stamp_to_msg(self.now)
        self.feel(level(1), 50)
        times["release"] = stamp_to_msg(self.now)
        self.feel(REST, 20)
        self.report(name, times, success=success)
        return times

    def report(self, name: str, times: dict[str, Any], *, success: bool = True) -> None:
        header = header_to_msg(FRAME, self.now)
        self.adapter.add_executed(ExecutedGrasp(header=header, grasp_id=name, success=success, **times))
        self.adapter.process_touches()

    def counts(self) -> dict[str, str]:
        return {k: v for k, v in self.adapter.notes().items() if k.startswith(("touches.refused", "touches.taken"))}


START = 1_700_000_000_000 * MS


@pytest.fixture
def direct(card: str) -> DirectHand:
    hand: list[DirectHand] = []
    settings = TouchPredictorConfig()
    model = load_model(card)
    adapter = OnlineAdapter(
        model,
        make_reader(TactileConfig()),
        HistoryKeeper(model),
        lambda: settings,
        lambda: hand[0].now if hand else START,
        print,
    )
    hand.append(DirectHand(adapter))
    return hand[0]


def test_two_clouds_of_one_stamp_are_refused_as_the_recorder_does_unless_one_was_requested(direct: DirectHand) -> None:
    direct.see("a")
    direct.see("b", shift=1.0, requested=True)
    direct.execute("a")
    assert direct.counts() == {"touches.taken_in": "1"}
    direct.see("c")
    direct.see("d", shift=1.0)
    direct.execute("c")
    assert direct.counts() == {"touches.taken_in": "1", "touches.refused.cloud_ambiguous": "1"}


def test_a_failed_grasp_is_refused_and_its_time_belongs_to_it(direct: DirectHand) -> None:
    direct.see("a")
    direct.see("b", requested=True)
    times = direct.execute("a", success=False)
    direct.report("b", times)
    assert direct.counts() == {"touches.refused.grasp_failed": "1", "touches.refused.overlap": "1"}


def test_a_stamp_in_the_far_future_neither_freezes_the_tare_nor_fills_the_memory(graph: Any, card: str) -> None:
    hand = start_awake(graph, card)
    hand.feel(REST, 120)
    graph.until(lambda: hand.notes()["tare_age_s"] != "none")
    now, hand.now = hand.now, hand.now + 3600 * 1000 * MS
    hand.feel(REST, 1)
    hand.now = now
    time.sleep(1.5)
    hand.feel(REST, 300)
    graph.until(lambda: hand.notes()["tactile.received"] == str(hand.sent["/rh/tactile"]))
    assert float(hand.notes()["tare_age_s"]) < 1.2
    assert len(hand.node._adapter._tare._recent) < 100


# A model whose calibration has a tracker: readings outlive the object, and with a named hand the process.


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> str:
    return save_calibrated_network(tmp_path_factory.mktemp("tracked"), make_tracked_calibration())


def first(answer: TouchPredictionArray) -> TouchPredictionMsg:
    assert answer.status == Status.OK, answer.reason
    return answer.predictions[0]


def test_touches_of_another_object_stay_in_the_history(graph: Any, tracked: str) -> None:
    hand = start_awake(graph, tracked, use_tare=False)
    unread = first(hand.ask())
    assert (unread.reference, unread.touches, unread.readings) == (TouchPredictionMsg.NONE, 0, 0)
    assert unread.reading_age.sec < 0
    for number in range(2):
        hand.touch(f"g-{number}", number)
    touched = first(hand.ask())
    assert (touched.reference, touched.touches, touched.readings) == (TouchPredictionMsg.TOUCHES, 2, 2)
    assert 0 <= touched.touch_age.sec < 60
    hand.shift = np.array([0.05, 0.0, 0.0], np.float32)  # another object
    other = first(hand.ask())
    assert (other.reference, other.touches, other.readings) == (TouchPredictionMsg.HISTORY, 0, 2)
    assert width(other) < width(unread)
    assert hand.notes()["history.readings"] == "2"
    answer = graph.call(Trigger, "forget_history", Trigger.Request())
    assert (answer.success, answer.message) == (True, "2 readings forgotten")
    forgotten = first(hand.ask())
    assert (forgotten.reference, forgotten.readings) == (TouchPredictionMsg.NONE, 0)


def width(message: TouchPredictionMsg) -> float:
    return float(message.pdc_th.upper - message.pdc_th.lower)


def test_a_named_hand_remembers_across_a_restart(graph: Any, tracked: str, tmp_path: Any) -> None:
    named = {"use_tare": False, "hand": "right", "history_folder": str(tmp_path)}
    hand = start_awake(graph, tracked, **named)
    hand.touch("g-0", 0)
    before = first(hand.ask())
    assert before.reference == TouchPredictionMsg.TOUCHES
    node = hand.node
    for transition in (node.trigger_deactivate, node.trigger_cleanup):
        transition()
    assert (tmp_path / "right.safetensors").exists()
    for transition in (node.trigger_configure, node.trigger_activate):
        transition()
    after = first(hand.ask())
    assert (after.reference, after.touches, after.readings) == (TouchPredictionMsg.TOUCHES, 1, 1)
    assert after.pdc_th.value == pytest.approx(before.pdc_th.value, abs=1.0)
    assert hand.notes()["history.file"] == str(tmp_path / "right.safetensors")


def test_a_clock_that_was_set_back_is_reported_once(tracked: str) -> None:
    model, said, settings = load_model(tracked), [], TouchPredictorConfig()
    tare, now = Touch.from_vector(TOUCH_REST), [START]
    keeper = HistoryKeeper(model)
    keeper.history.add_tare(START, tare)
    adapter = OnlineAdapter(model, make_reader(TactileConfig()), keeper, lambda: settings, lambda: now[0], said.append)
    adapter._recent_tare = lambda _: tare
    cloud = Cloud(np.random.default_rng(0).uniform(-0.04, 0.04, (300, 3)).astype(np.float32) + np.float32([0, 0, 0.8]))
    grasp = Grasp(np.array([0.04, 0.0, 0.8]), np.array([-0.04, 0.0, 0.8]), np.eye(3))
    for hours, lines in ((1, 1), (1, 1), (0, 1), (2, 2)):
        now[0] = START - hours * 3_600_000 * MS
        (found,) = adapter.predict(cloud, [grasp], limits=settings.limits, reach=settings)
        assert (found.reference, len(said)) == ("tare", lines)
    assert said[0].startswith("tare: refused: stamp: is 3600.0 s before that of the newest reading")
