"""racetrack-v0 of highway-env as a world of dropj: throttle and steering, 64 x 64 pixels, 15 steps a second."""

import dropj  # first: what is printed from here on goes to standard error

import gymnasium
import highway_env  # noqa: F401: it registers the world
import numpy as np

RATE = 15  # Hz


FAST = 15  # m/s, of the whole bar


def thickened(picture):
    """The brightest of each pixel and those around it."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.max(around, axis=0)


class World(gymnasium.Wrapper):
    """The reward is the way along the road in meters, while on it.

    In the picture all lines are three pixels wide instead of one, which networks would take for noise, and a bar at its foot
    tells the speed, as nothing else in one picture does.
    """

    def render(self):
        picture = thickened(self.env.render())
        picture[-4:] = 0
        middle = picture.shape[1] // 2
        end = middle + round(float(np.clip(self.unwrapped.vehicle.speed / FAST, -1, 1)) * middle)
        if end > middle:
            picture[-4:, middle:end] = (255, 255, 255)
        picture[-4:, end:middle] = (200, 0, 0)
        return picture

    def reset(self, **options):
        observation, _ = self.env.reset(**options)
        return observation, {"off_road": not self.unwrapped.vehicle.on_road, "crashed": False}

    def step(self, action):
        observation, _, terminated, truncated, info = self.env.step(action)
        car, off_road = self.unwrapped.vehicle, not info["rewards"]["on_road_reward"]
        turned = car.heading - car.lane.heading_at(car.lane.local_coordinates(car.position)[0])
        meters = 0.0 if off_road else car.speed * np.cos(turned) / RATE
        info = {"off_road": off_road, "crashed": info["crashed"], "speed": car.speed}
        return observation, meters, terminated, truncated, info


def world():
    return World(
        gymnasium.make(
            "racetrack-v0",
            disable_env_checker=True,
            render_mode="rgb_array",
            config={
                "action": {"type": "ContinuousAction", "longitudinal": True, "lateral": True},
                "observation": {"type": "Kinematics", "vehicles_count": 1},
                "screen_width": 64,
                "screen_height": 64,
                "scaling": 2.5,
                "centering_position": [0.5, 0.5],
                "policy_frequency": RATE,
                "duration": 20,
                "terminate_off_road": False,
                "other_vehicles": 2,
            },
        )
    )


class Policy:
    """Drives stretches of one second to four, each at a speed and on a line of its own, some of them beside the road or after another car."""

    def reset(self, env, rng):
        self.rng, self.left = rng, 0

    def act(self, env):
        if self.left == 0:
            self.draw()
        self.left -= 1
        car, others = env.unwrapped.vehicle, env.unwrapped.road.vehicles[1:]
        at, offset = car.lane.local_coordinates(car.position)
        towards, aside = car.lane.heading_at(at + 2 + max(car.speed, 0) / 2), -0.12 * (offset - self.line)
        if self.follows and others:
            way = min((other.position - car.position for other in others), key=np.linalg.norm)
            if np.linalg.norm(way) < 15:
                towards, aside = np.arctan2(way[1], way[0]), 0
        turned = (towards - car.heading + np.pi) % (2 * np.pi) - np.pi
        return np.clip([0.4 * (self.speed - car.speed), 1.3 * turned + aside + self.rng.normal(0, 0.1)], -1, 1)

    def draw(self):
        rng = self.rng
        self.left, self.speed, self.line = rng.integers(15, 61), rng.uniform(2, 13), rng.uniform(-1, 1)
        kind = rng.random()
        self.follows = kind < 0.2
        if kind > 0.75:
            self.line = rng.choice([-1.0, 1.0]) * rng.uniform(3, 8)


if __name__ == "__main__":
    dropj.serve(
        world,
        name="racetrack-v0",
        axes=["throttle", "steer"],
        neutral=[0, 0],
        hertz=RATE,
        size=(64, 64),
        pixels="render",
        safety=["crashed", "off_road"],
        policy=Policy,
    )
