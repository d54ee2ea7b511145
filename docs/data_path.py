"""Calls on the path of a joint state, from the transport to the torque message."""

#: Definition of the path, for `docs/map.md` and `test/integration/test_data_path.py`.
DEFINITION = """\
In each cycle, `ControlLoop.cycle` passes the joint state through these calls, from the message of the transport to the
serialized torques: functions that receive the joint state or derived data, and return or store derived data, or call
such a function. Checks, compiled kernels and constructors of records are not listed.
`test/integration/test_data_path.py` compares the list with an active robot with odometry."""
#: Largest number of calls on the path.
MOST_CALLS = 20
#: File and qualified name of each function, in the order of first calls.
PATH = (
    "nodes/inputs.py:Inputs.latch",
    "nodes/inputs.py:Inputs._collect",
    "nodes/inputs.py:Inputs._decode",
    "middleware/states.py:JointStateReader.read",
    "middleware/states.py:StateReader._decode",
    "inverse_dynamics/robot/model.py:RobotModel.state",
    "controller/cycle.py:ControlCycle.cycle",
    "controller/cycle.py:ControlCycle._compute",
    "inverse_dynamics/whole_body_qp.py:WholeBodyQP.solve",
    "inverse_dynamics/formulation/formulation.py:Formulation.build",
    "inverse_dynamics/robot/dynamics.py:Dynamics.compute",
    "inverse_dynamics/whole_body_qp.py:WholeBodyQP._solve_with_relaxation",
    "inverse_dynamics/solvers/solver.py:Solver.solve",
    "inverse_dynamics/solvers/active_set.py:ActiveSet.solve",
    "inverse_dynamics/formulation/unpacking.py:unpack",
    "safety/supervisor.py:Supervisor.step",
    "safety/supervisor.py:Supervisor._follow",
    "nodes/outputs.py:Outputs.publish_command",
    "inverse_dynamics/robot/transmission.py:Drive.command",
    "middleware/codec.py:Template.write",
)
