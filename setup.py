"""Files for ament and `ros2 launch`, beside the metadata in pyproject.toml: colcon (ament_python) runs this file."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "wbc_controller"

setup(
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "controller/visualization/page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.yaml"))),
        (f"share/{PACKAGE}/config/ros2_control", sorted(glob("config/ros2_control/*.yaml"))),
        (f"share/{PACKAGE}/config/diagnostics", ["config/diagnostics/analyzers.yaml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/layouts", sorted(glob("layouts/*"))),
    ],
    include_package_data=False,  # otherwise the wheel would contain the files of MANIFEST.in in folders of the package
    zip_safe=False,
)
