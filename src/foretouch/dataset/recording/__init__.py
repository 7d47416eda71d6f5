# SPDX-License-Identifier: Apache-2.0
"""Recording of grasps that loses nothing, in files that ROS tools open: MCAP, a chunk a sample."""

from foretouch.dataset.recording.accounts import Accounts, TopicAccount
from foretouch.dataset.recording.folder import is_dataset
from foretouch.dataset.recording.messages import SAMPLE_TOPIC, StoredSample
from foretouch.dataset.recording.policy import RecordingConfig
from foretouch.dataset.recording.reader import RecordedDataset, holds_samples
from foretouch.dataset.recording.record import APPROACH, HOLD, REST, Identity, Outcome, SampleRecord, TouchSeries
from foretouch.dataset.recording.repair import RepairReport, repair_dataset
from foretouch.dataset.recording.verify import FileReport, verify_dataset
from foretouch.dataset.recording.writer import RecordingWriter

__all__ = [
    "APPROACH",
    "HOLD",
    "REST",
    "SAMPLE_TOPIC",
    "Accounts",
    "FileReport",
    "Identity",
    "Outcome",
    "RecordedDataset",
    "RecordingConfig",
    "RecordingWriter",
    "RepairReport",
    "SampleRecord",
    "StoredSample",
    "TopicAccount",
    "TouchSeries",
    "holds_samples",
    "is_dataset",
    "repair_dataset",
    "verify_dataset",
]
