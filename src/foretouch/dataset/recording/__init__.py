# SPDX-License-Identifier: Apache-2.0
"""Recording of grasps that loses nothing, in files that ROS tools open: MCAP, a chunk a sample."""

from foretouch.dataset.recording.accounts import Accounts, TopicAccount
from foretouch.dataset.recording.record import APPROACH, HOLD, REST, Identity, Outcome, SampleRecord, TouchSeries
from foretouch.dataset.recording.writer import SAMPLE_TOPIC, RecordingConfig, RecordingWriter

__all__ = [
    "APPROACH",
    "HOLD",
    "REST",
    "SAMPLE_TOPIC",
    "Accounts",
    "Identity",
    "Outcome",
    "RecordingConfig",
    "RecordingWriter",
    "SampleRecord",
    "TopicAccount",
    "TouchSeries",
]
