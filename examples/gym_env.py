"""A Gymnasium environment with task references as actions: the agent sets the position of the centre of mass.

The whole-body controller keeps balance, limits and friction. The goal is a random point in each episode. Requires
``pip install gymnasium``.
"""

import sys

import gymnasium
import numpy as np

import wbc_controller as wbc

REACH = np.array([0.03, 0.03, 0.06])  # largest displacement of an action, m
CYCLES, STEPS = 25, 40  # control cycles per step of the environment, steps per episode


class BalanceEnv(gymnasium.Env):
    """Standing Go2; an action in [-1, 1]³ is the reference of its centre of mass.

    Observation, (9,): displacement and velocity of the centre of mass, and goal.
    """

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, (9,), np.float32)
        # Each action is reached within one step of the environment.
        self.robot = wbc.Simulation(wbc.load("go2").replace({"tasks.com.setpoint_duration": CYCLES / 500.0}))
        self.start = np.array(self.robot.controller.dynamics.com)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Reset the robot and draw a goal."""
        super().reset(seed=seed)
        self.robot.reset()
        self.goal, self.steps = REACH * self.np_random.uniform(-1.0, 1.0, 3), 0
        return self.observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Set the reference and run some control cycles."""
        self.robot.controller.set("com", self.start + REACH * np.clip(action, -1.0, 1.0))
        self.robot.run(CYCLES * self.robot.controller.period)
        self.steps += 1
        seen = self.observation()
        distance = float(np.linalg.norm(seen[:3] - self.goal))
        return seen, -distance, self.robot.plant.fallen, self.steps >= STEPS, {"distance": distance}

    def observation(self) -> np.ndarray:
        """Return the observation."""
        dynamics = self.robot.controller.dynamics
        return np.concatenate([dynamics.com - self.start, dynamics.com_velocity, self.goal]).astype(np.float32)


def main() -> int:
    """Run one episode with the goal as action; return 0 if the goal was reached."""
    env = BalanceEnv()
    seen, _ = env.reset(seed=7)
    total, done = 0.0, False
    while not done:
        seen, reward, fallen, ended, info = env.step(seen[6:] / REACH)
        total, done = total + reward, fallen or ended
    print(f"return {total:.2f} m, distance at the end {1e3 * info['distance']:.1f} mm (at most 2), fallen: {fallen}")
    return int(fallen or not info["distance"] < 0.002)


if __name__ == "__main__":
    sys.exit(main())
