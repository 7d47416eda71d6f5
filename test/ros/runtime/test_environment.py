# SPDX-License-Identifier: Apache-2.0
import os
import platform
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from foretouch.ros.runtime.environment import SHARED_MEMORY_PROFILE, prepare_environment, profile_variable

PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
NAMES = ("AMENT_PREFIX_PATH", *PROFILE_VARIABLES, "OMP_NUM_THREADS")


@pytest.fixture
def bare(monkeypatch):
    for name in NAMES:
        monkeypatch.setenv(name, "x")  # so that it is put back
        monkeypatch.delenv(name)
    return monkeypatch


def test_what_is_missing_is_set(bare):
    prepare_environment()
    assert os.environ["AMENT_PREFIX_PATH"] == sys.prefix
    assert [os.environ.get(name) for name in PROFILE_VARIABLES].count(str(SHARED_MEMORY_PROFILE)) == 1
    assert os.environ["OMP_NUM_THREADS"] == "1"


@pytest.mark.parametrize("name", NAMES)
def test_what_the_user_has_set_stays(bare, name):
    bare.setenv(name, "mine")
    prepare_environment()
    assert os.environ[name] == "mine"
    if name in PROFILE_VARIABLES:
        assert not any(other in os.environ for other in PROFILE_VARIABLES if other != name)


@pytest.mark.parametrize(("package", "name"), list(zip(("fastdds", "fastrtps"), PROFILE_VARIABLES, strict=True)))
def test_the_profile_is_named_where_the_installed_fast_dds_reads_it(bare, tmp_path, package, name):
    (tmp_path / "ros" / "share" / package).mkdir(parents=True)
    bare.setenv("AMENT_PREFIX_PATH", os.pathsep.join((str(tmp_path / "workspace"), str(tmp_path / "ros"))))
    assert profile_variable() == name
    prepare_environment()
    assert os.environ[name] == str(SHARED_MEMORY_PROFILE)


@pytest.mark.ros
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="no /dev/shm")
def test_the_segment_of_a_started_process_is_as_large_as_the_profile_says(bare):
    code = (
        "import os; from foretouch.ros.runtime.environment import start_rclpy\n"
        "sizes = lambda: {one.name: one.stat().st_size for one in os.scandir('/dev/shm')}\n"
        "before = sizes(); start_rclpy([]); import rclpy; node = rclpy.create_node('alone')\n"
        "print(max(size for name, size in sizes().items() if name not in before))\n"
        "node.destroy_node(); rclpy.shutdown()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(result.stdout) > 64 * 1024 * 1024
    assert not result.stderr


def test_the_profile_offers_64_mb_and_still_reaches_other_machines():
    space = {"d": "http://www.eprosima.com"}
    root = ET.parse(SHARED_MEMORY_PROFILE).getroot()
    kinds = {
        transport.findtext("d:transport_id", namespaces=space): transport
        for transport in root.iterfind(".//d:transport_descriptor", space)
    }
    used = [one.text for one in root.iterfind(".//d:userTransports/d:transport_id", space)]
    assert sorted(used) == sorted(kinds)
    assert {one.findtext("d:type", namespaces=space) for one in kinds.values()} == {"SHM", "UDPv4"}
    assert int(root.find(".//d:segment_size", space).text) == 64 * 1024 * 1024
    assert int(root.find(".//d:maxMessageSize", space).text) > 1280 * 720 * 16


def test_the_profile_announces_often():
    space = {"d": "http://www.eprosima.com"}
    config = (
        ET.parse(SHARED_MEMORY_PROFILE).getroot().find(".//d:participant/d:rtps/d:builtin/d:discovery_config", space)
    )
    period = config.find("d:leaseAnnouncement", space)
    seconds = int(period.findtext("d:sec", None, space)) + 1e-9 * int(period.findtext("d:nanosec", None, space))
    assert seconds <= 0.5


def test_it_loads_neither_numpy_nor_rclpy():
    code = "import sys, foretouch.ros.runtime.environment, foretouch.ros.executables; print('numpy' in sys.modules, 'rclpy' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False"]


def _page_faults(**environment):
    code = (
        "import resource; from foretouch.ros.runtime.environment import prepare_environment; prepare_environment()\n"
        "bytearray(5_000_000); before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "for _ in range(20): bytearray(5_000_000)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"
    )
    known = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=known | environment
    )
    return int(result.stdout)


@pytest.mark.skipif(sys.platform != "linux" or platform.libc_ver()[0] != "glibc", reason="only glibc has mallopt")
def test_the_memory_of_a_cloud_is_used_again():
    assert _page_faults() < 2000  # of 24,400
    assert _page_faults(MALLOC_TRIM_THRESHOLD_="131072") > 10_000  # the user's own stays
