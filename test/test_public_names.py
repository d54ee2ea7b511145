"""Public names are few, and exported on purpose: a change of them is a change of this file."""

import importlib

import pytest

EXPORTED = {
    "wbc_controller.core.tasks": {
        "AccelerationTask",
        "AngularMomentumTask",
        "AxisAlignmentTask",
        "CapturePointTask",
        "ComTask",
        "ContactWrenchTask",
        "EffortTask",
        "FrameOrientationTask",
        "FramePoseTask",
        "FramePositionTask",
        "GazeTask",
        "LinearMomentumTask",
        "MotionTask",
        "PostureTask",
        "RateTask",
        "RelativePoseTask",
        "Task",
        "TorqueTask",
    },
    "wbc_controller.core.contacts": {
        "AnchoredContact",
        "Contact",
        "FixedContact",
        "LoopClosure",
        "PointContact",
        "Polygon",
        "Rectangle",
        "RollingContact",
        "SurfaceContact",
        "UnilateralContact",
        "placement_of",
        "polygon_wrench_cone",
        "wrench_cone",
    },
    "wbc_controller.core.limits": {
        "JointMotionLimit",
        "RowLimit",
        "SelfCollisionLimit",
        "TorqueLimit",
        "TorqueSpeedCurve",
    },
    "wbc_controller.core.solvers": {"Answer", "Solver", "available_solvers", "make_solver"},
}


@pytest.mark.parametrize("module", EXPORTED)
def test_a_package_exports_these_names(module):
    package = importlib.import_module(module)
    assert set(package.__all__) == EXPORTED[module]
    assert list(package.__all__) == sorted(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__module__.startswith(module)


def test_the_errors_are_one_tree():
    errors = importlib.import_module("wbc_controller.errors")
    own = {
        name: kind
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and kind.__module__ == errors.__name__
    }
    assert set(own) == {"WbcError", "ConfigurationError", "InputRefused", "NoSolution", "TransportError"}
    assert all(issubclass(kind, errors.WbcError) for kind in own.values())
    assert all(name in errors.__doc__ for name in own)
