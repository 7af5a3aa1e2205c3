"""CarRacing-v3 of Gymnasium as a world of dropj, with what dropj's own Car Racing has: its picture, grass, reward and end."""

import dropj  # first: what is printed from here on goes to standard error

import math

import numpy as np
from gymnasium.envs.box2d import car_racing


class Contacts(car_racing.FrictionDetector):
    """Grass as the paper counts it: from a wheel's last tile on, until any wheel comes onto any tile."""

    def __init__(self, env, *rest):
        super().__init__(env, *rest)
        env.off_road = False

    def _contact(self, contact, begin):
        super()._contact(contact, begin)
        ends = [contact.fixtureA.body.userData, contact.fixtureB.body.userData]
        wheel = next((end for end in ends if hasattr(end, "tiles")), None)
        if wheel is not None and any(hasattr(end, "road_friction") for end in ends):
            if begin:
                self.env.off_road = False
            elif not wheel.tiles:
                self.env.off_road = True


car_racing.FrictionDetector = Contacts


class Turned:
    """The hull as the camera is to see it: turned to where it moves, not to where it points."""

    def __init__(self, hull):
        self.hull = hull

    def __getattr__(self, name):
        return getattr(self.hull, name)

    @property
    def angle(self):
        vx, vy = self.hull.linearVelocity
        return -math.atan2(vx, vy) if math.hypot(vx, vy) > 0.5 else self.hull.angle


class World(car_racing.CarRacing):
    def _render(self, mode):
        hull = self.car.hull
        self.car.hull = Turned(hull)
        try:
            return super()._render(mode)
        finally:
            self.car.hull = hull

    def step(self, action):
        if action is None:  # the hidden step of a reset
            return super().step(action)
        before = self.tile_visited_count
        picture = super().step(action)[0]
        x, y = self.car.hull.position
        out = abs(x) > car_racing.PLAYFIELD or abs(y) > car_racing.PLAYFIELD
        grass = out or self.off_road
        new_tile = not grass and self.tile_visited_count > before
        reward = -1.0 if grass else 10.0 if new_tile else 0.0
        info = {"grass": grass, "new_tile": new_tile, "x": x, "y": y, "speed": self.car.hull.linearVelocity.length}
        return picture, reward, out, False, info  # goes on after a lap


def lanczos(x):
    return np.where(abs(x) < 3, np.sinc(x) * np.sinc(x / 3), 0.0)


def weights(n, to):
    """How Pillow squeezes n pixels to fewer, in fixed point: [to, n]."""
    scale = n / to
    x = (np.arange(n) - (np.arange(to)[:, None] + 0.5) * scale + 0.5) / scale
    whole = lanczos(x)
    return np.rint(whole / whole.sum(1, keepdims=True) * 2**22)


WEIGHTS = weights(96, 84)


def processed(raw):
    """[96, 96, 3] to [84, 84, 3]: without the bar below, squeezed, and black turned to white. Bit for bit as dropj does it."""
    picture = np.matmul(WEIGHTS, raw[:84].astype(np.float64))  # whole numbers below 2 ** 53
    picture = np.clip(np.floor((picture + 2**21) / 2**22), 0, 255).astype(np.uint8)
    picture[(picture == 0).all(2)] = 255
    return picture


class Policy:
    """Drives stretches of half a second to two, each at a speed and on a line of its own, some of them beside the road."""

    def reset(self, env, rng):
        self.rng, self.left = rng, 0

    def act(self, env):
        if self.left == 0:
            self.draw()
        self.left -= 1
        if self.fixed is not None:
            return self.fixed
        hull = env.car.hull
        (x, y), speed = hull.position, hull.linearVelocity.length
        nodes = np.array(env.track)[:, 1:]
        nearest = np.hypot(nodes[:, 1] - x, nodes[:, 2] - y).argmin()
        beta, to_x, to_y = nodes[(nearest + 3 + int(speed / 6)) % len(nodes)]
        to_x, to_y = to_x + self.line * math.cos(beta), to_y + self.line * math.sin(beta)
        sideways, ahead = hull.GetLocalPoint((to_x, to_y))
        bearing, missing = math.atan2(sideways, ahead), self.speed - speed
        gas = min(0.08 * missing, 0.4) if env.off_road else 0.08 * missing
        if abs(bearing) > 0.7:  # or it would spin
            gas = min(gas, 0.15) if speed < 12 else 0.0
        steer = 1.3 * bearing + self.rng.normal(0, 0.15)
        return np.clip([steer, gas, -0.02 * missing - 0.2], [-1, 0, 0], [1, 1, 0.8])

    def draw(self):
        rng = self.rng
        self.left, self.speed, self.line = rng.integers(30, 121), rng.uniform(8, 55), rng.uniform(-5, 5)
        kind, side = rng.random(), rng.choice([-1.0, 1.0])
        if kind < 0.15:
            self.line = side * rng.uniform(8, 20)
        self.fixed = [side, 0.5, 0.0] if 0.15 <= kind < 0.2 else [0.0, 0.0, 0.6] if 0.2 <= kind < 0.25 else None


if __name__ == "__main__":
    dropj.serve(
        World,
        name="CarRacing-v3",
        axes=["steer", "gas", "brake"],
        neutral=[0, 0, 0],
        hertz=50,
        size=(84, 84),
        pixels=lambda env, observation: processed(observation),
        safety=["grass"],
        progress=["new_tile"],
        policy=Policy,
    )
