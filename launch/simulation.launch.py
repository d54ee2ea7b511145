"""Controller on a simulator with ros2_control: ``ros2 launch wbc_controller simulation.launch.py config:=…``.

Starts mujoco_ros2_control, or uses a running simulator (``simulator:=false``), such as Gazebo with gz_ros2_control.
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import Command, FindExecutable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

from launch import LaunchDescription

SIM_TIME = {"use_sim_time": True}


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument("config", description="Path of the robot's configuration."),
        DeclareLaunchArgument(
            "controllers",
            description="Path of the controllers of ros2_control, such as config/ros2_control/g1.yaml: a joint state "
            "broadcaster, and an effort controller with the joints of the configuration in its order.",
        ),
        DeclareLaunchArgument(
            "simulator",
            default_value="true",
            choices=["true", "false"],
            description="Start mujoco_ros2_control and robot_state_publisher; false for a running simulator with a "
            "controller manager.",
        ),
        DeclareLaunchArgument(
            "description",
            default_value="",
            description="With simulator:=true, path of the robot's URDF or xacro, with a <ros2_control> tag that names "
            "the plugin mujoco_ros2_control/MujocoSystemInterface and the MJCF model.",
        ),
        DeclareLaunchArgument(
            "odom",
            default_value="/simulator/floating_base_state",
            description="Topic of pose and twist of the base: odom_topic of mujoco_ros2_control.",
        ),
        DeclareLaunchArgument(
            "activate",
            default_value="false",
            choices=["true", "false"],
            description="Activate the controller without a command, when its inputs are fresh.",
        ),
    ]
    controllers = LaunchConfiguration("controllers")
    simulated = IfCondition(LaunchConfiguration("simulator"))
    robot_description = Command([FindExecutable(name="xacro"), " ", LaunchConfiguration("description")])
    state_publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[SIM_TIME, {"robot_description": ParameterValue(robot_description, value_type=str)}],
        condition=simulated,
        output="screen",
    )
    simulator = Node(
        package="mujoco_ros2_control",
        executable="ros2_control_node",
        parameters=[SIM_TIME, ParameterFile(controllers)],
        condition=simulated,
        output="screen",
    )
    spawner = Node(
        package="controller_manager",
        executable="spawner",
        arguments=["joint_state_broadcaster", "effort_controller", "--param-file", controllers],
        output="screen",
    )
    controller = Node(
        package="wbc_controller",
        executable="wbc_controller",
        name="wbc_controller",
        parameters=[
            SIM_TIME,
            {
                "config": ParameterValue(LaunchConfiguration("config"), value_type=str),
                "activate": ParameterValue(LaunchConfiguration("activate"), value_type=bool),
            },
        ],
        remappings=[("odom", LaunchConfiguration("odom"))],
        output="screen",
    )
    return LaunchDescription([*arguments, state_publisher, simulator, spawner, controller])
