# SPDX-License-Identifier: Apache-2.0
# Alias until merge.
from foretouch.dataset.store_writer import BuildResult, SampleFacts, build_store

__all__ = ["BuildResult", "SampleFacts", "build_store"]
