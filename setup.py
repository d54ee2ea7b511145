"""Installation, by pip and by colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "wbc_controller"

# ROS 2 Jazzy without an installation of ROS, on Fast DDS: wheels of a third party, which exist for these machines only.
_ROS2_WHEELS = "sys_platform == 'linux' and platform_machine == 'x86_64' and python_version < '3.14'"
_ROS2 = {
    "rclpy": ">=7.1.6,<7.2",
    "rmw-fastrtps-cpp": ">=8.4.3,<8.5",
    "diagnostic-msgs": ">=5.3.6,<5.4",
    "geometry-msgs": ">=5.3.6,<5.4",
    "lifecycle-msgs": ">=2.0.3,<2.1",
    "nav-msgs": ">=5.3.6,<5.4",
    "rcl-interfaces": ">=2.0.3,<2.1",
    "rosgraph-msgs": ">=2.0.3,<2.1",
    "sensor-msgs": ">=5.3.6,<5.4",
    "std-msgs": ">=5.3.6,<5.4",
    "std-srvs": ">=5.3.6,<5.4",
    "trajectory-msgs": ">=5.3.6,<5.4",
    "visualization-msgs": ">=5.3.6,<5.4",
}

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Whole-body QP controller for legged and other floating-base robots, as a ROS 2 service",
    author="The wbc_controller developers",
    maintainer="The wbc_controller developers",
    maintainer_email="maintainers@wbc-controller.invalid",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "config/*.yaml", "controller/visualization/page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.yaml"))),
        (f"share/{PACKAGE}/config/ros2_control", sorted(glob("config/ros2_control/*.yaml"))),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/layouts", sorted(glob("layouts/*"))),
    ],
    zip_safe=False,
    install_requires=[
        "click>=8.1,<9",
        "cyclonedds>=11.0.1,<12",
        "daqp>=0.11,<0.12",
        "mcap>=1.2,<2",
        "numba>=0.61,<0.70",
        "numpy>=1.26,<3",
        "osqp>=1.0,<2",
        "pin>=4.1,<5",
        "proxsuite>=0.7,<0.9",
        "pydantic>=2.7,<3",
        "pyyaml>=6,<7",
        "qpsolvers>=4.8,<5",
        "rich>=13,<16",
        "rosbags>=0.10.6,<0.12",
        "scipy>=1.11,<2",
        "zstandard>=0.21,<1",
    ],
    extras_require={
        "robots": ["example-robot-data>=6,<7"],
        "mock": [
            "mujoco-core>=4,<5; python_version >= '3.11'",
            "mujoco>=3.3,<4; python_version < '3.11'",
        ],
        # What the tests import; by pytest in it, colcon test knows that the tests are pytest's. For others they skip.
        "test": [
            "pytest>=7.4",
            "hypothesis>=6.100,<7",
            "quadprog>=0.1.12,<0.2",  # a solver that is called through qpsolvers, and the exact reference of the tests
            "joblib>=1.4,<2",
            "plotly>=7.1,<8",
            # What the examples for Python users are run with.
            "gymnasium>=1,<2",
            "nbclient>=0.10,<1",
            "ipykernel>=6,<8",
        ],
        "plots": ["plotly>=7.1,<8"],
        "campaign": ["joblib>=1.4,<2"],  # for wbc faults
        "fuzz": ["hypothesis>=6.100,<7"],  # for wbc fuzz messages, configurations and urdf
        # For wbc view and wbc play: the page, and what makes meshes small enough for a browser.
        "view": [
            "viser>=1.1.1,<1.2",
            "msgspec>=0.18.5,<1",
            "websockets>=13.1,<17",
            "trimesh>=4,<6",
            "fast-simplification>=0.1.9,<0.3",
        ],
        "ros2": [f"ros-jazzy-{name}{bounds}; {_ROS2_WHEELS}" for name, bounds in _ROS2.items()],
        "demo": ["wbc_controller[robots,mock,plots,campaign,view]"],
    },
    entry_points={
        "console_scripts": [
            "wbc = wbc_controller.cli:main",
            "wbc_controller = wbc_controller.node:main",
            "mock_robot = wbc_controller.node:mock_main",
            "guard = wbc_controller.node:guard_main",
            "base_estimator = wbc_controller.node:estimator_main",
        ],
    },
)
