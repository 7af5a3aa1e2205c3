"""Drives the same actions here and in dropj's own Car Racing, and compares: python3 compare.py [DROPJ]"""

import hashlib
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import pygame
from serve import World, processed

N = 600
GOLDEN = pathlib.Path(__file__).parents[4] / "tests" / "golden"


class Gym(np.random.RandomState):
    """The random numbers of gym 0.20, with which dropj can lay the same track."""

    def __init__(self, seed):
        super().__init__(np.frombuffer(hashlib.sha512(str(seed).encode()).digest()[:8], "<u4"))


def actions(seed):
    """Mostly on the road, at times beside it."""
    rng = np.random.default_rng(seed)
    steer = np.repeat(rng.uniform(-0.3, 0.3, N // 20), 20)
    return np.stack([steer, np.repeat(rng.uniform(0, 0.4, N // 20), 20), np.repeat(rng.choice([0, 0, 0, 0.3], N // 20), 20)], 1)


def driven_here(seed, taken):
    env = World()
    env.reset(seed=0)
    env.unwrapped._np_random = Gym(seed)
    picture = env.reset()[0]
    pictures, rows = [processed(picture)], []
    for action in taken:
        picture, reward, ended, _, info = env.step(action.astype(np.float32))
        hull = env.car.hull
        rows.append([reward, ended, info["grass"], info["new_tile"], *hull.position, hull.angle, *hull.linearVelocity])
        pictures.append(processed(picture))
        if ended:
            break
    return np.array(rows, float), pictures


def driven_by_dropj(dropj, seed, taken, folder):
    table = pathlib.Path(folder) / "actions.csv"
    table.write_text("".join(",".join(repr(float(np.float32(value))) for value in action) + "\n" for action in taken))
    command = [dropj, "trace", "--gym-seed", str(seed), "--actions", str(table), "--frames", f"{folder}/frames-{seed}"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    rows = np.array([[float(cell) for cell in line.split(",")] for line in done.stdout.splitlines()])
    # steer, gas, brake, reward, out, grass, new tile, four of obstacles, score, x, y, angle, vx, vy, turn rate
    return rows[:, [3, 4, 5, 6, 12, 13, 14, 15, 16]]


def read(path):
    return pygame.surfarray.array3d(pygame.image.load(path)).swapaxes(0, 1)


def main():
    dropj = sys.argv[1] if len(sys.argv) > 1 else "dropj"
    for step in [0, 10, 150]:
        ours = processed(read(GOLDEN / f"frame_plain_0_step{step}.png"))
        assert np.array_equal(ours, read(GOLDEN / f"processed84_plain_0_step{step}.png"))
    print("the processing of pictures is dropj's, bit for bit")
    for seed in [0, 7]:
        taken = actions(seed)
        with tempfile.TemporaryDirectory() as folder:
            here, pictures = driven_here(seed, taken)
            there = driven_by_dropj(dropj, seed, taken, folder)
            raw = [read(f"{folder}/frames-{seed}/step{step:04}.png") for step in range(len(there) + 1)]
        assert len(here) == len(there), f"{len(here)} steps here and {len(there)} there"
        place = np.hypot(*(here - there)[:, 4:6].T)
        driven = np.hypot(*np.diff(there[:, 4:6], axis=0).T).sum()
        other = {name: int((here[:, i] != there[:, i]).sum()) for i, name in enumerate(["reward", "end", "grass", "new tile"])}
        pixels = np.mean([abs(a.astype(int) - processed(b)).mean() for a, b in zip(pictures, raw)])
        print(f"seed {seed}, {len(here)} steps, {driven:.0f} units, {int(here[:, 3].sum())} new tiles, {int(here[:, 2].sum())} steps of grass:")
        print(f"  the hull is {place.max():.1e} units away at the most; steps in which these differ: {other}; pixels by {pixels:.1f} of 255")
        assert place.max() < 0.01 and max(other.values()) <= 0.01 * len(here)


if __name__ == "__main__":
    main()
