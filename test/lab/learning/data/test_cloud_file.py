# SPDX-License-Identifier: Apache-2.0
"""Prepared clouds on the disk: what was written is read, in any order and in other processes."""

import pickle
import tempfile

import numpy as np
import pytest

from foretouch.processes import process_pool
from foretouch_lab.learning.data.training_set import CloudFile


def test_clouds_are_read_as_they_were_written_also_in_another_process(rng, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    made = [rng.normal(size=(int(count), 6)).astype(np.float32) for count in rng.integers(1, 90, 40)]
    clouds = CloudFile()
    for cloud in made:
        clouds.append(cloud)
    assert list(tmp_path.iterdir()) == []  # it has no name
    assert len(clouds) == 40
    for k in rng.permutation(40):
        np.testing.assert_array_equal(clouds[k], made[k])
        assert clouds[k].dtype == np.float32
    np.testing.assert_array_equal(clouds[-1], made[-1])
    with pytest.raises(IndexError):
        clouds[40]
    copy = pickle.loads(pickle.dumps(clouds))
    assert [cloud.tolist() for cloud in copy] == [cloud.tolist() for cloud in made]
    with process_pool(1) as pool:
        assert [cloud.tolist() for cloud in pool.submit(list, clouds).result()] == [cloud.tolist() for cloud in made]
