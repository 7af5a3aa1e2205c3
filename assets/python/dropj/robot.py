"""How a robot is served: python -m dropj.robot is one, with a camera and two wheels that are only pretended.

Put your camera into look and your motors into drive. dropj waits for each step as long as the world's file says.
"""

import time

import dropj
import numpy as np


class Robot:
    action_space = dropj.Box([-0.3, -1.0], [0.6, 1.0], names=["speed", "turn"], neutral=[0.0, 0.0])  # m/s, rad/s
    period = 1 / 10  # s
    x = 0.0

    def reset(self):
        self.drive(0.0, 0.0)
        self.x, self.steps, self.due = 0.0, 0, time.monotonic()  # drive home, or wait until it was put back by hand
        return self.look(), {}

    def step(self, action):
        speed, turn = action
        if self.x > 0.9:
            speed = min(speed, 0.1)  # a safety filter: what is executed is not what was asked
        self.drive(speed, turn)
        self.steps += 1
        self.due = max(self.due + self.period, time.monotonic())  # an even beat, however long dropj thought
        time.sleep(max(0.0, self.due - time.monotonic()))
        bumped = abs(self.x) > 1.0
        return self.look(), None, bumped, self.steps >= 600, {"bumped": bumped, "x": self.x, "executed": [speed, turn]}

    def drive(self, speed, turn):
        self.x += float(speed) * self.period  # motors.set(speed, turn)

    def look(self):
        picture = np.full((48, 64, 3), 90, np.uint8)  # camera.read(), RGB
        picture[:, min(63, max(0, int(32 + 30 * self.x)))] = 255
        return picture

    def close(self):
        self.drive(0.0, 0.0)  # whatever happened, it stops


def wander(robot, rng):
    """What it does where dropj records it by itself."""
    return rng.uniform(robot.action_space.low, robot.action_space.high)


if __name__ == "__main__":
    dropj.serve(Robot(), hertz=10, size=(48, 64), safety=["bumped"], policy=wander, executed="executed")
