# SPDX-License-Identifier: Apache-2.0
"""Where clouds and grasps come from and go to: files, folders, recordings, and collections made by others."""

from foretouch.dataset.bag import Message, Recording, Topic, is_recording, list_topics, read_bag
from foretouch.dataset.bag_writer import BagWriter, write_bag
from foretouch.dataset.source import Source, SourceItem, open_source, readable
from foretouch.dataset.vision2tactile import read_folder, read_sample

__all__ = [
    "BagWriter",
    "Message",
    "Recording",
    "Source",
    "SourceItem",
    "Topic",
    "is_recording",
    "list_topics",
    "open_source",
    "read_bag",
    "read_folder",
    "read_sample",
    "readable",
    "write_bag",
]
