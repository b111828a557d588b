"""Starts the predictor: ros2 launch rigidformer_ros predictor.launch.py model:=nano.rfm params:=units.yaml"""

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
            DeclareLaunchArgument("model", description="Path of a packed model, .rfm"),
            DeclareLaunchArgument(
                "params",
                default_value=os.path.join(share, "config", "predictor.yaml"),
                description="Parameters: the units, times, gravity and ground",
            ),
            DeclareLaunchArgument(
                "poses",
                default_value="~/poses",
                description="Topic of geometry_msgs/PoseArray with one pose for each unit",
            ),
            Node(
                package="rigidformer_ros",
                executable="predictor_node",
                name="rigidformer_predictor",
                output="screen",
                parameters=[LaunchConfiguration("params"), {"model": LaunchConfiguration("model")}],
                remappings=[("~/poses", LaunchConfiguration("poses"))],
            ),
        ]
    )
