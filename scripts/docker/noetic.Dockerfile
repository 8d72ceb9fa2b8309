# The stack on Ubuntu 20.04 with ROS Noetic. From the root of a clone:
#   docker build -f scripts/docker/noetic.Dockerfile -t ros4hri:noetic .
#   docker run --rm -it --init --net=host ros4hri:noetic roslaunch ros4hri ros4hri.launch image:=/camera/image_raw
# The master of a robot: -e ROS_MASTER_URI=http://ROBOT:11311 -e ROS_IP=ADDRESS_OF_THIS_MACHINE.
# --net=host: ROS 1 nodes talk over ports of their own choice. A webcam: --device /dev/video0.
# --init: somebody has to collect processes whose parent has ended.
FROM ros:noetic-ros-base-focal
COPY . /opt/ros4hri
# System packages, Python packages, models, and the workspace: what scripts/demo installs and builds.
RUN bash /opt/ros4hri/scripts/lib/in_workspace.sh docker true && rm -rf /var/lib/apt/lists/*
ENTRYPOINT ["bash", "/opt/ros4hri/scripts/lib/in_workspace.sh", "docker"]
CMD ["roslaunch", "ros4hri", "ros4hri.launch"]
