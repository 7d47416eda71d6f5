# SPDX-License-Identifier: Apache-2.0
"""Crash-safe recording of grasps in files that ROS tools can open: MCAP, one chunk a sample."""

from foretouch.dataset.record import APPROACH, HOLD, REST, Identity, Outcome, SampleRecord, TouchSeries
from foretouch.dataset.recording.folder import is_dataset
from foretouch.dataset.recording.reader import RecordedDataset
from foretouch.dataset.recording.records import MessageCounts, TopicCounts
from foretouch.dataset.recording.repair import RepairReport, repair_dataset
from foretouch.dataset.recording.sample_codec import SAMPLE_TOPIC, StoredSample
from foretouch.dataset.recording.verify import FileReport, verify_dataset
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter

__all__ = [
    "APPROACH",
    "HOLD",
    "REST",
    "SAMPLE_TOPIC",
    "FileReport",
    "Identity",
    "MessageCounts",
    "Outcome",
    "RecordedDataset",
    "RecordingConfig",
    "RecordingWriter",
    "RepairReport",
    "SampleRecord",
    "StoredSample",
    "TopicCounts",
    "TouchSeries",
    "is_dataset",
    "repair_dataset",
    "verify_dataset",
]
