"""A world in a process for tests: a few pixels, two axes of odd ranges. Python's standard library alone.

toy_world.py [FAULT]: serves, or does what FAULT says, in place of some answer.
"""

import json
import os
import random
import struct
import sys
import time

HEIGHT, WIDTH = 6, 10
LAST = 40
FAULT = sys.argv[1] if len(sys.argv) > 1 else ""
OUT = os.dup(1)


def write(data):
    while data:
        data = data[os.write(OUT, data):]


def send(header, pixels=b""):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    write(struct.pack("<II", len(text), len(pixels)) + text + pixels)


def receive():
    data = sys.stdin.buffer.read(8)
    if len(data) < 8:
        sys.exit(0)
    n, m = struct.unpack("<II", data)
    return json.loads(sys.stdin.buffer.read(n + m))


class Toy:
    """A dot that is pushed along a line; beyond its middle third it is off the road."""

    def reset(self, seed):
        self.at, self.t, self.laps = random.Random(seed).uniform(-0.2, 0.2), 0, 0

    def step(self, push, lift):
        self.at = max(-1.0, min(1.0, self.at + 0.05 * push + 0.001 * (lift - 256)))
        self.t += 1
        self.laps += self.t % 10 == 0

    def act(self):
        return [-40 * self.at, 256 + self.t]

    def off(self):
        return abs(self.at) > 1 / 3

    def picture(self):
        column = min(WIDTH - 1, int((self.at + 1) / 2 * WIDTH))
        return bytes(255 if x == column else 40 + 20 * (c == y % 3) for y in range(HEIGHT) for x in range(WIDTH) for c in range(3))

    def frame(self, asked, n, reward=None):
        known = {"off": self.off(), "laps": self.laps, "at": self.at, "nested.depth": 3, "quiet": None}
        names = known if asked == ["*"] else asked
        return {
            "type": "frame", "n": n, "height": HEIGHT, "width": WIDTH, "reward": reward, "terminated": abs(self.at) >= 1.0,
            "truncated": self.t >= LAST, "fields": {name: known.get(name) for name in names},
        }


def hello():
    return {
        "type": "hello", "protocol": 1, "name": "toy/World v1", "image": {"height": HEIGHT, "width": WIDTH},
        "axes": [{"name": "push", "low": -2.5, "high": 0.5}, {"name": "lift", "low": 0, "high": 512, "neutral": 256}],
        "hertz": 12.5, "longest_episode": LAST, "versions": {"python": sys.version.split()[0]}, "unknown": [1], "policy": FAULT != "no-policy",
        "events": [{"name": "off", "kind": "safety", "field": "off"}],
    }


def fault_at_start():
    if FAULT == "exit-at-start":
        sys.exit("ModuleNotFoundError: No module named 'my_robot'")
    if FAULT == "silent-at-start":
        time.sleep(60)
    if FAULT == "print-at-start":
        write(b"pygame-ce 2.5.8 (SDL 2.32, Python 3.11)\nHello from the pygame community.\n")
    if FAULT == "print-a-little":
        write(b"hi\n")
        time.sleep(60)
    if FAULT == "other-version":
        send({"type": "hello", "protocol": 99})
    if FAULT == "no-axes":
        send(dict(hello(), axes=[]))
    if FAULT == "huge-header":
        write(struct.pack("<II", 0x7FFFFFF0, 0))
    if FAULT == "huge-pixels":
        write(struct.pack("<II", 2, 0xFFFFFFF0) + b"{}")
    if FAULT == "no-json":
        send(b"{'type': 'hello'}")
    if FAULT == "bytes":
        write(bytes(range(200, 256)) * 50)
    if FAULT == "frame-first":
        toy = Toy()
        toy.reset(0)
        send(toy.frame([], 0))
    if FAULT == "sees-sdl":
        sys.exit(f"SDL_VIDEODRIVER is {os.environ.get('SDL_VIDEODRIVER')}, DROPJ_PROTOCOL is {os.environ.get('DROPJ_PROTOCOL')}")


def fault_at_step(toy, frame, pixels):
    if FAULT == "exit":
        sys.stderr.write("motor 3 is too hot\n")
        sys.stderr.flush()
        os._exit(3)
    if FAULT == "signal":
        os.kill(os.getpid(), 11)
    if FAULT == "hang":
        time.sleep(60)
    if FAULT == "hang-on-sigterm-with-child":
        os.system("sleep 60 & echo child $! >&2; sleep 60")
    if FAULT == "close-output":
        os.close(OUT)
        os.close(1)
        time.sleep(60)
    if FAULT == "print":
        write(b"step 1 of 40\n")
    if FAULT == "action-unasked":
        send({"type": "action", "n": frame["n"], "action": [0, 256]})
    if FAULT == "executed":
        frame = dict(frame, action=[-1.5, 1000])
    if FAULT == "executed-short":
        frame = dict(frame, action=[-1.5])
    if FAULT == "executed-nan":
        frame = dict(frame, action=[float("nan"), 256])
    if FAULT == "wrong-size":
        frame, pixels = dict(frame, height=HEIGHT + 1), pixels + bytes(WIDTH * 3)
    if FAULT == "few-pixels":
        pixels = pixels[:-1]
    if FAULT == "half-a-frame":
        text = json.dumps(frame).encode()
        write(struct.pack("<II", len(text), len(pixels)) + text + pixels[:20])
        time.sleep(60)
    if FAULT == "nan":
        frame = dict(frame, reward=float("nan"))
    if FAULT == "overflow":
        frame = dict(frame, reward=1e300)
    if FAULT == "two":
        send(frame, pixels)
    if FAULT == "error":
        send({"type": "error", "message": "ValueError: no such gear", "traceback": "line one\n\x1b[31mline two\n"})
        sys.exit(1)
    if FAULT == "uniform":
        pixels = bytes(len(pixels))
    if FAULT == "chatter":
        for i in range(20000):
            sys.stderr.write(f"a line of chatter, number {i}\n")
    send(frame, pixels)


def answer_to_act(toy, n):
    action = toy.act()
    if FAULT == "act-far":
        action = [-99, 1e9]
    if FAULT == "act-short":
        action = action[:1]
    if FAULT == "act-overflow":
        action = [1e300, 256]
    if FAULT == "act-infinite":
        action = [float("inf"), 256]
    if FAULT == "act-text":
        action = "left"
    if FAULT == "act-frame":
        return send(toy.frame([], n), toy.picture())
    if FAULT == "act-other":
        n -= 1
    if FAULT == "act-hang":
        time.sleep(60)
    if FAULT == "act-exit":
        sys.exit("the policy's file is not there")
    send({"type": "action", "n": n, "action": action})


def main():
    fault_at_start()
    send(hello())
    toy, asked = Toy(), []
    while True:
        request = receive()
        if request["type"] == "close":
            if FAULT == "no-end":
                time.sleep(60)
            return
        if request["type"] == "reset":
            asked = request["fields"]
            toy.reset(request["seed"])
            send(toy.frame(asked, request["n"]), toy.picture())
        elif request["type"] == "act":
            answer_to_act(toy, request["n"])
        else:
            toy.step(*request["action"])
            fault_at_step(toy, toy.frame(asked, request["n"], -1.0 if toy.off() else 0.5), toy.picture())


main()
