# SPDX-License-Identifier: Apache-2.0
"""What the check of a recording does with messages that cannot be decoded."""

from types import SimpleNamespace

import pytest

from foretouch.dataset.session_check import SessionCheck
from foretouch.ros.recorder.check_feed import CheckFeed
from foretouch.ros.recorder.subscriptions import RecordedTopic
from foretouch.ros.runtime.subscription import SerializedMessage
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileConfig
from foretouch_msgs.msg import BiotacAll

pytestmark = pytest.mark.ros

TACTILE = "/rh/tactile"


def test_messages_that_cannot_be_decoded_are_counted_and_named() -> None:
    reader = make_reader(TactileConfig())
    check = SessionCheck(("TH", "MF"), reader)
    queues = []
    topics = {TACTILE: RecordedTopic(TACTILE, BiotacAll, role="tactile")}
    inputs = SimpleNamespace(topics=topics, open=queues.append, close=lambda: None)
    feed = CheckFeed(check, inputs, reader)
    for number in range(7):
        queues[0].put(SerializedMessage(TACTILE, b"\0\1\0\0 not a message", number, number, None))
    feed.receive(0.1)
    feed.close()
    (finding,) = [finding for finding in check.at_rest() if finding.name == "messages"]
    assert finding.found.startswith("cannot be decoded: 7 of tactile: BiotacAll: 18 bytes cannot be deserialized")
    assert finding.fix == "do the types and the sensor's description fit?"
