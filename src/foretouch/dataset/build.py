# SPDX-License-Identifier: Apache-2.0
from foretouch.dataset.store_writer import *  # noqa: F403
from foretouch.dataset.store_writer import BuildResult as BuildResult
from foretouch.dataset.store_writer import SampleFacts as SampleFacts
from foretouch.dataset.store_writer import build_store as build_store
