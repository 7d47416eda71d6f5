# SPDX-License-Identifier: Apache-2.0
"""Online adaptation: readings move the predictions as they move those of the core, without DDS and over it."""

import io
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from calibrated_models import REST as TOUCH_REST
from calibrated_models import make_calibration, make_tracked_calibration, save_calibrated_network
from constant_models import constant_model
from diagnostic_msgs.msg import DiagnosticStatus
from pair_builders import REST
from rich.console import Console
from robot_builders import FRAME, MS, QUICK, Robot
from sensor_builders import sens_stream
from std_msgs.msg import String
from std_srvs.srv import Trigger

from foretouch.cli.live import live_panel
from foretouch.cloud.messages import decode_objects
from foretouch.dataset.labelling.buffers import TouchBuffer
from foretouch.dataset.labelling.cut import Interval, cut_touch
from foretouch.models import load_model
from foretouch.models.history_keeper import HistoryKeeper
from foretouch.models.touch_model import History
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.requests import Targets
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.ros.steps.online_adapter import OnlineAdapter
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch.tactile.description import packaged_sensor
from foretouch.tactile.messages.biotac import finger_counts
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileReading
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Plane, stamp_ns
from foretouch.types.scene import Object

pytestmark = pytest.mark.ros

PAIRING = {name.removeprefix("pairing__"): value for name, value in QUICK.items()}
ACROSS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # of a hand that closes along x
DEAD = np.r_[-22072.0, REST[1:]]


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    return save_calibrated_network(tmp_path_factory.mktemp("model"), make_tracked_calibration())


class CanRobot(Robot):
    """A robot whose camera sees one can that lies still, and that keeps what its hand has sent."""

    channels = BIOTAC

    def begin(self):
        self.shift, self.felt = 0.0, []
        rng = np.random.default_rng(5)
        angle, along = rng.uniform(0, np.pi, 600), rng.uniform(-0.05, 0.05, 600)
        self.can = np.column_stack([0.033 * np.cos(angle), along, 0.8 - 0.033 * np.sin(angle)])

    def look(self, name):
        """The messages of a cloud of now and of two grasps on it."""
        self.cloud = Cloud((self.can + np.array([self.shift, 0.0, 0.0])).astype(np.float32), None, FRAME, self.now)
        self.planned = [
            Grasp(np.array([0.033, y, 0.8]), np.array([-0.033, y, 0.8]), ACROSS, 1.0 - k, f"{name}{' too' * k}", "7")
            for k, y in enumerate((0.0, 0.02))
        ]
        cloud = objects_to_msg([Object.of("7", self.cloud, ASSUMED_TABLE)], FRAME, self.now)
        return cloud, [grasp_to_msg(grasp) for grasp in self.planned]

    def grasp(self, name, number):
        self.now += MS  # no cloud before has this stamp
        return super().grasp(name, number)

    def message(self, counts):
        self.felt.append(super().message(counts))
        return self.felt[-1]

    def cut(self, times):
        """What the recorder would cut out of the messages of this hand."""
        buffer = TouchBuffer(channels=self.channels)
        for message in self.felt:
            stamp, counts = self.content(message)
            buffer.add(TactileReading(stamp, counts, np.empty(0, np.float32), stamp))
        interval = Interval(**{name: stamp_ns(stamp) for name, stamp in times.items()})
        return cut_touch(buffer, interval, TouchSettings.from_mapping({"pairing": PAIRING}).pairing)

    @staticmethod
    def content(message):
        """Stamp and counts of a message."""
        thumb, middle = (finger_counts(message, name) for name in ("TH", "MF"))
        counts = np.concatenate([thumb[:1], middle[:1], thumb[1:], middle[1:]])
        return stamp_ns(message.header.stamp), counts


class DirectHand(CanRobot):
    """Sends its messages straight to an adapter, whose clock stands still between two of them."""

    def __init__(self, model, **settings):
        self.begin()
        self.config = TouchSettings.from_mapping({"pairing": PAIRING, "use_tare": False, **settings})
        self.model, self.said, self.now = load_model(model) if isinstance(model, str) else model, [], time.time_ns()
        reader, self.keeper = make_reader(self.config.tactile), HistoryKeeper(self.model)
        self.adapter = OnlineAdapter(
            self.model, reader, self.keeper, lambda: self.config, lambda: self.now, self.said.append
        )
        self._rng, self.sent = np.random.default_rng(0), {"/rh/tactile": 0, "executed_grasp": 0}
        self.hand = SimpleNamespace(publish=self.adapter.add_tactile)
        self.told = SimpleNamespace(publish=self.adapter.add_executed)
        self.feel(self.rest, 5)  # from then on clouds are kept

    def see(self, name, *, requested=False):
        cloud, grasps = self.look(name)
        self.adapter.add_grasps(Targets(cloud.header, decode_objects(cloud)), grasps, requested=requested)

    def ask(self):
        """The predictions for a cloud of now."""
        self.now += MS
        self.see(f"ask {self.now}")
        return self.predict(Object.of("7", self.cloud, ASSUMED_TABLE))

    def predict(self, target):
        read = self.adapter.readings_for(target.cloud)
        return self.model.predict(target, self.planned, history=read, limits=self.config.limits, reach=self.config)

    def reference(self):
        return self.ask()[0].reference

    def counts(self):
        self.adapter.process_touches()
        found = {key.removeprefix("touches."): value for key, value in self.adapter.notes().items()}
        return {key: int(value) for key, value in found.items() if key == "taken_in" or key.startswith("refused")}

    def notes(self):
        return self.adapter.notes()

    def set(self, **settings):
        self.config = self.config.replace(**settings)


class UskinHand(DirectHand):
    """The same with the messages of XELA's server; Z rises in contact on both fingers."""

    rest, noise = np.full(96, 30_000.0), 3.0
    channels = packaged_sensor("xela_uskin_4x4").channels

    @classmethod
    def level(cls, number):
        return cls.rest + 60.0 * (np.arange(96) >= 64)

    def message(self, counts):
        by_taxel = np.asarray(counts).reshape(3, 2, 16).transpose(1, 2, 0)
        self.felt.append(sens_stream(by_taxel, time_s=self.now * 1e-9))
        return self.felt[-1]

    @staticmethod
    def content(message):
        taxels = [[(taxel.x, taxel.y, taxel.z) for taxel in finger.taxels] for finger in message.sensors]
        counts = np.array(taxels, np.float32).transpose(2, 0, 1).ravel()
        time_s = message.sensors[0].time
        return int(time_s) * 10**9 + round(time_s % 1.0 * 1e9), counts


def test_readings_of_a_described_sensor_move_the_predictions_of_its_model():
    sensor = packaged_sensor("xela_uskin_4x4")
    rest = UskinHand.rest + 40.0
    model = constant_model(sensor, rest, make_calibration(0, sensor.channels, rest))
    hand = UskinHand(model, tactile={"sensor": "xela_uskin_4x4"}, use_tare=True)
    (alone, _) = hand.ask()
    assert alone.reference == "none"
    np.testing.assert_array_equal(alone.value.values, rest)
    hand.feel(hand.rest, 250)
    (tared, _), tare = hand.ask(), hand.adapter._recent_tare(hand.config)
    assert tare.channels == sensor.channels
    np.testing.assert_allclose(tare.values, hand.rest, atol=2.0)
    history = History(model)
    history.tare(tare, stamp_ns=hand.now)
    assert_equal([tared], expected(hand, history, tare=True)[:1])
    assert np.abs(tared.value.values - hand.rest).mean() < 0.7 * 40.0  # towards what was read
    cut = hand.cut(hand.grasp("good", 0))
    np.testing.assert_allclose(cut.touch.values - cut.tare.values, 60.0 * (np.arange(96) >= 64), atol=4.0)
    history.tare(cut.tare, stamp_ns=hand.now + MS)
    history.touched(hand.cloud, hand.planned[0], cut.touch, stamp_ns=hand.now + MS, same_object=True)
    found = hand.ask()
    history.tare(hand.adapter._recent_tare(hand.config), stamp_ns=hand.now)
    assert_equal(found, expected(hand, history, tare=True))
    assert (found[0].reference, hand.counts()) == ("touches", {"taken_in": 1})


def expected(hand, history, model=None, *, tare=False):
    """The core's predictions after the same readings."""
    read = None if history is None else history.at(hand.now, same_object=True, tared=tare)
    return (model or hand.model).predict(hand.cloud, hand.planned, history=read)


def assert_equal(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        assert (one.reference, one.evidence) == (other.reference, other.evidence)
        for name in ("value", "lower", "upper"):
            np.testing.assert_array_equal(getattr(one, name).values, getattr(other, name).values)


def test_predictions_are_those_of_the_core_and_forgetting_undoes_it(card):
    for use_tare in (False, True):
        hand, history = DirectHand(card, use_tare=use_tare), None
        assert_equal(hand.ask(), expected(hand, history))
        history = History(hand.model)
        for number in range(3):
            cut = hand.cut(hand.grasp(f"g-{number}", number))
            if use_tare:
                history.tare(cut.tare, stamp_ns=hand.now + MS)
            history.touched(hand.cloud, hand.planned[0], cut.touch, stamp_ns=hand.now + MS, same_object=True)
            found = hand.ask()
            tare = hand.adapter._recent_tare(hand.config)
            assert (tare is not None) == use_tare
            if use_tare:
                history.tare(tare, stamp_ns=hand.now)
            assert_equal(found, expected(hand, history, tare=use_tare))
        assert (hand.notes()["touches"], hand.counts()) == ("3", {"taken_in": 3})
    assert hand.adapter.forget() == 3
    assert (hand.reference(), hand.notes()["touches"]) == ("tare", "0")
    hand.set(use_tare=False)
    assert (hand.reference(), hand.adapter.forget_history() > 3) == ("history", True)
    assert_equal(hand.ask(), expected(hand, None))


def test_a_touch_is_compared_on_the_table_of_its_cloud_however_many_came_since():
    """A camera at 30 Hz sends hundreds of clouds between a plan and the touch."""
    hand = DirectHand(load_model("default"))
    up = np.array([0.0, -np.sin(np.radians(40.0)), -np.cos(np.radians(40.0))])
    table = Plane(up, -float(up @ [0.0, 0.0, 0.84]))
    first, stamp = hand.look("good"), hand.now
    hand.adapter.add_grasps(Targets(first[0].header, decode_objects(first[0], table)), first[1])
    touched = hand.cloud, hand.planned[0]
    for number in range(70):
        hand.now += MS
        later, grasps = hand.look(f"later {number}")
        hand.adapter.add_grasps(Targets(later.header, decode_objects(later, table)), grasps)
    hand.see = lambda name: None  # the grasp is executed on the first cloud
    cut = hand.cut(hand.grasp("good", 0))
    history = History(hand.model)
    history.touched(Object.of("7", touched[0], table), touched[1], cut.touch, stamp_ns=hand.now)
    found = hand.predict(Object.of("7", hand.cloud, table))
    assert hand.counts() == {"taken_in": 1}
    assert touched[0].stamp_ns == stamp
    read = history.at(hand.now, same_object=True)
    assert_equal(found, hand.model.predict(hand.cloud, hand.planned, history=read, table=table))


def test_a_dead_sensor_is_refused_counted_and_named(card):
    hand = DirectHand(card)
    hand.grasp("good", 0)
    before, honest = hand.ask()[0], hand.feel
    hand.feel = lambda counts, readings: honest(np.r_[-22072.0, counts[1:]], readings)
    hand.grasp("dead", 1)
    assert hand.ask()[0].value["PDC_TH"][0] == pytest.approx(
        before.value["PDC_TH"][0], abs=0.1
    )  # but for the drift meanwhile
    assert (hand.notes()["touches"], hand.counts()) == ("1", {"taken_in": 1, "refused.sensor_fault": 1})
    assert "grasp dead: contact: pdc_th: -22072 is not between 1 and 4095" in hand.notes()["touches.last_refusal"]
    hand = DirectHand(card, use_tare=True)
    hand.feel(DEAD, 250)
    assert (hand.reference(), "pdc_th: -22072" in hand.notes()["tare.fault"]) == ("none", True)


def test_another_object_is_told_by_its_place_and_an_old_touch_by_its_age(card):
    hand = DirectHand(card)
    unread = hand.ask()[0]
    assert (unread.reference, unread.evidence.readings, unread.evidence.reading_age_s) == ("none", 0, None)
    for number in range(2):
        hand.grasp(f"g-{number}", number)
    touched = hand.ask()[0]
    assert (touched.reference, touched.evidence.touches, touched.evidence.readings) == ("touches", 2, 2)
    for hand.shift, reference in ((0.015, "touches"), (0.05, "history")):
        other = hand.ask()[0]
        assert other.reference == reference
    assert (other.evidence.touches, other.evidence.readings) == (0, 2)
    assert other.upper["PDC_TH"][0] - other.lower["PDC_TH"][0] < unread.upper["PDC_TH"][0] - unread.lower["PDC_TH"][0]
    hand.grasp("elsewhere", 1)  # the history of an object begins with the one that was touched last
    assert (hand.reference(), hand.notes()["touches"]) == ("touches", "1")
    for use_touches, reference in ((False, "none"), (True, "touches")):
        hand.set(use_touches=use_touches)
        assert hand.reference() == reference
    hand.set(forget_after_s=0.0)
    assert (hand.reference(), hand.notes()["touches"]) == ("history", "0")


def test_a_clock_that_was_set_back_is_reported_once(card):
    hand = DirectHand(card, use_tare=True)
    start, tare = hand.now, biotac_touch(TOUCH_REST)
    hand.keeper.history.tare(tare, stamp_ns=start)
    hand.adapter._recent_tare = lambda _: tare
    for hours, lines in ((1, 1), (1, 1), (0, 1), (2, 2)):
        hand.now = start - hours * 3_600_000 * MS
        assert (hand.reference(), len(hand.said)) == ("tare", lines)
    assert set(hand.said) == {"history: the clock was set back: readings that are ahead of it count as taken now"}
    assert hand.keeper.history.tracker.evidence(hand.now).readings == 4


@pytest.mark.slow
def test_a_hand_without_readings_and_a_model_without_calibration_harm_nobody(graph, card, model_card):
    (node,) = graph.add("touch_predictor", model=card, tactile__type="std_msgs/String")
    lines = graph.talk_matched(String, "/rh/tactile")
    lines.publish(String(data="not,a,reading"))
    graph.until(lambda: node.reported().values["tactile.unreadable"] == "1")
    assert "CSV: 3 fields" in node.reported().values["tactile.last_unreadable"]
    graph.remove(node)
    (node,) = graph.add("touch_predictor", model=model_card)
    assert graph.probe.count_subscribers("/rh/tactile") == 0
    assert "no calibration" in node.reported().values["regime"]
    reports, monitor = graph.reports("touch_predictor"), MonitorNode()
    graph.serve(monitor)
    text = "model small gives no intervals and does not adapt to readings: "
    graph.until(lambda: reports and reports[-1].level == DiagnosticStatus.WARN and text in reports[-1].message)
    console = Console(file=io.StringIO(), width=200)
    graph.until(lambda: console.print(live_panel(monitor.view(), "")) or text in console.file.getvalue())
    assert graph.call(Trigger, "forget_touches").message == "0 touches forgotten"
    for words, status, text in (
        (("touches",), 0, "0 touches forgotten\n"),
        (("history", "--wait", "0.2", "--namespace", "/no"), 1, ""),
    ):
        command = [sys.executable, "-m", "foretouch", "forget", *words]
        done = subprocess.run(command, env=graph.environment(), capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stdout) == (status, text), done.stderr
    assert done.stderr == "foretouch: /no/forget_history: no such service within 0.2 s: is the graph running?\n"


def test_the_memory_for_clouds_is_bounded_and_named(card) -> None:
    hand = DirectHand(str(card), pairing=PAIRING | {"kept_mb": 1.0})
    hand.see("first")
    assert hand.notes()["clouds.kept"] == "1"
    for number in range(200):
        hand.now += MS
        hand.see(f"cloud {number}")
    notes = hand.notes()
    assert 0.9 <= float(notes["clouds.kept_mb"]) <= 1.0
    assert 20 <= int(notes["clouds.kept"]) < 200
