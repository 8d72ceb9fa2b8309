"""Perception core without ROS: numpy, OpenCV and onnxruntime only; time is an argument."""
