"""Bridges to other programs: Foxglove (``foxglove``, ``relay``, ``layouts``) and ROS 2 (``ros``, ``rosbag``)."""
