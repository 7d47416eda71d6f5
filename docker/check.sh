#!/usr/bin/env bash
# Checks foretouch beside a full ROS 2, one step after the other, and prints what to report.
#
# In a colcon workspace that holds this repository as src/foretouch, after `. /opt/ros/jazzy/setup.bash`:
#   bash src/foretouch/docker/check.sh                    # all steps
#   bash src/foretouch/docker/check.sh doctor scene bag   # some of them, in this order
#   bash src/foretouch/docker/check.sh --list
# A step that fails does not stop the others. Exit status 1 if one has failed. Nothing outside the workspace is changed, but
# for the packages that rosdep installs.
set -u
STEPS=(machine rosdep environment build doctor interfaces launch_files typed scene bag tests)
HERE=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
REPORT=foretouch-report.txt
LIMIT_S=${LIMIT_S:-1800} # of each step

# The machine, its ROS 2, and whether large clouds have room.
machine() {
  uname -srm
  grep -m 1 PRETTY_NAME /etc/os-release
  python3 --version
  df -h /dev/shm | tail -n 1
  echo "RMW_IMPLEMENTATION=${RMW_IMPLEMENTATION:-} ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-}"
  test -n "${ROS_DISTRO:-}" || { echo "ROS_DISTRO is not set: . /opt/ros/jazzy/setup.bash"; return 1; }
  echo "ROS_DISTRO=$ROS_DISTRO"
}

# What rosdep has keys for, from the packages of the distribution.
rosdep() {
  apt_get update -qq && command rosdep update && command rosdep install -y --from-paths "$HERE" "$HERE/foretouch_msgs" --ignore-src
}

apt_get() { if test "$(id -u)" = 0; then apt-get "$@"; else sudo -n apt-get "$@"; fi; }

# What rosdep has no keys for, in an environment that sees the packages of the system; and what the tests need.
environment() {
  python3 -m venv --system-site-packages venv && touch venv/COLCON_IGNORE && . venv/bin/activate \
    && pip install -q -c "$HERE/constraints.txt" safetensors embreex lazy_loader mcap pyarrow rosbags threadpoolctl trimesh python-neo-lzf \
    && pip install -q hypothesis pytest-timeout mpmath
}

build() { activate && colcon build --base-paths "$HERE" "$HERE/foretouch_msgs"; }

doctor() { activate && foretouch doctor; }

# The messages as the tools of ROS 2 read them, and the executables that `ros2 run` finds.
interfaces() {
  activate && ros2 interface show foretouch_msgs/msg/TouchPredictionArray >/dev/null \
    && ros2 interface show foretouch_msgs/action/SampleGrasps >/dev/null && ros2 pkg executables foretouch
}

launch_files() { activate && cd "$HERE" && python3 -m pytest -q -rs -p no:cacheprovider test/ros/test_launch_files.py; }

# The commands of the pages and the launch files, typed.
typed() { activate && cd "$HERE" && ROS2_TOOLS=$(dirname "$(command -v ros2)") python3 -m pytest -q -rs -p no:cacheprovider test/ros/test_typed_commands.py; }

# A launch file of a simulated scene, whose answers `ros2 topic` and `ros2 service` see.
scene() {
  activate && started "ros2 launch foretouch scene.launch.py scene:=$HERE/examples/data/table.yaml" || return 1
  timeout 90 ros2 topic echo --once --field status /foretouch/touch foretouch_msgs/msg/TouchPredictionArray
  local answered=$?
  timeout 20 ros2 lifecycle get /foretouch/perception
  ended && return $answered
}

# A recording of `ros2 bag`, split into files, that foretouch reads.
bag() {
  activate && rm -rf foretouch-bag && started "ros2 launch foretouch scene.launch.py scene:=$HERE/examples/data/table.yaml" || return 1
  timeout -s INT 40 ros2 bag record -o foretouch-bag -s mcap -d 10 /foretouch/points /foretouch/touch
  ended
  ls foretouch-bag && foretouch segment foretouch-bag | tail -n 3
}

tests() { activate && cd "$HERE" && python3 -m pytest -q -rs -p no:cacheprovider -m "not slow" test/ros test/dataset/recordings/test_bag.py; }

activate() { . venv/bin/activate && set +u && . install/setup.bash && set -u; }

started() { setsid $1 >launched.log 2>&1 & launched=$!; sleep 5; kill -0 $launched 2>/dev/null || { tail -n 20 launched.log; return 1; }; }

ended() { kill -INT -- "-$launched" 2>/dev/null; timeout 30 tail --pid=$launched -f /dev/null; grep -E "ERROR|Traceback|process has died" launched.log | head -n 5; true; }

# Runs a step in a shell of its own; its result and its last lines go into the report.
run() {
  local began=$SECONDS log
  log=$(mktemp)
  echo "== $1"
  timeout -k 30 "$LIMIT_S" bash -c "$(declare -f); HERE='$HERE'; set -u; $1" >"$log" 2>&1
  local status=$?
  test $status = 0 && result=ok || result="FAILED, exit status $status"
  { echo "== $1: $result, $((SECONDS - began)) s"; tail -n "$(test $status = 0 && echo 8 || echo 40)" "$log" | cut -c 1-300; } | tee -a "$REPORT"
  rm -f "$log"
  return $status
}

test "${1:-}" = --list && { printf '%s\n' "${STEPS[@]}"; exit 0; }
test "${1:-}" = --report && { REPORT=$2; shift 2; }
for step in "$@"; do
  [[ " ${STEPS[*]} " == *" $step "* ]] || { echo "check.sh: $step is none of the steps: ${STEPS[*]}" >&2; exit 2; }
done
test $# = 0 && set -- "${STEPS[@]}"
: >"$REPORT"
failed=0
for step in "$@"; do run "$step" || failed=$((failed + 1)); done
echo "$# steps, $failed failed. Please report $REPORT at https://github.com/foretouch/foretouch/issues"
exit $((failed > 0))
