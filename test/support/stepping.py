"""Steps of the mock robot and of its physics, as fast as possible."""


def step(robot, periods=1):
    """Publish, wait in lockstep for the answer, and advance."""
    for _ in range(periods):
        robot.publish()
        assert not robot._lockstep or robot.wait_for_answer()
        robot.advance()


def simulate(plant, steps):
    for _ in range(steps):
        plant.step()


def has_faults(injector):
    """Return True if a fault is planned or active, or a message is queued."""
    return bool(injector._planned or injector._acting or any(injector._waiting.values()))
