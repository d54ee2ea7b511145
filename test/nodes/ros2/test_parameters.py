"""From ROS 2 parameters to settings, without ROS 2."""

import array

import pytest
from refusals import refusal

from wbc_controller.nodes.ros2.parameters import flatten, own_values, settings_from
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.settings.nesting import nested

G1 = find_configuration("g1")


def test_the_dotted_parameters_of_a_file_are_the_file():
    settings = load_settings(G1)
    parameters = {name: value for name, value, _ in flatten(settings)}
    assert "tasks.com.weight" in parameters
    ros = {"use_sim_time": False, "qos_overrides./parameter_events.publisher.depth": 1000, "autostart": True}
    assert settings_from(parameters | ros, "/wbc_controller", [], ["autostart"])[0] == settings
    flat = {"a.b": array.array("d", [1.0]), "a.c": ("x",), "a.d": "text"}
    assert nested(flat) == {"a": {"b": [1.0], "c": ["x"], "d": "text"}}


@pytest.mark.parametrize("base", [{"robot": "g1"}, {"config": str(G1), "robot": ""}])
def test_parameters_are_put_over_a_named_configuration(base):
    settings, source = settings_from(base | {"control.rate": 250.0, "tasks.com.weight": 7.0}, "/n", [])
    assert (settings.control.rate, settings.tasks["com"].weight) == (250.0, 7.0)
    assert settings.tasks["com"].stiffness == load_settings(G1).tasks["com"].stiffness
    assert str(G1) in source


def test_a_node_without_a_section_takes_the_controllers_section_of_the_parameter_file():
    arguments = ["mock_robot", "--ros-args", "--params-file", str(G1)]
    assert settings_from({"use_sim_time": False}, "/r1/mock_robot", arguments)[0] == load_settings(G1)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({}, "/n has no robot: pass -p robot:=<name> (Valid: g1, go2, talos)"),
        ({"robot": "talo"}, "did you mean 'talos'?"),
        ({"robot": "g1", "config": "x.yaml"}, "both name a configuration"),
        ({"config": "x.yaml"}, "config = 'x.yaml': file not found"),
        ({"robot": 1}, "robot = 1: must be a string"),
        ({"robot": "g1", "contorl.rate": 1.0}, "contorl: unknown key; did you mean 'control'?"),
        ({"control": 1, "control.rate": 1.0}, "parameter control = 1: conflict with parameter control.rate"),
    ],
)
def test_invalid_parameters_are_refused(parameters, said):
    assert said in refusal(settings_from, parameters, "/n", [])


def test_a_nodes_own_parameters_have_the_types_of_their_defaults():
    defaults = {"real_time_factor": 1.0, "lockstep": False}
    assert own_values({"real_time_factor": 2, "robot": "g1"}, defaults, "/n") == {
        "real_time_factor": 2.0,
        "lockstep": False,
    }
    for given, said in [
        ({"lockstep": "false"}, "/n: lockstep = 'false': must be true or false"),
        ({"lockstep": 0}, "/n: lockstep = 0: must be true or false"),
        ({"real_time_factor": "fast"}, "/n: real_time_factor = 'fast': must be a number"),
        ({"real_time_factor": True}, "/n: real_time_factor = True: must be a number"),
    ]:
        assert refusal(own_values, given, defaults, "/n") == said
