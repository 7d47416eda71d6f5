# SPDX-License-Identifier: Apache-2.0
import hashlib

import numpy as np

from foretouch.simulation.world import SampleKey


def test_a_stream_is_seeded_by_scene_name_slot_and_attempt() -> None:
    digest = hashlib.sha256(b"noise").digest()[:16]
    words = np.frombuffer(digest, "<u4").tolist()
    expected = np.random.Generator(np.random.PCG64(np.random.SeedSequence((5, *words, 7, 2)))).random(4)
    np.testing.assert_array_equal(SampleKey(5, 7, 2).stream("noise").random(4), expected)
    keys = [SampleKey(0, 0), SampleKey(1, 0), SampleKey(0, 1), SampleKey(0, 0, 1)]
    assert len({key.stream(name).random() for key in keys for name in ("noise", "holes", "noise ")}) == 12
