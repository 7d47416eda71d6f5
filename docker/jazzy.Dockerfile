# ROS 2 Jazzy from the packages of Ubuntu 24.04, as on a robot. A template, not tested:
# docker build -f docker/jazzy.Dockerfile -t foretouch-jazzy . && docker run --rm --shm-size=1g foretouch-jazzy
FROM ros:jazzy-ros-base
RUN apt-get update && apt-get install -y --no-install-recommends g++ git python3-venv libgl1 libgomp1 \
      ros-jazzy-launch-pytest ros-jazzy-rosbag2 ros-jazzy-rosbag2-storage-mcap ros-jazzy-tf2-ros-py && rm -rf /var/lib/apt/lists/*
WORKDIR /ws
COPY . src/foretouch
RUN bash src/foretouch/docker/check.sh --report /ws/build-report.txt rosdep environment build
CMD ["bash", "src/foretouch/docker/check.sh", "machine", "doctor", "interfaces", "launch_files", "typed", "scene", "bag", "tests"]
