"""Controller and mock robot: ``ros2 launch wbc_controller wbc.launch.py robot:=g1``."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, IfElseSubstitution, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(
            "robot",
            default_value="g1",
            choices=["g1", "talos", "go2"],
            description="Shipped robot; ignored if config:= is set.",
        ),
        DeclareLaunchArgument("config", default_value="", description="Path of a configuration, in place of robot:=."),
        DeclareLaunchArgument(
            "mock",
            default_value="true",
            choices=["true", "false"],
            description="Start the mock robot. It hangs until false is published on mock_robot/hold.",
        ),
        DeclareLaunchArgument(
            "guard",
            default_value="false",
            choices=["true", "false"],
            description="Start the guard, which damps the robot when the controller's commands stop.",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of all nodes."),
        DeclareLaunchArgument(
            "activate",
            default_value="false",
            choices=["true", "false"],
            description="Activate the controller without a command, when its inputs are fresh.",
        ),
        DeclareLaunchArgument(
            "real_time_factor", default_value="1.0", description="Simulated seconds per second of the mock robot."
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false"],
            description="Use the mock robot's clock, which waits for the controller: for slow computers.",
        ),
        DeclareLaunchArgument(
            "rviz",
            default_value="false",
            choices=["true", "false"],
            description="Start RViz (package rviz2) with the shipped layout.",
        ),
    ]
    robot, config = LaunchConfiguration("robot"), LaunchConfiguration("config")
    which = {
        "robot": ParameterValue(IfElseSubstitution(EqualsSubstitution(config, ""), robot, ""), value_type=str),
        "config": ParameterValue(config, value_type=str),
    }
    clock = [("/clock", "clock")]  # one clock per robot
    controller = Node(
        package="wbc_controller",
        executable="wbc_controller",
        name="wbc_controller",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            which,
            {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in ("activate", "use_sim_time")},
        ],
        remappings=clock,
        output="screen",
    )
    mock = Node(
        package="wbc_controller",
        executable="mock_robot",
        name="mock_robot",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            which,
            {"real_time_factor": ParameterValue(LaunchConfiguration("real_time_factor"), value_type=float)},
            {"patient": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)},
        ],
        remappings=clock,
        condition=IfCondition(LaunchConfiguration("mock")),
        output="screen",
    )
    guard = Node(
        package="wbc_controller",
        executable="guard",
        name="guard",
        namespace=LaunchConfiguration("namespace"),
        parameters=[which],
        condition=IfCondition(LaunchConfiguration("guard")),
        output="screen",
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", PathJoinSubstitution([FindPackageShare("wbc_controller"), "layouts", "wbc.rviz"])],
        remappings=[(f"/{topic}", topic) for topic in ("robot_description", "wbc_controller/markers", "odom")],
        condition=IfCondition(LaunchConfiguration("rviz")),
        output="screen",
    )
    return LaunchDescription([*arguments, mock, controller, guard, rviz])
