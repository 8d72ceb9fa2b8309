# The stack on Debian 12, whose own packages hold ROS 1. From the root of a clone:
#   docker build -f scripts/docker/debian-12.Dockerfile -t ros4hri .
#   docker run --rm -it --init --net=host ros4hri roslaunch ros4hri ros4hri.launch image:=/camera/image_raw
# The master of a robot: -e ROS_MASTER_URI=http://ROBOT:11311 -e ROS_IP=ADDRESS_OF_THIS_MACHINE.
# --net=host: ROS 1 nodes talk over ports of their own choice. A webcam: --device /dev/video0.
# --init: somebody has to collect processes whose parent has ended.
FROM debian:bookworm-slim
COPY . /opt/ros4hri
# System packages, Python packages, models, and the workspace: what scripts/demo installs and builds.
RUN bash /opt/ros4hri/scripts/lib/in_workspace.sh docker true && rm -rf /var/lib/apt/lists/*
ENTRYPOINT ["bash", "/opt/ros4hri/scripts/lib/in_workspace.sh", "docker"]
CMD ["roslaunch", "ros4hri", "ros4hri.launch"]
