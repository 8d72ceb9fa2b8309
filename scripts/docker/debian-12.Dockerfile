# The stack on Debian 12, whose own packages hold ROS 1. From the root of a clone:
#   docker build -f scripts/docker/debian-12.Dockerfile -t ros4hri .
#   docker run --rm -it --net=host ros4hri roslaunch ros4hri ros4hri.launch image:=/camera/image_raw
# --net=host: ROS 1 nodes talk over ports of their own choice. A webcam: --device /dev/video0.
FROM debian:bookworm-slim
COPY . /opt/ros4hri
# System packages, Python packages, models, and the workspace: what scripts/demo installs and builds.
RUN /opt/ros4hri/scripts/lib/in_workspace.sh docker true && rm -rf /var/lib/apt/lists/*
ENTRYPOINT ["/opt/ros4hri/scripts/lib/in_workspace.sh", "docker"]
CMD ["roslaunch", "ros4hri", "ros4hri.launch"]
