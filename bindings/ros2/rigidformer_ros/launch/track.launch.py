"""Starts the tracker: ros2 launch rigidformer_ros track.launch.py model:=edge.rfm depth:=/camera/depth/image_rect_raw"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    share = get_package_share_directory("rigidformer_ros")
    return LaunchDescription(
        [
            DeclareLaunchArgument("model", description="Path of a packed model for rigid units, .rfm"),
            DeclareLaunchArgument(
                "params",
                default_value=os.path.join(share, "config", "track.yaml"),
                description="Parameters: the world's frame, times, bounds",
            ),
            DeclareLaunchArgument(
                "depth", default_value="~/depth", description="Topic of sensor_msgs/Image, rectified depth"
            ),
            DeclareLaunchArgument(
                "camera_info", default_value="~/camera_info", description="Topic of sensor_msgs/CameraInfo of the depth image"
            ),
            DeclareLaunchArgument(
                "points", default_value="~/points", description="Topic of sensor_msgs/PointCloud2, where input is points"
            ),
            Node(
                package="rigidformer_ros",
                executable="track_node",
                name="rigidformer_track",
                output="screen",
                parameters=[LaunchConfiguration("params"), {"model": LaunchConfiguration("model")}],
                remappings=[
                    ("~/depth", LaunchConfiguration("depth")),
                    ("~/camera_info", LaunchConfiguration("camera_info")),
                    ("~/points", LaunchConfiguration("points")),
                ],
            ),
        ]
    )
