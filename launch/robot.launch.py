"""Controller for an existing robot or simulator: ``ros2 launch wbc_controller robot.launch.py config:=…``."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument("config", description="Path of the robot's configuration."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node."),
        DeclareLaunchArgument(
            "activate",
            default_value="false",
            choices=["true", "false"],
            description="Activate the controller without a command, when its inputs are fresh.",
        ),
        DeclareLaunchArgument(
            "guard",
            default_value="false",
            choices=["true", "false"],
            description="Start the guard, which damps the robot when the controller's commands stop.",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false"],
            description="Use /clock for ages and ramps: for simulators only.",
        ),
        DeclareLaunchArgument(
            "joint_states", default_value="joint_states", description="Topic of the robot's joint states."
        ),
        DeclareLaunchArgument(
            "odom",
            default_value="odom",
            description="Topic of pose and twist of the base, from an estimator or simulator.",
        ),
        DeclareLaunchArgument(
            "effort",
            default_value="effort_controller/commands",
            description="Topic of the torques: command topic of ros2_control's effort controller.",
        ),
    ]
    config = {"config": ParameterValue(LaunchConfiguration("config"), value_type=str)}
    remappings = [
        ("joint_states", LaunchConfiguration("joint_states")),
        ("odom", LaunchConfiguration("odom")),
        ("effort_controller/commands", LaunchConfiguration("effort")),
    ]
    controller = Node(
        package="wbc_controller",
        executable="wbc_controller",
        name="wbc_controller",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            config,
            {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in ("activate", "use_sim_time")},
        ],
        remappings=remappings,
        output="screen",
    )
    guard = Node(
        package="wbc_controller",
        executable="guard",
        name="guard",
        namespace=LaunchConfiguration("namespace"),
        parameters=[config],
        remappings=remappings,
        condition=IfCondition(LaunchConfiguration("guard")),
        output="screen",
    )
    return LaunchDescription([*arguments, controller, guard])
