# SPDX-License-Identifier: Apache-2.0
import os
import platform
import sys
from pathlib import Path

import pytest
from command_answer import run_python

from foretouch.ros.runtime.environment import SHARED_MEMORY_PROFILE, large_clouds, prepare_environment, profile_variable

PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
NAMES = ("AMENT_PREFIX_PATH", *PROFILE_VARIABLES, "OMP_NUM_THREADS")


@pytest.fixture
def bare(monkeypatch):
    for name in NAMES:
        monkeypatch.setenv(name, "x")  # so that it is put back
        monkeypatch.delenv(name)
    return monkeypatch


def printed(code, **environment):
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    done = run_python(code, env=kept | environment)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_what_is_missing_is_set_and_what_the_user_has_set_stays(bare):
    with bare.context():
        prepare_environment()
        assert os.environ["AMENT_PREFIX_PATH"] == sys.prefix
        assert [os.environ.get(name) for name in PROFILE_VARIABLES].count(str(SHARED_MEMORY_PROFILE)) == 1
        assert os.environ["OMP_NUM_THREADS"] == "1"
    for name in NAMES:
        with bare.context() as patch:
            for other in NAMES:
                patch.setenv(other, "x")
                patch.delenv(other)
            patch.setenv(name, "mine")
            prepare_environment()
            assert os.environ[name] == "mine"
            assert name not in PROFILE_VARIABLES or sum(other in os.environ for other in PROFILE_VARIABLES) == 1


@pytest.mark.parametrize(("package", "name"), list(zip(("fastdds", "fastrtps"), PROFILE_VARIABLES, strict=True)))
def test_the_profile_is_named_where_the_installed_fast_dds_reads_it(bare, tmp_path, package, name):
    (tmp_path / "ros" / "share" / package).mkdir(parents=True)
    bare.setenv("AMENT_PREFIX_PATH", os.pathsep.join((str(tmp_path / "workspace"), str(tmp_path / "ros"))))
    assert profile_variable() == name
    prepare_environment()
    assert os.environ[name] == str(SHARED_MEMORY_PROFILE)


@pytest.mark.ros
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="no /dev/shm")
def test_the_segment_of_a_started_process_is_as_large_as_the_profile_demands(bare):
    code = (
        "from foretouch.ros.runtime.environment import start_rclpy\n"
        "from pathlib import Path\n"
        "sizes = lambda: {one.name: one.stat().st_size for one in Path('/dev/shm').glob('fast*')}\n"
        "before = sizes(); start_rclpy([]); import rclpy; node = rclpy.create_node('alone')\n"
        "print(max(size for name, size in sizes().items() if name not in before))\n"
        "node.destroy_node(); rclpy.shutdown()"
    )
    assert int(*printed(code)) > 64 * 1024 * 1024


def test_large_clouds_pass_by_fast_dds_with_room_and_nothing_is_promised_for_another_middleware(tmp_path):
    text, fine = large_clouds("rmw_fastrtps_cpp", tmp_path / "none")
    assert (fine, "there is no" in text) == (False, True)
    for name in ("rmw_cyclonedds_cpp", "rmw_zenoh_cpp"):
        text, fine = large_clouds(name, tmp_path)
        assert (fine, text.startswith(f"{name}: not tested")) == (False, True)


@pytest.mark.skipif(sys.platform != "linux" or platform.libc_ver()[0] != "glibc", reason="only glibc has mallopt")
def test_the_memory_of_a_cloud_is_used_again():
    code = (
        "import resource; from foretouch.ros.runtime.environment import prepare_environment; prepare_environment()\n"
        "bytearray(5_000_000); before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "for _ in range(20): bytearray(5_000_000)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"
    )
    assert int(*printed(code)) < 2000  # page faults, of 24,400
    assert int(*printed(code, MALLOC_TRIM_THRESHOLD_="131072")) > 10_000  # the user's own stays
