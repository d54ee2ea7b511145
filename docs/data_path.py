"""The calls that a joint state passes, from the transport to the torque message.

`docs/map.md` lists them, and `test/integration/test_data_path.py` follows them in a cycle of an active robot.
"""

from __future__ import annotations

#: The definition of the path, for `docs/map.md` and its test.
DEFINITION = """\
In each cycle, `ControlLoop.cycle` passes the joint state through the following calls. A function of the package is on
the path if it receives the joint state, or data made from it, as an argument or as the result of a call, and returns
data made from it, stores them (`-> None`), or calls such a function. The joint state is at first the serialized
message, then arrays and records of arrays, at last the serialized torques. The path begins when the transport returns
the message and ends when the transport receives the torques. Checks, which return a flag, a number or a fault, are not
on the path, nor are compiled kernels and constructors of records. `test/integration/test_data_path.py` follows the path
of an active robot whose base is measured, and compares it with `docs/data_path.py`."""
#: Largest number of calls on the path.
MOST_CALLS = 20
#: The functions on the path in the order of their first calls: file and qualified name.
PATH = (
    "nodes/inputs.py:Inputs.latch",
    "nodes/inputs.py:Inputs._collect",
    "nodes/inputs.py:Inputs._decode",
    "middleware/joint_states.py:JointStateReader.read",
    "middleware/joint_states.py:StateReader._decode",
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
    "middleware/message_layout.py:Template.write",
)
