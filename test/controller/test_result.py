"""Results of a cycle: values, tables and plots."""

import re

import numpy as np
import pytest
from refusals import input_refusal, refusal

import wbc_controller as wbc


@pytest.fixture(scope="module")
def results():
    """A push with binding constraints and a nearly unloaded foot."""
    robot = wbc.Simulation("g1")
    robot.run(0.1)
    robot.plant.push("pelvis", [0.0, 60.0, 0.0, 0.0, 0.0, 0.0], 0.2)
    return robot.run(0.6)


@pytest.fixture(scope="module")
def binding(results):
    return max(results, key=lambda each: len(each.binding))


def test_values_and_tables_of_a_result(binding):
    assert binding.tau is binding.command.tau
    assert list(binding.torques) == list(binding.qp.model.actuators)
    assert list(binding.torques.values()) == binding.tau.tolist()
    assert binding.v_dot is binding.solution.v_dot
    assert set(binding.forces) == {"left_foot", "right_foot"}
    assert max(binding.residuals.values()) < 1e-5
    used = binding.friction_used()
    for name, force in binding.forces.items():
        if force[2] > 1.0:
            assert used[name] == pytest.approx(np.hypot(*force[:2]) / (binding.qp.contacts[name].friction * force[2]))
        else:
            assert np.isnan(used[name])
    page = binding._repr_html_()
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page)
    assert set(binding.binding) | set(binding.task_errors) | set(binding.forces) <= set(cells)
    assert page.count("<table>") == 4


def test_table_of_binding_constraints_and_tasks(binding):
    said = repr(binding)
    lines = said.splitlines()
    assert lines[0] == f"active at {binding.time:.3f} s"
    for name, value in binding.task_errors.items():
        assert re.search(rf"^{name} +{re.escape(f'{value:.3g}')}\b", said, flags=re.MULTILINE), name
    for name in binding.binding:
        assert re.search(rf"^{name} +\S+$", said, flags=re.MULTILINE), name
    largest = binding.qp.model.actuators[int(np.argmax(np.abs(binding.tau) / binding.qp.model.effort_limits))]
    assert re.search(rf"^{largest} +\S+ N·m +\d+ %$", said, flags=re.MULTILINE)
    assert "array(" not in said
    assert max(map(len, lines)) <= 110


def test_result_without_a_solution():
    controller = wbc.Controller("go2", preflight=False)
    controller.reset(controller.stance(), np.zeros(controller.model.nv))
    controller.request("estop")
    result = controller.step(controller.stance(), np.zeros(controller.model.nv), 0.0)
    assert repr(result) == "fault at 0.000 s: ESTOP: emergency stop by command"
    assert (dict(result.forces), dict(result.binding), result.relaxed) == ({}, {}, ())
    assert np.isnan(result.v_dot).all()
    assert not result.tau.any()


def test_the_picture_of_a_cycle_is_of_its_own_state(binding):
    """Forces start at the soles of the result's state."""
    shapes = {shape.group: shape.points for shape in binding.shapes}
    assert {"contact_forces", "friction_cones", "support", "com", "capture_point"} <= set(shapes)
    figure = binding.plot()
    com = next(trace for trace in figure.data if trace.name == "com")
    dynamics = wbc.Dynamics(binding.qp.model)
    dynamics.update(binding.state.q, binding.state.v)
    np.testing.assert_allclose([com.x[0], com.y[0], com.z[0]], dynamics.com)
    (bars,) = [trace for trace in figure.data if trace.type == "bar"]
    shares = 100.0 * np.abs(binding.tau) / binding.qp.model.effort_limits
    assert bars.x[-1] == pytest.approx(shares.max())
    assert all(name in figure.layout.title.text for name in binding.binding)


def test_the_plot_of_a_run_has_every_cycle(results):
    figure = wbc.plot(results)
    traces = {(trace.legendgroup, trace.name): trace for trace in figure.data}
    np.testing.assert_array_equal(traces["task errors", "com"].x, [each.time for each in results])
    np.testing.assert_array_equal(traces["task errors", "com"].y, [each.task_errors["com"] for each in results])
    forces = [each.forces["left_foot"][2] for each in results]
    np.testing.assert_array_equal(traces["normal forces, N", "left_foot"].y, forces)
    marks = {trace.y[0]: len(trace.x) for trace in figure.data if trace.mode == "markers"}
    bound = [name for each in results for name in each.binding]
    assert marks == {name: bound.count(name) for name in set(bound)}
    assert "no results" in input_refusal(wbc.plot, [])


def test_missing_plotly(binding, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "plotly.graph_objects", None)
    assert "pip install 'wbc_controller[plots]'" in refusal(binding.plot)
